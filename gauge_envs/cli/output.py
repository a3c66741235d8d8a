"""Terminal output and exit codes.

Exit code 0 is success. The commands document their other exit codes.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import typer
from rich.console import Console
from rich.markup import escape

from gauge_envs.cli.streams import result_stream
from gauge_envs.files import json_ready

if TYPE_CHECKING:
    from gauge_envs.pages.document import Shown

PIPE_WIDTH = 140
"""Width of tables without a terminal [characters]; the default of rich is 80."""

LINE_INTERVAL_S = 5.0
"""Time between two lines of progress without a terminal [s]."""

EXIT_FAILED = 1
"""The command ran with a bad outcome: a failed episode or check, a damaged file, a stale asset."""

EXIT_INCOMPLETE = 3
"""The command ran, but could not measure everything."""

EXIT_USAGE = 2
"""The request is wrong: an unknown name, a missing file, an unsupported option."""


EXIT_INTERRUPTED = 130
"""Ctrl-C ended the command."""


def stdout_console() -> Console:
    """Return the console of results."""
    return _with_width(Console(file=result_stream(), emoji=False))


def stderr_console() -> Console:
    """Return the console of messages and progress."""
    return _with_width(Console(stderr=True, highlight=False, emoji=False))


def _with_width(console: Console) -> Console:
    """Give a console without a terminal a fixed width unless `COLUMNS` sets one."""
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = PIPE_WIDTH
    return console


_quiet = [False]
"""Whether each running command is quiet, the innermost last."""


@contextmanager
def quieted(is_quiet: bool) -> Iterator[None]:
    """Suppress progress, notes and totals while a quiet command runs."""
    _quiet.append(is_quiet)
    try:
        yield
    finally:
        _quiet.pop()


def message(text: object, label: str = "") -> None:
    """Print a sentence on stderr after a label such as `note` (yellow) or `error` (red).

    A quiet command prints no notes and no sentences without a label.
    """
    if _quiet[-1] and label in ("", "note"):
        return
    color = "red" if label in ("error", "stale") else "yellow"
    start = f"[{color}]{label}:[/] " if label else ""
    stderr_console().print(f"{start}{escape(str(text))}", soft_wrap=True)


def note(text: str) -> None:
    """Print a note on stderr."""
    message(text, "note")


class Progress:
    """Progress on stderr: a bar on a terminal; without a terminal, lines or nothing.

    Args:
        noun: Noun of a step.
        total: Number of steps; None if it is not known.
        done: Number of steps completed before.
        line_interval_s: Shortest time between two lines without a terminal [s]; None for no lines.
    """

    def __init__(
        self,
        noun: str,
        total: int | None,
        *,
        done: int = 0,
        line_interval_s: float | None = None,
    ) -> None:
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
        )

        console = stderr_console()
        self._is_terminal = console.is_terminal
        self._bar = Progress(
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.description}"),
            console=console,
            transient=True,
            disable=_quiet[-1] or not self._is_terminal,
        )
        self._task = self._bar.add_task(noun, total=total, completed=done)
        self._total, self._first, self._done = total, done, done
        self._interval_s = line_interval_s
        self._start_s = self._line_s = time.monotonic()

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def advance(self, text: object = "") -> None:
        """Count a step, and show its name."""
        self._done += 1
        self.show(text)
        self._bar.advance(self._task)
        time_s = time.monotonic()
        if self._done == self._first + 1:
            self._start_s = time_s  # The first step also loads the engine.
        if self._is_terminal or self._interval_s is None:
            return
        if time_s - self._line_s >= self._interval_s:
            self._line_s = time_s
            message(f"{self._done}/{self._total} {text}{self._left(time_s)}")

    def show(self, text: object) -> None:
        """Show the name of the current step."""
        self._bar.update(self._task, description=escape(str(text)))

    def _left(self, time_s: float) -> str:
        """Return the remaining time at the pace since the first step; empty if it is not known."""
        counted = self._done - self._first - 1
        if not self._total or counted < 1 or self._done >= self._total:
            return ""
        step_s = (time_s - self._start_s) / counted
        left_s = (self._total - self._done) * step_s
        return f", about {left_s / 60.0:.1f} min left"


def echo(text: object, *, nl: bool = True) -> None:
    """Print a text on stdout as a result of the command."""
    typer.echo(str(text), file=result_stream(), nl=nl)


class Format(StrEnum):
    """Format of the results on stdout."""

    TEXT = "text"
    WIDE = "wide"
    MARKDOWN = "markdown"
    LATEX = "latex"
    CSV = "csv"
    JSON = "json"


def print_document(
    shown: Shown,
    form: Format,
    *,
    files: Mapping[str, Path] | None = None,
) -> None:
    """Print a document on stdout, and write it to files, whose paths go to stderr.

    Args:
        shown: Document or part.
        form: The format.
        files: Files by suffix, from `arguments.by_suffix`; `.json` and `.md` have the content of stdout.
    """
    from gauge_envs.pages.document import as_rows, save_file
    from gauge_envs.pages.markdown import as_markdown
    from gauge_envs.pages.tabular import as_csv, as_latex
    from gauge_envs.pages.terminal import Terminal

    match form:
        case Format.JSON:
            print_json_lines(as_rows(shown))
        case Format.MARKDOWN:
            echo(as_markdown(shown), nl=False)
        case Format.LATEX:
            echo(as_latex(shown), nl=False)
        case Format.CSV:
            echo(as_csv(shown), nl=False)
        case Format.TEXT | Format.WIDE:
            stdout_console().print(Terminal(shown, form is Format.WIDE))
    for suffix, file in (files or {}).items():
        is_json = suffix == ".json"
        text = json_text(as_rows(shown)) if is_json else as_markdown(shown)
        message(save_file(file, text))


def print_json_lines(rows: Iterable[Mapping[str, Any]]) -> None:
    """Print one JSON object per line on stdout."""
    echo(json_text(rows), nl=False)


def json_text(rows: Iterable[Mapping[str, Any]]) -> str:
    """Return rows as JSON, one object a line, with null for NaN and infinity."""
    return "".join(f"{json.dumps(json_ready(row), allow_nan=False)}\n" for row in rows)
