"""A matrix of conformance checks as one HTML file: no script, no other file, no network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime

from gauge_envs.files import versions
from gauge_envs.pages.document import Heading, Paragraph, Part, page
from gauge_envs.pages.html import Html, below, code, element, folded, join, listed
from gauge_envs.pages.table import Column, Place, Table, grid
from gauge_envs.pages.text import pairs_text
from gauge_envs.tools.conformance.matrix import MatrixColumn
from gauge_envs.tools.conformance.model import Check, CheckResult, Status
from gauge_envs.tools.conformance.words import SIGNS, cost_text, error_text, expected_text, measured_text, tally

CLASSES = {Status.PASS: "inside", Status.FAIL: "wrong", Status.DECLINED: "declined", Status.ERROR: "wrong"}
"""Classes of the badges: blue, orange and grey, which colour-blind readers distinguish."""

LEAD = (
    "One row per phenomenon: a small scene with a closed form. One column per engine and solver or preset. A cell has "
    "the measured value, its relative error, or its error in tolerances where 0 is expected, and the CPU time. The "
    "tolerance is the same for every engine. What an engine declines is no failure. \u26a0 marks a column of another "
    "version of gauge-envs, and a result of a check that was another one then; such a result is not counted."
)


def conformance_page(columns: Sequence[MatrixColumn], checks: Sequence[Check], *, command: str, when: datetime) -> str:
    """Return the self-contained page of a matrix.

    Args:
        columns: Engines and configurations, with the results of their checks.
        checks: The checks, one row each.
        command: Command that wrote the page.
        when: Time of the run.
    """
    ran = [column for column in columns if column.findings]
    left_out = [f"{column.title}: {column.reason}" for column in columns if column.reason]
    origin = f"{when.isoformat(timespec='minutes')}, {sum(column.cpu_s or 0.0 for column in ran):.0f} s of CPU time in "
    origin += f"the checks, {pairs_text(versions())}. Written by"
    parts: list[Part | Html] = [
        element("p", LEAD, class_="lead"),
        _matrix(ran, checks),
        *([Heading("Not run, or not to the end"), listed(left_out)] if left_out else []),
        Heading("Checks"),
        *(_section(check, ran) for check in checks),
        Heading("Configurations"),
        _configurations(ran),
        Heading("Provenance"),
        Paragraph(origin),
        element("p", element("code", command)),
    ]
    return page("Conformance of physics engines", parts, look="full")


def _badge(kind: str, text: str, hint: str | None = None) -> Html:
    return element("span", text, class_=f"badge {kind}", title=hint)


def _matrix(columns: Sequence[MatrixColumn], checks: Sequence[Check]) -> Table:
    current = [column.current() for column in columns]
    outdated = [column.outdated for column in columns]
    titles = ["phenomenon"]
    for column in columns:
        title = [column.backend, element("br"), column.name, below(tally(column))]
        title += [] if column.is_of_this_version else [below(f"\u26a0 gauge-envs {column.gauge_envs}")]
        titles.append(join(title))
    rows = []
    for check in checks:
        expected = below(expected_text(found.get(check.id) for found in current))
        cells = [_cell(column, check.id, old) for column, old in zip(columns, outdated, strict=True)]
        rows.append([join([element("a", check.title, href=f"#{check.id}"), expected]), *cells])
    return grid(titles, rows, look="matrix")


def _cell(column: MatrixColumn, check: str, outdated: Mapping[str, str]) -> Html:
    finding = column.findings.get(check)
    if finding is None:
        word = "refused" if check in column.refused else "not run"
        return _badge("declined", f"\u2013 {word}", column.refused.get(check, column.reason))
    if check in outdated:
        reason = f"{outdated[check]}; its result was {finding.status.value} {measured_text(finding)}".rstrip()
        return _badge("declined", "\u26a0 other check", reason)
    hint = "; ".join(finding.missing) or finding.diagnosis or None
    cost = "" if finding.status is Status.DECLINED else cost_text(finding)
    texts = (measured_text(finding), error_text(finding), cost)
    return join([_badge(CLASSES[finding.status], SIGNS[finding.status], hint), *(below(one) for one in texts if one)])


def _section(check: Check, columns: Sequence[MatrixColumn]) -> Html:
    """Return the description of a check, and its results with the commands that repeat them."""
    facts = {"scene": check.scene, "measures": check.measures, "law": check.law, "source": check.source}
    facts["tolerance"] = check.tolerance.rationale
    found = [(column, column.findings[check.id]) for column in columns if check.id in column.findings]
    refused = [(column, None) for column in columns if check.id in column.refused]
    results = Table(
        columns=(
            Column("0.title", "engine"),
            Column(
                "1", "outcome", html=lambda one: _badge(CLASSES[one.status], SIGNS[one.status]) if one else "refused"
            ),
            Column("1", "measured", html=lambda one: measured_text(one) if one else ""),
            Column("1", "expected", html=lambda one: expected_text([one])),
            Column("1", "error", html=lambda one: error_text(one) if one else ""),
            Column("", "command", html=lambda row: code(row[0].command(check.id)) if row[1] else ""),
            Column(
                "", "", lambda row: _note(row[0], row[1]) if row[1] else row[0].refused[check.id], place=Place.BELOW
            ),
        ),
        rows=[*found, *refused],
    )
    title = element("h3", f"{check.title} ", element("code", check.id))
    described = listed(f"{name}: {text}" for name, text in facts.items())
    return element(
        "section", title, described, folded(f"{len(found)} results with their commands", results.html()), id=check.id
    )


def _note(column: MatrixColumn, finding: CheckResult) -> str:
    return column.outdated.get(finding.check) or "; ".join(finding.missing) or finding.diagnosis


def _configurations(columns: Sequence[MatrixColumn]) -> Table:
    def origin(column: MatrixColumn) -> str:
        """Return when and with which version a column ran, and which of its results are not counted."""
        outdated = (f"{name}: {reason}" for name, reason in column.outdated.items())
        return "; ".join([f"{column.made}, gauge-envs {column.gauge_envs}", *outdated])

    return Table(
        columns=(
            Column("title", "engine"),
            Column("settings", "settings", lambda settings: pairs_text(settings) or "the presets of the engine"),
            Column("versions", "versions", pairs_text),
            Column("", "run", origin),
        ),
        rows=columns,
    )
