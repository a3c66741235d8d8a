"""Commands that check engines and training configurations."""

from __future__ import annotations

import time
from contextlib import ExitStack
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gauge_envs.cli.arguments import Json, Wide, check_one_format, parsed_settings
from gauge_envs.cli.check_matrix import MatrixOutput, check_matrix
from gauge_envs.cli.output import (
    EXIT_FAILED,
    counted,
    echo,
    plain_text,
    print_json_lines,
    print_table,
    progress_bar,
    stderr_console,
    stdout_console,
)
from gauge_envs.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.console import Console

    from gauge_envs.checks.conformance import CheckResult
    from gauge_envs.checks.sanity import PhenomenonResult, Report, Verdict


__all__ = [
    "FailOn",
    "OtherEngine",
    "backend_app",
    "backend_check",
    "backend_list",
    "has_failed",
    "print_report",
    "sanity",
]


class OtherEngine(StrEnum):
    """Engine on which flagged rows are run again."""

    MUJOCO_WARP = "mujoco_warp"


class FailOn(StrEnum):
    """Least bad verdict with which a sanity check fails."""

    WRONG = "wrong"
    VISIBLE = "visible"
    NEVER = "never"


def sanity(
    target: Annotated[
        str | None,
        typer.Argument(
            help="Training configuration: a Gymnasium id with a MuJoCo model (HalfCheetah-v5), a task of "
            "dm_control's suite (dm_control:walker/walk), of MuJoCo Playground (playground:WalkerWalk), of mjlab or of "
            "ManiSkill (maniskill:PickCube-v1), the params/env.yaml of Isaac Lab, a model file (robot.xml), a settings "
            "file (.toml, .json), or a backend and a preset (mujoco:out_of_box)."
        ),
    ] = None,
    pair: Annotated[
        str | None,
        typer.Option(
            metavar="GEOM1,GEOM2",
            help="Two geoms whose contact constants are used; by default all on the ground.",
        ),
    ] = None,
    against: Annotated[
        str | None,
        typer.Option(
            metavar="TARGET", help="Target where the policy runs: report what changes from the first target to it."
        ),
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option("--only", help="Ids or patterns of phenomena, as 'creep-*,gravity'; repeatable."),
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="Also check deformable bodies, which takes longer.")] = False,
    describe: Annotated[
        bool, typer.Option("--list", help="List ids, titles and kinds of the phenomena, and measure none.")
    ] = False,
    fail_on: Annotated[FailOn, typer.Option(help="Exit code 1 when a phenomenon is at least as bad as this.")] = (
        FailOn.NEVER
    ),
    baseline: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="JSON output of an earlier run; exit code 1 on regressions only."),
    ] = None,
    time_limit_s: Annotated[
        float | None,
        typer.Option(
            "--time-limit-s", min=0.0, help="Start no simulation after this time in s; other rows are declined."
        ),
    ] = None,
    on_engine: Annotated[
        OtherEngine | None,
        typer.Option(help="Run flagged rows of a MuJoCo model again on mujoco_warp: a minute more, longer at first."),
    ] = None,
    html: Annotated[Path | None, typer.Option(metavar="FILE", help="File for an HTML page with pictures.")] = None,
    markdown: Annotated[bool, typer.Option("--markdown", help="The table as GitHub Markdown.")] = False,
    json_lines: Json = False,
    wide: Wide = False,
) -> None:
    """Report which physics a training configuration gets wrong, and the change that corrects most of it.

    Runs measured objects with the numerical settings of the target and of this package's presets, and compares both
    with real trials and laws. Exit code 1 for a phenomenon as bad as --fail-on states, for a regression from
    --baseline, or when nothing could be measured.
    """
    from gauge_envs.checks.sanity import check, configuration
    from gauge_envs.checks.sanity.baseline import read_baseline
    from gauge_envs.checks.sanity.selection import selection
    from gauge_envs.checks.sanity.target import compiled_model
    from gauge_envs.report.sanity import phenomena_rows, phenomena_table
    from gauge_envs.report.sanity_page import check_can_draw, save_sanity_page

    check_one_format(json_lines, markdown)
    patterns = only or []
    if describe:
        listed = phenomena_rows(include_deformables=every, only=patterns)
        print_table(phenomena_table(listed), json_lines=json_lines, wide=wide)
        return
    if target is None:
        raise ParameterError("no target is given: name one, as in gauge sanity HalfCheetah-v5, or use --list")
    if against is not None:
        if html is not None or baseline is not None or pair is not None:
            raise ParameterError("--against goes with none of --html, --baseline and --pair: leave them out")
        _compare(target, against, patterns, every, time_limit_s, fail_on, json_lines, markdown, wide)
        return
    if html is not None:
        check_can_draw()
    before = None if baseline is None else read_baseline(baseline)
    checked = configuration(target, pair=_geom_pair(pair))
    with progress_bar(stderr_console()) as progress:
        bar = progress.add_task("phenomena", total=len(selection(patterns, include_deformables=every)))

        def notify(row: PhenomenonResult) -> None:
            progress.update(bar, advance=1, description=row.phenomenon)

        report = check(checked, only=patterns, include_deformables=every, time_limit_s=time_limit_s, notify=notify)
        if on_engine is not None:
            from gauge_envs.checks.sanity.mujoco_warp_run import with_mujoco_warp

            progress.update(bar, description=on_engine.value)
            report = with_mujoco_warp(report, model=compiled_model(target))
    print_report(report, json_lines, markdown, wide)
    if html is not None:
        stderr_console().print(plain_text(str(save_sanity_page(report, html))), soft_wrap=True)
    if has_failed(report, fail_on, before):
        raise typer.Exit(EXIT_FAILED)


