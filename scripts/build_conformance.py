"""Write the tables of `docs/engines/conformance.md` from `scoring/conformance.json`.

    gauge backend check '*:*' --only '*' --out engines.json                     in each environment that has engines
    gauge backend check engines.json genesis.json --out scoring/conformance.json
    python -m scripts build conformance

A failure of a default configuration is listed with the hints of its check, which are likely causes and not verified.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from gauge_envs.pages.text import markdown_text, pairs_text
from gauge_envs.tools.conformance import checks
from gauge_envs.tools.conformance.matrix import CANONICAL, MatrixColumn, read_columns
from gauge_envs.tools.conformance.model import CheckResult, Status
from gauge_envs.tools.conformance.words import (
    error_text,
    expected_text,
    measured_text,
    tally,
)
from scripts.generated import ROOT, SCORING, markdown_table, page_part

PAGE = ROOT / "docs" / "engines" / "conformance.md"
SCRIPT = f"scripts/{Path(__file__).name}"
SHOWN = ("default", "out_of_box")
"""Configurations that the table of checks shows, one sign each."""

SIGNS = {Status.PASS: "✓", Status.FAIL: "✗", Status.ERROR: "✗", Status.DECLINED: "-"}


def failures(columns: Sequence[MatrixColumn]) -> Iterator[str]:
    """Yield a line for each failure of a default configuration, or one that says that there is none."""
    default = [column for column in columns if column.name == "default"]
    bad = [
        finding
        for column in default
        for finding in column.current().values()
        if finding.is_bad
    ]
    if not bad:
        yield "No default configuration fails a check or raises an error."
    for finding in bad:
        found = "an error"
        if finding.measured is not None:
            found = f"{measured_text(finding)}, {error_text(finding)} instead of {expected_text([finding])}"
        hints = markdown_text(finding.diagnosis)
        yield f"- {finding.backend}, `{finding.check}`: {found}. Hints of the check: {hints}"


def configuration(column: MatrixColumn) -> list[str]:
    """Return the cells of a configuration."""
    settings = {
        name: value
        for name, value in column.settings.items()
        if (name, value) != ("preset", column.name)
    }
    settings_text = f"`{pairs_text(settings)}`" if settings else ""
    cost = "" if column.cpu_s is None else f"{column.cpu_s:.3g} s"
    return [column.backend, f"`{column.name}`", settings_text, tally(column), cost]


def sign(finding: CheckResult | None) -> str:
    """Return the sign of a result; `-` also where a configuration was not run."""
    return "-" if finding is None else SIGNS[finding.status]


def check_table(columns: Sequence[MatrixColumn]) -> Iterator[str]:
    """Yield the table: one check per phenomenon, and what a default fails, with a column for each engine."""
    engines = list(dict.fromkeys(column.backend for column in columns))
    found = {(column.backend, column.name): column.current() for column in columns}
    failed = {
        name
        for (_, configuration), results in found.items()
        if configuration == "default"
        for name, one in results.items()
        if one.is_bad
    }
    rows = []
    for check in checks([*CANONICAL, *failed]):
        of_check = {place: results.get(check.id) for place, results in found.items()}
        cells = [
            "".join(sign(of_check.get((engine, name))) for name in SHOWN)
            for engine in engines
        ]
        expected = expected_text(of_check.values())
        rows.append(
            [f"`{check.id}`", "exactly 0" if expected == "0 +- 0" else expected, *cells]
        )
    yield from markdown_table(["check", "expected", *engines], rows)


def contents() -> dict[Path, str]:
    """Return the page with its generated part replaced."""
    columns = read_columns(SCORING / "conformance.json")
    versions = {
        f"{name} {text}" for column in columns for name, text in column.versions.items()
    }
    lines = [
        *failures(columns),
        "",
        f"Run on {', '.join(sorted({column.made for column in columns}))} with {', '.join(sorted(versions))}.",
        "",
        *markdown_table(
            ["engine", "configuration", "settings", "passed", "CPU time"],
            map(configuration, columns),
        ),
        "",
        "The checks of all engines with `default` and `out_of_box`, in this order:",
        "",
        *check_table(columns),
    ]
    return page_part(PAGE, "matrix", SCRIPT, "\n".join(lines))
