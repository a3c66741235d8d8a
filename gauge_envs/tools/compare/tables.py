"""Tables of scores, of ranks, of distances between engines where there is no reference, and a summary."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from gauge_envs.pages.results import (
    ALIGNED,
    PLAIN,
    SCORE_METRICS,
    VERIFIED,
    configuration_parts,
    versions_text,
)
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import (
    NORMALIZED_NOTE,
    counted,
    interval_text,
    kind_notes,
    plus_minus_text,
    quantity_text,
    score_text,
    short_id,
    with_unit,
)
from gauge_envs.references.kind import Kind
from gauge_envs.references.published import PUBLISHED_ENGINES
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.result import Outcome
from gauge_envs.scoring.score import COVERAGE_FACTOR, OVER_U
from gauge_envs.tools.compare.comparison import Comparison
from gauge_envs.tools.compare.distance import MOTION_SHARE, Distance
from gauge_envs.tools.compare.ranks import NEGLIGIBLE, Mean

VERDICT = "verdict"
"""Key of the row with the verdicts, above that of each primary metric."""

EXPERIMENT = Column("id", "experiment", short_id, place=Place.HEADING)
KIND = Column("kind", "reference", place=Place.HEADING)

INTERVAL_NOTE = "[low, high]: 95 % interval, for what the sample of real trials, or u of the reference, leaves open."

SOLUTION_NOTE = (
    f"{VERIFIED.title[0].upper()}{VERIFIED.title[1:]}: over u, its standard uncertainty; up to {COVERAGE_FACTOR} u is "
    "inside. It says nothing of reality."
)

RANK_NOTE = (
    "Best to worst rank among configurations with the same constants. Two rank apart where the 95 % interval of their "
    f"difference excludes differences of at most {NEGLIGIBLE} of the scale: they share the errors of the reference, "
    "which cancel in a difference."
)

CELL_NOTES = {
    "-": "-: not run, or not published",
    "no score": "no score: it ran, but no reference scores it, or the measured event did not happen",
    "diverged": "diverged: the simulation left what is physically possible, so it has no score",
    "declined": "declined: the engine cannot build the scene",
    "failed": "failed: the episode ended in an error",
}


# --- scores ----------------------------------------------------------------------------------------------------------


def score_table(comparison: Comparison, rows: Sequence[dict[str, Any]]) -> Table:
    """Return rows of `comparison_rows` as a table, the verdict above each primary metric."""
    experiments = {one.id: one for one in comparison.experiments}
    titles = {key: metric.title for key, metric in SCORE_METRICS.items()}

    def real_text(row: Mapping[str, Any]) -> str:
        if row["metric"] == "el":
            return "0 is ideal"
        if row["metric"] == OVER_U:
            return "u of the solution"
        line = experiments[row["id"]].baselines.get(
            "rmse" if row["metric"] == ALIGNED.key else row["metric"]
        )
        return "-" if line is None else plus_minus_text(line.mean, line.std, line.unit)

    def style(index: int, row: Mapping[str, Any]) -> str:
        outcomes = row["configurations"][index]["outcomes"]
        return "red" if Outcome.DIVERGED.value in outcomes else ""

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
        one = experiments[row["id"]]
        verdicts = [cell.verdict if cell else "" for cell in one.cells]
        # Without a reference motion, recorded events alone may decide.
        is_judged = bool(set(verdicts) - {"", "no reference"})
        if row["metric"] == one.primary or (row["metric"] is None and is_judged):
            shown.append(
                row | {"metric": VERDICT, "published": None, VERDICT: verdicts}
            )
        if row["metric"] is not None or not is_judged:
            shown.append(row)
    return Table(
        title="Scores over the mean score of the real trials, or over u of a solution, with 95 % intervals",
        columns=(
            EXPERIMENT,
            KIND,
            Column("metric", "metric", lambda name: titles.get(name, name)),
            Column("", "1 =", real_text, is_number=True, wide_only=True),
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


def _score_cell(index: int, row: Mapping[str, Any]) -> str:
    """Return mean and scatter of a configuration's repeats, or why it has no score."""
    if VERDICT in row:
        return row[VERDICT][index] or "-"
    one = row["configurations"][index]
    outcomes, normalized = one["outcomes"], one["normalized"]
    if not outcomes:
        return "-"
    texts = []
    # A score without a baseline to divide by stands in its own unit.
    if spread := normalized or one["raw"]:
        text = interval_text(spread["mean"], normalized and one["normalized_95"])
        if spread["std"] is not None:
            text += f" +- {score_text(spread['std'])} ({spread['count']})"
        unit = "1" if normalized else row["unit"]
        texts.append(with_unit(text, "u" if row["metric"] == OVER_U else unit))
    for outcome in (Outcome.DIVERGED, Outcome.FAILED, Outcome.DECLINED):
        count = outcomes.count(outcome.value)
        if count == len(outcomes):
            texts.append(outcome.value)
        elif count:
            texts.append(f"{count} {outcome.value}")
    return ", ".join(texts) or "no score"


