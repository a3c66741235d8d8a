"""Summarize scores on one screen, with details, and give the reasons for missing results."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from gauge_envs.pages.document import Document, Heading, Paragraph, Part, Tone
from gauge_envs.pages.results import configuration_parts
from gauge_envs.pages.table import Column, Facts, Place, Table
from gauge_envs.pages.text import (
    digits_text,
    event_title,
    interval_text,
    score_text,
    short_id,
    shortened,
    with_unit,
)
from gauge_envs.references.metrics import METRICS
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.scoring.estimates import ComparedQuantity
from gauge_envs.scoring.score import OVER_U, Score, ScoreVerdict

MAX_EXPLAINED = 5
"""Maximum number of results with explanations below their rows."""

EQUAL_SHARE = 0.1
"""Largest relative difference between the distances of an engine and an exact solution that count as equal.

The difference is divided by the distance, at least by the mean distance of real trials."""

NOTE = (
    "Distances are divided by the mean distance of real trials, or by u, the standard uncertainty. "
    "[95 % interval]. More: --details"
)

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


def summary_document(results: Sequence[Result], *, details: bool = False) -> Document:
    """Return a row and an explanation for each result, and the reasons for missing results.

    Args:
        results: The results.
        details: Whether to show all numbers of the scores.
    """
    ran = [result for result in results if result.error is None]
    summary = _summary(ran, details=details) if ran else ()
    return Document(parts=[*summary, *_outcomes(results)])


def _summary(results: Sequence[Result], *, details: bool) -> Iterator[Part]:
    """Yield the common configuration, a row for each result, and the details."""
    parts = [
        [text for _, text in configuration_parts(RunConfiguration.of(result))]
        + ([f"seed {result.seed}"] if result.seed else [])
        for result in results
    ]
    shared = [text for text in parts[0] if all(text in texts for texts in parts)]
    labels = [
        ", ".join(text for text in texts if text not in shared) for texts in parts
    ]
    is_explained = details or len(results) <= MAX_EXPLAINED
    rows = [
        _row(result, is_explained=is_explained) | {"label": label}
        for result, label in zip(results, labels, strict=True)
    ]
    columns = [
        column
        for column in COLUMNS
        if any(row.get(column.key) not in (None, "") for row in rows)
    ]
    yield Paragraph(", ".join(shared), Tone.NOTE)
    yield Table(columns=tuple(columns), rows=rows, notes=(NOTE,))
    if details:
        for result, label in zip(results, labels, strict=True):
            yield Heading(f"{short_id(result.id)} {label}".rstrip())
            yield Facts(_details(result.score))


def _row(result: Result, *, is_explained: bool) -> dict[str, Any]:
    score = result.score
    row: dict[str, Any] = {"id": result.id, "kind": score.kind, "exact": score.exact}
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
        texts = [motion_text(score)]
        if (count := score.compared_frames) is not None and count < result.frames:
            texts.append(f"compared at {count} of {result.frames} frames")
        row["motion"] = "; ".join(filter(None, texts))
        row["cause"] = score.refused or cause_text(score)
        if result.is_edited and score.refused is None:
            row["cause"] = f"modified: {shortened(result.asset['changes'])}"
    return row


def motion_text(score: Score) -> str | None:
    """Return the estimate or event with the largest deviation from its real value in u, or the first one."""
    quantities = {**score.estimates, **score.events}
    if not quantities:
        return None
    name = max(quantities, key=lambda name: _deviation(quantities[name]))
    quantity = quantities[name]
    text = f"{event_title(name)} does not happen"
    if quantity.value is not None:
        phrase = PHRASES.get(name, f"{event_title(name)} {{}}")
        text = phrase.format(with_unit(digits_text(quantity.value), quantity.unit))
    if quantity.real is None:
        return text
    # Estimates and published metrics come from several trials; the remaining events come from one recording.
    is_of_trials = name in score.estimates or name in METRICS
    owner = "real trials" if is_of_trials else "the recording"
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


def cause_text(score: Score) -> str | None:
    """Return the cause of the distance, engine or constants; None without an exact solution."""
    engine, exact = score.primary_normalized, score.exact
    if engine is None or exact is None:
        return None
    if abs(engine - exact) <= EQUAL_SHARE * max(engine, exact, 1.0):
        cause = "the constants, not the engine"
        if score.verdict is ScoreVerdict.INSIDE:
            cause = "the engine agrees with the exact solution"
    elif engine > exact:
        cause = "the engine differs from an exact solution"
    else:
        cause = "errors of the engine and of the constants cancel in part"
    return f"engine {digits_text(engine)}, exact {digits_text(exact)}: {cause}"


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
