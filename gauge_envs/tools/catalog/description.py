"""Describe an experiment completely, with the source of each number, JSON-ready.

`gauge show` and the page of a family in the documentation use this description.
"""

import csv
import dataclasses
import re
from fnmatch import fnmatchcase
from typing import Any

from gauge_envs.envs.reward import is_reward_bounded, reward_text
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.task_format import Substituted
from gauge_envs.files import data_folder, json_ready
from gauge_envs.references.band import band_file, read_band_file, recorded_events
from gauge_envs.references.convergence import convergence_rows
from gauge_envs.references.imported import load_imported
from gauge_envs.references.user_data import DataSource
from gauge_envs.scene import Deformable, RigidBody
from gauge_envs.scoring.reference import reference_band, reference_kind
from gauge_envs.text import toml_document
from gauge_envs.tools.catalog.listing import engine_rows
from gauge_envs.tools.catalog.spaces import action_rows, observation_rows


def all_limits() -> list[dict[str, Any]]:
    """Return all known limits of experiments from `scoring/limits.toml`.

    `variants` are patterns of variants, and `text` is one or two sentences. `study` is the folder of `studies/`, or the
    heading in its README, with the numbers.
    """
    content = toml_document((data_folder("scoring") / "limits.toml").read_bytes())
    limits: list[dict[str, Any]] = content["limit"]
    return limits


def description(experiment: Experiment) -> dict[str, Any]:
    """Return the complete description of an experiment, JSON-ready, with the source of each number."""
    spec, variant, scene = experiment.spec, experiment.variant, experiment.scene
    bodies = (*scene.bodies, *scene.deformables)
    return json_ready(
        {
            "id": experiment.id,
            "title": experiment.title,
            "summary": spec.summary,
            "group": spec.group.value,
            "evaluates": spec.evaluates,
            "source": spec.source.model_dump(exclude_none=True),
            "constants": {
                name: _constants(experiment, name)
                for name in spec.constants
                if any(
                    re.fullmatch(rf"{re.escape(name)}(-\d+)?", body.name)
                    for body in bodies
                )
            },
            "parameter_sets": {
                "calibrated": {
                    "summary": "calibrated constants of the metadata",
                    "values": {},
                },
                **{
                    name: {
                        "summary": chosen.summary,
                        "values": dict(load_experiment(variant, name).overrides),
                    }
                    for name, chosen in spec.parameters.items()
                },
            },
            "subtask": spec.subtasks[variant.subtask].title
            if variant.subtask
            else None,
            "provenance": spec.provenance,
            "decisions": spec.decisions,
            "asset": experiment.asset and experiment.asset.to_dict(),
            "frames": experiment.frame_count,
            "duration_s": scene.duration_s,
            "observable": {
                "kind": experiment.score.observable.value,
                "unit": experiment.score.observable.unit,
                "coordinates": experiment.coordinates,
            },
            "bodies": [_body(body, experiment) for body in bodies],
            "contacts": list(map(dataclasses.asdict, scene.contacts)),
            "joints": [
                {"kind": type(joint).__name__.lower(), **dataclasses.asdict(joint)}
                for joint in scene.joints
            ],
            "attachments": list(map(dataclasses.asdict, scene.attachments)),
            "drivers": _drivers(experiment),
            "gravity_m_per_s2": scene.gravity_m_per_s2,
            "air": scene.air and dataclasses.asdict(scene.air),
            "markers": scene.markers and {"count": len(scene.markers.positions_m)},
            "action": action_rows(experiment),
            "observation": observation_rows(experiment),
            "reference": _reference(experiment),
            "baselines": [row.model_dump() for row in experiment.baselines.values()],
            "engines": [
                row | {"convergence": convergence_rows(row["engine"], experiment.name)}
                for row in engine_rows(experiment)
            ],
            "limits": [
                {"text": limit["text"], "study": limit.get("study")}
                for limit in all_limits()
                if any(
                    fnmatchcase(experiment.name, pattern)
                    for pattern in limit["variants"]
                )
            ],
        }
    )


