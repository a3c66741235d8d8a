"""Write the tables of `docs/engines/matrix.md` from `scoring/conformance.json`.

    gauge backend check '*:*' --out engines.json                                 in each environment that has engines
    gauge backend check engines.json genesis.json --out scoring/conformance.json
    python scripts/build_matrix.py                                              writes the page
    python scripts/build_matrix.py --check                                      fails if the page is not current

A failure of a default configuration is listed with the hints of its check, which are likely causes and not verified.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from generated import write_or_check

from gauge_envs.pages.document import as_markdown
from gauge_envs.pages.text import markdown_text
from gauge_envs.tools.conformance import checks
from gauge_envs.tools.conformance.matrix import CANONICAL, MatrixColumn
from gauge_envs.tools.conformance.matrix_file import read_columns
from gauge_envs.tools.conformance.words import error_text, expected_text, matrix_document, measured_text

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "engines" / "matrix.md"
BEGIN, END = "<!-- matrix, written by scripts/build_matrix.py -->", "<!-- end of matrix -->"


def failures(columns: Sequence[MatrixColumn]) -> Iterator[str]:
    """Yield a line for each failure of a default configuration, or one that says that there is none."""
    default = [column for column in columns if column.name == "default"]
    bad = [finding for column in default for finding in column.current().values() if finding.is_bad]
    if not bad:
        yield "No default configuration fails a check or raises an error."
    for finding in bad:
        found = "an error"
        if finding.measured is not None:
            found = f"{measured_text(finding)}, {error_text(finding)} instead of {expected_text([finding])}"
        hints = markdown_text(finding.diagnosis)
        yield f"- {finding.backend}, `{finding.check}`: {found}. Hints of the check: {hints}"


def declined(columns: Sequence[MatrixColumn]) -> Iterator[str]:
    """Yield a line for each engine and reason for which its backend declines scenes, with the checks."""
    found: dict[tuple[str, str], dict[str, None]] = {}
    for column in columns:
        for finding in column.current().values():
            for reason in finding.missing:
                found.setdefault((column.backend, reason), {})[finding.check] = None
    for (engine, reason), names in sorted(found.items()):
        yield f"- {engine}: {markdown_text(reason)} ({', '.join(f'`{name}`' for name in names)})"


def generate(scoring: Path) -> dict[Path, str]:
    """Return the page with its generated part replaced."""
    columns = read_columns(scoring / "conformance.json")
    text = PAGE.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    lines = [BEGIN, "", "### Failures of default configurations", "", *failures(columns), ""]
    lines += ["### Why scenes are declined", "", *declined(columns), ""]
    generated = "\n".join([*lines, as_markdown(matrix_document(columns, checks(CANONICAL)))])
    return {PAGE: f"{before}{generated}{END}{after}"}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the script; return its exit status."""
    return write_or_check(
        generate, script="build_matrix.py", what="Write the page of engines and phenomena.", arguments=arguments
    )


if __name__ == "__main__":
    sys.exit(main())
