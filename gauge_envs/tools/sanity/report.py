"""Print a sanity check on one screen, its details, and the table of rows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from gauge_envs.errors import first_names
from gauge_envs.pages.document import Document, Heading, Paragraph, Part, Tone
from gauge_envs.pages.table import Column, Facts, Place, Table
from gauge_envs.pages.text import counted, quantity_text, vector_text, with_unit
from gauge_envs.tools.bench.model_settings import default_contact_settings
from gauge_envs.tools.sanity.model import (
    WARNED,
    PhenomenonResult,
    Reality,
    Report,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.tools.sanity.own_rows import ROWS
from gauge_envs.tools.sanity.phenomena import phenomena
from gauge_envs.tools.sanity.selection import selection
from gauge_envs.tools.sanity.target_checks import STATED_ROWS

MAX_OWN_FLAGS, MAX_OBJECT_FLAGS = 3, 4
"""Largest numbers of flags on the target itself and on measured objects that the screen shows; of more, it shows a flag
less and names the others. With these numbers a report has at most 25 lines of 100 characters."""

SAME_SPEED = 0.25
"""Change of the number of steps a second that a short measurement does not resolve."""

MAX_DIFF_LINES = 6
"""Largest number of lines of a change that the screen shows."""

MAX_NAMES = 3
"""Largest number of names in a sentence."""

GUIDE = "docs/sanity.md"
"""Page that explains the rows."""

STYLES = {
    Verdict.INSIDE: "green",
    Verdict.VISIBLE: "yellow",
    Verdict.WRONG: "bold red",
    Verdict.DECLINED: "dim",
}

LABELS = {
    Verdict.WRONG: "to mend",
    Verdict.VISIBLE: "to look at",
    Verdict.INSIDE: "fine",
    Verdict.DECLINED: "not measured",
}
"""Verdicts in the words of the screen."""

DEFAULT_OPTIONS = {
    "cone": "pyramidal",
    "impratio": 1.0,
    "solver": "Newton",
    "iterations": 100,
    "ls_iterations": 50,
    "noslip_iterations": 0,
    "timestep_s": 0.002,
}
"""Options of MuJoCo's that decide contacts, at their defaults."""


def sanity_document(
    report: Report, *, details: bool = False, every: bool = False
) -> Document:
    """Return a sanity check: one screen with the flags, or more.

    Its JSON rows are the configuration with the worst verdict, then each row.

    Args:
        report: The report.
        details: Whether to show what was read, the sources of reality and the changes that were tried.
        every: Whether to show the table of all rows.
    """
    whole = report.to_dict()
    rows = whole.pop("rows")
    parts = [
        Paragraph(answer_text(report), Tone.ANSWER),
        *_own_flags(report),
        *_object_flags(report),
        *_change(report, details=details),
        *_notes(report, details=details),
    ]
    table = _all_rows(report)
    if every:
        parts.append(table)
    if details:
        parts += _details(report)
    markdown = (Paragraph(answer_text(report), Tone.ANSWER), table)
    return Document(parts=parts, rows=[whole, *rows], markdown=markdown)


def answer_text(report: Report) -> str:
    """Return how many rows are to mend, to look at, fine, and not measured."""
    verdicts = [row.verdict for row in report.flags.values()]
    fine = sum(
        row.verdict is not Verdict.DECLINED and not row.is_flag for row in report.rows
    )
    if not report.counts["measured"]:
        reasons = dict.fromkeys(row.remark for row in report.rows if row.remark)
        text = f"nothing was measured: {'; '.join([*reasons][:MAX_NAMES])}"
        return f"{report.configuration.name}: {text}"
    texts = [
        f"{verdicts.count(Verdict.WRONG)} to mend",
        f"{verdicts.count(Verdict.VISIBLE)} to look at",
        f"{fine} fine",
    ]
    missing = report.unmeasured
    if missing:
        texts.append(f"{len(missing)} not measured")
    return f"{report.configuration.name}: {', '.join(texts)}"


def phenomena_table(
    *, include_deformables: bool = False, only: Sequence[str] = ()
) -> Table:
    """Return the rows that a sanity check can have: ids, titles, kinds and reality."""
    chosen = selection(only, include_deformables=include_deformables)
    known = [(row.phenomenon, row.title, row.reality, row.unit) for row in STATED_ROWS]
    known += [(row.id, row.title, row.reality, row.unit) for row in ROWS.values()]
    known += [
        (row.id, row.title, row.reality, row.unit)
        for row in phenomena(include_deformables=True)
    ]
    return Table(
        columns=(
            Column("id", "id"),
            Column("title", "title", place=Place.BELOW),
            Column("kind", "kind"),
            Column("reality", "reality"),
            Column("trial_count", "trials", is_number=True, wide_only=True),
            Column("source", "source", place=Place.BELOW, wide_only=True),
            Column("rationale", "interval", place=Place.BELOW, wide_only=True),
        ),
        rows=[
            {
                "id": name,
                "title": title,
                "kind": reality.kind.value,
                "reality": reality_text(reality, unit),
                "trial_count": reality.trial_count,
                "source": reality.source,
                "rationale": reality.rationale,
            }
            for name, title, reality, unit in known
            if name in chosen
        ],
    )


