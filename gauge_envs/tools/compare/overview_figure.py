"""One figure over all experiments of a comparison."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gauge_envs.pages.figures import OURS, REAL, new_figure, save_png, tidy_axis
from gauge_envs.pages.results import SCORE_METRICS
from gauge_envs.references.published import PUBLISHED_ENGINES
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.scoring.score import COVERAGE_FACTOR, OVER_U, Interval
from gauge_envs.tools.compare.comparison import (
    Comparison,
    ExperimentComparison,
    compare,
)
from gauge_envs.tools.compare.difference import ScoreSpread
from gauge_envs.tools.compare.experiment_figure import save_figures

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


OVERVIEW = "overview"
"""Name of the picture of all experiments."""

UNSCORED = "#f4f4f4"
ENGINE_MARKERS = dict(zip(PUBLISHED_ENGINES, "s^D", strict=True))
HOLLOW: dict[str, Any] = {
    "ms": 6,
    "mfc": "none",
    "mec": "#707070",
    "mew": 1.0,
    "ls": "",
    "zorder": 5,
}
CROSS: dict[str, Any] = {"ms": 6, "mew": 1.8, "ls": "", "zorder": 4}


def save_comparison(
    results: Sequence[Result], folder: Path, *, metric: str | None = None
) -> Iterator[Path]:
    """Write the pictures of `save_figures`, and one of all experiments with scores, `overview.png`.

    Args:
        results: Results of any experiments and configurations.
        folder: Where to, created if need be.
        metric: Metric of the overview, as in `draw_overview`.

    Yields:
        Path of each picture, as soon as it is written.
    """
    yield from save_figures(results, folder)
    overview = draw_overview(compare(results), metric=metric)
    if overview is not None:
        yield save_png(overview, folder / f"{OVERVIEW}.png")


def draw_overview(
    comparison: Comparison, *, metric: str | None = None
) -> Figure | None:
    """Return dots of the score of every experiment over its scale, with their 95 % intervals.

    Configurations are in colour. Published engines are in grey beside the raw scores of kind `trials`, because these
    alone are against the same reference. Distances from solutions have a panel of their own.

    Args:
        comparison: What `gauge_envs.tools.compare.comparison.compare` returns.
        metric: A key of `pages.results.SCORE_METRICS`. None draws two panels over real trials, the score that reports
            show first and the raw RMSE, and the distances from solutions.

    Returns:
        The picture; None if no experiment has such a score.
    """
    metrics: list[str | None] = [None, "rmse", OVER_U] if metric is None else [metric]
    shown = [
        one
        for one in comparison.experiments
        if _diverged(one) or any(_has_score(one, name) for name in metrics)
    ]
    metrics = [name for name in metrics if any(_has_score(one, name) for one in shown)]
    if not metrics:
        return None
    figure = new_figure(max(10.0, 4.0 * len(metrics)), 0.3 * len(shown) + 2.2)
    axes = figure.subplots(1, len(metrics), sharey=True, squeeze=False)[0]
    for axis, name in zip(axes, metrics, strict=True):
        _draw_panel(axis, shown, name)
    names = [f"{one.name}  ({one.kind})" for one in shown]
    axes[0].set_yticks(range(len(shown)), names, fontsize=8)
    axes[0].set_ylim(len(shown) - 0.5, -0.5)
    _legend(figure, axes[-1], comparison.labels, shown)
    return figure


def _scores(
    one: ExperimentComparison, metric: str | None
) -> Iterator[tuple[int, ScoreSpread, Interval | None]]:
    """Yield index, score and interval of each configuration; of None, the primary score over real trials."""
    if metric is None and one.is_solution:
        return
    name = metric or one.primary
    for index, cell in enumerate(one.cells):
        spread = None if cell is None else cell.spread(name, normalized=True)
        if cell is not None and spread is not None:
            yield index, spread, cell.interval_95(name)


def _published(one: ExperimentComparison, metric: str | None) -> dict[str, float]:
    """Return the published scores of a metric that stand beside it, by engine; nothing is for the primary score."""
    is_comparable = metric is not None and SCORE_METRICS[metric].is_normalized
    found = (one.published(metric or "") if is_comparable else None) or {}
    # A score of 0 has no place on a logarithmic axis.
    return {engine: value for engine, value in found.items() if value}


def _has_score(one: ExperimentComparison, metric: str | None) -> bool:
    return any(True for _ in _scores(one, metric)) or bool(_published(one, metric))


def _draw_panel(
    axis: Axes, shown: Sequence[ExperimentComparison], metric: str | None
) -> None:
    from matplotlib.ticker import LogLocator

    # An end of an interval at 0 has no place on a logarithmic axis: the bar reaches the edge.
    axis.set_xscale("log", nonpositive="clip")
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.xaxis.set_minor_formatter(lambda *_: "")
    is_solution = metric == OVER_U
    line = COVERAGE_FACTOR if is_solution else 1.0
    axis.axvline(line, color=REAL, lw=1.2, ls="--", zorder=1)
    for place, one in enumerate(shown):
        for engine, value in _published(one, metric).items():
            axis.plot(value, place, ENGINE_MARKERS[engine], **HOLLOW)
        is_scored = False
        for index, spread, interval in _scores(one, metric):
            is_scored = True
            height, color = _height(place, index, one), OURS[index % len(OURS)]
            if interval is not None:
                axis.hlines(height, *interval, color=color, lw=1.2, zorder=3)
            if spread.mean > 0.0:
                axis.plot(spread.mean, height, "o", ms=5.5, color=color, zorder=4)
        if not is_scored:
            axis.axhspan(place - 0.5, place + 0.5, color=UNSCORED, zorder=0)
        edge = axis.get_yaxis_transform()
        for index, cell in enumerate(one.cells):
            if cell is not None and cell.count(Outcome.DIVERGED):
                look = {"color": OURS[index % len(OURS)], "transform": edge, **CROSS}
                axis.plot(0.985, _height(place, index, one), "x", **look)
    closer = "1 is ideal" if metric in ("lsd", "mte", "pd") else "lower is closer"
    aligned = " (aligned after a release)" if metric is None else ""
    label = f"over real trials{aligned},\nlog scale; {closer}; bars: 95 %"
    if is_solution:
        label = f"over u of the solution,\nlog scale; up to {line} u is inside"
    axis.set_xlabel(label, fontsize=9)
    title = "Primary score" if metric is None else SCORE_METRICS[metric].title
    axis.set_title(
        f"{title[0].upper()}{title[1:]}", loc="left", fontsize=12, fontweight="bold"
    )
    tidy_axis(axis)
    axis.tick_params(axis="y", length=0)


def _height(place: int, index: int, one: ExperimentComparison) -> float:
    """Return the height of a configuration: side by side, so that equal scores do not hide each other."""
    return place + 0.5 * ((index + 0.5) / len(one.cells) - 0.5)


def _diverged(one: ExperimentComparison) -> bool:
    return any(cell is not None and cell.count(Outcome.DIVERGED) for cell in one.cells)


def _legend(
    figure: Figure,
    axis: Axes,
    labels: Sequence[str],
    shown: Sequence[ExperimentComparison],
) -> None:
    for index, label in enumerate(labels):
        axis.plot([], [], "o", color=OURS[index % len(OURS)], ms=5.5, label=label)
    for engine, marker in ENGINE_MARKERS.items():
        axis.plot([], [], marker, label=f"{PUBLISHED_ENGINES[engine]}, paper", **HOLLOW)
    text = "no score: no reference of this kind, or not run"
    axis.fill_between([], [], fc=UNSCORED, ec="#c4c4c4", label=text)
    if any(map(_diverged, shown)):
        axis.plot([], [], "x", color=REAL, label="diverged, at the right edge", **CROSS)
    figure.legend(loc="outside lower left", ncols=3, fontsize=8, frameon=False)
