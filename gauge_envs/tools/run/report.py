"""Summarize scores on one screen, with details and the reasons for missing results; show plans and their outcomes."""

import math
from collections import Counter
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from gauge_envs.experiments.variants import is_glob, matching_variants
from gauge_envs.pages.document import Document, Heading, Paragraph, Part, Tone
from gauge_envs.pages.results import configuration_parts
from gauge_envs.pages.table import Column, Facts, Place, Table, grid
from gauge_envs.pages.text import (
    digits_text,
    event_title,
    score_text,
    short_id,
    shortened,
    with_unit,
)
from gauge_envs.references.kind import Kind
from gauge_envs.references.metrics import METRICS
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.scoring.answers import Answer, DistanceCause
from gauge_envs.scoring.estimates import ComparedQuantity
from gauge_envs.scoring.interval import COVERAGE_FACTOR
from gauge_envs.scoring.score import FROM_SOLUTION, Score
from gauge_envs.tools.run.plan import PlannedRun, episode_count

MAX_EXPLAINED = 5
"""Maximum number of results with explanations below their rows."""

NOTES = {
    "trials": "Trials: mean distance of real trials.",
    "exact": "Exact: distance of the exact motion with the same constants.",
}
"""Meaning of columns, by key."""

COLUMNS = (
    Column("id", "id", short_id),
    Column("label", "run"),
    Column("distance", "distance", is_number=True),
    Column("motion", "motion", score_text, is_number=True),
    Column("trials", "trials", score_text, is_number=True),
    Column("exact", "exact", score_text, is_number=True),
    Column("solves", "solves"),
    Column("like_reality", "like reality"),
    Column("event", "event", place=Place.BELOW),
    Column("cause", "cause", place=Place.BELOW),
)
"""Columns of the summary; empty columns are left out."""

PHRASES = {
    "friction": "slides as with friction {}",
    "restitution": "rebounds with restitution {}",
    "pd": "swings in {}",
    "frequency": "swings at {}",
    "swing_frequency_hz": "swings at {}",
    "droop": "droops by {}",
    "lsd": "the last ball rests for {}",
    "mte": "passes on {} of the momentum",
    "el": "loses {} of the energy",
}
"""Description of a motion, by estimate or event."""

MISSING = {"friction": "does not slide"}
"""Description of a motion without an estimate or event."""


def summary_document(results: Sequence[Result], *, details: bool = False) -> Document:
    """Return a row and an explanation for each result, and the reasons for missing results.

    Args:
        results: The results.
        details: Whether to show all numbers of the scores.
    """
    ran = [result for result in results if result.error is None]
    summary = _summary(ran, details=details) if ran else ()
    return Document(parts=[*summary, *_outcomes(results)])


def answers_text(results: Sequence[Result]) -> str:
    """Return how many results solve their scene, how many are like reality, and how many diverged, in one line."""
    scores = [result.score for result in results if not result.diverged]
    texts = [
        _count_text([score.solves for score in scores], "solve their scene"),
        _count_text([score.like_reality for score in scores], "are like reality"),
    ]
    if diverged := len(results) - len(scores):
        texts.insert(0, f"{diverged} of {len(results)} diverged")
    return "; ".join(texts)


def _count_text(answers: Sequence[Answer | None], words: str) -> str:
    """Return how many answers are yes, as `1 of 4 are like reality`, and how many cannot be told."""
    known = [answer for answer in answers if answer is not None]
    if not known:
        return f"no data says whether they {words}"
    text = f"{known.count(Answer.YES)} of {len(known)} {words}"
    if unknown := known.count(Answer.CANNOT_TELL):
        text += f" ({unknown} cannot be told)"
    return text


def _summary(results: Sequence[Result], *, details: bool) -> Iterator[Part]:
    """Yield the common configuration, a row for each result, and the details."""
    texts = [_configuration_texts(result) for result in results]
    shared = [text for text in texts[0] if all(text in other for other in texts)]
    rows = []
    for result, own in zip(results, texts, strict=True):
        row = _row(result)
        row["label"] = ", ".join(text for text in own if text not in shared)
        if details or len(results) <= MAX_EXPLAINED:
            row |= _explanation(result)
        rows.append(row)
    filled = {
        key for row in rows for key, value in row.items() if value not in (None, "")
    }
    columns = [column for column in COLUMNS if column.key in filled]
    yield Paragraph(f"{answers_text(results)}.", Tone.ANSWER)
    yield Paragraph(", ".join(shared), Tone.NOTE)
    notes = [note for key, note in NOTES.items() if key in filled]
    note = " ".join([*notes, "More: --details"])
    yield Table(columns=tuple(columns), rows=rows, notes=(note,))
    if details:
        for result, row in zip(results, rows, strict=True):
            yield Heading(f"{short_id(result.id)} {row['label']}".rstrip())
            yield Facts(_details(result.score))


