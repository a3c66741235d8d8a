"""A matrix of conformance checks as one HTML file: no script, no other file, no network."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from gauge_envs.files import versions
from gauge_envs.pages.document import Heading, Paragraph, Part, page
from gauge_envs.pages.html import Html, below, code, element, folded, join, listed
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import pairs_text
from gauge_envs.tools.conformance.matrix import MatrixColumn
from gauge_envs.tools.conformance.model import Check, CheckResult
from gauge_envs.tools.conformance.words import (
    CLASSES,
    SIGNS,
    WORDS,
    badge,
    error_text,
    expected_text,
    matrix_table,
    measured_text,
    tally,
)

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
    missing: list[Part] = [Heading("Not run, or not to the end"), listed(left_out)] if left_out else []
    origin = f"{when.isoformat(timespec='minutes')}, {sum(column.cpu_s or 0.0 for column in ran):.0f} s of CPU time in "
    origin += f"the checks, {pairs_text(versions())}. Written by"
    parts: list[Part] = [
        element("p", LEAD, class_="lead"),
        _matrix(ran, checks),
        *missing,
        Heading("Checks"),
        *(_section(check, ran) for check in checks),
        Heading("Configurations"),
        _configurations(ran),
        Heading("Provenance"),
        Paragraph(origin),
        element("p", element("code", command)),
    ]
    return page("Conformance of physics engines", parts, look="full")


def _matrix(columns: Sequence[MatrixColumn], checks: Sequence[Check]) -> Table:
    titles = []
    for column in columns:
        title = [column.backend, element("br"), column.name, below(tally(column))]
        title += [] if column.is_of_this_version else [below(f"\u26a0 gauge-envs {column.gauge_envs}")]
        titles.append(join(title))
    return matrix_table(columns, checks, titles)


def _section(check: Check, columns: Sequence[MatrixColumn]) -> Html:
    """Return the description of a check, and its results with the commands that repeat them."""
    facts = {"scene": check.scene, "measures": check.measures, "law": check.law, "source": check.source}
    facts["tolerance"] = check.tolerance.rationale
    found = [(column, column.findings[check.id]) for column in columns if check.id in column.findings]
    refused = [(column, None) for column in columns if check.id in column.refused]

    def outcome(one: CheckResult | None) -> Html | str:
        return "refused" if one is None else badge(CLASSES[one.status], f"{SIGNS[one.status][0]} {WORDS[one.status]}")

    def command(row: tuple[MatrixColumn, CheckResult | None]) -> Html | str:
        return "" if row[1] is None else code(row[0].command(check.id))

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
    repeated = folded(f"{len(found)} results with their commands", results.html())
    return element("section", title, described, repeated, id=check.id)


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
