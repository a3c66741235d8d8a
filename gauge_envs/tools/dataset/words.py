"""Tables of imports and of the state of the dataset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gauge_envs.pages.document import Document, Paragraph, Tone
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import METRIC_TITLES, short_id, with_unit
from gauge_envs.tools.dataset.importer import FLAGGED_DIFFERENCE, BaselineRow, ImportedTrials


def import_document(imports: Sequence[ImportedTrials]) -> Document:
    """Return the own baselines beside the paper's, one row per metric, and the imported drivers."""
    baselines = [
        {"name": one.variant.name, "trials": f"{one.used} trials, {one.left_out} left out", "row": row}
        for one in imports
        for row in one.rows
    ]
    drivers = [
        {"name": one.variant.name, "driver": driver} for one in imports if one.record for driver in one.record.drivers
    ]
    flagged = sum(row.is_flagged for one in imports for row in one.rows)
    note = f"{flagged} baselines differ from the published ones by more than {100 * FLAGGED_DIFFERENCE:.0f} %"
    return Document(
        parts=(
            Table(columns=BASELINE_COLUMNS, rows=baselines),
            *([Table(title="Drivers", columns=DRIVER_COLUMNS, rows=drivers)] if drivers else []),
            Paragraph(""),
            Paragraph(note, Tone.WARNING if flagged else Tone.NOTE),
        )
    )


def status_table(rows: Sequence[dict[str, Any]]) -> Table:
    """Return the rows of `status_rows` as a table."""
    return Table(columns=STATUS_COLUMNS, rows=rows, notes=(STATUS_NOTE,))


def _grade_text(row: Mapping[str, Any]) -> str:
    grade = f"{row['grade']}, imported" if row["imported"] else row["grade"]
    return f"{grade}; task file changed" if row["is_current"] is False else grade


def _drivers_text(drivers: Sequence[Mapping[str, Any]]) -> str:
    return ", ".join(f"{driver['body']}: {driver['provenance']}" for driver in drivers) or "-"


def _baselines_text(lines: Sequence[Mapping[str, Any]]) -> str:
    texts = []
    for line in lines:
        own, published = (_spread(line[f"{whose}_mean"], line[f"{whose}_std"]) for whose in ("own", "published"))
        texts.append(f"{METRIC_TITLES[line['metric']]} own {own}, published {published}")
    return "; ".join(texts)


def _spread(mean: float | None, std: float | None) -> str:
    if mean is None:
        return "-"
    return f"{mean:.4g}" if std is None else f"{mean:.4g} ({std:.3g})"


def _own(row: BaselineRow) -> str:
    if row.own is None:
        return "-"
    return with_unit(_spread(row.own.mean, row.own.std), row.unit)


def _published(row: BaselineRow) -> str:
    return _spread(row.published.mean, row.published.std) if row.published else "-"


def _difference(row: BaselineRow) -> str:
    return "-" if row.difference is None else f"{100 * row.difference:+.1f} %"


def _flag_style(row: BaselineRow) -> str:
    return "yellow" if row.is_flagged else ""


def _amounts(length_mm: float | None, angle_deg: float | None) -> str:
    amounts = ((length_mm, "mm"), (angle_deg, "deg"))
    return ", ".join(f"{value:.2g} {unit}" for value, unit in amounts if value is not None) or "-"


BASELINE_COLUMNS = (
    Column("name", "experiment", place=Place.HEADING),
    Column("trials", "", place=Place.HEADING),
    Column("row.metric", "metric", METRIC_TITLES.__getitem__),
    Column("row", "own baseline", _own, is_number=True),
    Column("row", "published", _published, is_number=True),
    Column("row", "difference", _difference, is_number=True, style=_flag_style),
)

DRIVER_COLUMNS = (
    Column("name", "experiment", place=Place.HEADING),
    Column("driver.body", "body"),
    Column("driver.trial_count", "trials", is_number=True),
    Column("driver", "left out by its motions", lambda one: _amounts(one.residual_mm, one.residual_deg)),
    Column("driver.start_offset_mm", "start off by", lambda value: f"{value:.2g} mm", is_number=True),
    Column("driver", "scatter", lambda one: _amounts(one.scatter_mm, one.scatter_deg)),
)

STATUS_COLUMNS = (
    Column("id", "experiment", short_id),
    Column("", "grade", _grade_text),
    Column("trials", "trials", is_number=True),
    Column("drivers", "driver", _drivers_text),
    Column("baselines", "baselines", _baselines_text, place=Place.BELOW),
)

STATUS_NOTE = (
    "Baselines: mean (standard deviation) of the real trials. Own: from the trials of the reference band. Published: "
    "from the paper, Table 5."
)
