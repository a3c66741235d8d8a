"""Experiments in words: the list, and each in full."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from gauge_envs.envs.arguments import EnvArguments
from gauge_envs.experiments.experiment import AssetKind
from gauge_envs.pages.document import Bullets, Document, Heading, Paragraph, Part, Tone
from gauge_envs.pages.results import convergence_text
from gauge_envs.pages.table import Column, Facts, Place, Table
from gauge_envs.pages.text import (
    GRADE_NOTES,
    METRIC_TITLES,
    NORMALIZED_NOTE,
    pairs_text,
    plus_minus_text,
    score_text,
    shortened,
    vector_text,
)
from gauge_envs.references.band import SigmaSource
from gauge_envs.references.kind import Kind
from gauge_envs.references.published import PUBLISHED_ENGINES
from gauge_envs.tools.catalog.spaces import range_text, shape_text

SIGMA_NOTES = {
    SigmaSource.TRIALS: "scatter of the trials, per frame",
    SigmaSource.BASELINE: "from the published scatter, constant and the same for each coordinate",
    SigmaSource.MEASUREMENT: "uncertainty of the measurement; the scatter of trials is not known",
    SigmaSource.MODEL: "uncertainty of the solution; the scatter of trials is not published",
}

SHORT_NOTE = "Engines: score over that of real trials, as published (GAUGE, Table 5)."
OTHER_QUESTION = (
    "Published, over real trials (GAUGE, Table 5): another question than grade {grade}"
)


def experiment_document(values: Mapping[str, Any], *, detailed: bool) -> Document:
    """Return the dictionary of `description` in words.

    Args:
        values: The dictionary.
        detailed: Whether to add the scene, the source of each number, decisions and parameter sets to what fits a page.
    """
    short: tuple[Part, ...] = (
        Paragraph(f"{values['id']}  {values['title']}", Tone.ANSWER),
        Paragraph(values["summary"]),
        Paragraph(""),
        Facts(_facts(values)),
        Heading(_spaces_heading(values)),
        Facts(_entries([*values["action"], *values["observation"]])),
        *_engines(values),
        _published(values),
        *(
            [Bullets([limit_text(one) for one in values["limits"]], "Known limits")]
            if values["limits"]
            else []
        ),
        *(
            [Heading("Constants and driven motion")]
            if values["constants"] or values["drivers"]
            else []
        ),
        Facts(_constants(values["constants"])),
        *_drivers(values, detailed=detailed),
    )
    # The constants of an experiment file are those of its scene.
    if detailed or not values["constants"]:
        return Document(parts=(*short, *_details(values)), rows=[values])
    more = Paragraph("Scene, decisions and all sources: --format wide", Tone.NOTE)
    return Document(parts=(*short, more), rows=[values])


def _spaces_heading(values: Mapping[str, Any]) -> str:
    """Return the heading of the spaces, with the task of a policy where zero actions are near the best."""
    heading = "Action and observation"
    if values["drivers"] and values["reference"]["known_frames"]:
        heading += " (with drivers='action' driven bodies rest until actions move them)"
    return heading


def _facts(values: Mapping[str, Any]) -> dict[str, str]:
    observable, reference, asset = (
        values["observable"],
        values["reference"],
        values["asset"],
    )
    facts = {
        "evaluates": ", ".join(values["evaluates"]),
        "episode": f"{values['frames']} frames at 30 Hz, {values['duration_s']:.3f} s",
        "g(t)": f"{observable['kind']} [{observable['unit']}]: {shortened(observable['coordinates'])}",
        "grade": grade_text(reference),
        "reference": reference["source"] or reference["law"] or "none",
        "reward": reference["reward"],
    }
    if reference["deformation"]:
        facts["real"] = deformation_text(reference["deformation"])
    if asset is not None:
        facts["asset"] = f"{asset['file']}, sha256 {asset['sha256'][:8]}"
        if asset["kind"] != AssetKind.EXPERIMENT:
            facts["edited"] = "; ".join(asset["changes"]) or "no: the calibrated scene"
    return facts | _band_facts(values)


def _published(values: Mapping[str, Any]) -> Part:
    """Return the published scores, which are of reality whatever the grade of the reference."""
    if not values["baselines"]:
        return Paragraph("Published: none")
    grade = Kind(values["reference"]["grade"])
    if grade.is_solution:
        title, note = OTHER_QUESTION.format(grade=grade.value), ""
    else:
        title, note = "Published", SHORT_NOTE
    return published_table(values["baselines"], title=title, note=note)


def deformation_text(statistics: Sequence[Mapping[str, Any]]) -> str:
    """Return real statistics of deformation with their 95 % intervals."""
    texts = [
        f"{one['name']} {one['value']:.3g} +- {one['reach_95']:.2g}"
        + ("" if one["unit"] == "1" else f" {one['unit']}")
        for one in statistics
    ]
    count = statistics[0]["trial_count"]
    source = "one recording" if count == 1 else f"{count} trials"
    frame = statistics[0]["frame"]
    return f"{', '.join(texts)} at frame {frame} (95 %, {source})"


def grade_text(reference: Mapping[str, Any]) -> str:
    """Return the grade of a reference, what it means, and whether a recording is withheld."""
    count = None if reference["single_shot"] else reference["trial_count"]
    trials = f", {count} trials" if count else ""
    withheld = ", recording withheld" if reference["withheld"] is not None else ""
    return f"{reference['grade']}{trials} ({grade_note(reference)}){withheld}"


def grade_note(reference: Mapping[str, Any]) -> str:
    """Return what the grade of a reference means."""
    if reference["single_shot"]:
        return "one real trial with the same start; each trial has its own"
    return GRADE_NOTES[Kind(reference["grade"])]


def limit_text(limit: Mapping[str, Any]) -> str:
    """Return a known limit, with the study that shows it."""
    return limit["text"] + (f" (study: {limit['study']})" if limit["study"] else "")


def _constants(
    constants: Mapping[str, Mapping[str, Mapping[str, Any]]],
) -> dict[str, str]:
    """Return the constants of bodies that share them, those of a source before it."""
    names: dict[str, list[str]] = {}
    for name, table in constants.items():
        by_source: dict[str, dict[str, Any]] = {}
        for key, constant in table.items():
            by_source.setdefault(constant["source"], {})[key] = constant["value"]
        text = "; ".join(
            f"{pairs_text(group)} ({source})" for source, group in by_source.items()
        )
        names.setdefault(text, []).append(name)
    return {shortened(sharing): text for text, sharing in names.items()}


def _entries(rows: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return the entries of action and observation with their shapes, and what each holds."""
    found: dict[str, str] = {}
    for row in rows:
        key = f"{row['entry']} {shape_text(row['whole'])}".rstrip()
        text = f"{row['meaning']}, {range_text(row)}{'' if row['unit'] == '1' else ' ' + row['unit']}"
        found[key] = f"{found[key]}; {text}" if key in found else text
    return found


