"""Engines side by side: scores, ranks and pairs within each grade, cost, distances and a summary."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from rich.console import Group, RenderableType
from rich.text import Text

from gauge_envs.files import json_ready
from gauge_envs.pages.results import PLAIN, configuration_labels, configuration_parts, versions_text
from gauge_envs.pages.table import Column, Place, Table, as_markdown, as_rich
from gauge_envs.pages.text import (
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
)
from gauge_envs.references.bands import BandGrade
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.result import Outcome
from gauge_envs.tools.compare.comparison import Cell, Comparison, ExperimentComparison
from gauge_envs.tools.compare.distance import MOTION_SHARE
from gauge_envs.tools.compare.grades import GradeComparison, GradeScore, Mean, PairComparison
from gauge_envs.tools.compare.scores import COMPARED_METRICS, ComparedMetric

Interval = tuple[float, float]


def comparison_json(comparison: Comparison, metrics: Sequence[str] = tuple(COMPARED_METRICS)) -> list[dict[str, Any]]:
    """Return JSON-ready objects: the scores of each experiment, the means of each grade, and all pairs.

    The key `record` states which: `experiment`, `grade` or `pair`.
    """
    labels = configuration_labels(comparison.configurations)
    experiments = comparison_rows(comparison, metrics)
    grades = [_grade_record(grade, labels) for grade in comparison.grades]
    pairs = [_pair_record(grade, pair, labels) for grade in comparison.grades for pair in grade.pairs]
    kinds = (("experiment", experiments), ("grade", grades), ("pair", pairs))
    records: list[dict[str, Any]] = json_ready([{"record": kind, **one} for kind, some in kinds for one in some])
    return records


def _grade_record(grade: GradeComparison, labels: Sequence[str]) -> dict[str, Any]:
    return {
        "grade": grade.grade,
        "withheld": grade.withheld,
        "ids": grade.ids,
        "configurations": [
            {"label": labels[one.configuration], "rank": one.rank}
            | _mean_record("mean", one.mean)
            | _mean_record("interquartile_mean", one.interquartile_mean)
            | _mean_record("geometric_mean", one.geometric_mean)
            | _mean_record("geometric_mean_raw", one.geometric_mean_raw)
            for one in grade.scores
        ],
        "published": grade.published,
    }


def _mean_record(key: str, mean: Mean | None) -> dict[str, Any]:
    value, interval = (None, None) if mean is None else (mean.value, mean.interval_95)
    return {key: value, f"{key}_95": interval}


def _pair_record(grade: GradeComparison, pair: PairComparison, labels: Sequence[str]) -> dict[str, Any]:
    return {
        "first": labels[pair.first],
        "second": labels[pair.second],
        "grade": grade.grade,
        "withheld": grade.withheld,
        "ids": pair.ids,
        "difference": pair.difference,
        "difference_95": pair.difference_95,
        "distinguishable": pair.distinguishable,
        "probability_of_improvement": pair.probability_of_improvement,
        "experiments": [dataclasses.asdict(one) for one in pair.experiments],
    }


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
                    "withheld": one.withheld,
                    "metric": name,
                    "unit": _metric_unit(one, metric) if metric else None,
                    "real": None if line is None else {"mean": line.mean, "std": line.std},
                    "published": None if name is None else one.published(name),
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
        "normalized_95": None if cell is None or metric is None else cell.interval_95(metric),
        "percentile": None if cell is None or metric is None else cell.percentile(metric),
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
    """Return the tables of scores, ranks, pairs, cost, distances without a reference, and the summary."""
    rows = comparison_rows(comparison, metrics)
    labels = configuration_labels(comparison.configurations)
    unscored = [one for one in comparison.experiments if one.grade == BandGrade.NONE.value and one.distances]
    return [
        _score_table(comparison, rows, labels),
        *([_ranking_table(comparison, labels)] if any(grade.ids for grade in comparison.grades) else []),
        *(_pair_tables(comparison, labels) if any(grade.pairs for grade in comparison.grades) else []),
        _cost_table(rows, labels),
        *([_distance_table(unscored, labels)] if unscored else []),
        _summary_table(comparison, labels),
    ]


PERCENTILE = "percentile"
"""Key of the row with the percentage of real trials that are closer to their mean than the primary score."""

TITLES = {**METRIC_TITLES, "rmse_aligned": ALIGNED_TITLE, PERCENTILE: "trials closer"}

EXPERIMENT = Column("id", "experiment", short_id, place=Place.HEADING)


def _grade_text(row: Mapping[str, Any]) -> str:
    return f"{row['grade']}, withheld" if row["withheld"] else str(row["grade"])


GRADE = Column("", "grade", _grade_text, place=Place.HEADING)


def _score_table(comparison: Comparison, rows: Sequence[dict[str, Any]], labels: Sequence[str]) -> Table:
    baselines = {one.id: one.baselines for one in comparison.experiments}

    def real_text(row: Mapping[str, Any]) -> str:
        if row["metric"] == PERCENTILE:
            return "-"
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
    primary = {one.id: one.primary for one in comparison.experiments}
    shown = []
    for row in rows:
        shown.append(row)
        if row["metric"] == primary[row["id"]] and any(one["percentile"] is not None for one in row["configurations"]):
            shown.append(row | {"metric": PERCENTILE, "published": None})
    return Table(
        title="Scores over the mean score of the real trials, with 95 % intervals",
        columns=(
            EXPERIMENT,
            GRADE,
            Column("metric", "metric", lambda name: TITLES.get(name, name)),
            Column("", "1 = real trials", real_text, is_number=True, wide_only=True),
            *scores,
        ),
        rows=shown,
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
    if row["metric"] == PERCENTILE:
        return "-" if one["percentile"] is None else f"{one['percentile']:.0f} %"
    if not outcomes:
        return "-"
    texts = []
    # A score without a baseline to divide by stands in its own unit.
    if spread := one["normalized"] or one["raw"]:
        unit = "" if one["normalized"] or row["unit"] == "1" else f" {row['unit']}"
        interval = _interval_text(one["normalized_95"]) if one["normalized"] and one["normalized_95"] else ""
        scatter = "" if spread["std"] is None else f" +- {score_text(spread['std'])} ({spread['count']})"
        texts.append(score_text(spread["mean"]) + interval + scatter + unit)
    for outcome in (Outcome.DIVERGED, Outcome.FAILED, Outcome.DECLINED):
        if count := outcomes.count(outcome.value):
            texts.append(outcome.value if count == len(outcomes) else f"{count} {outcome.value}")
    return ", ".join(texts) or "no score"


def _score_style(index: int, row: Mapping[str, Any]) -> str:
    return "red" if Outcome.DIVERGED.value in row["configurations"][index]["outcomes"] else ""


def _interval_text(interval: Sequence[float]) -> str:
    """Return ` [low, high]`, to stand behind a value."""
    low, high = interval
    return f" [{score_text(low)}, {score_text(high)}]"


def _spread_text(spread: Mapping[str, Any], text: Callable[[float], str]) -> str:
    """Return the mean of repeats; of several, with their standard deviation."""
    scatter = "" if spread["std"] is None else f" +- {text(spread['std'])}"
    return f"{text(spread['mean'])}{scatter}"


def _cost_text(value: float) -> str:
    return f"{value:.2g}" if value < 10.0 else f"{value:.0f}"


INTERVAL_NOTE = (
    "[low, high]: 95 % interval, from the sample of real trials and the uncertain inputs. Trials closer: share of the "
    "real trials that are closer to their mean, by the metric above it."
)

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
    if any("[" in cell for cell in used):
        notes.append(INTERVAL_NOTE)
    notes += [f"{'; '.join(meanings)}."] if meanings else []
    if any("+-" in cell for cell in used):
        notes.append("Repeats, which differ in their seed alone: mean +- sample standard deviation (how many).")
    if any(row["metric"] == "rmse_aligned" for row in rows):
        notes.append(
            f"{ALIGNED_TITLE}: RMSE after the constant time shift that fits best. It comes first where the experiment "
            "starts with a release."
        )
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


def _ranking_table(comparison: Comparison, labels: Sequence[str]) -> Table:
    rows: list[dict[str, Any]] = []
    for grade in comparison.grades:
        heading = {"grade": f"{grade.name}, {_count_text(grade.ids)}"}
        rows += [
            heading | _ranking_row(labels[one.configuration], one)
            for one in sorted(grade.scores, key=_rank_order)
            if one.mean is not None
        ]
        rows += [
            heading | {"label": f"{ENGINE_TITLES[engine]}, paper", "geometric_mean_raw": score_text(mean)}
            for engine, mean in grade.published.items()
        ]
    return Table(
        title="Ranking within each grade",
        columns=(
            Column("grade", "grade", place=Place.HEADING),
            Column("label", "configuration"),
            Column("rank", "rank", is_number=True),
            Column("mean", "mean", is_number=True),
            Column("geometric_mean_raw", "geometric mean, RMSE", is_number=True),
            Column("interquartile_mean", "IQM", is_number=True),
            Column("geometric_mean", "geometric mean", is_number=True),
        ),
        rows=rows,
        notes=(
            "Rank: 1 + number of configurations with a distinguishably lower mean. Mean, IQM (interquartile mean) and "
            "geometric mean are of the score that is first above; geometric mean, RMSE: of the raw RMSE, as published. "
            "Nothing is averaged across grades.",
        ),
    )


def _ranking_row(label: str, one: GradeScore) -> dict[str, Any]:
    means = {
        "mean": one.mean,
        "interquartile_mean": one.interquartile_mean,
        "geometric_mean": one.geometric_mean,
        "geometric_mean_raw": one.geometric_mean_raw,
    }
    return {"label": label, "rank": one.rank} | {
        key: score_text(mean.value) + _interval_text(mean.interval_95)
        for key, mean in means.items()
        if mean is not None
    }


def _rank_order(one: GradeScore) -> tuple[int, float]:
    return one.rank or 0, 0.0 if one.mean is None else one.mean.value


def _count_text(ids: Sequence[str]) -> str:
    return f"{len(ids)} experiment{'' if len(ids) == 1 else 's'}"


def _verdict_text(distinguishable: bool) -> str:
    return "distinguishable" if distinguishable else "not distinguishable"


def _pair_tables(comparison: Comparison, labels: Sequence[str]) -> tuple[Table, Table]:
    """Return the table of pairs over each grade, and the one over each experiment."""
    pairs = [(grade, pair) for grade in comparison.grades for pair in grade.pairs]
    over_grades = [
        {
            "grade": f"{grade.name}, {_count_text(pair.ids)}",
            "between": f"{labels[pair.first]} : {labels[pair.second]}",
            "difference": score_text(pair.difference) + _interval_text(pair.difference_95),
            "improvement": f"{pair.probability_of_improvement:.0%}",
            "distinguishable": pair.distinguishable,
        }
        for grade, pair in pairs
    ]
    over_experiments = [
        {
            "id": one.id,
            "grade": grade.grade,
            "withheld": grade.withheld,
            "between": f"{labels[pair.first]} : {labels[pair.second]}",
            "difference": score_text(one.difference) + _interval_text(one.difference_95),
            "distinguishable": one.distinguishable,
        }
        for grade, pair in pairs
        for one in pair.experiments
    ]
    order = {one.id: place for place, one in enumerate(comparison.experiments)}
    verdict = Column("distinguishable", "at 95 %", _verdict_text)
    return (
        Table(
            title="Pairs within each grade",
            columns=(
                Column("grade", "grade", place=Place.HEADING),
                Column("between", "first : second"),
                Column("difference", "mean difference", is_number=True),
                Column("improvement", "first closer", is_number=True),
                verdict,
            ),
            rows=over_grades,
            notes=(
                "Paired bootstrap: both have the same resampled real mean and the same drawn inputs. Difference: first "
                "minus second, mean over the experiments; below 0, the first is closer. First closer: probability over "
                "experiments and draws.",
            ),
        ),
        Table(
            title="Pairs in each experiment",
            columns=(
                EXPERIMENT,
                GRADE,
                Column("between", "first : second"),
                Column("difference", "difference", is_number=True),
                verdict,
            ),
            rows=sorted(over_experiments, key=lambda row: order[row["id"]]),
            notes=("Difference of the score that is first above, first minus second.",),
            wide_only=len(comparison.configurations) > 2,
        ),
    )


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
            "Motion: the same for the displacement from the start. Neither shows which engine is right.",
            f"Threshold: published mean RMSE of the single real trials, relative to their mean.{share}",
        ),
    )


def _exceeded_text(row: Mapping[str, Any]) -> str:
    ending = ", diverged" if row["diverged"] else ""
    return ("never" if row["apart_at_s"] is None else f"{row['apart_at_s']:.2f} s") + ending


def _summary_table(comparison: Comparison, labels: Sequence[str]) -> Table:
    rows = [
        {"label": label} | dataclasses.asdict(one) for label, one in zip(labels, comparison.summaries(), strict=True)
    ]
    counts = {"ran": "ran", "scored": "scored", "diverged": "diverged", "not_run": "not run"}
    return Table(
        title="Summary",
        columns=(
            Column("label", "configuration"),
            *(Column(key, title, is_number=True) for key, title in counts.items()),
            Column("wall_s_per_sim_s", COST_TITLE, _cost_text, is_number=True),
            Column("wall_s_per_sim_s_common", "in common", _cost_text, is_number=True),
        ),
        rows=rows,
        notes=(
            f"{COST_TITLE}: wall time of reset and steps over simulated time, without the time to build the scene; "
            f"repeats that ran together share it; in common: over the {len(comparison.run_by_all)} that all ran. "
            "Comparable only on one machine.",
        ),
    )
