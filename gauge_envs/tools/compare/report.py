"""Report of a comparison: tables of scores, ranks and distances, and JSON rows."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from typing import Any

from gauge_envs.errors import UnknownNameError
from gauge_envs.files import json_ready
from gauge_envs.pages.document import Document, Paragraph
from gauge_envs.pages.results import (
    PLAIN,
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
    short_id,
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
    "[low, high]: 95 % interval. *: outside the scatter of real trials, or of what a "
    "solution leaves open."
)

SCALE_NOTE = (
    "Scores are over the mean of real trials (RMSE, DTW), over the real value (LSD, MTE, PD), or over u, the standard "
    "uncertainty of a solution. EL: 0 is ideal."
)

RANK_NOTE = (
    "Best to worst rank among configurations with the same constants. Two rank apart where the 95 % interval of their "
    f"difference excludes differences of at most {NEGLIGIBLE} of the scale. They share the errors of the reference, "
    "which cancel in a difference."
)

MEAN_RANK_NOTE = "Each experiment counts the same. [low, high]: mean of the best and of the worst ranks."

DISTANCE_NOTE = (
    "Root mean square over common frames of the Euclidean distance over all coordinates, and of the displacement from "
    "the start. Neither shows which engine is right. Threshold: published mean RMSE of real trials; "
    f"*: not published, {MOTION_SHARE:.0%} of the motion."
)

PHYSICS = {
    "": "",
    "own defaults": "(its own defaults)",
    "own options": "(its own options)",
    "corrected": "(corrected by this package)",
}
"""Whose physics an engine shows, by `RunConfiguration.physics`."""

CELL_NOTES = {
    "-": "-: not run, or not published",
    "no score": "no score: no reference scores it, or the measured event did not happen",
    "diverged": "diverged: the simulation left the physical bounds of the scene",
    "declined": "declined: the engine cannot build the scene",
    "failed": "failed: the episode ended in an error",
    "+-": "+-: standard deviation of repeats (how many)",
}


def check_metrics(names: Iterable[str]) -> tuple[str, ...]:
    """Return names of metrics without repetition, or all metrics if none is given."""
    chosen = tuple(dict.fromkeys(names))
    for name in chosen:
        if name not in SCORE_METRICS:
            raise UnknownNameError("metric", name, SCORE_METRICS)
    return chosen or ALL_METRICS


def comparison_document(
    comparison: Comparison,
    metrics: Sequence[str] = ALL_METRICS,
    *,
    is_wide: bool = False,
    with_rows: bool = True,
) -> Document:
    """Return scores and ranks within each kind of reference, and distances without a reference.

    Its rows are the scores of each experiment and the ranks within each kind; `record` states which.

    Args:
        comparison: The comparison.
        metrics: Metrics to show. Of all metrics a terminal shows the primary one of each experiment.
        is_wide: Whether a terminal shows what Markdown has: all metrics, published engines, and ranks in each
            experiment.
        with_rows: Whether the document has JSON rows, which need the distance between each two configurations.
    """
    if not comparison.experiments:
        return Document(parts=(Paragraph("no results to compare"),), rows=[])
    ranking = _mean_rank_tables(comparison)
    distances = distance_tables(comparison.experiments, comparison.labels)
    chosen = None if metrics == ALL_METRICS else metrics
    short = [_score_table(comparison, chosen), *ranking, *distances]
    full = [
        _score_table(comparison, metrics, is_full=True),
        *_rank_tables(comparison),
        *ranking,
        *distances,
    ]
    rows: list[dict[str, Any]] = []
    if with_rows:
        scores = comparison_rows(comparison, metrics)
        rows = [{"record": "experiment", **row} for row in scores]
        rows += _kind_rows(comparison)
    return Document(parts=full if is_wide else short, rows=rows, markdown=full)


def short_tables(comparison: Comparison) -> list[Table]:
    """Return the primary score of each experiment, and the ranks within each kind."""
    if not comparison.experiments:
        return []
    return [_score_table(comparison, None), *_mean_rank_tables(comparison)]


# --- JSON ------------------------------------------------------------------------------------------------------------


def comparison_rows(
    comparison: Comparison, metrics: Sequence[str] = ALL_METRICS
) -> list[dict[str, Any]]:
    """Return a JSON-ready object for each experiment and metric.

    An experiment without any of the metrics has one object, whose `metric` is None.
    """
    labels = comparison.labels
    rows = []
    for one in comparison.experiments:
        distances = [
            asdict(far) | {"first": labels[far.first], "second": labels[far.second]}
            for far in one.distances
        ]
        names: list[str | None] = [*one.metrics(metrics)]
        for metric in names or [None]:
            baseline = one.baselines.get(metric or "")
            rows.append(
                {
                    "id": one.id,
                    "kind": one.kind,
                    "metric": metric,
                    "unit": metric and one.unit_of(metric),
                    "real": baseline and {"mean": baseline.mean, "std": baseline.std},
                    "published": metric and one.published(metric),
                    "configurations": [
                        {"label": label, **asdict(configuration)}
                        | _cell_row(cell or Cell(results=()), metric)
                        for label, configuration, cell in zip(
                            labels, comparison.configurations, one.cells, strict=True
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
            one.error or one.diverged_reason or one.score.refused
            for one in cell.results
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
    """Return mean and scatter of a metric over the repeats, with their values."""
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
    """Return the mean of a metric over repeats, as `0.41 [0.17, 1.43] +- 0.05 (3)`; empty without a score.

    Args:
        cell: Repeats of a configuration.
        metric: A key of `SCORE_METRICS`.
        unit: Unit of a score that has no scale.
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
    comparison: Comparison, metrics: Sequence[str] | None, *, is_full: bool = False
) -> Table:
    """Return a row for each experiment and metric, a column for each configuration.

    Args:
        comparison: The comparison.
        metrics: Metrics to show; None for the primary one of each experiment.
        is_full: Whether verdicts are words, and published engines are columns.
    """
    kinds = list(Kind)
    rows = []
    for one in sorted(
        comparison.experiments, key=lambda one: kinds.index(Kind(one.kind))
    ):
        names: list[str | None] = [
            name for name in one.metrics(metrics or ALL_METRICS) if _is_shown(one, name)
        ]
        shown = names if metrics else names[:1]
        rows += [_score_row(one, name, is_full=is_full) for name in shown or [None]]
    columns = _label_columns(comparison, "scores")
    if is_full:
        columns += [
            Column(f"published.{engine}", f"{title}, paper", score_text, is_number=True)
            for engine, title in PUBLISHED_ENGINES.items()
        ]
    used = {column.text(row) for column in columns for row in rows}
    cells = [REFERENCE, NAME]
    if is_full or not all(row["is_primary"] for row in rows):
        cells.append(Column("metric", "metric"))
    return Table(
        title="Scores, with 95 % intervals",
        columns=(*cells, *columns),
        rows=rows,
        notes=tuple(_score_notes(comparison, used)),
    )


