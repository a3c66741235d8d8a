"""Sanity checks for continuous integration: JUnit, SARIF, and workflow commands of GitHub."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote
from xml.etree import ElementTree

from gauge_envs.files import versions
from gauge_envs.pages.text import shortened
from gauge_envs.tools.sanity.comparison import Change, Comparison
from gauge_envs.tools.sanity.comparison_words import change_text, comparison_line
from gauge_envs.tools.sanity.model import PhenomenonResult, Report, Verdict
from gauge_envs.tools.sanity.words import (
    measured_text,
    reality_text,
    responsible_text,
    top_line,
    verdict_text,
)

SARIF_SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"

LEVELS = {Verdict.WRONG: "error", Verdict.VISIBLE: "warning"}
"""Levels of a flag in SARIF, and commands of GitHub."""


def _message(row: PhenomenonResult) -> str:
    """Return what a row found, in one line."""
    found = f"{measured_text(row.configured)} instead of {reality_text(row.reality, row.unit)} ({verdict_text(row)})"
    parts = [one.name for one in row.parts if one.verdict.is_off]
    several = f"In {shortened(parts)}. " if len(parts) > 1 else ""
    return f"{row.title}: {found}. {several}{responsible_text(row)}".strip()


def _unmeasured_text(row: PhenomenonResult) -> str:
    """Return that a row was not measured, and why."""
    how = "was not measured" if row.applies else "does not apply"
    return f"{row.phenomenon} {how}: {row.remark}"


def junit_text(report: Report) -> str:
    """Return a report as a test suite: a flag is a failure, a row that should have been measured an error."""
    unmeasured = report.unmeasured
    declined = [row for row in report.rows if row.verdict is Verdict.DECLINED]
    suite = ElementTree.Element(
        "testsuite",
        name=f"gauge sanity {report.configuration.name}",
        tests=str(len(report.rows)),
        failures=str(len(report.flags)),
        errors=str(len(unmeasured)),
        skipped=str(len(declined) - len(unmeasured)),
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
        elif row in declined:
            ElementTree.SubElement(case, "skipped", message=row.remark)
    ElementTree.indent(suite)
    return ElementTree.tostring(suite, encoding="unicode")


def sarif_text(report: Report) -> str:
    """Return a report as SARIF 2.1.0; a target that is a file is the place of its flags."""
    words = report.configuration.source.split(" ")
    endings = (Path(" ".join(words[start:])) for start in range(len(words)))
    file = next((one for one in endings if one.is_file()), None)
    locations = {}
    if file is not None:
        uri = quote(file.as_posix())
        location = {"physicalLocation": {"artifactLocation": {"uri": uri}}}
        locations = {"locations": [location]}
    rules = [
        {
            "id": row.phenomenon,
            "shortDescription": {"text": row.title},
            "fullDescription": {"text": row.reality.source},
        }
        for row in report.rows
    ]
    results: list[Mapping[str, Any]] = [
        {
            "ruleId": row.phenomenon,
            "level": LEVELS[row.verdict],
            "message": {"text": _message(row)},
            **locations,
        }
        for row in report.flags.values()
    ]
    unmeasured = set(report.unmeasured)
    notes = [
        {
            "level": "error" if row.phenomenon in unmeasured else "note",
            "associatedRule": {"id": row.phenomenon},
            "message": {"text": _unmeasured_text(row)},
        }
        for row in report.rows
        if row.verdict is Verdict.DECLINED
    ]
    invocation = {
        "executionSuccessful": not unmeasured,
        "toolExecutionNotifications": notes,
        "properties": report.counts,
    }
    driver = {
        "name": "gauge sanity",
        "version": versions()["gauge-envs"],
        "rules": rules,
    }
    run = {"tool": {"driver": driver}, "results": results, "invocations": [invocation]}
    return json.dumps(
        {"$schema": SARIF_SCHEMA, "version": "2.1.0", "runs": [run]}, indent=1
    )


def _command(kind: str, title: str, text: str) -> str:
    """Return a workflow command of GitHub, which makes an annotation."""
    escaped = text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")
    return f"::{kind} title={title.replace('%', '%25').replace(':', '%3A').replace(',', '%2C')}::{escaped}"


def github_text(report: Report) -> str:
    """Return a report as workflow commands: an annotation for each flag, and one with the first line of the report."""
    lines = [
        _command(LEVELS[r.verdict], f"gauge sanity {r.phenomenon}", _message(r))
        for r in report.flags.values()
    ]
    lines += [
        _command("error", f"gauge sanity {row.phenomenon}", _unmeasured_text(row))
        for row in report.rows
        if row.phenomenon in report.unmeasured
    ]
    name = report.configuration.name
    return "\n".join(
        [*lines, _command("notice", f"gauge sanity {name}", top_line(report))]
    )


def github_comparison(comparison: Comparison) -> str:
    """Return a comparison as workflow commands: an annotation for each change, and one with its first line."""
    lines = [
        _command(
            "error" if row.change is Change.LARGE else "warning",
            f"gauge sanity {row.id}",
            change_text(row),
        )
        for row in comparison.changed
    ]
    title = f"gauge sanity {comparison.trained.name} against {comparison.deployed.name}"
    return "\n".join([*lines, _command("notice", title, comparison_line(comparison))])


WRITERS: Mapping[str, Callable[[Report], str]] = {
    "junit": junit_text,
    "sarif": sarif_text,
    "github": github_text,
}
"""Functions that write a report, by the name of the format."""
