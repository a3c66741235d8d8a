"""Tables: columns and rows that print in a terminal, as Markdown, as HTML, or as JSON objects.

A row is a JSON-ready mapping, a sequence, or an object with attributes. A column states which value of a row it shows
and how to write it. In a terminal cells wrap between words, and columns that do not fit are written below their rows.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from enum import StrEnum
from textwrap import TextWrapper
from typing import Any, Literal

import rich.table
from rich.cells import cell_len
from rich.console import RenderableType
from rich.padding import Padding
from rich.text import Text

from gauge_envs.pages.html import Html, element, join
from gauge_envs.pages.text import markdown_row, markdown_text, value_text

GAP = 2
"""Blanks between two columns, and before rows below a heading."""

TITLE_WIDTH = 12
"""Longer titles wrap where their cells are shorter [characters]."""

MIN_NAME_WIDTH = 12
"""The first column gets at least this width [characters]."""

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

    def renderables(self, width: int, *, wide: bool) -> Iterator[RenderableType]:
        """Yield what a terminal of a width [characters] shows."""
        if self.narrow_only if wide else self.wide_only:
            return
        if self.title:
            yield Text(f"\n{self.title}", style="bold")
        if self.rows:
            yield from _lines(self, width, wide=wide)
        else:
            yield Text("none", style="dim")
        for note in self.notes:
            yield Text(note, style="dim")

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

    def html(self) -> Html:
        """Return the table as an element; on a narrow screen the cells of a row may stand below each other."""
        columns = [column for column in self.columns if not column.narrow_only]
        beside = [column for column in columns if column.place is not Place.BELOW]
        below = [column for column in columns if column.place is Place.BELOW]
        head = (
            element(
                "th",
                column.title if isinstance(column.title, Html) else column.label,
                scope="col",
                class_="n" if column.is_number else None,
            )
            for column in beside
        )
        body = []
        for row in self.rows:
            body.append(element("tr", *(_cell(column, row) for column in beside)))
            for text in filter(None, (column.markup(row) for column in below)):
                cell = element("td", text, colspan=len(beside))
                body.append(element("tr", cell, class_="more"))
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


def _lines(table: Table, width: int, *, wide: bool) -> Iterator[RenderableType]:
    """Yield titles, headings, and rows, each with its lines below."""
    chosen = [
        column
        for column in table.columns
        if not (column.narrow_only if wide else column.wide_only)
    ]
    headings = [column for column in chosen if column.place is Place.HEADING]
    cells = [column for column in chosen if column.place is Place.CELL]
    below = [column for column in chosen if column.place is Place.BELOW]
    indent = GAP if headings else 0
    widths = _widths(cells, table.rows, width - indent)
    shown, spilled = cells[: len(widths)], cells[len(widths) :]
    titles = [Text(column.label, style="dim") for column in shown]
    yield Padding.indent(_line(shown, widths, titles, vertical="bottom"), indent)
    last_heading = ""
    for row in table.rows:
        heading = _heading(headings, row)
        if heading != last_heading:
            yield Text(heading, style="bold")
            last_heading = heading
        texts = [Text(column.text(row), column.style_of(row)) for column in shown]
        if max(map(cell_len, texts[0].plain.split()), default=0) > widths[0]:
            yield Padding.indent(texts[0], indent)
            texts[0] = Text("")
        if any(texts):
            yield Padding.indent(_line(shown, widths, texts), indent)
        lines = [column.text(row) for column in below]
        rest = [(column.label, column.text(row)) for column in spilled]
        lines.append(
            "; ".join(
                f"{title}: {text}" for title, text in rest if text not in ("", "-")
            )
        )
        for line in filter(None, lines):
            yield Padding.indent(Text(line), 2 * GAP)


def _heading(columns: Sequence[Column], row: Any) -> str:
    """Return the line above rows: the first value alone, and the others with their titles."""
    first, *others = [column.text(row) for column in columns] or [""]
    titles = [column.title for column in columns[1:]]
    texts = [f"{title} {text}" for title, text in zip(titles, others, strict=True)]
    return "  ".join([first, *texts])


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
        # Blanks would follow the texts of a last column.
        is_last = column is columns[-1] and not column.is_number
        line.add_column(
            justify="right" if column.is_number else "left",
            width=None if is_last else width,
            max_width=width,
            overflow="fold",
            vertical=vertical,
        )
    line.add_row(*texts)
    return line


def _widths(columns: Sequence[Column], rows: Sequence[Any], width: int) -> list[int]:
    """Return the widths of the columns that fit side by side; cells wrap between words where they must."""
    wrapper = TextWrapper(TITLE_WIDTH, break_long_words=False, break_on_hyphens=False)
    lines = [
        [*wrapper.wrap(column.label), *(column.text(row) for row in rows)]
        for column in columns
    ]
    widths = [max(map(cell_len, texts)) for texts in lines]
    least = [max(map(cell_len, " ".join(texts).split()), default=1) for texts in lines]
    # A longer name of a row has a line of its own rather than that columns go below their rows.
    least[0] = min(least[0], MIN_NAME_WIDTH)
    while len(least) > 1 and sum(least) + GAP * (len(least) - 1) > width:
        del least[-1], widths[-1]
    while sum(widths) + GAP * (len(widths) - 1) > width:
        spare = [size - word for size, word in zip(widths, least, strict=True)]
        if max(spare) <= 0:
            break
        widths[spare.index(max(spare))] -= 1
    return widths


@dataclass(frozen=True)
class Facts:
    """Names and texts below each other."""

    pairs: Mapping[str, str]

    def renderables(self, width: int, *, wide: bool) -> Iterator[RenderableType]:
        """Yield names beside their texts; a long name has a line of its own."""
        key_width = max(
            (len(key) for key in self.pairs if len(key) <= MAX_KEY_WIDTH), default=0
        )
        for key, text in self.pairs.items():
            is_long = len(key) > key_width
            if is_long:
                yield Text(key, style="cyan")
            fact = rich.table.Table.grid(padding=(0, GAP, 0, 0))
            fact.add_column(style="cyan", width=key_width)
            fact.add_column(overflow="fold")
            fact.add_row("" if is_long else Text(key), Text(text))
            yield fact

    def markdown(self) -> str:
        """Return a list."""
        return "\n".join(
            f"- {markdown_text(f'{key}: {text}')}" for key, text in self.pairs.items()
        )

    def html(self) -> Html:
        """Return a table of two columns."""
        return grid(("what", "value"), list(self.pairs.items()), look="anywhere").html()
