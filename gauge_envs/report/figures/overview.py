"""One figure over all experiments of a comparison."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gauge_envs.analysis.comparison import Comparison, ExperimentComparison, compare
from gauge_envs.analysis.scores import COMPARED_METRICS, ScoreSpread
from gauge_envs.report import ALIGNED_TITLE, ENGINE_TITLES, METRIC_TITLES, configuration_labels
from gauge_envs.report.figures.experiment import save_figures
from gauge_envs.report.figures.style import (
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
from gauge_envs.runs.result import Outcome, Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


__all__ = ["draw_overview", "save_comparison"]

OVERVIEW = "overview"
"""Name of the picture of all experiments."""


def save_comparison(results: Sequence[Result], folder: Path, *, metric: str = "rmse") -> Iterator[Path]:
    """Write the pictures of `save_figures`, and one of all experiments with scores, `overview.png`.

    Args:
        results: Results of any experiments and configurations.
        folder: Where to, created if need be.
        metric: ComparedMetric of the overview, one of `gauge_envs.analysis.scores.COMPARED_METRICS`.

    Yields:
        Path of each picture, as soon as it is written.

    Raises:
        MissingExtraError: matplotlib is not installed.
        ResultFileError: The folder cannot be written.
    """
    yield from save_figures(results, folder)
    overview = draw_overview(compare(results), metric=metric)
    if overview is not None:
        yield save_png(overview, folder / f"{OVERVIEW}.png")


def draw_overview(comparison: Comparison, *, metric: str = "rmse") -> Figure | None:
    """Return dots of the normalized score of every experiment: configurations in colour, published engines in grey.

    Args:
        comparison: What `gauge_envs.analysis.comparison.compare` returns.
        metric: One of `gauge_envs.analysis.scores.COMPARED_METRICS`.

    Returns:
        The picture; None if no experiment has such a score.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    chosen = COMPARED_METRICS[metric]
    scores = {
        one.id: [None if cell is None else cell.spread(chosen, normalized=True) for cell in one.cells]
        for one in comparison.experiments
    }
    published = {one.id: one.baselines.get(chosen.published or "") for one in comparison.experiments}
    if chosen.normalized is None or not any(any(scores[key]) or published[key] for key in scores):
        return None
    rows = [one for one in comparison.experiments if any(scores[one.id]) or published[one.id] or _diverged(one)]
    figure = new_figure(10.0, 0.3 * len(rows) + 2.2)
    axis = figure.add_subplot()
    axis.set_xscale("log")
    axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.axvline(1.0, color=REAL, lw=1.2, ls="--", zorder=1)
    for place, one in enumerate(rows):
        line = published[one.id]
        for engine, marker in zip(ENGINE_TITLES, ENGINE_MARKERS, strict=True):
            value = None if line is None else line.engines[engine]
            # A score of 0 has no place on a logarithmic axis.
            if value:
                axis.plot(value, place, marker, **HOLLOW)
        _draw_dots(axis, one, scores[one.id], place)
    _overview_legend(figure, axis, configuration_labels(comparison.configurations), rows)
    axis.set_yticks(range(len(rows)), [f"{one.name}  ({one.grade})" for one in rows], fontsize=8)
    axis.set_ylim(len(rows) - 0.5, -0.5)
    title = METRIC_TITLES.get(metric, ALIGNED_TITLE)
    closer = "1 is ideal" if metric in ("lsd", "mte", "pd") else "1 = a typical real trial, lower is closer"
    repeats = any(spread and spread.std is not None for spreads in scores.values() for spread in spreads)
    whiskers = "; whiskers: standard deviation of repeats" if repeats else ""
    axis.set_xlabel(f"normalized {title}, log scale; {closer}{whiskers}")
    axis.set_title(f"{title} of each experiment, against reality", loc="left", fontsize=12, fontweight="bold")
    tidy_axis(axis)
    axis.tick_params(axis="y", length=0)
    return figure


def _draw_dots(axis: Axes, one: ExperimentComparison, spreads: Sequence[ScoreSpread | None], place: int) -> None:
    """Draw the scores of one experiment as a row of dots, and crosses at the right edge for diverged results."""
    for index, (cell, spread) in enumerate(zip(one.cells, spreads, strict=True)):
        # Configurations side by side within the row, so that equal scores do not hide each other.
        height = place + 0.5 * ((index + 0.5) / len(one.cells) - 0.5)
        color = OURS[index % len(OURS)]
        if spread is not None and spread.mean > 0.0:
            reach = spread.std or 0.0
            low = min(reach, 0.95 * spread.mean)
            axis.errorbar(spread.mean, height, xerr=[[low], [reach]], fmt="o", ms=5.5, color=color, zorder=4)
        if cell is not None and cell.count(Outcome.DIVERGED):
            axis.plot(0.985, height, "x", color=color, transform=axis.get_yaxis_transform(), **CROSS)
    if not any(spreads):
        axis.axhspan(place - 0.5, place + 0.5, color=UNSCORED, zorder=0)


def _diverged(one: ExperimentComparison) -> bool:
    return any(cell is not None and cell.count(Outcome.DIVERGED) for cell in one.cells)


def _overview_legend(figure: Figure, axis: Axes, labels: Sequence[str], rows: Sequence[ExperimentComparison]) -> None:
    for index, label in enumerate(labels):
        axis.plot([], [], "o", color=OURS[index % len(OURS)], ms=5.5, label=label)
    for title, marker in zip(ENGINE_TITLES.values(), ENGINE_MARKERS, strict=True):
        axis.plot([], [], marker, label=f"{title}, paper", **HOLLOW)
    axis.fill_between([], [], fc=UNSCORED, ec="#c4c4c4", label="no score: no reference, or not run")
    if any(map(_diverged, rows)):
        axis.plot([], [], "x", color=REAL, label="diverged, at the right edge", **CROSS)
    figure.legend(loc="outside lower left", ncols=4, fontsize=8, frameon=False)
