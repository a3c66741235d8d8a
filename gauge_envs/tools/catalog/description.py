"""Describe an experiment completely, with the source of each number, JSON-ready.

`gauge show` and the page of a family in the documentation use this description.
"""

import csv
import dataclasses
import math
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from gauge_envs.envs.reward import is_reward_bounded, reward_text
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.task_format import Substituted
from gauge_envs.files import data_folder, json_ready
from gauge_envs.references.band import (
    band_file,
    read_band_file,
    recorded_events,
)
from gauge_envs.references.convergence import convergence_rows
from gauge_envs.references.imported import load_imported
from gauge_envs.references.metrics import EVENT_METRICS
from gauge_envs.references.user_data import DataSource
from gauge_envs.scene import Deformable, Hinge, RigidBody, Tether
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
from gauge_envs.scoring.answers import Answer, is_like_trials, real_limit, solves
from gauge_envs.scoring.estimates import ComparedQuantity
from gauge_envs.scoring.exact import exact_motion
from gauge_envs.scoring.reference import reference_band, reference_kind
from gauge_envs.scoring.trajectory import score_trajectory
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
    constants = [name for name in spec.constants if name in spec.bodies_of(variant)]
    return json_ready(
        {
            "id": experiment.id,
            "title": experiment.title,
            "summary": spec.summary,
            "group": spec.group.value,
            "evaluates": spec.evaluates,
            "source": spec.source.model_dump(exclude_none=True),
            "constants": {name: _constants(experiment, name) for name in constants},
            "parameter_sets": _parameter_sets(experiment),
            "subtask": variant.subtask and spec.subtasks[variant.subtask].title,
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
            "joints": list(map(_with_kind, scene.joints)),
            "attachments": list(map(dataclasses.asdict, scene.attachments)),
            "drivers": _drivers(experiment),
            "gravity_m_per_s2": scene.gravity_m_per_s2,
            "air": scene.air and dataclasses.asdict(scene.air),
            "markers": scene.markers and {"count": len(scene.markers.positions_m)},
            "action": action_rows(experiment),
            "observation": observation_rows(experiment),
            "reference": _reference(experiment),
            "baselines": [row.model_dump() for row in experiment.baselines.values()],
            "engines": _engines(experiment),
            "limits": _limits(experiment.name),
        }
    )


def _parameter_sets(experiment: Experiment) -> dict[str, dict[str, Any]]:
    """Return the summary and the values of each parameter set by name."""
    summary = "published constants of the metadata"
    sets: dict[str, dict[str, Any]] = {"published": {"summary": summary, "values": {}}}
    for name, chosen in experiment.spec.parameters.items():
        values = dict(load_experiment(experiment.variant, name).overrides)
        sets[name] = {"summary": chosen.summary, "values": values}
    return sets


def _engines(experiment: Experiment) -> list[dict[str, Any]]:
    """Return the support of an experiment by each engine, and how far its step is from convergence."""
    return [
        row | {"convergence": convergence_rows(row["engine"], experiment.name)}
        for row in engine_rows(experiment)
    ]


def _limits(name: str) -> list[dict[str, str | None]]:
    """Return the known limits of a variant, each with its study."""
    return [
        {"text": limit["text"], "study": limit.get("study")}
        for limit in all_limits()
        if any(fnmatchcase(name, pattern) for pattern in limit["variants"])
    ]


def _with_kind(part: Hinge | Tether) -> dict[str, Any]:
    """Return the fields of a joint with its kind."""
    return {"kind": type(part).__name__.lower(), **dataclasses.asdict(part)}


def _constants(experiment: Experiment, name: str) -> dict[str, dict[str, Any]]:
    """Return value and source of each constant of a body."""
    spec, variant = experiment.spec, experiment.variant
    tables = spec.constants[name]
    material = variant.material
    if material not in tables:
        material = next(iter(tables))
    values = spec.constants_of(name, material, variant.subtask)
    described = {}
    for key, constant in tables[material].items():
        place = f"constants.{name}.{material}.{key}"
        source = spec.provenance_of(place)
        if isinstance(constant, Substituted):
            used = spec.provenance_of(f"{place}.used")
            source = f"{used}, for {constant.published:g} ({source}): {constant.reason}"
        described[key] = {"value": values[key], "source": source}
    return described


