"""Tables of scores: against real trials, and from a solution of the scene."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from gauge_envs.pages.results import (
    ALIGNED,
    PLAIN,
    SCORE_METRICS,
    VERIFICATION_NOTE,
    configuration_parts,
    versions_text,
)
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import (
    NORMALIZED_NOTE,
    interval_text,
    plus_minus_text,
    reality_notes,
    reality_of,
    score_text,
    short_id,
    with_unit,
)
from gauge_envs.references.published import PUBLISHED_ENGINES
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.result import Outcome
from gauge_envs.scoring.verification import Verification
from gauge_envs.tools.compare.comparison import Cell, Comparison
from gauge_envs.tools.compare.grades import (
    grade_name,
)

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


def score_table(comparison: Comparison, rows: Sequence[dict[str, Any]]) -> Table:
    """Return rows of `comparison_rows` as a table, the percentile above each primary metric."""
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


def verification_table(comparison: Comparison) -> Table:
    """Return how well each configuration solves the scenes of laws and solved models."""
    rows = []
    for experiment in comparison.experiments:
        by_cell = [_verifications(cell) for cell in experiment.cells]
        firsts: dict[str, Verification] = {}
        for verifications in by_cell:
            for verified in verifications:
                firsts.setdefault(verified.quantity, verified)
        for quantity, first in firsts.items():
            cells = []
            for verifications in by_cell:
                repeats = [one for one in verifications if one.quantity == quantity]
                cells.append(verification_cell(repeats))
            rows.append(
                {
                    "id": experiment.id,
                    "grade": first.grade,
                    "quantity": quantity,
                    "frozen": with_unit(score_text(first.frozen), first.unit),
                    "cells": cells,
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
                Column(f"cells.{index}", label, is_number=True)
                for index, label in enumerate(comparison.labels)
            ),
        ),
        rows=rows,
        notes=(VERIFICATION_NOTE,),
    )


def _verifications(cell: Cell | None) -> list[Verification]:
    """Return what the repeats of a configuration have beside solutions, of all quantities."""
    if cell is None:
        return []
    found: list[Verification] = []
    for result in cell.results:
        found += result.score.verifications
    return found


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
        text = interval_text(spread["mean"], normalized and one["normalized_95"])
        if spread["std"] is not None:
            text += f" +- {score_text(spread['std'])} ({spread['count']})"
        texts.append(text if normalized else with_unit(text, row["unit"]))
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
    yield NORMALIZED_NOTE
    if any("[" in cell for cell in used):
        yield INTERVAL_NOTE
    meanings = []
    for word, meaning in CELL_NOTES.items():
        is_used = word in used if word == "-" else any(word in cell for cell in used)
        if is_used:
            meanings.append(meaning)
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
        others_parts = [configuration_parts(one, digits=17) for one in others]
        shared = []
        for exact, shown in zip(
            configuration_parts(first, digits=17),
            configuration_parts(first),
            strict=True,
        ):
            if all(exact in parts for parts in others_parts):
                shared.append(shown[1])
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