def _constants(experiment: Experiment, name: str) -> dict[str, dict[str, Any]]:
    """Return value and source of each constant of a body."""
    spec, variant = experiment.spec, experiment.variant
    tables = spec.constants[name]
    material = variant.material if variant.material in tables else next(iter(tables))
    values = spec.constants_of(name, material, variant.subtask)
    described = {}
    for key, constant in tables[material].items():
        place = f"constants.{name}.{material}.{key}"
        source = spec.provenance_of(place)
        if isinstance(constant, Substituted):
            used = spec.provenance_of(f"{place}.used")
            source = (
                f"{used}, for {constant.calibrated:g} ({source}): {constant.reason}"
            )
        described[key] = {"value": values[key], "source": source}
    return described


def _reference(experiment: Experiment) -> dict[str, Any]:
    """Return the reference of an experiment."""
    source = experiment.reference_source
    band = reference_band(experiment)
    file = band_file(experiment.name, source)
    facts = None if file is None else read_band_file(file)
    return {
        "kind": reference_kind(experiment.name, source).value,
        "unit": band and band.compared.unit,
        "source": band.source if band is not None else facts and facts.source,
        "licence": band and band.licence,
        "trial_count": band and band.trial_count,
        "single_shot": experiment.trial is not None,
        "known_frames": band and int(band.compared.known.sum()),
        "standard_uncertainty": band and band.standard_uncertainty,
        "zero_motion_distance": band and band.zero_motion_distance,
        "exact": {} if band is None else dict(band.exact),
        "exact_source": facts and facts.exact_source,
        "events": [
            event.model_dump() for event in recorded_events(experiment.name, source)
        ],
        "sees": planted_errors(experiment.name),
        "imported": source is DataSource.IMPORTED,
        "impossible": "; ".join(
            dict.fromkeys(
                row.disputed for row in experiment.baselines.values() if row.disputed
            )
        ),
        "reward": reward_text(band, is_bounded=is_reward_bounded(experiment)),
    }


def planted_errors(variant: str) -> list[dict[str, Any]]:
    """Return the scores of MuJoCo with planted errors in a variant, a row for each metric."""
    file = data_folder("scoring") / "sees.csv"
    with file.open(encoding="utf-8", newline="") as stream:
        rows = [row for row in csv.DictReader(stream) if row.pop("id") == variant]
    return [
        {
            key: text if key in ("metric", "unit") else float(text or "nan")
            for key, text in row.items()
        }
        for row in rows
    ]


def _body(body: RigidBody | Deformable, experiment: Experiment) -> dict[str, Any]:
    """Return the fields of a body, with its kind and pose, without an inertia that follows from the shape."""
    values = dataclasses.asdict(body)
    del values["pose"]
    if shape := getattr(body, "shape", None):
        values["shape"]["kind"] = type(shape).__name__
    if values.get("inertia_kg_m2", 0.0) is None:
        del values["inertia_kg_m2"]
    return {
        "kind": type(body).__name__.lower().replace("rigidbody", "rigid"),
        "recorded": body.name in experiment.recorded,
        **values,
        "position_m": body.pose.position_m,
        "quaternion_wxyz": body.pose.quaternion,
    }


def _drivers(experiment: Experiment) -> list[dict[str, Any]]:
    """Return the driven bodies with their motions and sources."""
    drivers = experiment.scene.drivers
    notes = ["from the asset"] * len(drivers)
    imported: set[str] = set()
    if experiment.asset is None:
        specs = experiment.spec.drivers_of(experiment.variant)
        notes = [spec.note for spec in specs]
        if experiment.drivers is DataSource.IMPORTED:
            trials = load_imported(experiment.name)
            records = trials.facts.drivers if trials else ()
            imported = {record.body for record in records}
    return [
        {
            "body": driver.body,
            "provenance": driver.provenance,
            "imported": driver.body in imported,
            "note": "mean motion in the imported trials"
            if driver.body in imported
            else note,
            "motions": list(map(dataclasses.asdict, driver.motions)),
        }
        for driver, note in zip(drivers, notes, strict=True)
    ]
