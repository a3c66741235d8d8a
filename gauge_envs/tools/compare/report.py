"""Report a comparison: the answer, tables of scores, ranks and distances, and JSON rows."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from itertools import chain
from typing import Any

from gauge_envs.errors import UnknownNameError
from gauge_envs.files import json_ready
from gauge_envs.pages.document import Document, Paragraph, Part, Tone
from gauge_envs.pages.results import (
    SCORE_METRICS,
    configuration_parts,
    versions_text,
)
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import (
    KIND_NOTES,
    counted,
    interval_text,
    quantity_text,
    score_text,
    with_unit,
)
from gauge_envs.references.kind import Kind
from gauge_envs.references.published import PUBLISHED_ENGINES
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.result import Outcome
from gauge_envs.scoring.score import OVER_U
from gauge_envs.tools.compare.comparison import Cell, Comparison, ExperimentComparison
from gauge_envs.tools.compare.distance import MOTION_SHARE, Distance
from gauge_envs.tools.compare.ranks import NEGLIGIBLE, Mean

ALL_METRICS = tuple(SCORE_METRICS)

NAME = Column("name", "experiment")
REFERENCE = Column("kind", "reference", place=Place.HEADING)

INTERVAL_NOTE = (
    "[low, high]: 95 % interval. +-: standard deviation of repeats (how many). *: outside the scatter of real trials, "
    "or the uncertainty of a solution. -: not run, or not published. no score: no reference scores it, or the measured "
    "event did not happen."
)

SCALE_NOTE = (
    "RMSE and DTW are divided by the mean of real trials; LSD, MTE and PD by the real value. EL: 0 is ideal. "
    "Distances from a solution are divided by u, its standard uncertainty."
)

RANK_NOTE = (
    "All experiments have the same weight. [low, high]: mean of the best and mean of the worst ranks among "
    "configurations with the same constants. Two scores are distinguishable if the 95 % interval of their difference "
    f"excludes differences up to {NEGLIGIBLE}. Errors of the reference cancel in a difference."
)

NO_RANKS = "No ranks: they need two configurations with the same constants and scores of one experiment."

MIN_RANKED = 3
"""Smallest number of experiments whose mean rank the short report shows."""

DISTANCE_NOTE = (
    "Distance between trajectories and displacement from the initial state: root mean squares over common frames. "
    "Neither shows which engine is right. Threshold: published mean RMSE of real trials; "
    f"*: not published, {MOTION_SHARE:.0%} of the motion."
)

PHYSICS = {
    "": "",
    "own defaults": "(its own defaults)",
    "own options": "(its own options)",
    "corrected": "(corrected by this package)",
}
"""Note on the physics of an engine, by `RunConfiguration.physics`."""


def check_metrics(names: Iterable[str]) -> tuple[str, ...]:
    """Return the names of metrics without repetition.

    Raises:
        UnknownNameError: A metric does not exist.
    """
    chosen = tuple(dict.fromkeys(names))
    for name in chosen:
        if name not in SCORE_METRICS:
            raise UnknownNameError("metric", name, SCORE_METRICS)
    return chosen


def comparison_document(
    comparison: Comparison,
    metrics: Sequence[str] = (),
    *,
    is_wide: bool = False,
    with_rows: bool = True,
) -> Document:
    """Return the answer, scores and ranks for each kind of reference, and distances without a reference.

    The rows are the scores of each experiment and the ranks within each kind; `record` names the type of a row.

    Args:
        comparison: The comparison.
        metrics: Metrics to show. Empty means all; a terminal then shows the primary metric of each experiment.
        is_wide: Whether a terminal shows the same as Markdown: all metrics, published engines, and all mean ranks.
        with_rows: Whether the document has JSON rows, which need the distance between each pair of configurations.
    """
    answers = [Paragraph(answer, Tone.ANSWER) for answer in _answers(comparison)]
    distances = distance_tables(comparison.experiments, comparison.labels)
    short: list[Part] = [*answers, *short_tables(comparison, metrics), *distances]
    full: list[Part] = [
        *answers,
        _score_table(comparison, metrics or ALL_METRICS, is_full=True),
        *_mean_rank_tables(comparison),
        *distances,
    ]
    rows: list[dict[str, Any]] = []
    if with_rows:
        scores = comparison_rows(comparison, metrics or ALL_METRICS)
        rows = [{"record": "experiment", **row} for row in scores]
        rows += _kind_rows(comparison)
    return Document(parts=full if is_wide else short, rows=rows, markdown=full)


def short_tables(comparison: Comparison, metrics: Sequence[str] = ()) -> list[Table]:
    """Return the score of each experiment, and mean ranks within kinds of `MIN_RANKED` or more experiments.

    Args:
        comparison: The comparison.
        metrics: Metrics to show; empty for the primary metric of each experiment.
    """
    ranks = _mean_rank_tables(comparison, min_experiments=MIN_RANKED)
    return [_score_table(comparison, metrics), *ranks]


def _answers(comparison: Comparison) -> Iterator[str]:
    """Yield on how many experiments the best configuration is distinguishable, for each set of constants."""
    rankings: dict[str, list[Mapping[int, Mean]]] = {}
    for kind in comparison.kinds:
        ranked = [ranks for ranks in kind.ranks.values() if len(ranks) > 1]
        rankings.setdefault(kind.constants, []).extend(ranked)
    if not any(rankings.values()):
        yield NO_RANKS
    for ranked in filter(None, rankings.values()):
        firsts = Counter(
            comparison.labels[index]
            for ranks in ranked
            for index, rank in ranks.items()
            if rank.interval_95 == (1.0, 1.0)
        )
        labels = [comparison.labels[index] for index in sorted(set(chain(*ranked)))]
        answer = f"{' and '.join(labels)} are not distinguishable"
        if len(labels) > 2:
            answer = f"None of {len(labels)} configurations ranks first"
        shared = len(ranked) - firsts.total()
        answer += f" on {shared} of {counted(len(ranked), 'experiment')}"
        wins = [f"{label} ranks first on {count}" for label, count in firsts.items()]
        yield f"{'; '.join([answer, *wins])}."


# --- JSON ------------------------------------------------------------------------------------------------------------


def comparison_rows(
    comparison: Comparison, metrics: Sequence[str]
) -> list[dict[str, Any]]:
    """Return a JSON-ready object for each experiment and metric.

    An experiment without these metrics has one object with `metric` None.
    """
    labels = comparison.labels
    rows = []
    for experiment in comparison.experiments:
        distances = [
            asdict(distance)
            | {"first": labels[distance.first], "second": labels[distance.second]}
            for distance in experiment.distances
        ]
        names: list[str | None] = [*experiment.metrics(metrics)]
        for metric in names or [None]:
            baseline = experiment.baselines.get(metric or "")
            rows.append(
                {
                    "id": experiment.id,
                    "kind": experiment.kind,
                    "metric": metric,
                    "unit": metric and experiment.unit_of(metric),
                    "real": baseline and {"mean": baseline.mean, "std": baseline.std},
                    "published": metric and experiment.published(metric),
                    "configurations": [
                        {"label": label, **asdict(configuration)}
                        | _cell_row(cell or Cell(results=()), metric)
                        for label, configuration, cell in zip(
                            labels,
                            comparison.configurations,
                            experiment.cells,
                            strict=True,
                        )
                    ],
                    "distances": distances,
                    "notes": comparison.notes,
                }
            )
    return json_ready(rows)


def _cell_row(cell: Cell, metric: str | None) -> dict[str, Any]:
    ran = next((result for result in cell.results if result.error is None), None)
    return {
        "outcomes": [result.outcome.value for result in cell.results],
        "reasons": [
            result.error or result.diverged_reason or result.score.refused
            for result in cell.results
        ],
        "seeds": [result.seed for result in cell.results],
        "raw": _spread_row(cell, metric, normalized=False),
        "normalized": _spread_row(cell, metric, normalized=True),
        "normalized_95": metric and cell.interval_95(metric),
        "percentile": cell.percentile,
        "verdicts": [result.score.verdict for result in cell.results],
        "settings": ran and ran.settings,
        "versions": ran and ran.versions,
    }


def _spread_row(
    cell: Cell, metric: str | None, *, normalized: bool
) -> dict[str, Any] | None:
    """Return mean, scatter and values of a metric over the repeats."""
    spread = metric and cell.spread(metric, normalized=normalized)
    if not metric or not spread:
        return None
    return asdict(spread) | {"values": cell.values(metric, normalized=normalized)}


def _kind_rows(comparison: Comparison) -> Iterator[dict[str, Any]]:
    """Yield the ranks within each kind."""
    for kind in comparison.kinds:
        configurations = []
        for score in kind.scores:
            index, mean = score.configuration, score.mean_rank
            configurations.append(
                {
                    "label": comparison.labels[index],
                    "mean_rank": mean and mean.value,
                    "mean_rank_95": mean and mean.interval_95,
                    "ranks": {
                        name: asdict(ranks[index])
                        for name, ranks in kind.ranks.items()
                        if index in ranks
                    },
                }
            )
        yield {
            "record": "kind",
            "kind": kind.kind,
            "constants": kind.constants,
            "ids": kind.ids,
            "configurations": configurations,
        }


# --- scores ----------------------------------------------------------------------------------------------------------


def score_cell_text(cell: Cell, metric: str, unit: str) -> str:
    """Return the mean of a metric over repeats, for example `0.41 [0.17, 1.43] +- 0.05 (3)`; empty without a score.

    Args:
        cell: Repeats of a configuration.
        metric: A key of `SCORE_METRICS`.
        unit: Unit of a score without normalization.
    """
    spread = cell.spread(metric, normalized=True)
    if spread is not None:
        unit = "u" if metric == OVER_U else "1"
    else:
        spread = cell.spread(metric, normalized=False)
    if spread is None:
        return ""
    text = interval_text(spread.mean, cell.interval_95(metric))
    if spread.std is not None:
        text += f" +- {score_text(spread.std)} ({spread.count})"
    return with_unit(text, unit)


def _score_table(
    comparison: Comparison, metrics: Sequence[str], *, is_full: bool = False
) -> Table:
    """Return a table with a row for each experiment and metric, and a column for each configuration.

    Args:
        comparison: The comparison.
        metrics: Metrics to show; empty for the primary metric of each experiment.
        is_full: Whether to show verdicts in words and published engines as columns.
    """
    kinds = list(Kind)
    rows = []
    for experiment in sorted(
        comparison.experiments,
        key=lambda experiment: kinds.index(Kind(experiment.kind)),
    ):
        names: list[str | None] = [*experiment.shown_metrics(metrics or ALL_METRICS)]
        shown = names if metrics else names[:1]
        rows += [
            _score_row(experiment, name, is_full=is_full) for name in shown or [None]
        ]
    columns = _label_columns(comparison, "scores")
    if is_full:
        columns += [
            Column(f"published.{engine}", f"{title}, paper", score_text, is_number=True)
            for engine, title in PUBLISHED_ENGINES.items()
        ]
    cells = [REFERENCE, NAME]
    if is_full or not all(row["is_primary"] for row in rows):
        cells.append(Column("metric", "metric"))
    return Table(
        title="Scores, with 95 % intervals",
        columns=(*cells, *columns),
        rows=rows,
        notes=tuple(_score_notes(comparison)),
    )


def _score_row(
    experiment: ExperimentComparison, metric: str | None, *, is_full: bool
) -> dict[str, Any]:
    title = "-" if metric is None else SCORE_METRICS[metric].title
    return {
        "kind": f"{experiment.kind}: {KIND_NOTES[Kind(experiment.kind)]}",
        "name": experiment.name,
        "metric": title,
        "is_primary": metric in (experiment.primary, None),
        "scores": [
            _score_text(experiment, cell, metric, is_full) for cell in experiment.cells
        ],
        "published": metric and experiment.published(metric),
    }


def _score_text(
    experiment: ExperimentComparison,
    cell: Cell | None,
    metric: str | None,
    is_full: bool,
) -> str:
    """Return the score of a configuration, or the reason for a missing score."""
    if cell is None:
        return "-"
    parts = (
        [score_cell_text(cell, metric, experiment.unit_of(metric))] if metric else []
    )
    for outcome in (Outcome.DIVERGED, Outcome.FAILED, Outcome.UNSUPPORTED):
        count = cell.count(outcome)
        is_all = count == len(cell.results)
        parts.append(f"{'' if is_all else f'{count} '}{outcome}" if count else "")
    text = ", ".join(filter(None, parts))
    if metric not in (experiment.primary, None) or cell.verdict in ("", "no reference"):
        return text or "no score"
    if is_full or not text:
        return f"{text} {cell.verdict}".strip()
    return f"{text} *" if "outside" in cell.verdict else text


def _label_columns(comparison: Comparison, key: str) -> list[Column]:
    """Return a column for each configuration; each row has a list of texts under `key`."""
    return [
        Column(f"{key}.{index}", label, is_number=True)
        for index, label in enumerate(comparison.labels)
    ]


def _score_notes(comparison: Comparison) -> Iterator[str]:
    """Yield the notes of the table of scores."""
    yield SCALE_NOTE
    yield INTERVAL_NOTE
    yield from _configuration_notes(comparison.configurations)
    yield from (f"Note: {note}." for note in comparison.notes)


def _configuration_notes(configurations: Sequence[RunConfiguration]) -> Iterator[str]:
    """Yield the common parts of all configurations, and the versions and physics of the engines."""
    exact = [
        configuration_parts(configuration, digits=17)
        for configuration in configurations
    ]
    if len(exact) > 1:
        shared = [
            text
            for part, (_, text) in zip(
                exact[0], configuration_parts(configurations[0]), strict=True
            )
            if all(part in parts for parts in exact)
        ]
        if shared:
            yield f"All configurations: {', '.join(shared)}."
    engines = dict.fromkeys(
        f"{versions_text(item) or item.backend or 'file'} {PHYSICS[item.physics]}".strip()
        for item in configurations
    )
    yield f"Engines: {'; '.join(engines)}."


# --- ranks and distances ----------------------------------------------------------------------------------------------


def _mean_rank_tables(
    comparison: Comparison, *, min_experiments: int = 1
) -> list[Table]:
    """Return the table of mean ranks within each kind of reference; empty without ranks."""
    rows = [
        {
            "kind": f"{kind.name}, {counted(len(kind.ids), 'experiment')}",
            "label": comparison.labels[score.configuration],
            "mean_rank": score.mean_rank,
        }
        for kind in comparison.kinds
        if len(kind.ids) >= min_experiments
        for score in kind.ranked
        if len(kind.scores) > 1 and score.mean_rank is not None
    ]
    rank = Column("mean_rank", "mean rank", mean_rank_text, is_number=True)
    return _unless_empty(
        title="Mean rank within each kind of reference",
        columns=(REFERENCE, Column("label", "configuration"), rank),
        rows=rows,
        notes=(RANK_NOTE,),
    )


def _unless_empty(**content: Any) -> list[Table]:
    """Return a table of this content; empty without rows."""
    return [Table(**content)] if content["rows"] else []


def mean_rank_text(mean: Mean) -> str:
    """Return a mean rank with its interval."""
    return interval_text(mean.value, mean.interval_95, lambda rank: f"{rank:.1f}")


def distance_tables(
    experiments: Iterable[ExperimentComparison], labels: Sequence[str]
) -> list[Table]:
    """Return the table of distances between engines in experiments without a reference; empty without distances."""
    rows = [
        {
            "name": experiment.name,
            "between": f"{labels[distance.first]} : {labels[distance.second]}",
            **_distance_texts(distance),
        }
        for experiment in experiments
        if experiment.kind == Kind.NONE
        for distance in experiment.distances
    ]
    titles = ("distance", "motion", "threshold", "first exceeded")
    numbers = (Column(title, title, is_number=True) for title in titles)
    return _unless_empty(
        title="Distances between engines, without a reference",
        columns=(NAME, Column("between", "between"), *numbers),
        rows=rows,
        notes=(DISTANCE_NOTE,),
    )


def _distance_texts(distance: Distance) -> dict[str, str]:
    texts = {
        "distance": quantity_text(distance.rms.mean),
        "motion": f"{quantity_text(distance.motion_rms)} {distance.unit}",
        "threshold": f"{quantity_text(distance.threshold)} {distance.unit}",
        "first exceeded": "never",
    }
    if distance.rms.std is not None:
        texts["distance"] += f" +- {quantity_text(distance.rms.std)}"
    texts["distance"] += f" {distance.unit}"
    if not distance.threshold_is_scatter:
        texts["threshold"] += " *"
    if distance.apart_at_s is not None:
        texts["first exceeded"] = f"{distance.apart_at_s:.2f} s"
    if distance.diverged:
        texts["first exceeded"] += ", diverged"
    return texts
