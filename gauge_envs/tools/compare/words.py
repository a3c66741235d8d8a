"""Engines side by side: scores, ranks and pairs within each grade, cost, distances and a summary."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

from gauge_envs.errors import UnknownNameError
from gauge_envs.files import json_ready
from gauge_envs.pages.document import Document, Paragraph
from gauge_envs.pages.results import (
    ALIGNED,
    PLAIN,
    SCORE_METRICS,
    configuration_labels,
    configuration_parts,
    versions_text,
)
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import (
    COST_TITLE,
    ENGINE_TITLES,
    GRADE_NOTES,
    NORMALIZED_NOTE,
    counted,
    interval_text,
    plus_minus_text,
    quantity_text,
    score_text,
    short_id,
    with_unit,
)
from gauge_envs.references.bands import BandGrade
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.result import Outcome
from gauge_envs.tools.compare.comparison import Cell, Comparison, ExperimentComparison
from gauge_envs.tools.compare.distance import MOTION_SHARE, Distance
from gauge_envs.tools.compare.grades import GradeComparison, GradeScore, PairComparison, grade_name

ALL_METRICS = tuple(SCORE_METRICS)


def check_metrics(names: Iterable[str]) -> tuple[str, ...]:
    """Return names of metrics without repetition, or all metrics if none is given."""
    chosen = tuple(dict.fromkeys(names))
    for name in chosen:
        if name not in SCORE_METRICS:
            raise UnknownNameError("metric", name, SCORE_METRICS)
    return chosen or ALL_METRICS


def comparison_document(
    comparison: Comparison, metrics: Sequence[str] = ALL_METRICS, *, with_costs: bool = True
) -> Document:
    """Return scores, ranks and pairs of each grade, costs, distances without a reference, and a summary.

    Its rows are the scores of each experiment, the means of each grade, and all pairs; `record` states which.

    Args:
        comparison: The comparison.
        metrics: Metrics to show.
        with_costs: Whether to show wall times.
    """
    labels, rows = configuration_labels(comparison.configurations), comparison_rows(comparison, metrics)
    grades = [_grade_record(grade, labels) for grade in comparison.grades]
    pairs = [_pair_record(grade, pair, labels) for grade in comparison.grades for pair in grade.pairs]
    kinds = (("experiment", rows), ("grade", grades), ("pair", pairs))
    unscored = [one for one in comparison.experiments if one.grade == BandGrade.NONE.value and one.distances]
    tables: list[Table] = []
    if rows:
        tables.append(_score_table(comparison, rows, labels))
    if any(grade.ids for grade in comparison.grades):
        tables.append(_ranking_table(comparison, labels))
    if any(grade.pairs for grade in comparison.grades):
        tables += _pair_tables(comparison, labels)
    if rows and with_costs:
        tables.append(_cost_table(rows, labels))
    if unscored:
        tables.append(_distance_table(unscored, labels))
    if rows and with_costs:
        tables.append(_summary_table(comparison, labels))
    return Document(
        parts=tables or (Paragraph("no results to compare"),),
        rows=[{"record": kind, **one} for kind, some in kinds for one in some],
        markdown=tables,
    )


# --- rows ------------------------------------------------------------------------------------------------------------


MEANS = ("mean", "interquartile_mean", "geometric_mean", "geometric_mean_raw")
"""Means of `GradeScore`."""


def _grade_record(grade: GradeComparison, labels: Sequence[str]) -> dict[str, Any]:
    def score_record(one: GradeScore) -> dict[str, Any]:
        record: dict[str, Any] = {"label": labels[one.configuration], "rank": one.rank}
        for key in MEANS:
            mean = getattr(one, key)
            record |= {key: mean and mean.value, f"{key}_95": mean and mean.interval_95}
        return record

    return {
        "grade": grade.grade,
        "withheld": grade.withheld,
        "ids": grade.ids,
        "configurations": [score_record(one) for one in grade.scores],
        "published": grade.published,
    }


def _pair_record(grade: GradeComparison, pair: PairComparison, labels: Sequence[str]) -> dict[str, Any]:
    values = asdict(pair)
    experiments = values.pop("experiments")
    names = {"first": labels[pair.first], "second": labels[pair.second]}
    about = {"grade": grade.grade, "withheld": grade.withheld, "ids": pair.ids}
    return names | about | {key: values[key] for key in values if key not in names} | {"experiments": experiments}


def comparison_rows(comparison: Comparison, metrics: Sequence[str] = ALL_METRICS) -> list[dict[str, Any]]:
    """Return a JSON-ready object for each experiment and metric.

    An experiment without any of the metrics has one object, whose `metric` is None.
    """
    labels = configuration_labels(comparison.configurations)
    rows = []
    for one in comparison.experiments:
        names: list[str | None] = [*one.metrics(metrics)]
        for name in names or [None]:
            line = one.baselines.get(name or "")
            rows.append(
                {
                    "id": one.id,
                    "grade": one.grade,
                    "withheld": one.withheld,
                    "metric": name,
                    "unit": None if name is None else SCORE_METRICS[name].unit or one.unit,
                    "real": None if line is None else {"mean": line.mean, "std": line.std},
                    "published": None if name is None else one.published(name),
                    "configurations": [
                        {"label": label, **asdict(configuration)} | _cell_row(cell, name)
                        for label, configuration, cell in zip(labels, comparison.configurations, one.cells, strict=True)
                    ],
                    "distances": [
                        asdict(far) | {"first": labels[far.first], "second": labels[far.second]}
                        for far in one.distances
                    ],
                    "notes": list(comparison.notes),
                }
            )
    return json_ready(rows)


def _cell_row(found: Cell | None, metric: str | None) -> dict[str, Any]:
    cell = found or Cell(results=())
    ran = [result for result in cell.results if result.error is None]
    return {
        "outcomes": [result.outcome.value for result in cell.results],
        "reasons": [result.error or result.diverged_reason for result in cell.results],
        "seeds": [result.seed for result in cell.results],
        "raw": _spread_row(cell, metric, normalized=False),
        "normalized": _spread_row(cell, metric, normalized=True),
        "normalized_95": None if metric is None else cell.interval_95(metric),
        "percentile": None if metric is None else cell.percentile(metric),
        "wall_s_per_sim_s": cell.wall_s_per_sim_s,
        "settings": ran[0].settings if ran else None,
        "versions": ran[0].versions if ran else None,
    }


def _spread_row(cell: Cell, metric: str | None, *, normalized: bool) -> dict[str, Any] | None:
    spread = None if metric is None else cell.spread(metric, normalized=normalized)
    if metric is None or spread is None:
        return None
    return asdict(spread) | {"values": cell.values(metric, normalized=normalized)}


# --- scores ----------------------------------------------------------------------------------------------------------

PERCENTILE = "percentile"
"""Key of the row with the percentage of real trials that are closer to their mean than the primary score."""

TITLES = {key: metric.title for key, metric in SCORE_METRICS.items()} | {PERCENTILE: "trials closer"}

EXPERIMENT = Column("id", "experiment", short_id, place=Place.HEADING)


GRADE = Column("", "grade", lambda row: grade_name(row["grade"], withheld=row["withheld"]), place=Place.HEADING)


def _score_table(comparison: Comparison, rows: Sequence[dict[str, Any]], labels: Sequence[str]) -> Table:
    baselines = {one.id: one.baselines for one in comparison.experiments}

    def real_text(row: Mapping[str, Any]) -> str:
        if row["metric"] == PERCENTILE:
            return "-"
        if row["metric"] == "el":
            return "0 is ideal"
        line = baselines[row["id"]].get("rmse" if row["metric"] == ALIGNED.key else row["metric"])
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
        notes=tuple(_score_notes(comparison, rows, [column.text(row) for column in scores for row in rows])),
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
        interval = one["normalized_95"] if one["normalized"] else None
        scatter = "" if spread["std"] is None else f" +- {score_text(spread['std'])} ({spread['count']})"
        text = interval_text(spread["mean"], interval, score_text) + scatter
        texts.append(text if one["normalized"] else with_unit(text, row["unit"]))
    for outcome in (Outcome.DIVERGED, Outcome.FAILED, Outcome.DECLINED):
        if count := outcomes.count(outcome.value):
            texts.append(outcome.value if count == len(outcomes) else f"{count} {outcome.value}")
    return ", ".join(texts) or "no score"


def _score_style(index: int, row: Mapping[str, Any]) -> str:
    return "red" if Outcome.DIVERGED.value in row["configurations"][index]["outcomes"] else ""


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


def _score_notes(comparison: Comparison, rows: Sequence[dict[str, Any]], used: Sequence[str]) -> Iterator[str]:
    """Yield what the table of scores needs to be read: only what occurs in it is explained."""
    yield NORMALIZED_NOTE
    if any("[" in cell for cell in used):
        yield INTERVAL_NOTE
    meanings = [
        text
        for word, text in CELL_NOTES.items()
        if any(word == cell or (word != "-" and word in cell) for cell in used)
    ]
    if meanings:
        yield f"{'; '.join(meanings)}."
    if any("+-" in cell for cell in used):
        yield "Repeats, which differ in their seed alone: mean +- sample standard deviation (how many)."
    if any(row["metric"] == ALIGNED.key for row in rows):
        yield (
            f"{ALIGNED.title}: RMSE after the constant time shift that fits best. It comes first where the experiment "
            "starts with a release."
        )
    grades = sorted({one.grade for one in comparison.experiments})
    yield f"Grades: {'; '.join(f'{grade}: {GRADE_NOTES[BandGrade(grade)]}' for grade in grades)}."
    yield from _configuration_notes(comparison.configurations)
    yield from (f"Note: {note}." for note in comparison.notes)


def _configuration_notes(configurations: Sequence[RunConfiguration]) -> Iterator[str]:
    """Yield what all configurations share, and the versions of their engines."""
    first, *others = configurations
    if others:
        exact = [configuration_parts(one, digits=17) for one in others]
        pairs = zip(configuration_parts(first, digits=17), configuration_parts(first), strict=True)
        shared = [text for part, (_, text) in pairs if all(part in parts for parts in exact)]
        if shared:
            yield f"All configurations: {', '.join(shared)}."
        if PLAIN[1] not in shared:
            yield "Parameters are calibrated unless stated."
    engines = dict.fromkeys(f"{one.backend or 'file'}: {versions_text(one) or '-'}" for one in configurations)
    yield f"Versions: {'; '.join(engines)}."
    if not others:
        yield "One configuration: there is nothing to compare it with but the published scores."


# --- grades ----------------------------------------------------------------------------------------------------------


def _ranking_table(comparison: Comparison, labels: Sequence[str]) -> Table:
    rows: list[dict[str, Any]] = []
    for grade in comparison.grades:
        heading = {"grade": f"{grade.name}, {counted(len(grade.ids), 'experiment')}"}
        rows += [heading | _ranking_row(labels[one.configuration], one) for one in grade.ranked if one.mean is not None]
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
    means = {key: mean for key in MEANS if (mean := getattr(one, key)) is not None}
    return {"label": label, "rank": one.rank} | {
        key: interval_text(mean.value, mean.interval_95, score_text) for key, mean in means.items()
    }


def _pair_tables(comparison: Comparison, labels: Sequence[str]) -> tuple[Table, Table]:
    """Return the table of pairs over each grade, and the one over each experiment."""
    over_grades: list[dict[str, Any]] = []
    over_experiments: list[dict[str, Any]] = []
    for grade in comparison.grades:
        for pair in grade.pairs:
            names = {"between": f"{labels[pair.first]} : {labels[pair.second]}"}
            heading = {"grade": f"{grade.name}, {counted(len(pair.ids), 'experiment')}"}
            over_grades.append(heading | names | {"of": pair})
            about = {"grade": grade.grade, "withheld": grade.withheld}
            over_experiments += [{"id": one.id} | about | names | {"of": one} for one in pair.experiments]

    def difference(title: str) -> Column:
        return Column(
            "of", title, lambda of: interval_text(of.difference, of.difference_95, score_text), is_number=True
        )

    order = {one.id: place for place, one in enumerate(comparison.experiments)}
    between = Column("between", "first : second")
    verdict = Column("of.distinguishable", "at 95 %", verdict_text)
    return (
        Table(
            title="Pairs within each grade",
            columns=(
                Column("grade", "grade", place=Place.HEADING),
                between,
                difference("mean difference"),
                Column("of.probability_of_improvement", "first closer", lambda share: f"{share:.0%}", is_number=True),
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
            columns=(EXPERIMENT, GRADE, between, difference("difference"), verdict),
            rows=sorted(over_experiments, key=lambda row: order[row["id"]]),
            notes=("Difference of the score that is first above, first minus second.",),
            wide_only=len(comparison.configurations) > 2,
        ),
    )


def verdict_text(distinguishable: bool) -> str:
    """Return whether two configurations are distinguishable."""
    return "distinguishable" if distinguishable else "not distinguishable"


# --- distances and costs ---------------------------------------------------------------------------------------------


def _distance_table(experiments: Sequence[ExperimentComparison], labels: Sequence[str]) -> Table:
    rows = [
        {"id": one.id, "between": f"{labels[far.first]} : {labels[far.second]}", "far": far}
        for one in experiments
        for far in one.distances
    ]

    def distance(far: Distance) -> str:
        scatter = "" if far.rms.std is None else f" +- {quantity_text(far.rms.std)}"
        return f"{quantity_text(far.rms.mean)}{scatter} {far.unit}"

    def exceeded(far: Distance) -> str:
        ending = ", diverged" if far.diverged else ""
        return ("never" if far.apart_at_s is None else f"{far.apart_at_s:.2f} s") + ending

    texts: dict[str, Callable[[Distance], str]] = {
        "distance": distance,
        "motion": lambda far: f"{quantity_text(far.motion_rms)} {far.unit}",
        "threshold": lambda far: f"{quantity_text(far.threshold)} {far.unit}{'' if far.threshold_is_scatter else ' *'}",
        "first exceeded": exceeded,
    }
    is_published = all(far.threshold_is_scatter for one in experiments for far in one.distances)
    share = "" if is_published else f" * not published: {MOTION_SHARE:.0%} of the motion."
    return Table(
        title="Where engines disagree: no reference, so distances between them",
        columns=(
            EXPERIMENT,
            Column("between", "between"),
            *(Column("far", title, text, is_number=True) for title, text in texts.items()),
        ),
        rows=rows,
        notes=(
            "Distance: Euclidean over all coordinates at a frame, root mean square over the frames that both have. "
            "Motion: the same for the displacement from the start. Neither shows which engine is right.",
            f"Threshold: published mean RMSE of the single real trials, relative to their mean.{share}",
        ),
    )


def _summary_table(comparison: Comparison, labels: Sequence[str]) -> Table:
    rows = [{"label": label} | asdict(one) for label, one in zip(labels, comparison.summaries(), strict=True)]
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
