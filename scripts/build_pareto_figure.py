"""Draw error over cost: `docs/images/accuracy_and_cost.png`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from gauge_envs.backends.registry import backend_class
from gauge_envs.pages.figures import REAL, new_figure, save_png, tidy_axis
from gauge_envs.tools.compare.cost import (
    GREY,
    MIN_SHOWN,
    ROW_IN,
    set_ticks,
)
from scripts.build_pareto import stored
from scripts.generated import ROOT, Request
from scripts.pareto_model import Family, Phenomenon, Point, Tradeoff
from scripts.pictures import shrink

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FIGURE = ROOT / "docs" / "images" / "accuracy_and_cost.png"


def draw_pareto(tradeoff: Tradeoff) -> Figure:
    """Return the picture.

    Each row is a phenomenon: on the left the numerical error with the parametric floor, on the right the error against
    reality with the real scatter, or the distance to the exact motion where there are no trials.
    """
    count = len(tradeoff.phenomena)
    figure = new_figure(10.0, ROW_IN * count + 1.3)
    grid = figure.subplots(count, 2, squeeze=False, sharex="row")
    for (left, right), phenomenon in zip(grid, tradeoff.phenomena, strict=True):
        _panel(left, phenomenon, "numerical", "numerical error")
        if phenomenon.has_trials:
            _panel(right, phenomenon, "to_reality", "error against reality")
        else:
            _panel(
                right, phenomenon, "to_closed_form", "error against the exact motion"
            )
        left.set_title(phenomenon.name, loc="left", fontsize=11, fontweight="bold")
    unit = "CPU" if tradeoff.cost == "cpu" else "wall"
    for axis in grid[-1]:
        axis.set_xlabel(f"{unit} seconds per simulated second", fontsize=9)
    handles = list(_legend(tradeoff))
    figure.legend(
        handles=handles, loc="outside upper left", ncols=5, frameon=False, fontsize=9
    )
    figure.supxlabel(
        "Each line is one engine with one preset, from its coarsest step (left) to its finest (right). "
        "Crosses: other iterations.\nThe converged motion itself, with numerical error 0, is not drawn. "
        "Errors below 0.0001 are drawn there.",
        x=0.01,
        ha="left",
        fontsize=8.5,
        color="#505050",
    )
    return figure


def _panel(axis: Axes, phenomenon: Phenomenon, error: str, title: str) -> None:
    """Draw one error of all families over their cost, the real scatter, and the parametric floor."""
    tidy_axis(axis)
    axis.set_xscale("log")
    axis.set_yscale("log")
    for family in phenomenon.families:
        style = _style(family)
        line = [
            p
            for p in family.points
            if p.is_on_main_line and _value(p, error) is not None
        ]
        line.sort(key=lambda point: -(point.step_s or 0.0))
        if line:
            axis.plot(
                [p.cost for p in line],
                [_value(p, error) or math.nan for p in line],
                **style,
            )
            if error == "numerical" and family.is_default and style["color"] == GREY:
                # The name of an engine without a colour of its own stands at the end of its line.
                end = (line[-1].cost, _value(line[-1], error) or MIN_SHOWN)
                place: dict[str, Any] = {
                    "xytext": (5, 0),
                    "textcoords": "offset points",
                    "va": "center",
                }
                axis.annotate(
                    family.backend,
                    end,
                    fontsize=7.5,
                    color=style["color"],
                    annotation_clip=False,
                    **place,
                )
        others = [
            p
            for p in family.points
            if not p.is_on_main_line and _value(p, error) is not None
        ]
        if others:
            cross: dict[str, Any] = {
                "marker": "x",
                "ms": 6,
                "mew": 1.6,
                "ls": "",
                "color": style["color"],
            }
            axis.plot(
                [p.cost for p in others],
                [_value(p, error) or math.nan for p in others],
                **cross,
            )
    unit = "real scatter" if phenomenon.unit == "scatter" else phenomenon.unit
    axis.set_ylabel(f"{title}\n[{unit}]", fontsize=8.5)
    axis.tick_params(labelsize=8)
    axis.margins(x=0.12)
    floors = [
        family.floor
        for family in phenomenon.families
        if family.floor is not None and family.floor > MIN_SHOWN
    ]
    if phenomenon.unit == "scatter":
        axis.axhline(1.0, color=REAL, lw=1.0, ls="-", zorder=1)
    if floors:
        axis.axhspan(
            min(floors) * 0.97,
            max(floors) * 1.03,
            color="#9a9a9a",
            alpha=0.55,
            lw=0.0,
            zorder=1,
        )
    set_ticks(axis)


def _value(point: Point, error: str) -> float | None:
    """Return an error that a logarithmic axis can show; None for the converged motion's own numerical error."""
    value = getattr(point, error)
    if value is None or (error == "numerical" and point.is_reference):
        return None
    return max(float(value), MIN_SHOWN)


def _style(family: Family) -> dict[str, Any]:
    engine = backend_class(family.backend)
    shared = {
        "color": engine.color or GREY,
        "marker": engine.marker,
        "ms": 5,
        "lw": 1.3,
    }
    return (
        shared
        if family.is_default
        else shared | {"ls": (0, (4, 2)), "mfc": "white", "lw": 1.0, "ms": 4.5}
    )


def _legend(tradeoff: Tradeoff) -> Sequence[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    every = [
        family for phenomenon in tradeoff.phenomena for family in phenomenon.families
    ]
    named = {
        family.name: family
        for family in sorted(every, key=lambda one: (one.backend, not one.is_default))
    }
    lines: list[Any] = [
        Line2D([], [], label=name, **_style(family)) for name, family in named.items()
    ]
    lines.append(Line2D([], [], color=REAL, lw=1.0, label="scatter of real trials"))
    return [*lines, Patch(facecolor="#9a9a9a", alpha=0.55, label="parametric floor")]


def measure(request: Request) -> None:
    """Draw the figure from the stored errors."""
    save_png(draw_pareto(stored()[1]), FIGURE)
    shrink(FIGURE)
