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

MIN_FIRST_WIDTH = 12
"""The first column gets at least this width; longer first cells have a line of their own [characters]."""

TITLE_WIDTH = 12
"""Longer titles are wrapped [characters]."""

MAX_KEY_WIDTH = 22
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
                value = (
                    value[int(part)]
                    if isinstance(value, list | tuple)
                    else getattr(value, part, None)
                )
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
        columns = [column for column in self.columns if not column.narrow_only]
        lines = []
        if self.title:
            lines += [f"**{markdown_text(self.title)}**", ""]
        lines.append(markdown_row([column.label for column in columns]))
        marks = ["---:" if column.is_number else "---" for column in columns]
        lines.append(f"| {' | '.join(marks)} |")
        for row in self.rows:
            lines.append(markdown_row([column.text(row) for column in columns]))
        if self.notes:
            lines.append("")
        # Two blanks end a line in Markdown.
        lines += [f"{markdown_text(note)}  " for note in self.notes]
        return "\n".join(lines)

    def csv(self) -> str:
        """Return the values with full digits, below the keys of the columns; a missing value is an empty cell."""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow([column.key for column in self.columns])
        for row in self.rows:
            writer.writerow([column.value(row) for column in self.columns])
        return stream.getvalue()

    def latex(self) -> str:
        """Return the table as a LaTeX `tabular`, with all columns."""
        layout = "".join("r" if column.is_number else "l" for column in self.columns)
        lines = [f"\\begin{{tabular}}{{{layout}}}"]
        for row in (None, *self.rows):
            cells = [
                column.label if row is None else column.text(row)
                for column in self.columns
            ]
            escaped = [re.sub(r"([&%$#_{}^])", r"\\\1{}", cell) for cell in cells]
            lines.append(f"{' & '.join(escaped)} \\\\")
        return "\n".join([*lines, "\\end{tabular}\n"])

    def html(self) -> Html:
        """Return the table as an element; on a narrow screen the cells of a row may stand below each other."""
        columns = [column for column in self.columns if not column.narrow_only]
        beside = [column for column in columns if column.place is not Place.BELOW]
        below = [column for column in columns if column.place is Place.BELOW]
        head = []
        for column in beside:
            title = column.title if isinstance(column.title, Html) else column.label
            head.append(
                element(
                    "th", title, scope="col", class_="n" if column.is_number else None
                )
            )
        body = []
        for row in self.rows:
            body.append(element("tr", *(_cell(column, row) for column in beside)))
            for column in below:
                text = column.markup(row)
                if text:
                    body.append(
                        element(
                            "tr",
                            element("td", text, colspan=len(beside)),
                            class_="more",
                        )
                    )
        table = element(
            "table",
            element("thead", element("tr", *head)),
            element("tbody", *body),
            class_=self.look,
        )
        # A keyboard scrolls what has the focus.
        focus = {}
        if "matrix" in self.look and beside[0].label:
            focus = {"tabindex": "0", "role": "region", "aria_label": beside[0].label}
        above = element("h3", self.title) if self.title else None
        notes = (element("p", note, class_="small") for note in self.notes)
        return join([above, element("div", table, class_="scroll", **focus), *notes])


def _cell(column: Column, row: Any) -> Html:
    label = None if isinstance(column.title, Html) else column.label or None
    kinds = " ".join(
        filter(None, ("n" if column.is_number else "", column.style_of(row)))
    )
    return element("td", column.markup(row), data_label=label, class_=kinds or None)


def grid(
    titles: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    number_from: int = 99,
    look: str = "stack dense",
) -> Table:
    """Return a table of cells that are texts or markup already.

    Args:
        titles: Titles of the columns, texts or markup.
        rows: The cells.
        number_from: First column of numbers.
        look: Classes of the table on a page.
    """
    columns = (
        Column(str(index), title, lambda cell: cell, is_number=index >= number_from)
        for index, title in enumerate(titles)
    )
    return Table(columns=tuple(columns), rows=list(rows), look=look)