# --- engines ----------------------------------------------------------------------------------------------------------


def step_text(step_s: float) -> str:
    """Return a time step as a fraction of a second, or in seconds if it is none."""
    count = 1.0 / step_s
    return (
        f"1/{round(count)}"
        if abs(count - round(count)) < 1e-6 * count
        else f"{step_s:.4g}"
    )


def reasons_text(missing: Sequence[str]) -> str:
    """Return why an engine declines a scene: the first reason, and the number of the others; empty without any."""
    return (
        ""
        if not missing
        else missing[0]
        + (f" (and {len(missing) - 1} more)" if len(missing) > 1 else "")
    )


def _engines(values: Mapping[str, Any]) -> Iterator[Part]:
    """Yield the engines that build a scene, and why the others do not."""
    running = [row for row in values["engines"] if not row["missing"]]
    yield Table(
        title="Engines",
        columns=(
            Column(
                "engine",
                "engine",
                lambda name: (
                    f"{name} (default)" if name == EnvArguments.backend else name
                ),
            ),
            Column("preset", "preset"),
            Column("timestep_s", "step [s]", step_text, is_number=True),
            Column(
                "", "works here", lambda row: "yes" if row["fault"] is None else "no"
            ),
        ),
        rows=running,
        notes=tuple(row["fault"] for row in running if row["fault"] is not None),
    )
    yield Facts(
        {
            row["engine"]: f"no: {reasons_text(row['missing'])}"
            for row in values["engines"]
            if row["missing"]
        }
    )


def convergence_facts(values: Mapping[str, Any]) -> dict[str, str]:
    """Return what half the step and half the cell change, by engine, of those that were measured."""
    has_cells = any(body["kind"] != "rigid" for body in values["bodies"])
    is_verified = Kind(values["reference"]["grade"]).is_solution
    return {
        row["engine"]: convergence_text(
            row["convergence"],
            has_cells=has_cells,
            with_unit=True,
            over_trials=not is_verified,
        )
        for row in values["engines"]
        if row["convergence"]
    }


# --- details ----------------------------------------------------------------------------------------------------------


