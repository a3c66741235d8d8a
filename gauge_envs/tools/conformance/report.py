"""Reports of conformance checks: lists of engines and checks, the results of one engine and of several."""

from collections import Counter
from collections.abc import Iterator, Sequence
from textwrap import shorten

from gauge_envs.backends import backend_names, versions_of
from gauge_envs.errors import GaugeError
from gauge_envs.pages.document import Document, Paragraph, Part, Tone
from gauge_envs.pages.table import Column, Place, Table, grid
from gauge_envs.pages.text import with_unit
from gauge_envs.runs.workers import call_engine
from gauge_envs.tools.conformance.catalog import checks as all_checks
from gauge_envs.tools.conformance.causes import likely_causes
from gauge_envs.tools.conformance.model import Check, CheckResult, Status
from gauge_envs.tools.conformance.results import EngineColumn, counts_text, levels

QUERY_LIMIT_S = 60.0
"""Time for which an engine outside this package may answer [s]."""

SIGNS = {
    Status.PASS: "✓",
    Status.FAIL: "✗",
    Status.UNSUPPORTED: "-",
    Status.ERROR: "✗ error",
}
STYLES = {Status.PASS: "green", Status.FAIL: "bold red", Status.ERROR: "bold red"}

NOT_IN_RIGID = "No level says anything of motors, limits, springs and friction of joints, which scenes do not have."

MAX_FAILURES = 6
"""Largest number of failures of one engine on a screen, each with its cause."""


def backends_table() -> Table:
    """Return the installed engines: name, versions, and the error of an unusable engine.

    Engines outside this package answer in a separate process.
    """
    rows = []
    for name in backend_names():
        try:
            engine_versions = call_engine(
                name, versions_of, name, time_limit_s=QUERY_LIMIT_S
            )
            rows.append({"name": name, "versions": engine_versions, "error": None})
        except GaugeError as error:
            rows.append({"name": name, "versions": {}, "error": str(error)})
    engine = Column(
        "", "engine", lambda row: row["error"] or versions_text(row["versions"])
    )
    return Table(columns=(Column("name", "backend"), engine), rows=rows)


def versions_text(versions: dict[str, str]) -> str:
    """Return versions of packages, as `newton 1.8.0, warp-lang 1.19.0`."""
    return ", ".join(f"{name} {text}" for name, text in versions.items())


CHECK_TEXTS = ("id", "title", "description", "law", "unit")


def checks_table(checks: Sequence[Check]) -> Table:
    """Return the checks with their descriptions and laws."""
    return Table(
        columns=(
            Column("id", "check"),
            Column("law", "law"),
            Column("unit", "unit", wide_only=True),
            Column("description", "description", place=Place.BELOW),
        ),
        rows=[{key: getattr(check, key) for key in CHECK_TEXTS} for check in checks],
    )


# --- one engine ------------------------------------------------------------------------------------------------------


def engine_document(results: Sequence[CheckResult]) -> Document:
    """Return the results of one engine on one screen: counts, levels, failures with causes, unsupported checks.

    The wide form and Markdown have all checks.
    """
    answer = f"{results[0].backend} ({versions_text(dict(results[0].versions))}): {counts_text(results)}"
    parts: list[Part] = [Paragraph(answer, Tone.ANSWER)]
    verdicts = ", ".join(f"{level} {text}" for level, text in levels(results).items())
    if verdicts:
        parts.append(Paragraph(f"Levels: {verdicts}."))
    if "rigid" in verdicts:
        parts.append(Paragraph(NOT_IN_RIGID, Tone.NOTE))
    parts += [Paragraph(f"Likely: {text}.") for text in likely_causes(results)]
    failures = [result for result in results if result.is_bad]
    columns = (
        Column("", "check", lambda result: f"{result.of.title} ({result.check})"),
        Column("", "expected", expected_text),
        Column(
            "",
            "measured",
            lambda result: f"{_measured_text(result)} {result.status}".lstrip(),
            style=lambda result: STYLES.get(result.status, ""),
        ),
        Column(
            "",
            "",
            lambda result: "; ".join(result.missing) or result.diagnosis,
            place=Place.BELOW,
        ),
    )
    if failures:
        parts.append(Table(columns=columns, rows=failures[:MAX_FAILURES]))
    parts += [Paragraph(note, Tone.NOTE) for note in _notes(results, failures)]
    everything = Table(columns=columns, rows=results, wide_only=True)
    rows = (result.to_dict() for result in results)
    return Document(parts=(*parts, everything), rows=rows)


def _notes(
    results: Sequence[CheckResult], failures: Sequence[CheckResult]
) -> Iterator[str]:
    """Yield notes on failures that are not shown, narrow passes, and the most frequent reason of unsupported checks."""
    if len(failures) > MAX_FAILURES:
        yield f"{len(failures) - MAX_FAILURES} more failures: see --format wide"
    for result in results:
        if result.is_narrow:
            text = f"Narrow pass: {result.check} is {_measured_text(result)} for {expected_text(result)}"
            yield "; ".join(filter(None, (text, result.diagnosis)))
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


def comparison(columns: Sequence[EngineColumn]) -> Table:
    """Return a column for each engine: counts, levels, and the checks that one of the engines fails."""
    rows = [["passed", "", *map(_passed, columns)]]
    verdicts = [levels([*column.results.values()]) for column in columns]
    for level in verdicts[0]:
        cells = [of_engine.get(level, "-") for of_engine in verdicts]
        rows.append([f"level {level}", "", *cells])
    for check in all_checks():
        results = [column.results.get(check.id) for column in columns]
        measured = [result for result in results if result is not None]
        if any(result.is_bad for result in measured):
            expected = next(filter(None, map(expected_text, measured)), "")
            rows.append([check.id, expected, *map(_verdict_text, results)])
    return grid(["check", "expected", *(column.title for column in columns)], rows)


def _passed(column: EngineColumn) -> str:
    statuses = [result.status for result in column.results.values()]
    ran = len(statuses) - statuses.count(Status.UNSUPPORTED)
    return f"{statuses.count(Status.PASS)} of {ran}"


def _verdict_text(result: CheckResult | None) -> str:
    """Return the sign of a result, with the value of a failure; `-` if the check did not run."""
    if result is None:
        return "-"
    value = _measured_text(result) if result.status is Status.FAIL else ""
    return f"{SIGNS[result.status]} {value}".rstrip()
