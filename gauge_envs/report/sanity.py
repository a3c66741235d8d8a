"""Sanity checks as a table and as JSON objects."""

from __future__ import annotations

from typing import Any

from rich.console import Group
from rich.table import Table
from rich.text import Text

from gauge_envs.checks.sanity.model import PhenomenonResult, Reality, Report, TrainingConfiguration, Verdict
from gauge_envs.report.text import facts_grid, heading, markdown_row, quantity_text, rows_table, vector_text

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

TITLES = ("phenomenon", "reality", "default", "this", "verdict", "responsible")

LEGEND = (
    "Reality: mean +- standard deviation (sigma) of real trials. Default: the backend's own settings. Responsible: "
    "found by putting one setting at a time back to the default and measuring again."
)


def sanity_rows(report: Report) -> list[dict[str, Any]]:
    """JSON-ready objects: what was checked, with the worst verdict, then one a phenomenon, without its curve."""
    whole = report.to_dict()
    rows = whole.pop("rows")
    return [whole, *({key: value for key, value in row.items() if key != "curve"} for row in rows)]


def sanity_view(report: Report) -> Group:
    """A sanity check for reading: what was read, the table of phenomena, and what the words mean."""
    checked = report.configuration
    parts: list[Any] = [heading(checked.name), facts_grid(_facts(checked))]
    if len(checked.contact_groups) > 1:
        parts += [heading("Contacts of the model"), _groups_table(checked)]
    parts += [Text(f"note: {note}", style="yellow") for note in checked.notes]
    parts += [heading("Phenomena"), _phenomena_table(report)]
    parts += [Text(""), Text(tally_text(report), style="bold"), Text(LEGEND, style="dim")]
    parts += [Text(f"{verdict.value}: {VERDICT_NOTES[verdict]}", style="dim") for verdict in _present(report)]
    return Group(*parts)


def sanity_markdown(report: Report) -> str:
    """The table of phenomena as GitHub Markdown, and how many rows have each verdict."""
    rows = [TITLES, ("---",) * len(TITLES), *map(_cells, report.rows)]
    return "\n".join([*map(markdown_row, rows), "", f"{report.configuration.name}: {tally_text(report)}"]) + "\n"


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
    """Settings by where they are from, in the order in which they were read."""
    grouped: dict[str, dict[str, Any]] = {}
    for name, value in checked.settings.items():
        grouped.setdefault(checked.origins.get(name, "settings"), {})[name] = value
    return grouped


def setting_text(value: Any) -> str:
    """A setting as people write it."""
    if value is None:
        return "the backend's own"
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, list | tuple):
        return vector_text(value)
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _groups_table(checked: TrainingConfiguration) -> Table | Text:
    names = ("condim", "friction", "solref", "solimp", "margin", "gap")
    rows = [
        [
            "used" if group.is_used else "",
            group.geoms,
            str(group.pair_count),
            *(setting_text(group.constants[name]) for name in names),
        ]
        for group in checked.contact_groups
    ]
    return rows_table(("", "geoms", "pairs", *names), rows)


def _phenomena_table(report: Report) -> Table:
    table = Table(box=None, header_style="dim", pad_edge=False)
    phenomenon, *numbers, verdict, responsible = TITLES
    table.add_column(phenomenon, overflow="fold", ratio=3)
    for title in numbers:
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column(verdict, no_wrap=True)
    table.add_column(responsible, overflow="fold", ratio=4)
    for row in report.rows:
        styles = ("", "", STYLES[row.default_verdict], STYLES[row.verdict], STYLES[row.verdict], "")
        table.add_row(*(Text(cell, style=style) for cell, style in zip(_cells(row), styles, strict=True)))
    return table


def _cells(row: PhenomenonResult) -> tuple[str, ...]:
    return (
        row.title,
        reality_text(row.reality, row.unit),
        measured_text(row.default),
        measured_text(row.configured),
        verdict_text(row),
        responsible_text(row),
    )


def reality_text(reality: Reality, unit: str) -> str:
    """`mean +- sigma unit`."""
    told = f"{quantity_text(reality.value)} +- {quantity_text(reality.scatter)}"
    return told if unit == "1" else f"{told} {unit}"


def measured_text(value: float | None) -> str:
    """A measured value; a dash where there is none."""
    return "-" if value is None else quantity_text(value)


def verdict_text(row: PhenomenonResult) -> str:
    """The verdict, and how many standard deviations the value is off where it is."""
    if row.sigmas is None or row.verdict in (Verdict.INSIDE, Verdict.DECLINED):
        return row.verdict.value
    return f"{row.verdict.value}, {quantity_text(row.sigmas)} sigma"


def responsible_text(row: PhenomenonResult) -> str:
    """What is responsible, and how the run failed where it did."""
    return "; ".join(part for part in (row.remark, "" if row.cause is None else row.cause.line) if part)


def tally_text(report: Report) -> str:
    """How many rows have each verdict."""
    counts = {verdict: sum(row.verdict is verdict for row in report.rows) for verdict in _present(report)}
    told = ", ".join(f"{count} {verdict.value}" for verdict, count in counts.items())
    return f"{told or 'nothing was measured'}; {report.wall_s:.0f} s"


def _present(report: Report) -> list[Verdict]:
    """Verdicts that occur, the worst first."""
    found = {row.verdict for row in report.rows}
    return [v for v in (Verdict.WRONG, Verdict.VISIBLE, Verdict.INSIDE, Verdict.DECLINED) if v in found]
