"""Comparisons of two training configurations in words."""

from __future__ import annotations

from gauge_envs.pages.document import Document, Heading, Paragraph, Tone
from gauge_envs.pages.table import Column, Facts, Place, Table
from gauge_envs.pages.text import with_unit
from gauge_envs.tools.sanity.against import Change, ChangeRow, Comparison
from gauge_envs.tools.sanity.words import measured_text

STYLES = {Change.NONE: "green", Change.VISIBLE: "yellow", Change.LARGE: "bold red", Change.UNKNOWN: "dim"}

MOST_NAMED = 2
"""Largest number of changes that the first line names."""

LEGEND = (
    "same: no real trial could resolve the difference, or it is within the tolerance of the law; visible: up to 2.5 "
    "times as much; large: more; unknown: one of the two was not measured."
)


def against_document(comparison: Comparison) -> Document:
    """Return the largest change, both sources, and the table; its rows are both configurations, then each row."""
    whole = comparison.to_dict()
    rows = whole.pop("rows")
    answer, table = Paragraph(against_line(comparison), Tone.ANSWER), _table(comparison)
    return Document(
        parts=(
            answer,
            Paragraph(""),
            Heading(f"{comparison.trained.name} against {comparison.deployed.name}"),
            Facts({"trained": comparison.trained.source, "deployed": comparison.deployed.source}),
            table,
            Paragraph(""),
            Paragraph(LEGEND, Tone.NOTE),
        ),
        rows=[whole, *rows],
        markdown=(answer, table),
    )


def against_line(comparison: Comparison) -> str:
    """Return the largest changes in one line."""
    changed = comparison.changed
    if not changed:
        unknown = sum(row.change is Change.UNKNOWN for row in comparison.rows)
        return "Nothing changes" + (f"; {unknown} rows are unknown" if unknown else "")
    named = "; then ".join(map(_change_text, changed[:MOST_NAMED]))
    return f"{len(changed)} of {len(comparison.rows)} rows change; most of all {named}"


def _change_text(row: ChangeRow) -> str:
    return with_unit(f"{row.title}: from {measured_text(row.trained)} to {measured_text(row.deployed)}", row.unit)


def _table(comparison: Comparison) -> Table:
    return Table(
        columns=(
            Column("id", "id"),
            Column("title", "quantity", wide_only=True),
            Column("trained", "trained", measured_text, is_number=True),
            Column("deployed", "deployed", measured_text, is_number=True),
            Column("", "difference", _difference, is_number=True),
            Column("", "change", lambda row: row.change.value, style=lambda row: STYLES[row.change]),
            Column("", "", _below, place=Place.BELOW),
        ),
        rows=comparison.rows,
    )


def _difference(row: ChangeRow) -> str:
    if row.trained is None or row.deployed is None:
        return "-"
    return with_unit(f"{row.deployed - row.trained:+.3g}", row.unit)


def _below(row: ChangeRow) -> str:
    """Return the title of a row that changes, and its remark."""
    parts = (row.title if row.change in (Change.VISIBLE, Change.LARGE) else "", row.remark)
    return "; ".join(part for part in parts if part)
