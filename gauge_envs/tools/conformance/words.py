"""Results of conformance checks in words: tables of engines and checks, one screen of results, tables of engines."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from gauge_envs.backends import backend_names, versions_of
from gauge_envs.errors import GaugeError
from gauge_envs.pages.document import Document, Paragraph, Part, Tone
from gauge_envs.pages.html import Html, element
from gauge_envs.pages.page import page
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import pairs_text, with_unit
from gauge_envs.runs.isolation import call_engine
from gauge_envs.tools.conformance.model import (
    Check,
    CheckResult,
    Status,
    checks as all_checks,
)
from gauge_envs.tools.conformance.results import (
    Change,
    EngineColumn,
    counts_text,
    levels,
)

QUERY_LIMIT_S = 60.0
"""Time for which an engine outside this package may answer [s]."""

SIGNS = {
    Status.PASS: "✓",
    Status.FAIL: "✗",
    Status.DECLINED: "-",
    Status.ERROR: "✗ error",
}
STYLES = {Status.PASS: "green", Status.FAIL: "bold red", Status.ERROR: "bold red"}
CLASSES = {Status.PASS: "inside", Status.DECLINED: "declined"}
"""Classes of outcomes on a page; all others are `wrong`."""

REASON_LINES = 2
"""Largest number of lines on what an engine declines."""


def backends_table() -> Table:
    """Return the installed engines: name, versions, and the error of one that cannot be used.

    Engines outside this package answer in a process of their own.
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


CHECK_TEXTS = ("id", "title", "scene", "measures", "law", "source", "unit")


def checks_table(checks: Sequence[Check]) -> Table:
    """Return the checks with their scenes, measured quantities and laws."""
    return Table(
        columns=(
            Column("id", "check"),
            Column("law", "law"),
            Column("unit", "unit", wide_only=True),
            Column("scene", "scene", place=Place.BELOW),
            Column("measures", "measures", place=Place.BELOW),
        ),
        rows=[{key: getattr(one, key) for key in CHECK_TEXTS} for one in checks],
    )


# --- one engine ------------------------------------------------------------------------------------------------------


def engine_document(results: Sequence[CheckResult]) -> Document:
    """Return the results of one engine on one screen: counts, levels, failures, and what it declines.

    The wide form and Markdown have all checks.
    """
    versions = ", ".join(f"{key} {text}" for key, text in results[0].versions.items())
    answer = f"{results[0].backend} ({versions}): {counts_text(results)}"
    parts: list[Part] = [Paragraph(answer, Tone.ANSWER)]
    verdicts = ", ".join(f"{level} {text}" for level, text in levels(results).items())
    if verdicts:
        parts.append(Paragraph(f"Levels: {verdicts}."))
    if bad := sorted((one for one in results if one.is_bad), key=_urgency):
        columns = (
            Column("check", "check"),
            Column(
                "",
                "measured",
                lambda one: _measured_text(one) or one.status.value,
                style=lambda _: "bold red",
            ),
            Column("", "expected", expected_text),
            Column("", "", _message, place=Place.BELOW),
        )
        parts.append(Table(columns=columns, rows=bad))
    parts += [Paragraph(line, Tone.NOTE) for line in _declined_lines(results)]
    everything = Table(
        columns=(
            Column("", "check", lambda one: f"{one.of.title} ({one.check})"),
            Column("", "expected", expected_text),
            Column(
                "",
                "measured",
                lambda one: f"{_measured_text(one)} {one.status}".lstrip(),
                style=lambda one: STYLES.get(one.status, ""),
            ),
            Column("", "", _reason, place=Place.BELOW),
        ),
        rows=results,
        wide_only=True,
    )
    rows = (one.to_dict() for one in results)
    return Document(parts=(*parts, everything), rows=rows)


def _urgency(result: CheckResult) -> int:
    """Return the place of a failure: what makes other results worthless comes first."""
    if result.check == "determinism":
        return 0
    if result.diagnosis.startswith("not finite"):
        return 1
    return 2 if result.status is Status.ERROR else 3


def _reason(result: CheckResult) -> str:
    return "; ".join(result.missing) or result.diagnosis


def _message(result: CheckResult) -> str:
    title = result.of.title
    return f"{title[:1].upper()}{title[1:]}: {result.diagnosis}"


