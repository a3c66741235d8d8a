"""Sanity checks in words."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from gauge_envs.errors import first_names
from gauge_envs.pages.document import Document, Heading, Paragraph, Part, Tone
from gauge_envs.pages.table import Column, Facts, Place, Table
from gauge_envs.pages.text import counted, quantity_text, vector_text, with_unit
from gauge_envs.tools.sanity.model import (
    INSIDE_WITHIN,
    PhenomenonResult,
    Reality,
    Report,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.tools.sanity.phenomena import ROBOT_IDS, phenomena, selection
from gauge_envs.tools.sanity.run import Regression
from gauge_envs.tools.sanity.target_checks import TARGET_ROWS, robot_row

VERDICT_NOTES = {
    Verdict.INSIDE: "in the interval: a real trial could have done this, or the law is met within its tolerance",
    Verdict.VISIBLE: "outside, at most 2.5 half-widths from reality: a careful observer sees the difference",
    Verdict.WRONG: "farther away, or of another kind: a body slides that should hold, or the run diverges",
    Verdict.DECLINED: "applies and was not measured, for the reason that stands below the row",
}

ADVISORY_NOTE = (
    "does not count for --fail-on: the target does not state what the row depends on"
)

STYLES = {
    Verdict.INSIDE: "green",
    Verdict.VISIBLE: "yellow",
    Verdict.WRONG: "bold red",
    Verdict.DECLINED: "dim",
}

MOST_NAMED = 2
"""Largest number of changes, or of rows that were not measured, that the first line names."""

REALITY = Column(
    "", "reality", lambda row: reality_text(row.reality, row.unit), is_number=True
)
"""Column of tables of phenomena."""

LEGEND = (
    "Reality: mean of real trials and the interval of 95 % of further trials, or a law and its tolerance (gauge list "
    "phenomena --format wide names the source). Preset: this package's preset for the scene. This: the "
    "checked configuration; after the verdict, its difference from reality."
)


def sanity_document(report: Report) -> Document:
    """Return a sanity check: what was read, the table of phenomena, and the meaning of the verdicts.

    Its rows are the configuration with the worst verdict, then each phenomenon.
    """
    checked, table = report.configuration, _phenomenon_table(report)
    whole = report.to_dict()
    rows = whole.pop("rows")
    answer, tally = Paragraph(top_line(report), Tone.ANSWER), tally_text(report)
    return Document(
        parts=(
            answer,
            Paragraph(""),
            Heading(checked.name),
            Facts(_facts(checked)),
            *([contact_table(checked)] if len(checked.contact_groups) > 1 else []),
            *(Paragraph(f"note: {note}", Tone.WARNING) for note in checked.notes),
            table,
            *inapplicable(report),
            Paragraph(""),
            Paragraph(tally, Tone.ANSWER),
            Paragraph(LEGEND, Tone.NOTE),
            *(
                Paragraph(f"{verdict.value}: {VERDICT_NOTES[verdict]}", Tone.NOTE)
                for verdict in _present(report)
            ),
            *advisory_note(report),
        ),
        rows=[whole, *rows],
        markdown=(
            answer,
            replace(table, title=""),
            *inapplicable(report),
            Paragraph(f"{checked.name}: {tally}"),
        ),
    )


def top_line(report: Report) -> str:
    """Return the change that mends most rows, and what is left; without one, what the check found."""
    flags = report.flags
    if report.cure is not None:
        left = [
            name
            for name, row in flags.items()
            if row.verdict is Verdict.WRONG
            and name.startswith("robot-")
            and name not in report.cure.mended
        ]
        first = f"Wrong in the robot itself: {', '.join(left)}. " if left else ""
        return f"{first}Mends most: {report.cure.line}"
    if flags:
        text = f"{counted(len(flags), 'flag')}: {', '.join(flags)}"
        if report.tried:
            changes = counted(len(report.tried), "change")
            text += f". None of {changes} of settings that were tried corrects one without harm"
        return text
    measured, missing = report.counts["measured"], report.unmeasured
    if not measured:
        reasons = dict.fromkeys(row.remark for row in report.rows if row.remark)
        return "; ".join(("Nothing was measured", *[*reasons][:MOST_NAMED]))
    if missing:
        named = first_names(missing, MOST_NAMED)
        return f"Incomplete: {len(missing)} of {measured + len(missing)} rows were not measured: {named}"
    texts = [f"No flags: {counts_text(report)}", *report.notes]
    off = [row.phenomenon for row in report.rows if row.verdict.is_off]
    if off:
        texts.append(f"advice that does not count: {', '.join(off)}")
    return "; ".join(texts)


def counts_text(report: Report) -> str:
    """Return how many rows were measured, declined and not applicable."""
    first, *others = report.counts.items()
    texts = [f"{count} {name.replace('_', ' ')}" for name, count in others if count]
    return ", ".join([f"{counted(first[1], 'row')} {first[0]}", *texts])


def is_clean(report: Report) -> bool:
    """Return whether all that was asked for was measured, and nothing is flagged."""
    return not report.unmeasured and not report.flags


def phenomena_table(
    *, include_deformables: bool = False, only: Sequence[str] = ()
) -> Table:
    """Return the rows that a sanity check can have: ids, titles, kinds and reality."""
    chosen = selection(only, include_deformables=include_deformables)
    stated = (*TARGET_ROWS, *(robot_row(name, None) for name in ROBOT_IDS))
    known = [(row.phenomenon, row.title, row.reality, row.unit) for row in stated]
    known += [
        (one.id, one.title, one.reality, one.unit)
        for one in phenomena(include_deformables=True)
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


def _facts(checked: TrainingConfiguration) -> dict[str, str]:
    """Return what was read, and the settings by origin, in the order in which they were read."""
    facts = {"read from": checked.source, "backend": checked.backend}
    if checked.frame_skip is not None:
        facts["one action"] = f"{checked.frame_skip} steps"
    if checked.foot_contact is not None:
        facts["foot on ground"] = checked.foot_contact.text
    if (foot := checked.foot_geometry) is not None:
        facts["foot"] = f"{foot.description}, in the {foot.pose}; {foot.assumption}"
    grouped: dict[str, dict[str, Any]] = {}
    for name, value in checked.settings.items():
        grouped.setdefault(checked.origins.get(name, "settings"), {})[name] = value
    for origin, settings in grouped.items():
        facts[origin] = ", ".join(
            f"{name} = {setting_text(value)}" for name, value in settings.items()
        )
    if not checked.settings:
        facts["settings"] = "this package's presets"
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


def contact_table(checked: TrainingConfiguration) -> Table:
    """Return the contact constants of each group of pairs."""
    names = ("condim", "friction", "solref", "solimp", "margin", "gap")
    return Table(
        title="Contacts of the model",
        columns=(
            Column("is_used", "", lambda is_used: "used" if is_used else ""),
            Column("geoms", "geoms", place=Place.HEADING),
            Column("pair_count", "pairs", is_number=True),
            *(
                Column(
                    f"constants.{name}", name, setting_text, wide_only=name in names[4:]
                )
                for name in names
            ),
        ),
        rows=checked.contact_groups,
    )


def _phenomenon_table(report: Report) -> Table:
    return Table(
        title="Phenomena",
        columns=(
            Column("phenomenon", "id"),
            Column("title", "phenomenon", wide_only=True),
            Column("reality.kind", "kind", wide_only=True),
            REALITY,
            Column(
                "",
                "preset",
                lambda row: measured_text(row.default),
                is_number=True,
                style=lambda row: STYLES[row.default_verdict],
            ),
            Column(
                "",
                "this",
                lambda row: measured_text(row.configured),
                is_number=True,
                style=_style,
            ),
            Column("", "verdict", verdict_text, style=_style),
            Column("", "remark", remark_text, place=Place.BELOW),
        ),
        rows=applicable(report),
    )


def advisory_note(report: Report) -> list[Part]:
    """Return what advisory means, where a row is."""
    note = Paragraph(f"advisory: {ADVISORY_NOTE}", Tone.NOTE)
    return [note] if any(row.advisory for row in report.rows) else []


def applicable(report: Report) -> tuple[PhenomenonResult, ...]:
    """Return the rows that apply to the target."""
    return tuple(row for row in report.rows if row.applies)


def inapplicable(report: Report) -> list[Part]:
    """Return a line for each reason why rows do not apply, with these rows."""
    several: dict[str, list[str]] = {}
    for row in report.rows:
        if not row.applies:
            several.setdefault(row.remark, []).append(row.phenomenon)
    return [
        Paragraph(f"not applicable, {reason}: {', '.join(names)}", Tone.NOTE)
        for reason, names in several.items()
    ]


def _style(row: PhenomenonResult) -> str:
    return "" if row.advisory else STYLES[row.verdict]


def reality_text(reality: Reality, unit: str) -> str:
    """Return `centre +- half-width unit` of the interval of reality, or its limits."""
    interval = f"{quantity_text(reality.value)} +- {quantity_text(reality.tolerance)}"
    return with_unit(reality.limits or interval, unit)


def measured_text(value: float | None) -> str:
    """Return a measured value; a dash for None."""
    return "-" if value is None else quantity_text(value)


def verdict_text(row: PhenomenonResult) -> str:
    """Return the verdict, and for a visible or wrong value its difference from reality, in per cent below 100 %."""
    if not row.verdict.is_off:
        return row.verdict.value
    word, effect = "advisory" if row.advisory else row.verdict.value, row.effect
    if effect is None or row.reality.limits:
        return word
    if abs(effect) <= abs(row.reality.value):
        return f"{word}, {100.0 * effect / abs(row.reality.value):+.3g} %"
    return f"{word}, {with_unit(f'{effect:+.3g}', row.unit)}"


def remark_text(row: PhenomenonResult) -> str:
    """Return the geoms that decide a row, its remark, and what a flag means."""
    parts = (
        f"worst: {row.geoms}" if row.geoms and row.verdict.is_off else "",
        row.remark,
        row.advisory if row.verdict.is_off else "",
        row.consequence.removesuffix("."),
    )
    return "; ".join(filter(None, parts))


def tally_text(report: Report) -> str:
    """Return how many rows were measured, declined and not applicable, and the verdicts of those that were measured."""
    rows = [row for row in report.rows if row.verdict is not Verdict.DECLINED]
    counting = [row for row in rows if not row.advisory or not row.verdict.is_off]
    found = Counter(row.verdict for row in counting)
    counts = {verdict.value: found[verdict] for verdict in _present(report)}
    counts["advisory"] = len(rows) - len(counting)
    text = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
    shown = ": ".join(filter(None, (counts_text(report), text)))
    return "; ".join((shown, *report.notes, f"{report.wall_s:.0f} s"))


def regression_text(one: Regression) -> str:
    """Return what is farther from reality than in the baseline, and by how much."""
    row, part = one.row, one.part
    value = with_unit(measured_text(part.value), row.unit)
    head = ", ".join(filter(None, (row.phenomenon, part.name)))
    was = "not in the baseline"
    if one.before is not None:
        is_inside = one.before <= INSIDE_WITHIN
        was = "inside" if is_inside else f"{one.before:.3g} half-widths"
    return f"{head}: {part.verdict.value}, {value}, {part.deviation:.3g} half-widths from reality; was {was}"


def _present(report: Report) -> list[Verdict]:
    """Return the verdicts that occur in rows that count, the worst first."""
    found = {
        row.verdict
        for row in applicable(report)
        if not (row.advisory and row.verdict.is_off)
    }
    return [
        v
        for v in (Verdict.WRONG, Verdict.VISIBLE, Verdict.INSIDE, Verdict.DECLINED)
        if v in found
    ]
