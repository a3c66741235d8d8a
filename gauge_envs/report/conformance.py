"""Findings as a table: one row a check, one column a backend."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from gauge_envs.checks.conformance.model import CheckResult, Status

__all__ = [
    "findings_markdown",
    "findings_view",
]

STYLES = {Status.PASS: "green", Status.FAIL: "bold red", Status.DECLINED: "dim", Status.ERROR: "bold red"}
WORDS = {Status.PASS: "pass", Status.FAIL: "FAIL", Status.DECLINED: "declined", Status.ERROR: "error"}


def findings_view(findings: Sequence[CheckResult]) -> Group:
    """Table, diagnoses of what failed, reasons of what was declined, versions and settings; for a terminal."""
    names = _backends(findings)
    table = Table(box=None, header_style="bold", pad_edge=False, padding=(0, 2, 0, 0))
    for title in ("check", "law", "expected"):
        table.add_column(title, overflow="fold")
    for name in names:
        table.add_column(escape(name), overflow="fold")
    for row in _rows(findings):
        first = next(iter(row.values()))
        cells = [_cell(row[name]) if name in row else Text("") for name in names]
        table.add_row(escape(first.check), escape(first.law), escape(_expected(row)), *cells)
    parts: list[RenderableType] = [table]
    for title, lines in _notes(findings):
        parts += [Text(""), Text(title, style="bold"), *(Text(f"  {line}") for line in lines)]
    return Group(*parts)


def findings_markdown(findings: Sequence[CheckResult]) -> str:
    """The same table in Markdown, for a README, with the notes below it as lists."""
    names = _backends(findings)
    lines = [f"| check | law | expected | {' | '.join(names)} |", "|---" * (3 + len(names)) + "|"]
    for row in _rows(findings):
        first = next(iter(row.values()))
        cells = [_cell(row[name]).plain if name in row else "" for name in names]
        entries = (f"{first.title} (`{first.check}`)", first.law, _expected(row), *cells)
        lines.append("| " + " | ".join(entry.replace("|", "\\|") for entry in entries) + " |")
    for title, notes in _notes(findings):
        lines += ["", f"{title}:", "", *(f"- {note}" for note in notes)]
    return "\n".join(lines)


def _backends(findings: Sequence[CheckResult]) -> list[str]:
    return list(dict.fromkeys(finding.backend for finding in findings))


def _rows(findings: Sequence[CheckResult]) -> list[dict[str, CheckResult]]:
    """Findings of each check by backend, in the order of the checks."""
    rows: dict[str, dict[str, CheckResult]] = {}
    for finding in findings:
        rows.setdefault(finding.check, {})[finding.backend] = finding
    return list(rows.values())


def _number(value: float) -> str:
    return f"{value:.4g}"


def _with_unit(text: str, unit: str) -> str:
    return text if unit == "1" else f"{text} {unit}"


def _expected(row: Mapping[str, CheckResult]) -> str:
    """Expected value with the pass mark; empty where no backend was measured."""
    for finding in row.values():
        if finding.expected is not None and finding.width is not None:
            expected = _number(finding.expected)
            text = f"{expected} +- {finding.width:.2g}" if finding.width else f"exactly {expected}"
            return _with_unit(text, finding.unit)
    return ""


def _cell(finding: CheckResult) -> Text:
    word = WORDS[finding.status]
    measured = "" if finding.measured is None else f"{_number(finding.measured)} "
    return Text(measured + word, style=STYLES[finding.status])


def _notes(findings: Sequence[CheckResult]) -> Iterator[tuple[str, list[str]]]:
    """What stands below the table: title and lines."""
    bad = [finding for finding in findings if finding.is_bad]
    if bad:
        yield "Diagnoses", [f"{one.backend}, {one.check}: {_what(one)}{one.diagnosis}" for one in bad]
    declined: dict[str, list[str]] = {}
    for one in findings:
        if one.status is Status.DECLINED:
            declined.setdefault(f"{one.backend}: {'; '.join(one.missing)}", []).append(one.check)
    if declined:
        yield "Declined", [f"{reason} ({', '.join(ids)})" for reason, ids in declined.items()]
    for name in _backends(findings):
        own = [finding for finding in findings if finding.backend == name]
        versions = ", ".join(f"{key} {value}" for key, value in own[0].versions.items())
        yield f"{name}: {versions}; settings in force", list(_settings_lines(own))


def _settings_lines(findings: Sequence[CheckResult]) -> Iterator[str]:
    """Settings that all checks share, then what each group of checks has beyond them."""
    groups: list[tuple[Mapping[str, Any], list[str]]] = []
    for finding in findings:
        if not finding.settings:
            continue
        known = next((ids for settings, ids in groups if settings == finding.settings), None)
        if known is None:
            groups.append((finding.settings, [finding.check]))
        else:
            known.append(finding.check)
    if not groups:
        return
    first = groups[0][0]
    shared = {key for key in first if all(key in s and s[key] == first[key] for s, _ in groups)}
    yield "all: " + (_assignments({key: first[key] for key in first if key in shared}) or "nothing in common")
    for settings, ids in groups:
        own = _assignments({key: value for key, value in settings.items() if key not in shared})
        if own:
            yield f"{', '.join(ids)}: {own}"


def _assignments(settings: Mapping[str, Any]) -> str:
    return ", ".join(f"{key}={_value(value)}" for key, value in settings.items())


def _value(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _what(finding: CheckResult) -> str:
    if finding.measured is None or finding.expected is None:
        return ""
    expected, measured = _number(finding.expected), _number(finding.measured)
    return _with_unit(f"{measured} instead of {expected}", finding.unit) + f" ({finding.measures}). "
