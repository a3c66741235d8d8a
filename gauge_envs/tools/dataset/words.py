"""Tables of imports and of the state of the dataset."""

from collections.abc import Mapping, Sequence
from typing import Any

from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.task_files import task_sha256
from gauge_envs.experiments.variants import Variant
from gauge_envs.files import json_ready
from gauge_envs.pages.document import Document, Paragraph, Tone
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import METRIC_TITLES, short_id, with_unit
from gauge_envs.references.band import load_band
from gauge_envs.references.imported import load_imported
from gauge_envs.references.published import published_baselines
from gauge_envs.references.user_data import DataSource
from gauge_envs.scoring.reference import reference_kind
from gauge_envs.tools.dataset.importer import (
    FLAGGED_DIFFERENCE,
    ImportedTrials,
    baseline_lines,
)
from gauge_envs.tools.dataset.lines import BaselineLine

STATUS_NOTE = (
    "Baselines: mean (standard deviation) of the real trials. Own: from imported trials. Published: from the paper, "
    "Table 5."
)

EXPERIMENT = Column("id", "experiment", short_id, place=Place.HEADING)


def import_document(imports: Sequence[ImportedTrials]) -> Document:
    """Return the own baselines beside the paper's, one row per metric, and the imported drivers."""
    flagged = sum(line["flagged"] for one in imports for line in one.baselines)
    note = f"{flagged} baselines differ from the published ones by more than {100 * FLAGGED_DIFFERENCE:.0f} %"
    drivers = [
        {"id": one.variant.id, **driver.model_dump()}
        for one in imports
        if one.facts
        for driver in one.facts.drivers
    ]
    return Document(
        parts=[
            _baselines_table(imports),
            *([_drivers_table(drivers)] if drivers else []),
            Paragraph(""),
            Paragraph(note, Tone.WARNING if flagged else Tone.NOTE),
        ]
    )


def _baselines_table(imports: Sequence[ImportedTrials]) -> Table:
    return Table(
        columns=(
            EXPERIMENT,
            Column("trials", "", place=Place.HEADING),
            Column("line.metric", "metric", METRIC_TITLES.__getitem__),
            Column("line", "own baseline", _own, is_number=True),
            Column("line", "published", _published, is_number=True),
            Column(
                "line.difference",
                "difference",
                lambda value: f"{100 * value:+.1f} %",
                is_number=True,
                style=lambda value: (
                    "yellow" if abs(value or 0.0) > FLAGGED_DIFFERENCE else ""
                ),
            ),
        ),
        rows=[
            {
                "id": one.variant.id,
                "trials": f"{one.used} trials, {one.left_out} left out",
                "line": line,
            }
            for one in imports
            for line in one.baselines
        ],
    )


def _drivers_table(drivers: Sequence[Mapping[str, Any]]) -> Table:
    def amounts(name: str) -> Column:
        def text(driver: Mapping[str, Any]) -> str:
            values = {unit: driver[f"{name}_{unit}"] for unit in ("mm", "deg")}
            known = {unit: value for unit, value in values.items() if value is not None}
            return ", ".join(f"{value:.2g} {unit}" for unit, value in known.items())

        titles = {"residual": "left out by its motions", "scatter": "scatter"}
        return Column("", titles[name], text)

    return Table(
        title="Drivers",
        columns=(
            EXPERIMENT,
            Column("body", "body"),
            Column("trial_count", "trials", is_number=True),
            amounts("residual"),
            Column(
                "start_offset_mm",
                "start off by",
                lambda value: f"{value:.2g} mm",
                is_number=True,
            ),
            amounts("scatter"),
        ),
        rows=drivers,
    )


def _own(line: BaselineLine) -> str:
    text = _spread(line["own_mean"], line["own_std"])
    return text if text == "-" else with_unit(text, line["unit"])


def _published(line: BaselineLine) -> str:
    return _spread(line["published_mean"], line["published_std"])


def _spread(mean: float | None, std: float | None) -> str:
    if mean is None:
        return "-"
    return f"{mean:.4g}" if std is None else f"{mean:.4g} ({std:.3g})"


def status_table(rows: Sequence[dict[str, Any]]) -> Table:
    """Return the rows of `status_row` as a table."""

    def kind(row: Mapping[str, Any]) -> str:
        text = f"{row['kind']}, imported" if row["imported"] else row["kind"]
        return f"{text}; task file changed" if row["is_current"] is False else text

    def baselines(lines: Sequence[BaselineLine]) -> str:
        return "; ".join(
            f"{METRIC_TITLES[line['metric']]} own {_spread(line['own_mean'], line['own_std'])}, "
            f"published {_published(line)}"
            for line in lines
        )

    def drivers(moved: Sequence[Mapping[str, Any]]) -> str:
        texts = (f"{driver['body']}: {driver['provenance']}" for driver in moved)
        return ", ".join(texts) or "-"

    return Table(
        columns=(
            Column("id", "experiment", short_id),
            Column("", "reference", kind),
            Column("trials", "trials", is_number=True),
            Column("drivers", "driver", drivers),
            Column("baselines", "baselines", baselines, place=Place.BELOW),
        ),
        rows=rows,
        notes=(STATUS_NOTE,),
    )


def status_row(variant: Variant) -> dict[str, Any]:
    """Return the reference and the drivers of a variant, JSON-ready, as `lines.StatusLine`."""
    imported = load_imported(variant.name)
    source = DataSource.BUNDLED if imported is None else DataSource.IMPORTED
    experiment = load_experiment(variant, drivers=source)
    band = load_band(variant.name, source)
    facts = imported and imported.facts
    recorded = {one.body: one.model_dump() for one in facts.drivers} if facts else {}
    is_current = facts and facts.task_sha256 == task_sha256(variant.family)
    return json_ready(
        {
            "id": variant.id,
            "kind": reference_kind(variant.name, source).value,
            "imported": facts is not None,
            "trials": band and band.trial_count,
            "revision": facts and facts.revision,
            "is_current": is_current,
            "drivers": [
                {
                    "body": driver.body,
                    "provenance": driver.provenance,
                    "recorded": recorded.get(driver.body),
                }
                for driver in experiment.scene.drivers
            ],
            "baselines": baseline_lines(
                facts.metrics if facts else {}, published_baselines(variant.name)
            ),
        }
    )
