"""Print a sanity check on one screen, its details, and the table of all checks."""

from collections import Counter
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import Any

from rich.console import Console

from gauge_envs.names import first_names
from gauge_envs.pages.document import Document, Paragraph, Part, Tone
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.terminal import Terminal
from gauge_envs.pages.text import counted, quantity_text, with_unit
from gauge_envs.tools.sanity.causes import causes_first
from gauge_envs.tools.sanity.object_checks import object_check
from gauge_envs.tools.sanity.target_checks import READ, RUN, TARGET_CHECKS, selection
from gauge_envs.tools.sanity.verdict import (
    Reality,
    Report,
    SanityResult,
    SanityVerdict,
    Severity,
)

MAX_OBJECT_FLAGS = 3
"""Largest number of measured objects that the screen shows."""

SAME_SPEED = 0.25
"""Relative change of the speed that a short measurement does not resolve."""

MAX_DIFF_LINES = 6
"""Largest number of lines of a change that the screen shows."""

MAX_NAMES = 3
"""Largest number of names in a sentence."""

GUIDE = "docs/sanity.md"
"""Page that explains the checks."""

TONES = {Severity.ERROR: Tone.ERROR, Severity.WARNING: Tone.WARNING}

STYLES = {
    Severity.NONE: "green",
    Severity.ADVICE: "dim",
    Severity.WARNING: "yellow",
    Severity.ERROR: "bold red",
}

READ_TEXT = "Read: numbers of the model against each other"
RUN_TEXT = "Run: the model from its keyframe, without actions"
ADVICE_TEXT = "Advice: unusual numbers, and motions that only the check makes"
OBJECTS_TEXT = "Contacts: measured objects with these settings"
"""Headings of the stages."""


def sanity_document(report: Report, *, is_all: bool = False) -> Document:
    """Return a sanity check: one screen with the problems, or more.

    Its JSON rows are the configuration with the worst verdict, then each check.

    Args:
        report: The report.
        is_all: Whether to show all checks and lines, and the sources of reality.
    """
    whole = report.to_dict()
    results = whole.pop("checks")
    parts = [
        Paragraph(answer_text(report), Tone.ANSWER),
        *_findings(report),
        *_object_findings(report),
        *_change(report, is_all=is_all),
        *_notes(report, is_all=is_all),
    ]
    table = _all_rows(report)
    if is_all:
        parts.append(table)
        parts += [
            Paragraph(
                f"{result.id}: {result.title}; {result.reality.source}", Tone.NOTE
            )
            for result in report.flags.values()
        ]
    markdown = (Paragraph(answer_text(report), Tone.ANSWER), table)
    return Document(parts=parts, rows=[whole, *results], markdown=markdown)


def screen_text(report: Report) -> str:
    """Return the screen of a sanity check as plain text."""
    console = Console(width=100, file=StringIO())
    with console.capture() as capture:
        console.print(Terminal(sanity_document(report)))
    return f"\n{capture.get()}"


def answer_text(report: Report) -> str:
    """Return the numbers of errors, warnings, pieces of advice, passed checks, and checks that were not measured."""
    name, measured = report.configuration.name, report.counts["measured"]
    if not measured:
        reasons = dict.fromkeys(
            result.remark for result in report.checks if result.remark
        )
        return f"{name}: nothing was measured: {'; '.join([*reasons][:MAX_NAMES])}"
    counts = Counter(result.severity for result in report.flags.values())
    passed = [check.verdict for check in report.checks].count(SanityVerdict.PASSED)
    accepted = sum(bool(check.accepted) for check in report.checks)
    missing = len(report.unmeasured)
    texts = {
        counted(counts[Severity.ERROR], "error"): counts[Severity.ERROR],
        counted(counts[Severity.WARNING], "warning"): counts[Severity.WARNING],
        f"{counts[Severity.ADVICE]} advice": counts[Severity.ADVICE],
        f"{accepted} accepted": accepted,
        f"{counted(passed, 'check')} passed": True,
        f"{missing} not measured": missing,
    }
    return f"{name}: {', '.join(text for text, count in texts.items() if count)}"


def workflow_commands(report: Report) -> list[str]:
    """Return a workflow command of GitHub for each error and warning, with its file and line."""
    # The command begins an escape with a per cent sign.
    return [
        f"::{result.severity} file={result.file},line={result.line},title={result.id}::"
        + finding_text(result).replace("%", "%25")
        for result in report.checks
        if result.severity in TONES
    ]


def checks_table(only: Sequence[str] = ()) -> Table:
    """Return checks by patterns: ids, titles, kinds and reality."""
    chosen = selection(only or ["*"])
    return Table(
        columns=(
            Column("id", "id"),
            Column("title", "title", place=Place.BELOW),
            Column("kind", "kind"),
            Column("reality", "expected"),
            Column("trial_count", "trials", is_number=True, wide_only=True),
            Column("source", "source", place=Place.BELOW, wide_only=True),
            Column("rationale", "interval", place=Place.BELOW, wide_only=True),
        ),
        rows=[_check_line(name) for name in chosen],
    )


def _check_line(name: str) -> dict[str, Any]:
    """Return the row of a check in the list of checks."""
    check = TARGET_CHECKS[name] if name in TARGET_CHECKS else object_check(name)
    reality = check.reality
    return {
        "id": name,
        "title": check.title,
        "kind": reality.kind.value,
        "reality": reality_text(reality, check.unit),
        "trial_count": reality.trial_count,
        "source": reality.source,
        "rationale": reality.rationale,
    }


# --- findings --------------------------------------------------------------------------------------------------------


