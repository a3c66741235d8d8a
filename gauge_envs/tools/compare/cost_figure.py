"""The picture of `gauge plot --kind cost`: errors over cost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from gauge_envs.backends.registry import backend_class
from gauge_envs.pages.figures import REAL, new_figure, tidy_axis
from gauge_envs.pages.text import short_id
from gauge_envs.tools.compare.cost import CostCurve

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Places = Sequence[tuple[float, float]]
"""Costs and errors."""

GREY = "#707070"
"""Colour of engines that state none."""

MIN_SHOWN = 1e-4
"""Errors below this are drawn at the lower edge."""

ROW_IN = 2.3


def draw_costs(curves: Sequence[CostCurve]) -> Figure:
    """Return the picture: each row is an experiment, with its numerical error and that against its reference."""
    groups: dict[tuple[str, str], list[CostCurve]] = {}
    for curve in curves:
        groups.setdefault((short_id(curve.id), str(curve.first.parameters)), []).append(
            curve
        )
    figure = new_figure(10.0, ROW_IN * len(groups) + 1.3)
    grid = figure.subplots(len(groups), 2, squeeze=False, sharex="row")
    for (left, right), ((name, parameters), members) in zip(
        grid, groups.items(), strict=True
    ):
        unit = members[0].unit
        reference = "the solution" if members[0].measure.is_verified else "reality"
        for axis, error, title in (
            (left, "numerical", "numerical error"),
            (right, "to_reference", f"error against {reference}"),
        ):
            start_panel(axis, f"{title}\n[{unit}]")
            for curve in members:
                _draw_curve(axis, curve, error)
            finish_panel(axis, has_scatter=bool(members[0].measure.scatter))
        changed = "" if parameters == "calibrated" else f", {parameters}"
        left.set_title(f"{name}{changed}", loc="left", fontsize=11, fontweight="bold")
    for axis in grid[-1]:
        axis.set_xlabel(f"{curves[0].time} seconds per simulated second", fontsize=9)
    draw_legend(figure)
    return figure


def _draw_curve(axis: Axes, curve: CostCurve, error: str) -> None:
    """Draw one error of a curve."""

    def places(is_main: bool) -> Places:
        errors = [
            (one.cost, curve.over_scatter(getattr(one, error)))
            # The converged motion has no numerical error of its own.
            for one in (curve.main_line if is_main else curve.settings)
            if one.is_main is is_main
            and not (error == "numerical" and one.is_converged)
        ]
        return [(cost, value) for cost, value in errors if value is not None]

    draw_errors(
        axis,
        curve.first.backend or "file",
        places(True),
        places(False),
        name=curve.name,
        is_default="preset" not in curve.first.settings_given,
    )


def start_panel(axis: Axes, title: str) -> None:
    """Begin a panel of errors over cost, both in logarithms."""
    tidy_axis(axis)
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.tick_params(labelsize=8)
    axis.set_ylabel(title, fontsize=8.5)


def draw_errors(
    axis: Axes,
    backend: str,
    line: Places,
    others: Places,
    *,
    name: str,
    is_default: bool,
) -> None:
    """Draw the errors of an engine over their cost.

    Args:
        axis: The panel.
        backend: Name of the engine.
        line: Costs and errors of its steps, drawn as a line.
        others: Those of other iterations, drawn as crosses.
        name: Name of the line in the legend.
        is_default: Whether its settings are the engine's own, whose line is not dashed.
    """
    engine = backend_class(backend)
    style: dict[str, Any] = {
        "color": engine.color or GREY,
        "marker": engine.marker,
        "ms": 5,
        "lw": 1.3,
    }
    cross: dict[str, Any] = {"color": style["color"], "marker": "x", "ls": ""}
    if not is_default:
        style |= {"ls": "--", "mfc": "white", "lw": 1.0}
    for places, looks in ((line, style | {"label": name}), (others, cross)):
        axis.plot(
            [cost for cost, _ in places],
            [max(error, MIN_SHOWN) for _, error in places],
            **looks,
        )


def finish_panel(axis: Axes, *, has_scatter: bool) -> None:
    """Draw the scatter of real trials, if errors are in units of it, and label the axes."""
    if has_scatter:
        axis.axhline(1.0, color=REAL, lw=1.0, zorder=1, label="scatter of real trials")
    _set_ticks(axis)


def draw_legend(figure: Figure) -> None:
    """Draw the legend of all panels above them, a label once."""
    labels: dict[str, Any] = {}
    for axis in figure.axes:
        labels |= dict(zip(*reversed(axis.get_legend_handles_labels()), strict=True))
    figure.legend(
        labels.values(),
        labels,
        loc="outside upper left",
        ncols=5,
        frameon=False,
        fontsize=9,
    )


def _set_ticks(axis: Axes) -> None:
    """Label 1, 2 and 5 of each decade of cost, and whole decades of error, of which at least one is shown."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axis.get_ylim()
    axis.set_ylim(min(low, 0.5 * high), max(high, 2.0 * low))
    low, high = axis.get_ylim()
    lower = 0.7 * 10.0 ** math.floor(math.log10(low) + 0.3)
    upper = 10.0 ** math.ceil(math.log10(high) - 0.1)
    axis.set_ylim(min(low, lower), max(high, upper))
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    for one in (axis.xaxis, axis.yaxis):
        one.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        one.set_minor_formatter(NullFormatter())
