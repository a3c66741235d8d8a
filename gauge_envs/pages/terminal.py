"""Documents in a terminal: rich wraps texts, and tables fit the width of the console.

Cells wrap between words. Columns that do not fit side by side move below their rows.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import rich.table
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.padding import Padding
from rich.text import Text

from gauge_envs.pages.document import (
    Bullets,
    Heading,
    Paragraph,
    Part,
    Shown,
    document_of,
)
from gauge_envs.pages.table import Column, Facts, Place, Table

GAP = 2
"""Blanks between two columns, and before rows below a heading."""

MIN_NAME_WIDTH = 12
"""Smallest width of the first column [characters]."""

MAX_KEY_WIDTH = 22
"""Width above which the name of a fact has its own line [characters]."""


@dataclass(frozen=True)
class Terminal:
    """A document that rich prints at the width of its console.

    Attributes:
        shown: Document or part.
        wide: Whether to show columns and tables that are omitted by default.
    """

    shown: Shown
    wide: bool = False

    def __rich_console__(
        self, console: Console, options: ConsoleOptions
    ) -> RenderResult:
        """Yield the lines of all parts."""
        for part in document_of(self.shown).parts:
            yield from _lines(part, options.max_width, wide=self.wide)


def _lines(part: Part, width: int, *, wide: bool) -> Iterator[RenderableType]:
    """Yield the lines of a part for a width [characters]; markup is omitted."""
    match part:
        case Heading(text):
            yield Text(f"\n{text}", style="bold")
        case Paragraph(text, tone):
            yield Text(text, style=tone.value)
        case Bullets(entries, title):
            if title:
                yield Text(f"\n{title}", style="bold")
            yield from (Text(f"  {line}") for line in entries)
        case Facts(pairs):
            yield from _facts(pairs)
        case Table():
            if wide or not part.wide_only:
                yield from _table(part, width, wide=wide)


def _facts(pairs: Mapping[str, str]) -> Iterator[RenderableType]:
    """Yield names with their texts; a long name has its own line."""
    lengths = [len(key) for key in pairs if len(key) <= MAX_KEY_WIDTH]
    width = max(lengths, default=0)
    for key, text in pairs.items():
        name = key
        if len(key) > MAX_KEY_WIDTH:
            yield Text(key, style="cyan")
            name = ""
        line = rich.table.Table.grid(padding=(0, GAP, 0, 0))
        line.add_column(style="cyan", width=width)
        line.add_column(overflow="fold")
        line.add_row(Text(name), Text(text))
        yield line


def _table(table: Table, width: int, *, wide: bool) -> Iterator[RenderableType]:
    if table.title:
        yield Text(f"\n{table.title}", style="bold")
    if table.rows:
        yield from _rows(table, width, wide=wide)
    else:
        yield Text("none", style="dim")
    for note in table.notes:
        yield Text(note, style="dim")


def _rows(table: Table, width: int, *, wide: bool) -> Iterator[RenderableType]:
    """Yield titles, headings, and rows, each with its lines below."""
    if not wide:
        narrow = tuple(column for column in table.columns if not column.wide_only)
        table = replace(table, columns=narrow)
    cells = table.placed(Place.CELL)
    indent = 0
    if table.placed(Place.HEADING):
        indent = GAP
    widths = _widths(cells, table.rows, width - indent)
    shown, spilled = cells[: len(widths)], cells[len(widths) :]
    titles = [Text(column.label, style="dim") for column in shown]
    yield Padding.indent(_line(shown, widths, titles, vertical="bottom"), indent)
    last_heading = ""
    for row in table.rows:
        heading = table.heading_of(row)
        if heading != last_heading:
            yield Text(heading, style="bold")
            last_heading = heading
        line = [Text(column.text(row), column.style_of(row)) for column in shown]
        if max(map(cell_len, line[0].plain.split()), default=0) > widths[0]:
            yield Padding.indent(line[0], indent)
            line[0] = Text("")
        if any(line):
            yield Padding.indent(_line(shown, widths, line), indent)
        texts = [column.text(row) for column in table.placed(Place.BELOW)]
        texts.append(_spilled_text(spilled, row))
        for text in filter(None, texts):
            yield Padding.indent(Text(text), 2 * GAP)


def _spilled_text(columns: Sequence[Column], row: object) -> str:
    """Return the known values of columns that do not fit, each after its title."""
    known = []
    for column in columns:
        text = column.text(row)
        if text not in ("", "-"):
            known.append(f"{column.label}: {text}")
    return "; ".join(known)


def _line(
    columns: Sequence[Column],
    widths: Sequence[int],
    texts: Sequence[Text],
    *,
    vertical: Literal["top", "bottom"] = "top",
) -> rich.table.Table:
    """Return texts in columns of given widths [characters]."""
    line = rich.table.Table.grid(padding=(0, GAP, 0, 0))
    for column, width in zip(columns, widths, strict=True):
        line.add_column(width=width, overflow="fold", vertical=vertical)
        if column.is_number:
            line.columns[-1].justify = "right"
    if not columns[-1].is_number:
        # A fixed width of the last column would add trailing blanks.
        line.columns[-1].width = None
        line.columns[-1].max_width = widths[-1]
    line.add_row(*texts)
    return line


def _widths(columns: Sequence[Column], rows: Sequence[object], width: int) -> list[int]:
    """Return the widths of the columns that fit side by side; cells wrap between words where they must."""
    widths: list[int] = []
    min_widths: list[int] = []
    for column in columns:
        lines = [column.label, *map(column.text, rows)]
        words = " ".join(lines).split()
        widths.append(max(map(cell_len, lines)))
        min_widths.append(max(map(cell_len, words), default=1))
    # A longer name of a row gets its own line, so that fewer columns move below their rows.
    min_widths[0] = min(min_widths[0], MIN_NAME_WIDTH)
    while len(min_widths) > 1 and _total(min_widths) > width:
        del min_widths[-1], widths[-1]
    while _total(widths) > width:
        spare = [size - word for size, word in zip(widths, min_widths, strict=True)]
        if max(spare) <= 0:
            break
        widths[spare.index(max(spare))] -= 1
    return widths


def _total(widths: Sequence[int]) -> int:
    """Return the width of columns with the gaps between them."""
    return sum(widths) + GAP * (len(widths) - 1)
