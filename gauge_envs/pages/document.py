"""Documents: what a command shows, as text for a terminal, as Markdown, as JSON objects and as HTML.

Example:
    >>> from gauge_envs.pages.table import Column, Table
    >>> found = Table(columns=(Column("id", "check"),), rows=[{"id": "slide"}])
    >>> document = Document(parts=(Paragraph("1 check"), found))
    >>> print(as_markdown(document), end="")
    1 check
    <BLANKLINE>
    | check |
    | --- |
    | slide |
    >>> as_rows(document)
    [{'id': 'slide'}]
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Protocol

from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.text import Text

from gauge_envs.errors import ResultFileError
from gauge_envs.files import json_ready, os_errors, write_whole
from gauge_envs.pages.html import Html, element, join, listed, stylesheet
from gauge_envs.pages.table import Table
from gauge_envs.pages.text import markdown_text


class Part(Protocol):
    """Part of a document, as a heading or a table."""

    def renderables(self, width: int, *, wide: bool) -> Iterator[RenderableType]:
        """Yield what a terminal of a width [characters] shows; `wide` adds what is left out by default."""

    def markdown(self) -> str:
        """Return the part as GitHub Markdown, without an empty line below it."""

    def html(self) -> Html:
        """Return the part as markup."""


@dataclass(frozen=True)
class Heading:
    """Line above a part of a document.

    Attributes:
        text: The line.
        level: 1 for the title of a page.
    """

    text: str
    level: int = 2

    def renderables(self, width: int, *, wide: bool) -> Iterator[RenderableType]:
        """Yield the line in bold, below an empty one."""
        yield Text(f"\n{self.text}", style="bold")

    def markdown(self) -> str:
        """Return the line with its level."""
        return f"{'#' * self.level} {markdown_text(self.text)}"

    def html(self) -> Html:
        """Return the line as an element."""
        return element(f"h{self.level}", self.text)


class Tone(StrEnum):
    """What a paragraph is for; the value is its style in a terminal."""

    PLAIN = ""
    ANSWER = "bold"
    """The result in a line."""
    NOTE = "dim"
    """What one needs to read the rest."""
    WARNING = "yellow"
    """What a reader might miss."""
    ERROR = "red"


CLASSES = {
    Tone.ANSWER: "answer",
    Tone.NOTE: "small",
    Tone.WARNING: "note",
    Tone.ERROR: "note",
}
"""Class of a paragraph on a page."""


@dataclass(frozen=True)
class Paragraph:
    """A few sentences; an empty text is an empty line of a terminal."""

    text: str
    tone: Tone = Tone.PLAIN

    def renderables(self, width: int, *, wide: bool) -> Iterator[RenderableType]:
        """Yield the text, which rich wraps."""
        yield Text(self.text, style=self.tone.value)

    def markdown(self) -> str:
        """Return the text in a line."""
        return markdown_text(self.text)

    def html(self) -> Html:
        """Return the text as an element."""
        return (
            element("p", self.text, class_=CLASSES.get(self.tone))
            if self.text
            else Html("")
        )


@dataclass(frozen=True)
class Bullets:
    """Lines below a title, sentences of this package: Markdown keeps their marks.

    Attributes:
        entries: The lines.
        title: The title; empty for none.
    """

    entries: Sequence[str]
    title: str = ""

    def renderables(self, width: int, *, wide: bool) -> Iterator[RenderableType]:
        """Yield the title in bold, below an empty line, and the indented entries."""
        if self.title:
            yield Text("")
            yield Text(self.title, style="bold")
        yield from (Text(f"  {line}") for line in self.entries)

    def markdown(self) -> str:
        """Return a list below its title."""
        entries = "\n".join(f"- {line}" for line in self.entries)
        return f"{self.title}:\n\n{entries}" if self.title else entries

    def html(self) -> Html:
        """Return a list below its title."""
        return join(
            [*([element("h3", self.title)] if self.title else []), listed(self.entries)]
        )


@dataclass(frozen=True, kw_only=True)
class Document:
    """What a command shows.

    Attributes:
        parts: From top to bottom. Only pages show markup.
        rows: JSON-ready objects; None for the rows of its tables.
        markdown: Parts of the Markdown text; None for the same.
    """

    parts: Sequence[Part]
    rows: Iterable[Mapping[str, Any]] | None = None
    markdown: Sequence[Part] | None = None


Shown = Document | Part
"""A document, or one of its parts alone."""


def _parts(shown: Shown) -> Sequence[Part]:
    return shown.parts if isinstance(shown, Document) else (shown,)


@dataclass(frozen=True)
class Terminal:
    """A document that rich prints at the width of its console.

    Attributes:
        shown: What to print.
        wide: Whether to show what is left out by default.
    """

    shown: Shown
    wide: bool = False

    def __rich_console__(
        self, console: Console, options: ConsoleOptions
    ) -> RenderResult:
        """Yield the lines of all parts."""
        for part in _parts(self.shown):
            yield from part.renderables(options.max_width, wide=self.wide)


def as_markdown(shown: Shown) -> str:
    """Return a document as GitHub Markdown, with an empty line between its parts."""
    chosen = (
        shown.markdown
        if isinstance(shown, Document) and shown.markdown is not None
        else _parts(shown)
    )
    return (
        "\n\n".join(filter(None, (part.markdown() for part in chosen))).rstrip() + "\n"
    )


def as_rows(shown: Shown) -> list[dict[str, Any]]:
    """Return the JSON-ready objects of a document."""
    rows = shown.rows if isinstance(shown, Document) else None
    if rows is None:
        rows = [
            row
            for part in _parts(shown)
            if isinstance(part, Table)
            for row in part.rows
        ]
    return json_ready([row if isinstance(row, Mapping) else vars(row) for row in rows])


def page(
    title: str,
    parts: Iterable[Part],
    *,
    above: Html | None = None,
    style: str | None = None,
    scripts: Sequence[str] = (),
    look: str | None = None,
) -> str:
    """Return a page in HTML.

    Args:
        title: Its title, above the parts and for the browser.
        parts: Its content.
        above: What stands above the title, as links.
        style: File of the style, relative to the page; None writes the style into the page.
        scripts: Script files in the order in which they run.
        look: Class of the body.
    """
    head = [
        element("meta", charset="utf-8"),
        element("title", title),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        *(element("script", Html(""), src=file, defer=True) for file in scripts),
    ]
    if style is None:
        head.append(element("style", Html(stylesheet())))
    else:
        head.append(element("link", rel="icon", href="data:,"))
        head.append(element("link", rel="stylesheet", href=style))
    shown: list[Part] = [above or Html(""), Heading(title, 1), *parts]
    body = join((part.html() for part in shown), "\n")
    whole = element(
        "html", element("head", *head), element("body", body, class_=look), lang="en"
    )
    return f"<!DOCTYPE html>\n{whole}\n"


def save_file(path: Path, content: str | bytes) -> Path:
    """Write a text or a picture whole or not at all, and return its path; the folder is created."""
    with os_errors(
        lambda cause: ResultFileError(f"{path}: cannot be written: {cause}")
    ):
        path.parent.mkdir(parents=True, exist_ok=True)
        # The name of a file may have bytes that are no UTF-8.
        write_whole(
            path,
            content
            if isinstance(content, bytes)
            else content.encode(errors="backslashreplace"),
        )
    return path
