"""Comparisons of two training configurations in words."""

from collections import Counter

from gauge_envs.pages.document import (
    Document,
    Heading,
    Paragraph,
    Part,
    Tone,
)
from gauge_envs.pages.table import Column, Facts, Place, Table
from gauge_envs.pages.text import counted, with_unit
from gauge_envs.tools.sanity.comparison import Change, ChangeRow, Comparison
from gauge_envs.tools.sanity.words import MOST_NAMED, by_reason, measured_text

MOST_PARTS = 4
"""Largest number of links, joints or motors that a row of a comparison names; JSON has all."""

CHANGE_STYLES = {
    Change.NONE: "green",
    Change.VISIBLE: "yellow",
    Change.LARGE: "bold red",
    Change.UNKNOWN: "dim",
    Change.NEITHER: "dim",
}

COMPARISON_LEGEND = (
    "same: no real trial could resolve the difference, or it is within the tolerance of the law; visible: up to 2.5 "
    "times as much; large: more; unknown: one of the two was not measured. What models state of links, joints and "
    "motors is the same within 5 %; places and angles within 1 mm, 2 mm for centres of mass, and 0.01 rad. A dash: no "
    "limit, or no such part."
)


def comparison_document(comparison: Comparison) -> Document:
    """Return the largest change, both sources, and the table; its rows are both configurations, then each row."""
    whole = comparison.to_dict()
    rows = whole.pop("rows")
    answer, table = (
        Paragraph(comparison_line(comparison), Tone.ANSWER),
        _change_table(comparison),
    )
    return Document(
        parts=(
            answer,
            Paragraph(""),
            Heading(f"{comparison.trained.name} against {comparison.deployed.name}"),
            Facts(
                {
                    "trained": comparison.trained.source,
                    "deployed": comparison.deployed.source,
                }
            ),
            table,
            *_neither(comparison),
            Paragraph(""),
            Paragraph(COMPARISON_LEGEND, Tone.NOTE),
        ),
        rows=[whole, *rows],
        markdown=(answer, table, *_neither(comparison)),
    )


def _neither(comparison: Comparison) -> list[Part]:
    """Return a line for each reason why rows are not compared, with these rows."""
    return by_reason(
        "not compared",
        [
            (row.remark, row.id)
            for row in comparison.rows
            if row.change is Change.NEITHER
        ],
    )


def comparison_line(comparison: Comparison) -> str:
    """Return the largest changes in one line."""
    changed = comparison.changed
    if not changed:
        return f"Nothing changes in {', '.join(_change_counts(comparison))}"
    named = [
        f"{row.title}{f' ({row.parts[0].name})' if row.parts else ''}: from "
        + with_unit(
            f"{measured_text(row.trained)} to {measured_text(row.deployed)}", row.unit
        )
        for row in changed[:MOST_NAMED]
    ]
    others = ", ".join(row.id for row in changed[MOST_NAMED:])
    compared, *missing = _change_counts(comparison)
    texts = [
        f"{len(changed)} of {compared} change",
        *missing,
        f"most of all {'; then '.join(named)}",
        f"then {others}" if others else "",
    ]
    return "; ".join(filter(None, texts))


def _change_counts(comparison: Comparison) -> list[str]:
    """Return how many rows were compared, are unknown, and were not compared."""
    found = Counter(row.change for row in comparison.rows)
    unknown, neither = found[Change.UNKNOWN], found[Change.NEITHER]
    compared = counted(len(comparison.rows) - unknown - neither, "row")
    others = {"unknown": unknown, Change.NEITHER.value: neither}
    return [compared, *(f"{count} {word}" for word, count in others.items() if count)]


def change_text(row: ChangeRow) -> str:
    """Return what changes in a row, in one line."""
    values = f"{measured_text(row.trained)} to {measured_text(row.deployed)}"
    found = _parts_text(row) or values
    return "; ".join(
        filter(None, (f"{row.title}: {with_unit(found, row.unit)}", row.remark))
    )


def _parts_text(row: ChangeRow) -> str:
    """Return the links, joints or motors that change most, with both values."""
    named = [
        f"{one.name} {measured_text(one.trained)} to {measured_text(one.deployed)}"
        for one in row.parts[:MOST_PARTS]
    ]
    if len(row.parts) > MOST_PARTS:
        named.append(f"and {len(row.parts) - MOST_PARTS} more")
    return ", ".join(named)


def _change_table(comparison: Comparison) -> Table:
    def difference(row: ChangeRow) -> str:
        known = row.trained is not None and row.deployed is not None
        return (
            with_unit(f"{(row.deployed or 0.0) - (row.trained or 0.0):+.3g}", row.unit)
            if known
            else "-"
        )

    def below(row: ChangeRow) -> str:
        title = row.title if row.change in (Change.VISIBLE, Change.LARGE) else ""
        return "; ".join(filter(None, (title, _parts_text(row), row.remark)))

    return Table(
        columns=(
            Column("id", "id"),
            Column("title", "quantity", wide_only=True),
            Column("trained", "trained", measured_text, is_number=True),
            Column("deployed", "deployed", measured_text, is_number=True),
            Column("", "difference", difference, is_number=True),
            Column(
                "change",
                "change",
                lambda change: change.value,
                style=CHANGE_STYLES.__getitem__,
            ),
            Column("", "", below, place=Place.BELOW),
        ),
        rows=[row for row in comparison.rows if row.change is not Change.NEITHER],
    )
