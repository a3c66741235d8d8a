"""Tables: columns and rows that print in a terminal, as Markdown, as HTML, or as JSON objects.

A row is a JSON-ready mapping, a sequence, or an object with attributes. A column states which value of a row it shows
and how to write it. In a terminal no cell is cut or wrapped. What does not fit beside the others is written below its
row.
"""

import csv
import io
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from enum import StrEnum
from itertools import chain, repeat
from typing import Any

from rich.text import Text

from gauge_envs.pages.html import Html, element, join
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
    """Where a column stands in a terminal. In Markdown every column is a column, on a page all but those below are."""

    CELL = "cell"
    """In the row."""
    HEADING = "heading"
    """In a line above all neighbouring rows that share the value."""
    BELOW = "below"
    """In lines of its own below the row, wrapped; on a page in a row of its own."""


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
        narrow_only: Whether only a terminal without `--format wide` shows the column.
        place: Where the column stands in a terminal.
        style: Rich style of a value, which is the class of its cell on a page; None for plain text.
        html: Markup of a value on a page; None for its text.
    """

    key: str
    title: str
    format: Callable[[Any], str] = value_text
    _: KW_ONLY
    unit: str = ""
    is_number: bool = False
    wide_only: bool = False
    narrow_only: bool = False
    place: Place = Place.CELL
    style: Callable[[Any], str] | None = None
    html: Callable[[Any], Html | str] | None = None

    @property
    def label(self) -> str:
        """Title with the unit."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title

    def value(self, row: Any) -> Any:
        """Return the value of a row; None for a missing one."""
        value = row
        for part in filter(None, self.key.split(".")):
            if isinstance(value, Mapping):
                value = value.get(part)
            else:
                value = value[int(part)] if isinstance(value, list | tuple) else getattr(value, part, None)
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

    def markup(self, row: Any) -> Html | str:
        """Return what a page shows of a row."""
        return self.text(row) if self.html is None else self.html(self.value(row))


@dataclass(frozen=True, kw_only=True)
class Table:
    """Columns and rows.

    Attributes:
        columns: From left to right.
        rows: Mappings, sequences or objects that the columns read.
        title: Line above the table; empty for none.
        notes: Lines below the table.
        wide_only: Whether a terminal shows the table only with `--format wide`.
        narrow_only: Whether only a terminal without `--format wide` shows the table.
        look: Classes of the table on a page.
    """

    columns: tuple[Column, ...]
    rows: Sequence[Any]
    title: str = ""
    notes: tuple[str, ...] = ()
    wide_only: bool = False
    narrow_only: bool = False
    look: str = "stack dense"

    def lines(self, width: int, *, wide: bool) -> Iterator[Text]:
        """Yield the lines of the table for a terminal, none longer than the width."""
        if self.narrow_only if wide else self.wide_only:
            return
        if self.title:
            yield Text(f"\n{self.title}", style="bold")
        if self.rows:
            yield from _lines(self, wide, width)
        else:
            yield Text("none", style="dim")
        for note in self.notes:
            yield from _wrapped(note, width, style="dim")

    def markdown(self) -> str:
        """Return the table as GitHub Markdown, with all columns."""
        lines = [f"**{markdown_text(self.title)}**", ""] if self.title else []
        columns = [column for column in self.columns if not column.narrow_only]
        lines.append(markdown_row([column.label for column in columns]))
        lines.append(f"| {' | '.join('---:' if column.is_number else '---' for column in columns)} |")
        lines += [markdown_row([column.text(row) for column in columns]) for row in self.rows]
        # Two blanks end a line in Markdown.
        lines += ["", *(f"{markdown_text(note)}  " for note in self.notes)] if self.notes else []
        return "\n".join(lines)

    def csv(self) -> str:
        """Return the values with full digits, below the keys of the columns; a missing value is an empty cell."""
        stream = io.StringIO()
        csv.writer(stream, lineterminator="\n").writerows(
            [
                [column.key for column in self.columns],
                *([column.value(row) for column in self.columns] for row in self.rows),
            ]
        )
        return stream.getvalue()

    def latex(self) -> str:
        """Return the table as a LaTeX `tabular`, with all columns."""
        layout = "".join("r" if column.is_number else "l" for column in self.columns)
        cells = [[column.label for column in self.columns], *([c.text(row) for c in self.columns] for row in self.rows)]
        lines = [" & ".join(re.sub(r"([&%$#_{}^])", r"\\\1{}", cell) for cell in line) for line in cells]
        return "\n".join([f"\\begin{{tabular}}{{{layout}}}", *(f"{line} \\\\" for line in lines), "\\end{tabular}\n"])

    def html(self) -> Html:
        """Return the table as an element; on a narrow screen the cells of a row may stand below each other."""
        columns = [column for column in self.columns if not column.narrow_only]
        beside = [column for column in columns if column.place is not Place.BELOW]
        below = [column for column in columns if column.place is Place.BELOW]
        head = (
            element("th", column.title if isinstance(column.title, Html) else column.label, scope="col", class_=kind)
            for column in beside
            for kind in ["n" if column.is_number else None]
        )
        body: list[Html] = []
        for row in self.rows:
            body.append(element("tr", *(_cell(column, row) for column in beside)))
            texts = filter(None, (column.markup(row) for column in below))
            body += [element("tr", element("td", text, colspan=len(beside)), class_="more") for text in texts]
        table = element("table", element("thead", element("tr", *head)), element("tbody", *body), class_=self.look)
        title = [element("h3", self.title)] if self.title else []
        notes = (element("p", note, class_="small") for note in self.notes)
        # A keyboard scrolls what has the focus.
        label = beside[0].label if "matrix" in self.look else None
        focus = {"tabindex": label and "0", "role": label and "region", "aria_label": label}
        return join([*title, element("div", table, class_="scroll", **focus), *notes])


