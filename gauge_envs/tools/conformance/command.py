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
    from gauge_envs.runs.isolation import Worker
    from gauge_envs.tools.conformance import CheckResult
    from gauge_envs.tools.conformance.results import EngineColumn, Expected

ALWAYS = ("determinism",)
"""Checks that run whatever `--only` chooses, because a failure makes all other results worthless."""

CHECK_LIMIT_S = 600.0
"""Default time limit of a check in another process [s]."""

REFUSED = "the settings are refused"
"""First words of the reason of a check whose scene the engine does not build with the given settings."""

LONG_S = 60.0
"""Time after which a line names the check that runs [s]."""


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
            help="Engines. ENGINE:CONFIGURATION is one of the solvers and presets that an engine declares, as "
            "mujoco:PGS; patterns as 'mujoco:*' and '*:*' are all. A .json file of --out has columns that are not "
            "measured again.",
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
            'A TOML file of checks that this engine fails, as rebound-flat = { measured = 0.513, reason = "no model of '
            'it" }, and of what it declines: exit code 0 when exactly these fail, with these values.',
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
    With --expected: when a result is not as listed. With --baseline: when one became worse or its value moved by more
    than its tolerance. A declined check is no failure. Engines of other packages run in another process. All engines do
    so with --isolate, --timeout, --memory, --out or a configuration: one that crashes or hangs there costs one check.
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
    chosen = [one.id for one in checks(only or ())]
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
        if form is not Format.JSON and any(one.results for one in columns):
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
    if misplaced := sorted({one.id for one in checks()}.intersection(engines)):
        raise ParameterError(
            f"{misplaced[0]!r} is a check and no backend: choose it by --only {misplaced[0]}"
        )
    if is_judged and (len(engines) != 1 or files or baseline):
        raise ParameterError(
            "--expected and --badge are of one engine: leave out other names and --baseline"
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
        is_apart: Whether engines of this package run in another process, too.
    """
    from gauge_envs.backends.registry import is_bundled
    from gauge_envs.runs.isolation import Worker

    total = len(chosen) * len(columns)
    with Progress("checks", total, line_interval_s=LINE_INTERVAL_S) as progress:
        for engine, group in groupby(columns, key=lambda one: one.backend):
            # Configurations of one engine share a process, which imports it once; two engines share none.
            with Worker(*limits) as worker:
                there = worker if is_apart or not is_bundled(engine) else None
                for column in group:
                    for result in _run(column, chosen, there):
                        progress.advance(f"{column.title}: {result.check}")
                        yield result, column


def _run(
    column: EngineColumn, chosen: Sequence[str], worker: Worker | None
) -> Iterator[CheckResult]:
    """Run the checks of a column, and those that always run; yield each result that the column keeps."""
    from gauge_envs.tools.conformance import checks
    from gauge_envs.tools.conformance.results import run_column

    ids = [one.id for one in checks([*chosen, *ALWAYS])]
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
        """Watch the check that runs now, which has run for a time [s]."""
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
    """Print one engine on a screen, or a table of several."""
    from gauge_envs.tools.conformance.words import columns_document, engine_document

    if len(columns) == 1 and new and new[0].results:
        print_document(engine_document([*new[0].results.values()]), form)
    else:
        print_document(columns_document(columns), form)


def _check_measured(new: Sequence[EngineColumn]) -> None:
    """Raise a `ParameterError` where no engine can be used, or all refuse the settings in every scene."""
    results = [one for column in new for one in column.results.values()]
    reasons = [column.reason for column in new if column.reason]
    refused = [one for one in results if str(*one.missing[:1]).startswith(REFUSED)]
    if new and len(refused) == len(results):
        raise ParameterError((reasons or refused[0].missing)[0])


def _has_failed(new: Sequence[EngineColumn]) -> bool:
    """Print the counts, and return whether a check failed or nothing was measured."""
    from gauge_envs.tools.conformance.results import counts_text

    results = [one for column in new for one in column.results.values()]
    if not new:
        message("no check ran")
        return False
    is_measured = any(not one.missing for one in results)
    message(f"{counts_text(results)}{'' if is_measured else '; nothing was measured'}")
    has_reason = any(column.reason for column in new)
    return has_reason or not is_measured or any(one.is_bad for one in results)


def _is_surprising(
    column: EngineColumn, expected: Expected | None, file: Path | None
) -> bool:
    """Write the badge, print what is not as expected, and return whether something is not.

    Args:
        column: The engine.
        expected: What it is expected to fail and to decline; None: nothing, and every decline is expected.
        file: File of the badge, or None.
    """
    from gauge_envs.pages.document import save_file
    from gauge_envs.tools.conformance.results import Expected, badge

    results = [*column.results.values()]
    known = expected or Expected(declined={"*": "no list"})
    if file is not None:
        save_file(file, f"{json.dumps(badge(results, known))}\n")
    if expected is None:
        return False
    surprises = [(one.check, text) for one in results if (text := known.surprise(one))]
    for name, text in surprises:
        message(f"not expected: {name} {text}")
    return bool(surprises or column.reason) or all(one.missing for one in results)


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
    from gauge_envs.tools.conformance.results import write_columns
    from gauge_envs.tools.conformance.words import conformance_page

    found = []
    if ".json" in places:
        made = [one for one in columns if one.made]
        found.append(write_columns(made, places[".json"]))
    if ".html" in places:
        text = conformance_page(columns, join(["gauge", *sys.argv[1:]]))
        found.append(save_file(places[".html"], text))
    return found


def _is_worse(
    columns: Sequence[EngineColumn], before: Sequence[EngineColumn], form: Format
) -> bool:
    """Print what changed since an earlier version of the engines, and return whether something got worse or moved."""
    from gauge_envs.tools.conformance.results import changes
    from gauge_envs.tools.conformance.words import changes_table

    changed = changes(columns, before)
    if form is not Format.JSON and changed:
        print_document(changes_table(changed), form)
    kinds = [one.kind for one in changed]
    counts = [f"{kinds.count(kind)} {kind}" for kind in ("worse", "moved", "mended")]
    message(f"{', '.join(counts)} since the baseline")
    is_worse = bool({"worse", "moved"}.intersection(kinds))
    return is_worse or any(column.reason for column in columns)
