"""One figure over all experiments of a comparison."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from gauge_envs.pages.figures import (
    CROSS,
    ENGINE_MARKERS,
    HOLLOW,
    OURS,
    REAL,
    UNSCORED,
    new_figure,
    save_png,
    tidy_axis,
)
from gauge_envs.pages.results import configuration_labels
from gauge_envs.pages.text import ALIGNED_TITLE, ENGINE_TITLES, METRIC_TITLES
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.tools.compare.comparison import Comparison, ExperimentComparison, compare
from gauge_envs.tools.compare.experiment_figure import save_figures
from gauge_envs.tools.compare.scores import COMPARED_METRICS, ScoreSpread

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


OVERVIEW = "overview"
"""Name of the picture of all experiments."""

LONG_LABEL = 40
"""Length of a label from which the legend has fewer columns [characters]."""


def save_comparison(results: Sequence[Result], folder: Path, *, metric: str | None = None) -> Iterator[Path]:
    """Write the pictures of `save_figures`, and one of all experiments with scores, `overview.png`.

    Args:
        results: Results of any experiments and configurations.
        folder: Where to, created if need be.
        metric: Metric of the overview, one of `scores.COMPARED_METRICS`; None for two panels, the primary scores and
            the raw RMSE.

    Yields:
        Path of each picture, as soon as it is written.
    """
    yield from save_figures(results, folder)
    overview = draw_overview(compare(results), metric=metric)
    if overview is not None:
        yield save_png(overview, folder / f"{OVERVIEW}.png")


def draw_overview(comparison: Comparison, *, metric: str | None = None) -> Figure | None:
    """Return dots of the normalized score of every experiment, with their 95 % intervals.

    Configurations are in colour. Published engines are in grey beside the raw scores of grade `trials`, because these
    alone are against the same reference.

    Args:
        comparison: What `gauge_envs.tools.compare.comparison.compare` returns.
        metric: One of `scores.COMPARED_METRICS`. None draws two panels: the score that reports show first, and the raw
            RMSE.

    Returns:
        The picture; None if no experiment has such a score.
    """
    names: list[str | None] = [metric] if metric is not None else [None, "rmse"]
    panels = [_panel(comparison, name) for name in names]
    shown = [one for one in comparison.experiments if any(_is_shown(one, panel) for panel in panels)]
    if not any(any(panel.spreads[one.id]) or panel.published[one.id] for panel in panels for one in shown):
        return None
    figure = new_figure(10.0, 0.3 * len(shown) + 2.2)
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axis, panel in zip(axes, panels, strict=True):
        _draw_panel(axis, shown, panel)
    axes[0].set_yticks(range(len(shown)), [f"{one.name}  ({_grade_text(one)})" for one in shown], fontsize=8)
    axes[0].set_ylim(len(shown) - 0.5, -0.5)
    has_published = any(panel.published[one.id] for panel in panels for one in shown)
    _overview_legend(
        figure, axes[-1], configuration_labels(comparison.configurations), shown, has_published=has_published
    )
    return figure


@dataclass(frozen=True, kw_only=True)
class _Panel:
    """What one panel shows.

    Attributes:
        title: Name of the metric.
        axis_label: Label of the axis of scores.
        spreads: Scores of each configuration by id.
        intervals: Their 95 % intervals by id.
        published: Published scores by id and engine.
    """

    title: str
    axis_label: str
    spreads: Mapping[str, Sequence[ScoreSpread | None]]
    intervals: Mapping[str, Sequence[tuple[float, float] | None]]
    published: Mapping[str, Mapping[str, float | None] | None]


def _panel(comparison: Comparison, metric: str | None) -> _Panel:
    metrics = {one.id: COMPARED_METRICS[metric or one.primary] for one in comparison.experiments}
    title = "Primary score" if metric is None else METRIC_TITLES.get(metric, ALIGNED_TITLE)
    closer = "1 is ideal" if metric in ("lsd", "mte", "pd") else "lower is closer"
    aligned = " (aligned after a release)" if metric is None else ""
    return _Panel(
        title=title,
        axis_label=f"normalized{aligned}, log scale; {closer}; bars: 95 %",
        spreads={
            one.id: [None if cell is None else cell.spread(metrics[one.id], normalized=True) for cell in one.cells]
            for one in comparison.experiments
        },
        intervals={
            one.id: [None if cell is None else cell.interval_95(metrics[one.id]) for cell in one.cells]
            for one in comparison.experiments
        },
        published={
            one.id: None if metric is None or COMPARED_METRICS[metric].normalized is None else one.published(metric)
            for one in comparison.experiments
        },
    )


def _is_shown(one: ExperimentComparison, panel: _Panel) -> bool:
    return any(panel.spreads[one.id]) or bool(panel.published[one.id]) or _diverged(one)


def _grade_text(one: ExperimentComparison) -> str:
    return f"{one.grade}, withheld" if one.withheld else one.grade


def _draw_panel(axis: Axes, shown: Sequence[ExperimentComparison], panel: _Panel) -> None:
    # An end of an interval at 0 has no place on a logarithmic axis: the bar reaches the edge.
    axis.set_xscale("log", nonpositive="clip")
    axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.axvline(1.0, color=REAL, lw=1.2, ls="--", zorder=1)
    places = [1.0]
    for place, one in enumerate(shown):
        for engine, marker in zip(ENGINE_TITLES, ENGINE_MARKERS, strict=True):
            value = (panel.published[one.id] or {}).get(engine)
            # A score of 0 has no place on a logarithmic axis.
            if value:
                axis.plot(value, place, marker, **HOLLOW)
                places.append(value)
        spreads, intervals = panel.spreads[one.id], panel.intervals[one.id]
        places += [spread.mean for spread in spreads if spread is not None and spread.mean > 0.0]
        places += [end for interval in intervals if interval is not None for end in interval if end > 0.0]
        _draw_dots(axis, one, spreads, intervals, place)
    low, high = 0.7 * min(places), 1.4 * max(places)
    axis.set_xlim(low, high)
    # Within two decades, whole decades alone are too few labels.
    digits = ("2", "5") if high < 100.0 * low else ()
    axis.xaxis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in digits else "")
    axis.set_xlabel(panel.axis_label, fontsize=9)
    axis.set_title(panel.title, loc="left", fontsize=12, fontweight="bold")
    tidy_axis(axis)
    axis.tick_params(axis="y", length=0)


def _draw_dots(
    axis: Axes,
    one: ExperimentComparison,
    spreads: Sequence[ScoreSpread | None],
    intervals: Sequence[tuple[float, float] | None],
    place: int,
) -> None:
    """Draw the scores of one experiment as a row of dots, and crosses at the right edge for diverged results."""
    for index, (cell, spread, interval) in enumerate(zip(one.cells, spreads, intervals, strict=True)):
        # Configurations side by side within the row, so that equal scores do not hide each other.
        height = place + 0.5 * ((index + 0.5) / len(one.cells) - 0.5)
        color = OURS[index % len(OURS)]
        if interval is not None:
            axis.hlines(height, *interval, color=color, lw=1.2, zorder=3)
        if spread is not None and spread.mean > 0.0:
            axis.plot(spread.mean, height, "o", ms=5.5, color=color, zorder=4)
        if cell is not None and cell.count(Outcome.DIVERGED):
            axis.plot(0.985, height, "x", color=color, transform=axis.get_yaxis_transform(), **CROSS)
    if not any(spreads):
        axis.axhspan(place - 0.5, place + 0.5, color=UNSCORED, zorder=0)


def _diverged(one: ExperimentComparison) -> bool:
    return any(cell is not None and cell.count(Outcome.DIVERGED) for cell in one.cells)


def _overview_legend(
    figure: Figure, axis: Axes, labels: Sequence[str], rows: Sequence[ExperimentComparison], *, has_published: bool
) -> None:
    for index, label in enumerate(labels):
        axis.plot([], [], "o", color=OURS[index % len(OURS)], ms=5.5, label=label)
    if has_published:
        for title, marker in zip(ENGINE_TITLES.values(), ENGINE_MARKERS, strict=True):
            axis.plot([], [], marker, label=f"{title}, paper", **HOLLOW)
    axis.fill_between([], [], fc=UNSCORED, ec="#c4c4c4", label="no score: no reference, or not run")
    if any(map(_diverged, rows)):
        axis.plot([], [], "x", color=REAL, label="diverged, at the right edge", **CROSS)
    columns = 4 if max(map(len, labels), default=0) < LONG_LABEL else 3
    figure.legend(loc="outside lower left", ncols=columns, fontsize=8, frameon=False)
