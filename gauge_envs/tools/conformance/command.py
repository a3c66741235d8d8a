"""`gauge backend`."""

from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gauge_envs.cli.arguments import Json, Wide, parsed_settings
from gauge_envs.cli.output import (
    EXIT_FAILED,
    counted,
    plain_text,
    print_document,
    print_json_lines,
    progress_bar,
    stderr_console,
)
from gauge_envs.errors import ParameterError
from gauge_envs.tools.conformance.matrix_command import MatrixOutput, check_matrix

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.console import Console

    from gauge_envs.tools.conformance import CheckResult


backend_app = typer.Typer(help="Installed physics engines.", no_args_is_help=True)


@backend_app.command("list")
def backend_list(json_lines: Json = False) -> None:
    """List installed backends and the versions of their engines."""
    from gauge_envs.tools.conformance.words import backends_table

    print_document(backends_table(), json_lines=json_lines)


@backend_app.command("check")
def backend_check(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="NAME...", help="Engines; one column of the table each.")
    ] = None,
    only: Annotated[list[str] | None, typer.Option("--only", help="Id or pattern of checks; repeatable.")] = None,
    changes: Annotated[
        list[str] | None, typer.Option("--set", help="Numerical setting of the engines, as timestep_s=0.0005.")
    ] = None,
    describe: Annotated[
        bool, typer.Option("--list", help="List the checks with their scenes and laws, and run none.")
    ] = False,
    isolate: Annotated[
        bool,
        typer.Option("--isolate", help="Run the checks in another process; engines of other packages always do."),
    ] = False,
    time_limit_s: Annotated[
        float | None, typer.Option(help="Time limit of a check in another process in s, 600 by default.")
    ] = None,
    memory_limit_gb: Annotated[
        float | None, typer.Option(help="Limit of the resident memory of that process in GB, on Linux.")
    ] = None,
    every: Annotated[
        bool,
        typer.Option(
            "--all",
            help="Every solver and preset that the backends declare, of all installed ones if none is named; one check "
            "per phenomenon without --only. Needs --report, --out, --markdown or --json.",
        ),
    ] = False,
    configurations: Annotated[
        list[str] | None,
        typer.Option("--configuration", metavar="NAME", help="With --all, only this solver or preset; repeatable."),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(metavar="PAGE", help="One HTML page: checks in rows, engines in columns, with all commands."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="File for the columns of the page, which --from reads.")
    ] = None,
    files: Annotated[
        list[Path] | None,
        typer.Option(
            "--from",
            metavar="FILE",
            help="Columns that --out wrote, which are not measured again; repeatable.",
        ),
    ] = None,
    json_lines: Json = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="The table as GitHub Markdown.")] = False,
    wide: Wide = False,
) -> None:
    """Check engines against closed forms in small scenes, with a diagnosis of each failure.

    Exit code 1 when a check failed or raised an error. A declined check is no failure. An engine that crashes, exits or
    hangs in another process costs one check. A limit implies --isolate, and so do --all, --report and --out.
    """
    from gauge_envs.tools.conformance import checks
    from gauge_envs.tools.conformance.matrix import CANONICAL
    from gauge_envs.tools.conformance.run import CHECK_LIMIT_S
    from gauge_envs.tools.conformance.words import checks_table, findings_document

    patterns = only or []
    if describe:
        print_document(checks_table(checks(patterns)), json_lines=json_lines, wide=wide)
        return
    if not names and not every and not files:
        raise ParameterError("no backend is given: name one, as in gauge backend check mujoco, or use --list or --all")
    if misplaced := [name for name in names or [] if name in {one.id for one in checks()}]:
        raise ParameterError(f"{misplaced[0]!r} is a check and no backend: repeat the option, as --only {misplaced[0]}")
    if configurations and not every:
        raise ParameterError("--configuration chooses among those of --all: add --all")
    limit_s = CHECK_LIMIT_S if time_limit_s is None else time_limit_s
    if every or files or report is not None or out is not None:
        output = MatrixOutput(report=report, file=out, json_lines=json_lines, markdown=markdown)
        output.check()
        check_matrix(
            names or [],
            every=every,
            configurations=configurations or [],
            files=files or [],
            settings=parsed_settings(changes or []),
            only=patterns or (CANONICAL if every else []),
            limits=(limit_s, memory_limit_gb),
            output=output,
        )
        return
    findings = _findings(
        list(dict.fromkeys(names or [])),
        patterns,
        parsed_settings(changes or []),
        isolate=isolate or time_limit_s is not None or memory_limit_gb is not None,
        limits=(limit_s, memory_limit_gb),
        json_lines=json_lines,
    )
    if not json_lines:
        print_document(findings_document(findings), markdown=markdown, wide=wide)
    bad = sum(finding.is_bad for finding in findings)
    stderr_console().print(f"{counted(len(findings), 'check')}, {bad} failed")
    if bad:
        raise typer.Exit(EXIT_FAILED)


def _findings(
    engines: list[str],
    patterns: list[str],
    settings: Mapping[str, Any] | None,
    *,
    isolate: bool,
    limits: tuple[float, float | None],
    json_lines: bool,
) -> list[CheckResult]:
    """Run checks on engines and return the results, with a bar or lines of progress."""
    from gauge_envs.backends import backend_names
    from gauge_envs.backends.registry import is_bundled
    from gauge_envs.runs.isolation import Worker
    from gauge_envs.tools.conformance import checks, run_checks

    findings: list[CheckResult] = []
    stderr = stderr_console()
    total = len(checks(patterns)) * len(engines)
    lines = _ProgressLines(stderr, total)
    apart = {name for name in backend_names() if isolate or not is_bundled(name)}
    with ExitStack() as stack:
        progress = stack.enter_context(progress_bar(stderr))
        worker = stack.enter_context(Worker(*limits))
        bar = progress.add_task("checks", total=total)
        runs = [
            run_checks(name, settings=settings, only=patterns, worker=worker if name in apart else None)
            for name in engines
        ]
        for run in runs:
            for finding in run:
                findings.append(finding)
                progress.update(bar, advance=1, description=f"{finding.backend}: {finding.check}")
                lines.update(len(findings), f"{finding.backend}: {finding.check}")
                if json_lines:
                    print_json_lines([finding.to_dict()])
    return findings


class _ProgressLines:
    """Lines that report progress where there is no terminal, at most one every few seconds.

    Args:
        console: The console of messages.
        total: Number of checks.
    """

    INTERVAL_S = 5.0

    def __init__(self, console: Console, total: int) -> None:
        self._console, self._total = console, total
        self._last_s = time.monotonic()

    def update(self, done: int, text: str) -> None:
        """Print a line if there is no terminal and the last line is old."""
        now_s = time.monotonic()
        if self._console.is_terminal or now_s - self._last_s < self.INTERVAL_S:
            return
        self._last_s = now_s
        self._console.print(plain_text(f"{done} of {counted(self._total, 'check')} done, {text}"), soft_wrap=True)
