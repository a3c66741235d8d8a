"""All that defines an experiment, with the source of each number, JSON-ready.

The terminal page of `gauge show` and the page of a family in the documentation are both made from it.
"""

import csv
import dataclasses
from fnmatch import fnmatchcase
from typing import Any

from pydantic import Field

from gauge_envs.envs.reward import is_reward_bounded, reward_text
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.task_format import Substituted
from gauge_envs.files import data_folder, json_ready
from gauge_envs.references.band import band_file, recorded_events, stated_of
from gauge_envs.references.convergence import convergence_rows
from gauge_envs.references.imported import load_imported
from gauge_envs.references.tables import FileModel, read_toml
from gauge_envs.references.user_data import DataSource
from gauge_envs.scene import Deformable, Hinge, RigidBody
from gauge_envs.scoring.reference import reference_band
from gauge_envs.tools.catalog.listing import engine_rows, kind_of
from gauge_envs.tools.catalog.spaces import action_rows, observation_rows


class Limit(FileModel):
    """What is known to be wrong or uncertain of some experiments.

    Attributes:
        variants: Patterns of variants.
        text: One or two sentences.
        study: Folder of `studies/`, or heading in its README, that has the numbers; or None.
    """

    variants: tuple[str, ...] = Field(min_length=1)
    text: str
    study: str | None = None


class _Limits(FileModel):
    limit: tuple[Limit, ...]


def all_limits() -> tuple[Limit, ...]:
    """Return all known limits."""
    return read_toml(data_folder("scoring") / "limits.toml", _Limits).limit


def known_limits(variant: str) -> tuple[Limit, ...]:
    """Return the known limits of a variant, as `SlopeSlider-2-wood`."""
    return tuple(
        one
        for one in all_limits()
        if any(fnmatchcase(variant, pattern) for pattern in one.variants)
    )


def description(experiment: Experiment) -> dict[str, Any]:
    """Return all that defines one experiment, JSON-ready, with the source of each number."""
    scene = experiment.scene
    return json_ready(
        {
            "id": experiment.id,
            "title": experiment.title,
            **_of_task(experiment),
            "asset": None if experiment.asset is None else experiment.asset.to_dict(),
            "frames": experiment.frame_count,
            "duration_s": scene.duration_s,
            "observable": {
                "kind": experiment.score.observable.value,
                "unit": experiment.score.observable.unit,
                "coordinates": experiment.coordinates,
            },
            "bodies": [
                _body(body, experiment) for body in (*scene.bodies, *scene.deformables)
            ],
            "contacts": [dataclasses.asdict(contact) for contact in scene.contacts],
            "joints": [
                {"kind": "hinge" if isinstance(joint, Hinge) else "tether"}
                | dataclasses.asdict(joint)
                for joint in scene.joints
            ],
            "attachments": [
                dataclasses.asdict(attachment) for attachment in scene.attachments
            ],
            "drivers": [
                _driver(experiment, index) for index in range(len(scene.drivers))
            ],
            "air": None if scene.air is None else dataclasses.asdict(scene.air),
            "markers": None
            if scene.markers is None
            else {"count": len(scene.markers.positions_m)},
            "action": action_rows(experiment),
            "observation": observation_rows(experiment),
            "reference": _reference(experiment),
            "baselines": [
                dataclasses.asdict(line) for line in experiment.baselines.values()
            ],
            "engines": [
                row | {"convergence": convergence_rows(row["engine"], experiment.name)}
                for row in engine_rows(experiment)
            ],
            "limits": [
                limit.model_dump(exclude={"variants"})
                for limit in known_limits(experiment.name)
            ],
        }
    )


def _of_task(experiment: Experiment) -> dict[str, Any]:
    """Return what a task file states beside the scene."""
    spec, variant = experiment.spec, experiment.variant
    scene = experiment.scene
    # Bodies of one kind are numbered in the scene, as `cube-1`.
    bodies = [body.name for body in (*scene.bodies, *scene.deformables)]
    return {
        "summary": spec.summary,
        "group": spec.group.value,
        "evaluates": spec.evaluates,
        "source": spec.source.model_dump(exclude_none=True),
        "constants": {
            name: _constants(experiment, name)
            for name in spec.constants
            if any(
                body == name or body.removeprefix(f"{name}-").isdecimal()
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
        "subtask": spec.subtasks[variant.subtask].title if variant.subtask else None,
        "provenance": spec.provenance,
        "decisions": spec.decisions,
    }


def _constants(experiment: Experiment, name: str) -> dict[str, dict[str, Any]]:
    """Return value and source of each constant of a body."""
    spec, variant = experiment.spec, experiment.variant
    tables = spec.constants[name]
    material = variant.material if variant.material in tables else next(iter(tables))
    values = spec.constants_of(name, material, variant.subtask)
    described = {}
    for key, stated in tables[material].items():
        place = f"constants.{name}.{material}.{key}"
        source = spec.provenance_of(place)
        if isinstance(stated, Substituted):
            used = spec.provenance_of(f"{place}.used")
            source = f"{used}, for {stated.calibrated:g} ({source}): {stated.reason}"
        described[key] = {"value": values[key], "source": source}
    return described


def _reference(experiment: Experiment) -> dict[str, Any]:
    """Return what an experiment is scored against."""
    source = experiment.reference_source
    band = reference_band(experiment)
    file = band_file(experiment.name, source)
    stated = None if file is None else stated_of(file)
    return {
        "kind": kind_of(experiment).value,
        "unit": band and band.compared.unit,
        "source": band.source if band is not None else stated and stated.source,
        "licence": band and band.licence,
        "trial_count": band and band.trial_count,
        "single_shot": experiment.trial is not None,
        "known_frames": band and int(band.compared.known.sum()),
        "standard_uncertainty": band and band.standard_uncertainty,
        "zero_motion_distance": band and band.zero_motion_distance,
        "exact": {} if band is None else dict(band.exact),
        "exact_source": stated and stated.exact_source,
        "events": [
            one.model_dump() for one in recorded_events(experiment.name, source)
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
    """Return what MuJoCo's score of a variant is with changed motions and constants, a row for each metric."""
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
    """Return the fields of a body, with its kind and pose; an inertia that follows from the shape is left out."""
    kind = "rigid" if isinstance(body, RigidBody) else type(body).__name__.lower()
    values = {
        field.name: getattr(body, field.name) for field in dataclasses.fields(body)
    }
    if values.get("inertia_kg_m2", 0.0) is None:
        del values["inertia_kg_m2"]
    shape = values.pop("shape", None)
    if shape is not None:
        values["shape"] = dataclasses.asdict(shape) | {"kind": type(shape).__name__}
    pose = values.pop("pose")
    return {
        "kind": kind,
        "recorded": body.name in experiment.recorded,
        **values,
        "position_m": pose.position_m,
        "quaternion_wxyz": pose.quaternion,
    }


def _driver(experiment: Experiment, index: int) -> dict[str, Any]:
    driver = experiment.scene.drivers[index]
    note, imported = "as the asset states it", None
    if experiment.asset is None:
        note = experiment.spec.drivers_of(experiment.variant)[index].note
        if experiment.drivers is DataSource.IMPORTED:
            imported = load_imported(experiment.name)
    records = [] if imported is None else imported.facts.drivers
    is_imported = any(one.body == driver.body for one in records)
    return {
        "body": driver.body,
        "provenance": driver.provenance,
        "imported": is_imported,
        "note": "mean motion in the imported trials" if is_imported else note,
        "motions": [dataclasses.asdict(motion) for motion in driver.motions],
    }
