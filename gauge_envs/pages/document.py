"""Documents: the output of a command as a list of parts.

`pages.terminal`, `pages.markdown` and `pages.page` write a document in one form each. `as_rows` returns JSON objects.

Example:
    >>> from gauge_envs.pages.markdown import as_markdown
    >>> from gauge_envs.pages.table import Column
    >>> table = Table(columns=(Column("id", "check"),), rows=[{"id": "slide"}])
    >>> document = Document(parts=(Paragraph("1 check"), table))
    >>> print(as_markdown(document), end="")
    1 check
    <BLANKLINE>
    | check |
    | --- |
    | slide |
    >>> as_rows(document)
    [{'id': 'slide'}]
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import chain
from pathlib import Path
from typing import Any, TypeAlias

from gauge_envs.errors import ResultFileError
from gauge_envs.files import json_ready, os_errors, write_whole
from gauge_envs.pages.html import Html
from gauge_envs.pages.table import Facts, Table


@dataclass(frozen=True)
class Heading:
    """Line above a part of a document.

    Attributes:
        text: The line.
        level: 1 for the title of a page.
    """

    text: str
    level: int = 2


class Tone(StrEnum):
    """Purpose of a paragraph; the value is its style in a terminal."""

    PLAIN = ""
    ANSWER = "bold"
    """The result in one line."""
    NOTE = "dim"
    """Explanation of the other parts."""
    WARNING = "yellow"
    """Fact that a reader must not miss."""
    ERROR = "red"


@dataclass(frozen=True)
class Paragraph:
    """A few sentences; an empty text is an empty line in a terminal."""

    text: str
    tone: Tone = Tone.PLAIN


@dataclass(frozen=True)
class Bullets:
    """Lines below a title; they are sentences of this package, so their Markdown is not escaped.

    Attributes:
        entries: The lines.
        title: The title; empty for none.
    """

    entries: Sequence[str]
    title: str = ""


Part: TypeAlias = Heading | Paragraph | Bullets | Table | Facts | Html
"""Part of a document. Only pages show markup."""


@dataclass(frozen=True, kw_only=True)
class Document:
    """Output of a command.

    Attributes:
        parts: From top to bottom.
        rows: JSON-ready objects; None for the rows of its tables.
        markdown: Parts of the Markdown text; None for the same.
    """

    parts: Sequence[Part]
    rows: Iterable[Mapping[str, Any]] | None = None
    markdown: Sequence[Part] | None = None


Shown: TypeAlias = Document | Part
"""A document, or a single part."""


def document_of(shown: Shown) -> Document:
    """Return a part as a document; a document stays as it is."""
    if isinstance(shown, Document):
        return shown
    return Document(parts=(shown,))


def as_rows(shown: Shown) -> list[dict[str, Any]]:
    """Return the JSON-ready objects of a document."""
    document = document_of(shown)
    rows: Iterable[Any] | None = document.rows
    if rows is None:
        tables = (part for part in document.parts if isinstance(part, Table))
        rows = chain.from_iterable(table.rows for table in tables)
    return json_ready([row if isinstance(row, Mapping) else vars(row) for row in rows])


def save_file(path: Path, content: str | bytes) -> Path:
    """Write a text or a picture whole or not at all, and return its path; the folder is created.

    Raises:
        ResultFileError: The file cannot be written.
    """
    if isinstance(content, str):
        # The name of a file may have bytes that are not UTF-8.
        content = content.encode(errors="backslashreplace")
    with os_errors(
        lambda cause: ResultFileError(f"{path}: cannot be written: {cause}")
    ):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, content)
    return path
