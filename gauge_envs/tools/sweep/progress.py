"""Progress of a sweep on stderr: a bar on a terminal, else a line every few seconds."""

from __future__ import annotations

import time
from types import TracebackType
from typing import TYPE_CHECKING, Self

from rich.console import Console

from gauge_envs.cli.output import plain_text, progress_bar

if TYPE_CHECKING:
    from gauge_envs.runs.result import Result


LINE_INTERVAL_S = 5.0
"""Time between two lines where there is no terminal [s]."""


class SweepProgress:
    """Progress of a sweep. Use it in a `with` statement.

    Args:
        console: Console of messages.
        total: Number of episodes.
        done: Number of episodes that are complete already.
    """

    def __init__(self, console: Console, *, total: int, done: int) -> None:
        self._console = console
        self._total = total
        self._first = self._done = done
        self._failed = 0
        self._start_s = self._line_s = time.monotonic()
        self._bar = progress_bar(console)
        self._task = self._bar.add_task("episodes", total=total, completed=done)

    def __enter__(self) -> Self:
        if self._done and not self._console.is_terminal:
            self._console.print(f"{self._done}/{self._total} complete already")
        self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._bar.stop()
        if not self._console.is_terminal and self._done > self._first:
            self._print_line()

    def advance(self, result: Result) -> None:
        """Count a result; a failure is shown with its cause."""
        self._done += 1
        name = f"{result.id.removeprefix('GAUGE/')} on {result.backend}"
        if result.outcome.value == "failed":
            self._failed += 1
            self._console.print(plain_text(f"failed: {name}, seed {result.seed}: {result.error}"), soft_wrap=True)
        self._bar.update(self._task, advance=1, description=name)
        if not self._console.is_terminal and time.monotonic() - self._line_s > LINE_INTERVAL_S:
            self._print_line()

    def _print_line(self) -> None:
        self._line_s = time.monotonic()
        here, elapsed_s = self._done - self._first, self._line_s - self._start_s
        rate = here / elapsed_s if elapsed_s else 0.0
        left_s = (self._total - self._done) / rate if rate else 0.0
        left = f", about {left_s / 60.0:.1f} min left" if self._done < self._total else ""
        failed = f", {self._failed} failed" if self._failed else ""
        self._console.print(f"{self._done}/{self._total}{failed}, {rate:.1f} episodes/s{left}")
