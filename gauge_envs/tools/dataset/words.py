"""Tables of imports and of the state of the dataset."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.task_files import task_sha256
from gauge_envs.experiments.variants import Variant
from gauge_envs.files import json_ready
from gauge_envs.pages.document import Document, Paragraph, Tone
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import METRIC_TITLES, short_id, with_unit
from gauge_envs.references.band import bundled_sidecar
from gauge_envs.references.imported import load_imported
from gauge_envs.references.published import published_baselines
from gauge_envs.references.user_data import DataSource
from gauge_envs.scoring.reference import band_grade, load_band
from gauge_envs.tools.dataset.importer import (
    FLAGGED_DIFFERENCE,
    BaselineRow,
    ImportedTrials,
)

STATUS_NOTE = (
    "Baselines: mean (standard deviation) of the real trials. Own: from the trials of the reference band. Published: "
    "from the paper, Table 5."
)

EXPERIMENT = Column("name", "experiment", place=Place.HEADING)


def import_document(imports: Sequence[ImportedTrials]) -> Document:
    """Return the own baselines beside the paper's, one row per metric, and the imported drivers."""
    flagged = sum(row.is_flagged for one in imports for row in one.rows)
    note = f"{flagged} baselines differ from the published ones by more than {100 * FLAGGED_DIFFERENCE:.0f} %"
    drivers = [
        {"name": one.variant.name, "driver": driver}
        for one in imports
        if one.record
        for driver in one.record.drivers
    ]
    tables = [
        _baselines_table(imports),
        *([_drivers_table(drivers)] if drivers else []),
    ]
    return Document(
        parts=[
            *tables,
            Paragraph(""),
            Paragraph(note, Tone.WARNING if flagged else Tone.NOTE),
        ]
    )


def _baselines_table(imports: Sequence[ImportedTrials]) -> Table:
    def imported(row: BaselineRow) -> str:
        return (
            "-"
            if row.imported is None
            else with_unit(_spread(row.imported.mean, row.imported.std), row.unit)
        )

    def published(row: BaselineRow) -> str:
        return _spread(row.published.mean, row.published.std) if row.published else "-"

    def difference(row: BaselineRow) -> str:
        return "-" if row.difference is None else f"{100 * row.difference:+.1f} %"

    def style(row: BaselineRow) -> str:
        return "yellow" if row.is_flagged else ""

    return Table(
        columns=(
            EXPERIMENT,
            Column("trials", "", place=Place.HEADING),
            Column("row.metric", "metric", METRIC_TITLES.__getitem__),
            Column("row", "own baseline", imported, is_number=True),
            Column("row", "published", published, is_number=True),
            Column("row", "difference", difference, is_number=True, style=style),
        ),
        rows=[
            {
                "name": one.variant.name,
                "trials": f"{one.used} trials, {one.left_out} left out",
                "row": row,
            }
            for one in imports
            for row in one.rows
        ],
    )


def _drivers_table(drivers: Sequence[Mapping[str, Any]]) -> Table:
    def amounts(length_mm: float | None, angle_deg: float | None) -> str:
        texts = (
            f"{value:.2g} {unit}"
            for value, unit in ((length_mm, "mm"), (angle_deg, "deg"))
            if value is not None
        )
        return ", ".join(texts) or "-"

    return Table(
        title="Drivers",
        columns=(
            EXPERIMENT,
            Column("driver.body", "body"),
            Column("driver.trial_count", "trials", is_number=True),
            Column(
                "driver",
                "left out by its motions",
                lambda one: amounts(one.residual_mm, one.residual_deg),
            ),
            Column(
                "driver.start_offset_mm",
                "start off by",
                lambda value: f"{value:.2g} mm",
                is_number=True,
            ),
            Column(
                "driver",
                "scatter",
                lambda one: amounts(one.scatter_mm, one.scatter_deg),
            ),
        ),
        rows=drivers,
    )


def status_table(rows: Sequence[dict[str, Any]]) -> Table:
    """Return the rows of `status_rows` as a table."""

    def grade(row: Mapping[str, Any]) -> str:
        text = f"{row['grade']}, imported" if row["imported"] else row["grade"]
        return f"{text}; task file changed" if row["is_current"] is False else text

    def baseline(line: Mapping[str, Any]) -> str:
        imported, published = (
            _spread(line[f"{whose}_mean"], line[f"{whose}_std"])
            for whose in ("own", "published")
        )
        return f"{METRIC_TITLES[line['metric']]} own {imported}, published {published}"

    def drivers(moved: Sequence[Mapping[str, Any]]) -> str:
        return (
            ", ".join(f"{driver['body']}: {driver['provenance']}" for driver in moved)
            or "-"
        )

    return Table(
        columns=(
            Column("id", "experiment", short_id),
            Column("", "grade", grade),
            Column("trials", "trials", is_number=True),
            Column("drivers", "driver", drivers),
            Column(
                "baselines",
                "baselines",
                lambda lines: "; ".join(map(baseline, lines)),
                place=Place.BELOW,
            ),
        ),
        rows=rows,
        notes=(STATUS_NOTE,),
    )


def _spread(mean: float | None, std: float | None) -> str:
    if mean is None:
        return "-"
    return f"{mean:.4g}" if std is None else f"{mean:.4g} ({std:.3g})"


def status_rows(variants: Iterable[Variant]) -> list[dict[str, Any]]:
    """Return one JSON-ready row per variant.

    Keys: `id`, `grade`, `imported`, `trials`, `revision`, `is_current` (whether the task file is unchanged since the
    import; None without an import), `drivers` (body, provenance, and the record of an imported driver) and `baselines`
    (metric, own and published mean and standard deviation).
    """
    return [_row(variant) for variant in variants]


def _row(variant: Variant) -> dict[str, Any]:
    imported = load_imported(variant.name)
    source = DataSource.BUNDLED if imported is None else DataSource.IMPORTED
    experiment, band = (
        load_experiment(variant, drivers=source),
        load_band(variant.name, source),
    )
    record = imported.record if imported else None
    recorded = (
        {driver.body: driver.model_dump() for driver in record.drivers}
        if record
        else {}
    )
    return json_ready(
        {
            "id": variant.id,
            "grade": band_grade(variant.name, source).value,
            "imported": record is not None,
            "trials": band.trial_count if band else None,
            "revision": record.revision if record else None,
            "is_current": record.task_sha256 == task_sha256(variant.family)
            if record
            else None,
            "drivers": [
                {
                    "body": driver.body,
                    "provenance": driver.provenance,
                    "recorded": recorded.get(driver.body),
                }
                for driver in experiment.scene.drivers
            ],
            "baselines": _baselines(variant),
        }
    )


def _baselines(variant: Variant) -> list[dict[str, Any]]:
    """Return mean and standard deviation of each metric: own are those of the trials of the band."""
    published, imported = published_baselines(variant.name), load_imported(variant.name)
    sidecar = bundled_sidecar(variant.name) if imported is None else None
    scores = {} if sidecar is None else {"rmse": sidecar.rmse, "dtw": sidecar.dtw}
    of_trials = (
        imported.record.metrics
        if imported
        else {metric: score for metric, score in scores.items() if score}
    )
    return [
        {
            "metric": metric,
            **{
                f"{whose}_{key}": getattr(spreads.get(metric), key, None)
                for whose, spreads in (("own", of_trials), ("published", published))
                for key in ("mean", "std")
            },
        }
        for metric in dict.fromkeys([*published, *of_trials])
    ]
