"""Tables: rows, and columns that select a value of a row and format it.

A row is a JSON-ready mapping, a sequence, or an object with attributes.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from enum import StrEnum
from typing import Any

from gauge_envs.pages.text import value_text


class Place(StrEnum):
    """Place of a column in a terminal and on a page. Markdown has only columns."""

    CELL = "cell"
    """In the row."""
    HEADING = "heading"
    """In a line above consecutive rows with the same value."""
    BELOW = "below"
    """In wrapped lines below the row; on a page in a separate row."""


@dataclass(frozen=True)
class Column:
    """One column.

    Attributes:
        key: Path of the value in a row, as `published.newton`; empty for the row itself.
        title: Heading of the column.
        format: Text of a value that is not None.
        unit: Unit of all values, in brackets after the title.
        is_number: Whether the texts are aligned on the right.
        wide_only: Whether a terminal shows the column only with `--format wide`.
        place: Place of the column in a terminal.
        style: Rich style of a value in a terminal; None for plain text.
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
        if not self.unit:
            return self.title
        return f"{self.title} [{self.unit}]"

    def value(self, row: Any) -> Any:
        """Return the value of a row; None for a missing one."""
        value = row
        for name in filter(None, self.key.split(".")):
            if isinstance(value, Mapping):
                value = value.get(name)
            elif isinstance(value, list | tuple):
                value = value[int(name)]
            else:
                value = getattr(value, name, None)
        return value

    def text(self, row: Any) -> str:
        """Return the text of a row; a missing value is a dash in a cell and empty elsewhere."""
        value = self.value(row)
        if value is not None:
            return self.format(value)
        if self.place is Place.CELL:
            return "-"
        return ""

    def style_of(self, row: Any) -> str:
        """Return the rich style of a row."""
        if self.style is None:
            return ""
        return self.style(self.value(row))


@dataclass(frozen=True, kw_only=True)
class Table:
    """Columns and rows.

    Attributes:
        columns: From left to right.
        rows: Mappings, sequences or objects.
        title: Line above the table; empty for none.
        notes: Lines below the table.
        wide_only: Whether a terminal shows the table only with `--format wide`.
    """

    columns: tuple[Column, ...]
    rows: Sequence[Any]
    title: str = ""
    notes: tuple[str, ...] = ()
    wide_only: bool = False

    def placed(self, place: Place) -> list[Column]:
        """Return the columns with a place."""
        return [column for column in self.columns if column.place is place]

    def heading_of(self, row: Any) -> str:
        """Return the line above consecutive rows: the first value without a title, the others after their titles."""
        headings = self.placed(Place.HEADING)
        texts = [column.text(row) for column in headings[:1]]
        texts += [f"{column.title} {column.text(row)}" for column in headings[1:]]
        return "  ".join(texts)


@dataclass(frozen=True)
class Facts:
    """Names and texts below each other."""

    pairs: Mapping[str, str]


def grid(
    titles: Sequence[str], rows: Iterable[Sequence[str]], *, number_from: int = 99
) -> Table:
    """Return a table of cells that are already texts.

    Args:
        titles: Titles of the columns.
        rows: The cells.
        number_from: First column of numbers.
    """
    columns = [
        Column(str(index), title, is_number=index >= number_from)
        for index, title in enumerate(titles)
    ]
    return Table(columns=tuple(columns), rows=list(rows))
