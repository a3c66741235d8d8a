"""Terminal output and exit codes."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from typing import Any

import typer
from rich.console import Console

__all__ = [
    "EXIT_FAILED",
    "EXIT_INTERRUPTED",
    "EXIT_USAGE",
    "PIPE_WIDTH",
    "counted",
    "plain_text",
    "print_json_lines",
    "progress_bar",
    "stderr_console",
    "stdout_console",
]


PIPE_WIDTH = 140
"""Width of tables where there is no terminal [characters]; rich would take 80, and cut them."""


EXIT_FAILED = 1
"""An episode failed, diverged, or was asked for by name and declined."""


EXIT_USAGE = 2
"""What was asked for cannot be done."""


EXIT_INTERRUPTED = 130


def stdout_console() -> Console:
    return _widened(Console())


def stderr_console() -> Console:
    return _widened(Console(stderr=True, highlight=False))


def _widened(console: Console) -> Console:
    """A console that does not cut tables where there is no terminal."""
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = PIPE_WIDTH
    return console


def plain_text(text: str) -> str:
    from rich.markup import escape

    return escape(text)


def progress_bar(console: Console) -> Any:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)


def print_json_lines(rows: Sequence[Mapping[str, Any]]) -> None:
    for row in rows:
        typer.echo(json.dumps(row, allow_nan=False))


def counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