def finding_text(result: SanityResult) -> str:
    """Return what is wrong as a sentence, with its numbers."""
    if result.remark:
        return result.remark
    limit = reality_text(result.reality, result.unit)
    return f"{result.title}: {measured_text(result)}, {limit}"


def _findings(report: Report) -> list[Part]:
    """Return a line for each finding of the target itself: errors, warnings by stages, then advice."""
    parts: list[Part] = []
    read, run = ({check.id for check in checks} for checks in (READ, RUN))
    stage_of = dict.fromkeys(read, READ_TEXT) | dict.fromkeys(run, RUN_TEXT)
    flags = [result for result in report.flags.values() if result.is_on_target]
    shown = ""
    for result in causes_first(flags):
        heading = stage_of.get(result.id, "")
        if result.severity is Severity.ADVICE:
            heading = ADVICE_TEXT
        if heading and heading != shown:
            parts.append(Paragraph(heading, Tone.NOTE))
        shown = heading
        place = f" ({Path(result.file).name}:{result.line})" if result.file else ""
        text = f"{result.severity:8} {finding_text(result)}{place}"
        parts.append(Paragraph(text, TONES.get(result.severity, Tone.PLAIN)))
        texts = {"also": "; ".join(result.effects), "fix": result.fix}
        parts += [
            Paragraph(f"         {word}: {text}")
            for word, text in texts.items()
            if text
        ]
    return parts


def _object_findings(report: Report) -> list[Part]:
    """Return a line for each measured object that moves otherwise."""
    flags = [flag for flag in report.flags.values() if not flag.is_on_target]
    flags.sort(key=lambda result: -result.deviation)
    if not flags:
        return []
    shown, left = flags[:MAX_OBJECT_FLAGS], flags[MAX_OBJECT_FLAGS:]
    parts: list[Part] = [Table(title=OBJECTS_TEXT, columns=COLUMNS, rows=shown)]
    if left:
        names = first_names([result.id for result in left], MAX_NAMES)
        parts.append(Paragraph(f"and {len(left)} more: {names}"))
    return parts


def _change(report: Report, *, is_all: bool) -> list[Part]:
    """Return the best fix as a diff, with what each part resolves alone."""
    change = report.fix
    if change is None:
        return [Paragraph(report.trade)] if report.trade else []
    text = f"Best fix: resolves {len(change.fixed)} of {counted(len(report.flags), 'finding')}"
    if change.speed_ratio is not None:
        ratio = change.speed_ratio
        is_same = abs(ratio - 1.0) < SAME_SPEED
        percent = (
            f"{100.0 * abs(ratio - 1.0):.0f} % {'slower' if ratio < 1.0 else 'faster'}"
        )
        text += f"; {'as fast' if is_same else percent}"
    diff = change.lines or (change.line,)
    count = len(diff) if is_all else MAX_DIFF_LINES
    lines: list[Part] = [
        Paragraph(text, Tone.ANSWER),
        *(Paragraph(f"  {line}") for line in diff[:count]),
    ]
    if hidden_count := len(diff[count:]):
        lines.append(Paragraph(f"  and {hidden_count} more lines, which --fix writes"))
    return lines


# --- notes and details -----------------------------------------------------------------------------------------------


def _notes(report: Report, *, is_all: bool) -> list[Part]:
    """Return what the reader might miss, what the model leaves open, and where to read on."""
    configuration = report.configuration
    texts = [f"MuJoCo warns: {text}" for text in configuration.warnings]
    texts += report.notes
    if is_all:
        texts += configuration.notes
    lines: list[Part] = [Paragraph(f"note: {text}", Tone.WARNING) for text in texts]
    if missing := report.unmeasured:
        reasons = {result.id: result.remark for result in report.checks}
        text = f"{missing[0]}: {reasons[missing[0]]}"
        names = first_names(missing, MAX_NAMES)
        lines.append(Paragraph(f"Not measured: {names} ({text})", Tone.WARNING))
    lines += [
        Paragraph(f"accepted {result.id}: {result.accepted}", Tone.NOTE)
        for result in report.checks
        if result.accepted
    ]
    if report.flags and not is_all:
        lines.append(
            Paragraph(f"--all shows more; {GUIDE} explains the checks", Tone.NOTE)
        )
    return lines


def _all_rows(report: Report) -> Table:
    """Return the table of all checks that apply."""
    remark = Column(
        "",
        "remark",
        lambda result: "; ".join(
            filter(None, (result.geoms or result.place, result.remark))
        ),
        place=Place.BELOW,
        wide_only=True,
    )
    rows = [result for result in report.checks if result.applies]
    return Table(columns=(*COLUMNS, remark), rows=rows)


def _style(result: SanityResult) -> str:
    return STYLES[result.severity]


def reality_text(reality: Reality, unit: str) -> str:
    """Return `centre +- half-width unit` of the interval of reality, or its limits."""
    interval = f"{quantity_text(reality.value)} +- {quantity_text(reality.tolerance)}"
    return with_unit(reality.limits or interval, unit)


def measured_text(result: SanityResult) -> str:
    """Return the measured value, or a dash."""
    return "-" if result.configured is None else quantity_text(result.configured)


COLUMNS = (
    Column("id", "check"),
    Column("title", "quantity"),
    Column("", "here", measured_text, is_number=True, style=_style),
    Column("", "expected", lambda result: reality_text(result.reality, result.unit)),
    Column(
        "",
        "",
        lambda result: (
            "accepted" if result.accepted else result.severity or result.verdict.value
        ),
        style=_style,
    ),
)
"""Columns of tables of checks."""
