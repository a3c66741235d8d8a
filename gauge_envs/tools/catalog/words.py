"""Experiments and control tasks in words: the list, and each in full."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from gauge_envs.envs.control.tasks import control_tasks
from gauge_envs.experiments.experiment import AssetKind
from gauge_envs.pages.document import Document, Heading, Paragraph, Part, Tone
from gauge_envs.pages.results import convergence_text
from gauge_envs.pages.table import Column, Facts, Place, Table
from gauge_envs.pages.text import (
    ENGINE_TITLES,
    GRADE_NOTES,
    METRIC_TITLES,
    NORMALIZED_NOTE,
    number_text,
    pairs_text,
    plus_minus_text,
    short_id,
    shortened,
    vector_text,
    with_unit,
)
from gauge_envs.references.bands import BandGrade, SigmaSource

SIGMA_NOTES = {
    SigmaSource.TRIALS: "scatter of the trials, per frame",
    SigmaSource.BASELINE: "from the published scatter, constant and the same for each coordinate",
    SigmaSource.MEASUREMENT: "uncertainty of the measurement; the scatter of trials is not known",
    SigmaSource.MODEL: "uncertainty of the solution; the scatter of trials is not published",
}


def list_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return the rows of `list_rows` as a table."""
    imported = [short_id(row["id"]) for row in rows if row["imported"]]
    # An engine that runs nothing is not installed or broken; it is no exception in each row.
    working = {name for row in rows for name, lacks in row["backends"].items() if not lacks}
    return Table(
        columns=(
            Column("id", "id"),
            Column("group", "group", wide_only=True),
            Column("observable", "observable", wide_only=True),
            Column("frames", "frames", is_number=True, wide_only=True),
            Column("grade", "grade"),
            Column("imported", "imported trials", lambda known: "yes" if known else "no", wide_only=True),
            Column("backends", "runs on", partial(_usable_text, working=working)),
        ),
        rows=rows,
        notes=(f"Real trials imported for {shortened(imported)}.",) if imported else (),
    )


def _usable_text(backends: Mapping[str, Sequence[str]], *, working: Collection[str]) -> str:
    """Return the engines that run an experiment, of those that run any."""
    usable = [name for name, lacks in backends.items() if not lacks]
    others = [name for name, lacks in backends.items() if lacks and name in working]
    if len(usable) > 2 and len(others) < 2:
        return f"all {len(usable)}" if not others else f"all but {others[0]}"
    return ", ".join(usable) or "none"


def control_summary() -> str:
    """Return the control tasks in a line."""
    ids = [task.id for task in control_tasks()]
    return f"extra, {len(ids)} control tasks whose optimum a law gives: {shortened(ids)}; gauge show explains one"


def control_document(values: Mapping[str, Any]) -> Document:
    """Return the dictionary of `control_description` in words."""
    limit = values["limit"]
    value = with_unit(f"{limit['value']:.4g} +- {limit['sigma']:.2g}", limit["unit"])
    facts = {
        "scene": f"that of {values['scene']}, with the action instead of the driver",
        "episode": f"{values['duration_s']:g} s, one step is 1/30 s",
        "observed": ", ".join(values["observed"]),
        "law": limit["law"],
        "limit": f"{limit['quantity']}: {value}",
        "uncertainty": limit["sigma_source"],
    }
    title = Paragraph(f"{values['id']}  control task", Tone.ANSWER)
    return Document(parts=(title, Facts(facts), Heading("Task"), Paragraph(values["task"])), rows=[values])


def experiment_document(values: Mapping[str, Any]) -> Document:
    """Return the dictionary of `description` in words."""
    sets = {
        name: chosen["summary"] + (f": {pairs_text(chosen['values'])}" if chosen["values"] else "")
        for name, chosen in values["parameter_sets"].items()
    }
    return Document(
        parts=(
            Paragraph(f"{values['id']}  {values['title']}", Tone.ANSWER),
            Paragraph(values["summary"]),
            Paragraph(""),
            Facts(_facts(values)),
            *_scene(values),
            Heading("Constants"),
            Facts({name: pairs_text(table) for name, table in values["constants"].items()}),
            Heading("Where the numbers are from"),
            Facts(values["provenance"]),
            Heading("Decisions"),
            *(Paragraph(f"- {line}") for line in values["decisions"] or ["none"]),
            Heading("Parameter sets"),
            Facts(sets),
            _published(values),
        ),
        rows=[values],
    )