# --- flags -----------------------------------------------------------------------------------------------------------


def _sorted_flags(report: Report, *, is_own: bool) -> list[PhenomenonResult]:
    """Return the flagged rows on the target itself or on measured objects, those to mend first."""
    flags = [row for row in report.flags.values() if row.is_own == is_own]
    return sorted(flags, key=lambda row: row.verdict is not Verdict.WRONG)


def _own_flags(report: Report) -> list[Part]:
    """Return three lines for each flag on the target itself: what it is, its numbers, its place and the change."""
    flags = _sorted_flags(report, is_own=True)
    lines: list[Part] = []
    shown, more = _shown(flags, MAX_OWN_FLAGS)
    for row in shown:
        limit = reality_text(row.reality, row.unit)
        style = Tone.ERROR if row.verdict is Verdict.WRONG else Tone.WARNING
        numbers = f"{measured_text(row)}, {limit}"
        texts = [": ".join(filter(None, (numbers, row.remark)))]
        texts += filter(None, [_place_text(report, row)])
        lines.append(
            Paragraph(f"{LABELS[row.verdict]}: {row.title} ({row.phenomenon})", style)
        )
        lines += [Paragraph(f"  {text}") for text in texts]
    return lines + more


def _shown(
    flags: Sequence[PhenomenonResult], largest: int
) -> tuple[Sequence[PhenomenonResult], list[Part]]:
    """Return the flags that the screen shows, and a line that names the others."""
    count = largest if len(flags) <= largest else largest - 1
    left = [row.phenomenon for row in flags[count:]]
    if not left:
        return flags, []
    text = f"and {len(left)} more: {first_names(left, MAX_NAMES)}"
    return flags[:count], [Paragraph(text)]


def _place_text(report: Report, row: PhenomenonResult) -> str:
    """Return where a row is off, and which part of the change corrects it, or what the flag means."""
    texts = [f"at {row.place}"] if row.place else []
    if report.cure is not None and row.phenomenon in report.cure.mended:
        parts = [
            part.text for part in report.cure.parts if row.phenomenon in part.corrects
        ]
        texts.append(f"change: {parts[0] if parts else 'all lines below together'}")
    elif row.consequence:
        texts.append(row.consequence)
    return "; ".join(texts)


def _object_flags(report: Report) -> list[Part]:
    """Return a line for each flag on measured objects; one line in all for MuJoCo's default contact."""
    flags = _sorted_flags(report, is_own=False)
    if not flags:
        return []
    if _has_default_contact(report.configuration):
        worst = flags[0]
        text = (
            f"{LABELS[worst.verdict]}: MuJoCo's default contact, as in any file that gives no solref, solimp and cone: "
            f"{counted(len(flags), 'row')} on measured objects, as {worst.phenomenon} with "
            f"{with_unit(measured_text(worst), worst.unit)}, real {reality_text(worst.reality, worst.unit)}"
        )
        return [Paragraph(text, Tone.WARNING)]
    heading = "Measured objects with these settings"
    set_count = len(report.configuration.contact_sets)
    if set_count > 1:
        heading += f", worst of {set_count} sets of contact constants"
    shown, more = _shown(flags, MAX_OBJECT_FLAGS)
    table = Table(title=heading, columns=(*COLUMNS, VERDICT), rows=shown)
    return [table, *more]


def _has_default_contact(checked: TrainingConfiguration) -> bool:
    """Return whether all contacts that are judged have MuJoCo's default constants and options."""
    if not checked.is_model:
        return False
    constants = default_contact_settings()
    default = DEFAULT_OPTIONS | {
        name: constants[name] for name in ("contact_solref", "contact_solimp")
    }
    return all(
        settings.get(name) == value
        for settings in checked.contact_sets.values()
        for name, value in default.items()
    )


def _change(report: Report, *, details: bool) -> list[Part]:
    """Return the change of settings that corrects most, as a diff, and what each part corrects alone."""
    change = report.cure
    if change is None:
        return [Paragraph(report.trade)] if report.trade else []
    text = f"Change: corrects {change.mended_count} of {change.flag_count}"
    if change.speed_ratio is not None:
        ratio = change.speed_ratio
        is_same = abs(ratio - 1.0) < SAME_SPEED
        factor = f"{max(ratio, 1.0 / ratio):.2g} times {'slower' if ratio < 1.0 else 'faster'}"
        text += f"; {'as fast' if is_same else factor}"
    diff = change.lines or (change.line,)
    count = len(diff) if details else MAX_DIFF_LINES
    lines: list[Part] = [
        Paragraph(text, Tone.ANSWER),
        *(Paragraph(f"  {line}") for line in diff[:count]),
    ]
    if left := len(diff[count:]):
        lines.append(Paragraph(f"  and {left} more lines, which --fix writes"))
    alone = [
        f"{part.text} corrects {first_names(part.corrects, MAX_NAMES)}"
        for part in change.parts
        if part.corrects
    ]
    if len(change.parts) > 1 and alone:
        lines.append(Paragraph(f"  alone: {'; '.join(alone)}", Tone.NOTE))
    return lines


