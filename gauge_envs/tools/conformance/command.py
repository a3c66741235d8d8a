"""`gauge backend check`, and the lists of engines and checks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import (
    LINE_INTERVAL_S,
    Format,
    Progress,
    echo,
    message,
    print_document,
    print_json_lines,
)
from gauge_envs.errors import ParameterError

if TYPE_CHECKING:
    from gauge_envs.pages.table import Table
    from gauge_envs.tools.conformance import CheckResult
    from gauge_envs.tools.conformance.expectations import Expectation
    from gauge_envs.tools.conformance.results import EngineColumn

ALWAYS = ("determinism",)
"""Checks that always run, because a failure of them makes all other results worthless."""

CHECK_LIMIT_S = 600.0
"""Default time limit of a check in another process [s]."""


def list_backends(patterns: Sequence[str]) -> list[Table]:
    """Return the table of the installed engines and their versions."""
    from gauge_envs.tools.conformance.report import backends_table

    return arguments.matching([backends_table()], patterns, kind="backend")


def list_checks(patterns: Sequence[str]) -> list[Table]:
    """Return the table of the checks with their scenes and laws."""
    from gauge_envs.tools.conformance import checks
    from gauge_envs.tools.conformance.report import checks_table

    return [checks_table(checks(patterns))]


def backend_check(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="NAME",
            help="Engines. ENGINE:CONFIGURATION is one of the solvers and presets that an engine declares, as "
            "mujoco:PGS; patterns as 'mujoco:*' and '*:*' are all.",
        ),
    ] = None,
    only: arguments.Only = None,
    changes: arguments.Settings = None,
    timeout: Annotated[
        float | None,
        arguments.timeout(
            "Time of a check in a separate process.", "600 in a separate process"
        ),
    ] = None,
    memory: arguments.Memory = None,
    isolate: arguments.Isolate = False,
    out: Annotated[
        Path | None,
        arguments.target("All results (.json), which --baseline reads."),
    ] = None,
    baseline: Annotated[
        Path | None,
        arguments.option(
            arguments.SELECTION,
            "A .json file of --out by an earlier version of the engine: fail only if a result got worse or moved.",
            metavar="FILE",
        ),
    ] = None,
    expected: Annotated[
        Path | None,
        arguments.option(
            arguments.SELECTION,
            'A TOML file of known failures, as rebound-flat = { measured = 0.513, reason = "no model of it" }, and of '
            "unsupported checks: exit code 0 when exactly these fail, with these values.",
            metavar="FILE",
        ),
    ] = None,
    export: Annotated[
        Path | None,
        arguments.option(
            arguments.OUTPUT,
            "Write the scenes of checks of rigid bodies as MJCF and USD, and their laws as checks.json. No engine is "
            "judged.",
            metavar="DIR",
        ),
    ] = None,
    judge: Annotated[
        Path | None,
        arguments.option(
            arguments.SELECTION,
            "A folder of --export with a CSV file of the motion in each scene: judge these in place of an engine.",
            metavar="DIR",
        ),
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Check engines against closed forms, with the most likely cause of each failure.

    gauge list checks shows the checks. Exit code 1 when a check that ran failed, or nothing was measured.
    With --expected: when a result is not as listed. With --baseline: when a result became worse or moved by more than
    its tolerance. An unsupported check is not a failure. Engines of other packages run in another process. All engines
    do so with --isolate, --timeout, --memory, --out or a configuration: a crash or a hang there costs one check.
    """
    from gauge_envs.tools.conformance import checks
    from gauge_envs.tools.conformance.results import engine_columns, write_columns

    if not names:
        others = (changes, timeout, memory, isolate, out, baseline, expected)
        return _of_files(export, judge, only or (), form, has_others=any(others))
    if export or judge:
        raise ParameterError("--export and --judge run no engine: leave out NAME")
    if misplaced := sorted({check.id for check in checks()}.intersection(names)):
        raise ParameterError(
            f"{misplaced[0]!r} is a check and no backend: choose it by --only {misplaced[0]}"
        )
    chosen = [check.id for check in checks(only or ())]
    settings = arguments.parsed_settings(changes)
    is_apart = isolate or timeout is not None or memory is not None or out is not None
    is_apart |= any(":" in name for name in names)
    columns = engine_columns(names, settings, isolate=is_apart)
    # Files are read and written before checks run that may take hours.
    expectation = _expectation(columns, expected, baseline)
    if out is not None:
        arguments.by_suffix([out], ".json")
        write_columns([], out)
    limits = (CHECK_LIMIT_S if timeout is None else timeout, memory)
    try:
        for result in _results(columns, chosen, limits, is_apart):
            if form is Format.JSON:
                print_json_lines([result.to_dict()])
            if out is not None:
                # A process that is killed leaves the results so far.
                write_columns([column for column in columns if column.made], out)
    except KeyboardInterrupt:
        _print(columns, form)
        raise
    if out is not None:
        message(out)
    _check_settings(columns)
    _print(columns, form)
    return _is_unexpected(columns, expectation)


