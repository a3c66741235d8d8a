"""Print a sanity check on one screen, its details, and the table of all checks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from gauge_envs.backends.mujoco.contact_table import default_contact_settings
from gauge_envs.names import first_names
from gauge_envs.pages.document import Document, Heading, Paragraph, Part, Tone
from gauge_envs.pages.table import Column, Facts, Place, Table
from gauge_envs.pages.text import counted, quantity_text, with_unit
from gauge_envs.tools.sanity.model_checks import TARGET_CHECKS
from gauge_envs.tools.sanity.object_checks import object_check
from gauge_envs.tools.sanity.readers.dialect import toml_text
from gauge_envs.tools.sanity.selection import chooses_deformables, selection
from gauge_envs.tools.sanity.training import TrainingConfiguration
from gauge_envs.tools.sanity.verdict import (
    Reality,
    Report,
    SanityResult,
    SanityVerdict,
    flags_text,
)

MAX_TARGET_FLAGS, MAX_OBJECT_FLAGS = 3, 4
"""Largest numbers of problems of the target itself and of measured objects that the screen shows.

A problem is a failed check or a warning. Of more problems, the screen shows one fewer and names the rest.
A report then has at most 25 lines of 100 characters.
"""

SAME_SPEED = 0.25
"""Relative change of the speed that a short measurement does not resolve."""

MAX_DIFF_LINES = 6
"""Largest number of lines of a change that the screen shows."""

MAX_NAMES = 3
"""Largest number of names in a sentence."""

GUIDE = "docs/sanity.md"
"""Page that explains the checks."""

STYLES = {
    SanityVerdict.PASSED: "green",
    SanityVerdict.WARNING: "yellow",
    SanityVerdict.FAILED: "bold red",
    SanityVerdict.NOT_MEASURED: "dim",
}

DEFAULT_OPTIONS = {
    "cone": "pyramidal",
    "impratio": 1.0,
    "solver": "Newton",
    "iterations": 100,
    "ls_iterations": 50,
    "noslip_iterations": 0,
    "timestep_s": 0.002,
}
"""Options of MuJoCo that decide contacts, at their defaults."""


def sanity_document(
    report: Report, *, details: bool = False, is_all: bool = False
) -> Document:
    """Return a sanity check: one screen with the problems, or more.

    Its JSON rows are the configuration with the worst verdict, then each check.

    Args:
        report: The report.
        details: Whether to show what was read, the sources of reality and the changes that were tried.
        is_all: Whether to show the table of all checks.
    """
    whole = report.to_dict()
    results = whole.pop("checks")
    parts = [
        Paragraph(answer_text(report), Tone.ANSWER),
        *_target_flags(report),
        *_object_flags(report),
        *_change(report, details=details),
        *_notes(report, details=details),
    ]
    table = _all_rows(report)
    if is_all:
        parts.append(table)
    if details:
        parts += _details(report)
    markdown = (Paragraph(answer_text(report), Tone.ANSWER), table)
    return Document(parts=parts, rows=[whole, *results], markdown=markdown)


def answer_text(report: Report) -> str:
    """Return how many checks failed, warn, passed, and were not measured."""
    verdicts = [result.verdict for result in report.flags.values()]
    measured = report.counts["measured"]
    if not measured:
        reasons = dict.fromkeys(
            result.remark for result in report.checks if result.remark
        )
        text = f"nothing was measured: {'; '.join([*reasons][:MAX_NAMES])}"
        return f"{report.configuration.name}: {text}"
    texts = [
        f"{counted(verdicts.count(SanityVerdict.FAILED), 'check')} failed",
        counted(verdicts.count(SanityVerdict.WARNING), "warning"),
        f"{measured - len(verdicts)} passed",
    ]
    missing = report.unmeasured
    if missing:
        texts.append(f"{len(missing)} not measured")
    return f"{report.configuration.name}: {', '.join(texts)}"


def checks_table(only: Sequence[str] = ()) -> Table:
    """Return checks by patterns: ids, titles, kinds and reality; those of deformable bodies by their own patterns."""
    chosen = selection(only, include_deformables=chooses_deformables(only))
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


# --- flags -----------------------------------------------------------------------------------------------------------


def _sorted_flags(report: Report, *, is_on_target: bool) -> list[SanityResult]:
    """Return the problems of the target itself or of measured objects, failed checks first."""
    flags = [
        result
        for result in report.flags.values()
        if result.is_on_target == is_on_target
    ]
    return sorted(flags, key=lambda result: result.verdict is not SanityVerdict.FAILED)


def _target_flags(report: Report) -> list[Part]:
    """Return three lines for each problem of the target itself: its title, its numbers, its place with the fix."""
    flags = _sorted_flags(report, is_on_target=True)
    lines: list[Part] = []
    shown, more = _shown(flags, MAX_TARGET_FLAGS)
    for result in shown:
        limit = reality_text(result.reality, result.unit)
        style = Tone.ERROR if result.verdict is SanityVerdict.FAILED else Tone.WARNING
        numbers = f"{measured_text(result)}, {limit}"
        texts = [": ".join(filter(None, (numbers, result.remark)))]
        texts += filter(None, [_place_text(report, result)])
        lines.append(
            Paragraph(f"{result.verdict}: {result.title} ({result.id})", style)
        )
        lines += [Paragraph(f"  {text}") for text in texts]
    return lines + more


def _shown(
    flags: Sequence[SanityResult], maximum: int
) -> tuple[Sequence[SanityResult], list[Part]]:
    """Return the problems that the screen shows, and a line that names the rest."""
    count = maximum if len(flags) <= maximum else maximum - 1
    left = [result.id for result in flags[count:]]
    if not left:
        return flags, []
    text = f"and {len(left)} more: {first_names(left, MAX_NAMES)}"
    return flags[:count], [Paragraph(text)]


def _place_text(report: Report, result: SanityResult) -> str:
    """Return the place of a problem, and the part of the fix that resolves it, or what the problem means."""
    texts = [f"at {result.place}"] if result.place else []
    if report.fix is not None and result.id in report.fix.fixed:
        parts = [part.text for part in report.fix.parts if result.id in part.corrects]
        texts.append(f"fix: {parts[0] if parts else 'all lines below together'}")
    elif result.consequence:
        texts.append(result.consequence)
    return "; ".join(texts)


def _object_flags(report: Report) -> list[Part]:
    """Return a line for each problem of measured objects; a single line for MuJoCo's default contact."""
    flags = _sorted_flags(report, is_on_target=False)
    if not flags:
        return []
    if _has_default_contact(report.configuration):
        worst = flags[0]
        text = (
            f"{worst.verdict}: MuJoCo's default contact, as the file sets no solref, solimp, cone. Measured objects: "
            f"{len(flags)} {flags_text(flags)}, such as {worst.id} with "
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
    """Return whether all checked contacts have MuJoCo's default constants and options."""
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
    """Return the best fix as a diff, with what each part resolves alone."""
    change = report.fix
    if change is None:
        return [Paragraph(report.trade)] if report.trade else []
    text = f"Best fix: resolves {len(change.fixed)} of {len(report.flags)} "
    text += flags_text([*report.flags.values()])
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
    if hidden_count := len(diff[count:]):
        lines.append(Paragraph(f"  and {hidden_count} more lines, which --fix writes"))
    alone = [
        f"{part.text} resolves {first_names(part.corrects, MAX_NAMES)}"
        for part in change.parts
        if part.corrects
    ]
    if len(change.parts) > 1 and alone:
        lines.append(Paragraph(f"  alone: {'; '.join(alone)}", Tone.NOTE))
    return lines


# --- notes and details -----------------------------------------------------------------------------------------------


def _notes(report: Report, *, details: bool) -> list[Part]:
    """Return what the reader might miss, what the model leaves open, and where to read on."""
    configuration = report.configuration
    texts = [f"MuJoCo warns: {text}" for text in configuration.warnings]
    if details:
        texts += configuration.notes
    texts += report.notes
    lines: list[Part] = [Paragraph(f"note: {text}", Tone.WARNING) for text in texts]
    if missing := report.unmeasured:
        reasons = {result.id: result.remark for result in report.checks}
        text = f"{missing[0]}: {reasons[missing[0]]}"
        names = first_names(missing, MAX_NAMES)
        lines.append(Paragraph(f"Not measured: {names} ({text})", Tone.WARNING))
    if report.unstated:
        lines.append(Paragraph(report.unstated, Tone.NOTE))
    if report.flags and not details:
        lines.append(
            Paragraph(
                f"--all and --details show more; {GUIDE} explains the checks", Tone.NOTE
            )
        )
    return lines


def _details(report: Report) -> list[Part]:
    """Return what was read, the sources of the problems, and the changes that were tried."""
    checked = report.configuration
    parts: list[Part] = [Heading("Read"), Facts(_facts(checked))]
    for result in report.flags.values():
        reality = result.reality
        text = f"{result.id}: {result.title}; {reality.source}; {reality.rationale}"
        parts.append(Paragraph(text, Tone.NOTE))
    parts += [Paragraph(f"tried {text}", Tone.NOTE) for text in report.tried]
    reasons: dict[str, list[str]] = {}
    for result in report.checks:
        if not result.applies:
            reasons.setdefault(result.remark, []).append(result.id)
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
        text = f"{name} = {toml_text(value)}"
        facts[origin] = f"{facts[origin]}, {text}" if origin in facts else text
    for group in checked.contact_groups:
        constants = [
            f"{name} {toml_text(value)}" for name, value in group.constants.items()
        ]
        use = "" if group.is_used else "not used: "
        pairs = counted(group.pair_count, "pair")
        facts[group.geoms] = f"{use}{pairs}, {', '.join(constants)}"
    return facts


def _all_rows(report: Report) -> Table:
    """Return the table of all checks that apply."""
    remark = Column("", "remark", _remark_text, place=Place.BELOW, wide_only=True)
    rows = [result for result in report.checks if result.applies]
    return Table(columns=(*COLUMNS, VERDICT, remark), rows=rows)


def _style(result: SanityResult) -> str:
    return "" if result.advisory else STYLES[result.verdict]


def reality_text(reality: Reality, unit: str) -> str:
    """Return `centre +- half-width unit` of the interval of reality, or its limits."""
    interval = f"{quantity_text(reality.value)} +- {quantity_text(reality.tolerance)}"
    return with_unit(reality.limits or interval, unit)


def measured_text(result: SanityResult) -> str:
    """Return the measured value; what it is instead where there is none."""
    if result.configured is not None:
        return quantity_text(result.configured)
    return "no value" if result.verdict.is_off else "-"


def verdict_text(result: SanityResult) -> str:
    """Return the verdict; `advice` for a check that does not count."""
    return (
        "advice" if result.advisory and result.verdict.is_off else result.verdict.value
    )


def _remark_text(result: SanityResult) -> str:
    """Return the place, the remark and why the verdict does not count."""
    advice = result.advisory if result.verdict.is_off else ""
    return "; ".join(
        filter(None, (result.geoms or result.place, result.remark, advice))
    )


VERDICT = Column("", "", verdict_text, style=_style)

COLUMNS = (
    Column("id", "check"),
    Column("title", "quantity", wide_only=True),
    Column("", "real", lambda result: reality_text(result.reality, result.unit)),
    Column("", "here", measured_text, is_number=True, style=_style),
    Column("default", "preset", quantity_text, is_number=True),
)
"""Columns of tables of checks."""
