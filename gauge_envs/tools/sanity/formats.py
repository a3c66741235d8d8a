"""Sanity checks for continuous integration: JUnit, and workflow commands of GitHub."""

from collections.abc import Callable, Mapping
from xml.etree import ElementTree

from gauge_envs.tools.sanity.model import PhenomenonResult, Report, Verdict
from gauge_envs.tools.sanity.words import (
    measured_text,
    reality_text,
    responsible_text,
    top_line,
    verdict_text,
)

LEVELS = {Verdict.WRONG: "error", Verdict.VISIBLE: "warning"}
"""Commands of GitHub for a flag."""


def _message(row: PhenomenonResult) -> str:
    """Return what a row found, in one line."""
    found = f"{measured_text(row.configured)} instead of {reality_text(row.reality, row.unit)} ({verdict_text(row)})"
    return f"{row.title}: {found}. {responsible_text(row)}".strip()


def junit_text(report: Report) -> str:
    """Return a report as a test suite: a flag is a failure, a row that should have been measured an error."""
    unmeasured = set(report.unmeasured)
    failures = [row for row in report.rows if row.is_flag]
    skipped = [
        row
        for row in report.rows
        if row.verdict is Verdict.DECLINED and row.phenomenon not in unmeasured
    ]
    suite = ElementTree.Element(
        "testsuite",
        name=f"gauge sanity {report.configuration.name}",
        tests=str(len(report.rows)),
        failures=str(len(failures)),
        errors=str(len(unmeasured)),
        skipped=str(len(skipped)),
        time=f"{report.wall_s:.3f}",
    )
    for row in report.rows:
        case = ElementTree.SubElement(
            suite, "testcase", classname="gauge.sanity", name=row.phenomenon
        )
        if row.is_flag:
            ElementTree.SubElement(
                case, "failure", type=row.verdict.value, message=_message(row)
            )
        elif row.phenomenon in unmeasured:
            ElementTree.SubElement(case, "error", type="unmeasured", message=row.remark)
        elif row in skipped:
            ElementTree.SubElement(case, "skipped", message=row.remark)
    ElementTree.indent(suite)
    return ElementTree.tostring(suite, encoding="unicode")


def github_text(report: Report) -> str:
    """Return a report as workflow commands: an annotation for each flag, and one with the first line of the report."""

    def command(kind: str, title: str, text: str) -> str:
        escaped = text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")
        return f"::{kind} title={title.replace('%', '%25').replace(':', '%3A').replace(',', '%2C')}::{escaped}"

    lines = [
        command(LEVELS[r.verdict], f"gauge sanity {r.phenomenon}", _message(r))
        for r in report.rows
        if r.is_flag
    ]
    lines += [
        command("error", f"gauge sanity {name}", "was not measured")
        for name in report.unmeasured
    ]
    return "\n".join(
        [
            *lines,
            command(
                "notice", f"gauge sanity {report.configuration.name}", top_line(report)
            ),
        ]
    )


WRITERS: Mapping[str, Callable[[Report], str]] = {
    "junit": junit_text,
    "github": github_text,
}
"""Functions that write a report, by the name of the format."""
