"""Draw error over cost: `docs/images/accuracy_and_cost.png`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gauge_envs.backends.registry import backend_class
from gauge_envs.pages.figures import new_figure, save_png
from gauge_envs.tools.compare.cost_figure import (
    GREY,
    MIN_SHOWN,
    ROW_IN,
    Places,
    draw_errors,
    draw_legend,
    finish_panel,
    start_panel,
)
from scripts.build_pareto import stored
from scripts.generated import ROOT, Request
from scripts.pareto_model import Family, Phenomenon, Tradeoff
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
    draw_legend(figure)
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
    is_over_scatter = phenomenon.unit == "scatter"
    unit = "real scatter" if is_over_scatter else phenomenon.unit
    start_panel(axis, f"{title}\n[{unit}]")
    axis.margins(x=0.12)
    for family in phenomenon.families:
        line, others = _places(family, error, True), _places(family, error, False)
        draw_errors(
            axis,
            family.backend,
            line,
            others,
            name=family.name,
            is_default=family.is_default,
        )
        is_grey = not backend_class(family.backend).color
        if line and error == "numerical" and family.is_default and is_grey:
            # The name of an engine without a colour of its own stands at the end of its line.
            axis.annotate(
                family.backend,
                line[-1],
                xytext=(5, 0),
                textcoords="offset points",
                va="center",
                fontsize=7.5,
                color=GREY,
                annotation_clip=False,
            )
    floors = [family.floor for family in phenomenon.families if family.floor]
    if shown := [floor for floor in floors if floor > MIN_SHOWN]:
        axis.axhspan(
            min(shown) * 0.97,
            max(shown) * 1.03,
            color="#9a9a9a",
            alpha=0.55,
            lw=0.0,
            zorder=1,
            label="parametric floor",
        )
    finish_panel(axis, has_scatter=is_over_scatter)


def _places(family: Family, error: str, is_on_main_line: bool) -> Places:
    """Return costs and errors, the coarsest step first; the converged motion has no numerical error of its own."""
    points = [
        (point, getattr(point, error))
        for point in sorted(family.points, key=lambda one: -(one.step_s or 0.0))
        if point.is_on_main_line is is_on_main_line
        and not (error == "numerical" and point.is_reference)
    ]
    return [(point.cost, value) for point, value in points if value is not None]


def measure(request: Request) -> None:
    """Draw the figure from the stored errors."""
    save_png(draw_pareto(stored()[1]), FIGURE)
    shrink(FIGURE)