def _of_files(
    export: Path | None,
    judge: Path | None,
    only: Sequence[str],
    form: Format,
    *,
    has_others: bool,
) -> bool:
    """Write scenes of checks, or judge their motions; return whether a check failed or nothing was measured."""
    from gauge_envs.pages.text import counted
    from gauge_envs.tools.conformance.files import export_scenes, judge_motions

    if has_others or (export is None) == (judge is None):
        raise ParameterError(
            "give engines, as in gauge backend check mujoco; or --export DIR or --judge DIR, with --only and --format"
        )
    if export is not None:
        echo(f"{counted(len(export_scenes(export, only)), 'check')} in {export}")
        return False
    assert judge is not None
    column = judge_motions(judge, only)
    if form is Format.JSON:
        print_json_lines(result.to_dict() for result in column.results.values())
    _print([column], form)
    return _is_unexpected([column], None)


def _expectation(
    columns: Sequence[EngineColumn], expected: Path | None, baseline: Path | None
) -> Expectation | None:
    """Return the results that the user expects of one engine; None for passed checks."""
    from gauge_envs.tools.conformance.expectations import expectation_of

    engine = columns[0].backend
    is_several = any(column.backend != engine for column in columns)
    if is_several and (expected is not None or baseline is not None):
        raise ParameterError(
            "--expected and --baseline need exactly one engine: leave out other names"
        )
    configurations = [column.name for column in columns]
    return expectation_of(engine, expected, baseline, configurations)


def _results(
    columns: Sequence[EngineColumn],
    chosen: Sequence[str],
    limits: tuple[float, float | None],
    is_apart: bool,
) -> Iterator[CheckResult]:
    """Run the chosen checks of columns and `ALWAYS`; yield each result that its column keeps.

    Args:
        columns: The columns.
        chosen: Ids of the checks.
        limits: Limits of a process: time of a check [s], and memory [GB].
        is_apart: Whether engines of this package also run in another process.
    """
    from gauge_envs.backends.registry import is_bundled
    from gauge_envs.runs.workers import Worker
    from gauge_envs.tools.conformance import Status
    from gauge_envs.tools.conformance.results import run_column

    total = len(chosen) * len(columns)
    with Progress("checks", total, line_interval_s=LINE_INTERVAL_S) as progress:
        for column in columns:
            is_here = is_bundled(column.backend) and not is_apart
            with Worker(*limits) as worker:
                process = None if is_here else worker
                for result in run_column(column, [*chosen, *ALWAYS], process):
                    if result.check in chosen or result.status is Status.FAIL:
                        progress.advance(f"{column.title}: {result.check}")
                        yield result
                    else:
                        del column.results[result.check]


def _print(columns: Sequence[EngineColumn], form: Format) -> None:
    """Print the results of one engine, or a table of several engines; JSON lines are printed before."""
    from gauge_envs.tools.conformance.report import comparison, engine_document

    if form is Format.JSON:
        return
    for column in columns:
        if column.reason:
            message(f"{column.title}: {column.reason}")
    ran = [column for column in columns if column.results]
    if len(ran) == 1:
        print_document(engine_document([*ran[0].results.values()]), form)
    elif ran:
        print_document(comparison(ran), form)


def _check_settings(columns: Sequence[EngineColumn]) -> None:
    """Raise a `ParameterError` if no engine can be used, or every engine rejects the settings in every scene."""
    results = [result for column in columns for result in column.results.values()]
    reasons = [column.reason for column in columns if column.reason]
    reasons += ["; ".join(result.missing) for result in results]
    if all(result.rejects_settings for result in results):
        raise ParameterError(reasons[0])


def _is_unexpected(
    columns: Sequence[EngineColumn], expectation: Expectation | None
) -> bool:
    """Print counts and unexpected results; return whether there are any, or nothing was measured."""
    from gauge_envs.tools.conformance.results import counts_text

    results = [result for column in columns for result in column.results.values()]
    is_measured = any(not result.missing for result in results)
    if not is_measured:
        message("nothing was measured")
    elif len(columns) > 1:
        message(counts_text(results))
    is_bad = not is_measured or any(column.reason for column in columns)
    if expectation is None:
        return is_bad or any(result.is_bad for result in results)
    for result in results:
        difference = expectation.difference(result)
        if difference is not None:
            message(f"not expected: {result.check} {difference}")
            is_bad = True
    return is_bad
