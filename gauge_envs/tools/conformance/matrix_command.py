"""The part of `gauge backend check` that writes a matrix of engines and checks."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from shlex import join
from typing import TYPE_CHECKING, Any

import typer

from gauge_envs.cli.output import (
    EXIT_FAILED,
    counted,
    plain_text,
    print_document,
    print_json_lines,
    progress_bar,
    stderr_console,
)
from gauge_envs.errors import ParameterError, ResultFileError

if TYPE_CHECKING:
    from gauge_envs.tools.conformance.matrix import MatrixColumn


@dataclass(frozen=True, kw_only=True)
class MatrixOutput:
    """Where a matrix goes.

    Attributes:
        report: The HTML page; None writes none.
        file: File for all columns, which `--from` reads; None writes none.
        json_lines: Whether to print each new result as JSON.
        markdown: Whether to print the matrix in Markdown.
    """

    report: Path | None
    file: Path | None
    json_lines: bool
    markdown: bool

    def check(self) -> None:
        """Check that a matrix goes somewhere, and that stdout has one format."""
        if self.json_lines and self.markdown:
            raise ParameterError("--json and --markdown both write to stdout: choose one of them")
        if not (self.report or self.file or self.json_lines or self.markdown):
            raise ParameterError(
                "--all and --from write a matrix: give --report PAGE.html, --out FILE.json, --markdown or --json"
            )

    def check_places(self) -> None:
        """Check that the files can be written, before checks run that may take hours."""
        from gauge_envs.files import check_replaceable
        from gauge_envs.runs.batch import check_writable

        for file in filter(None, (self.file, self.report)):
            try:
                check_replaceable(file)
            except OSError as error:
                raise ResultFileError(f"{file}: cannot be written: {error.strerror}") from error
            check_writable(file.parent)


def check_matrix(
    names: Sequence[str],
    *,
    every: bool,
    configurations: Sequence[str],
    files: Sequence[Path],
    settings: Mapping[str, Any] | None,
    only: Sequence[str],
    limits: tuple[float, float | None],
    output: MatrixOutput,
) -> None:
    """Run checks on engines with their configurations, each engine in a process of its own, and write the matrix.

    Args:
        names: Engines; with none and `every`, all installed ones.
        every: Whether to run every configuration that an engine declares.
        configurations: Names of the configurations that run; all with none.
        files: Files with further columns, which are not run again.
        settings: Settings for every column that runs.
        only: Ids or patterns of checks; none are those of the files.
        limits: Time limit of a check [s] and limit of memory [GB].
        output: Where the matrix goes.
    """
    from datetime import UTC, datetime

    from gauge_envs.pages.document import save_file
    from gauge_envs.runs.isolation import Worker
    from gauge_envs.tools.conformance import checks
    from gauge_envs.tools.conformance.matrix import matrix_columns
    from gauge_envs.tools.conformance.matrix_file import with_columns, write_columns
    from gauge_envs.tools.conformance.page import conformance_page
    from gauge_envs.tools.conformance.words import matrix_document

    output.check_places()
    new: list[MatrixColumn] = []
    if names or every:
        with Worker(*limits) as importer:
            new = matrix_columns(names, settings, every=every, configurations=configurations, worker=importer)
    # Before anything runs, so that a wrong file costs no time.
    columns = with_columns(new, files)
    stderr = stderr_console()
    if new:
        for column in _run(new, only, limits, json_lines=output.json_lines):
            if output.file is not None and column is not new[-1]:
                # After each column, so that a run that is stopped leaves the columns that ended.
                write_columns([one for one in columns if one.made], output.file)
    found = {name for column in columns for name in (*column.findings, *column.refused)}
    chosen = [check for check in checks(only) if new or only or check.id in found]
    command = join(["gauge", *sys.argv[1:]])
    if output.file is not None:
        stderr.print(plain_text(str(write_columns(columns, output.file))), soft_wrap=True)
    if output.report is not None:
        page = conformance_page(columns, chosen, command=command, when=datetime.now(UTC))
        stderr.print(plain_text(str(save_file(output.report, page))), soft_wrap=True)
    if output.markdown:
        print_document(matrix_document(columns, chosen), markdown=True)
    bad = sum(finding.is_bad for column in new for finding in column.findings.values())
    if new:
        stderr.print(f"{counted(sum(len(column.findings) for column in new), 'check')}, {bad} failed")
    else:
        stderr.print(f"{counted(len(columns), 'column')} of files; no check ran")
    if bad:
        raise typer.Exit(EXIT_FAILED)


def _run(
    columns: Sequence[MatrixColumn], only: Sequence[str], limits: tuple[float, float | None], *, json_lines: bool
) -> Iterator[MatrixColumn]:
    """Run the checks of columns, with a bar or lines of progress, and yield each column as it ends."""
    from gauge_envs.runs.isolation import Worker
    from gauge_envs.tools.conformance import checks
    from gauge_envs.tools.conformance.matrix import run_column

    stderr = stderr_console()
    with progress_bar(stderr) as progress:
        bar = progress.add_task("checks", total=len(checks(only)) * len(columns))
        for _, group in groupby(columns, key=lambda column: column.backend):
            # Configurations of one engine share a process, which imports it once; two engines share none.
            with Worker(*limits) as worker:
                for column in group:
                    for finding in run_column(column, only, worker):
                        progress.update(bar, advance=1, description=f"{column.title}: {finding.check}")
                        if json_lines:
                            print_json_lines([finding.to_dict() | {"configuration": column.name}])
                    if not stderr.is_terminal:
                        stderr.print(plain_text(f"{column.title}: {_summary(column)}"), soft_wrap=True)
                    yield column


def _summary(column: MatrixColumn) -> str:
    bad = sum(finding.is_bad for finding in column.findings.values())
    return column.reason or f"{counted(len(column.findings), 'check')}, {bad} failed"