def _reference(experiment: Experiment) -> dict[str, Any]:
    """Return the reference of an experiment."""
    source = experiment.reference_source
    band = reference_band(experiment)
    file = band_file(experiment.name, source)
    facts = file and read_band_file(file)
    described = band or facts
    disputed = [row.disputed for row in experiment.baselines.values() if row.disputed]
    return {
        "kind": reference_kind(experiment.name, source).value,
        "unit": band and band.compared.unit,
        "compared": band and band.compared.coordinates,
        "source": described and described.source,
        "licence": band and band.licence,
        "trial_count": band and band.trial_count,
        "single_shot": experiment.trial is not None,
        "known_frames": band and int(band.compared.known.sum()),
        "standard_uncertainty": band and band.standard_uncertainty,
        "zero_motion_distance": band and band.zero_motion_distance,
        "exact": _exact_scores(experiment),
        "exact_source": facts and facts.exact_source,
        "events": [
            event.model_dump() for event in recorded_events(experiment.name, source)
        ],
        "sees": planted_errors(experiment),
        "imported": source is DataSource.IMPORTED,
        "impossible": "; ".join(dict.fromkeys(disputed)),
        "reward": reward_text(band, is_bounded=is_reward_bounded(experiment)),
    }


def _exact_scores(experiment: Experiment) -> dict[str, float]:
    """Return the primary normalized distance of the exact motion by parameter set; empty without a closed form."""
    scores = {}
    for name in _parameter_sets(experiment):
        variant = load_experiment(
            experiment.variant, name, reference=experiment.reference_source
        )
        sample_count = (variant.frame_count - 1) * SAMPLES_PER_FRAME + 1
        times_s = np.arange(sample_count) / (SAMPLES_PER_FRAME * FRAME_RATE_HZ)
        motion = exact_motion(variant, times_s)
        if motion is None:
            continue
        band = reference_band(variant)
        score = score_trajectory(variant, band, times_s=times_s, values=motion)
        if score.exact is not None:
            scores[name] = score.exact
    return scores


def planted_errors(experiment: Experiment) -> list[dict[str, Any]]:
    """Return the scores of MuJoCo with planted errors, a row for each metric.

    `answers` has the answer to each score, by column: whether the motion solves the scene, or is like reality.
    """
    file = data_folder("scoring") / "sees.csv"
    rows: list[dict[str, Any]] = []
    with file.open(encoding="utf-8", newline="") as stream:
        for texts in csv.DictReader(stream):
            if texts.pop("id") != experiment.name:
                continue
            names: dict[str, Any] = {key: texts.pop(key) for key in ("metric", "unit")}
            scores = {key: float(text or "nan") for key, text in texts.items()}
            names["answers"] = {
                key: _answer(experiment, names["metric"], score)
                for key, score in scores.items()
            }
            rows.append(names | scores)
    return rows


def _answer(experiment: Experiment, metric: str, score: float) -> Answer | None:
    """Return the answer to a score; None without a reference."""
    real = _real_event(experiment, metric)
    if real is not None:
        mean, uncertainty = real
        quantity = ComparedQuantity(
            value=None if math.isnan(score) else score,
            unit="",
            real=mean,
            real_uncertainty=uncertainty,
        )
        return quantity.answer
    band = reference_band(experiment)
    if band is None:
        return None
    if band.kind.is_solution:
        return solves(band, score)
    limit = real_limit(experiment, band, is_aligned=metric == "rmse_aligned")
    return is_like_trials(band, score, limit)


def _real_event(
    experiment: Experiment, metric: str
) -> tuple[float, float | None] | None:
    """Return the real value of an event and its standard uncertainty; None if the metric is no event."""
    if metric in EVENT_METRICS and metric in experiment.baselines:
        row = experiment.baselines[metric]
        return row.mean, row.standard_uncertainty
    for event in recorded_events(experiment.name, experiment.reference_source):
        if event.name == metric:
            return event.value, event.standard_uncertainty
    return None


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
        notes = [spec.note for spec in experiment.spec.drivers_of(experiment.variant)]
        trials = load_imported(experiment.name)
        if experiment.drivers is DataSource.IMPORTED and trials is not None:
            imported = {record.body for record in trials.facts.drivers}
    rows = []
    for driver, note in zip(drivers, notes, strict=True):
        is_imported = driver.body in imported
        if is_imported:
            note = "mean motion in the imported trials"
        rows.append(
            {
                "body": driver.body,
                "provenance": driver.provenance,
                "imported": is_imported,
                "note": note,
                "motions": list(map(dataclasses.asdict, driver.motions)),
            }
        )
    return rows
