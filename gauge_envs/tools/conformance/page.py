"""A matrix of conformance checks as one HTML file: no script, no other file, no network."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from html import escape
from pathlib import Path

from gauge_envs.errors import ResultFileError
from gauge_envs.files import versions, write_whole
from gauge_envs.pages.html import STYLE
from gauge_envs.pages.text import pairs_text
from gauge_envs.tools.conformance.matrix import MatrixColumn
from gauge_envs.tools.conformance.matrix_words import cost_text, error_text, expected_text, measured_text, tally
from gauge_envs.tools.conformance.model import Check, CheckResult, Status

CLASSES = {Status.PASS: "inside", Status.FAIL: "wrong", Status.DECLINED: "declined", Status.ERROR: "wrong"}
"""Classes of the sanity page's style: blue, orange and grey, which colour-blind readers distinguish."""

WORDS = {
    Status.PASS: "&#10003; pass",
    Status.FAIL: "&#10007; FAIL",
    Status.DECLINED: "&ndash; declined",
    Status.ERROR: "&#10007; error",
}

MATRIX_STYLE = """
.scroll { overflow-x: auto; max-width: 100%; } body { max-width: none; }
.matrix { width: auto; font-size: .8rem; line-height: 1.3; }
.matrix td, .matrix th { padding: .2rem .35rem; vertical-align: top; white-space: nowrap; }
.matrix th:first-child, .matrix td:first-child { position: sticky; left: 0; background: var(--back); z-index: 1;
  white-space: normal; overflow-wrap: normal; width: 13rem; min-width: 13rem; border-right: 1px solid var(--line); }
.matrix th { vertical-align: bottom; } .matrix small { color: var(--quiet); display: block; font-weight: 400; }
.matrix .badge { padding: 0 .3rem; } .matrix tbody tr:hover td { background: var(--grey); }
section { max-width: 72rem; } code { font-size: .85rem; overflow-wrap: anywhere; }
@media (max-width: 760px) { .matrix th:first-child, .matrix td:first-child { width: 7.5rem; min-width: 7.5rem; } }
"""


