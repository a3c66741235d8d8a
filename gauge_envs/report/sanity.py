"""Sanity checks as a table and as JSON objects."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from rich.console import Group
from rich.text import Text

from gauge_envs.checks.sanity.model import PhenomenonResult, Reality, Report, TrainingConfiguration, Verdict
from gauge_envs.report.table import Column, Facts, Place, Table, as_markdown, as_rich
from gauge_envs.report.text import heading, quantity_text, vector_text

__all__ = [
    "VERDICT_NOTES",
    "measured_text",
    "reality_text",
    "responsible_text",
    "sanity_markdown",
    "sanity_rows",
    "sanity_view",
    "setting_text",
    "settings_by_origin",
    "tally_text",
    "verdict_text",
]

VERDICT_NOTES = {
    Verdict.INSIDE: "within 2 sigma of reality: a real trial could have done this",
    Verdict.VISIBLE: "beyond 2 sigma, within 5: a careful observer sees the difference",
    Verdict.WRONG: "beyond 5 sigma, or of another kind: what holds slides, what stays intact diverges",
    Verdict.DECLINED: "not measured: the backend cannot build the scene, or not with these settings",
}

STYLES = {Verdict.INSIDE: "green", Verdict.VISIBLE: "yellow", Verdict.WRONG: "bold red", Verdict.DECLINED: "dim"}

LEGEND = (
    "Reality: mean +- standard deviation (sigma) of real trials. Default: the backend's default settings. This: the "
    "checked configuration. Below a row: the settings that are responsible, found by resetting one setting at a time "
    "to the default and measuring again."
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
        heading(checked.name),
        Facts(_facts(checked)),
        *([as_rich(_contact_table(checked), wide=wide)] if len(checked.contact_groups) > 1 else []),
        *(Text(f"note: {note}", style="yellow") for note in checked.notes),
        as_rich(_phenomenon_table(report), wide=wide),
        Text(""),
        Text(tally_text(report), style="bold"),
        Text(LEGEND, style="dim"),
        *(Text(f"{verdict.value}: {VERDICT_NOTES[verdict]}", style="dim") for verdict in _present(report)),
    )


def sanity_markdown(report: Report) -> str:
    """Return the table of phenomena as GitHub Markdown, and the number of rows with each verdict."""
    table = replace(_phenomenon_table(report), title="")
    return f"{as_markdown(table)}\n{report.configuration.name}: {tally_text(report)}\n"


def _facts(checked: TrainingConfiguration) -> dict[str, str]:
    facts = {"read from": checked.source, "backend": checked.backend}
    if checked.frame_skip is not None:
        facts["one action"] = f"{checked.frame_skip} steps"
    for origin, settings in settings_by_origin(checked).items():
        facts[origin] = ", ".join(f"{name} = {setting_text(value)}" for name, value in settings.items())
    if not checked.settings:
        facts["settings"] = "the backend's default"
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
        return "the backend's default"
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


def _phenomenon_table(report: Report) -> Table:
    return Table(
        title="Phenomena",
        columns=(
            Column("title", "phenomenon"),
            Column("", "reality", lambda row: reality_text(row.reality, row.unit), is_number=True),
            Column("", "default", lambda row: measured_text(row.default), is_number=True, style=_default_style),
            Column("", "this", lambda row: measured_text(row.configured), is_number=True, style=_style),
            Column("", "verdict", verdict_text, style=_style),
            Column("", "responsible", responsible_text, place=Place.BELOW),
        ),
        rows=report.rows,
    )


def _style(row: PhenomenonResult) -> str:
    return STYLES[row.verdict]


def _default_style(row: PhenomenonResult) -> str:
    return STYLES[row.default_verdict]


def reality_text(reality: Reality, unit: str) -> str:
    """Return `mean +- sigma unit`."""
    text = f"{quantity_text(reality.value)} +- {quantity_text(reality.scatter)}"
    return text if unit == "1" else f"{text} {unit}"


def measured_text(value: float | None) -> str:
    """Return a measured value; a dash for None."""
    return "-" if value is None else quantity_text(value)


def verdict_text(row: PhenomenonResult) -> str:
    """Return the verdict, and for a visible or wrong value its distance from reality in standard deviations."""
    if row.sigmas is None or row.verdict in (Verdict.INSIDE, Verdict.DECLINED):
        return row.verdict.value
    return f"{row.verdict.value}, {quantity_text(row.sigmas)} sigma"


def responsible_text(row: PhenomenonResult) -> str:
    """Return the remark of a row and its responsible settings."""
    return "; ".join(part for part in (row.remark, "" if row.cause is None else row.cause.line) if part)


def tally_text(report: Report) -> str:
    """Return the number of rows with each verdict."""
    counts = {verdict: sum(row.verdict is verdict for row in report.rows) for verdict in _present(report)}
    text = ", ".join(f"{count} {verdict.value}" for verdict, count in counts.items())
    return f"{text or 'nothing was measured'}; {report.wall_s:.0f} s"


def _present(report: Report) -> list[Verdict]:
    """Return the verdicts that occur, the worst first."""
    found = {row.verdict for row in report.rows}
    return [v for v in (Verdict.WRONG, Verdict.VISIBLE, Verdict.INSIDE, Verdict.DECLINED) if v in found]
