"""Reports of conformance checks: lists of engines and checks, the results of one engine and of several."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from textwrap import shorten
from typing import Any

from gauge_envs.backends import backend_names, versions_of
from gauge_envs.errors import GaugeError
from gauge_envs.pages.document import Document, Paragraph, Part, Tone
from gauge_envs.pages.html import Html, element
from gauge_envs.pages.page import page
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import pairs_text, with_unit
from gauge_envs.runs.workers import call_engine
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
    Status.UNSUPPORTED: "-",
    Status.ERROR: "✗ error",
}
STYLES = {Status.PASS: "green", Status.FAIL: "bold red", Status.ERROR: "bold red"}
CLASSES = {Status.PASS: "inside", Status.UNSUPPORTED: "unsupported"}
"""Classes of outcomes on a page; all others are `wrong`."""

MAX_FAILURES = 6
"""Largest number of failures of one engine on a screen, each with its cause."""

MAX_ROWS = 14
"""Largest number of checks in the table of several engines on a screen."""


def backends_table() -> Table:
    """Return the installed engines: name, versions, and the error of an unusable engine.

    Engines outside this package answer in a separate process.
    """
    rows: list[dict[str, Any]] = []
    for name in backend_names():
        try:
            engine_versions = call_engine(
                name, versions_of, name, time_limit_s=QUERY_LIMIT_S
            )
            rows.append({"name": name, "versions": engine_versions, "error": None})
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
        rows=[{key: getattr(check, key) for key in CHECK_TEXTS} for check in checks],
    )


# --- one engine ------------------------------------------------------------------------------------------------------


def engine_document(results: Sequence[CheckResult]) -> Document:
    """Return the results of one engine on one screen: counts, levels, failures with causes, unsupported checks.

    The wide form and Markdown have all checks.
    """
    versions = ", ".join(f"{key} {text}" for key, text in results[0].versions.items())
    answer = f"{results[0].backend} ({versions}): {counts_text(results)}"
    parts: list[Part] = [Paragraph(answer, Tone.ANSWER)]
    verdicts = ", ".join(f"{level} {text}" for level, text in levels(results).items())
    if verdicts:
        parts.append(Paragraph(f"Levels: {verdicts}."))
    failures = sorted((result for result in results if result.is_bad), key=_urgency)
    if failures:
        columns = (
            Column("check", "check"),
            Column(
                "",
                "measured",
                lambda result: _measured_text(result) or result.status.value,
                style=lambda _: "bold red",
            ),
            Column("", "expected", expected_text),
            Column("", "", _message, place=Place.BELOW),
        )
        parts.append(Table(columns=columns, rows=failures[:MAX_FAILURES]))
    parts += [Paragraph(note, Tone.NOTE) for note in _notes(results, failures)]
    everything = Table(
        columns=(
            Column("", "check", lambda result: f"{result.of.title} ({result.check})"),
            Column("", "expected", expected_text),
            Column(
                "",
                "measured",
                lambda result: f"{_measured_text(result)} {result.status}".lstrip(),
                style=lambda result: STYLES.get(result.status, ""),
            ),
            Column("", "", _reason, place=Place.BELOW),
        ),
        rows=results,
        wide_only=True,
    )
    rows = (result.to_dict() for result in results)
    return Document(parts=(*parts, everything), rows=rows)


def _urgency(result: CheckResult) -> int:
    """Return the rank of a failure; failures that make other results worthless come first."""
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


def _notes(
    results: Sequence[CheckResult], failures: Sequence[CheckResult]
) -> Iterator[str]:
    """Yield notes on failures that are not shown, and on the most frequent reason of unsupported checks."""
    if len(failures) > MAX_FAILURES:
        yield f"{len(failures) - MAX_FAILURES} more failures: see --format wide"
    reasons = Counter(
        "; ".join(result.missing)
        for result in results
        if result.status is Status.UNSUPPORTED
    )
    if reasons:
        ((reason, count),) = reasons.most_common(1)
        text = shorten(reason, 100, placeholder=" ...")
        rest = reasons.total() - count
        more = f"; {rest} for other reasons: see --format wide" if rest else ""
        yield f"Unsupported, {count}: {text}{more}"


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


def columns_document(
    columns: Sequence[EngineColumn], *, is_wide: bool = False
) -> Document:
    """Return the results of several engines and configurations: failed checks, counts, and a row for each check.

    Args:
        columns: Engines and configurations.
        is_wide: Whether a terminal shows all checks, as Markdown does, instead of the first failed checks.
    """
    known = {name for column in columns for name in column.results}
    rows = [check for check in all_checks() if check.id in known]
    bad = {
        result.check
        for column in columns
        for result in column.results.values()
        if result.is_bad
    }
    failed = [check for check in rows if check.id in bad]
    ran = [column for column in columns if column.results]
    answer = f"{len(failed)} of {len(rows)} checks fail in at least one of {len(ran)} engines"
    short: list[Part] = [Paragraph(answer, Tone.ANSWER), _columns_table(columns)]
    full = [*short, _verdicts_table(ran, rows)]
    if failed:
        short.append(_verdicts_table(ran, failed[:MAX_ROWS]))
    if len(failed) > MAX_ROWS:
        more = f"{len(failed) - MAX_ROWS} more failed checks: see --format wide"
        short.append(Paragraph(more, Tone.NOTE))
    return Document(parts=full if is_wide else short, markdown=full)


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
            Column(
                "", "CPU time", lambda column: f"{column.cpu_s:.3g} s", is_number=True
            ),
            Column("settings", "settings", pairs_text, wide_only=True),
            Column("versions", "versions", pairs_text, wide_only=True),
        ),
        rows=columns,
    )


def _verdicts_table(columns: Sequence[EngineColumn], rows: Sequence[Check]) -> Table:
    """Return a row for each check and a column for each engine: sign, and the value of a failure."""

    def cell(column: EngineColumn) -> Callable[[Check], str]:
        return lambda check: verdict_text(column.results.get(check.id))

    def markup(column: EngineColumn) -> Callable[[Check], Html]:
        def badge_of(check: Check) -> Html:
            result = column.results.get(check.id)
            kind = (
                "unsupported" if result is None else CLASSES.get(result.status, "wrong")
            )
            hint = "" if result is None else _reason(result)
            text = verdict_text(result)
            return element("span", text, class_=f"badge {kind}", title=hint or None)

        return badge_of

    def expected(check: Check) -> str:
        results = (column.results.get(check.id) for column in columns)
        texts = (expected_text(result) for result in results if result)
        return next(filter(None, texts), "")

    return Table(
        columns=(
            Column("id", "check"),
            Column("", "expected", expected),
            *(
                Column("", column.title, cell(column), html=markup(column))
                for column in columns
            ),
        ),
        rows=rows,
        look="matrix",
    )


def verdict_text(result: CheckResult | None) -> str:
    """Return the sign of a result, with the value of a failure; `-` if the check did not run."""
    if result is None:
        return "-"
    value = _measured_text(result) if result.status is Status.FAIL else ""
    return f"{SIGNS[result.status]} {value}".rstrip()


def changes_table(changes: Iterable[Change]) -> Table:
    """Return the checks whose result differs from the result of an earlier version of the engine."""

    def text(result: CheckResult) -> str:
        return f"{SIGNS[result.status]} {_measured_text(result)}".rstrip()

    return Table(
        columns=(
            Column("column", "engine"),
            Column("after.check", "check"),
            Column("kind", "change"),
            Column("before", "before", text),
            Column("after", "now", text),
            Column("after", "expected", expected_text),
            Column("after.diagnosis", "", place=Place.BELOW),
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
        name: result.of for column in columns for name, result in column.results.items()
    }
    described = Table(
        title="Checks",
        columns=tuple(
            Column(key, key) for key in (*CHECK_TEXTS, "tolerance.rationale", "cause")
        ),
        rows=list(checks.values()),
    )
    parts = [
        *columns_document(columns, is_wide=True).parts,
        described,
        element("p", element("code", command)),
    ]
    return page("Conformance of physics engines", parts, look="full")
