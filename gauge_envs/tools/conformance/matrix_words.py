"""A matrix of conformance checks in words and in Markdown."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

from gauge_envs.pages.text import markdown_text, pairs_text
from gauge_envs.tools.conformance.matrix import MatrixColumn
from gauge_envs.tools.conformance.model import Check, CheckResult, Status

LEAST_PERCENT = 1e-4
"""Relative errors below this are not written out [%]."""

MANY = 99.5
"""Numbers from here on are written as integers."""

MOST_IN_MS_S = 0.0995
"""CPU time from which on it is written in seconds [s]."""

LEAST_COST_S = 1e-3
"""Shorter CPU times are not written out [s]."""

SIGNS = {Status.PASS: "✓", Status.FAIL: "✗ FAIL", Status.DECLINED: "- declined", Status.ERROR: "✗ error"}


def expected_text(findings: Iterable[CheckResult | None]) -> str:
    """Return the expected value of the first result that has one, with tolerance and unit; empty if none has."""
    for finding in findings:
        if finding is not None and finding.expected is not None and finding.width is not None:
            unit = "" if finding.of.unit == "1" else f" {finding.of.unit}"
            return f"{finding.expected:.4g} +- {finding.width:.2g}{unit}"
    return ""


def measured_text(finding: CheckResult) -> str:
    """Return the measured value; empty if nothing was measured."""
    return "" if finding.measured is None else f"{finding.measured:.4g}"


def error_text(finding: CheckResult) -> str:
    """Return the error relative to the expected value, or in tolerances where that is 0."""
    if finding.measured is None or finding.expected is None or finding.width is None:
        return ""
    difference = finding.measured - finding.expected
    if not math.isfinite(difference):
        return "not finite"
    if finding.expected:
        percent = 100.0 * difference / abs(finding.expected)
        return f"{percent:+.3g} %" if abs(percent) >= LEAST_PERCENT else f"<{LEAST_PERCENT:g} %"
    if not finding.width:
        return f"{difference:+.2g}" if difference else "exact"
    return f"{_two_digits(abs(difference) / finding.width)} tol."


def cost_text(finding: CheckResult) -> str:
    """Return the CPU time of a check; a check that shares a simulation with an earlier one takes less than 1 ms."""
    if finding.cpu_s is None:
        return ""
    if finding.cpu_s < LEAST_COST_S:
        return "<1 ms"
    is_short = finding.cpu_s < MOST_IN_MS_S
    return f"{_two_digits(1e3 * finding.cpu_s)} ms" if is_short else f"{_two_digits(finding.cpu_s)} s"


def _two_digits(value: float) -> str:
    return f"{value:.2g}" if value < MANY else f"{value:.0f}"


def tally(column: MatrixColumn) -> str:
    """Return how many of the checks that were not declined passed, as `30 of 33`."""
    statuses = [finding.status for finding in column.current().values()]
    return f"{statuses.count(Status.PASS)} of {sum(status is not Status.DECLINED for status in statuses)}"


def matrix_markdown(columns: Sequence[MatrixColumn], checks: Sequence[Check]) -> str:
    """Return a matrix as GitHub Markdown: columns with their versions, then a table of default and of other columns.

    A cell has the outcome, the measured value, its error and the CPU time.
    """
    ran = [column for column in columns if column.findings]
    names = [column.name for column in ran]
    engines = {column.backend for column in ran}
    # Configurations that most engines have are tables of their own; the others share one.
    shared = [name for name in dict.fromkeys(names) if name == "default" or 2 * names.count(name) > len(engines) > 1]
    groups = {f"Configuration `{name}`": [column for column in ran if column.name == name] for name in shared}
    groups["Other configurations"] = [column for column in ran if column.name not in shared]
    lines = ["### Columns", "", *_columns(columns), ""]
    for title, group in groups.items():
        if group:
            lines += [f"### {title}", "", *_table(group, checks), ""]
    return "\n".join(lines)


def _columns(columns: Sequence[MatrixColumn]) -> Iterator[str]:
    yield "| engine | configuration | settings | passed | CPU time | run | versions |"
    yield "|---|---|---|---:|---:|---|---|"
    for column in columns:
        made = f"{column.made}, gauge-envs {column.gauge_envs}"
        cells = [
            markdown_text(column.backend),
            markdown_text(column.name),
            markdown_text(pairs_text(column.settings) or "its presets"),
            tally(column) if column.findings else "not run",
            "" if column.cpu_s is None else f"{column.cpu_s:.3g} s",
            markdown_text(made if column.is_of_this_version else f"⚠ {made}"),
            markdown_text(pairs_text(column.versions) or column.reason),
        ]
        yield f"| {' | '.join(cells)} |"


def _table(columns: Sequence[MatrixColumn], checks: Sequence[Check]) -> Iterator[str]:
    # A name that all columns share is that of the table.
    is_one = len({column.name for column in columns}) == 1
    titles = [column.backend if is_one else column.title for column in columns]
    yield f"| phenomenon | expected | {' | '.join(map(markdown_text, titles))} |"
    yield f"|---|---|{'---|' * len(columns)}"
    outdated = [column.outdated for column in columns]
    for check in checks:
        found = [column.current().get(check.id) for column in columns]
        cells = [_cell(column, check.id, old) for column, old in zip(columns, outdated, strict=True)]
        name = f"{markdown_text(check.title)}<br>`{check.id}`"
        yield f"| {name} | {markdown_text(expected_text(found))} | {' | '.join(cells)} |"


def _cell(column: MatrixColumn, check: str, outdated: Iterable[str]) -> str:
    finding = column.findings.get(check)
    if finding is None:
        return "- refused" if check in column.refused else "- not run"
    if check in outdated:
        return "⚠ other check"
    if finding.status is Status.DECLINED:
        return SIGNS[finding.status]
    parts = [f"{SIGNS[finding.status]} {measured_text(finding)}".rstrip(), error_text(finding), cost_text(finding)]
    return "<br>".join(markdown_text(part) for part in parts if part)
