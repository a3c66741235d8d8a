"""Picture of error over cost: numerical error and error against reality of every engine, one row per phenomenon."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from gauge_envs.pages.figures import OURS, REAL, new_figure, tidy_axis
from gauge_envs.tools.cost.model import Family, Phenomenon, Point, Tradeoff

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


COLOURS = {
    "mujoco": OURS[0],
    "rapier": OURS[1],
    "physx": OURS[2],
    "newton": OURS[3],
    "drake": OURS[4],
    "genesis": OURS[5],
    "pybullet": "#000000",
}
"""Colours of the engines of this package; others share a grey and have their name at the line."""

MARKERS = {
    "mujoco": "o",
    "rapier": "s",
    "physx": "^",
    "newton": "D",
    "drake": "v",
    "genesis": "P",
    "pybullet": "X",
}

LEAST_SHOWN = 1e-4
"""Errors below this are drawn at the lower edge."""

ROW_IN = 2.3


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
        scored = phenomenon.best("to_reality") is not None
        _panel(
            right,
            phenomenon,
            "to_reality" if scored else "to_closed_form",
            "error against reality" if scored else "error against the exact motion",
        )
        left.set_title(phenomenon.name, loc="left", fontsize=11, fontweight="bold")
        for axis in (left, right):
            _mark_limits(axis, phenomenon)
    unit = "CPU" if tradeoff.cost == "cpu" else "wall"
    for axis in grid[-1]:
        axis.set_xlabel(f"{unit} seconds per simulated second", fontsize=9)
    handles = list(_legend(tradeoff))
    figure.legend(handles=handles, loc="outside upper left", ncols=5, frameon=False, fontsize=9)
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
    """Draw one error of all families over their cost."""
    tidy_axis(axis)
    axis.set_xscale("log")
    axis.set_yscale("log")
    for family in phenomenon.families:
        style = _style(family)
        line = [p for p in family.points if p.is_on_main_line and _value(p, error) is not None]
        line.sort(key=lambda point: -(point.step_s or 0.0))
        if line:
            axis.plot([p.cost for p in line], [_value(p, error) or math.nan for p in line], **style)
            if error == "numerical":
                _name_line(axis, family, (line[-1].cost, _value(line[-1], error) or LEAST_SHOWN), style["color"])
        others = [p for p in family.points if not p.is_on_main_line and _value(p, error) is not None]
        if others:
            cross: dict[str, Any] = {"marker": "x", "ms": 6, "mew": 1.6, "ls": "", "color": style["color"]}
            axis.plot([p.cost for p in others], [_value(p, error) or math.nan for p in others], **cross)
    unit = "real scatter" if phenomenon.unit == "scatter" else phenomenon.unit
    axis.set_ylabel(f"{title}\n[{unit}]", fontsize=8.5)
    axis.tick_params(labelsize=8)
    axis.margins(x=0.12)


def _name_line(axis: Axes, family: Family, end: tuple[float, float], colour: str) -> None:
    """Write the name of an engine without a colour of its own at the end of its line; the legend names the others."""
    if family.is_default and family.backend not in COLOURS:
        place: dict[str, Any] = {"xytext": (5, 0), "textcoords": "offset points", "va": "center"}
        axis.annotate(family.backend, end, fontsize=7.5, color=colour, annotation_clip=False, **place)


def _value(point: Point, error: str) -> float | None:
    """Return an error that a logarithmic axis can show; None for the converged motion's own numerical error."""
    value = getattr(point, error)
    if value is None or (error == "numerical" and point.is_reference):
        return None
    return max(float(value), LEAST_SHOWN)


def _mark_limits(axis: Axes, phenomenon: Phenomenon) -> None:
    """Draw the real scatter and the parametric floor."""
    floors = [family.floor for family in phenomenon.families if family.floor is not None and family.floor > LEAST_SHOWN]
    if phenomenon.unit == "scatter":
        axis.axhline(1.0, color=REAL, lw=1.0, ls="-", zorder=1)
    if floors:
        axis.axhspan(min(floors) * 0.97, max(floors) * 1.03, color="#9a9a9a", alpha=0.55, lw=0.0, zorder=1)
    _set_ticks(axis)


def _set_ticks(axis: Axes) -> None:
    """Label 1, 2 and 5 of each decade of cost, and whole decades of error, of which at least one is shown."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axis.get_ylim()
    axis.set_ylim(min(low, 0.5 * high), max(high, 2.0 * low))
    low, high = axis.get_ylim()
    axis.set_ylim(0.7 * 10.0 ** math.floor(math.log10(low) + 0.3), 10.0 ** math.ceil(math.log10(high) - 0.1))
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    for one in (axis.xaxis, axis.yaxis):
        one.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        one.set_minor_formatter(NullFormatter())


def _style(family: Family) -> dict[str, Any]:
    colour = COLOURS.get(family.backend, "#707070")
    shared = {"color": colour, "marker": MARKERS.get(family.backend, "*"), "ms": 5, "lw": 1.3}
    return shared if family.is_default else shared | {"ls": (0, (4, 2)), "mfc": "white", "lw": 1.0, "ms": 4.5}


def _legend(tradeoff: Tradeoff) -> Sequence[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    every = [family for phenomenon in tradeoff.phenomena for family in phenomenon.families]
    named = {family.name: family for family in sorted(every, key=lambda one: (one.backend, not one.is_default))}
    lines: list[Any] = [Line2D([], [], label=name, **_style(family)) for name, family in named.items()]
    lines.append(Line2D([], [], color=REAL, lw=1.0, label="scatter of real trials"))
    return [*lines, Patch(facecolor="#9a9a9a", alpha=0.55, label="parametric floor")]
