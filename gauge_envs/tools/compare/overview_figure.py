"""Draw all experiments of a comparison in one figure (needs matplotlib)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gauge_envs.pages.figures import OURS, REAL, new_figure, save_png, tidy_axis
from gauge_envs.pages.results import SCORE_METRICS
from gauge_envs.references.published import PUBLISHED_ENGINES
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.scoring.answers import MATTERING_SHARE
from gauge_envs.scoring.score import FROM_SOLUTION
from gauge_envs.tools.compare.comparison import (
    ExperimentComparison,
    ScoreComparison,
    compare,
)
from gauge_envs.tools.compare.experiment_figure import save_figures

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


OVERVIEW = "overview"
"""Name of the picture of all experiments."""

PRIMARY = "primary"
"""Panel of the primary scores, compared with real trials."""
PRIMARY_TITLE = "primary score"

MARKERS = dict(zip(PUBLISHED_ENGINES, "s^D", strict=True))
PUBLISHED_STYLE: dict[str, Any] = {"mfc": "none", "mec": "#707070", "ls": ""}
CROSS: dict[str, Any] = {"marker": "x", "mew": 1.8, "ls": ""}


def save_comparison(
    results: Sequence[Result], folder: Path, *, metric: str | None = None
) -> Iterator[Path]:
    """Write the pictures of `save_figures`, and `overview.png` with all scored experiments.

    Args:
        results: Results of any experiments and configurations.
        folder: Folder of the pictures, created if it does not exist.
        metric: Metric of the overview, as in `draw_overview`.

    Yields:
        Path of each picture, as soon as it is written.
    """
    yield from save_figures(results, folder)
    overview = draw_overview(compare(results), metric=metric)
    if overview is not None:
        yield save_png(overview, folder / f"{OVERVIEW}.png")


def draw_overview(
    comparison: ScoreComparison, *, metric: str | None = None
) -> Figure | None:
    """Draw the normalized score of every experiment as a dot with its 95 % interval.

    Configurations are in colour. Published engines are in grey, with the raw scores of kind `trials`: only these have
    the same reference. Distances from solutions have a separate panel.

    Args:
        comparison: Result of `gauge_envs.tools.compare.comparison.compare`.
        metric: A key of `pages.results.SCORE_METRICS`. None draws the primary score and the raw RMSE for real trials,
            and the distances from solutions.

    Returns:
        The picture; None if no experiment has a score of this metric.
    """
    panels = [PRIMARY, "rmse", FROM_SOLUTION]
    if metric is not None:
        panels = [metric]
    experiments = []
    shown = set()
    for experiment in comparison.experiments:
        scored = [panel for panel in panels if _has_score(experiment, panel)]
        diverged = [cell.count(Outcome.DIVERGED) for _, cell in experiment.present]
        if scored or any(diverged):
            experiments.append(experiment)
            shown.update(scored)
    if not shown:
        return None
    width_in, height_in = max(10.0, 4.0 * len(shown)), 0.3 * len(experiments) + 2.2
    figure = new_figure(width_in, height_in)
    axes = figure.subplots(1, len(shown), sharey=True, squeeze=False)[0]
    ordered = [panel for panel in panels if panel in shown]
    for axis, panel in zip(axes, ordered, strict=True):
        _draw_panel(axis, experiments, panel)
    names = [f"{experiment.name}  ({experiment.kind})" for experiment in experiments]
    axes[0].set_yticks(range(len(names)), names, fontsize=8)
    axes[0].set_ylim(len(names) - 0.5, -0.5)
    _add_legend(figure, axes[-1], comparison.labels)
    return figure


def _metric_of(experiment: ExperimentComparison, panel: str) -> str | None:
    """Return the metric that a panel shows for an experiment; None for a solution in the panel of real trials."""
    if panel != PRIMARY:
        return panel
    if experiment.is_solution:
        return None
    return experiment.primary


def _published(experiment: ExperimentComparison, panel: str) -> dict[str, float]:
    """Return the published scores of a panel by engine, without zeros: the axis is logarithmic."""
    if panel == PRIMARY or not SCORE_METRICS[panel].is_normalized:
        return {}
    published = experiment.published(panel) or {}
    return {engine: value for engine, value in published.items() if value}


def _has_score(experiment: ExperimentComparison, panel: str) -> bool:
    metric = _metric_of(experiment, panel)
    if metric is not None:
        for _, cell in experiment.present:
            if cell.spread(metric, normalized=True) is not None:
                return True
    return bool(_published(experiment, panel))


def _draw_panel(
    axis: Axes, experiments: Sequence[ExperimentComparison], panel: str
) -> None:
    # A logarithmic axis has no 0: an interval that ends at 0 extends to the edge.
    axis.set_xscale("log", nonpositive="clip")
    axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    line, label = _scale_of(panel)
    axis.axvline(line, color=REAL, lw=1.2, ls="--", zorder=1)
    axis.set_xlabel(label, fontsize=9)
    for place, experiment in enumerate(experiments):
        for engine, value in _published(experiment, panel).items():
            axis.plot(value, place, MARKERS[engine], **PUBLISHED_STYLE)
        _draw_scores(axis, place, experiment, _metric_of(experiment, panel))
    title = PRIMARY_TITLE
    if panel != PRIMARY:
        title = SCORE_METRICS[panel].title
    title = f"{title[0].upper()}{title[1:]}"
    axis.set_title(title, loc="left", fontsize=12, fontweight="bold")
    tidy_axis(axis)
    axis.tick_params(axis="y", length=0)


def _scale_of(panel: str) -> tuple[float, str]:
    """Return the score of a motion at its limit or of a real trial, and the label of the axis."""
    if panel == FROM_SOLUTION:
        limit = f"a difference of {MATTERING_SHARE:g} matters; bars: 95 %"
        return MATTERING_SHARE, f"divided by the motion, log scale;\n{limit}"
    ideal = "lower is closer"
    if panel in ("lsd", "mte", "pd"):
        ideal = "1 is ideal"
    return 1.0, f"divided by real trials, log scale;\n{ideal}; bars: 95 %"


def _draw_scores(
    axis: Axes, place: int, experiment: ExperimentComparison, metric: str | None
) -> None:
    """Draw the scores of an experiment, one configuration below the other, so that equal scores stay visible."""
    for index, cell in experiment.present:
        color = OURS[index % len(OURS)]
        height = place + 0.5 * ((index + 0.5) / len(experiment.cells) - 0.5)
        if metric is not None:
            interval = cell.interval_95(metric)
            if interval is not None:
                axis.hlines(height, *interval, color=color, lw=1.2, zorder=3)
            spread = cell.spread(metric, normalized=True)
            if spread is not None and spread.mean > 0.0:
                axis.plot(spread.mean, height, "o", ms=5.5, color=color, zorder=4)
        if cell.count(Outcome.DIVERGED):
            edge = axis.get_yaxis_transform()
            axis.plot(0.985, height, color=color, transform=edge, **CROSS)


def _add_legend(figure: Figure, axis: Axes, labels: Sequence[str]) -> None:
    for index, label in enumerate(labels):
        axis.plot([], [], "o", color=OURS[index % len(OURS)], label=label)
    for engine, marker in MARKERS.items():
        label = f"{PUBLISHED_ENGINES[engine]}, paper"
        axis.plot([], [], marker, label=label, **PUBLISHED_STYLE)
    axis.plot([], [], color=REAL, label="diverged, at the right edge", **CROSS)
    figure.legend(loc="outside lower left", ncols=3, fontsize=8, frameon=False)
