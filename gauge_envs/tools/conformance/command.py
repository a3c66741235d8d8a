"""`gauge backend check`, and the lists of engines and checks."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from shlex import join
from typing import TYPE_CHECKING, Annotated, Any, Self

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import (
    LINE_INTERVAL_S,
    Format,
    Progress,
    message,
    print_document,
    print_json_lines,
)
from gauge_envs.errors import ParameterError, ResultFileError
from gauge_envs.pages.text import counted

if TYPE_CHECKING:
    from gauge_envs.pages.table import Table
    from gauge_envs.tools.conformance import CheckResult
    from gauge_envs.tools.conformance.matrix import MatrixColumn

Limits = tuple[float, float | None]
"""Limits of a process: time of a check [s], and memory [GB]."""


def list_backends(patterns: Sequence[str]) -> list[Table]:
    """Return the table of the installed engines and their versions."""
    from gauge_envs.tools.conformance.words import backends_table

    return arguments.matching([backends_table()], patterns, kind="backend")


def list_checks(patterns: Sequence[str]) -> list[Table]:
    """Return the table of the checks with their scenes and laws."""
    from gauge_envs.tools.conformance import checks
    from gauge_envs.tools.conformance.words import checks_table

    return [checks_table(checks(patterns))]


def backend_check(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="NAME",
            show_default=False,
            help="Engines, one column of the table each. ENGINE:CONFIGURATION is one of the solvers and presets that "
            "an engine declares, as mujoco:PGS; patterns as 'mujoco:*' and '*:*' are all. A .json file of --out has "
            "columns that are not measured again.",
        ),
    ] = None,
    only: arguments.Only = None,
    changes: arguments.Settings = None,
    timeout: Annotated[
        float | None,
        arguments.timeout(
            "Time of a check, in a process of its own.", "600 in such a one"
        ),
    ] = None,
    memory: arguments.Memory = None,
    isolate: arguments.Isolate = False,
    out: Annotated[
        list[Path] | None,
        arguments.target("Page with all commands (.html), or columns (.json)."),
    ] = None,
    baseline: Annotated[
        Path | None,
        arguments.option(
            arguments.SELECTION,
            "A .json file of --out by an earlier version of the engine: list what got worse or moved.",
            metavar="FILE",
        ),
    ] = None,
    expected: Annotated[
        Path | None,
        arguments.option(
            arguments.SELECTION,
            'A TOML file of checks that this engine fails, each with a reason, as rebound-flat = "no model of '
            'it": exit code 0 when exactly these fail.',
            metavar="FILE",
        ),
    ] = None,
    badge: Annotated[
        Path | None,
        arguments.option(
            arguments.OUTPUT,
            "Counts of passed checks as JSON for a badge of shields.io.",
            metavar="FILE",
        ),
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Check engines against closed forms, with a diagnosis of each failure.

    gauge list checks shows the checks; for configurations, one per phenomenon runs without --only: NAME:default is the
    quick check of an engine. Exit code 1 when a check failed or raised an error; with --expected, when others than the
    listed ones failed; with --baseline, when one became worse or its value moved by more than its tolerance. A declined
    check is no failure, unless all are. Engines of other packages run in another process, all engines do with
    --isolate, --out, --baseline or a configuration: one that crashes, exits or hangs there costs one check.
    """
    from gauge_envs.tools.conformance import checks
    from gauge_envs.tools.conformance.matrix import CANONICAL, read_columns
    from gauge_envs.tools.conformance.run import CHECK_LIMIT_S

    if not names:
        raise ParameterError(
            "no backend is given: name one, as in gauge backend check mujoco; see gauge list backends"
        )
    files = [Path(name) for name in names if name.endswith(".json")]
    engines = list(dict.fromkeys(name for name in names if not name.endswith(".json")))
    if misplaced := sorted({one.id for one in checks()}.intersection(engines)):
        raise ParameterError(
            f"{misplaced[0]!r} is a check and no backend: choose it by --only {misplaced[0]}"
        )
    settings = arguments.parsed_settings(changes)
    bounds = (CHECK_LIMIT_S if timeout is None else timeout, memory)
    isolate = isolate or timeout is not None or memory is not None
    has_configurations = any(":" in name for name in engines)
    judged = None
    if expected is not None or badge is not None:
        if len(engines) != 1 or has_configurations or baseline or out:
            raise ParameterError(
                "--expected and --badge are of the default of one engine: leave out other names, --out and --baseline"
            )
        judged = _Judged.read(expected, badge)
    if not (has_configurations or files or out or baseline):
        return _check(engines, only or (), settings, isolate, bounds, form, judged)
    places = _checked_places(arguments.by_suffix(out, ".html", ".json"))
    only_ids = only or (CANONICAL if has_configurations else [])
    before = None if baseline is None else read_columns(baseline)
    return _matrix(engines, files, settings, only_ids, bounds, places, form, before)