def _score_notes(
    comparison: Comparison, rows: Sequence[dict[str, Any]], used: Sequence[str]
) -> Iterator[str]:
    """Yield what the table of scores needs to be read: only what occurs in it is explained."""
    metrics = {row["metric"] for row in rows}
    if metrics - {OVER_U}:
        yield NORMALIZED_NOTE
    if OVER_U in metrics:
        yield SOLUTION_NOTE
    if any("[" in cell for cell in used):
        yield INTERVAL_NOTE
    meanings = [
        meaning
        for word, meaning in CELL_NOTES.items()
        if (word in used if word == "-" else any(word in cell for cell in used))
    ]
    if meanings:
        yield f"{'; '.join(meanings)}."
    if any("+-" in cell for cell in used):
        yield "Repeats, which differ in their seed alone: mean +- sample standard deviation (how many)."
    if ALIGNED.key in metrics:
        yield (
            f"{ALIGNED.title}: RMSE after the constant time shift that fits best. It comes first where the experiment "
            "starts with a release."
        )
    yield from kind_notes(row["kind"] for row in rows)
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
        others_parts = [configuration_parts(one, digits=17) for one in others]
        exact_parts = configuration_parts(first, digits=17)
        shared = [
            shown
            for exact, (_, shown) in zip(
                exact_parts, configuration_parts(first), strict=True
            )
            if all(exact in parts for parts in others_parts)
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


# --- ranks -----------------------------------------------------------------------------------------------------------


def rank_tables(
    comparison: Comparison, *, with_experiments: bool = True
) -> Iterator[Table]:
    """Yield the ranks in each experiment, and those over each kind of reference."""
    experiments = [
        {"id": one.id, "kind": kind.name, "ranks": one.ranks}
        for kind in comparison.kinds
        for one in kind.experiments
        if len(one.ranks) > 1
    ]
    if with_experiments and experiments:
        yield Table(
            title="Ranks in each experiment",
            columns=(
                EXPERIMENT,
                KIND,
                *(
                    Column("ranks", label, partial(_rank_of, index), is_number=True)
                    for index, label in enumerate(comparison.labels)
                ),
            ),
            rows=experiments,
            notes=(RANK_NOTE,),
        )
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
    if rows:
        yield Table(
            title="Ranking within each kind of reference",
            columns=(
                KIND,
                Column("label", "configuration"),
                Column("mean_rank", "mean rank", mean_rank_text, is_number=True),
            ),
            rows=rows,
            notes=(
                "Mean rank: over the experiments, which all count the same, of the middle of the ranks in each. "
                "[low, high]: mean of the best and of the worst ranks. Ranks depend on which configurations are "
                "compared. Nothing is averaged across kinds.",
            ),
        )


def _rank_of(index: int, ranks: Mapping[int, Mean]) -> str:
    return rank_text(ranks.get(index))


def rank_text(rank: Mean | None) -> str:
    """Return the best and the worst rank of a configuration in an experiment."""
    if rank is None:
        return "-"
    low, high = (round(end) for end in rank.interval_95)
    return f"{low}" if low == high else f"{low}-{high}"


def mean_rank_text(mean: Mean) -> str:
    """Return a mean rank with its interval."""
    return interval_text(mean.value, mean.interval_95, lambda rank: f"{rank:.1f}")


# --- distances and counts --------------------------------------------------------------------------------------------


def distance_table(comparison: Comparison) -> Table | None:
    """Return how far engines are from each other in experiments without a reference; None without such a distance."""
    rows: list[dict[str, Any]] = [
        {
            "id": one.id,
            "between": " : ".join(comparison.names(far).values()),
            "far": far,
        }
        for one in comparison.experiments
        if one.kind == Kind.NONE
        for far in one.distances
    ]
    if not rows:
        return None

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


def summary_table(comparison: Comparison) -> Table:
    """Return how many episodes of each configuration ran and have a score."""
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
        ),
        rows=[{"label": label} | vars(one) for label, one in summaries],
    )
