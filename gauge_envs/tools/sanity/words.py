"""Sanity checks in words and on a page, and comparisons of two training configurations in words.

The page is one HTML file: no script, no other file, no network.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from io import StringIO
from typing import Any

import numpy as np

from gauge_envs.errors import needs_extra
from gauge_envs.pages.document import (
    Document,
    Heading,
    Paragraph,
    Part,
    Tone,
    as_html,
    page,
)
from gauge_envs.pages.html import Html, element, folded
from gauge_envs.pages.table import Column, Facts, Place, Table, grid
from gauge_envs.pages.text import counted, quantity_text, vector_text, with_unit
from gauge_envs.tools.sanity.comparison import Change, ChangeRow, Comparison
from gauge_envs.tools.sanity.model import (
    Cause,
    Curve,
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

MOST_PARTS = 4
"""Largest number of links, joints or motors that a row of a comparison names; JSON has all."""

MOST_TRIED = 4
"""Largest number of changes without success that the first line names."""

HALF_TEXT = 80
"""Characters of the begin and of the end of a change without success in the first line; JSON has all of it."""

MOST_NAMED = 2
"""Largest number of changes, or of rows that were not measured, that the first line names."""

REALITY = Column(
    "", "reality", lambda row: reality_text(row.reality, row.unit), is_number=True
)
"""Column of tables of phenomena."""

LEGEND = (
    "Reality: mean of real trials and the interval of 95 % of further trials, or a law and its tolerance (gauge list "
    "phenomena, --format wide and pages name the source). Preset: this package's preset for the scene. This: the "
    "checked configuration; after the verdict, its difference from reality. Below a row: the responsible setting, "
    "found by resetting each setting to the engine's documented default and to this package's preset, and measuring "
    "again."
)


def sanity_document(report: Report) -> Document:
    """Return a sanity check: what was read, the table of phenomena, and the meaning of the verdicts.

    Its rows are the configuration with the worst verdict, then each phenomenon without its curve.
    """
    checked, table = report.configuration, _phenomenon_table(report)
    whole = report.to_dict()
    rows = (
        {key: value for key, value in row.items() if key != "curve"}
        for row in whole.pop("rows")
    )
    answer, tally = Paragraph(top_line(report), Tone.ANSWER), tally_text(report)
    return Document(
        parts=(
            answer,
            Paragraph(""),
            Heading(checked.name),
            Facts(_facts(checked)),
            *([_contact_table(checked)] if len(checked.contact_groups) > 1 else []),
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
            *_advisory_note(report),
        ),
        rows=[whole, *rows],
        markdown=(
            answer,
            replace(table, title=""),
            *inapplicable(report),
            Paragraph(f"{checked.name}: {tally}"),
        ),
    )


def _cut(text: str) -> str:
    """Return a text without its middle where it is long: first what was tried, last how far it came."""
    if len(text) <= 2 * HALF_TEXT:
        return text
    return f"{text[:HALF_TEXT].rstrip(' ,')} ... {text[-HALF_TEXT:].lstrip(' ,')}"


def top_line(report: Report) -> str:
    """Return the change that mends most rows; without one, what the check found in one line."""
    flags = sum(row.is_flag for row in report.rows)
    if report.cure is not None:
        return f"Mends most: {report.cure.line}"
    if flags:
        text = f"{flags} {'flags' if flags > 1 else 'flag'}"
        if report.tried:
            more = len(report.tried) - MOST_TRIED
            several = [
                *(_cut(one) for one in report.tried[:MOST_TRIED]),
                *([f"and {more} more"] if more > 0 else []),
            ]
            return (
                f"{text}. Tried, and none mends one without harm: {'; '.join(several)}"
            )
        return (
            f"{text}: {', '.join(row.phenomenon for row in report.rows if row.is_flag)}"
        )
    measured, missing = report.counts["measured"], report.unmeasured
    if not measured:
        reasons = dict.fromkeys(row.remark for row in report.rows if row.remark)
        return "; ".join(("Nothing was measured", *[*reasons][:MOST_NAMED]))
    if missing:
        named = ", ".join(missing[:MOST_NAMED]) + (
            f" and {len(missing) - MOST_NAMED} more" * (len(missing) > MOST_NAMED)
        )
        return f"Incomplete: {len(missing)} of {measured + len(missing)} rows were not measured: {named}"
    return "; ".join(
        (
            f"No flags: {counts_text(report)}, nothing to change",
            *report.notes,
        )
    )


def counts_text(report: Report) -> str:
    """Return how many rows were measured, declined and not applicable."""
    first, *others = report.counts.items()
    texts = [f"{count} {name.replace('_', ' ')}" for name, count in others if count]
    return ", ".join([f"{counted(first[1], 'row')} {first[0]}", *texts])


def is_clean(report: Report) -> bool:
    """Return whether all that was asked for was measured, and nothing is flagged."""
    return not report.unmeasured and not any(row.is_flag for row in report.rows)


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


def source_facts(checked: TrainingConfiguration) -> dict[str, str]:
    """Return what was read, without the settings."""
    facts = {"read from": checked.source, "backend": checked.backend}
    if checked.frame_skip is not None:
        facts["one action"] = f"{checked.frame_skip} steps"
    if checked.foot_contact is not None:
        facts["foot on ground"] = checked.foot_contact.text
    if (foot := checked.foot_geometry) is not None:
        facts["foot"] = f"{foot.description}, in the {foot.pose}; {foot.assumption}"
    return facts


def _facts(checked: TrainingConfiguration) -> dict[str, str]:
    facts = source_facts(checked)
    for origin, settings in settings_by_origin(checked).items():
        facts[origin] = ", ".join(
            f"{name} = {setting_text(value)}" for name, value in settings.items()
        )
    if not checked.settings:
        facts["settings"] = "this package's presets"
    return facts


def settings_by_origin(checked: TrainingConfiguration) -> dict[str, dict[str, Any]]:
    """Return the settings by origin, in the order in which they were read."""
    grouped: dict[str, dict[str, Any]] = {}
    for name, value in checked.settings.items():
        grouped.setdefault(checked.origins.get(name, "settings"), {})[name] = value
    return grouped


def setting_text(value: Any) -> str:
    """Return a setting as people write it."""
    if value is None:
        return "not set"
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, list | tuple):
        return vector_text(value)
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _contact_table(checked: TrainingConfiguration) -> Table:
    names = {
        "condim": False,
        "friction": False,
        "solref": False,
        "solimp": False,
        "margin": True,
        "gap": True,
    }
    return Table(
        title="Contacts of the model",
        columns=(
            Column("is_used", "", lambda is_used: "used" if is_used else ""),
            Column("geoms", "geoms", place=Place.HEADING),
            Column("pair_count", "pairs", is_number=True),
            *(
                Column(f"constants.{name}", name, setting_text, wide_only=wide_only)
                for name, wide_only in names.items()
            ),
        ),
        rows=checked.contact_groups,
    )


def _phenomenon_table(report: Report) -> Table:
    repeated = _repeated_causes(report)
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
            Column(
                "",
                "",
                lambda row: repeated[row.phenomenon],
                place=Place.BELOW,
                narrow_only=True,
            ),
            Column(
                "", "responsible", responsible_text, place=Place.BELOW, wide_only=True
            ),
        ),
        rows=applicable(report),
    )


def _advisory_note(report: Report) -> list[Part]:
    """Return what advisory means, where a row is."""
    note = Paragraph(f"advisory: {ADVISORY_NOTE}", Tone.NOTE)
    return [note] if any(row.advisory for row in report.rows) else []


def applicable(report: Report) -> tuple[PhenomenonResult, ...]:
    """Return the rows that apply to the target."""
    return tuple(row for row in report.rows if row.applies)


def inapplicable(report: Report) -> list[Part]:
    """Return a line for each reason why rows do not apply, with these rows."""
    return _by_reason(
        "not applicable",
        [(row.remark, row.phenomenon) for row in report.rows if not row.applies],
    )


def _by_reason(word: str, found: Sequence[tuple[str, str]]) -> list[Part]:
    """Return a line for each reason, with the ids of its rows."""
    several: dict[str, list[str]] = {}
    for reason, name in found:
        several.setdefault(reason, []).append(name)
    return [
        Paragraph(f"{word}, {reason}: {', '.join(names)}", Tone.NOTE)
        for reason, names in several.items()
    ]


CAUSE_VERB = re.compile(r" brings? ")
"""Verb of a cause, between the settings and what they do."""


def _repeated_causes(report: Report) -> dict[str, str]:
    """Return what is responsible for each row, shorter where its cause is that of an earlier row, by phenomenon."""
    first: dict[str, str] = {}
    texts = {}
    for row in report.rows:
        shown = row
        if row.cause is not None and CAUSE_VERB.search(row.cause.line):
            change, effect = CAUSE_VERB.split(row.cause.line, maxsplit=1)
            if first.setdefault(change, row.phenomenon) != row.phenomenon:
                # Other settings that would do, and the source, stand in the wide table.
                line = f"as for {first[change]}: {re.split(r' [(]|; ', effect)[0]}"
                shown = replace(row, cause=replace(row.cause, line=line))
        texts[row.phenomenon] = responsible_text(shown)
    return texts


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


def responsible_text(row: PhenomenonResult) -> str:
    """Return the remark of a row, the geoms that decide it, and its responsible settings."""
    parts = (
        f"worst: {row.geoms}" if row.geoms and row.verdict.is_off else "",
        row.remark,
        row.advisory if row.verdict.is_off else "",
        row.consequence.removesuffix("."),
        "" if row.cause is None else row.cause.line,
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
    row = one.row
    value = with_unit(measured_text(one.value), row.unit)
    head = ", ".join(filter(None, (row.phenomenon, one.part)))
    was = (
        "not in the baseline" if one.before is None else f"{one.before:.3g} half-widths"
    )
    return f"{head}: {one.verdict.value}, {value}, {one.deviation:.3g} half-widths from reality; was {was}"


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


# --- two configurations ----------------------------------------------------------------------------------------------

CHANGE_STYLES = {
    Change.NONE: "green",
    Change.VISIBLE: "yellow",
    Change.LARGE: "bold red",
    Change.UNKNOWN: "dim",
    Change.NEITHER: "dim",
}

COMPARISON_LEGEND = (
    "same: no real trial could resolve the difference, or it is within the tolerance of the law; visible: up to 2.5 "
    "times as much; large: more; unknown: one of the two was not measured. What models state of links, joints and "
    "motors is the same within 5 %; places and angles within 1 mm, 2 mm for centres of mass, and 0.01 rad. A dash: no "
    "limit, or no such part."
)


def comparison_document(comparison: Comparison) -> Document:
    """Return the largest change, both sources, and the table; its rows are both configurations, then each row."""
    whole = comparison.to_dict()
    rows = whole.pop("rows")
    answer, table = (
        Paragraph(comparison_line(comparison), Tone.ANSWER),
        _change_table(comparison),
    )
    return Document(
        parts=(
            answer,
            Paragraph(""),
            Heading(f"{comparison.trained.name} against {comparison.deployed.name}"),
            Facts(
                {
                    "trained": comparison.trained.source,
                    "deployed": comparison.deployed.source,
                }
            ),
            table,
            *_neither(comparison),
            Paragraph(""),
            Paragraph(COMPARISON_LEGEND, Tone.NOTE),
        ),
        rows=[whole, *rows],
        markdown=(answer, table, *_neither(comparison)),
    )


def _neither(comparison: Comparison) -> list[Part]:
    """Return a line for each reason why rows are not compared, with these rows."""
    return _by_reason(
        "not compared",
        [
            (row.remark, row.id)
            for row in comparison.rows
            if row.change is Change.NEITHER
        ],
    )


def comparison_line(comparison: Comparison) -> str:
    """Return the largest changes in one line."""
    changed = comparison.changed
    if not changed:
        return f"Nothing changes in {', '.join(_change_counts(comparison))}"
    named = [
        f"{row.title}{f' ({row.parts[0].name})' if row.parts else ''}: from "
        + with_unit(
            f"{measured_text(row.trained)} to {measured_text(row.deployed)}", row.unit
        )
        for row in changed[:MOST_NAMED]
    ]
    others = ", ".join(row.id for row in changed[MOST_NAMED:])
    compared, *missing = _change_counts(comparison)
    texts = [
        f"{len(changed)} of {compared} change",
        *missing,
        f"most of all {'; then '.join(named)}",
        f"then {others}" if others else "",
    ]
    return "; ".join(filter(None, texts))


def _change_counts(comparison: Comparison) -> list[str]:
    """Return how many rows were compared, are unknown, and were not compared."""
    found = Counter(row.change for row in comparison.rows)
    unknown, neither = found[Change.UNKNOWN], found[Change.NEITHER]
    compared = counted(len(comparison.rows) - unknown - neither, "row")
    others = {"unknown": unknown, Change.NEITHER.value: neither}
    return [compared, *(f"{count} {word}" for word, count in others.items() if count)]


def change_text(row: ChangeRow) -> str:
    """Return what changes in a row, in one line."""
    values = f"{measured_text(row.trained)} to {measured_text(row.deployed)}"
    found = _parts_text(row) or values
    return "; ".join(
        filter(None, (f"{row.title}: {with_unit(found, row.unit)}", row.remark))
    )


def _parts_text(row: ChangeRow) -> str:
    """Return the links, joints or motors that change most, with both values."""
    named = [
        f"{one.name} {measured_text(one.trained)} to {measured_text(one.deployed)}"
        for one in row.parts[:MOST_PARTS]
    ]
    if len(row.parts) > MOST_PARTS:
        named.append(f"and {len(row.parts) - MOST_PARTS} more")
    return ", ".join(named)


def _change_table(comparison: Comparison) -> Table:
    def difference(row: ChangeRow) -> str:
        known = row.trained is not None and row.deployed is not None
        return (
            with_unit(f"{(row.deployed or 0.0) - (row.trained or 0.0):+.3g}", row.unit)
            if known
            else "-"
        )

    def below(row: ChangeRow) -> str:
        title = row.title if row.change in (Change.VISIBLE, Change.LARGE) else ""
        return "; ".join(filter(None, (title, _parts_text(row), row.remark)))

    return Table(
        columns=(
            Column("id", "id"),
            Column("title", "quantity", wide_only=True),
            Column("trained", "trained", measured_text, is_number=True),
            Column("deployed", "deployed", measured_text, is_number=True),
            Column("", "difference", difference, is_number=True),
            Column(
                "change",
                "change",
                lambda change: change.value,
                style=CHANGE_STYLES.__getitem__,
            ),
            Column("", "", below, place=Place.BELOW),
        ),
        rows=[row for row in comparison.rows if row.change is not Change.NEITHER],
    )


# --- page ------------------------------------------------------------------------------------------------------------

REALITY_COLOR, DEFAULT_COLOR, CONFIGURED_COLOR = "#303030", "#0072b2", "#d55e00"
"""Grey and two of Okabe and Ito's colours, which colour-blind readers distinguish; line styles differ too."""