def _facts(values: Mapping[str, Any]) -> dict[str, str]:
    observable, reference, asset = values["observable"], values["reference"], values["asset"]
    grade = BandGrade(reference["grade"])
    trials, note = f", {reference['trial_count']} trials" if reference["trial_count"] else "", GRADE_NOTES[grade]
    if reference["single_shot"]:
        trials, note = "", "one real trial with the same start; each trial has its own"
    withheld = ", recording withheld" if reference["withheld"] is not None else ""
    facts = {
        "evaluates": ", ".join(values["evaluates"]),
        "sources": "; ".join(f"{key}: {text}" for key, text in values["source"].items()),
        "episode": f"{values['frames']} frames at 30 Hz, {values['duration_s']:.3f} s",
        "g(t)": f"{observable['kind']} [{observable['unit']}]: {shortened(observable['coordinates'])}",
        "grade": f"{grade.value}{trials} ({note}){withheld}",
        "reference": reference["source"] or reference["law"] or "none",
    }
    if asset is not None:
        facts["asset"] = f"{asset['file']}, sha256 {asset['sha256'][:8]}"
        if asset["kind"] != AssetKind.EXPERIMENT:
            facts["edited"] = "; ".join(asset["changes"]) or "no: the calibrated scene"
    facts |= _band_facts(values)
    facts |= {f"on {name}": "; ".join(lacks) or "runs" for name, lacks in values["backends"].items()}
    has_cells = any(body["kind"] != "rigid" for body in values["bodies"])
    return facts | {
        f"convergence, {name}": convergence_text(rows, has_cells=has_cells, with_unit=True)
        for name, rows in values["convergence"].items()
        if not values["backends"].get(name)
    }


def _band_facts(values: Mapping[str, Any]) -> dict[str, str]:
    """Return the limits of a band: known frames, source of sigma, why it is withheld."""
    reference = values["reference"]
    facts = {}
    if reference["known_frames"] is not None and reference["known_frames"] < values["frames"]:
        facts["known"] = f"{reference['known_frames']} of {values['frames']} frames"
    if reference["sigma_source"] is not None:
        facts["sigma"] = SIGMA_NOTES[SigmaSource(reference["sigma_source"])]
    if reference["single_shot"]:
        facts["normalized"] = "no: a single trial has no scatter; a reset with a trial or a seed selects another one"
    elif reference["normalized_by_baseline"] is False:
        facts["normalized"] = "no: the published baseline is of another span of the motion"
    if reference["withheld"] is not None:
        facts["withheld"] = f"{reference['withheld']}; use_withheld=True or gauge score --use withheld scores on it"
    return facts


def _scene(values: Mapping[str, Any]) -> Iterator[Part]:
    def name(body: Mapping[str, Any]) -> str:
        return body["name"] + (" (recorded)" if body["recorded"] else "")

    yield Table(
        title="Bodies",
        columns=(
            Column("", "name", name),
            Column("", "motion", lambda body: body.get("motion", body["kind"])),
            Column("", "mass [kg]", lambda body: f"{body['mass_kg']:.10g}" if body["mass_kg"] else "-", is_number=True),
            Column("position_m", "position [m]", vector_text),
            Column("quaternion_wxyz", "quaternion wxyz", vector_text),
            Column("", "shape", _shape, place=Place.BELOW),
        ),
        rows=values["bodies"],
    )
    yield Table(
        title="Contacts",
        columns=(
            Column("first", "first", shortened),
            Column("second", "second", shortened),
            Column("friction", "friction", is_number=True),
            Column("restitution", "restitution", is_number=True),
            Column("mode", "mode"),
        ),
        rows=values["contacts"],
    )
    if joints := (*values["joints"], *values["attachments"]):
        yield Heading("Joints")
        yield from (Paragraph(pairs_text(joint)) for joint in joints)
    if values["air"] is not None:
        yield Heading("Air")
        yield Paragraph(pairs_text(values["air"]))
    for driver in values["drivers"]:
        yield Heading(f"Driver of {driver['body']} ({driver['provenance']})")
        yield Paragraph(driver["note"])
        yield from (Paragraph(f"  {pairs_text(motion)}") for motion in driver["motions"])


def _shape(body: Mapping[str, Any]) -> str:
    shape = dict(body.get("shape") or {"kind": body["kind"]})
    kind = shape.pop("kind")
    if "pieces_m" in shape:
        return f"{kind}, {len(shape['pieces_m'])} pieces"
    skip = ("name", "kind", "recorded", "motion", "shape", "mass_kg", "position_m", "quaternion_wxyz")
    return " ".join(filter(None, (kind, pairs_text(shape), pairs_text(body, skip=skip))))


def _published(values: Mapping[str, Any]) -> Table:
    def trials(line: Mapping[str, Any]) -> str:
        return plus_minus_text(line["mean"], line["std"], line["unit"])

    return Table(
        title="Published",
        columns=(
            Column("metric", "metric", METRIC_TITLES.__getitem__),
            Column("", "real trials", trials, is_number=True),
            *(Column(f"engines.{key}", title, number_text, is_number=True) for key, title in ENGINE_TITLES.items()),
        ),
        rows=values["baselines"],
        notes=(NORMALIZED_NOTE,),
    )