def print_report(report: Report, json_lines: bool, markdown: bool, wide: bool) -> None:
    """Print a sanity check as JSON lines, as Markdown, or for a terminal."""
    from gauge_envs.report.sanity import sanity_markdown, sanity_rows, sanity_view

    if json_lines:
        print_json_lines(sanity_rows(report))
    elif markdown:
        echo(sanity_markdown(report), nl=False)
    else:
        stdout_console().print(sanity_view(report, wide=wide))


def _compare(
    trained: str,
    deployed: str,
    patterns: list[str],
    every: bool,
    time_limit_s: float | None,
    fail_on: FailOn,
    json_lines: bool,
    markdown: bool,
    wide: bool,
) -> None:
    """Print what changes between two targets; exit code 1 for a change as large as --fail-on states."""
    from gauge_envs.checks.sanity.against import Change, compare
    from gauge_envs.report.sanity_against import against_markdown, against_rows, against_view

    comparison = compare(trained, deployed, only=patterns, include_deformables=every, time_limit_s=time_limit_s)
    if json_lines:
        print_json_lines(against_rows(comparison))
    elif markdown:
        echo(against_markdown(comparison), nl=False)
    else:
        stdout_console().print(against_view(comparison, wide=wide))
    bad = {FailOn.WRONG: (Change.LARGE,), FailOn.VISIBLE: (Change.LARGE, Change.VISIBLE), FailOn.NEVER: ()}
    if any(row.change in bad[fail_on] for row in comparison.rows):
        raise typer.Exit(EXIT_FAILED)


def has_failed(report: Report, fail_on: FailOn, before: Mapping[str, Verdict] | None) -> bool:
    """Return whether a sanity check ends with an error, and print regressions from a baseline."""
    from gauge_envs.checks.sanity import Verdict
    from gauge_envs.checks.sanity.baseline import regressions

    applicable = [row for row in report.rows if row.applies]
    if applicable and report.worst is Verdict.DECLINED:
        return True
    if before is None:
        bad = {FailOn.WRONG: (Verdict.WRONG,), FailOn.VISIBLE: (Verdict.WRONG, Verdict.VISIBLE), FailOn.NEVER: ()}
        return report.worst in bad[fail_on]
    worse = regressions(report, before, least=Verdict.WRONG if fail_on is FailOn.WRONG else Verdict.VISIBLE)
    for row in worse:
        was = before.get(row.phenomenon, Verdict.DECLINED)
        stderr_console().print(plain_text(f"regression: {row.phenomenon}: {row.verdict.value}, was {was.value}"))
    return bool(worse)


def _geom_pair(text: str | None) -> tuple[str, str] | None:
    if text is None:
        return None
    names = [name.strip() for name in text.split(",")]
    if len(names) != 2 or not all(names):
        raise ParameterError(f"--pair {text!r}: expected the names of two geoms, as floor,foot")
    return names[0], names[1]


backend_app = typer.Typer(help="Installed physics engines.", no_args_is_help=True)


@backend_app.command("list")
def backend_list(json_lines: Json = False) -> None:
    """List installed backends and the versions of their engines."""
    from gauge_envs.report import backend_rows, backend_table

    print_table(backend_table(backend_rows(isolate=True)), json_lines=json_lines)


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
    from gauge_envs.checks.conformance import checks
    from gauge_envs.checks.conformance.matrix import CANONICAL
    from gauge_envs.checks.conformance.run import CHECK_LIMIT_S
    from gauge_envs.report.conformance import checks_table, findings_markdown, findings_view

    patterns = only or []
    if describe:
        print_table(checks_table(checks(patterns)), json_lines=json_lines, wide=wide)
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
    if markdown:
        echo(findings_markdown(findings))
    elif not json_lines:
        stdout_console().print(findings_view(findings, wide=wide))
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
    from gauge_envs.checks.conformance import checks, run_checks
    from gauge_envs.runs.isolation import Worker

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