def _configuration_texts(result: Result) -> list[str]:
    """Return the parts of the configuration of a result, and its seed."""
    parts = configuration_parts(RunConfiguration.of(result))
    texts = [text for _, text in parts]
    if result.seed:
        texts.append(f"seed {result.seed}")
    return texts


def _row(result: Result) -> dict[str, Any]:
    """Return the row of a result without its explanation."""
    score = result.score
    if result.diverged:
        return {"id": result.id, "solves": Outcome.DIVERGED.value}
    distance = None
    if score.distance is not None:
        distance = with_unit(score_text(score.distance), score.distance_unit)
    return {
        "id": result.id,
        "distance": distance,
        "motion": score.solution_motion,
        "trials": _trials_distance(score),
        "exact": _exact_distance(score),
        "solves": score.solves or "no solution",
        "like_reality": score.like_reality or "no real data",
    }


def _trials_distance(score: Score) -> float | None:
    """Return the mean distance of real trials, in `distance_unit`; None for a solution."""
    if score.primary == FROM_SOLUTION or not score.distance:
        return None
    return score.primary_normalized and score.distance / score.primary_normalized


def _exact_distance(score: Score) -> float | None:
    """Return the distance of the exact motion with the same constants, in `distance_unit`; None without one."""
    of_trials = _trials_distance(score)
    if score.exact is None or of_trials is None:
        return None
    return score.exact * of_trials


def _explanation(result: Result) -> dict[str, Any]:
    """Return the texts below the row of a result."""
    score = result.score
    if result.diverged:
        return {}
    texts = [motion_text(score)]
    if (count := score.compared_frames) is not None and count < result.frames:
        texts.append(f"compared at {count} of {result.frames} frames")
    cause = score.refused or cause_text(score, result.parameters)
    if result.is_edited and score.refused is None:
        cause = f"modified: {shortened(result.asset['changes'])}"
    return {"event": "; ".join(filter(None, texts)), "cause": cause}


def motion_text(score: Score) -> str | None:
    """Return the estimate or event with the largest deviation from its real value in u, or the first one."""
    quantities = {**score.estimates, **score.events}
    if not quantities:
        return None
    name = max(quantities, key=lambda name: _deviation(quantities[name]))
    quantity = quantities[name]
    text = MISSING.get(name, f"{event_title(name)} does not happen")
    if quantity.value is not None:
        phrase = PHRASES.get(name, f"{event_title(name)} {{}}")
        text = phrase.format(with_unit(digits_text(quantity.value), quantity.unit))
    if quantity.real is None:
        return text
    # Estimates and published metrics come from several trials; the remaining events come from one recording.
    is_of_trials = name in score.estimates or name in METRICS
    owner = "real trials" if is_of_trials else "the recording"
    if score.kind == Kind.PUBLISHED:
        owner = "published trials"
    return f"{text}; {owner} {_real_text(quantity)}"


def _deviation(quantity: ComparedQuantity) -> float:
    """Return the deviation from the real value, divided by its standard uncertainty; 0 if unknown."""
    if quantity.real is None or not quantity.real_uncertainty:
        return 0.0
    if quantity.value is None:
        return math.inf
    return abs(quantity.value - quantity.real) / quantity.real_uncertainty


def _real_text(quantity: ComparedQuantity) -> str:
    """Return the real value with its standard uncertainty."""
    text = digits_text(quantity.real)
    if quantity.real_uncertainty:
        text += f" +- {digits_text(quantity.real_uncertainty)}"
    return with_unit(text, quantity.unit)


def cause_text(score: Score, parameters: str | Mapping[str, Any]) -> str | None:
    """Return the cause of the distance, one sentence; None without an exact motion, or if the motion is near reality.

    Args:
        score: The score.
        parameters: Name of the parameter set, or the values of the user.
    """
    exact_distance = _exact_distance(score)
    if exact_distance is None:
        return None
    exact = with_unit(score_text(exact_distance), score.distance_unit)
    if score.cause is DistanceCause.CONSTANTS:
        wrong = _wrong_constants(score, parameters)
        return f"An exact solver is also {exact} off: {wrong}, not the engine."
    texts = {
        DistanceCause.ENGINE: "the engine or its settings are wrong, not the constants",
        DistanceCause.BOTH: "both the engine and the constants are wrong",
    }
    if score.cause in texts:
        return f"An exact solver is {exact} off: {texts[score.cause]}."
    return None


