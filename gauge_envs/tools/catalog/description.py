"""All that defines an experiment, with the source of each number, JSON-ready.

The terminal page of `gauge show` and the page of a family in the documentation are both made from it.
"""

import dataclasses
import math
from fnmatch import fnmatchcase
from typing import Any

import numpy as np
from pydantic import Field

from gauge_envs.envs.reward import is_reward_bounded, reward_text
from gauge_envs.experiments.experiment import Experiment, TaskExperiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.task_format import Substituted
from gauge_envs.files import data_folder, json_ready
from gauge_envs.references.convergence import convergence_rows
from gauge_envs.references.imported import DriverRecord, load_imported
from gauge_envs.references.models import unsolved_scenes
from gauge_envs.references.published import law_for
from gauge_envs.references.tables import FileModel, read_toml
from gauge_envs.references.user_data import DataSource, has_import
from gauge_envs.scene import Deformable, Hinge, RigidBody
from gauge_envs.scene.profiles import Profile, SampledProfile
from gauge_envs.scoring.deformation import deformation_reference, real_statistics
from gauge_envs.scoring.reference import (
    grade_of,
    load_band,
    reference_band,
)
from gauge_envs.tools.catalog.listing import engine_rows
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
            **(
                _of_task(experiment)
                if isinstance(experiment, TaskExperiment)
                else _of_file(experiment)
            ),
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
            "engines": _engines(experiment),
            "limits": [
                one.model_dump(exclude={"variants"})
                for one in known_limits(experiment.name)
            ],
        }
    )


def _engines(experiment: Experiment) -> list[dict[str, Any]]:
    """Return what each engine says of an experiment, and its convergence."""
    return [
        row | {"convergence": convergence_rows(row["engine"], experiment.name)}
        for row in engine_rows(experiment)
    ]


def _of_task(experiment: TaskExperiment) -> dict[str, Any]:
    """Return what a task file states beside the scene."""
    spec, variant = experiment.spec, experiment.variant
    return {
        "summary": spec.summary,
        "group": spec.group.value,
        "evaluates": spec.evaluates,
        "source": spec.source.model_dump(exclude_none=True),
        "constants": {
            name: _constants(experiment, name)
            for name in spec.constants
            if _has(experiment, name)
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


def _has(experiment: TaskExperiment, name: str) -> bool:
    """Return whether the scene has a body of a name of the task file, or several numbered ones."""
    scene = experiment.scene
    return any(
        body.name == name or body.name.removeprefix(f"{name}-").isdecimal()
        for body in (*scene.bodies, *scene.deformables)
    )


def _constants(experiment: TaskExperiment, name: str) -> dict[str, dict[str, Any]]:
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


def _of_file(experiment: Any) -> dict[str, Any]:
    """Return what an experiment file states beside the scene."""
    definition = experiment.definition
    return {
        "summary": definition.summary,
        "group": None,
        "evaluates": definition.evaluates,
        "source": {"usd": definition.usd},
        "constants": {},
        "parameter_sets": {},
        "subtask": None,
        "provenance": definition.provenance,
        "decisions": [],
    }


def _reference(experiment: Experiment) -> dict[str, Any]:
    """Return what an experiment is or could be scored against."""
    reference = experiment.reference
    band = (
        load_band(experiment.name, experiment.reference_source)
        if reference is None
        else reference.band
    )
    law = law_for(experiment.name) if reference is None else None
    used = reference_band(experiment)
    shown = band if used is None else used
    unsolved = unsolved_scenes().get(experiment.name) if reference is None else None
    deformation = deformation_reference(experiment)
    return {
        "grade": grade_of(experiment).value,
        "trial_count": shown and shown.trial_count,
        "single_shot": experiment.trial is not None,
        "source": shown and shown.source,
        "imported": experiment.reference_source is DataSource.IMPORTED,
        "is_import_available": has_import(experiment.name),
        "law": law and law.condition,
        "sigma_source": shown and shown.sigma_source.value,
        "known_frames": shown and int(np.isfinite(shown.mean).any(axis=1).sum()),
        "normalized_by_baseline": shown and shown.normalized_by_baseline,
        "impossible": experiment.impossible_scores,
        "withheld": band and band.withheld,
        "unsolved": unsolved.model_dump()
        if used is None and unsolved is not None
        else None,
        "reward": reward_text(used, is_bounded=is_reward_bounded(experiment)),
        "deformation": [
            dataclasses.asdict(one)
            for one in (real_statistics(deformation) if deformation else ())
        ],
    }


def _body(body: RigidBody | Deformable, experiment: Experiment) -> dict[str, Any]:
    described: dict[str, Any] = {
        "name": body.name,
        "kind": "rigid" if isinstance(body, RigidBody) else type(body).__name__.lower(),
        "recorded": body.name in experiment.recorded,
    }
    values = {f.name: getattr(body, f.name) for f in dataclasses.fields(body)}
    if values.get("inertia_kg_m2", 0.0) is None:
        del values["inertia_kg_m2"]
    shape = values.pop("shape", None)
    if shape is not None:
        described["shape"] = dataclasses.asdict(shape) | {"kind": type(shape).__name__}
    pose = values.pop("pose")
    return (
        described
        | values
        | {"position_m": pose.position_m, "quaternion_wxyz": pose.quaternion}
    )


def _driver(experiment: Experiment, index: int) -> dict[str, Any]:
    driver = experiment.scene.drivers[index]
    described = {"body": driver.body, "provenance": driver.provenance}
    if not isinstance(experiment, TaskExperiment) or experiment.asset is not None:
        keys = ("kind", "axis", "point_m", "largest_rate", "residual_rate")
        stated = [
            {key: getattr(motion, key) for key in keys}
            | {"profile": [type(profile).__name__ for profile in motion.profiles]}
            for motion in driver.motions
        ]
        note = "as the asset states it; rates in m/s or rad/s"
        return described | {"imported": False, "note": note, "motions": stated}
    variant, spec = experiment.variant, experiment.spec
    of_subtask = spec.subtasks[variant.subtask].drivers if variant.subtask else None
    source = (of_subtask if of_subtask is not None else spec.drivers)[index]
    motions, note = (
        [motion.model_dump(exclude_none=True) for motion in source.motions],
        source.note,
    )
    imported = (
        load_imported(experiment.name)
        if experiment.drivers is DataSource.IMPORTED
        else None
    )
    records = (
        []
        if imported is None
        else [one for one in imported.record.drivers if one.body == driver.body]
    )
    if records:
        note = f"{_recorded_note(records[0])}; not in use is the bundled one: {note}"
        for motion, used in zip(motions, driver.motions, strict=True):
            motion["profile"] = [
                _sampled(profile, motion["kind"]) for profile in used.profiles
            ]
    return described | {"imported": bool(records), "note": note, "motions": motions}


def _sampled(profile: Profile, kind: str) -> dict[str, Any]:
    """Return an imported profile as a task file would state it."""
    assert isinstance(profile, SampledProfile)
    values = (
        profile.values
        if kind == "translate"
        else [math.degrees(value) for value in profile.values]
    )
    unit = "m" if kind == "translate" else "deg"
    return {
        "kind": "sampled",
        "times_s": list(profile.times_s),
        f"values_{unit}": list(values),
    }


def _recorded_note(record: DriverRecord) -> str:
    angle = "" if record.residual_deg is None else f" and {record.residual_deg:.2g} deg"
    return (
        f"mean motion of the body in {record.trial_count} imported trials, from its calibrated start, which is "
        f"{record.start_offset_mm:.2g} mm from theirs; its motions leave {record.residual_mm:.2g} mm{angle} out (rms)"
    )