def _drivers(values: Mapping[str, Any], *, detailed: bool) -> Iterator[Part]:
    hint = "; imported trials exist: drivers='imported' or --use imported-drivers uses their motion"
    has_import = values["reference"]["is_import_available"] and values["asset"] is None
    for driver in values["drivers"]:
        end = hint if has_import and not driver["imported"] else ""
        yield Paragraph(
            f"Driver of {driver['body']} ({driver['provenance']}): {driver['note']}{end}"
        )
        yield from (
            Paragraph(f"  {pairs_text(motion)}")
            for motion in driver["motions"]
            if detailed
        )


def _details(values: Mapping[str, Any]) -> Iterator[Part]:
    if scale := _scale_facts(values):
        yield Heading("Scale of the score")
        yield Facts(scale)
    yield Heading("Sources")
    yield Facts(values["source"])
    yield from _scene(values)
    if convergence := convergence_facts(values):
        yield Heading("Convergence")
        yield Facts(convergence)
    yield Heading("Where the numbers are from")
    yield Facts(values["provenance"])
    yield Heading("Decisions")
    yield Bullets(values["decisions"] or ["none"])
    yield Heading("Parameter sets")
    yield Facts(
        {
            name: chosen["summary"]
            + (f": {pairs_text(chosen['values'])}" if chosen["values"] else "")
            for name, chosen in values["parameter_sets"].items()
        }
    )


def _band_facts(values: Mapping[str, Any]) -> dict[str, str]:
    """Return why a band is withheld or missing, and published scores that cannot be right."""
    reference = values["reference"]
    facts = {}
    if reference["unsolved"] is not None:
        facts["unsolved"] = reference["unsolved"]["reason"]
    if reference["impossible"]:
        facts["published"] = reference["impossible"]
    if reference["withheld"] is not None:
        facts["withheld"] = f"{reference['withheld']}; --use withheld scores on it"
    return facts


def _scale_facts(values: Mapping[str, Any]) -> dict[str, str]:
    """Return where sigma is from, which frames are known, and why scores are not normalized."""
    reference = values["reference"]
    facts = {}
    is_solution = Kind(reference["grade"]).is_solution
    if reference["sigma_source"] is not None and not is_solution:
        facts["sigma"] = SIGMA_NOTES[SigmaSource(reference["sigma_source"])]
    if (reference["known_frames"] or values["frames"]) < values["frames"]:
        facts["known"] = (
            f"the mean at {reference['known_frames']} of {values['frames']} frames"
        )
    if reference["single_shot"]:
        facts["normalized"] = (
            "no: a single trial has no scatter; a reset with a trial or a seed selects another one"
        )
    elif reference["impossible"]:
        facts["normalized"] = "no: published scores cannot be right"
    elif is_solution:
        facts["normalized"] = "no: the distance from a solution is a numerical error"
    elif reference["normalized_by_baseline"] is False:
        facts["normalized"] = (
            "no: the published baseline is of another span of the motion"
        )
    return facts


def _scene(values: Mapping[str, Any]) -> Iterator[Part]:
    def name(body: Mapping[str, Any]) -> str:
        return body["name"] + (" (recorded)" if body["recorded"] else "")

    yield Table(
        title="Bodies",
        columns=(
            Column("", "name", name),
            Column("", "motion", lambda body: body.get("motion", body["kind"])),
            Column(
                "",
                "mass [kg]",
                lambda body: f"{body['mass_kg']:.10g}" if body["mass_kg"] else "-",
                is_number=True,
            ),
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


def _shape(body: Mapping[str, Any]) -> str:
    shape = dict(body.get("shape") or {"kind": body["kind"]})
    kind = shape.pop("kind")
    if "pieces_m" in shape:
        return f"{kind}, {len(shape['pieces_m'])} pieces"
    skip = (
        "name",
        "kind",
        "recorded",
        "motion",
        "shape",
        "mass_kg",
        "position_m",
        "quaternion_wxyz",
    )
    return " ".join(
        filter(None, (kind, pairs_text(shape), pairs_text(body, skip=skip)))
    )


def published_table(
    lines: Sequence[Mapping[str, Any]],
    *,
    title: str = "",
    note: str = NORMALIZED_NOTE,
    columns: Sequence[Column] = (),
) -> Table:
    """Return published scores as a table.

    Args:
        lines: The baselines.
        title: Its title; empty for none.
        note: Line below it; empty for none.
        columns: Columns before the metric.
    """

    def trials(line: Mapping[str, Any]) -> str:
        return plus_minus_text(line["mean"], line["std"], line["unit"])

    return Table(
        title=title,
        columns=(
            *columns,
            Column("metric", "metric", METRIC_TITLES.__getitem__),
            Column("", "real trials", trials, is_number=True),
            *(
                Column(f"engines.{key}", title, score_text, is_number=True)
                for key, title in PUBLISHED_ENGINES.items()
            ),
        ),
        rows=lines,
        notes=(note,) if lines and note else (),
    )
