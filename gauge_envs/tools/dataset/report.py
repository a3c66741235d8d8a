"""Report imports and the state of the dataset."""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Any

from gauge_envs.errors import ReferenceFileError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.task_files import task_sha256
from gauge_envs.experiments.variants import Variant
from gauge_envs.files import json_ready
from gauge_envs.pages.document import Document, Paragraph, Part, Tone
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import (
    METRIC_TITLES,
    counted,
    short_id,
    with_unit,
)
from gauge_envs.references.band import load_band
from gauge_envs.references.imported import (
    DriverRecord,
    SpreadRecord,
    load_imported,
)
from gauge_envs.references.kind import Kind
from gauge_envs.references.published import published_baselines
from gauge_envs.references.user_data import DataSource
from gauge_envs.scoring.reference import reference_kind
from gauge_envs.tools.dataset.findings import ImportFinding
from gauge_envs.tools.dataset.importer import (
    FLAGGED_DIFFERENCE,
    ImportedTrials,
    baseline_lines,
)
from gauge_envs.tools.dataset.schema import BaselineLine

STATUS_NOTE = "Baselines: mean (standard deviation) of the real trials, imported and published in the paper (Table 5)."

MAX_LINES = 20
"""Maximum number of baselines that an import shows in full."""


def import_document(
    imports: Sequence[ImportedTrials], findings: Iterable[ImportFinding]
) -> Document:
    """Return what was left out, and the imported and published baselines; of many baselines, only the flagged ones."""
    lines = [(trials, line) for trials in imports for line in trials.baselines]
    flagged = [(trials, line) for trials, line in lines if line["flagged"]]
    shown = flagged
    if len(lines) <= MAX_LINES:
        shown = lines
    rows = [
        {
            "id": trials.variant.id,
            "trials": f"{counted(trials.used, 'trial')}, {trials.left_out} left out",
            "line": line,
        }
        for trials, line in shown
    ]
    note = (
        f"{len(flagged)} of {counted(len(lines), 'baseline')} differ from published baselines by more than "
        f"{100 * FLAGGED_DIFFERENCE:.0f} % and their sampling. All baselines: gauge list references"
    )
    tone = Tone.WARNING if flagged else Tone.NOTE
    parts: list[Part] = [Paragraph(""), Paragraph(note, tone)]
    if rows:
        parts.insert(0, Table(columns=BASELINE_COLUMNS, rows=rows))
    left_out = [
        {"file": finding.file, "reason": str(finding).removeprefix(f"{finding.file}: ")}
        for finding in findings
        if finding.left_out
    ]
    if left_out:
        parts.insert(0, Table(columns=LEFT_OUT_COLUMNS, rows=left_out))
    return Document(parts=parts)


def _percent(share: float) -> str:
    return f"{100 * share:+.1f} %"


def _spread(source: str, line: Mapping[str, Any]) -> str:
    """Return mean and standard deviation of a source of a baseline."""
    mean, std = line[f"{source}_mean"], line[f"{source}_std"]
    if mean is None:
        return "-"
    text = f"{mean:.4g}"
    if std is not None:
        text += f" ({std:.3g})"
    return with_unit(text, line["unit"])


LEFT_OUT_COLUMNS = (Column("file", "left out"), Column("reason", "reason"))
"""Columns of the trials that an import leaves out."""

BASELINE_COLUMNS = (
    Column("id", "experiment", short_id, place=Place.HEADING),
    Column("trials", "", place=Place.HEADING),
    Column("line.metric", "metric", METRIC_TITLES.__getitem__),
    Column("line", "imported", partial(_spread, "own"), is_number=True),
    Column("line", "published", partial(_spread, "published"), is_number=True),
    Column("line.difference", "difference", _percent, is_number=True),
)
"""Columns of the baselines of an import."""


def status_table(rows: Sequence[dict[str, Any]]) -> Table:
    """Return the rows of `status_row` as a table."""

    def kind(row: Mapping[str, Any]) -> str:
        if row["fault"]:
            return row["fault"]
        text = row["kind"]
        if row["imported"]:
            text += ", imported"
        if row["is_current"] is False:
            text += "; task file changed"
        return text

    def baselines(lines: Sequence[BaselineLine]) -> str:
        return "; ".join(
            f"{METRIC_TITLES[line['metric']]} imported {_spread('own', line)}, published {_spread('published', line)}"
            for line in lines
        )

    def drivers(bodies: Sequence[Mapping[str, Any]]) -> str:
        texts = [f"{driver['body']}: {driver['provenance']}" for driver in bodies]
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
    """Return the reference and the prescribed motions of a variant as a `schema.StatusLine`."""
    try:
        return {"id": variant.id, "fault": None, **_status(variant)}
    except ReferenceFileError as error:
        nothing = dict.fromkeys(("trials", "revision", "is_current"))
        empty: dict[str, Any] = {"drivers": [], "baselines": []}
        state = {"kind": Kind.NONE.value, "imported": False, "fault": str(error)}
        return {"id": variant.id, **state, **nothing, **empty}


def _status(variant: Variant) -> dict[str, Any]:
    """Return the entries of a `schema.StatusLine` that need the files of the reference."""
    source, facts = DataSource.BUNDLED, None
    records: Sequence[DriverRecord] = ()
    metrics: Mapping[str, SpreadRecord] = {}
    if (imported := load_imported(variant.name)) is not None:
        source, facts = DataSource.IMPORTED, imported.facts
        records, metrics = facts.drivers, facts.metrics
    band = load_band(variant.name, source)
    scene = load_experiment(variant, drivers=source).scene
    recorded = {record.body: record.model_dump() for record in records}
    drivers = [
        {
            "body": driver.body,
            "provenance": driver.provenance,
            "recorded": recorded.get(driver.body),
        }
        for driver in scene.drivers
    ]
    published = published_baselines(variant.name)
    return json_ready(
        {
            "kind": reference_kind(variant.name, source).value,
            "imported": facts is not None,
            "trials": band and band.trial_count,
            "revision": facts and facts.revision,
            "is_current": facts and facts.task_sha256 == task_sha256(variant.family),
            "drivers": drivers,
            "baselines": baseline_lines(metrics, published),
        }
    )
