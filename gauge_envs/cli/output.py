"""Terminal output and exit codes.

Exit code 0 is success. The commands document when they use the others.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import typer
from rich.console import Console, ConsoleOptions, ConsoleRenderable, RenderHook, RenderResult
from rich.control import Control
from rich.segment import Segment

from gauge_envs.cli.streams import result_stream
from gauge_envs.files import printable
from gauge_envs.pages.document import Shown, Terminal, as_markdown, as_rows

UNSAFE = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff]")
"""Control characters but tabs and ends of lines, and lone surrogates."""

PIPE_WIDTH = 140
"""Width of tables where there is no terminal [characters]; rich would take 80."""

EXIT_FAILED = 1
"""The command ran, with a bad outcome: a failed episode or check, a damaged file, a stale asset."""

EXIT_USAGE = 2
"""The request is wrong: an unknown name, a missing file, an unsupported option."""


def stdout_console() -> Console:
    """Return the console of results."""
    return _prepared(Console(file=result_stream(), emoji=False))


def stderr_console() -> Console:
    """Return the console of messages and progress."""
    return _prepared(Console(stderr=True, highlight=False, emoji=False))


def _prepared(console: Console) -> Console:
    """Show control characters as escapes; give a console without a terminal a fixed width unless `COLUMNS` states one.

    Names in files of strangers may hold escape sequences, which a terminal would execute.
    """
    console.push_render_hook(_PrintableHook())
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = PIPE_WIDTH
    return console


class _PrintableHook(RenderHook):
    """Hook of a console that makes all texts printable; styles and the control codes of rich stay."""

    def process_renderables(self, renderables: list[ConsoleRenderable]) -> list[ConsoleRenderable]:
        """Return renderables whose texts are printable."""
        return [one if isinstance(one, Control) else _Printable(one) for one in renderables]


@dataclass(frozen=True)
class _Printable:
    """A renderable whose texts hold no control characters but ends of lines."""

    inner: ConsoleRenderable

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the segments of the renderable."""
        for segment in console.render(self.inner, options):
            if segment.control or segment.text.isprintable():
                yield segment
            else:
                text = "\n".join(map(printable, segment.text.split("\n")))
                yield Segment(text, segment.style)


def plain_text(text: str) -> str:
    """Return a text in which rich interprets no brackets."""
    from rich.markup import escape

    return escape(text)


def progress_bar(console: Console) -> Any:
    """Return a progress bar, which only a terminal shows."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)


def echo(text: object, *, nl: bool = True) -> None:
    """Print a text on stdout as a result of the command, with control characters and lone surrogates as escapes.

    Names of files may hold them: a terminal would execute the first, and no encoding has the second.

    Args:
        text: The text.
        nl: Whether to end the line.
    """
    typer.echo(UNSAFE.sub(lambda found: printable(found[0]), str(text)), file=result_stream(), nl=nl)


def print_json_lines(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print one JSON object per line on stdout."""
    for row in rows:
        echo(json.dumps(row, allow_nan=False))


def print_document(shown: Shown, *, json_lines: bool = False, markdown: bool = False, wide: bool = False) -> None:
    """Print a document or a table on stdout: as JSON objects, as Markdown, or for a terminal.

    Args:
        shown: What to print.
        json_lines: Whether to print its rows, one JSON object a line.
        markdown: Whether to print GitHub Markdown.
        wide: Whether a terminal shows what is left out by default.
    """
    if json_lines:
        print_json_lines(as_rows(shown))
    elif markdown:
        echo(as_markdown(shown), nl=False)
    else:
        stdout_console().print(Terminal(shown, wide))


def counted(number: int, noun: str) -> str:
    """Return a number with its noun: `1 check`, `2 checks`."""
    return f"{number} {noun}{'' if number == 1 else 's'}"
