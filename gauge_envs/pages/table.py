"""Tables: columns and rows that print in a terminal, as Markdown, or as JSON objects.

A row is a JSON-ready mapping, or an object with attributes. A column states which value of a row it shows and how to
write it. In a terminal no cell is cut or wrapped. What does not fit beside the others is written below its row.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from enum import StrEnum
from itertools import chain, repeat
from typing import Any

from rich.console import Console, ConsoleOptions, RenderResult
from rich.text import Text

from gauge_envs.files import json_ready
from gauge_envs.pages.text import markdown_row, markdown_text, value_text

GAP = "  "
"""Between two columns, and the indentation of rows below a heading."""

LEAST_FIRST_WIDTH = 12
"""The first column gets at least this width; longer first cells have a line of their own [characters]."""

TITLE_WIDTH = 12
"""Longer titles are wrapped [characters]."""

MOST_KEY_WIDTH = 22
"""Longer names of facts have a line of their own [characters]."""


class Place(StrEnum):
    """Where a column stands in a terminal. In Markdown, every column is a column."""

    CELL = "cell"
    """In the row."""
    HEADING = "heading"
    """In a line above all neighbouring rows that share the value."""
    BELOW = "below"
    """In lines of its own below the row, wrapped."""


@dataclass(frozen=True)
class Column:
    """One column.

    Attributes:
        key: Path of the value in a row, as `published.newton`; empty for the row itself.
        title: Heading of the column.
        format: Text of a value that is not None.
        unit: Unit of all values; it stands in brackets behind the title.
        is_number: Whether the texts are aligned on the right.
        wide_only: Whether a terminal shows the column only with `--format wide`.
        place: Where the column stands in a terminal.
        style: Rich style of a value; None for plain text.
    """

    key: str
    title: str
    format: Callable[[Any], str] = value_text
    _: KW_ONLY
    unit: str = ""
    is_number: bool = False
    wide_only: bool = False
    place: Place = Place.CELL
    style: Callable[[Any], str] | None = None

    @property
    def label(self) -> str:
        """Title with the unit."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title

    def value(self, row: Any) -> Any:
        """Return the value of a row; None for a missing one."""
        value = row
        for part in filter(None, self.key.split(".")):
            value = value.get(part) if isinstance(value, Mapping) else getattr(value, part, None)
        return value

    def text(self, row: Any) -> str:
        """Return the text of a row; for a missing value a dash, or nothing outside of the cells."""
        value = self.value(row)
        if value is None:
            return "-" if self.place is Place.CELL else ""
        return self.format(value)

    def style_of(self, row: Any) -> str:
        """Return the rich style of a row."""
        return "" if self.style is None else self.style(self.value(row))


@dataclass(frozen=True, kw_only=True)
class Table:
    """Columns and rows.

    Attributes:
        columns: From left to right.
        rows: Mappings or objects that the columns read.
        title: Line above the table; empty for none.
        notes: Lines below the table.
        wide_only: Whether a terminal shows the table only with `--format wide`.
    """

    columns: tuple[Column, ...]
    rows: Sequence[Any]
    title: str = ""
    notes: tuple[str, ...] = ()
    wide_only: bool = False


def as_rows(table: Table) -> list[dict[str, Any]]:
    """Return the rows of a table as JSON-ready objects."""
    rows: list[dict[str, Any]] = json_ready([row if isinstance(row, Mapping) else vars(row) for row in table.rows])
    return rows


def as_markdown(table: Table) -> str:
    """Return a table as GitHub Markdown, with all columns."""
    lines = [f"**{markdown_text(table.title)}**", ""] if table.title else []
    lines.append(markdown_row([column.label for column in table.columns]))
    lines.append(f"| {' | '.join('---:' if column.is_number else '---' for column in table.columns)} |")
    lines += [markdown_row([column.text(row) for column in table.columns]) for row in table.rows]
    # Two blanks end a line in Markdown.
    lines += ["", *(f"{markdown_text(note)}  " for note in table.notes)] if table.notes else []
    return "\n".join(lines) + "\n"


def as_rich(table: Table, *, wide: bool = False) -> TerminalTable:
    """Return a table for a terminal.

    Args:
        table: What to print.
        wide: Whether to show the columns that are `wide_only`.
    """
    return TerminalTable(table, wide)


