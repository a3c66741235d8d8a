"""Engines side by side: scores, ranks and pairs within each grade, cost, distances and a summary."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

from gauge_envs.errors import UnknownNameError
from gauge_envs.evaluation.scatter import scatter_ranks
from gauge_envs.evaluation.verification import Verification
from gauge_envs.files import json_ready
from gauge_envs.pages.document import Document, Paragraph
from gauge_envs.pages.results import (
    ALIGNED,
    PLAIN,
    SCATTER_NOTE,
    SCORE_METRICS,
    VERIFICATION_NOTE,
    configuration_parts,
    scatter_cells,
    versions_text,
)
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import (
    COST_TITLE,
    NORMALIZED_NOTE,
    QUESTIONS,
    counted,
    interval_text,
    plus_minus_text,
    quantity_text,
    reality_notes,
    reality_of,
    score_text,
    short_id,
    with_unit,
)
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.published import PUBLISHED_ENGINES
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.result import Outcome
from gauge_envs.tools.compare.comparison import Cell, Comparison
from gauge_envs.tools.compare.distance import MOTION_SHARE, Distance
from gauge_envs.tools.compare.grades import (
    ExperimentDifference,
    GradeComparison,
    Mean,
    PairComparison,
    grade_name,
)
from gauge_envs.tools.compare.significance import NEGLIGIBLE

ALL_METRICS = tuple(SCORE_METRICS)

MAX_NAMED = 4
"""Number of experiments up to which the rank in each is shown beside their mean."""

PERCENTILE = "percentile"
"""Key of the row with the percentage of real trials that are closer to their mean than the primary score."""

EXPERIMENT = Column("id", "experiment", short_id, place=Place.HEADING)

GRADE = Column(
    "",
    "grade",
    lambda row: grade_name(reality_of(row["grade"]), withheld=row["withheld"]),
    place=Place.HEADING,
)

INTERVAL_NOTE = (
    "[low, high]: 95 % interval, for what the sample of real trials leaves open. Trials closer: share of the "
    "real trials that are closer to their mean, by the metric below it."
)

CELL_NOTES = {
    "-": "-: not run, or not published",
    "no score": "no score: it ran, but there is no reference, or the measured event did not happen",
    "diverged": "diverged: the simulation left what is physically possible, so it has no score",
    "declined": "declined: the engine cannot build the scene",
    "failed": "failed: the episode ended in an error",
}


RANK_NOTE = (
    "Rank: 1 where no difference is seen, before those that are unlike real trials; none where all have the same "
    "answer, or where it hangs on the starts."
)


def grades_of(comparison: Comparison, question: str) -> list[GradeComparison]:
    """Return the grades whose references answer one of `QUESTIONS`."""
    is_verified = question == "verification"
    return [grade for grade in comparison.grades if grade.is_verified is is_verified]


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
    with_costs: bool = True,
) -> Document:
    """Return scores, ranks and pairs of each grade, costs, distances without a reference, and a summary.

    Its rows are the scores of each experiment, the ranks of each grade, and all pairs; `record` states which.

    Args:
        comparison: The comparison.
        metrics: Metrics to show.
        with_costs: Whether to show wall times.
    """
    rows = comparison_rows(comparison, metrics)
    tables: list[Table] = []
    if validated := _validation_rows(comparison, rows):
        tables.append(_score_table(comparison, validated))
    tables += _scatter_tables(comparison)
    if any(one.is_verified for one in comparison.experiments):
        tables.append(_verification_table(comparison))
    for question in QUESTIONS:
        tables += _rank_tables(comparison, question)
    for question in QUESTIONS:
        tables += _pair_tables(comparison, question)
    if rows and with_costs:
        tables.append(_cost_table(comparison))
    if any(
        one.grade == BandGrade.NONE.value and one.distances
        for one in comparison.experiments
    ):
        tables.append(_distance_table(comparison))
    if rows and with_costs:
        tables.append(_summary_table(comparison))
    records = [{"record": "experiment", **row} for row in rows]
    records += _grade_records(comparison)
    return Document(
        parts=tables or (Paragraph("no results to compare"),),
        rows=records,
        markdown=tables,
    )


def short_tables(comparison: Comparison, *, with_ranks: bool = True) -> list[Table]:
    """Return the ranks within each grade, and the score of each experiment that comes first: no pairs.

    Args:
        comparison: The comparison.
        with_ranks: Whether to show ranks.
    """
    first: dict[str, dict[str, Any]] = {}
    for row in _validation_rows(comparison, comparison_rows(comparison)):
        first.setdefault(row["id"], row)
    tables = [
        table
        for question in QUESTIONS
        for table in _rank_tables(comparison, question, with_experiments=False)
        if with_ranks
    ]
    if first:
        tables.append(_score_table(comparison, [*first.values()]))
    if any(one.is_verified for one in comparison.experiments):
        tables.append(_verification_table(comparison))
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


# --- rows ------------------------------------------------------------------------------------------------------------


def comparison_rows(
    comparison: Comparison, metrics: Sequence[str] = ALL_METRICS
) -> list[dict[str, Any]]:
    """Return a JSON-ready object for each experiment and metric.

    An experiment without any of the metrics has one object, whose `metric` is None.
    """
    rows = []
    for one in comparison.experiments:
        names: list[str | None] = [*one.metrics(metrics)]
        configured = list(
            zip(comparison.labels, comparison.configurations, one.cells, strict=True)
        )
        distances = [asdict(far) | comparison.names(far) for far in one.distances]
        for name in names or [None]:
            line = one.baselines.get(name or "")
            rows.append(
                {
                    "id": one.id,
                    "grade": one.grade,
                    "withheld": one.withheld,
                    "metric": name,
                    "unit": name and one.unit_of(name),
                    "real": line and {"mean": line.mean, "std": line.std},
                    "published": name and one.published(name),
                    "configurations": [
                        {"label": label, **asdict(configuration)}
                        | _cell_row(cell or Cell(results=()), name)
                        for label, configuration, cell in configured
                    ],
                    "distances": distances,
                    "notes": comparison.notes,
                }
            )
    return json_ready(rows)


def _cell_row(cell: Cell, metric: str | None) -> dict[str, Any]:
    def spread_row(*, normalized: bool) -> dict[str, Any] | None:
        if (
            metric is None
            or (spread := cell.spread(metric, normalized=normalized)) is None
        ):
            return None
        return asdict(spread) | {"values": cell.values(metric, normalized=normalized)}

    ran = [result for result in cell.results if result.error is None]
    return {
        "outcomes": [result.outcome.value for result in cell.results],
        "reasons": [result.error or result.diverged_reason for result in cell.results],
        "seeds": [result.seed for result in cell.results],
        "raw": spread_row(normalized=False),
        "normalized": spread_row(normalized=True),
        "normalized_95": metric and cell.interval_95(metric),
        "percentile": metric and cell.percentile(metric),
        "verification": [
            None
            if result.score.verification is None
            else asdict(result.score.verification)
            for result in cell.results
        ],
        "also_verified": [
            [asdict(one) for one in result.score.also_verified]
            for result in cell.results
        ],
        "scatter": None if cell.scatter is None else asdict(cell.scatter),
        "wall_s_per_sim_s": cell.wall_s_per_sim_s,
        "settings": ran[0].settings if ran else None,
        "versions": ran[0].versions if ran else None,
    }


def _grade_records(comparison: Comparison) -> Iterator[dict[str, Any]]:
    """Yield the ranks of each grade, then all pairs."""
    for grade in comparison.grades:
        about = {
            "grade": grade.grade,
            "withheld": grade.withheld,
            "constants": grade.constants,
        }
        scores = [
            {
                "label": comparison.labels[one.configuration],
                "rank": one.rank,
                "mean_rank": one.mean_rank and one.mean_rank.value,
                "mean_rank_95": one.mean_rank and one.mean_rank.interval_95,
                "ranks": {
                    of.id: {"value": rank.value, "interval_95": rank.interval_95}
                    for of in grade.experiments
                    if (rank := of.ranks.get(one.configuration)) is not None
                },
            }
            for one in grade.scores
        ]
        apart = {
            one.id: [one.distinguishable_count, one.pair_count]
            for one in grade.experiments
        }
        if scores:
            yield (
                {"record": "grade"}
                | about
                | {"ids": grade.ids, "configurations": scores, "distinguishable": apart}
            )
    for grade in comparison.grades:
        about = {
            "grade": grade.grade,
            "withheld": grade.withheld,
            "constants": grade.constants,
        }
        for pair in grade.pairs:
            values = {
                key: value
                for key, value in asdict(pair).items()
                if key not in ("first", "second")
            }
            values["experiments"] = [
                asdict(one) | {"distinguishable": one.distinguishable}
                for one in pair.experiments
            ]
            found = {
                "ids": pair.ids,
                "closer_in": pair.counts,
                "distinguishable": pair.distinguishable,
            }
            yield {"record": "pair"} | comparison.names(pair) | about | values | found


# --- scores ----------------------------------------------------------------------------------------------------------


def _score_table(comparison: Comparison, rows: Sequence[dict[str, Any]]) -> Table:
    experiments = {one.id: one for one in comparison.experiments}
    titles = {key: metric.title for key, metric in SCORE_METRICS.items()} | {
        PERCENTILE: "trials closer"
    }

    def real_text(row: Mapping[str, Any]) -> str:
        if row["metric"] == "el":
            return "0 is ideal"
        line = experiments[row["id"]].baselines.get(
            "rmse" if row["metric"] == ALIGNED.key else row["metric"]
        )
        return "-" if line is None else plus_minus_text(line.mean, line.std, line.unit)

    def style(index: int, row: Mapping[str, Any]) -> str:
        return (
            "red"
            if Outcome.DIVERGED.value in row["configurations"][index]["outcomes"]
            else ""
        )

    scores = [
        Column(
            "",
            label,
            partial(_score_cell, index),
            is_number=True,
            style=partial(style, index),
        )
        for index, label in enumerate(comparison.labels)
    ]
    scores += [
        Column(f"published.{engine}", f"{title}, paper", score_text, is_number=True)
        for engine, title in PUBLISHED_ENGINES.items()
    ]
    shown = []
    for row in rows:
        is_primary = row["metric"] == experiments[row["id"]].primary
        if is_primary and any(
            one["percentile"] is not None for one in row["configurations"]
        ):
            shown.append(row | {"metric": PERCENTILE, "published": None})
        shown.append(row)
    return Table(
        title="Validation: scores over the mean score of the real trials, with 95 % intervals",
        columns=(
            EXPERIMENT,
            GRADE,
            Column("metric", "metric", lambda name: titles.get(name, name)),
            Column("", "1 = real trials", real_text, is_number=True, wide_only=True),
            *scores,
        ),
        rows=shown,
        notes=tuple(
            _score_notes(
                comparison,
                rows,
                [column.text(row) for column in scores for row in rows],
            )
        ),
    )


def _scatter_tables(comparison: Comparison) -> Iterator[Table]:
    """Yield the table of whether repeats scatter as real trials do, if any were enough for a test."""
    rows = []
    for one in comparison.experiments:
        found = [None if cell is None else cell.scatter for cell in one.cells]
        tested = [
            (label, scatter, rank)
            for label, scatter, rank in zip(
                comparison.labels, found, scatter_ranks(found), strict=True
            )
            if scatter is not None
        ]
        for label, scatter, rank in tested:
            cells = scatter_cells(scatter)
            rows.append({"id": one.id, "label": label, "rank": rank, **cells})
    if rows:
        yield Table(
            title="Validation: scatter of repeats and of real trials",
            columns=(
                EXPERIMENT,
                Column("label", "", place=Place.HEADING),
                Column("rank", "rank", is_number=True),
                Column("real_rmse", "real E_RMSE", is_number=True),
                Column("rmse", "runs", is_number=True),
                Column("real_dtw", "real E_DTW", is_number=True),
                Column("dtw", "runs", is_number=True),
                Column("p", "p", is_number=True),
                Column("verdict", "verdict", place=Place.BELOW),
            ),
            rows=rows,
            notes=(SCATTER_NOTE, RANK_NOTE),
        )


def _verification_table(comparison: Comparison) -> Table:
    """Return how well each configuration solves the scenes of laws and solved models."""
    rows = []
    for one in comparison.experiments:
        each = [
            verified
            for cell in one.cells
            for result in (() if cell is None else cell.results)
            for verified in result.score.verifications
        ]
        firsts: dict[str, Verification] = {}
        for verified in each:
            firsts.setdefault(verified.quantity, verified)
        for quantity, first in firsts.items():
            found = [
                [
                    verified
                    for result in (() if cell is None else cell.results)
                    for verified in result.score.verifications
                    if verified.quantity == quantity
                ]
                for cell in one.cells
            ]
            rows.append(
                {
                    "id": one.id,
                    "grade": first.grade,
                    "quantity": first.quantity,
                    "frozen": with_unit(score_text(first.frozen), first.unit),
                    "cells": [verification_cell(group) for group in found],
                }
            )
    return Table(
        title="Verification: distance from the solution of the scene",
        columns=(
            EXPERIMENT,
            Column("grade", "reference", place=Place.HEADING),
            Column("quantity", "compared"),
            Column("frozen", "frozen", is_number=True),
            *(
                Column("", label, partial(_verified_cell, index), is_number=True)
                for index, label in enumerate(comparison.labels)
            ),
        ),
        rows=rows,
        notes=(VERIFICATION_NOTE,),
    )


def _verified_cell(index: int, row: Mapping[str, Any]) -> str:
    return str(row["cells"][index])


def verification_cell(repeats: Sequence[Verification]) -> str:
    """Return the mean distance of repeats, over u where the solution has one, with the interval of a single run."""
    if not repeats:
        return "-"
    first = repeats[0]
    mean = sum(one.scaled for one in repeats) / len(repeats)
    ends = first.scaled_95 if len(repeats) == 1 else None
    return with_unit(interval_text(mean, ends), first.scale_unit)


def _score_cell(index: int, row: Mapping[str, Any]) -> str:
    """Return mean and scatter of a configuration's repeats, or why it has no score."""
    one = row["configurations"][index]
    outcomes, normalized = one["outcomes"], one["normalized"]
    if row["metric"] == PERCENTILE:
        return "-" if one["percentile"] is None else f"{one['percentile']:.0f} %"
    if not outcomes:
        return "-"
    texts = []
    # A score without a baseline to divide by stands in its own unit.
    if spread := normalized or one["raw"]:
        scatter = (
            ""
            if spread["std"] is None
            else f" +- {score_text(spread['std'])} ({spread['count']})"
        )
        text = (
            interval_text(spread["mean"], normalized and one["normalized_95"]) + scatter
        )
        texts.append(text if normalized else with_unit(text, row["unit"]))
    for outcome in (Outcome.DIVERGED, Outcome.FAILED, Outcome.DECLINED):
        if count := outcomes.count(outcome.value):
            texts.append(
                outcome.value if count == len(outcomes) else f"{count} {outcome.value}"
            )
    return ", ".join(texts) or "no score"


