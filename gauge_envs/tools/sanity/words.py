"""Sanity checks as a table and as JSON objects."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from rich.console import Group
from rich.text import Text

from gauge_envs.pages.table import Column, Facts, Place, Table, as_markdown, as_rich
from gauge_envs.pages.text import heading, markdown_text, quantity_text, vector_text
from gauge_envs.tools.sanity.model import PhenomenonResult, Reality, Report, TrainingConfiguration, Verdict
from gauge_envs.tools.sanity.phenomena import phenomena, selection
from gauge_envs.tools.sanity.robot.foot import FootGeometry
from gauge_envs.tools.sanity.stated import STATED_ROWS

VERDICT_NOTES = {
    Verdict.INSIDE: "in the interval: a real trial could have done this, or the law is met within its tolerance",
    Verdict.VISIBLE: "outside, at most 2.5 half-widths from reality: a careful observer sees the difference",
    Verdict.WRONG: "farther away, or of another kind: a body slides that should hold, or the run diverges",
    Verdict.DECLINED: "not measured: it does not apply, or the backend cannot build the scene with these settings",
}

ADVISORY_NOTE = "does not count for --fail-on: the target does not state what the row depends on"

STYLES = {Verdict.INSIDE: "green", Verdict.VISIBLE: "yellow", Verdict.WRONG: "bold red", Verdict.DECLINED: "dim"}

LEGEND = (
    "Reality: mean of real trials and the interval of 95 % of further trials, or a law and its tolerance (gauge sanity "
    "--list, --wide and --html name the source). Preset: this package's preset for the scene. This: the checked "
    "configuration; after the verdict, its difference from reality. Below a row: the responsible setting, found by "
    "resetting each setting to the engine's documented default and to this package's preset, and measuring again."
)


def sanity_rows(report: Report) -> list[dict[str, Any]]:
    """Return JSON-ready objects: the configuration with the worst verdict, then each phenomenon without its curve."""
    whole = report.to_dict()
    rows = whole.pop("rows")
    return [whole, *({key: value for key, value in row.items() if key != "curve"} for row in rows)]


def sanity_view(report: Report, *, wide: bool = False) -> Group:
    """Return a sanity check for a terminal: what was read, the table of phenomena, and the meaning of the verdicts."""
    checked = report.configuration
    return Group(
        Text(top_line(report), style="bold"),
        Text(""),
        heading(checked.name),
        Facts(_facts(checked)),
        *([as_rich(_contact_table(checked), wide=wide)] if len(checked.contact_groups) > 1 else []),
        *(Text(f"note: {note}", style="yellow") for note in checked.notes),
        as_rich(_phenomenon_table(report, is_short=not wide), wide=wide),
        Text(""),
        Text(tally_text(report), style="bold"),
        Text(LEGEND, style="dim"),
        *(Text(f"{verdict.value}: {VERDICT_NOTES[verdict]}", style="dim") for verdict in _present(report)),
        *([Text(f"advisory: {ADVISORY_NOTE}", style="dim")] if any(row.advisory for row in report.rows) else []),
    )


def top_line(report: Report) -> str:
    """Return the change that mends most rows; without one, what the check found in one line."""
    flags = sum(row.is_flag for row in report.rows)
    if report.cure is not None:
        return f"Mends most: {report.cure.line}"
    if flags:
        text = f"{flags} {'flags' if flags > 1 else 'flag'}"
        if any(row.cause is not None for row in report.rows):
            return f"{text}; no change that was tried mends one"
        return f"{text}: {', '.join(row.phenomenon for row in report.rows if row.is_flag)}"
    measured = any(row.verdict is not Verdict.DECLINED for row in report.rows)
    return "No flags: nothing to change" if measured else "Nothing was measured"


def phenomena_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return the rows that a sanity check can have: ids, titles, kinds and reality."""
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
        rows=rows,
    )


def phenomena_rows(*, include_deformables: bool = False, only: Sequence[str] = ()) -> list[dict[str, Any]]:
    """Return JSON-ready objects on the rows that a sanity check can have.

    Args:
        include_deformables: Whether to include phenomena of deformable bodies.
        only: Ids or patterns; all when empty.
    """
    chosen = selection(only, include_deformables=include_deformables)
    known = [(row.phenomenon, row.title, row.reality, row.unit) for row in STATED_ROWS]
    known += [(one.id, one.title, one.reality, one.unit) for one in phenomena(include_deformables=True)]
    return [
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
    ]


def sanity_markdown(report: Report) -> str:
    """Return the top line and the table of phenomena as GitHub Markdown, and the number of rows with each verdict."""
    table = replace(_phenomenon_table(report), title="")
    tally = f"{report.configuration.name}: {tally_text(report)}"
    return f"{markdown_text(top_line(report))}\n\n{as_markdown(table)}\n{tally}\n"