def _wrong_constants(score: Score, parameters: str | Mapping[str, Any]) -> str:
    """Return which constants of an exact motion are wrong, as `the published friction is wrong`."""
    names = [
        event_title(name)
        for name, quantity in score.estimates.items()
        if _deviation(quantity) > COVERAGE_FACTOR
    ]
    if not names:
        return "the constants or the start of the scene are wrong"
    owner = parameters if isinstance(parameters, str) else "given"
    verb = "is" if len(names) == 1 else "are"
    return f"the {owner} {' and '.join(names)} {verb} wrong"


def _details(score: Score) -> dict[str, str]:
    """Return all numbers of a score by name."""
    facts = {
        key: ", ".join(map(digits_text, np.atleast_1d(value)))
        for key, value in score.to_dict().items()
        if isinstance(value, float | int | tuple | list)
    }
    for key, quantity in {**score.estimates, **score.events}.items():
        facts[key] = with_unit(digits_text(quantity.value), quantity.unit)
        if quantity.real is not None:
            facts[key] += f", real {_real_text(quantity)}"
    return facts


def _outcomes(results: Sequence[Result]) -> Iterator[Paragraph]:
    """Yield a line for each reason, with the experiments that it applies to."""
    ids_of: dict[tuple[Outcome, str], list[str]] = {}
    for result in results:
        if reason := result.error or result.diverged_reason:
            name = short_id(result.id)
            reason = reason.replace(f"{result.id}: ", "").removeprefix(f"{name} ")
            ids_of.setdefault((result.outcome, reason), []).append(name)
    for (outcome, reason), ids in ids_of.items():
        text = f"{outcome.value}: {shortened(ids)}: {reason}"
        yield Paragraph(text, Tone.WARNING)


def totals_text(results: Sequence[Result], out: Path) -> str:
    """Return the number of results of each outcome, and their folder."""
    counts = Counter(result.outcome.value for result in results)
    parts = [f"{number} {outcome}" for outcome, number in counts.items()]
    return f"{', '.join(parts) or 'no episode finished'}; results in {out}"


def has_failed(
    outcomes: Iterable[tuple[str, Outcome]], patterns: Sequence[str]
) -> bool:
    """Return whether a run has exit code 1.

    Args:
        outcomes: Id or name of the experiment and outcome of each episode.
        patterns: Requested ids, patterns and task files; experiments of a pattern may be unsupported.
    """
    named: set[str] = set()
    for pattern in patterns:
        if not is_glob(pattern):
            named |= {variant.name for variant in matching_variants(pattern)}
    for name, outcome in outcomes:
        if outcome in (Outcome.FAILED, Outcome.DIVERGED):
            return True
        if outcome is Outcome.UNSUPPORTED and short_id(name) in named:
            return True
    return False


# --- sweeps ---

COUNTS = {
    "runs": "runs",
    "episodes": "episodes",
    "left": "left",
    "unsupported": "unsupported",
    "simulated_s": "simulated [s]",
}
"""Numbers of a plan and their titles."""


def plan_document(runs: Sequence[PlannedRun], done: Container[str]) -> Document:
    """Return the episodes of a plan and those that are left, for each engine.

    The JSON rows have the numbers for each engine and experiment.

    Args:
        runs: The plan, grouped by engine and experiment.
        done: Names of the existing result files.
    """
    numbers = [
        Column(key, title, digits_text, is_number=True) for key, title in COUNTS.items()
    ]
    engines = list(_rows(runs, done, "backend"))
    return Document(
        parts=[Table(columns=(Column("backend", "engine"), *numbers), rows=engines)],
        rows=list(_rows(runs, done, "backend", "experiment")),
    )


def _rows(
    runs: Iterable[PlannedRun], done: Container[str], *keys: str
) -> Iterator[dict[str, Any]]:
    """Yield the counts of neighbouring runs with equal attributes `keys`."""
    for _, group in groupby(runs, attrgetter(*keys)):
        members = list(group)
        first = members[0]
        left = [run for run in members for name in run.file_names if name not in done]
        yield {
            "backend": first.backend,
            "experiment": first.experiment,
            "runs": len(members),
            "episodes": episode_count(members),
            "left": len(left),
            "unsupported": episode_count(run for run in members if run.unsupported),
            "reason": first.unsupported,
            "simulated_s": sum(run.duration_s for run in left if not run.unsupported),
        }


def outcome_table(episodes: Iterable[tuple[str, str, Outcome]]) -> Table:
    """Return the number of episodes of each engine and outcome.

    Args:
        episodes: Engine, experiment and outcome of each episode.
    """
    counts = Counter((backend, outcome.value) for backend, _, outcome in episodes)
    rows = [(*key, str(count)) for key, count in sorted(counts.items())]
    return grid(("engine", "outcome", "episodes"), rows, number_from=2)