def _score_notes(
    comparison: Comparison, rows: Sequence[dict[str, Any]], used: Sequence[str]
) -> Iterator[str]:
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
    shown = {row["id"] for row in rows}
    yield from reality_notes(
        one.grade for one in comparison.experiments if one.id in shown
    )
    yield from _configuration_notes(comparison.configurations)
    yield from (f"Note: {note}." for note in comparison.notes)


def _physics_text(one: RunConfiguration) -> str:
    """Return whose physics a configuration shows, empty if that is not known."""
    by = " by this package" if one.physics == "corrected" else ""
    words = (one.backend, str(one.settings_given.get("preset", "")), one.physics + by)
    return " ".join(filter(None, words)) if one.physics else ""


def _configuration_notes(configurations: Sequence[RunConfiguration]) -> Iterator[str]:
    """Yield what all configurations share, and the versions of their engines."""
    first, *others = configurations
    if others:
        exact = [configuration_parts(one, digits=17) for one in others]
        pairs = zip(
            configuration_parts(first, digits=17),
            configuration_parts(first),
            strict=True,
        )
        shared = [
            text for part, (_, text) in pairs if all(part in parts for parts in exact)
        ]
        if shared:
            yield f"All configurations: {', '.join(shared)}."
        if PLAIN[1] not in shared:
            yield "Parameters are calibrated unless stated."
    if marks := dict.fromkeys(filter(None, map(_physics_text, configurations))):
        yield f"Physics: {', '.join(marks)}."
    engines = dict.fromkeys(
        f"{one.backend or 'file'}: {versions_text(one) or '-'}"
        for one in configurations
    )
    yield f"Versions: {'; '.join(engines)}."
    if not others:
        yield "One configuration: there is nothing to compare it with but the published scores."


