"""Engines side by side: the page of a comparison, and its rows."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from typing import Any

from gauge_envs.errors import UnknownNameError
from gauge_envs.files import json_ready
from gauge_envs.pages.document import Document, Paragraph
from gauge_envs.pages.results import SCORE_METRICS
from gauge_envs.pages.table import Table
from gauge_envs.pages.text import QUESTIONS
from gauge_envs.references.kind import Kind
from gauge_envs.tools.compare.comparison import Cell, Comparison
from gauge_envs.tools.compare.grades import GradeComparison, GradeScore
from gauge_envs.tools.compare.rank_tables import rank_tables
from gauge_envs.tools.compare.score_tables import score_table, verification_table
from gauge_envs.tools.compare.summary_tables import distance_table, summary_table

ALL_METRICS = tuple(SCORE_METRICS)


def check_metrics(names: Iterable[str]) -> tuple[str, ...]:
    """Return names of metrics without repetition, or all metrics if none is given."""
    chosen = tuple(dict.fromkeys(names))
    for name in chosen:
        if name not in SCORE_METRICS:
            raise UnknownNameError("metric", name, SCORE_METRICS)
    return chosen or ALL_METRICS


def comparison_document(
    comparison: Comparison, metrics: Sequence[str] = ALL_METRICS
) -> Document:
    """Return scores and ranks of each grade, distances without a reference, and a summary.

    Its rows are the scores of each experiment and the ranks of each grade; `record` states which.

    Args:
        comparison: The comparison.
        metrics: Metrics to show.
    """
    rows = comparison_rows(comparison, metrics)
    tables: list[Table] = []
    if validated := _validation_rows(comparison, rows):
        tables.append(score_table(comparison, validated))
    if any(one.is_verified for one in comparison.experiments):
        tables.append(verification_table(comparison))
    for question in QUESTIONS:
        tables += rank_tables(comparison, question)
    if any(
        one.grade == Kind.NONE.value and one.distances for one in comparison.experiments
    ):
        tables.append(distance_table(comparison))
    if rows:
        tables.append(summary_table(comparison))
    records = [{"record": "experiment", **row} for row in rows]
    records += _grade_records(comparison)
    return Document(
        parts=tables or (Paragraph("no results to compare"),),
        rows=records,
        markdown=tables,
    )


def short_tables(comparison: Comparison) -> list[Table]:
    """Return the ranks within each grade, and the score of each experiment that comes first."""
    first: dict[str, dict[str, Any]] = {}
    for row in _validation_rows(comparison, comparison_rows(comparison)):
        first.setdefault(row["id"], row)
    tables = [
        table
        for question in QUESTIONS
        for table in rank_tables(comparison, question, with_experiments=False)
    ]
    if first:
        tables.append(score_table(comparison, [*first.values()]))
    if any(one.is_verified for one in comparison.experiments):
        tables.append(verification_table(comparison))
    return tables


def _validation_rows(
    comparison: Comparison, rows: Sequence[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Return the rows that compare with reality: a law or a solved model has those of events alone."""
    verified = {one.id for one in comparison.experiments if one.is_verified}
    return [
        row
        for row in rows
        if row["id"] not in verified
        or (row["metric"] is not None and SCORE_METRICS[row["metric"]].is_event)
    ]


def comparison_rows(
    comparison: Comparison, metrics: Sequence[str] = ALL_METRICS
) -> list[dict[str, Any]]:
    """Return a JSON-ready object for each experiment and metric.

    An experiment without any of the metrics has one object, whose `metric` is None.
    """
    rows = []
    for one in comparison.experiments:
        names: list[str | None] = [*one.metrics(metrics)] or [None]
        distances = [asdict(far) | comparison.names(far) for far in one.distances]
        for name in names:
            baseline = one.baselines.get(name or "")
            configurations = []
            for label, configuration, cell in zip(
                comparison.labels, comparison.configurations, one.cells, strict=True
            ):
                configured = {"label": label, **asdict(configuration)}
                configurations.append(configured | _cell_row(cell, name))
            rows.append(
                {
                    "id": one.id,
                    "grade": one.grade,
                    "withheld": one.withheld,
                    "metric": name,
                    "unit": name and one.unit_of(name),
                    "real": baseline and {"mean": baseline.mean, "std": baseline.std},
                    "published": name and one.published(name),
                    "configurations": configurations,
                    "distances": distances,
                    "notes": comparison.notes,
                }
            )
    return json_ready(rows)


def _cell_row(cell: Cell | None, metric: str | None) -> dict[str, Any]:
    if cell is None:
        cell = Cell(results=())
    verification = []
    also_verified = []
    for result in cell.results:
        first = result.score.verification
        verification.append(None if first is None else asdict(first))
        also_verified.append([asdict(one) for one in result.score.also_verified])
    ran = [result for result in cell.results if result.error is None]
    return {
        "outcomes": [result.outcome.value for result in cell.results],
        "reasons": [result.error or result.diverged_reason for result in cell.results],
        "seeds": [result.seed for result in cell.results],
        "raw": _spread_row(cell, metric, normalized=False),
        "normalized": _spread_row(cell, metric, normalized=True),
        "normalized_95": metric and cell.interval_95(metric),
        "percentile": metric and cell.percentile(metric),
        "verification": verification,
        "also_verified": also_verified,
        "settings": ran[0].settings if ran else None,
        "versions": ran[0].versions if ran else None,
    }


def _spread_row(
    cell: Cell, metric: str | None, *, normalized: bool
) -> dict[str, Any] | None:
    """Return mean and scatter of a metric over the repeats, with their values."""
    if metric is None:
        return None
    spread = cell.spread(metric, normalized=normalized)
    if spread is None:
        return None
    return asdict(spread) | {"values": cell.values(metric, normalized=normalized)}


def _grade_records(comparison: Comparison) -> Iterator[dict[str, Any]]:
    """Yield the ranks of each grade."""
    for grade in comparison.grades:
        yield {
            "record": "grade",
            "grade": grade.grade,
            "withheld": grade.withheld,
            "constants": grade.constants,
            "ids": grade.ids,
            "configurations": [
                _rank_row(comparison, grade, one) for one in grade.scores
            ],
        }


def _rank_row(
    comparison: Comparison, grade: GradeComparison, score: GradeScore
) -> dict[str, Any]:
    """Return the ranks of a configuration over a grade and in each experiment, with 95 % intervals."""
    ranks = {}
    for experiment in grade.experiments:
        rank = experiment.ranks.get(score.configuration)
        if rank is not None:
            ranks[experiment.id] = {
                "value": rank.value,
                "interval_95": rank.interval_95,
            }
    mean = score.mean_rank
    return {
        "label": comparison.labels[score.configuration],
        "mean_rank": mean and mean.value,
        "mean_rank_95": mean and mean.interval_95,
        "ranks": ranks,
    }
