"""The part of `gauge backend check` that writes a matrix of engines and checks."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from shlex import join
from typing import TYPE_CHECKING, Any

import typer

from gauge_envs.cli.output import (
    EXIT_FAILED,
    counted,
    plain_text,
    print_json_lines,
    progress_bar,
    stderr_console,
)

if TYPE_CHECKING:
    from gauge_envs.checks.conformance.matrix import MatrixColumn

__all__ = ["check_matrix"]


def check_matrix(
    names: Sequence[str],
    *,
    every: bool,
    settings: Mapping[str, Any] | None,
    only: Sequence[str],
    limits: tuple[float, float | None],
    report: Path | None,
    json_lines: bool,
) -> None:
    """Run checks on engines with their configurations, each engine in a process of its own, and write the page.

    Args:
        names: Engines; with none, all installed ones.
        every: Whether to run every configuration that an engine declares.
        settings: Settings for every column.
        only: Ids or patterns of checks.
        limits: Time limit of a check [s] and limit of memory [GB].
        report: The page; None writes none.
        json_lines: Whether to print each result as JSON.
    """
    from gauge_envs.checks.conformance import checks
    from gauge_envs.checks.conformance.matrix import matrix_columns, run_column
    from gauge_envs.report.conformance_page import save_conformance_page
    from gauge_envs.runs.isolation import Worker

    chosen = checks(only)
    with Worker(*limits) as importer:
        columns = matrix_columns(names, settings, every=every, worker=importer)
    stderr = stderr_console()
    with progress_bar(stderr) as progress:
        bar = progress.add_task("checks", total=len(chosen) * len(columns))
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
    if report is not None:
        command = join(["gauge", *sys.argv[1:]])
        stderr.print(plain_text(str(save_conformance_page(columns, chosen, report, command=command))), soft_wrap=True)
    bad = sum(finding.is_bad for column in columns for finding in column.findings.values())
    stderr.print(f"{counted(sum(len(column.findings) for column in columns), 'check')}, {bad} failed")
    if bad:
        raise typer.Exit(EXIT_FAILED)


def _summary(column: MatrixColumn) -> str:
    bad = sum(finding.is_bad for finding in column.findings.values())
    return column.reason or f"{counted(len(column.findings), 'check')}, {bad} failed"