# --- grades ----------------------------------------------------------------------------------------------------------


def _rank_tables(
    comparison: Comparison, question: str, *, with_experiments: bool = True
) -> Iterator[Table]:
    """Yield the ranks in each experiment, and those over each grade, of one question."""
    grades = grades_of(comparison, question)
    has_ranks = any(len(one.ranks) > 1 for grade in grades for one in grade.experiments)
    if with_experiments and has_ranks:
        yield _experiment_rank_table(comparison, question)
    if any(grade.ids and len(grade.scores) > 1 for grade in grades):
        yield _ranking_table(comparison, question)


def _experiment_rank_table(comparison: Comparison, question: str) -> Table:
    """Return the rank of each configuration in each experiment, and how many pairs it tells apart."""
    rows = [
        {
            "id": one.id,
            "grade": grade.name,
            "ranks": [
                rank_text(one.ranks.get(index))
                for index in range(len(comparison.labels))
            ],
            "apart": f"{one.distinguishable_count} of {one.pair_count}",
        }
        for grade in grades_of(comparison, question)
        for one in grade.experiments
        if len(one.ranks) > 1
    ]
    return Table(
        title=f"Ranks in each experiment, {question}",
        columns=(
            EXPERIMENT,
            Column("grade", "grade", place=Place.HEADING),
            *(
                Column(f"ranks.{index}", label, is_number=True)
                for index, label in enumerate(comparison.labels)
            ),
            Column("apart", "pairs apart", is_number=True),
        ),
        rows=rows,
        notes=(
            "Best to worst rank: behind those that are distinguishably closer, before those that are distinguishably "
            "further. Pairs apart: distinguishable pairs; at 5 %, corrected by Holm for all pairs of the experiment. A "
            f"difference of at most {NEGLIGIBLE} of the score's scale counts as none. "
            "Only configurations with the same constants are ranked against each other.",
        ),
    )


