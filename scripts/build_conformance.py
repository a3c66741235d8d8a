"""Write the table of `docs/engines/conformance.md` from `scoring/conformance.json`, and what the checks cover.

    gauge backend check '*:default' '*:out_of_box' --out scoring/conformance.json
    python -m scripts build conformance

Engines that need environments of their own are joined by `gauge backend check ONE.json TWO.json --out ...`.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

from gauge_envs.backends import backend
from gauge_envs.pages.markdown import as_markdown
from gauge_envs.tools.conformance import Status, checks
from gauge_envs.tools.conformance.results import EngineColumn, levels, read_columns
from gauge_envs.tools.conformance.words import expected_text, verdict_text
from scripts.conformance_coverage import coverage_tables
from scripts.generated import ROOT, SCORING, markdown_table, page_part

PAGE = ROOT / "docs" / "engines" / "conformance.md"
CHECKS_PAGE = ROOT / "docs" / "adding_a_check.md"
SCRIPT = f"scripts/{Path(__file__).name}"


def verdicts(columns: Sequence[EngineColumn]) -> Iterator[str]:
    """Yield the lines of the table: counts, CPU time and levels, then one row for each check."""
    engines = list(dict.fromkeys(column.backend for column in columns))
    found = {one.backend: one for one in columns if one.name == "default"}
    default = [found[engine] for engine in engines]
    rows = [
        ["passed", "", *map(_passed, default)],
        ["CPU time [s]", "", *(f"{one.cpu_s:.3g}" for one in default)],
    ]
    of_level = [levels([*one.results.values()]) for one in default]
    for level in of_level[0]:
        rows.append([f"level {level}", "", *(one.get(level, "-") for one in of_level)])
    for check in checks():
        ran = [one.results[check.id] for one in default if check.id in one.results]
        expected = next((text for one in ran if (text := expected_text(one))), "")
        cells = [verdict_text(one.results.get(check.id)) for one in default]
        rows.append([f"`{check.id}`", expected, *cells])
    yield from markdown_table(["check", "expected", *engines], rows)


def _passed(column: EngineColumn) -> str:
    statuses = [one.status for one in column.results.values()]
    ran = sum(status is not Status.DECLINED for status in statuses)
    return f"{statuses.count(Status.PASS)} of {ran}"


def contents() -> dict[Path, str]:
    """Return the pages with their generated parts replaced."""
    columns = read_columns(SCORING / "conformance.json")
    pairs = {pair for column in columns for pair in column.versions.items()}
    versions = ", ".join(f"{name} {text}" for name, text in sorted(pairs))
    days = ", ".join(sorted({column.made for column in columns}))
    lines = [f"Run on {days} with {versions}.", "", *verdicts(columns)]
    coverage = "\n".join(map(as_markdown, coverage_tables(backend("mujoco"))))
    return page_part(PAGE, "matrix", SCRIPT, "\n".join(lines)) | page_part(
        CHECKS_PAGE, "coverage", SCRIPT, coverage
    )
