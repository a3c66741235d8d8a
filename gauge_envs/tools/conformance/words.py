"""Results of conformance checks as a table: one row per check, one column per backend."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from rich.console import Group, RenderableType
from rich.text import Text

from gauge_envs.pages.table import Column, Place, Table, as_markdown, as_rich
from gauge_envs.pages.text import pairs_text
from gauge_envs.tools.conformance.model import Check, CheckResult, Status

STYLES = {Status.PASS: "green", Status.FAIL: "bold red", Status.DECLINED: "dim", Status.ERROR: "bold red"}
WORDS = {Status.PASS: "pass", Status.FAIL: "FAIL", Status.DECLINED: "declined", Status.ERROR: "error"}


def checks_table(checks: Sequence[Check]) -> Table:
    """Return the checks with their scenes, measured quantities, laws and tolerances."""
    return Table(
        columns=(
            Column("id", "check"),
            Column("law", "law"),
            Column("unit", "unit", wide_only=True),
            Column("scene", "scene", place=Place.BELOW),
            Column("measures", "measures", place=Place.BELOW),
        ),
        rows=[
            {key: getattr(one, key) for key in ("id", "title", "scene", "measures", "law", "source", "unit")}
            for one in checks
        ],
    )


def findings_view(findings: Sequence[CheckResult], *, wide: bool = False) -> Group:
    """Return the table, diagnoses of failures, reasons of what was declined, versions and settings, for a terminal."""
    parts: list[RenderableType] = [as_rich(_findings_table(findings, lambda one: one.check), wide=wide)]
    for title, lines in _notes(findings):
        parts += [Text(""), Text(title, style="bold"), *(Text(f"  {line}") for line in lines)]
    return Group(*parts)


def findings_markdown(findings: Sequence[CheckResult]) -> str:
    """Return the same table in Markdown, for a README, with the notes below it as lists."""
    lines = [as_markdown(_findings_table(findings, lambda one: f"{one.of.title} ({one.check})")).rstrip()]
    for title, notes in _notes(findings):
        lines += ["", f"{title}:", "", *(f"- {note}" for note in notes)]
    return "\n".join(lines)


def _findings_table(findings: Sequence[CheckResult], name: Callable[[CheckResult], str]) -> Table:
    def first(text: Callable[[CheckResult], str]) -> Callable[[Mapping[str, CheckResult]], str]:
        return lambda row: text(next(iter(row.values())))

    return Table(
        columns=(
            Column("", "check", first(name)),
            Column("", "law", first(lambda one: one.of.law), wide_only=True),
            Column("", "expected", _expected),
            *(Column(backend, backend, _measured, style=_style) for backend in _backends(findings)),
        ),
        rows=_rows(findings),
    )


def _measured(finding: CheckResult) -> str:
    measured = "" if finding.measured is None else f"{_number(finding.measured)} "
    return measured + WORDS[finding.status]


def _style(finding: CheckResult | None) -> str:
    return "" if finding is None else STYLES[finding.status]


def _backends(findings: Sequence[CheckResult]) -> list[str]:
    return list(dict.fromkeys(finding.backend for finding in findings))


def _rows(findings: Sequence[CheckResult]) -> list[dict[str, CheckResult]]:
    """Return the results of each check by backend, in the order of the checks."""
    rows: dict[str, dict[str, CheckResult]] = {}
    for finding in findings:
        rows.setdefault(finding.check, {})[finding.backend] = finding
    return list(rows.values())


def _number(value: float) -> str:
    return f"{value:.4g}"


def _with_unit(text: str, unit: str) -> str:
    return text if unit == "1" else f"{text} {unit}"


def _expected(row: Mapping[str, CheckResult]) -> str:
    """Return the expected value with its tolerance; empty if no backend was measured."""
    for finding in row.values():
        if finding.expected is not None and finding.width is not None:
            expected = _number(finding.expected)
            text = f"{expected} +- {finding.width:.2g}" if finding.width else f"exactly {expected}"
            return _with_unit(text, finding.of.unit)
    return ""


def _notes(findings: Sequence[CheckResult]) -> Iterator[tuple[str, list[str]]]:
    """Yield the titles and lines below the table."""
    bad = [finding for finding in findings if finding.is_bad]
    if bad:
        own = [one for one in bad if not one.reported_by]
        lines = [f"{one.backend}, {one.check}: {_what(one)}{one.diagnosis}" for one in own]
        yield "Diagnoses", lines + list(_same_fault_lines(bad))
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


def _same_fault_lines(bad: Sequence[CheckResult]) -> Iterator[str]:
    """Yield one line for the checks that fail for a reason that an earlier check reports."""
    groups: dict[tuple[str, str], list[str]] = {}
    for one in bad:
        if one.reported_by:
            groups.setdefault((one.backend, one.reported_by), []).append(one.check)
    for (backend, first), ids in groups.items():
        yield f"{backend}: {len(ids)} more are not finite, see {first}: {', '.join(ids)}"


def _settings_lines(findings: Sequence[CheckResult]) -> Iterator[str]:
    """Yield the settings that all checks share, then those of each group of checks."""
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
    yield "all: " + (pairs_text({key: first[key] for key in first if key in shared}) or "nothing in common")
    for settings, ids in groups:
        own = pairs_text({key: value for key, value in settings.items() if key not in shared})
        if own:
            yield f"{', '.join(ids)}: {own}"


def _what(finding: CheckResult) -> str:
    if finding.measured is None or finding.expected is None:
        return ""
    expected, measured = _number(finding.expected), _number(finding.measured)
    return _with_unit(f"{measured} instead of {expected}", finding.of.unit) + f" ({finding.of.measures}). "
