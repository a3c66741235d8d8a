"""Engines side by side: scores, cost, distances and a summary."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from rich.console import Group, RenderableType
from rich.text import Text

from gauge_envs.analysis.comparison import Cell, Comparison, ExperimentComparison
from gauge_envs.analysis.configuration import RunConfiguration
from gauge_envs.analysis.distance import MOTION_SHARE
from gauge_envs.analysis.scores import COMPARED_METRICS, ComparedMetric
from gauge_envs.files import json_ready
from gauge_envs.references.bands import BandGrade
from gauge_envs.report.results import PLAIN, configuration_labels, configuration_parts, versions_text
from gauge_envs.report.table import Column, Place, Table, as_markdown, as_rich
from gauge_envs.report.text import (
    ALIGNED_TITLE,
    COST_TITLE,
    ENGINE_TITLES,
    GRADE_NOTES,
    METRIC_TITLES,
    NORMALIZED_NOTE,
    plus_minus_text,
    quantity_text,
    score_text,
    short_id,
    shortened,
)
from gauge_envs.runs.result import Outcome

__all__ = ["comparison_markdown", "comparison_rows", "comparison_view"]


def comparison_rows(comparison: Comparison, metrics: Sequence[str] = tuple(COMPARED_METRICS)) -> list[dict[str, Any]]:
    """Return a JSON-ready object for each experiment and metric.

    An experiment without any of the metrics has one object, whose `metric` is None.
    """
    labels = configuration_labels(comparison.configurations)
    rows = []
    for one in comparison.experiments:
        names: list[str | None] = [*one.metrics(metrics)]
        for name in names or [None]:
            metric = COMPARED_METRICS[name] if name else None
            line = one.baselines.get((metric.published if metric else None) or "")
            rows.append(
                {
                    "id": one.id,
                    "grade": one.grade,
                    "metric": name,
                    "unit": _metric_unit(one, metric) if metric else None,
                    "real": None if line is None else {"mean": line.mean, "std": line.std},
                    "published": None if line is None else dict(line.engines),
                    "configurations": [
                        _configuration_row(label, configuration, cell, metric)
                        for label, configuration, cell in zip(labels, comparison.configurations, one.cells, strict=True)
                    ],
                    "distances": [
                        dataclasses.asdict(far) | {"first": labels[far.first], "second": labels[far.second]}
                        for far in one.distances
                    ],
                    "notes": list(comparison.notes),
                }
            )
    return json_ready(rows)


def _configuration_row(
    label: str, configuration: RunConfiguration, cell: Cell | None, metric: ComparedMetric | None
) -> dict[str, Any]:
    ran = [] if cell is None else [result for result in cell.results if result.error is None]
    return {
        "label": label,
        **dataclasses.asdict(configuration),
        "outcomes": [] if cell is None else [result.outcome.value for result in cell.results],
        "reasons": [] if cell is None else [result.error or result.diverged_reason for result in cell.results],
        "seeds": [] if cell is None else [result.seed for result in cell.results],
        "raw": _spread_row(cell, metric, normalized=False),
        "normalized": _spread_row(cell, metric, normalized=True),
        "wall_s_per_sim_s": None if cell is None else cell.wall_s_per_sim_s,
        "settings": ran[0].settings if ran else None,
        "versions": ran[0].versions if ran else None,
    }


def _spread_row(cell: Cell | None, metric: ComparedMetric | None, *, normalized: bool) -> dict[str, Any] | None:
    spread = None if cell is None or metric is None else cell.spread(metric, normalized=normalized)
    if cell is None or metric is None or spread is None:
        return None
    return dataclasses.asdict(spread) | {"values": cell.values(metric, normalized=normalized)}


def comparison_view(
    comparison: Comparison, metrics: Sequence[str] = tuple(COMPARED_METRICS), *, wide: bool = False
) -> RenderableType:
    """Return scores, distances between engines and a summary, for a terminal."""
    if not comparison.experiments:
        return Text("no results to compare")
    return Group(*(as_rich(table, wide=wide) for table in comparison_tables(comparison, metrics)))


def comparison_markdown(comparison: Comparison, metrics: Sequence[str] = tuple(COMPARED_METRICS)) -> str:
    """Return the same tables as GitHub Markdown."""
    tables = comparison_tables(comparison, metrics) if comparison.experiments else []
    return "\n".join(map(as_markdown, tables)).rstrip() + "\n"


def comparison_tables(comparison: Comparison, metrics: Sequence[str] = tuple(COMPARED_METRICS)) -> list[Table]:
    """Return the tables of scores, cost, distances between engines without a reference, and the summary."""
    rows = comparison_rows(comparison, metrics)
    labels = configuration_labels(comparison.configurations)
    unscored = [one for one in comparison.experiments if one.grade == BandGrade.NONE.value and one.distances]
    return [
        _score_table(comparison, rows, labels),
        _cost_table(rows, labels),
        *([_distance_table(unscored, labels)] if unscored else []),
        _summary_table(comparison, labels),
    ]


EXPERIMENT = Column("id", "experiment", short_id, place=Place.HEADING)


def _score_table(comparison: Comparison, rows: Sequence[dict[str, Any]], labels: Sequence[str]) -> Table:
    baselines = {one.id: one.baselines for one in comparison.experiments}

    def real_text(row: Mapping[str, Any]) -> str:
        if row["metric"] == "el":
            return "0 is ideal"
        line = baselines[row["id"]].get({"rmse_aligned": "rmse"}.get(row["metric"], row["metric"]))
        return "-" if line is None else plus_minus_text(line.mean, line.std, line.unit)

    scores = [
        Column("", label, partial(_score_cell, index), is_number=True, style=partial(_score_style, index))
        for index, label in enumerate(labels)
    ]
    scores += [
        Column(f"published.{engine}", f"{title}, paper", score_text, is_number=True)
        for engine, title in ENGINE_TITLES.items()
    ]
    return Table(
        title="Scores over the mean score of the real trials",
        columns=(
            EXPERIMENT,
            Column("grade", "grade", place=Place.HEADING),
            Column("metric", "metric", lambda name: METRIC_TITLES.get(name, ALIGNED_TITLE)),
            Column("", "1 = real trials", real_text, is_number=True, wide_only=True),
            *scores,
        ),
        rows=rows,
        notes=_score_notes(comparison, rows, [column.text(row) for column in scores for row in rows]),
    )


def _cost_table(rows: Sequence[dict[str, Any]], labels: Sequence[str]) -> Table:
    costs = {
        row["id"]: {"id": row["id"]}
        | {str(index): one["wall_s_per_sim_s"] for index, one in enumerate(row["configurations"])}
        for row in rows
    }
    costs_of = (Column(str(index), label, _cost_text, is_number=True) for index, label in enumerate(labels))
    columns = (Column("id", "experiment", short_id), *costs_of)
    return Table(title=f"Cost, {COST_TITLE}", columns=columns, rows=list(costs.values()), wide_only=True)


def _metric_unit(one: ExperimentComparison, metric: ComparedMetric) -> str:
    return one.unit if metric.unit is None else metric.unit


def _score_cell(index: int, row: Mapping[str, Any]) -> str:
    """Return mean and scatter of a configuration's repeats, or why it has no score."""
    one = row["configurations"][index]
    outcomes = one["outcomes"]
    if not outcomes:
        return "-"
    texts = []
    # A score without a baseline to divide by stands in its own unit.
    if spread := one["normalized"] or one["raw"]:
        unit = "" if one["normalized"] or row["unit"] == "1" else f" {row['unit']}"
        count = "" if spread["std"] is None else f" ({spread['count']})"
        texts.append(_spread_text(spread, score_text) + count + unit)
    for outcome in (Outcome.DIVERGED, Outcome.FAILED, Outcome.DECLINED):
        if count := outcomes.count(outcome.value):
            texts.append(outcome.value if count == len(outcomes) else f"{count} {outcome.value}")
    return ", ".join(texts) or "no score"