def _is_shown(one: ExperimentComparison, metric: str) -> bool:
    """Return whether a table shows a metric: RMSE and DTW from a solution have no scale, and its distance says it."""
    return not one.is_solution or metric == OVER_U or SCORE_METRICS[metric].is_event


def _score_row(
    one: ExperimentComparison, metric: str | None, *, is_full: bool
) -> dict[str, Any]:
    title = "-" if metric is None else SCORE_METRICS[metric].title
    return {
        "kind": f"{one.kind}: {KIND_NOTES[Kind(one.kind)]}",
        "name": one.name,
        "metric": title,
        "is_primary": metric in (one.primary, None),
        "scores": [_score_text(one, cell, metric, is_full) for cell in one.cells],
        "published": metric and one.published(metric),
    }


def _score_text(
    one: ExperimentComparison, cell: Cell | None, metric: str | None, is_full: bool
) -> str:
    """Return the score of a configuration, or why it has none."""
    if cell is None:
        return "-"
    parts = [score_cell_text(cell, metric, one.unit_of(metric))] if metric else []
    for outcome in (Outcome.DIVERGED, Outcome.FAILED, Outcome.DECLINED):
        count = cell.count(outcome)
        is_all = count == len(cell.results)
        parts.append(f"{'' if is_all else f'{count} '}{outcome}" if count else "")
    text = ", ".join(filter(None, parts))
    if metric not in (one.primary, None) or cell.verdict in ("", "no reference"):
        return text or "no score"
    if is_full or not text:
        return f"{text} {cell.verdict}".strip()
    return f"{text} *" if "outside" in cell.verdict else text


def _label_columns(comparison: Comparison, key: str) -> list[Column]:
    """Return a column for each configuration, of a list of texts in each row."""
    return [
        Column(
            f"{key}.{index}",
            label,
            is_number=True,
            style=lambda text: "red" if "diverged" in text else "",
        )
        for index, label in enumerate(comparison.labels)
    ]