def _facts(checked: TrainingConfiguration) -> dict[str, str]:
    facts = {"read from": checked.source, "backend": checked.backend}
    if checked.frame_skip is not None:
        facts["one action"] = f"{checked.frame_skip} steps"
    if checked.foot_contact is not None:
        facts["foot on ground"] = checked.foot_contact.text
    if checked.foot_geometry is not None:
        facts["foot"] = foot_text(checked.foot_geometry)
    for origin, settings in settings_by_origin(checked).items():
        facts[origin] = ", ".join(f"{name} = {setting_text(value)}" for name, value in settings.items())
    if not checked.settings:
        facts["settings"] = "this package's presets"
    return facts


def foot_text(foot: FootGeometry) -> str:
    """Return what the rows on the foot of a robot are about."""
    return f"{foot.description}, in the {foot.pose}; {foot.assumption}"


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
    names = {"condim": False, "friction": False, "solref": False, "solimp": False, "margin": True, "gap": True}
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


def _phenomenon_table(report: Report, *, is_short: bool = False) -> Table:
    repeated = _repeated_causes(report) if is_short else {}
    return Table(
        title="Phenomena",
        columns=(
            Column("phenomenon", "id"),
            Column("title", "phenomenon", wide_only=True),
            Column("reality.kind", "kind", wide_only=True),
            Column("", "reality", lambda row: reality_text(row.reality, row.unit), is_number=True),
            Column("", "preset", lambda row: measured_text(row.default), is_number=True, style=_default_style),
            Column("", "this", lambda row: measured_text(row.configured), is_number=True, style=_style),
            Column("", "verdict", verdict_text, style=_style),
            Column(
                "", "responsible", lambda row: repeated.get(row.phenomenon) or responsible_text(row), place=Place.BELOW
            ),
        ),
        rows=report.rows,
    )


CAUSE_VERB = re.compile(r" brings? ")
"""Verb of a cause, between the settings and what they do."""


def _repeated_causes(report: Report) -> dict[str, str]:
    """Return shorter texts for rows whose cause is that of an earlier row, by phenomenon."""
    first: dict[str, str] = {}
    repeated = {}
    for row in report.rows:
        if row.cause is None or not CAUSE_VERB.search(row.cause.line):
            continue
        change, effect = CAUSE_VERB.split(row.cause.line, maxsplit=1)
        if first.setdefault(change, row.phenomenon) != row.phenomenon:
            # Other settings that would do, and the source, stand in the wide table.
            known = replace(row.cause, line=f"as for {first[change]}: {re.split(r' [(]|; ', effect)[0]}")
            repeated[row.phenomenon] = responsible_text(replace(row, cause=known))
    return repeated


def _style(row: PhenomenonResult) -> str:
    return "" if row.advisory else STYLES[row.verdict]


def _default_style(row: PhenomenonResult) -> str:
    return STYLES[row.default_verdict]


def reality_text(reality: Reality, unit: str) -> str:
    """Return `centre +- half-width unit` of the interval of reality."""
    text = f"{quantity_text(reality.value)} +- {quantity_text(reality.tolerance)}"
    return text if unit == "1" else f"{text} {unit}"


def measured_text(value: float | None) -> str:
    """Return a measured value; a dash for None."""
    return "-" if value is None else quantity_text(value)


def effect_text(row: PhenomenonResult) -> str:
    """Return the difference from reality, in per cent where it is below 100 %; empty if nothing was measured."""
    effect = row.effect
    if effect is None:
        return ""
    if abs(effect) <= abs(row.reality.value):
        return f"{100.0 * effect / abs(row.reality.value):+.3g} %"
    return f"{effect:+.3g}" + ("" if row.unit == "1" else f" {row.unit}")


def verdict_text(row: PhenomenonResult) -> str:
    """Return the verdict, and for a visible or wrong value its difference from reality."""
    if row.verdict in (Verdict.INSIDE, Verdict.DECLINED):
        return row.verdict.value
    word = "advisory" if row.advisory else row.verdict.value
    effect = effect_text(row)
    return f"{word}, {effect}" if effect else word


def responsible_text(row: PhenomenonResult) -> str:
    """Return the remark of a row, the geoms that decide it, and its responsible settings."""
    flagged = row.verdict in (Verdict.VISIBLE, Verdict.WRONG)
    parts = (
        f"worst: {row.geoms}" if row.geoms and flagged else "",
        row.remark,
        row.advisory if flagged else "",
        "" if row.cause is None else row.cause.line,
    )
    return "; ".join(part for part in parts if part)


def tally_text(report: Report) -> str:
    """Return the number of rows with each verdict."""
    counted = [row for row in report.rows if not row.advisory or not _is_off(row)]
    counts = {verdict.value: sum(row.verdict is verdict for row in counted) for verdict in _present(report)}
    counts["advisory"] = len(report.rows) - len(counted)
    text = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
    return "; ".join((text or "nothing was measured", *report.notes, f"{report.wall_s:.0f} s"))


def _is_off(row: PhenomenonResult) -> bool:
    return row.verdict in (Verdict.VISIBLE, Verdict.WRONG)


def _present(report: Report) -> list[Verdict]:
    """Return the verdicts that occur in rows that count, the worst first."""
    found = {row.verdict for row in report.rows if not (row.advisory and _is_off(row))}
    return [v for v in (Verdict.WRONG, Verdict.VISIBLE, Verdict.INSIDE, Verdict.DECLINED) if v in found]