MARKS = {
    Verdict.INSIDE: "\u2713",
    Verdict.VISIBLE: "\u25b3",
    Verdict.WRONG: "\u2717",
    Verdict.DECLINED: "\u2013",
}
"""Signs beside the words, so that a verdict is visible without its colour."""

FIGURE_SIZE_IN = (3.3, 2.6)
"""Size of a figure. At its own size it fits on a phone, where the text of `FONT_PT` is as large as the page's."""

FONT_PT = 10.5
"""Size of the text in figures: 14 pixels."""

LOOK = "stack dense anywhere"
"""Tables whose names may be longer than a phone is wide."""


def check_can_draw() -> None:
    """Check that a page can be drawn, before a long run."""
    with needs_extra("the HTML page", "plot"):
        import matplotlib  # noqa: F401


def sanity_page(report: Report) -> str:
    """Return the self-contained page of a sanity check."""
    checked = report.configuration
    lead = "What the numerical settings of this configuration do to the physics of measured objects: "
    rows = applicable(report)
    cards = (_card(row) for row in sorted(rows, key=lambda row: not row.is_flag))
    parts: list[Part] = [
        Paragraph(top_line(report), Tone.ANSWER),
        element("p", f"{lead}{tally_text(report)}.", class_="lead"),
        _phenomena(report),
        *inapplicable(report),
        *(
            element("p", _badge(verdict), f" {note}", class_="small")
            for verdict, note in VERDICT_NOTES.items()
        ),
        *_advisory_note(report),
        Heading("One by one"),
        element("div", *cards, class_="cards"),
        Heading("What was read"),
        *_configuration(checked),
        Heading("Versions"),
        grid(("package", "version"), sorted(report.versions.items()), look="anywhere"),
    ]
    return page(f"Sanity check of {checked.name}", parts)