# --- notes and details -----------------------------------------------------------------------------------------------


def _notes(report: Report, *, details: bool) -> list[Part]:
    """Return what the reader might miss, what the model leaves open, and where to read on."""
    texts = [
        note
        for note in report.configuration.notes
        if details or note.startswith(WARNED)
    ]
    lines: list[Part] = [
        Paragraph(f"note: {text}", Tone.WARNING) for text in (*texts, *report.notes)
    ]
    if missing := report.unmeasured:
        reasons = {row.phenomenon: row.remark for row in report.rows}
        text = f"{missing[0]}: {reasons[missing[0]]}"
        names = first_names(missing, MAX_NAMES)
        lines.append(Paragraph(f"Not measured: {names} ({text})", Tone.WARNING))
    if report.unstated:
        lines.append(Paragraph(report.unstated, Tone.NOTE))
    if report.flags and not details:
        lines.append(
            Paragraph(f"--all, --details show more; {GUIDE} explains", Tone.NOTE)
        )
    return lines


def _details(report: Report) -> list[Part]:
    """Return what was read, the sources of the flagged rows, and the changes that were tried."""
    checked = report.configuration
    parts: list[Part] = [Heading("Read"), Facts(_facts(checked))]
    for row in report.flags.values():
        reality = row.reality
        text = f"{row.phenomenon}: {row.title}; {reality.source}; {reality.rationale}"
        parts.append(Paragraph(text, Tone.NOTE))
    parts += [Paragraph(f"tried {text}", Tone.NOTE) for text in report.tried]
    reasons: dict[str, list[str]] = {}
    for row in report.rows:
        if not row.applies:
            reasons.setdefault(row.remark, []).append(row.phenomenon)
    parts += [
        Paragraph(f"not applicable, {reason}: {', '.join(names)}", Tone.NOTE)
        for reason, names in reasons.items()
    ]
    return parts


def _facts(checked: TrainingConfiguration) -> dict[str, str]:
    """Return what was read, and the settings by origin."""
    facts = {"read from": checked.source, "backend": checked.backend}
    if checked.frame_skip is not None:
        facts["one action"] = f"{checked.frame_skip} steps"
    if (foot := checked.foot_geometry) is not None:
        facts["foot"] = f"in the {foot.pose}, {foot.description}"
    for name, value in checked.settings.items():
        origin = checked.origins.get(name, "settings")
        text = f"{name} = {setting_text(value)}"
        facts[origin] = f"{facts[origin]}, {text}" if origin in facts else text
    for group in checked.contact_groups:
        constants = [
            f"{name} {setting_text(value)}" for name, value in group.constants.items()
        ]
        use = "" if group.is_used else "not used: "
        pairs = counted(group.pair_count, "pair")
        facts[group.geoms] = f"{use}{pairs}, {', '.join(constants)}"
    return facts


def setting_text(value: Any) -> str:
    """Return a setting as people write it."""
    if value is None:
        return "not set"
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, list | tuple):
        return vector_text(value)
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _all_rows(report: Report) -> Table:
    """Return the table of all rows that apply."""
    remark = Column("", "remark", _remark_text, place=Place.BELOW, wide_only=True)
    rows = [row for row in report.rows if row.applies]
    return Table(columns=(*COLUMNS, VERDICT, remark), rows=rows)


def _style(row: PhenomenonResult) -> str:
    return "" if row.advisory else STYLES[row.verdict]


def reality_text(reality: Reality, unit: str) -> str:
    """Return `centre +- half-width unit` of the interval of reality, or its limits."""
    interval = f"{quantity_text(reality.value)} +- {quantity_text(reality.tolerance)}"
    return with_unit(reality.limits or interval, unit)


def measured_text(row: PhenomenonResult) -> str:
    """Return the measured value of a row; what it is instead where there is none."""
    if row.configured is not None:
        return quantity_text(row.configured)
    return "no value" if row.verdict.is_off else "-"


def preset_text(row: PhenomenonResult) -> str:
    """Return the value with the recommended preset; a dash where it was not measured."""
    return "-" if row.default is None else quantity_text(row.default)


def verdict_text(row: PhenomenonResult) -> str:
    """Return the verdict in the words of the screen; `advice` for a row that does not count."""
    return "advice" if row.advisory and row.verdict.is_off else LABELS[row.verdict]


def _remark_text(row: PhenomenonResult) -> str:
    """Return the place, the remark and why a row does not count."""
    advice = row.advisory if row.verdict.is_off else ""
    return "; ".join(filter(None, (row.geoms or row.place, row.remark, advice)))


VERDICT = Column("", "", verdict_text, style=_style)

COLUMNS = (
    Column("phenomenon", "row"),
    Column("title", "quantity", wide_only=True),
    Column("", "real", lambda row: reality_text(row.reality, row.unit)),
    Column("", "here", measured_text, is_number=True, style=_style),
    Column("", "preset", preset_text, is_number=True),
)
"""Columns of tables of rows."""
