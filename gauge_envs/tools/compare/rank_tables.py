"""Tables of ranks and pairs, in each experiment and over each grade of reference."""

from collections.abc import Iterator
from typing import Any

from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import (
    counted,
    interval_text,
    short_id,
    with_unit,
)
from gauge_envs.tools.compare.comparison import Comparison
from gauge_envs.tools.compare.grades import (
    ExperimentDifference,
    GradeComparison,
    Mean,
    PairComparison,
)
from gauge_envs.tools.compare.score_tables import EXPERIMENT
from gauge_envs.tools.compare.significance import NEGLIGIBLE

MAX_NAMED = 4
"""Number of experiments up to which the rank in each is shown beside their mean."""


PAIRED_NOTES = {
    "validation": "Paired bootstrap: both have the same resampled real mean.",
    "verification": (
        "Both are compared with the same solution, whose error has the size u and the direction that tells the two "
        "apart least."
    ),
}
"""What the two of a pair have in common, by question."""


def grades_of(comparison: Comparison, question: str) -> list[GradeComparison]:
    """Return the grades whose references answer one of `QUESTIONS`."""
    is_verified = question == "verification"
    return [grade for grade in comparison.grades if grade.is_verified is is_verified]


def rank_tables(
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


def pair_tables(comparison: Comparison, question: str) -> list[Table]:
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


def p_text(p: float) -> str:
    """Return a p-value with two digits."""
    return "< 0.0001" if p < 1e-4 else f"{p:.2g}" if p < 0.01 else f"{p:.2f}"


def verdict_text(distinguishable: bool) -> str:
    """Return whether two configurations are distinguishable."""
    return "distinguishable" if distinguishable else "not distinguishable"
