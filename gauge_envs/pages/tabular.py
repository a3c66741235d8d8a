"""Tables of a document as CSV, and as LaTeX for a paper."""

import csv
import io
from collections.abc import Sequence

from gauge_envs.pages.document import Document, Shown, document_of
from gauge_envs.pages.table import Column, Place, Table

LATEX_ESCAPES = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        **{mark: rf"\{mark}" for mark in "&%$#_{}"},
    }
)


def as_csv(shown: Shown) -> str:
    """Return the tables of a document as CSV, with an empty line between tables."""
    return "\n".join(map(_csv, _tables(document_of(shown))))


def as_latex(shown: Shown) -> str:
    """Return the tables of a document as `tabular` environments after their notes, which are comments of LaTeX."""
    return "\n".join(map(_latex, _tables(document_of(shown))))


def _tables(document: Document) -> list[Table]:
    """Return the tables of a document."""
    return [part for part in document.parts if isinstance(part, Table)]


def _texts(table: Table) -> list[list[str]]:
    """Return the labels of a table, and below them its cells."""
    columns = table.columns
    cells = [[column.text(row) for column in columns] for row in table.rows]
    return [[column.label for column in columns], *cells]


def _csv(table: Table) -> str:
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(_texts(table))
    return stream.getvalue()


def _latex(table: Table) -> str:
    labels, *cells = map(_latex_row, _texts(table))
    alignment = "".join(map(_alignment, table.columns))
    lines = [
        *(f"% {note}" for note in table.notes),
        rf"\begin{{tabular}}{{{alignment}}}",
        r"\hline",
        labels,
        r"\hline",
        *cells,
        r"\hline",
        r"\end{tabular}",
    ]
    return "".join(f"{line}\n" for line in lines)


def _latex_row(cells: Sequence[str]) -> str:
    escaped = " & ".join(cell.translate(LATEX_ESCAPES) for cell in cells)
    return rf"{escaped} \\"


def _alignment(column: Column) -> str:
    """Return the alignment of a column; a long heading wraps."""
    if column.place is Place.HEADING:
        return "p{3cm}"
    return "r" if column.is_number else "l"