def _score_style(index: int, row: Mapping[str, Any]) -> str:
    return "red" if Outcome.DIVERGED.value in row["configurations"][index]["outcomes"] else ""


def _spread_text(spread: Mapping[str, Any], text: Callable[[float], str]) -> str:
    """Return the mean of repeats; of several, with their standard deviation."""
    scatter = "" if spread["std"] is None else f" +- {text(spread['std'])}"
    return f"{text(spread['mean'])}{scatter}"


def _cost_text(value: float) -> str:
    return f"{value:.2g}" if value < 10.0 else f"{value:.0f}"


CELL_NOTES = {
    "-": "-: not run, or not published",
    "no score": "no score: it ran, but there is no reference, or the measured event did not happen",
    "diverged": "diverged: the simulation left what is physically possible, so it has no score",
    "declined": "declined: the engine cannot build the scene",
    "failed": "failed: the episode ended in an error",
}


def _score_notes(comparison: Comparison, rows: Sequence[dict[str, Any]], used: Sequence[str]) -> tuple[str, ...]:
    """Return what the table of scores needs to be read: only what occurs in it is explained."""
    meanings = [
        text
        for word, text in CELL_NOTES.items()
        if any(word == cell or (word != "-" and word in cell) for cell in used)
    ]
    notes = [NORMALIZED_NOTE]
    notes += [f"{'; '.join(meanings)}."] if meanings else []
    if any("+-" in cell for cell in used):
        notes.append("Repeats, which differ in their seed alone: mean +- sample standard deviation (how many).")
    if any(row["metric"] == "rmse_aligned" for row in rows):
        notes.append(f"{ALIGNED_TITLE}: RMSE after the constant time shift that fits best.")
    grades = sorted({one.grade for one in comparison.experiments})
    notes.append(f"Grades: {'; '.join(f'{grade}: {GRADE_NOTES[BandGrade(grade)]}' for grade in grades)}.")
    return (*notes, *_configuration_notes(comparison), *(f"Note: {note}." for note in comparison.notes))