@dataclass(frozen=True)
class _Judged:
    """How the repository of an engine judges its results.

    Attributes:
        expected: Reasons by the id of the checks that fail.
        badge: File of the badge, or None.
    """

    expected: Mapping[str, str]
    badge: Path | None

    @classmethod
    def read(cls, expected: Path | None, badge: Path | None) -> Self:
        """Return what the files state, before checks run."""
        from gauge_envs.tools.conformance.expected import read_expected

        if badge is not None:
            _checked_places({".json": badge})
        return cls({} if expected is None else read_expected(expected), badge)

    def __call__(self, findings: Sequence[CheckResult]) -> bool:
        """Write the badge, tell what is otherwise than expected, and return whether something is."""
        from gauge_envs.files import write_whole
        from gauge_envs.tools.conformance.expected import badge, surprise

        if self.badge is not None:
            text = json.dumps(badge(findings, self.expected))
            write_whole(self.badge, f"{text}\n".encode())
        surprises = [
            f"{one.check} {wrong}"
            for one in findings
            if (wrong := surprise(one, self.expected))
        ]
        for line in surprises:
            message(f"not expected: {line}")
        return bool(surprises)


def _check(
    engines: Sequence[str],
    only: Sequence[str],
    settings: Mapping[str, Any] | None,
    isolate: bool,
    limits: Limits,
    form: Format,
    judged: _Judged | None,
) -> bool:
    """Run checks on engines, print the results, and return whether one is bad, or otherwise than expected."""
    from gauge_envs.backends.registry import is_bundled
    from gauge_envs.runs.isolation import Worker
    from gauge_envs.tools.conformance import checks, run_checks
    from gauge_envs.tools.conformance.words import findings_document

    findings: list[CheckResult] = []
    total = len(checks(only)) * len(engines)
    with (
        Progress("checks", total, line_interval_s=LINE_INTERVAL_S) as progress,
        Worker(*limits) as worker,
    ):
        # Settings and patterns of all engines are checked before the first one runs.
        runs = [
            run_checks(
                name,
                settings=settings,
                only=only,
                worker=worker if isolate or not is_bundled(name) else None,
            )
            for name in engines
        ]
        for finding in (finding for run in runs for finding in run):
            findings.append(finding)
            progress.advance(f"{finding.backend}: {finding.check}")
            if form is Format.JSON:
                print_json_lines([finding.to_dict()])
    if form is not Format.JSON:
        print_document(findings_document(findings), form)
    has_failed = _failed(findings)
    if judged is None:
        return has_failed
    return judged(findings) or not _is_measured(findings)


def _is_measured(findings: Sequence[CheckResult]) -> bool:
    return not all(one.missing for one in findings)


def _failed(findings: Sequence[CheckResult]) -> bool:
    """Tell how many checks failed, and return whether one did or nothing was measured."""
    bad = sum(finding.is_bad for finding in findings)
    is_measured = _is_measured(findings)
    rest = "" if is_measured else "; nothing was measured"
    message(f"{counted(len(findings), 'check')}, {bad} failed{rest}")
    return bad > 0 or not is_measured


def _checked_places(files: Mapping[str, Path]) -> Mapping[str, Path]:
    """Return files that can be written, before checks run that may take hours."""
    from gauge_envs.files import check_replaceable
    from gauge_envs.runs.batch import check_writable

    for file in files.values():
        try:
            check_replaceable(file)
        except OSError as error:
            raise ResultFileError(
                f"{file}: cannot be written: {error.strerror}"
            ) from error
        check_writable(file.parent)
    return files


