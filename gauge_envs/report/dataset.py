"""Tables of imports and of the dataset's state, for reading."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Group
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from gauge_envs.dataset.importer import FLAGGED_DIFFERENCE, BaselineRow, ImportedTrials
from gauge_envs.references.imported import DriverRecord
from gauge_envs.report.text import METRIC_TITLES

__all__ = [
    "import_view",
    "status_table",
]


def import_view(imports: Sequence[ImportedTrials]) -> Group:
    """Own baselines beside the paper's, one row a metric, and the imported drivers."""
    table = _table("experiment", "trials", "left out", "metric", "own baseline", "published", "difference")
    for one in imports:
        for number, row in enumerate(one.rows):
            shown = (one.variant.name, str(one.used), str(one.left_out)) if number == 0 else ("", "", "")
            table.add_row(*shown, METRIC_TITLES[row.metric], _own(row), _published(row), _difference(row))
    parts: list[Any] = [table]
    driven = [(one.variant.name, driver) for one in imports if one.record for driver in one.record.drivers]
    if driven:
        drivers = _table("experiment", "driver", "trials", "left out by its motions", "start off by", "scatter")
        for name, driver in driven:
            drivers.add_row(name, *_driver(driver))
        parts += [Text(""), drivers]
    flagged = sum(row.is_flagged for one in imports for row in one.rows)
    note = f"{flagged} baselines differ from the published ones by more than {100 * FLAGGED_DIFFERENCE:.0f} %"
    parts += [Text(""), Text(note, style="yellow" if flagged else "dim")]
    return Group(*parts)


def status_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Rows of `status_rows` as a table."""
    table = _table("experiment", "grade", "trials", "driver", "metric", "own baseline", "published")
    for row in rows:
        grade = f"{row['grade']}, imported" if row["imported"] else row["grade"]
        grade += "; task file changed" if row["is_current"] is False else ""
        drivers = ", ".join(f"{driver['body']}: {driver['provenance']}" for driver in row["drivers"]) or "-"
        first = (row["id"].removeprefix("GAUGE/"), grade, str(row["trials"] or "-"), drivers)
        for number, line in enumerate(row["baselines"] or [None]):
            cells = first if number == 0 else ("", "", "", "")
            if line is None:
                table.add_row(*cells, "-", "-", "-")
                continue
            own = _spread(line["own_mean"], line["own_std"])
            published = _spread(line["published_mean"], line["published_std"])
            table.add_row(*cells, METRIC_TITLES[line["metric"]], own, published)
    return table


def _table(*titles: str) -> Table:
    table = Table(box=None, header_style="bold", pad_edge=False)
    for title in titles:
        table.add_column(escape(title), overflow="fold")
    return table


def _spread(mean: float | None, std: float | None) -> str:
    if mean is None:
        return "-"
    return f"{mean:.4g}" if std is None else f"{mean:.4g} ({std:.3g})"


def _own(row: BaselineRow) -> str:
    if row.own is None:
        return "-"
    return f"{_spread(row.own.mean, row.own.std)}{'' if row.unit == '1' else f' {row.unit}'}"


def _published(row: BaselineRow) -> str:
    return _spread(row.published.mean, row.published.std) if row.published else "-"


def _difference(row: BaselineRow) -> str:
    if row.difference is None:
        return "-"
    text = f"{100 * row.difference:+.1f} %"
    return f"[yellow]{text}[/]" if row.is_flagged else text


def _driver(driver: DriverRecord) -> tuple[str, ...]:
    return (
        driver.body,
        str(driver.trial_count),
        _amounts(driver.residual_mm, driver.residual_deg),
        f"{driver.start_offset_mm:.2g} mm",
        _amounts(driver.scatter_mm, driver.scatter_deg),
    )


def _amounts(length_mm: float | None, angle_deg: float | None) -> str:
    amounts = ((length_mm, "mm"), (angle_deg, "deg"))
    return ", ".join(f"{value:.2g} {unit}" for value, unit in amounts if value is not None) or "-"