def _configuration_notes(comparison: Comparison) -> list[str]:
    """Return what all configurations share, and the versions of their engines."""
    first, *others = comparison.configurations
    notes = []
    if others:
        exact = [configuration_parts(one, digits=17) for one in others]
        pairs = zip(configuration_parts(first, digits=17), configuration_parts(first), strict=True)
        shared = [text for part, (_, text) in pairs if all(part in parts for parts in exact)]
        notes += [f"All configurations: {', '.join(shared)}."] if shared else []
        notes += ["Parameters are calibrated unless stated."] if PLAIN[1] not in shared else []
    engines = dict.fromkeys(
        f"{one.backend or 'file'}: {versions_text(one) or '-'}" for one in comparison.configurations
    )
    notes.append(f"Versions: {'; '.join(engines)}.")
    if not others:
        notes.append("One configuration: there is nothing to compare it with but the published scores.")
    return notes


def _distance_table(experiments: Sequence[ExperimentComparison], labels: Sequence[str]) -> Table:
    rows = [
        dataclasses.asdict(far) | {"id": one.id, "between": f"{labels[far.first]} : {labels[far.second]}"}
        for one in experiments
        for far in one.distances
    ]

    def threshold_text(row: Mapping[str, Any]) -> str:
        return f"{quantity_text(row['threshold'])} {row['unit']}{'' if row['threshold_is_scatter'] else ' *'}"

    share = (
        ""
        if all(row["threshold_is_scatter"] for row in rows)
        else f" * not published: {MOTION_SHARE:.0%} of the motion."
    )
    return Table(
        title="Where engines disagree: no reference, so distances between them",
        columns=(
            EXPERIMENT,
            Column("between", "between"),
            Column(
                "", "distance", lambda row: f"{_spread_text(row['rms'], quantity_text)} {row['unit']}", is_number=True
            ),
            Column("", "motion", lambda row: f"{quantity_text(row['motion_rms'])} {row['unit']}", is_number=True),
            Column("", "threshold", threshold_text, is_number=True),
            Column("", "first exceeded", _exceeded_text, is_number=True),
        ),
        rows=rows,
        notes=(
            "Distance: Euclidean over all coordinates at a frame, root mean square over the frames that both have. "
            "Motion: the same of the displacement from the start. Neither says which engine is right.",
            "Threshold: published mean RMSE of the real trials, which is the distance of a typical one from their "
            f"mean.{share}",
        ),
    )


def _exceeded_text(row: Mapping[str, Any]) -> str:
    ending = ", diverged" if row["diverged"] else ""
    return ("never" if row["apart_at_s"] is None else f"{row['apart_at_s']:.2f} s") + ending


def _summary_table(comparison: Comparison, labels: Sequence[str]) -> Table:
    rows = [
        {"label": label} | dataclasses.asdict(one) for label, one in zip(labels, comparison.summaries(), strict=True)
    ]
    rows += [
        {"label": f"{title}, paper", "geometric_mean": mean}
        for engine, title in ENGINE_TITLES.items()
        if (mean := comparison.published_geometric_mean(engine)) is not None
    ]
    names = [one.name for one in comparison.scored_by_all]
    over = f"over the {len(names)} that all have scored ({shortened(names)})" if names else "none is scored by all"
    counts = {"ran": "ran", "scored": "scored", "diverged": "diverged", "not_run": "not run"}
    return Table(
        title="Summary",
        columns=(
            Column("label", "configuration"),
            *(Column(key, title, is_number=True) for key, title in counts.items()),
            Column("geometric_mean", "geometric mean", score_text, is_number=True),
            Column("wall_s_per_sim_s", COST_TITLE, _cost_text, is_number=True),
            Column("wall_s_per_sim_s_common", "in common", _cost_text, is_number=True),
        ),
        rows=rows,
        notes=(
            f"Geometric mean of the normalized RMSE, {over}. It is descriptive and ranks nothing: experiments differ "
            "in difficulty and in the quality of their reference, the variants of one family are not independent, and "
            "release timing is in it.",
            f"{COST_TITLE}: wall time of reset and steps over simulated time, without the time to build the scene; "
            f"repeats that ran together share it; in common: over the {len(comparison.run_by_all)} that all ran. "
            "Comparable only on one machine.",
        ),
    )