def _matrix(
    names: Sequence[str],
    files: Sequence[Path],
    settings: Mapping[str, Any] | None,
    only: Sequence[str],
    limits: Limits,
    places: Mapping[str, Path],
    form: Format,
    before: Sequence[MatrixColumn] | None,
) -> bool:
    """Run checks on engines and configurations, print and write the matrix, and return whether a result is bad.

    Args:
        names: Engines and configurations that run, each engine in a process of its own.
        files: Files with further columns.
        settings: Settings for every column that runs.
        only: Ids or patterns of checks; none are those of the files.
        limits: Limits of a process.
        places: Files by suffix: the page, and the columns.
        form: Format on stdout.
        before: Columns of an earlier version, by which the result is judged; None to judge by the laws.
    """
    from gauge_envs.pages.document import save_file
    from gauge_envs.runs.isolation import Worker
    from gauge_envs.tools.conformance import checks
    from gauge_envs.tools.conformance.matrix import (
        changes,
        matrix_columns,
        with_columns,
        write_columns,
    )
    from gauge_envs.tools.conformance.words import conformance_page, matrix_document

    new: list[MatrixColumn] = []
    if names:
        with Worker(*limits) as importer:
            new = matrix_columns(names, settings, worker=importer)
    # Before anything runs, so that a wrong file costs no time.
    columns = with_columns(new, files)
    if before is not None:
        changes(new, before)
    for column in _measured(new, only, limits, form):
        if ".json" in places and column is not new[-1]:
            # After each column, so that a run that is stopped leaves the columns that ended.
            write_columns([one for one in columns if one.made], places[".json"])
    found = {name for column in columns for name in (*column.findings, *column.refused)}
    chosen = [check for check in checks(only) if new or only or check.id in found]
    if ".json" in places:
        message(write_columns(columns, places[".json"]))
    if ".html" in places:
        page = conformance_page(
            columns,
            chosen,
            command=join(["gauge", *sys.argv[1:]]),
            when=datetime.now(UTC),
        )
        message(save_file(places[".html"], page))
    if before is not None:
        return _is_worse(new, before, form)
    if form is not Format.JSON:
        print_document(matrix_document(columns, chosen), form)
    if new:
        return _failed([one for column in new for one in column.findings.values()])
    message(f"{counted(len(columns), 'column')} of files; no check ran")
    return False


def _is_worse(
    columns: Sequence[MatrixColumn], before: Sequence[MatrixColumn], form: Format
) -> bool:
    """Print what changed since an earlier version of the engines, and return whether something got worse or moved."""
    from gauge_envs.tools.conformance.matrix import changes
    from gauge_envs.tools.conformance.words import changes_table

    changed = changes(columns, before)
    if form is not Format.JSON and changed:
        print_document(changes_table(changed), form)
    kinds = [one.kind for one in changed]
    message(
        ", ".join(
            f"{kinds.count(kind)} {kind}" for kind in ("worse", "moved", "mended")
        )
        + " since the baseline"
    )
    return bool({"worse", "moved"}.intersection(kinds)) or any(
        column.reason for column in columns
    )


def _measured(
    columns: Sequence[MatrixColumn], only: Sequence[str], limits: Limits, form: Format
) -> Iterator[MatrixColumn]:
    """Run the checks of columns, and yield each column as it ends."""
    from gauge_envs.runs.isolation import Worker
    from gauge_envs.tools.conformance import checks
    from gauge_envs.tools.conformance.matrix import run_column

    with Progress("checks", len(checks(only)) * len(columns)) as progress:
        for _, group in groupby(columns, key=lambda column: column.backend):
            # Configurations of one engine share a process, which imports it once; two engines share none.
            with Worker(*limits) as worker:
                for column in group:
                    for finding in run_column(column, only, worker):
                        progress.advance(f"{column.title}: {finding.check}")
                        if form is Format.JSON:
                            print_json_lines(
                                [finding.to_dict() | {"configuration": column.name}]
                            )
                    bad = sum(finding.is_bad for finding in column.findings.values())
                    ran = f"{counted(len(column.findings), 'check')}, {bad} failed"
                    progress.line(f"{column.title}: {column.reason or ran}")
                    yield column
