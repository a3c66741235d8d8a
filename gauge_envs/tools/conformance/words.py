"""Results of conformance checks in words: tables of engines and checks, diagnoses, and matrices of configurations."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from functools import partial
from typing import Any

from gauge_envs.backends import backend_names, versions_of
from gauge_envs.errors import GaugeError
from gauge_envs.files import versions
from gauge_envs.pages.document import Bullets, Document, Heading, Paragraph, Part
from gauge_envs.pages.html import Html, below, element, folded, join, listed
from gauge_envs.pages.page import as_html, page
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import (
    Markdown,
    counted,
    markdown_text,
    pairs_text,
    with_unit,
)
from gauge_envs.runs.isolation import call_engine
from gauge_envs.tools.conformance.matrix import Change, MatrixColumn
from gauge_envs.tools.conformance.model import Check, CheckResult, Status

QUERY_LIMIT_S = 60.0
"""Time for which an engine outside this package may answer [s]."""

CLASSES = {
    Status.PASS: "inside",
    Status.FAIL: "wrong",
    Status.DECLINED: "declined",
    Status.ERROR: "wrong",
}
"""Classes of outcomes on a page: blue, orange and grey, which colour-blind readers distinguish."""

STYLES = {
    Status.PASS: "green",
    Status.FAIL: "bold red",
    Status.DECLINED: "dim",
    Status.ERROR: "bold red",
}
WORDS = {
    Status.PASS: "pass",
    Status.FAIL: "FAIL",
    Status.DECLINED: "declined",
    Status.ERROR: "error",
}
SIGNS = {
    Status.PASS: "✓",
    Status.FAIL: "✗ FAIL",
    Status.DECLINED: "- declined",
    Status.ERROR: "✗ error",
}
"""Outcomes with a sign, which is visible without a colour."""

LEAST_PERCENT = 1e-4
"""Relative errors below this are not written out [%]."""

MANY = 99.5
"""Numbers from here on are written as integers."""

MOST_IN_MS_S = 0.0995
"""CPU time from which on it is written in seconds [s]."""

LEAST_COST_S = 1e-3
"""Shorter CPU times are not written out [s]."""


def backends_table() -> Table:
    """Return the installed backends: name, versions of the engine, and the error of one that cannot be used.

    Backends outside this package answer in a process of their own.
    """
    rows: list[dict[str, Any]] = []
    for name in backend_names():
        try:
            found = call_engine(name, versions_of, name, time_limit_s=QUERY_LIMIT_S)
            rows.append({"name": name, "versions": found, "error": None})
        except GaugeError as error:
            rows.append({"name": name, "versions": {}, "error": str(error)})
    engine = Column(
        "",
        "engine",
        lambda row: row["error"] or pairs_text(row["versions"]).replace(" = ", " "),
    )
    return Table(columns=(Column("name", "backend"), engine), rows=rows)


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
            {
                key: getattr(one, key)
                for key in ("id", "title", "scene", "measures", "law", "source", "unit")
            }
            for one in checks
        ],
    )


# --- findings --------------------------------------------------------------------------------------------------------


def findings_document(findings: Sequence[CheckResult]) -> Document:
    """Return results: one row per check, one column per backend; what was declined, versions, settings; diagnoses.

    Markdown, for a README, has titles of the checks beside their ids.
    """
    notes = [Bullets(lines, title) for title, lines in _notes(findings)]
    titled = _findings_table(findings, lambda one: f"{one.of.title} ({one.check})")
    return Document(
        parts=(_findings_table(findings, lambda one: one.check), *notes),
        rows=(finding.to_dict() for finding in findings),
        markdown=(titled, *notes),
    )


def _findings_table(
    findings: Sequence[CheckResult], name: Callable[[CheckResult], str]
) -> Table:
    rows: dict[str, dict[str, CheckResult]] = {}
    for finding in findings:
        rows.setdefault(finding.check, {})[finding.backend] = finding

    def first(
        text: Callable[[CheckResult], str],
    ) -> Callable[[Mapping[str, CheckResult]], str]:
        return lambda row: text(next(iter(row.values())))

    def measured(finding: CheckResult) -> str:
        return f"{measured_text(finding)} {WORDS[finding.status]}".lstrip()

    def style(finding: CheckResult | None) -> str:
        return "" if finding is None else STYLES[finding.status]

    return Table(
        columns=(
            Column("", "check", first(name)),
            Column("", "law", first(lambda one: one.of.law), wide_only=True),
            Column(
                "", "expected", lambda row: expected_text(row.values(), exactly=True)
            ),
            *(
                Column(backend, backend, measured, style=style)
                for backend in _backends(findings)
            ),
        ),
        rows=list(rows.values()),
    )


def _backends(findings: Sequence[CheckResult]) -> list[str]:
    return list(dict.fromkeys(finding.backend for finding in findings))


def _notes(findings: Sequence[CheckResult]) -> Iterator[tuple[str, list[str]]]:
    """Yield the titles and lines below the table; diagnoses last, where a terminal shows the end of a long output."""
    left = [one for one in findings if one.status is Status.DECLINED]
    if declined := _checks_by(left, lambda one: "; ".join(one.missing)):
        yield (
            "Declined",
            [
                f"{name}: {reason} ({', '.join(ids)})"
                for (name, reason), ids in declined.items()
            ],
        )
    for name in _backends(findings):
        of_backend = [finding for finding in findings if finding.backend == name]
        versions = ", ".join(
            f"{key} {value}" for key, value in of_backend[0].versions.items()
        )
        yield (
            f"{name}: {versions}; settings in force",
            list(_settings_lines(of_backend)),
        )
    bad = [finding for finding in findings if finding.is_bad]
    if bad:
        told = _checks_by(
            [one for one in bad if not one.reported_by],
            lambda one: f"{_what(one)}{one.diagnosis}",
        )
        more = _checks_by(
            [one for one in bad if one.reported_by], lambda one: one.reported_by
        )
        lines = [
            f"{name}, {', '.join(ids)}: {text}" for (name, text), ids in told.items()
        ]
        for (name, first), ids in more.items():
            lines.append(
                f"{name}: {len(ids)} more are not finite, see {first}: {', '.join(ids)}"
            )
        yield "Diagnoses", lines


def _what(finding: CheckResult) -> str:
    if finding.measured is None or finding.expected is None:
        return ""
    text = f"{measured_text(finding)} instead of {finding.expected:.4g}"
    return f"{with_unit(text, finding.of.unit)} ({finding.of.measures}). "


def _checks_by(
    findings: Sequence[CheckResult], text: Callable[[CheckResult], str]
) -> dict[tuple[str, str], list[str]]:
    """Return the checks of each backend that have a text in common."""
    groups: dict[tuple[str, str], list[str]] = {}
    for one in findings:
        groups.setdefault((one.backend, text(one)), []).append(one.check)
    return groups


def _settings_lines(findings: Sequence[CheckResult]) -> Iterator[str]:
    """Yield the settings that all checks share, then those of each group of checks."""
    groups: list[tuple[Mapping[str, Any], list[str]]] = []
    for finding in filter(lambda one: one.settings, findings):
        known = next(
            (ids for settings, ids in groups if settings == finding.settings), None
        )
        if known is None:
            groups.append((finding.settings, [finding.check]))
        else:
            known.append(finding.check)
    if not groups:
        return
    first = groups[0][0]
    shared = {
        key: value
        for key, value in first.items()
        if all(key in s and s[key] == value for s, _ in groups)
    }
    yield f"all: {pairs_text(shared) or 'nothing in common'}"
    for settings, ids in groups:
        if differing := pairs_text(settings, skip=tuple(shared)):
            yield f"{', '.join(ids)}: {differing}"


# --- one result ------------------------------------------------------------------------------------------------------


def expected_text(
    findings: Iterable[CheckResult | None], *, exactly: bool = False
) -> str:
    """Return the expected value of the first result that has one, with tolerance and unit; empty if none has.

    Args:
        findings: The results.
        exactly: Whether to write `exactly` in place of a tolerance of zero.
    """
    for finding in findings:
        if (
            finding is not None
            and finding.expected is not None
            and finding.width is not None
        ):
            text = f"{finding.expected:.4g} +- {finding.width:.2g}"
            if exactly and not finding.width:
                text = f"exactly {finding.expected:.4g}"
            return with_unit(text, finding.of.unit)
    return ""


def measured_text(finding: CheckResult | None) -> str:
    """Return the measured value; empty if nothing was measured."""
    return (
        "" if finding is None or finding.measured is None else f"{finding.measured:.4g}"
    )


def error_text(finding: CheckResult | None) -> str:
    """Return the error relative to the expected value, or in tolerances where that is 0."""
    if (
        finding is None
        or finding.measured is None
        or finding.expected is None
        or finding.width is None
    ):
        return ""
    difference = finding.measured - finding.expected
    if not math.isfinite(difference):
        return "not finite"
    if finding.expected:
        percent = 100.0 * difference / abs(finding.expected)
        return (
            f"{percent:+.3g} %"
            if abs(percent) >= LEAST_PERCENT
            else f"<{LEAST_PERCENT:g} %"
        )
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
    return (
        f"{_two_digits(1e3 * finding.cpu_s)} ms"
        if is_short
        else f"{_two_digits(finding.cpu_s)} s"
    )


def _two_digits(value: float) -> str:
    return f"{value:.2g}" if value < MANY else f"{value:.0f}"


# --- matrix ----------------------------------------------------------------------------------------------------------


def tally(column: MatrixColumn) -> str:
    """Return how many of the checks that were not declined passed, as `30 of 33`."""
    statuses = [finding.status for finding in column.current().values()]
    return f"{statuses.count(Status.PASS)} of {sum(status is not Status.DECLINED for status in statuses)}"


def matrix_document(
    columns: Sequence[MatrixColumn], checks: Sequence[Check]
) -> Document:
    """Return a matrix: columns with their versions, then a table of the default and of each other configuration.

    A cell has the outcome, the measured value, its error and the CPU time.
    """
    ran = [column for column in columns if column.findings]
    names = [column.name for column in ran]
    engines = {column.backend for column in ran}
    # Configurations that most engines have are tables of their own; the others share one.
    shared = [
        name
        for name in dict.fromkeys(names)
        if name == "default" or 2 * names.count(name) > len(engines) > 1
    ]
    groups = {
        f"Configuration `{name}`": [column for column in ran if column.name == name]
        for name in shared
    }
    groups["Other configurations"] = [
        column for column in ran if column.name not in shared
    ]
    parts: list[Heading | Table] = [Heading("Columns", 3), _columns_table(columns)]
    for title, group in groups.items():
        if group:
            # A name that all columns share is that of the table.
            is_one = len({column.name for column in group}) == 1
            titles = [column.backend if is_one else column.title for column in group]
            parts += [Heading(Markdown(title), 3), matrix_table(group, checks, titles)]
    return Document(parts=parts)


def _columns_table(columns: Sequence[MatrixColumn]) -> Table:
    def run(column: MatrixColumn) -> str:
        made = f"{column.made}, gauge-envs {column.gauge_envs}"
        return made if column.is_of_this_version else f"⚠ {made}"

    return Table(
        columns=(
            Column("backend", "engine"),
            Column("name", "configuration"),
            Column(
                "settings",
                "settings",
                lambda settings: pairs_text(settings) or "its presets",
            ),
            Column(
                "",
                "passed",
                lambda one: tally(one) if one.findings else "not run",
                is_number=True,
            ),
            Column(
                "",
                "CPU time",
                lambda one: "" if one.cpu_s is None else f"{one.cpu_s:.3g} s",
                is_number=True,
            ),
            Column("", "run", run),
            Column("", "versions", lambda one: pairs_text(one.versions) or one.reason),
        ),
        rows=columns,
    )


def matrix_table(
    columns: Sequence[MatrixColumn], checks: Sequence[Check], titles: Sequence[str]
) -> Table:
    """Return one row per check and one column per configuration: the outcome, the value, its error and the CPU time."""
    current = [column.current() for column in columns]
    cells = [partial(_cell, column, column.outdated) for column in columns]
    return Table(
        columns=(
            Column(
                "",
                "phenomenon",
                lambda check: Markdown(f"{markdown_text(check.title)}<br>`{check.id}`"),
                html=lambda check: element("a", check.title, href=f"#{check.id}"),
            ),
            Column(
                "id",
                "expected",
                lambda check: expected_text(found.get(check) for found in current),
            ),
            *(
                Column(
                    "id",
                    title,
                    partial(_cell_markdown, cell),
                    html=partial(_cell_html, cell),
                )
                for title, cell in zip(titles, cells, strict=True)
            ),
        ),
        rows=checks,
        look="matrix",
    )


def changes_table(changes: Sequence[Change]) -> Table:
    """Return the checks that give another result than an earlier version of the engine."""

    def text(one: CheckResult) -> str:
        return f"{SIGNS[one.status]} {measured_text(one)}".rstrip()

    return Table(
        columns=(
            Column("column", "engine"),
            Column("now.check", "check"),
            Column("kind", "change"),
            Column("before", "before", text),
            Column("now", "now", text),
            Column("", "expected", lambda one: expected_text([one.now, one.before])),
            Column("now.diagnosis", "", place=Place.BELOW),
        ),
        rows=changes,
    )


Cell = Callable[[str], tuple[str, list[str], str]]
"""Class, lines and hint of the cell of a check."""


def _cell(
    column: MatrixColumn, outdated: Mapping[str, str], check: str
) -> tuple[str, list[str], str]:
    finding = column.findings.get(check)
    if finding is None:
        word = "- refused" if check in column.refused else "- not run"
        return "declined", [word], column.refused.get(check, column.reason)
    if check in outdated:
        hint = f"{outdated[check]}; its result was {finding.status.value} {measured_text(finding)}".rstrip()
        return "declined", ["⚠ other check"], hint
    lines = [f"{SIGNS[finding.status]} {measured_text(finding)}".rstrip()]
    if finding.status is not Status.DECLINED:
        lines += [error_text(finding), cost_text(finding)]
    return (
        CLASSES[finding.status],
        lines,
        "; ".join(finding.missing) or finding.diagnosis,
    )


def _cell_markdown(cell: Cell, check: str) -> Markdown:
    _, lines, _ = cell(check)
    return Markdown("<br>".join(markdown_text(line) for line in lines if line))


def _cell_html(cell: Cell, check: str) -> Html:
    kind, (first, *others), hint = cell(check)
    return join([badge(kind, first, hint), *(below(line) for line in others if line)])


def badge(kind: str, text: str, hint: str = "") -> Html:
    """Return an outcome with the colour of its class, and a hint for the pointer."""
    return element("span", text, class_=f"badge {kind}", title=hint or None)


# --- page ------------------------------------------------------------------------------------------------------------

LEAD = (
    "One row per phenomenon: a small scene with a closed form. One column per engine and solver or preset. A cell has "
    "the measured value, its relative error, or its error in tolerances where 0 is expected, and the CPU time. The "
    "tolerance is the same for every engine. What an engine declines is no failure. \u26a0 marks a column of another "
    "version of gauge-envs, and a result of a check that was another one then; such a result is not counted."
)


def conformance_page(
    columns: Sequence[MatrixColumn],
    checks: Sequence[Check],
    *,
    command: str,
    when: datetime,
) -> str:
    """Return the self-contained page of a matrix.

    Args:
        columns: Engines and configurations, with the results of their checks.
        checks: The checks, one row each.
        command: Command that wrote the page.
        when: Time of the run.
    """
    ran = [column for column in columns if column.findings]
    left_out = [
        f"{column.title}: {column.reason}" for column in columns if column.reason
    ]
    missing: list[Part] = (
        [Heading("Not run, or not to the end"), listed(left_out)] if left_out else []
    )
    origin = f"{when.isoformat(timespec='minutes')}, {sum(column.cpu_s or 0.0 for column in ran):.0f} s of CPU time in "
    origin += f"the checks, {pairs_text(versions())}. Written by"
    parts: list[Part] = [
        element("p", LEAD, class_="lead"),
        _matrix(ran, checks),
        *missing,
        Heading("Checks"),
        *(_section(check, ran) for check in checks),
        Heading("Configurations"),
        _columns_table(ran),
        Heading("Provenance"),
        Paragraph(origin),
        element("p", element("code", command)),
    ]
    return page("Conformance of physics engines", parts, look="full")


def _matrix(columns: Sequence[MatrixColumn], checks: Sequence[Check]) -> Table:
    titles = []
    for column in columns:
        title = [column.backend, element("br"), column.name, below(tally(column))]
        title += (
            []
            if column.is_of_this_version
            else [below(f"\u26a0 gauge-envs {column.gauge_envs}")]
        )
        titles.append(join(title))
    return matrix_table(columns, checks, titles)


def _section(check: Check, columns: Sequence[MatrixColumn]) -> Html:
    """Return the description of a check, and its results with the commands that repeat them."""
    facts = {
        "scene": check.scene,
        "measures": check.measures,
        "law": check.law,
        "source": check.source,
    }
    facts["tolerance"] = check.tolerance.rationale
    found = [
        (column, column.findings[check.id])
        for column in columns
        if check.id in column.findings
    ]
    refused = [(column, None) for column in columns if check.id in column.refused]

    def outcome(one: CheckResult | None) -> Html | str:
        return (
            "refused"
            if one is None
            else badge(
                CLASSES[one.status], f"{SIGNS[one.status][0]} {WORDS[one.status]}"
            )
        )

    def command(row: tuple[MatrixColumn, CheckResult | None]) -> Html | str:
        return "" if row[1] is None else element("code", row[0].command(check.id))

    def note(row: tuple[MatrixColumn, CheckResult | None]) -> str:
        column, one = row
        if one is None:
            return column.refused[check.id]
        return column.outdated.get(check.id) or "; ".join(one.missing) or one.diagnosis

    results = Table(
        columns=(
            Column("0.title", "engine"),
            Column("1", "outcome", html=outcome),
            Column("1", "measured", html=measured_text),
            Column("1", "expected", html=lambda one: expected_text([one])),
            Column("1", "error", html=error_text),
            Column("", "command", html=command),
            Column("", "", note, place=Place.BELOW),
        ),
        rows=[*found, *refused],
    )
    title = element("h3", f"{check.title} ", element("code", check.id))
    described = listed(f"{name}: {text}" for name, text in facts.items())
    count = counted(len(found), "result")
    repeated = folded(f"{count} with commands", as_html(results))
    return element("section", title, described, repeated, id=check.id)
