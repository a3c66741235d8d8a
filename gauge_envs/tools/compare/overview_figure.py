"""One figure over all experiments of a comparison."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gauge_envs.pages.figures import OURS, REAL, new_figure, save_png, tidy_axis
from gauge_envs.pages.results import SCORE_METRICS, VERIFIED
from gauge_envs.references.published import PUBLISHED_ENGINES
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.scoring.score import COVERAGE_FACTOR
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

LONG_LABEL = 40
"""Length of a label from which the legend has fewer columns [characters]."""

UNSCORED = "#f4f4f4"
ENGINE_MARKERS = ("s", "^", "D")
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
    chosen: list[str | None] = [None, "rmse", VERIFIED.key]
    if metric is not None:
        chosen = [metric]
    shown = []
    panels: list[list[_Row]] = [[] for _ in chosen]
    for one in comparison.experiments:
        rows = [_Row.of(one, name) for name in chosen]
        if _diverged(one) or any(row.has_score for row in rows):
            shown.append(one)
            for panel, row in zip(panels, rows, strict=True):
                panel.append(row)
    kept = [
        index
        for index, panel in enumerate(panels)
        if any(row.has_score for row in panel)
    ]
    panels, chosen = (
        [panels[index] for index in kept],
        [chosen[index] for index in kept],
    )
    drawn = [row for panel in panels for row in panel]
    if not any(row.has_score for row in drawn):
        return None
    figure = new_figure(max(10.0, 4.0 * len(chosen)), 0.3 * len(shown) + 2.2)
    axes = figure.subplots(1, len(chosen), sharey=True, squeeze=False)[0]
    for axis, panel, name in zip(axes, panels, chosen, strict=True):
        _draw_panel(axis, panel, name)
    axes[0].set_yticks(
        range(len(shown)),
        [f"{one.name}  ({one.kind})" for one in shown],
        fontsize=8,
    )
    axes[0].set_ylim(len(shown) - 0.5, -0.5)
    has_published = any(row.published for row in drawn)
    _overview_legend(
        figure, axes[-1], comparison.labels, shown, has_published=has_published
    )
    return figure


@dataclass(frozen=True)
class _Row:
    """Scores of one experiment in a panel: of each configuration with its 95 % interval, and as published."""

    one: ExperimentComparison
    spreads: Sequence[ScoreSpread | None]
    intervals: Sequence[tuple[float, float] | None]
    published: Mapping[str, float | None]

    @classmethod
    def of(cls, one: ExperimentComparison, metric: str | None) -> _Row:
        """Return the scores of a metric; None is the primary one over real trials, of which nothing is published."""
        name = metric or one.primary
        if metric is None and one.is_solution:
            nothing = [None] * len(one.cells)
            return cls(one, nothing, nothing, {})
        is_comparable = metric is not None and SCORE_METRICS[metric].is_normalized
        return cls(
            one,
            [
                None if cell is None else cell.spread(name, normalized=True)
                for cell in one.cells
            ],
            [None if cell is None else cell.interval_95(name) for cell in one.cells],
            (one.published(name) if is_comparable else None) or {},
        )

    @property
    def has_score(self) -> bool:
        return any(self.spreads) or bool(self.published)


def _draw_panel(axis: Axes, rows: Sequence[_Row], metric: str | None) -> None:
    # An end of an interval at 0 has no place on a logarithmic axis: the bar reaches the edge.
    axis.set_xscale("log", nonpositive="clip")
    axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    is_verified = metric == VERIFIED.key
    line = COVERAGE_FACTOR if is_verified else 1.0
    axis.axvline(line, color=REAL, lw=1.2, ls="--", zorder=1)
    places = [line]
    for place, row in enumerate(rows):
        for engine, marker in zip(PUBLISHED_ENGINES, ENGINE_MARKERS, strict=True):
            value = row.published.get(engine)
            # A score of 0 has no place on a logarithmic axis.
            if value:
                axis.plot(value, place, marker, **HOLLOW)
                places.append(value)
        places += [
            spread.mean
            for spread in row.spreads
            if spread is not None and spread.mean > 0.0
        ]
        places += [
            end
            for interval in row.intervals
            if interval is not None
            for end in interval
            if end > 0.0
        ]
        _draw_dots(axis, row, place)
    low, high = 0.7 * min(places, default=1.0), 1.4 * max(places, default=1.0)
    axis.set_xlim(low, high)
    # Within two decades, whole decades alone are too few labels.
    digits = ("2", "5") if high < 100.0 * low else ()
    axis.xaxis.set_minor_formatter(
        lambda value, _: f"{value:g}" if f"{value:e}"[0] in digits else ""
    )
    closer = "1 is ideal" if metric in ("lsd", "mte", "pd") else "lower is closer"
    aligned = " (aligned after a release)" if metric is None else ""
    label = f"over real trials{aligned}, log scale; {closer}; bars: 95 %"
    if is_verified:
        label = f"over u of the solution, log scale; up to {line} u is inside"
    axis.set_xlabel(label, fontsize=9)
    title = "Primary score" if metric is None else SCORE_METRICS[metric].title
    if is_verified:
        title = "Verification"
    axis.set_title(title, loc="left", fontsize=12, fontweight="bold")
    tidy_axis(axis)
    axis.tick_params(axis="y", length=0)


def _draw_dots(axis: Axes, row: _Row, place: int) -> None:
    """Draw the scores of one experiment as a row of dots, and crosses at the right edge for diverged results."""
    cells = row.one.cells
    for index, (cell, spread, interval) in enumerate(
        zip(cells, row.spreads, row.intervals, strict=True)
    ):
        # Configurations side by side within the row, so that equal scores do not hide each other.
        height = place + 0.5 * ((index + 0.5) / len(cells) - 0.5)
        color = OURS[index % len(OURS)]
        if interval is not None:
            axis.hlines(height, *interval, color=color, lw=1.2, zorder=3)
        if spread is not None and spread.mean > 0.0:
            axis.plot(spread.mean, height, "o", ms=5.5, color=color, zorder=4)
        if cell is not None and cell.count(Outcome.DIVERGED):
            axis.plot(
                0.985,
                height,
                "x",
                color=color,
                transform=axis.get_yaxis_transform(),
                **CROSS,
            )
    if not any(row.spreads):
        axis.axhspan(place - 0.5, place + 0.5, color=UNSCORED, zorder=0)


def _diverged(one: ExperimentComparison) -> bool:
    return any(cell is not None and cell.count(Outcome.DIVERGED) for cell in one.cells)


def _overview_legend(
    figure: Figure,
    axis: Axes,
    labels: Sequence[str],
    rows: Sequence[ExperimentComparison],
    *,
    has_published: bool,
) -> None:
    for index, label in enumerate(labels):
        axis.plot([], [], "o", color=OURS[index % len(OURS)], ms=5.5, label=label)
    if has_published:
        for title, marker in zip(
            PUBLISHED_ENGINES.values(), ENGINE_MARKERS, strict=True
        ):
            axis.plot([], [], marker, label=f"{title}, paper", **HOLLOW)
    axis.fill_between(
        [],
        [],
        fc=UNSCORED,
        ec="#c4c4c4",
        label="no score: no reference of this kind, or not run",
    )
    if any(map(_diverged, rows)):
        axis.plot([], [], "x", color=REAL, label="diverged, at the right edge", **CROSS)
    columns = 4 if max(map(len, labels), default=0) < LONG_LABEL else 3
    figure.legend(loc="outside lower left", ncols=columns, fontsize=8, frameon=False)
