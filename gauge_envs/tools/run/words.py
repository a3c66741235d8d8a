"""Scores of results on one screen, all their numbers as details, and what was not run and why."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

from gauge_envs.pages.document import Document, Heading, Paragraph, Part, Tone
from gauge_envs.pages.results import (
    configuration_parts,
    discretization_text,
)
from gauge_envs.pages.table import Column, Facts, Place, Table
from gauge_envs.pages.text import (
    digits_text,
    event_title,
    interval_text,
    plus_minus_text,
    score_text,
    short_id,
    shortened,
    with_unit,
)
from gauge_envs.references.convergence import convergence_rows
from gauge_envs.references.metrics import METRICS
from gauge_envs.references.published import PUBLISHED_ENGINES, published_baselines
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.scoring.estimates import Measured
from gauge_envs.scoring.score import OVER_U, Score

MAX_EXPLAINED = 5
"""Results up to this number have lines below their rows; more of them have rows alone."""

SAME_SHARE = 0.1
"""Difference up to which an engine and an exact solution are equally far from real trials, over that distance.

Of a distance that is shorter than that of real trials, it is over theirs.
"""

NOTE = "Over the mean distance of real trials, or over u, the standard uncertainty. [95 % interval]. More: --details"

COLUMNS = (
    Column("id", "id", short_id),
    Column("label", "run"),
    Column("kind", "kind"),
    Column("distance", "distance", is_number=True),
    Column("scaled", "over real trials or u", is_number=True),
    Column("exact", "exact", digits_text, is_number=True),
    Column("verdict", "verdict"),
    Column("motion", "motion", place=Place.BELOW),
    Column("cause", "cause", place=Place.BELOW),
)
"""Columns of the summary; those without any value are left out."""

PHRASES = {
    "friction": "slides as with friction {}",
    "restitution": "rebounds with restitution {}",
    "period": "swings in {}",
    "pd": "swings in {}",
    "frequency": "swings at {}",
    "swing_frequency_hz": "swings at {}",
    "droop": "droops by {}",
    "lsd": "the last ball rests for {}",
    "mte": "passes on {} of the momentum",
    "el": "loses {} of the energy",
}
"""What a motion does, by estimate or event."""

NO_NUMBERS = ("kind", "unit", "primary", "events", "estimates", "refused")
"""Fields of a score that are no numbers."""

TONES = {
    Outcome.DIVERGED: Tone.ERROR,
    Outcome.FAILED: Tone.ERROR,
    Outcome.DECLINED: Tone.WARNING,
}
"""Outcomes whose reasons are reported."""


def summary_document(results: Sequence[Result], *, details: bool = False) -> Document:
    """Return a row for each result with what its motion implies, and what was not run and why.

    Args:
        results: The results.
        details: Whether to add all numbers of the scores and the published ones.
    """
    ran = [result for result in results if result.error is None]
    summary = _summary(ran, details=details) if ran else ()
    return Document(parts=[*summary, *_outcomes(results)])


def _labels(results: Sequence[Result]) -> tuple[str, list[str]]:
    """Return what the configurations of results share, and what distinguishes each."""
    parts = [
        [text for _, text in configuration_parts(RunConfiguration.of(result))]
        + [f"seed {result.seed or 0}"]
        for result in results
    ]
    shared = [text for text in parts[0] if all(text in one for one in parts)]
    labels = [", ".join(text for text in one if text not in shared) for one in parts]
    return ", ".join(text for text in shared if text != "seed 0"), labels


def _summary(results: Sequence[Result], *, details: bool) -> Iterator[Part]:
    """Yield what the results share, a row for each, and their details."""
    is_explained = details or len(results) <= MAX_EXPLAINED
    shared, labels = _labels(results)
    rows = [
        _summary_row(result, is_explained=is_explained) | {"label": label}
        for result, label in zip(results, labels, strict=True)
    ]
    yield Paragraph(shared, Tone.NOTE)
    known = [
        column
        for column in COLUMNS
        if any(row.get(column.key) not in (None, "") for row in rows)
    ]
    yield Table(columns=tuple(known), rows=rows, notes=(NOTE,))
    for result, label in zip(results if details else (), labels, strict=False):
        yield Heading(f"{short_id(result.id)} {label}".rstrip())
        yield Facts(_details(result))


def _summary_row(result: Result, *, is_explained: bool) -> dict[str, Any]:
    score = result.score
    row: dict[str, Any] = {
        "id": result.id,
        "kind": score.kind,
        "exact": score.exact,
    }
    if result.diverged:
        return row | {"verdict": Outcome.DIVERGED.value}
    row["verdict"] = score.verdict
    if score.distance is not None:
        row["distance"] = with_unit(score_text(score.distance), score.distance_unit)
    if score.primary_normalized is not None:
        text = interval_text(
            score.primary_normalized, score.primary_interval, digits_text
        )
        row["scaled"] = with_unit(text, "u" if score.primary == OVER_U else "1")
    if is_explained:
        row["motion"] = "; ".join(
            filter(None, (motion_text(score), _frames_text(result)))
        )
        row["cause"] = score.refused or cause_text(score)
        if result.is_edited and score.refused is None:
            row["cause"] = f"edited: {shortened(result.asset['changes'])}"
    return row


def _frames_text(result: Result) -> str:
    """Return how many frames the reference judges; empty for all."""
    count = result.score.compared_frames
    if count is None or count >= result.frames:
        return ""
    return f"compared at {count} of {result.frames} frames"


def motion_text(score: Score) -> str | None:
    """Return the estimate or event that is farthest from its real value over u; without real values the first one."""
    found = {**score.estimates, **score.events}
    if not found:
        return None
    name = max(found, key=lambda name: _deviation(found[name]))
    one = found[name]
    if one.value is None:
        text = f"{event_title(name)} does not happen"
    else:
        value = with_unit(_rounded(one.value, one.real_uncertainty), one.unit)
        text = PHRASES.get(name, f"{event_title(name)} {{}}").format(value)
    if one.real is None:
        return text
    # Estimates and published metrics are of several trials, and other events of one recording.
    is_of_trials = name in score.estimates or name in METRICS
    owner = "real trials" if is_of_trials else "the recording"
    return f"{text}; {owner} {_real_text(one)}"


def _deviation(one: Measured) -> float:
    """Return the deviation from the real value over its standard uncertainty; negative if that is not known."""
    if one.real is None or not one.real_uncertainty:
        return -2.0 if one.real is None else -1.0
    if one.value is None:
        return math.inf
    return abs(one.value - one.real) / one.real_uncertainty


def _rounded(value: float, uncertainty: float | None) -> str:
    """Return a value to the first digit of its uncertainty, or the second if the first is 1."""
    if not uncertainty:
        return score_text(value)
    exponent = math.floor(math.log10(uncertainty))
    is_one = uncertainty < 2.0 * 10.0**exponent
    return f"{value:.{max(0, int(is_one) - exponent)}f}"


def _real_text(one: Measured) -> str:
    """Return the real value with its standard uncertainty."""
    assert one.real is not None
    texts = [_rounded(one.real, one.real_uncertainty)]
    if one.real_uncertainty:
        texts.append(_rounded(one.real_uncertainty, one.real_uncertainty))
    return with_unit(" +- ".join(texts), one.unit)


def cause_text(score: Score) -> str | None:
    """Return whether the engine or the constants make the distance from real trials; None without an exact solution."""
    engine, exact = score.primary_normalized, score.exact
    if engine is None or exact is None:
        return None
    numbers = f"engine {digits_text(engine)}, exact {digits_text(exact)}"
    if abs(engine - exact) <= SAME_SHARE * max(engine, exact, 1.0):
        if score.verdict == "inside":
            return f"{numbers}: the engine agrees with the exact solution"
        return f"{numbers}: the constants, not the engine"
    if engine > exact:
        return f"{numbers}: the engine differs from an exact solution"
    return f"{numbers}: errors of the engine and of the constants cancel in part"


def _details(result: Result) -> dict[str, str]:
    """Return all numbers of a score by their names there, the published ones, and what half the step changes."""
    score, name = result.score, short_id(result.id)
    facts = {
        key: _numbers_text(value)
        for key, value in score.to_dict().items()
        if key not in NO_NUMBERS and value is not None
    }
    for key, one in {**score.estimates, **score.events}.items():
        facts[key] = with_unit(digits_text(one.value), one.unit)
        if one.real is not None:
            facts[key] += f", real {_real_text(one)}"
    for key, line in published_baselines(name).items():
        engines = ", ".join(
            f"{title} {score_text(line.engines[engine])}"
            for engine, title in PUBLISHED_ENGINES.items()
        )
        real = plus_minus_text(line.mean, line.std, line.unit)
        facts[f"published {key}"] = f"real trials {real}; {engines}"
    converged = convergence_rows(result.backend, result.id)
    if text := discretization_text(result, converged):
        facts["discretization"] = text
    return facts


def _numbers_text(value: float | Sequence[float]) -> str:
    """Return a number, or several, with three digits."""
    numbers = value if isinstance(value, Sequence) else [value]
    return ", ".join(digits_text(number) for number in numbers)


def _outcomes(results: Sequence[Result]) -> Iterator[Paragraph]:
    """Yield a line for each reason: a backend declines many experiments for the same one."""
    for outcome, tone in TONES.items():
        reasons: dict[str, list[str]] = {}
        for result in results:
            if result.outcome is outcome:
                name = short_id(result.id)
                reason = (result.error or result.diverged_reason or "").replace(
                    f"{result.id}: ", ""
                )
                reasons.setdefault(reason.removeprefix(f"{name} "), []).append(name)
        yield from (
            Paragraph(f"{outcome.value}: {shortened(ids)}: {text}", tone)
            for text, ids in reasons.items()
        )
