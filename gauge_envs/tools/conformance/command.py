"""`gauge backend check`, and the lists of engines and checks."""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from shlex import join
from typing import TYPE_CHECKING, Annotated, Self

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

if TYPE_CHECKING:
    from gauge_envs.pages.table import Table
    from gauge_envs.runs.workers import Worker
    from gauge_envs.tools.conformance import CheckResult
    from gauge_envs.tools.conformance.results import EngineColumn, Expected

ALWAYS = ("determinism",)
"""Checks that always run, because a failure of them makes all other results worthless."""

CHECK_LIMIT_S = 600.0
"""Default time limit of a check in another process [s]."""

REJECTED = "the settings are rejected"
"""First words of the reason of a check whose scene the engine cannot build with the given settings."""

LONG_S = 60.0
"""Time after which a line names the check that runs [s]."""


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
            show_default=False,
            help="Engines. ENGINE:CONFIGURATION is one of the solvers and presets that an engine declares, as "
            "mujoco:PGS; patterns as 'mujoco:*' and '*:*' are all. A .json file of --out adds its columns without new "
            "runs.",
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
        list[Path] | None,
        arguments.target("Page with all results (.html), or columns (.json)."),
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
            'A TOML file of known failures, as rebound-flat = { measured = 0.513, reason = "no model of it" }, and of '
            "unsupported checks: exit code 0 when exactly these fail, with these values.",
            metavar="FILE",
        ),
    ] = None,
    badge: Annotated[
        Path | None,
        arguments.option(
            arguments.OUTPUT,
            "Counts of checks as JSON for a badge of shields.io.",
            metavar="FILE",
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
    from gauge_envs.tools.conformance.results import (
        engine_columns,
        read_columns,
        read_expected,
        with_columns,
    )

    files = [Path(name) for name in names or () if name.endswith(".json")]
    engines = [name for name in names or () if not name.endswith(".json")]
    is_judged = expected is not None or badge is not None
    _check_names(engines, files, is_judged, baseline)
    chosen = [check.id for check in checks(only or ())]
    places = arguments.by_suffix(out, ".html", ".json")
    # Files are read and places checked before anything runs.
    known = None if expected is None else read_expected(expected)
    before = None if baseline is None else read_columns(baseline)
    _check_places([*places.values(), *([] if badge is None else [badge])])
    is_apart = isolate or bool(timeout or memory or places)
    is_apart |= any(":" in name for name in engines)
    settings = arguments.parsed_settings(changes)
    new = engine_columns(engines, settings, isolate=is_apart) if engines else []
    columns = with_columns(new, files)
    limits = (CHECK_LIMIT_S if timeout is None else timeout, memory)
    try:
        for result, column in _measured(new, chosen, limits, is_apart):
            if form is Format.JSON:
                is_default = column.name == "default"
                more = {} if is_default else {"configuration": column.name}
                print_json_lines([result.to_dict() | more])
            if ".json" in places:
                # A process that is killed leaves the results so far.
                _write(columns, {".json": places[".json"]})
    except KeyboardInterrupt:
        if form is not Format.JSON and any(column.results for column in columns):
            _print(new, columns, form)
        raise
    for path in _write(columns, places):
        message(path)
    _check_measured(new)
    if before is not None:
        return _is_worse(new, before, form)
    if form is not Format.JSON:
        _print(new, columns, form)
    has_failed = _has_failed(new)
    if not is_judged:
        return has_failed
    is_surprising = _is_surprising(new[0], known, badge)
    return has_failed if known is None else is_surprising


def _check_names(
    engines: Sequence[str],
    files: Sequence[Path],
    is_judged: bool,
    baseline: Path | None,
) -> None:
    from gauge_envs.tools.conformance import checks

    if not (engines or files):
        raise ParameterError(
            "no backend is given: name one, as in gauge backend check mujoco; see gauge list backends"
        )
    if misplaced := sorted({check.id for check in checks()}.intersection(engines)):
        raise ParameterError(
            f"{misplaced[0]!r} is a check and no backend: choose it by --only {misplaced[0]}"
        )
    if is_judged and (len(engines) != 1 or files or baseline):
        raise ParameterError(
            "--expected and --badge need exactly one engine: leave out other names and --baseline"
        )


def _measured(
    columns: Sequence[EngineColumn],
    chosen: Sequence[str],
    limits: tuple[float, float | None],
    is_apart: bool,
) -> Iterator[tuple[CheckResult, EngineColumn]]:
    """Run the checks of columns and yield each result with its column.

    Args:
        columns: The columns.
        chosen: Ids of the checks.
        limits: Limits of a process: time of a check [s], and memory [GB].
        is_apart: Whether engines of this package also run in another process.
    """
    from gauge_envs.backends.registry import is_bundled
    from gauge_envs.runs.workers import Worker

    total = len(chosen) * len(columns)
    with Progress("checks", total, line_interval_s=LINE_INTERVAL_S) as progress:
        for engine, group in groupby(columns, key=lambda column: column.backend):
            # Configurations of one engine share a process, which imports it once; each engine has its own.
            with Worker(*limits) as worker:
                there = worker if is_apart or not is_bundled(engine) else None
                for column in group:
                    for result in _run(column, chosen, there):
                        progress.advance(f"{column.title}: {result.check}")
                        yield result, column


def _run(
    column: EngineColumn, chosen: Sequence[str], worker: Worker | None
) -> Iterator[CheckResult]:
    """Run the chosen checks of a column and `ALWAYS`; yield each result that the column keeps."""
    from gauge_envs.tools.conformance import checks
    from gauge_envs.tools.conformance.results import run_column

    ids = [check.id for check in checks([*chosen, *ALWAYS])]
    running = iter([*ids, ""])
    with _Watch(column.title) as watch:
        watch.see(next(running))
        for result in run_column(column, ids, worker):
            watch.see(next(running))
            if result.check not in chosen and result.status != "fail":
                del column.results[result.check]
                continue
            yield result


class _Watch:
    """Prints a line for each minute that one check takes."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._timer = threading.Timer(0.0, print)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._timer.cancel()

    def see(self, check: str, waited_s: float = 0.0) -> None:
        """Watch the running check, which has run for a time [s]."""
        if waited_s:
            message(f"{self._title}: {check} has run for {waited_s:.0f} s")
        self._timer.cancel()
        arguments = (check, waited_s + LONG_S)
        self._timer = threading.Timer(LONG_S, self.see, arguments)
        self._timer.daemon = True
        self._timer.start()


def _print(
    new: Sequence[EngineColumn], columns: Sequence[EngineColumn], form: Format
) -> None:
    """Print the results of one engine, or a table of several engines."""
    from gauge_envs.tools.conformance.report import columns_document, engine_document

    if len(columns) == 1 and new and new[0].results:
        print_document(engine_document([*new[0].results.values()]), form)
    else:
        is_wide = form is Format.WIDE
        print_document(columns_document(columns, is_wide=is_wide), form)


def _check_measured(new: Sequence[EngineColumn]) -> None:
    """Raise a `ParameterError` if no engine can be used, or every engine rejects the settings in every scene."""
    results = [result for column in new for result in column.results.values()]
    reasons = [column.reason for column in new if column.reason]
    rejected = [
        result for result in results if str(*result.missing[:1]).startswith(REJECTED)
    ]
    if new and len(rejected) == len(results):
        raise ParameterError((reasons or rejected[0].missing)[0])


def _has_failed(new: Sequence[EngineColumn]) -> bool:
    """Print the counts, and return whether a check failed or nothing was measured."""
    from gauge_envs.tools.conformance.results import counts_text

    results = [result for column in new for result in column.results.values()]
    if not new:
        message("no check ran")
        return False
    is_measured = any(not result.missing for result in results)
    message(f"{counts_text(results)}{'' if is_measured else '; nothing was measured'}")
    has_reason = any(column.reason for column in new)
    return has_reason or not is_measured or any(result.is_bad for result in results)


def _is_surprising(
    column: EngineColumn, expected: Expected | None, file: Path | None
) -> bool:
    """Write the badge, print unexpected results, and return whether there are any.

    Args:
        column: The engine.
        expected: Known failures and unsupported checks; None expects no failure, and any unsupported check.
        file: File of the badge, or None.
    """
    from gauge_envs.pages.document import save_file
    from gauge_envs.tools.conformance.results import Expected, badge

    results = [*column.results.values()]
    known = expected or Expected(unsupported={"*": "no list"})
    if file is not None:
        save_file(file, f"{json.dumps(badge(results, known))}\n")
    if expected is None:
        return False
    surprises = [
        (result.check, text) for result in results if (text := known.surprise(result))
    ]
    for name, text in surprises:
        message(f"not expected: {name} {text}")
    return bool(surprises or column.reason) or all(result.missing for result in results)


def _check_places(files: Sequence[Path]) -> None:
    """Check that files can be written, before checks run that may take hours."""
    from gauge_envs.files import check_replaceable
    from gauge_envs.runs.batch import check_writable

    for file in files:
        try:
            check_replaceable(file)
        except OSError as error:
            raise ResultFileError(
                f"{file}: cannot be written: {error.strerror}"
            ) from error
        check_writable(file.parent)


def _write(columns: Sequence[EngineColumn], places: Mapping[str, Path]) -> list[Path]:
    """Write columns to files by suffix, and return the paths."""
    from gauge_envs.pages.document import save_file
    from gauge_envs.tools.conformance.report import conformance_page
    from gauge_envs.tools.conformance.results import write_columns

    paths = []
    if ".json" in places:
        made = [column for column in columns if column.made]
        paths.append(write_columns(made, places[".json"]))
    if ".html" in places:
        text = conformance_page(columns, join(["gauge", *sys.argv[1:]]))
        paths.append(save_file(places[".html"], text))
    return paths


def _is_worse(
    columns: Sequence[EngineColumn], before: Sequence[EngineColumn], form: Format
) -> bool:
    """Print the changes since an earlier version of the engines, and return whether a result got worse or moved."""
    from gauge_envs.tools.conformance.report import changes_table
    from gauge_envs.tools.conformance.results import changes

    changed = changes(columns, before)
    if form is not Format.JSON and changed:
        print_document(changes_table(changed), form)
    kinds = [change.kind for change in changed]
    counts = [f"{kinds.count(kind)} {kind}" for kind in ("worse", "moved", "fixed")]
    message(f"{', '.join(counts)} since the baseline")
    is_worse = bool({"worse", "moved"}.intersection(kinds))
    return is_worse or any(column.reason for column in columns)