def _cell(column: Column, row: Any) -> Html:
    label = None if isinstance(column.title, Html) else column.label or None
    kinds = " ".join(filter(None, ("n" if column.is_number else "", column.style_of(row))))
    return element("td", column.markup(row), data_label=label, class_=kinds or None)


def grid(
    titles: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    number_from: int = 99,
    look: str = "stack dense",
    notes: tuple[str, ...] = (),
) -> Table:
    """Return a table of cells that are texts or markup already.

    Args:
        titles: Titles of the columns, texts or markup.
        rows: The cells.
        number_from: First column of numbers.
        look: Classes of the table on a page.
        notes: Lines below the table.
    """
    columns = (
        Column(str(index), title, lambda cell: cell, is_number=index >= number_from)
        for index, title in enumerate(titles)
    )
    return Table(columns=tuple(columns), rows=list(rows), notes=notes, look=look)


def _lines(table: Table, wide: bool, width: int) -> Iterator[Text]:
    """Yield headings, rows and what stands below them, none longer than the width."""
    chosen = [c for c in table.columns if not (c.narrow_only if wide else c.wide_only)]
    shown = {place: [c for c in chosen if c.place is place] for place in Place}
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
    """Names and texts below each other."""

    pairs: Mapping[str, str]

    def lines(self, width: int, *, wide: bool = False) -> Iterator[Text]:
        """Yield a line for each name; a long text goes on below its beginning."""
        key_width = max((len(key) for key in self.pairs if len(key) <= MOST_KEY_WIDTH), default=0)
        for key, text in self.pairs.items():
            if len(key) > key_width:
                yield from _wrapped(key, width, style="cyan")
            names = chain(["" if len(key) > key_width else key], repeat(""))
            for name, line in zip(names, _wrap(text, width - key_width - len(GAP)), strict=False):
                yield Text.assemble((name.ljust(key_width), "cyan"), GAP, line)

    def markdown(self) -> str:
        """Return a list."""
        return "\n".join(f"- {markdown_text(f'{key}: {text}')}" for key, text in self.pairs.items())

    def html(self) -> Html:
        """Return a table of two columns."""
        return grid(("what", "value"), list(self.pairs.items()), look="anywhere").html()