def _score_notes(comparison: Comparison, used: Iterable[str]) -> Iterator[str]:
    """Yield what one needs to read the table of scores: only what occurs in it is explained."""
    yield SCALE_NOTE
    yield INTERVAL_NOTE
    meanings = [
        meaning
        for word, meaning in CELL_NOTES.items()
        if any(text == "-" if word == "-" else word in text for text in used)
    ]
    if meanings:
        yield f"{'; '.join(meanings)}."
    yield from _configuration_notes(comparison.configurations)
    yield from (f"Note: {note}." for note in comparison.notes)


def _configuration_notes(configurations: Sequence[RunConfiguration]) -> Iterator[str]:
    """Yield what all configurations share, and whose physics and which versions they are."""
    exact = [configuration_parts(one, digits=17) for one in configurations]
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
        if PLAIN[1] not in shared:
            yield "Parameters are calibrated unless given."
    engines = dict.fromkeys(
        f"{versions_text(one) or one.backend or 'file'} {PHYSICS[one.physics]}".strip()
        for one in configurations
    )
    yield f"Engines: {'; '.join(engines)}."


# --- ranks and distances ----------------------------------------------------------------------------------------------


def _rank_tables(comparison: Comparison) -> list[Table]:
    """Return the ranks in each experiment; empty without any."""
    rows = [
        {
            "kind": kind.name,
            "name": short_id(name),
            "ranks": [
                rank_text(ranks.get(index)) for index in range(len(comparison.labels))
            ],
        }
        for kind in comparison.kinds
        for name, ranks in kind.ranks.items()
        if len(ranks) > 1
    ]
    if not rows:
        return []
    columns = _label_columns(comparison, "ranks")
    return [
        Table(
            title="Ranks in each experiment",
            columns=(REFERENCE, NAME, *columns),
            rows=rows,
            notes=(RANK_NOTE,),
        )
    ]


def _mean_rank_tables(comparison: Comparison) -> list[Table]:
    """Return the mean ranks within each kind of reference; empty without any."""
    rows = [
        {
            "kind": f"{kind.name}, {counted(len(kind.ids), 'experiment')}",
            "label": comparison.labels[one.configuration],
            "mean_rank": one.mean_rank,
        }
        for kind in comparison.kinds
        for one in kind.ranked
        if len(kind.scores) > 1 and one.mean_rank is not None
    ]
    if not rows:
        return []
    rank = Column("mean_rank", "mean rank", mean_rank_text, is_number=True)
    return [
        Table(
            title="Mean rank within each kind of reference",
            columns=(REFERENCE, Column("label", "configuration"), rank),
            rows=rows,
            notes=(MEAN_RANK_NOTE,),
        )
    ]


def rank_text(rank: Mean | None) -> str:
    """Return the best and the worst rank of a configuration in an experiment."""
    if rank is None:
        return "-"
    low, high = (round(end) for end in rank.interval_95)
    return f"{low}" if low == high else f"{low}-{high}"


def mean_rank_text(mean: Mean) -> str:
    """Return a mean rank with its interval."""
    return interval_text(mean.value, mean.interval_95, lambda rank: f"{rank:.1f}")


def distance_tables(
    experiments: Iterable[ExperimentComparison], labels: Sequence[str]
) -> list[Table]:
    """Return how far engines are from each other in experiments without a reference; empty without such a distance."""
    rows = [
        {
            "name": one.name,
            "between": f"{labels[far.first]} : {labels[far.second]}",
            **_distance_texts(far),
        }
        for one in experiments
        if one.kind == Kind.NONE
        for far in one.distances
    ]
    if not rows:
        return []
    titles = ("distance", "motion", "threshold", "first exceeded")
    numbers = (Column(title, title, is_number=True) for title in titles)
    return [
        Table(
            title="Distances between engines, without a reference",
            columns=(NAME, Column("between", "between"), *numbers),
            rows=rows,
            notes=(DISTANCE_NOTE,),
        )
    ]


def _distance_texts(far: Distance) -> dict[str, str]:
    texts = {
        "distance": quantity_text(far.rms.mean),
        "motion": f"{quantity_text(far.motion_rms)} {far.unit}",
        "threshold": f"{quantity_text(far.threshold)} {far.unit}",
        "first exceeded": "never",
    }
    if far.rms.std is not None:
        texts["distance"] += f" +- {quantity_text(far.rms.std)}"
    texts["distance"] += f" {far.unit}"
    if not far.threshold_is_scatter:
        texts["threshold"] += " *"
    if far.apart_at_s is not None:
        texts["first exceeded"] = f"{far.apart_at_s:.2f} s"
    if far.diverged:
        texts["first exceeded"] += ", diverged"
    return texts
