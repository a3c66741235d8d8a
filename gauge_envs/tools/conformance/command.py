"""`gauge backend check`."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from shlex import join
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gauge_envs.cli.arguments import (
    FormatOption,
    LimitsOption,
    OnlyOption,
    ProcessLimits,
    SettingsOption,
    by_suffix,
    matching,
    parsed_limits,
    parsed_settings,
    split_list,
)
from gauge_envs.cli.output import Format, Progress, counted, message, print_document, print_json_lines
from gauge_envs.errors import ParameterError, ResultFileError

if TYPE_CHECKING:
    from gauge_envs.pages.table import Table
    from gauge_envs.runs.isolation import Worker
    from gauge_envs.tools.conformance import CheckResult
    from gauge_envs.tools.conformance.matrix import MatrixColumn

LINE_INTERVAL_S = 5.0
"""Least time between two lines of progress where there is no terminal [s]."""


def list_backends(patterns: Sequence[str]) -> list[Table]:
    """Return the table of the installed engines and their versions."""
    from gauge_envs.tools.conformance.words import backends_table

    return matching([backends_table()], patterns, kind="backend")


def list_checks(patterns: Sequence[str]) -> list[Table]:
    """Return the table of the checks with their scenes and laws."""
    from gauge_envs.tools.conformance import checks
    from gauge_envs.tools.conformance.words import checks_table

    return [checks_table(checks(patterns))]


def backend_check(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="NAME...",
            help="Engines, one column of the table each. ENGINE:CONFIGURATION is one of the solvers and presets that "
            "an engine declares, as mujoco:PGS; patterns as 'mujoco:*' and '*:*' are all. A .json file of --out has "
            "columns that are not measured again.",
        ),
    ] = None,
    only: OnlyOption = None,
    changes: SettingsOption = None,
    limits: LimitsOption = "",
    out: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="Page with checks in rows, engines in columns, and all commands (.html), or the columns (.json); "
            "repeatable.",
        ),
    ] = None,
    form: FormatOption = Format.TEXT,
) -> bool:
    """Check engines against closed forms, with a diagnosis of each failure.

    gauge list checks shows the checks; for configurations, one per phenomenon runs without --only. Exit code 1 when a
    check failed or raised an error. A declined check is no failure. Engines of other packages run in another process,
    all engines do with --limits, --out or a configuration: one that crashes, exits or hangs there costs one check.
    """
    from gauge_envs.tools.conformance import checks
    from gauge_envs.tools.conformance.matrix import CANONICAL
    from gauge_envs.tools.conformance.run import CHECK_LIMIT_S

    if not names:
        raise ParameterError("no backend is given: name one, as in gauge backend check mujoco; see gauge list backends")
    files = [Path(name) for name in names if name.endswith(".json")]
    engines = list(dict.fromkeys(name for name in names if not name.endswith(".json")))
    if misplaced := {one.id for one in checks()}.intersection(engines):
        name = min(misplaced)
        raise ParameterError(f"{name!r} is a check and no backend: repeat the option, as --only {name}")
    patterns = [part for text in only or () for part in split_list(text)]
    bounds = parsed_limits(limits)
    if bounds.time_s is None:
        bounds = bounds._replace(time_s=CHECK_LIMIT_S)
    has_configurations = any(":" in name for name in engines)
    if has_configurations or files or out:
        matrix = _Matrix(by_suffix(out, ".html", ".json"), form, bounds)
        return matrix.run(
            engines, files, parsed_settings(changes), patterns or (CANONICAL if has_configurations else [])
        )
    return _check(engines, patterns, parsed_settings(changes), bounds, form)


def _check(
    engines: Sequence[str], only: Sequence[str], settings: Mapping[str, Any] | None, limits: ProcessLimits, form: Format
) -> bool:
    """Run checks on engines, print the results, and return whether one is bad."""
    from gauge_envs.backends import backend_names
    from gauge_envs.backends.registry import is_bundled
    from gauge_envs.tools.conformance import checks, run_checks
    from gauge_envs.tools.conformance.words import findings_document

    findings: list[CheckResult] = []
    apart = {name for name in backend_names() if limits.isolate or not is_bundled(name)}
    total = len(checks(only)) * len(engines)
    with Progress("checks", total, line_interval_s=LINE_INTERVAL_S) as progress, _worker(limits) as worker:
        # Settings and patterns of all engines are checked before the first one runs.
        runs = [
            run_checks(name, settings=settings, only=only, worker=worker if name in apart else None) for name in engines
        ]
        for finding in (finding for run in runs for finding in run):
            findings.append(finding)
            progress.advance(f"{finding.backend}: {finding.check}")
            if form is Format.JSON:
                print_json_lines([finding.to_dict()])
    if form is not Format.JSON:
        print_document(findings_document(findings), form)
    bad = sum(finding.is_bad for finding in findings)
    message(f"{counted(len(findings), 'check')}, {bad} failed")
    return bad > 0


def _worker(limits: ProcessLimits) -> Worker:
    from gauge_envs.runs.isolation import Worker

    assert limits.time_s is not None
    return Worker(limits.time_s, limits.memory_gb)


class _Matrix:
    """A matrix of engines and checks; where it goes is checked before checks run, which may take hours.

    Args:
        files: Files by suffix: the page, and the columns.
        form: Format on stdout. A matrix has no text for a terminal.
        limits: Limits of a process.
    """

    def __init__(self, files: Mapping[str, Path], form: Format, limits: ProcessLimits) -> None:
        from gauge_envs.files import check_replaceable
        from gauge_envs.runs.batch import check_writable

        self._files, self._form, self._limits = files, form, limits
        if not files and form not in (Format.JSON, Format.MARKDOWN):
            raise ParameterError(
                "configurations and files make a matrix: give --out PAGE.html, --out FILE.json, --format markdown or "
                "--json"
            )
        for file in files.values():
            try:
                check_replaceable(file)
            except OSError as error:
                raise ResultFileError(f"{file}: cannot be written: {error.strerror}") from error
            check_writable(file.parent)

    def run(
        self, names: Sequence[str], files: Sequence[Path], settings: Mapping[str, Any] | None, only: Sequence[str]
    ) -> bool:
        """Run checks, each engine in a process of its own, write the matrix, and return whether a result is bad.

        Args:
            names: Engines and configurations that run.
            files: Files with further columns.
            settings: Settings for every column that runs.
            only: Ids or patterns of checks; none are those of the files.
        """
        from gauge_envs.pages.document import save_file
        from gauge_envs.tools.conformance import checks
        from gauge_envs.tools.conformance.matrix import matrix_columns
        from gauge_envs.tools.conformance.matrix_file import with_columns, write_columns
        from gauge_envs.tools.conformance.page import conformance_page
        from gauge_envs.tools.conformance.words import matrix_document

        new: list[MatrixColumn] = []
        if names:
            with _worker(self._limits) as importer:
                new = matrix_columns(names, settings, worker=importer)
        # Before anything runs, so that a wrong file costs no time.
        columns = with_columns(new, files)
        rows = self._files.get(".json")
        for column in self._measured(new, only):
            if rows is not None and column is not new[-1]:
                # After each column, so that a run that is stopped leaves the columns that ended.
                write_columns([one for one in columns if one.made], rows)
        found = {name for column in columns for name in (*column.findings, *column.refused)}
        chosen = [check for check in checks(only) if new or only or check.id in found]
        if rows is not None:
            message(write_columns(columns, rows))
        if ".html" in self._files:
            command = join(["gauge", *sys.argv[1:]])
            page = conformance_page(columns, chosen, command=command, when=datetime.now(UTC))
            message(save_file(self._files[".html"], page))
        if self._form is not Format.JSON:
            print_document(matrix_document(columns, chosen), self._form)
        bad = sum(finding.is_bad for column in new for finding in column.findings.values())
        if new:
            message(f"{counted(sum(len(column.findings) for column in new), 'check')}, {bad} failed")
        else:
            message(f"{counted(len(columns), 'column')} of files; no check ran")
        return bad > 0

    def _measured(self, columns: Sequence[MatrixColumn], only: Sequence[str]) -> Iterator[MatrixColumn]:
        """Run the checks of columns, and yield each column as it ends."""
        from gauge_envs.tools.conformance import checks
        from gauge_envs.tools.conformance.matrix import run_column

        with Progress("checks", len(checks(only)) * len(columns)) as progress:
            for _, group in groupby(columns, key=lambda column: column.backend):
                # Configurations of one engine share a process, which imports it once; two engines share none.
                with _worker(self._limits) as worker:
                    for column in group:
                        for finding in run_column(column, only, worker):
                            progress.advance(f"{column.title}: {finding.check}")
                            if self._form is Format.JSON:
                                print_json_lines([finding.to_dict() | {"configuration": column.name}])
                        progress.line(f"{column.title}: {_summary(column)}")
                        yield column


def _summary(column: MatrixColumn) -> str:
    bad = sum(finding.is_bad for finding in column.findings.values())
    return column.reason or f"{counted(len(column.findings), 'check')}, {bad} failed"