def _declined_lines(results: Sequence[CheckResult]) -> Iterator[str]:
    """Yield lines on what an engine declines, the most frequent reasons first."""
    by_reason: dict[str, list[str]] = {}
    for one in results:
        if one.status is Status.DECLINED:
            by_reason.setdefault("; ".join(one.missing), []).append(one.check)
    reasons = sorted(by_reason, key=lambda reason: -len(by_reason[reason]))
    for reason in reasons[:REASON_LINES]:
        yield f"Declined, {len(by_reason[reason])}: {_shortened(reason)}"
    if rest := sum(len(by_reason[reason]) for reason in reasons[REASON_LINES:]):
        yield f"Declined for other reasons, {rest}: see --format wide"


def _shortened(text: str, length: int = 160) -> str:
    return text if len(text) <= length else f"{text[:length].rsplit(' ', 1)[0]} ..."


def expected_text(result: CheckResult) -> str:
    """Return the expected value with its tolerance and unit; empty if nothing was measured."""
    if result.expected is None or result.width is None:
        return ""
    text = f"{result.expected:.4g} +- {result.width:.2g}"
    if not result.width:
        text = f"exactly {result.expected:.4g}"
    return with_unit(text, result.of.unit)


def _measured_text(result: CheckResult) -> str:
    return "" if result.measured is None else f"{result.measured:.4g}"


# --- several engines -------------------------------------------------------------------------------------------------


def columns_document(columns: Sequence[EngineColumn]) -> Document:
    """Return the results of several engines and configurations: their counts, then one row for each check."""
    return Document(parts=(_columns_table(columns), _verdicts_table(columns)))


def _columns_table(columns: Sequence[EngineColumn]) -> Table:
    def counts(column: EngineColumn) -> str:
        text = counts_text([*column.results.values()])
        if column.outdated:
            text += f"; ⚠ {len(column.outdated)} of another version, not counted"
        return column.reason or text

    return Table(
        columns=(
            Column("title", "engine"),
            Column("", "checks", counts),
            Column("", "CPU time", lambda one: f"{one.cpu_s:.3g} s", is_number=True),
            Column("settings", "settings", pairs_text, wide_only=True),
            Column("versions", "versions", pairs_text, wide_only=True),
        ),
        rows=columns,
    )


def _verdicts_table(columns: Sequence[EngineColumn]) -> Table:
    """Return one row for each check and one column for each engine: sign, and the value of a failure."""
    ran = [column for column in columns if column.results]
    found = {name for column in ran for name in column.results}

    def cell(column: EngineColumn) -> Callable[[Check], str]:
        return lambda check: verdict_text(column.results.get(check.id))

    def markup(column: EngineColumn) -> Callable[[Check], Html]:
        def of(check: Check) -> Html:
            one = column.results.get(check.id)
            kind = "declined" if one is None else CLASSES.get(one.status, "wrong")
            hint = "" if one is None else _reason(one)
            text = verdict_text(one)
            return element("span", text, class_=f"badge {kind}", title=hint or None)

        return of

    def expected(check: Check) -> str:
        found = (column.results.get(check.id) for column in ran)
        return next((text for one in found if one and (text := expected_text(one))), "")

    return Table(
        columns=(
            Column("id", "check"),
            Column("", "expected", expected),
            *(Column("", one.title, cell(one), html=markup(one)) for one in ran),
        ),
        rows=[one for one in all_checks() if one.id in found],
        look="matrix",
    )


def verdict_text(result: CheckResult | None) -> str:
    """Return the sign of a result, with the value of a failure; `-` also where nothing ran."""
    if result is None:
        return "-"
    value = _measured_text(result) if result.status is Status.FAIL else ""
    return f"{SIGNS[result.status]} {value}".rstrip()


def changes_table(changes: Iterable[Change]) -> Table:
    """Return the checks that give another result than an earlier version of the engine."""

    def text(one: CheckResult) -> str:
        value = _measured_text(one)
        return f"{SIGNS[one.status]} {value}".rstrip()

    return Table(
        columns=(
            Column("column", "engine"),
            Column("now.check", "check"),
            Column("kind", "change"),
            Column("before", "before", text),
            Column("now", "now", text),
            Column("now", "expected", expected_text),
            Column("now.diagnosis", "", place=Place.BELOW),
        ),
        rows=list(changes),
    )


def conformance_page(columns: Sequence[EngineColumn], command: str) -> str:
    """Return the self-contained page of the results of engines.

    Args:
        columns: Engines and configurations.
        command: Command that wrote the page.
    """
    checks = {
        one.check: one.of for column in columns for one in column.results.values()
    }
    described = Table(
        title="Checks",
        columns=tuple(
            Column(key, key) for key in (*CHECK_TEXTS, "tolerance.rationale", "cause")
        ),
        rows=list(checks.values()),
    )
    parts = [
        *columns_document(columns).parts,
        described,
        element("p", element("code", command)),
    ]
    return page("Conformance of physics engines", parts, look="full")
