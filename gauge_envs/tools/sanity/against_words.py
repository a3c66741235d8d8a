"""Comparisons of two training configurations as a table and as JSON objects."""

from __future__ import annotations

from typing import Any

from rich.console import Group
from rich.text import Text

from gauge_envs.pages.table import Column, Facts, Place, Table, as_markdown, as_rich
from gauge_envs.pages.text import heading, markdown_text
from gauge_envs.tools.sanity.against import Change, ChangeRow, Comparison
from gauge_envs.tools.sanity.words import measured_text

STYLES = {Change.NONE: "green", Change.VISIBLE: "yellow", Change.LARGE: "bold red", Change.UNKNOWN: "dim"}

MOST_NAMED = 2
"""Largest number of changes that the first line names."""

LEGEND = (
    "same: no real trial could resolve the difference, or it is within the tolerance of the law; visible: up to 2.5 "
    "times as much; large: more; unknown: one of the two was not measured."
)


def against_rows(comparison: Comparison) -> list[dict[str, Any]]:
    """Return JSON-ready objects: both configurations and the versions, then each row."""
    whole = comparison.to_dict()
    rows = whole.pop("rows")
    return [whole, *rows]


def against_view(comparison: Comparison, *, wide: bool = False) -> Group:
    """Return a comparison for a terminal: the largest change, both sources, and the table."""
    sources = {"trained": comparison.trained.source, "deployed": comparison.deployed.source}
    return Group(
        Text(against_line(comparison), style="bold"),
        Text(""),
        heading(f"{comparison.trained.name} against {comparison.deployed.name}"),
        Facts(sources),
        as_rich(_table(comparison), wide=wide),
        Text(""),
        Text(LEGEND, style="dim"),
    )


def against_markdown(comparison: Comparison) -> str:
    """Return the largest change and the table as GitHub Markdown."""
    return f"{markdown_text(against_line(comparison))}\n\n{as_markdown(_table(comparison))}"


def against_line(comparison: Comparison) -> str:
    """Return the largest changes in one line."""
    changed = comparison.changed
    if not changed:
        unknown = sum(row.change is Change.UNKNOWN for row in comparison.rows)
        return "Nothing changes" + (f"; {unknown} rows are unknown" if unknown else "")
    named = "; then ".join(map(_change_text, changed[:MOST_NAMED]))
    return f"{len(changed)} of {len(comparison.rows)} rows change; most of all {named}"


def _change_text(row: ChangeRow) -> str:
    unit = "" if row.unit == "1" else f" {row.unit}"
    return f"{row.title}: from {measured_text(row.trained)} to {measured_text(row.deployed)}{unit}"


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
    return f"{row.deployed - row.trained:+.3g}" + ("" if row.unit == "1" else f" {row.unit}")


def _below(row: ChangeRow) -> str:
    """Return the title of a row that changes, and its remark."""
    parts = (row.title if row.change in (Change.VISIBLE, Change.LARGE) else "", row.remark)
    return "; ".join(part for part in parts if part)
