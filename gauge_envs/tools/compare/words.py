"""Engines side by side: the page of a comparison, and its rows."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from typing import Any

from gauge_envs.errors import UnknownNameError
from gauge_envs.files import json_ready
from gauge_envs.pages.document import Document, Paragraph
from gauge_envs.pages.results import SCORE_METRICS
from gauge_envs.pages.table import Table
from gauge_envs.scoring.score import OVER_U
from gauge_envs.tools.compare.comparison import Cell, Comparison
from gauge_envs.tools.compare.ranks import KindComparison, KindScore
from gauge_envs.tools.compare.tables import (
    distance_table,
    rank_tables,
    score_table,
    summary_table,
)

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
    """Return scores and ranks within each kind, distances without a reference, and a summary.

    Its rows are the scores of each experiment and the ranks within each kind; `record` states which.

    Args:
        comparison: The comparison.
        metrics: Metrics to show.
    """
    rows = comparison_rows(comparison, metrics)
    tables: list[Table] = []
    if shown := _shown_rows(comparison, rows):
        tables.append(score_table(comparison, shown))
    tables += rank_tables(comparison)
    distances = distance_table(comparison)
    tables += [] if distances is None else [distances]
    if rows:
        tables.append(summary_table(comparison))
    records = [{"record": "experiment", **row} for row in rows]
    records += _kind_records(comparison)
    return Document(
        parts=tables or (Paragraph("no results to compare"),),
        rows=records,
        markdown=tables,
    )


def short_tables(comparison: Comparison) -> list[Table]:
    """Return the ranks within each kind, and the score of each experiment that comes first."""
    first: dict[str, dict[str, Any]] = {}
    for row in _shown_rows(comparison, comparison_rows(comparison)):
        first.setdefault(row["id"], row)
    tables = [*rank_tables(comparison, with_experiments=False)]
    return [*tables, score_table(comparison, [*first.values()])] if first else tables


def _shown_rows(
    comparison: Comparison, rows: Sequence[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Return the rows of the table: RMSE and DTW from a solution have no scale, and its distance says it."""
    solved = {one.id for one in comparison.experiments if one.is_solution}
    return [
        row
        for row in rows
        if row["id"] not in solved
        or row["metric"] == OVER_U
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
                    "kind": one.kind,
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
    ran = [result for result in cell.results if result.error is None]
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


def _kind_records(comparison: Comparison) -> Iterator[dict[str, Any]]:
    """Yield the ranks within each kind."""
    for kind in comparison.kinds:
        yield {
            "record": "kind",
            "kind": kind.kind,
            "constants": kind.constants,
            "ids": kind.ids,
            "configurations": [_rank_row(comparison, kind, one) for one in kind.scores],
        }


def _rank_row(
    comparison: Comparison, kind: KindComparison, score: KindScore
) -> dict[str, Any]:
    """Return the ranks of a configuration over a kind and in each experiment."""
    ranks = {
        one.id: asdict(rank)
        for one in kind.experiments
        if (rank := one.ranks.get(score.configuration)) is not None
    }
    mean = score.mean_rank
    return {
        "label": comparison.labels[score.configuration],
        "mean_rank": mean and mean.value,
        "mean_rank_95": mean and mean.interval_95,
        "ranks": ranks,
    }