def rank_text(rank: Mean | None) -> str:
    """Return the best and the worst rank of a configuration in an experiment."""
    if rank is None:
        return "-"
    low, high = (round(end) for end in rank.interval_95)
    return f"{low}" if low == high else f"{low}-{high}"


def _ranking_table(comparison: Comparison, question: str) -> Table:
    rows = [
        {
            "grade": f"{grade.name}, {counted(len(grade.ids), 'experiment')}",
            "label": comparison.labels[one.configuration],
            "rank": one.rank,
            "mean_rank": one.mean_rank,
            "decides": deciding_text(grade, one.configuration),
        }
        for grade in grades_of(comparison, question)
        for one in grade.ranked
        if len(grade.scores) > 1 and one.mean_rank is not None
    ]
    return Table(
        title=f"Ranking within each grade, {question}",
        columns=(
            Column("grade", "grade", place=Place.HEADING),
            Column("label", "configuration"),
            Column("mean_rank", "mean rank", mean_rank_text, is_number=True),
            Column("rank", "rank", is_number=True),
            Column("decides", "rank in"),
        ),
        rows=rows,
        notes=(
            "Mean rank: over the experiments, which all count the same; a rank is 1 + sum of the probabilities that "
            "another configuration is closer. [low, high]: 95 % interval, from the ranks in all experiments together. "
            "Rank: 1 + number of configurations that are distinguishably closer in more than half of the experiments. "
            "Ranks depend on which configurations are compared. Nothing is averaged across grades.",
        ),
    )


