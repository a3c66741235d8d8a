"""Report a comparison: the answer, and the details for a maintainer."""

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

DIFFER = {
    Verdict.IDENTICAL: "are equal, bit for bit,",
    Verdict.SAME: "do not differ by more than the noise",
    Verdict.DIFFERENT: "differ",
}


def comparison_document(comparison: Comparison) -> Document:
    """Return the answer, the first and largest difference, the tables of differences, and which side is right."""
    titles = (comparison.before, comparison.after)
    answer = (
        f"{' and '.join(titles)} {DIFFER[comparison.verdict]} on {comparison.subject}: in {comparison.differing} of "
        f"{counted(comparison.states, 'state')} one step from the same state gives different accelerations, by up to "
        f"{100.0 * comparison.largest:.3g} %."
    )
    unknown = [
        f"{title} ignores unknown attributes: {', '.join(dropped)}."
        for title, dropped in zip(titles, comparison.dropped, strict=True)
        if dropped
    ]
    right = "No checked law shows which side is right."
    if comparison.right:
        right = f"{comparison.right} is right, by the laws above."
    parts: list[Part] = [
        _table(
            "Tested releases",
            comparison.tried,
            "release from_first from_last like",
        ),
        Paragraph(answer, Tone.ANSWER),
        _table("Compiled fields", comparison.fields, "field where count before after"),
        _table(
            "Laws: largest relative error of each side",
            comparison.rulings,
            "law before after states right",
        ),
        *(Paragraph(text, Tone.WARNING) for text in unknown),
    ]
    if comparison.verdict is Verdict.DIFFERENT:
        differences = Bullets(_differences(comparison), "One step from the same state")
        parts.insert(2, differences)
        parts.append(Paragraph(right, Tone.ANSWER))
    shown = [part for part in parts if getattr(part, "rows", True)]
    return Document(parts=shown, rows=[asdict(comparison)])


def _differences(comparison: Comparison) -> list[str]:
    """Return the first and the largest difference of the sides."""
    # If the first difference is also the largest, the name `first` replaces `largest`.
    partings = {comparison.worst: "largest", comparison.first: "first"}
    return [
        f"{name}: step {parting.step} of {parting.segment}, a state of {parting.of}; "
        f"{parting.quantity}: {parting.detail}; "
        f"{parting.where}: {parting.acceleration_before:.5g} and {parting.acceleration_after:.5g} (m/s^2 or rad/s^2)"
        for parting, name in reversed(partings.items())
        if parting
    ]


def motions_document(comparison: MotionComparison, scores: ScoreComparison) -> Document:
    """Return the first difference of two motions, and the scores of both."""
    from gauge_envs.tools.compare import short_tables

    unit = comparison.unit
    answer = (
        f"{comparison.before} and {comparison.after} {DIFFER[comparison.verdict]} in the motion of "
        f"{comparison.subject}: the largest difference is {quantity_text(comparison.largest)} {unit} (noise: "
        f"{quantity_text(comparison.noise)} {unit}, from an initial position shifted by 1e-9 m)."
    )
    if comparison.first_s is not None:
        answer += (
            f" {comparison.coordinate} differs first, after {comparison.first_s:.3g} s by "
            f"{quantity_text(comparison.difference)} {unit}. {comparison.right or 'Neither side'} is closer to the "
            "reference beyond its uncertainty."
        )
    return Document(
        parts=[Paragraph(answer, Tone.ANSWER), *short_tables(scores)],
        rows=[asdict(comparison)],
    )


def returns_document(comparison: ReturnComparison) -> Document:
    """Return the returns and successes of a policy on both sides."""
    rows = [
        ("return", *comparison.returns, comparison.change),
        ("success", *comparison.success, comparison.success_change),
    ]
    names = ("name", "before", "after", "change")
    table = _table(
        "Means with 95 % intervals; changes are paired by seed",
        [dict(zip(names, row, strict=True)) for row in rows],
        "name before after change",
    )
    answer = (
        f"{comparison.before} and {comparison.after} {DIFFER[comparison.verdict]} in returns and successes of "
        f"{comparison.subject} over {counted(comparison.seeds, 'seed')}."
    )
    return Document(
        parts=[Paragraph(answer, Tone.ANSWER), table], rows=[asdict(comparison)]
    )


def _table(title: str, rows: Sequence[Any], names: str) -> Table:
    """Return a table with a column for each name."""
    columns = [Column(name, name.replace("_", " "), _text) for name in names.split()]
    return Table(title=title, columns=tuple(columns), rows=rows)


def _text(value: Any) -> str:
    """Return the text of a number, an estimate or a list."""
    if isinstance(value, Estimate):
        interval = None if value.low is None else (value.low, value.high or 0.0)
        return interval_text(value.value, interval, lambda number: f"{number:.4g}")
    if isinstance(value, float):
        return quantity_text(value)
    if isinstance(value, list | tuple):
        return ", ".join(map(_text, value)) or "none"
    return value_text(value)
