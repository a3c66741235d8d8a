"""What two versions make of a model, as a document that a maintainer can read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from gauge_envs.pages.document import Bullets, Document, Paragraph, Part, Tone
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import (
    counted,
    interval_text,
    quantity_text,
    value_text,
)
from gauge_envs.tools.versions.gap import pair_text
from gauge_envs.tools.versions.model import (
    Comparison,
    Estimate,
    MotionComparison,
    Parting,
    Release,
    ReturnComparison,
    Verdict,
)

if TYPE_CHECKING:
    from gauge_envs.tools.compare import Comparison as ScoreComparison

SHOWN_PAIRS = 8
"""Pairs of geoms that a terminal shows."""

CANNOT_TELL = "Nothing here can tell which side is right: no law that was checked tells them apart."

NOISE_NOTE = (
    "A difference counts above ten times the noise of its state, and above what the tolerance of the solver allows, "
    "1e-4 by default. The noise is what a start that is 1e-10 apart, and a solver without its warm start, change on "
    "the quieter side. Each state is computed on both sides from itself, for one step, so that chaos adds nothing."
)


def comparison_document(found: Comparison, tried: Sequence[Release] = ()) -> Document:
    """Return what differs: the answer, where the sides part, fields, contacts, ends, laws."""
    parts: list[Part] = [Paragraph(answer(found), Tone.ANSWER)]
    if tried:
        parts.insert(0, _releases_table(tried))
    if found.first is not None and found.worst is not None:
        parts.append(Bullets(_parting_lines(found.first, found), "They part first"))
        if found.worst != found.first:
            parts.append(Bullets(_parting_lines(found.worst, found), "They part most"))
    parts += _tables(found)
    if found.verdict is Verdict.DIFFERENT:
        text = (
            f"{found.right} is right, by the laws above."
            if found.right
            else CANNOT_TELL
        )
        parts += [Paragraph(""), Paragraph(text, Tone.ANSWER)]
    for side, dropped in zip((found.before, found.after), found.dropped, strict=True):
        if dropped:
            text = f"{side} does not know, and runs without: {', '.join(dropped)}."
            parts.append(Paragraph(text, Tone.NOTE))
    if found.new_fields:
        count = counted(len(found.new_fields), "compiled field")
        text = f"{count} exist on one side alone; --json names them."
        parts.append(Paragraph(text, Tone.NOTE))
    parts.append(Paragraph(NOISE_NOTE, Tone.NOTE))
    return Document(
        parts=parts, rows=[asdict(found) | {"tried": list(map(asdict, tried))}]
    )


def answer(found: Comparison) -> str:
    """Return the verdict in a sentence."""
    sides = f"{found.before} and {found.after}"
    states = counted(found.states, "state")
    if found.verdict is Verdict.IDENTICAL:
        return f"{sides} compute the same on {found.subject}, bit for bit, in {states}."
    if found.verdict is Verdict.SAME:
        return (
            f"{sides} compute the same on {found.subject} within its noise: in {states} the accelerations part by "
            f"{quantity_text(found.largest)} or less."
        )
    return (
        f"{sides} differ on {found.subject}: in {found.differing} of {states} one step from the same state gives other "
        f"accelerations, by up to {_percent(found.largest)}."
    )


def motions_document(found: MotionComparison, scores: ScoreComparison) -> Document:
    """Return where two motions part, and the scores of both."""
    from gauge_envs.tools.compare import short_tables

    sides = f"{found.before} and {found.after}"
    noise = f"a start 1e-9 m apart changes {quantity_text(found.noise)} {found.unit}"
    if found.verdict is Verdict.IDENTICAL:
        text = f"{sides} give the same motion of {found.subject}, bit for bit."
    elif found.verdict is Verdict.SAME:
        text = (
            f"{sides} give the same motion of {found.subject} within its noise: they part by "
            f"{quantity_text(found.largest)} {found.unit} or less; {noise}."
        )
    else:
        text = (
            f"{sides} give other motions of {found.subject}: they part first after {found.first_s:.3g} s, in "
            f"{found.coordinate}, by {quantity_text(found.difference)} {found.unit}; until then {noise}. They part by "
            f"up to {quantity_text(found.largest)} {found.unit}."
        )
    parts: list[Part] = [Paragraph(text, Tone.ANSWER)]
    parts += short_tables(scores)
    if found.verdict is Verdict.DIFFERENT:
        right = f"{found.right} is closer to the reference." if found.right else NEITHER
        parts += [Paragraph(""), Paragraph(right, Tone.ANSWER)]
    return Document(parts=parts, rows=[asdict(found)])


NEITHER = "Nothing here can tell which side is right: no score tells them apart."


def returns_document(found: ReturnComparison) -> Document:
    """Return what a policy reaches on both sides."""
    sides = f"{found.before} and {found.after}"
    seeds = counted(found.seeds, "seed")
    text = f"{sides} give other returns in {found.subject}, in the mean over {seeds}."
    if found.verdict is Verdict.IDENTICAL:
        text = f"{sides} give the same returns in {found.subject}, bit for bit, from {seeds}."
    elif found.verdict is Verdict.SAME:
        text = (
            f"{sides} give returns in {found.subject} that {seeds} do not tell apart."
        )
    rows = [
        {"name": "return", "sides": found.returns, "change": found.change},
        {"name": "success", "sides": found.success, "change": found.success_change},
    ]
    table = Table(
        title="Means with 95 % intervals; the change is seed by seed",
        columns=(
            Column("name", ""),
            Column(
                "sides", found.before, lambda pair: _estimate(pair[0]), is_number=True
            ),
            Column(
                "sides", found.after, lambda pair: _estimate(pair[1]), is_number=True
            ),
            Column("change", "change", _estimate, is_number=True),
        ),
        rows=rows,
    )
    return Document(parts=[Paragraph(text, Tone.ANSWER), table], rows=[asdict(found)])


def _estimate(value: Estimate | None) -> str:
    if value is None:
        return "not stated"
    ends = None if value.low is None else (value.low, value.high or 0.0)
    return interval_text(value.value, ends, lambda number: f"{number:.4g}")


def _parting_lines(parting: Parting, found: Comparison) -> list[str]:
    both = pair_text(parting.acceleration_before, parting.acceleration_after)
    lines = [
        f"step {parting.step} of {parting.segment}, a state of {parting.of}",
        f"{parting.quantity}: {parting.detail}",
        f"{parting.where}: {both} (m/s^2 or rad/s^2); all accelerations part by {_percent(parting.acceleration)}",
    ]
    for name in ("contacts", "iterations", "warnings"):
        one, two = getattr(parting, f"{name}_before"), getattr(parting, f"{name}_after")
        if one != two:
            lines.append(f"{name}: {one} and {two}")
    return lines


def _tables(found: Comparison) -> list[Part]:
    tables = [
        Table(
            title="Compiled fields and options that differ",
            columns=(
                Column("field", "field"),
                Column("where", "most at"),
                Column("count", "rows", is_number=True),
                Column("before", found.before, _short),
                Column("after", found.after, _short),
            ),
            rows=found.fields,
        ),
        Table(
            title=f"Contacts that differ, in {counted(found.states, 'state')}",
            columns=(
                Column("pair", "pair", " and ".join),
                Column("states_before", "states before", is_number=True),
                Column("states_after", "after", is_number=True),
                Column("contacts_before", "contacts before", is_number=True),
                Column("contacts_after", "after", is_number=True),
                _depth("depth_before_m", "depth before"),
                _depth("depth_after_m", "after"),
            ),
            rows=found.pairs[:SHOWN_PAIRS],
            notes=_more(len(found.pairs)),
        ),
        Table(
            title="Starts that end differently",
            columns=(
                Column("segment", "start"),
                Column("body", "body"),
                Column("end_before", "before"),
                Column("end_after", "after"),
                _length("moved_before_m", "moved before"),
                _length("moved_after_m", "after"),
                _depth("depth_before_m", "deepest before"),
                _depth("depth_after_m", "after"),
                _length("noise_m", "noise"),
            ),
            rows=found.settled,
        ),
        Table(
            title="Laws: by how much each side misses them",
            columns=(
                Column("before", found.before, _percent, is_number=True),
                Column("after", found.after, _percent, is_number=True),
                Column("states", "states", is_number=True),
                Column(
                    "right", "right", lambda right: right or "neither is shown wrong"
                ),
                Column("law", "law", place=Place.BELOW),
            ),
            rows=found.rulings,
        ),
    ]
    return [table for table in tables if table.rows]


def _releases_table(tried: Sequence[Release]) -> Table:
    return Table(
        title="Releases that were tried: root mean square of what counts",
        columns=(
            Column("release", "release"),
            Column("from_first", "from the first", _percent, is_number=True),
            Column("from_last", "from the last", _percent, is_number=True),
            Column("like", "nearer to"),
        ),
        rows=tried,
    )


def _more(count: int) -> tuple[str, ...]:
    hidden = count - SHOWN_PAIRS
    return (f"{counted(hidden, 'pair')} more; --json has all.",) if hidden > 0 else ()


def _percent(fraction: float) -> str:
    return f"{quantity_text(100.0 * fraction)} %"


def _length(key: str, title: str) -> Column:
    return Column(key, title, quantity_text, unit="m", is_number=True)


def _depth(key: str, title: str) -> Column:
    return Column(
        key, title, lambda m: quantity_text(1e3 * m + 0.0), unit="mm", is_number=True
    )


def _short(value: Any) -> str:
    if isinstance(value, list) and len(value) == 1:
        value = value[0]
    return value_text(value) if value not in ([], None) else "none"