def _lines(table: Table, wide: bool, width: int) -> Iterator[Text]:
    """Yield headings, rows and what stands below them, none longer than the width."""
    chosen = [
        column
        for column in table.columns
        if not (column.narrow_only if wide else column.wide_only)
    ]
    headings = [column for column in chosen if column.place is Place.HEADING]
    cells = [column for column in chosen if column.place is Place.CELL]
    below = [column for column in chosen if column.place is Place.BELOW]
    indent = GAP if headings else ""
    columns, widths = _fitted(cells, table.rows, width - len(indent))
    spilled = cells[len(columns) :]

    def line(texts: Sequence[str], styles: Sequence[str]) -> Text:
        padded = Text(indent)
        for column, size, text, style in zip(
            columns, widths, texts, styles, strict=True
        ):
            padded.append(
                text.rjust(size) if column.is_number else text.ljust(size), style=style
            ).append(GAP)
        padded.rstrip()
        return padded

    titles = [
        _wrap(column.label, size) for column, size in zip(columns, widths, strict=True)
    ]
    height = max(map(len, titles))
    # Short titles stand at the bottom.
    padded_titles = [[""] * (height - len(title)) + title for title in titles]
    for level in zip(*padded_titles, strict=True):
        yield line(level, ["dim"] * len(columns))
    last = ""
    for row in table.rows:
        parts = []
        for number, column in enumerate(headings):
            title = column.title if number else ""
            parts.append(f"{title} {column.text(row)}".strip())
        heading = GAP.join(parts)
        if heading != last:
            yield from _wrapped(heading, width, style="bold")
        last = heading
        texts = [column.text(row) for column in columns]
        styles = [column.style_of(row) for column in columns]
        if len(texts[0]) > widths[0]:
            yield from _wrapped(texts[0], width, indent=indent, style=styles[0])
            texts[0] = ""
        if any(texts):
            yield line(texts, styles)
        lines = [column.text(row) for column in below]
        lines.append(
            "; ".join(
                f"{one.label}: {one.text(row)}"
                for one in spilled
                if one.value(row) is not None and one.text(row)
            )
        )
        for text in filter(None, lines):
            yield from _wrapped(text, width, indent=2 * GAP)


def _fitted(
    columns: Sequence[Column], rows: Sequence[Any], width: int
) -> tuple[list[Column], list[int]]:
    """Return the columns that fit side by side, and their widths.

    A first column that is too wide gets the width that the others leave, and its long cells have lines of their own.
    If the others leave too little, it gets at most half of the width, and columns spill from the right.
    """
    widths = [
        max(map(len, [*_wrap(c.label, TITLE_WIDTH), *(c.text(row) for row in rows)]))
        for c in columns
    ]
    room = width - sum(widths[1:]) - len(GAP) * (len(widths) - 1)
    widths[0] = min(widths[0], room if room >= MIN_FIRST_WIDTH else width // 2)
    count = len(columns)
    while count > 1 and sum(widths[:count]) + len(GAP) * (count - 1) > width:
        count -= 1
    return list(columns[:count]), widths[:count]


def _wrap(text: str, width: int) -> list[str]:
    """Break a text at blanks alone, so that names and numbers stay whole."""
    return textwrap.wrap(
        text, max(width, 1), break_long_words=False, break_on_hyphens=False
    ) or [""]


def _wrapped(
    text: str, width: int, *, indent: str = "", style: str = ""
) -> Iterator[Text]:
    for line in _wrap(text, width - len(indent)):
        yield Text(f"{indent}{line}", style=style)


@dataclass(frozen=True)
class Facts:
    """Names and texts below each other."""

    pairs: Mapping[str, str]

    def lines(self, width: int, *, wide: bool = False) -> Iterator[Text]:
        """Yield a line for each name; a long text goes on below its beginning."""
        key_width = max(
            (len(key) for key in self.pairs if len(key) <= MAX_KEY_WIDTH), default=0
        )
        for key, text in self.pairs.items():
            if len(key) > key_width:
                yield from _wrapped(key, width, style="cyan")
            names = chain(["" if len(key) > key_width else key], repeat(""))
            for name, line in zip(
                names, _wrap(text, width - key_width - len(GAP)), strict=False
            ):
                yield Text.assemble((name.ljust(key_width), "cyan"), GAP, line)

    def markdown(self) -> str:
        """Return a list."""
        return "\n".join(
            f"- {markdown_text(f'{key}: {text}')}" for key, text in self.pairs.items()
        )

    def html(self) -> Html:
        """Return a table of two columns."""
        return grid(("what", "value"), list(self.pairs.items()), look="anywhere").html()