def mean_rank_text(mean: Mean) -> str:
    """Return a mean rank with its interval."""
    return interval_text(mean.value, mean.interval_95, lambda rank: f"{rank:.1f}")


def deciding_text(grade: GradeComparison, configuration: int) -> str:
    """Return the experiments in which a configuration ranks best and worst, all if there are at most four."""
    ranks = [
        (one.ranks[configuration].value, one)
        for one in grade.experiments
        if one.id in grade.ids
    ]
    ordered = sorted(ranks, key=lambda entry: entry[0])
    shown = ordered if len(ordered) <= MAX_NAMED else [ordered[0], ordered[-1]]
    return ", ".join(
        f"{short_id(one.id)}: {rank_text(one.ranks[configuration])}" for _, one in shown
    )


def _pair_tables(comparison: Comparison, question: str) -> list[Table]:
    """Return the table of pairs over each grade of a question, and the one over each experiment; empty without any."""
    over_grades: list[dict[str, Any]] = []
    over_experiments: list[dict[str, Any]] = []
    for grade in grades_of(comparison, question):
        for pair in grade.pairs:
            between = {"between": " : ".join(comparison.names(pair).values())}
            heading = {"grade": f"{grade.name}, {counted(len(pair.ids), 'experiment')}"}
            over_grades.append(heading | between | {"of": pair})
            over_experiments += [
                {"id": one.id, "grade": grade.name} | between | {"of": one}
                for one in pair.experiments
            ]

    def counts(of: PairComparison) -> str:
        return "{} : {}".format(*of.counts)

    def text(of: ExperimentDifference) -> str:
        return with_unit(interval_text(of.difference, of.difference_95), units[of.id])

    if not over_grades:
        return []
    order = {one.id: place for place, one in enumerate(comparison.experiments)}
    units = {one.id: one.scale_unit for one in comparison.experiments}
    names, verdict = (
        Column("between", "first : second"),
        Column("of.distinguishable", "at 5 %", verdict_text),
    )
    share = Column(
        "of.probability_of_improvement",
        "first closer",
        lambda value: f"{value:.0%}",
        is_number=True,
    )
    p_value = Column("of.p_holm", "p", p_text, is_number=True)
    grade_heading = Column("grade", "grade", place=Place.HEADING)
    same = PAIRED_NOTES[question]
    return [
        Table(
            title=f"Pairs within each grade, {question}",
            columns=(
                grade_heading,
                names,
                Column("of", "closer in", counts, is_number=True),
                share,
                p_value,
                verdict,
            ),
            rows=over_grades,
            notes=(
                "Closer in: number of experiments in which the first, and in which the second is distinguishably "
                "closer. First closer: probability, mean over the experiments. p: of one being closer in more than "
                "half of the experiments, corrected by Holm for all pairs of the grade.",
            ),
        ),
        Table(
            title=f"Pairs in each experiment, {question}",
            columns=(
                EXPERIMENT,
                grade_heading,
                names,
                Column("of", "difference", text, is_number=True),
                p_value,
                verdict,
            ),
            rows=sorted(over_experiments, key=lambda row: order[row["id"]]),
            notes=(
                "Difference of the score that is first above, first minus second: below 0, the first is closer. "
                f"{same} Its interval is of this pair alone; p is corrected by Holm for all pairs of the experiment.",
            ),
            wide_only=len(comparison.configurations) > 2,
        ),
    ]