def _badge(verdict: Verdict, text: str | None = None) -> Html:
    return element(
        "span",
        f"{MARKS[verdict]} {text or verdict.value}",
        class_=f"badge {verdict.value}",
    )


def _row_badge(row: PhenomenonResult) -> Html:
    """Return the badge of a row; it is grey where the row is off and does not count."""
    counts = row.is_flag or row.verdict is Verdict.INSIDE
    return _badge(row.verdict if counts else Verdict.DECLINED, verdict_text(row))


def _phenomena(report: Report) -> Table:
    def preset(row: PhenomenonResult) -> str:
        verdict = (
            ""
            if row.default_verdict is Verdict.INSIDE
            else f" ({row.default_verdict.value})"
        )
        return measured_text(row.default) + verdict

    return Table(
        columns=(
            Column(
                "",
                "phenomenon",
                html=lambda row: element("a", row.title, href=f"#{row.phenomenon}"),
            ),
            REALITY,
            Column("", "preset", preset, is_number=True),
            Column("configured", "this configuration", measured_text, is_number=True),
            Column("", "verdict", html=_row_badge),
            Column("", "", responsible_text, place=Place.BELOW),
        ),
        rows=applicable(report),
        look="stack phenomena anywhere",
    )


def _configuration(checked: TrainingConfiguration) -> list[Part]:
    parts: list[Part] = [Facts(source_facts(checked))]
    parts += [Paragraph(note, Tone.WARNING) for note in checked.notes]
    rows = [
        (name, setting_text(value), origin)
        for origin, settings in settings_by_origin(checked).items()
        for name, value in settings.items()
    ]
    settings = grid(("setting", "value", "from"), rows, look=LOOK) if rows else None
    shown = (
        element("p", "No settings: this package's presets.")
        if settings is None
        else settings.html()
    )
    parts.append(folded(f"{len(rows)} settings", shown, open=True))
    if checked.contact_groups:
        table = replace(_contact_table(checked), title="", look=LOOK)
        parts.append(folded("contacts of the model", table.html(), open=True))
    return parts