def save_conformance_page(
    columns: Sequence[MatrixColumn], checks: Sequence[Check], path: Path, *, command: str
) -> Path:
    """Write the page of a matrix and return its path.

    Args:
        columns: Engines and configurations, with the results of their checks.
        checks: The checks, one row each.
        path: The file.
        command: Command that wrote it.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, conformance_page(columns, checks, command=command, when=datetime.now(UTC)).encode())
    except OSError as error:
        raise ResultFileError(f"{path}: cannot be written: {error.strerror or error}") from error
    return path


def conformance_page(columns: Sequence[MatrixColumn], checks: Sequence[Check], *, command: str, when: datetime) -> str:
    """Return the self-contained page of a matrix.

    Args:
        columns: Engines and configurations, with the results of their checks.
        checks: The checks, one row each.
        command: Command that wrote the page.
        when: Time of the run.
    """
    ran = [column for column in columns if column.findings]
    title = "Conformance of physics engines"
    spent_s = sum(column.cpu_s or 0.0 for column in ran)
    parts = [
        f"<h1>{title}</h1>",
        '<p class="lead">One row per phenomenon: a small scene with a closed form. One column per engine and solver or '
        "preset. A cell has the measured value, its relative error, or its error in tolerances where 0 is expected, "
        "and the CPU time. The tolerance is the same for every engine. What an engine declines is no failure. "
        "&#9888; marks a column of another version of gauge-envs, and a result of a check that was another one then; "
        "such a result is not counted.</p>",
        _matrix(ran, checks),
        _left_out([column for column in columns if column.reason]),
        "<h2>Checks</h2>",
        *(_section(check, ran) for check in checks),
        "<h2>Configurations</h2>",
        _configurations(ran),
        "<h2>Provenance</h2>",
        f"<p>{escape(when.isoformat(timespec='minutes'))}, {spent_s:.0f} s of CPU time in the checks, "
        f"{escape(pairs_text(versions()))}. Written by</p><p><code>{escape(command)}</code></p>",
    ]
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><style>{STYLE}{MATRIX_STYLE}</style>'
        f"</head>\n<body>{chr(10).join(part for part in parts if part)}</body></html>\n"
    )


def _matrix(columns: Sequence[MatrixColumn], checks: Sequence[Check]) -> str:
    head = "".join(f"<th>{escape(column.backend)}<br>{escape(column.name)}{_tally(column)}</th>" for column in columns)
    rows = "".join(_row(check, columns) for check in checks)
    return (
        f'<div class="scroll"><table class="matrix"><thead><tr><th>phenomenon</th>{head}</tr></thead>'
        f"<tbody>{rows}</tbody></table></div>"
    )


def _tally(column: MatrixColumn) -> str:
    """Return how many of the checks that were not declined passed, and the version where it is another one."""
    old = "" if column.is_of_this_version else f"<small>&#9888; gauge-envs {escape(column.gauge_envs)}</small>"
    return f"<small>{tally(column)}</small>{old}"


def _row(check: Check, columns: Sequence[MatrixColumn]) -> str:
    findings = [column.current().get(check.id) for column in columns]
    name = f'<a href="#{escape(check.id)}">{escape(check.title)}</a><small>{escape(expected_text(findings))}</small>'
    return f"<tr><td>{name}</td>{''.join(_cell(column, check.id) for column in columns)}</tr>"


def _cell(column: MatrixColumn, check: str) -> str:
    finding = column.findings.get(check)
    if finding is None:
        reason = column.refused.get(check, column.reason)
        word = "refused" if check in column.refused else "not run"
        return f'<td title="{escape(reason)}"><span class="badge declined">&ndash; {word}</span></td>'
    if check in column.outdated:
        reason = f"{column.outdated[check]}; its result was {finding.status.value} {measured_text(finding)}".rstrip()
        return f'<td title="{escape(reason)}"><span class="badge declined">&#9888; other check</span></td>'
    hint = "; ".join(finding.missing) or finding.diagnosis
    title = f' title="{escape(hint)}"' if hint else ""
    cost = "" if finding.status is Status.DECLINED else cost_text(finding)
    texts = (measured_text(finding), error_text(finding), cost)
    small = "".join(f"<small>{escape(text)}</small>" for text in texts if text)
    return f"<td{title}>{_badge(finding.status)}{small}</td>"


def _badge(status: Status) -> str:
    return f'<span class="badge {CLASSES[status]}">{WORDS[status]}</span>'


def _section(check: Check, columns: Sequence[MatrixColumn]) -> str:
    """Return the description of a check, and its results with the commands that repeat them."""
    facts = {"scene": check.scene, "measures": check.measures, "law": check.law, "source": check.source}
    facts["tolerance"] = check.tolerance.rationale
    described = "".join(f"<li>{name}: {escape(text)}</li>" for name, text in facts.items())
    found = [(column, column.findings[check.id]) for column in columns if check.id in column.findings]
    rows = "".join(_result(column, finding) for column, finding in found)
    rows += "".join(
        f"<tr><td>{escape(column.title)}</td><td>refused</td></tr>"
        f'<tr class="more"><td colspan="6">{escape(column.refused[check.id])}</td></tr>'
        for column in columns
        if check.id in column.refused
    )
    return (
        f'<section id="{escape(check.id)}"><h3>{escape(check.title)} <code>{escape(check.id)}</code></h3>'
        f"<ul>{described}</ul><details><summary>{len(found)} results with their commands</summary>"
        '<table class="stack wide"><thead><tr><th>engine</th><th>outcome</th><th>measured</th><th>expected</th>'
        f"<th>error</th><th>command</th></tr></thead><tbody>{rows}</tbody></table></details></section>"
    )


def _result(column: MatrixColumn, finding: CheckResult) -> str:
    note = column.outdated.get(finding.check) or "; ".join(finding.missing) or finding.diagnosis
    texts = {
        "measured": measured_text(finding),
        "expected": expected_text([finding]),
        "error": error_text(finding),
    }
    cells = "".join(f'<td data-label="{label}">{escape(text)}</td>' for label, text in texts.items())
    more = f'<tr class="more"><td colspan="6">{escape(note)}</td></tr>' if note else ""
    command = f"<td><code>{escape(column.command(finding.check))}</code></td>"
    return f"<tr><td>{escape(column.title)}</td><td>{_badge(finding.status)}</td>{cells}{command}</tr>{more}"


def _left_out(columns: Sequence[MatrixColumn]) -> str:
    lines = [f"<li>{escape(column.title)}: {escape(column.reason)}</li>" for column in columns]
    return f"<h2>Not run, or not to the end</h2><ul>{''.join(lines)}</ul>" if lines else ""


def _configurations(columns: Sequence[MatrixColumn]) -> str:
    rows = "".join(
        f"<tr><td>{escape(column.title)}</td>"
        f'<td data-label="settings">{escape(pairs_text(column.settings) or "the presets of the engine")}</td>'
        f'<td data-label="versions">{escape(pairs_text(column.versions))}</td>'
        f'<td data-label="run">{escape(_origin(column))}</td></tr>'
        for column in columns
    )
    head = "<tr><th>engine</th><th>settings</th><th>versions</th><th>run</th></tr>"
    return f'<table class="stack wide"><thead>{head}</thead><tbody>{rows}</tbody></table>'


def _origin(column: MatrixColumn) -> str:
    """Return when and with which version a column ran, and which of its results are not counted."""
    text = f"{column.made}, gauge-envs {column.gauge_envs}"
    reasons = [f"{name}: {reason}" for name, reason in column.outdated.items()]
    return "; ".join([text, *reasons])