PAIRED_NOTES = {
    "validation": "Paired bootstrap: both have the same resampled real mean.",
    "verification": (
        "Both are compared with the same solution, whose error has the size u and the direction that tells the two "
        "apart least."
    ),
}
"""What the two of a pair have in common, by question."""


def p_text(p: float) -> str:
    """Return a p-value with two digits."""
    return "< 0.0001" if p < 1e-4 else f"{p:.2g}" if p < 0.01 else f"{p:.2f}"


def verdict_text(distinguishable: bool) -> str:
    """Return whether two configurations are distinguishable."""
    return "distinguishable" if distinguishable else "not distinguishable"


# --- distances and costs ---------------------------------------------------------------------------------------------


def _distance_table(comparison: Comparison) -> Table:
    rows: list[dict[str, Any]] = [
        {
            "id": one.id,
            "between": " : ".join(comparison.names(far).values()),
            "far": far,
        }
        for one in comparison.experiments
        if one.grade == BandGrade.NONE.value
        for far in one.distances
    ]

    def distance(far: Distance) -> str:
        scatter = "" if far.rms.std is None else f" +- {quantity_text(far.rms.std)}"
        return f"{quantity_text(far.rms.mean)}{scatter} {far.unit}"

    def threshold(far: Distance) -> str:
        return far.text(far.threshold) + ("" if far.threshold_is_scatter else " *")

    def exceeded(far: Distance) -> str:
        return far.apart_text + (", diverged" if far.diverged else "")

    is_published = all(row["far"].threshold_is_scatter for row in rows)
    share = (
        "" if is_published else f" * not published: {MOTION_SHARE:.0%} of the motion."
    )
    return Table(
        title="Where engines disagree: no reference, so distances between them",
        columns=(
            EXPERIMENT,
            Column("between", "between"),
            Column("far", "distance", distance, is_number=True),
            Column(
                "far", "motion", lambda far: far.text(far.motion_rms), is_number=True
            ),
            Column("far", "threshold", threshold, is_number=True),
            Column("far", "first exceeded", exceeded, is_number=True),
        ),
        rows=rows,
        notes=(
            "Distance: Euclidean over all coordinates at a frame, root mean square over the frames that both have. "
            "Motion: the same for the displacement from the start. Neither shows which engine is right.",
            f"Threshold: published mean RMSE of the single real trials, relative to their mean.{share}",
        ),
    )


