"""Write the table of `docs/engines/conformance.md` from `scoring/conformance.json`: the checks that an engine fails.

    gauge backend check '*:default' '*:out_of_box' --out scoring/conformance.json
    python -m scripts build conformance

Engines that need environments of their own are joined by `gauge backend check ONE.json TWO.json --out ...`.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

from gauge_envs.tools.conformance import Status, checks
from gauge_envs.tools.conformance.report import expected_text, verdict_text
from gauge_envs.tools.conformance.results import EngineColumn, levels, read_columns
from scripts.generated import ROOT, SCORING, markdown_table, page_part

PAGE = ROOT / "docs" / "engines" / "conformance.md"
FAILURES = {Status.FAIL, Status.ERROR}
SCRIPT = f"scripts/{Path(__file__).name}"


def verdicts(columns: Sequence[EngineColumn]) -> Iterator[str]:
    """Yield the lines of the table: counts and levels, then a row for each check that an engine fails."""
    default = [column for column in columns if column.name == "default"]
    rows = [["passed", "", *map(_passed, default)]]
    engine_levels = [levels([*column.results.values()]) for column in default]
    for level in engine_levels[0]:
        verdict_cells = [verdicts.get(level, "-") for verdicts in engine_levels]
        rows.append([f"level {level}", "", *verdict_cells])
    for check in checks():
        results = [column.results.get(check.id) for column in default]
        measured = [result for result in results if result is not None]
        if any(result.status in FAILURES for result in measured):
            expected = next(filter(None, map(expected_text, measured)), "")
            rows.append([f"`{check.id}`", expected, *map(verdict_text, results)])
    engines = [column.backend for column in default]
    yield from markdown_table(["check", "expected", *engines], rows)


def _passed(column: EngineColumn) -> str:
    statuses = [result.status for result in column.results.values()]
    ran = sum(status is not Status.UNSUPPORTED for status in statuses)
    return f"{statuses.count(Status.PASS)} of {ran}"


def contents() -> dict[Path, str]:
    """Return the pages with their generated parts replaced."""
    columns = read_columns(SCORING / "conformance.json")
    pairs = {pair for column in columns for pair in column.versions.items()}
    versions = ", ".join(f"{name} {text}" for name, text in sorted(pairs))
    days = ", ".join(sorted({column.made for column in columns}))
    lines = [f"Run on {days} with {versions}.", "", *verdicts(columns)]
    return page_part(PAGE, "matrix", SCRIPT, "\n".join(lines))