# --- one phenomenon --------------------------------------------------------------------------------------------------


def _card(row: PhenomenonResult) -> Html:
    """Return the details of a row, which are open where it is visible or wrong."""
    values = f"reality {reality_text(row.reality, row.unit)}, preset {measured_text(row.default)}, this configuration "
    source = f"Reality ({row.reality.kind.value}): {row.reality.source}. Interval: {row.reality.rationale}."
    scene = f" Scene: {row.experiment}." if row.experiment else ""
    parts: list[Part] = [
        element("p", _row_badge(row), f" {values}{measured_text(row.configured)}")
    ]
    if row.curve is not None:
        parts.append(_figure(row.curve))
    if text := responsible_text(row):
        parts.append(Paragraph(text))
    if row.cause is not None and row.cause.tried:
        parts.append(_tried(row.cause, row.unit))
    if row.parts:
        rows = [
            (one.name, measured_text(one.value), one.verdict.value, one.remark)
            for one in row.parts
        ]
        parts.append(grid(("part", "measured", "verdict", ""), rows, look="anywhere"))
    parts.append(Paragraph(source + scene, Tone.NOTE))
    return folded(
        row.title, as_html(parts), class_="card", id=row.phenomenon, open=row.is_flag
    )


def _tried(cause: Cause, unit: str) -> Html:
    rows = [
        (
            ", ".join(
                f"{name} = {setting_text(value)}"
                for name, value in trial.changes.items()
            ),
            "the preset" if trial.on_default else "this configuration",
            "diverged or declined"
            if trial.value is None
            else measured_text(trial.value),
        )
        for trial in cause.tried
    ]
    titles = ("change", "of", "measured" if unit == "1" else f"measured [{unit}]")
    return folded(
        f"{len(rows)} changes were tried", grid(titles, rows, look="anywhere").html()
    )