def cost_text(value: float) -> str:
    """Return the wall seconds of a simulated second."""
    return f"{value:.2g}" if value < 10.0 else f"{value:.0f}"


def _cost_table(comparison: Comparison) -> Table:
    columns = (
        Column(f"costs.{index}", label, cost_text, is_number=True)
        for index, label in enumerate(comparison.labels)
    )
    return Table(
        title=f"Cost, {COST_TITLE}",
        columns=(Column("id", "experiment", short_id), *columns),
        rows=[
            {
                "id": one.id,
                "costs": [cell and cell.wall_s_per_sim_s for cell in one.cells],
            }
            for one in comparison.experiments
        ],
        wide_only=True,
    )


def _summary_table(comparison: Comparison) -> Table:
    summaries = zip(comparison.labels, comparison.summaries(), strict=True)
    counts = {
        "ran": "ran",
        "scored": "scored",
        "diverged": "diverged",
        "not_run": "not run",
    }
    return Table(
        title="Summary",
        columns=(
            Column("label", "configuration"),
            *(Column(key, title, is_number=True) for key, title in counts.items()),
            Column("wall_s_per_sim_s", COST_TITLE, cost_text, is_number=True),
            Column("wall_s_per_sim_s_common", "in common", cost_text, is_number=True),
        ),
        rows=[{"label": label} | vars(one) for label, one in summaries],
        notes=(
            f"{COST_TITLE}: wall time of reset and steps over simulated time, without the time to build the scene; "
            f"repeats that ran together share it; in common: over the {len(comparison.run_by_all)} that all ran. "
            "Comparable only on one machine.",
        ),
    )
