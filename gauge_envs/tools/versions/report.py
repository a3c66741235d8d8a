"""Reports of a comparison: the answer, and what a maintainer needs to see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from gauge_envs.pages.document import Bullets, Document, Paragraph, Part, Tone
from gauge_envs.pages.table import Column, Table
from gauge_envs.pages.text import counted, interval_text, quantity_text, value_text
from gauge_envs.tools.versions.schema import (
    Comparison,
    Estimate,
    MotionComparison,
    ReturnComparison,
    Verdict,
)

if TYPE_CHECKING:
    from gauge_envs.tools.compare import Comparison as ScoreComparison


def comparison_document(comparison: Comparison) -> Document:
    """Return the answer, where the sides differ first and most, the tables of differences, and which side is right."""
    sides = f"{comparison.before} and {comparison.after}"
    states = counted(comparison.states, "state")
    is_different = comparison.verdict is Verdict.DIFFERENT
    if is_different:
        answer = (
            f"{sides} differ on {comparison.subject}: in {comparison.differing} of {states} one step from the same "
            f"state gives other accelerations, by up to {100.0 * comparison.largest:.3g} %."
        )
    else:
        how = f"within its noise: accelerations differ by {100.0 * comparison.largest:.1g} % or less"
        if comparison.verdict is Verdict.IDENTICAL:
            how = "bit for bit"
        answer = (
            f"{sides} compute the same on {comparison.subject}, {how}, in {states}."
        )
    parts: list[Part] = [
        _table(
            "Releases that were tried",
            comparison.tried,
            "release from_first from_last like",
        ),
        Paragraph(answer, Tone.ANSWER),
        _table("Compiled fields", comparison.fields, "field where count before after"),
        _table(
            "Laws: the largest miss of each side, as a fraction",
            comparison.rulings,
            "law before after states right",
        ),
    ]
    titles = (comparison.before, comparison.after)
    for title, dropped in zip(titles, comparison.dropped, strict=True):
        if dropped:
            text = f"{title} does not know, and runs without: {', '.join(dropped)}."
            parts.append(Paragraph(text, Tone.WARNING))
    if is_different:
        right = "No law that was checked shows which side is right."
        if comparison.right:
            right = f"{comparison.right} is right, by the laws above."
        parts.append(Paragraph(right, Tone.ANSWER))
        parts.insert(
            2, Bullets(_differences(comparison), "One step from the same state")
        )
    shown = [part for part in parts if getattr(part, "rows", True)]
    return Document(parts=shown, rows=[asdict(comparison)])


def _differences(comparison: Comparison) -> list[str]:
    """Return where the sides differ first and most."""
    # Where the first difference is the largest one, the second name is overwritten.
    partings = {comparison.worst: "largest", comparison.first: "first"}
    return [
        f"{name}: step {each.step} of {each.segment}, a state of {each.of}; {each.quantity}: {each.detail}; "
        f"{each.where}: {each.acceleration_before:.5g} and {each.acceleration_after:.5g} (m/s^2 or rad/s^2)"
        for each, name in reversed(partings.items())
        if each
    ]


def motions_document(comparison: MotionComparison, scores: ScoreComparison) -> Document:
    """Return where two motions differ first, and the scores of both."""
    from gauge_envs.tools.compare import short_tables

    sides = f"{comparison.before} and {comparison.after}"
    largest = f"{quantity_text(comparison.largest)} {comparison.unit}"
    noise = f"{quantity_text(comparison.noise)} {comparison.unit}, from an initial position 1e-9 m apart"
    parts: list[Part] = list(short_tables(scores))
    if comparison.verdict is Verdict.DIFFERENT:
        answer = (
            f"{sides} give different motions of {comparison.subject}: {comparison.coordinate} differs first, after "
            f"{comparison.first_s:.3g} s by {quantity_text(comparison.difference)} {comparison.unit} (noise: {noise}). "
            f"The largest difference is {largest}."
        )
        right = f"{comparison.right or 'Neither side'} is closer to the reference beyond its uncertainty."
        parts.append(Paragraph(right, Tone.ANSWER))
    else:
        how = f"within its noise: they differ by {largest} or less (noise: {noise})"
        if comparison.verdict is Verdict.IDENTICAL:
            how = "bit for bit"
        answer = f"{sides} give the same motion of {comparison.subject}, {how}."
    return Document(
        parts=[Paragraph(answer, Tone.ANSWER), *parts], rows=[asdict(comparison)]
    )


RETURNS = {
    Verdict.IDENTICAL: "equal returns, bit for bit,",
    Verdict.SAME: "returns that do not differ significantly",
    Verdict.DIFFERENT: "different mean returns or successes",
}


def returns_document(comparison: ReturnComparison) -> Document:
    """Return what a policy reaches on both sides."""
    rows = [
        ("return", *comparison.returns, comparison.change),
        ("success", *comparison.success, comparison.success_change),
    ]
    names = ("name", "before", "after", "change")
    table = _table(
        "Means with 95 % intervals; the change is seed by seed",
        [dict(zip(names, row, strict=True)) for row in rows],
        "name before after change",
    )
    answer = (
        f"{comparison.before} and {comparison.after} give {RETURNS[comparison.verdict]} in {comparison.subject}, over "
        f"{counted(comparison.seeds, 'seed')}."
    )
    return Document(
        parts=[Paragraph(answer, Tone.ANSWER), table], rows=[asdict(comparison)]
    )


def _table(title: str, rows: Sequence[Any], names: str) -> Table:
    """Return a table of values by their names."""
    columns = [Column(name, name.replace("_", " "), _text) for name in names.split()]
    return Table(title=title, columns=tuple(columns), rows=rows)


def _text(value: Any) -> str:
    """Return a value of a row: a number, an estimate, or a list."""
    if isinstance(value, Estimate):
        interval = None if value.low is None else (value.low, value.high or 0.0)
        return interval_text(value.value, interval, lambda number: f"{number:.4g}")
    if isinstance(value, float):
        return quantity_text(value)
    if isinstance(value, list | tuple):
        return ", ".join(map(_text, value)) or "none"
    return value_text(value)