def _figure(curve: Curve) -> Html:
    """Return the curves of a phenomenon as inline SVG."""
    check_can_draw()
    import matplotlib as mpl
    from matplotlib.figure import Figure

    # Text stays text: a page of many figures is five times smaller than with glyphs as paths.
    with mpl.rc_context(
        {"svg.fonttype": "none", "font.family": "sans-serif", "font.size": FONT_PT}
    ):
        figure = Figure(figsize=FIGURE_SIZE_IN, layout="constrained")
        _draw(figure.add_subplot(), curve)
        figure.legend(
            loc="outside upper center",
            ncols=2,
            frameon=False,
            handlelength=1.4,
            columnspacing=1.0,
            borderpad=0.0,
        )
        stream = StringIO()
        figure.savefig(stream, format="svg", metadata={"Date": None})
    text = stream.getvalue()
    return Html(text[text.index("<svg") :])


def _draw(axes: Any, curve: Curve) -> None:
    if curve.reality:
        centre, half = np.asarray(curve.reality), np.asarray(curve.tolerance)
        band = (curve.times_s, centre - half, centre + half)
        axes.fill_between(*band, color="#cfcfcf", lw=0.0, label="reality")
        axes.plot(curve.times_s, curve.reality, color=REALITY_COLOR, lw=1.0)
    if curve.default:
        axes.plot(
            curve.times_s,
            curve.default,
            color=DEFAULT_COLOR,
            lw=1.4,
            ls="--",
            label="preset",
        )
    if curve.configured:
        axes.plot(
            curve.configured_times_s,
            curve.configured,
            color=CONFIGURED_COLOR,
            lw=1.6,
            label="this configuration",
        )
    axes.set_xlabel("time [s]")
    axes.set_ylabel(curve.label)
    axes.locator_params(nbins=5)
    axes.spines[["top", "right"]].set_visible(False)
