"""Tables of ranks, in each experiment and over each grade of reference."""

from collections.abc import Iterator

from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import counted, interval_text, short_id
from gauge_envs.tools.compare.comparison import Comparison
from gauge_envs.tools.compare.grades import NEGLIGIBLE, GradeComparison, Mean
from gauge_envs.tools.compare.score_tables import EXPERIMENT

MAX_NAMED = 4
"""Number of experiments up to which the rank in each is shown beside their mean."""


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
    """Return the rank of each configuration in each experiment."""
    rows = [
        {
            "id": one.id,
            "grade": grade.name,
            "ranks": [
                rank_text(one.ranks.get(index))
                for index in range(len(comparison.labels))
            ],
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
        ),
        rows=rows,
        notes=(
            "Best to worst rank, 95 % interval by paired bootstrap: all configurations have the same resampled real "
            f"mean, or error of the solution. A difference of at most {NEGLIGIBLE} of the score's scale is a tie. "
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
            Column("decides", "rank in"),
        ),
        rows=rows,
        notes=(
            "Mean rank: over the experiments, which all count the same; a rank is 1 + sum of the probabilities that "
            "another configuration is closer. [low, high]: 95 % interval by paired bootstrap. "
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