@dataclass(frozen=True)
class TerminalTable:
    """A table that rich prints at the width of its console."""

    table: Table
    wide: bool = False

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the lines of the table."""
        if self.table.wide_only and not self.wide:
            return
        if self.table.title:
            yield Text(f"\n{self.table.title}", style="bold")
        if self.table.rows:
            yield from _lines(self.table, self.wide, options.max_width)
        else:
            yield Text("none", style="dim")
        for note in self.table.notes:
            yield from _wrapped(note, options.max_width, style="dim")


def _lines(table: Table, wide: bool, width: int) -> Iterator[Text]:
    """Yield headings, rows and what stands below them, none longer than the width."""
    shown = {place: [c for c in table.columns if c.place is place and (wide or not c.wide_only)] for place in Place}
    indent = GAP if shown[Place.HEADING] else ""
    columns, widths = _fitted(shown[Place.CELL], table.rows, width - len(indent))
    spilled = shown[Place.CELL][len(columns) :]

    def line(texts: Sequence[str], styles: Sequence[str]) -> Text:
        padded = Text(indent)
        for column, size, text, style in zip(columns, widths, texts, styles, strict=True):
            padded.append(f"{text:>{size}}" if column.is_number else f"{text:<{size}}", style=style).append(GAP)
        padded.rstrip()
        return padded

    titles = [_wrap(column.label, size) for column, size in zip(columns, widths, strict=True)]
    height = max(map(len, titles))
    for texts in zip(*([""] * (height - len(title)) + title for title in titles), strict=True):
        yield line(texts, ["dim"] * len(columns))
    last = None
    for row in table.rows:
        heading = GAP.join(
            f"{c.title if index else ''} {c.text(row)}".strip() for index, c in enumerate(shown[Place.HEADING])
        )
        if heading != (last or ""):
            yield from _wrapped(heading, width, style="bold")
        last = heading
        cells, styles = [c.text(row) for c in columns], [c.style_of(row) for c in columns]
        if len(cells[0]) > widths[0]:
            yield from _wrapped(cells[0], width, indent=indent, style=styles[0])
            cells[0] = ""
        if any(cells):
            yield line(cells, styles)
        below = [c.text(row) for c in shown[Place.BELOW]]
        below.append("; ".join(f"{c.label}: {c.text(row)}" for c in spilled if c.value(row) is not None))
        for text in filter(None, below):
            yield from _wrapped(text, width, indent=2 * GAP)


def _fitted(columns: Sequence[Column], rows: Sequence[Any], width: int) -> tuple[list[Column], list[int]]:
    """Return the columns that fit side by side, and their widths.

    A first column that is too wide gets the width that the others leave, and its long cells have lines of their own.
    If the others leave too little, it gets at most half of the width, and columns spill from the right.
    """
    widths = [max(map(len, [*_wrap(c.label, TITLE_WIDTH), *(c.text(row) for row in rows)])) for c in columns]
    room = width - sum(widths[1:]) - len(GAP) * (len(widths) - 1)
    widths[0] = min(widths[0], room if room >= LEAST_FIRST_WIDTH else width // 2)
    count = len(columns)
    while count > 1 and sum(widths[:count]) + len(GAP) * (count - 1) > width:
        count -= 1
    return list(columns[:count]), widths[:count]


def _wrap(text: str, width: int) -> list[str]:
    """Break a text at blanks alone, so that names and numbers stay whole."""
    return textwrap.wrap(text, max(width, 1), break_long_words=False, break_on_hyphens=False) or [""]


def _wrapped(text: str, width: int, *, indent: str = "", style: str = "") -> Iterator[Text]:
    for line in _wrap(text, width - len(indent)):
        yield Text(f"{indent}{line}", style=style)


@dataclass(frozen=True)
class Facts:
    """Names and texts below each other; rich prints them at the width of its console."""

    pairs: Mapping[str, str]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield a line for each name; a long text goes on below its beginning."""
        key_width = max((len(key) for key in self.pairs if len(key) <= MOST_KEY_WIDTH), default=0)
        for key, text in self.pairs.items():
            if len(key) > key_width:
                yield from _wrapped(key, options.max_width, style="cyan")
            names = chain(["" if len(key) > key_width else key], repeat(""))
            for name, line in zip(names, _wrap(text, options.max_width - key_width - len(GAP)), strict=False):
                yield Text.assemble((name.ljust(key_width), "cyan"), GAP, line)
