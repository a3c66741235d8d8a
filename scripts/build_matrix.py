"""Write the tables of `docs/engines/matrix.md` from `scoring/conformance.json`.

    gauge backend check --all --out engines.json                                in each environment that has engines
    gauge backend check --from engines.json --from genesis.json --out scoring/conformance.json
    python scripts/build_matrix.py                                              writes the page
    python scripts/build_matrix.py --check                                      fails if the page is not current

Each failure of a default configuration has a sentence in `CAUSES`, or the page says that its cause is unknown.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from generated import write_or_check

from gauge_envs.checks.conformance import CheckResult, checks
from gauge_envs.checks.conformance.matrix import CANONICAL, MatrixColumn
from gauge_envs.checks.conformance.matrix_file import read_columns
from gauge_envs.report.conformance_matrix import error_text, expected_text, matrix_markdown, measured_text

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "engines" / "matrix.md"
BEGIN, END = "<!-- matrix, written by scripts/build_matrix.py -->", "<!-- end of matrix -->"

CAUSES: Mapping[tuple[str, str], str] = {}
"""Verified cause of a failure of a default configuration, by engine and check, in one sentence."""


def failures(columns: Sequence[MatrixColumn]) -> list[CheckResult]:
    """Return what default configurations fail, in the order of the columns."""
    default = [column for column in columns if column.name == "default"]
    return [finding for column in default for finding in column.current().values() if finding.is_bad]


def causes(columns: Sequence[MatrixColumn]) -> Iterator[str]:
    """Yield a line for each failure of a default configuration."""
    for finding in failures(columns):
        found = f"{measured_text(finding)}, {error_text(finding)}" if finding.measured is not None else "an error"
        cause = CAUSES.get((finding.backend, finding.check), "The cause is unknown.")
        law = f" instead of {expected_text([finding])}" if finding.measured is not None else ""
        yield f"- {finding.backend}, `{finding.check}`: {found}{law}. {cause}"


def generate(scoring: Path) -> dict[Path, str]:
    """Return the page with its generated part replaced."""
    columns = read_columns(scoring / "conformance.json")
    text = PAGE.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    lines = [BEGIN, "", "### Failures of default configurations", "", *causes(columns), ""]
    generated = "\n".join([*lines, matrix_markdown(columns, checks(CANONICAL))])
    return {PAGE: f"{before}{generated}{END}{after}"}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the script; return its exit status."""
    return write_or_check(
        generate, script="build_matrix.py", what="Write the page of engines and phenomena.", arguments=arguments
    )


if __name__ == "__main__":
    sys.exit(main())
