"""Measure what each reference can tell: how far an episode moves as one constant of its scene is changed or taken away.

Each scene is run on MuJoCo with its default preset, as it is and with one change at a time. The distance between the
two motions, over the frames that the reference knows, is what the reference would see of the change; it does not depend
on the error of the reference. `scoring/power.csv` holds the distances, in the unit of the compared quantity.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from gauge_envs.backends.registry import backend_for
from gauge_envs.envs.episode import Episode
from gauge_envs.errors import EpisodeError, GaugeError
from gauge_envs.evaluation.deviation import release_offset
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.evaluation.verification import point_lengths, root_mean_square
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import variants
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.references.bands import Band
from gauge_envs.references.power import POWER_COLUMNS, power_file
from gauge_envs.scene import Cloth, Scene, SoftBody
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from scripts.generated import Request

LOW = 0.8
"""Factor of a constant that is off by 20 %."""

NEARLY_NONE = 0.01
"""Factor of a stiffness that is taken away: without any, some solvers fail."""


def changed_scenes(scene: Scene) -> Iterator[tuple[str, Scene]]:
    """Yield the scene with one thing changed, and what it is."""
    for constant in ("friction", "restitution"):
        if any(getattr(contact, constant) for contact in scene.contacts):
            for text, factor in (("off", 0.0), ("x 0.8", LOW)):
                yield f"{constant} {text}", _with_contacts(scene, constant, factor)
    yield from _with_deformables(scene)
    masses = [body.mass_kg for body in scene.bodies]
    if any(masses):
        bodies = tuple(
            replace(body, mass_kg=LOW * body.mass_kg) for body in scene.bodies
        )
        yield "mass x 0.8", replace(scene, bodies=bodies)
    if scene.air is not None:
        yield "air off", replace(scene, air=None)
    if scene.joints:
        for name in ("dry_friction_n_m", "viscous_friction_n_m_s_per_rad"):
            yield from _with_joints(scene, name)


def _with_contacts(scene: Scene, constant: str, factor: float) -> Scene:
    changes: Any = [
        {constant: factor * getattr(contact, constant)} for contact in scene.contacts
    ]
    contacts = tuple(
        replace(contact, **change)
        for contact, change in zip(scene.contacts, changes, strict=True)
    )
    return replace(scene, contacts=contacts)


def _with_deformables(scene: Scene) -> Iterator[tuple[str, Scene]]:
    constants: dict[str, tuple[str, tuple[float, ...]]] = {}
    if any(isinstance(body, Cloth) for body in scene.deformables):
        constants = {
            "bend_stiffness_n_m_per_rad": ("bending", (NEARLY_NONE, LOW)),
            "shear_stiffness_n_per_m": ("shear", (NEARLY_NONE, LOW)),
            "stretch_stiffness_n_per_m": ("stretch", (LOW,)),
        }
    elif scene.deformables:
        constants = {"young_modulus_pa": ("Young's modulus", (LOW,))}
        if any(isinstance(body, SoftBody) for body in scene.deformables):
            constants["poisson_ratio"] = ("Poisson's ratio", (LOW,))
    for field, (title, factors) in constants.items():
        for factor in factors:
            bodies = tuple(
                replace(body, **{field: factor * getattr(body, field)})
                if hasattr(body, field)
                else body
                for body in scene.deformables
            )
            text = "off" if factor == NEARLY_NONE else f"x {factor:g}"
            yield f"{title} {text}", replace(scene, deformables=bodies)
    if scene.deformables:
        bodies = tuple(
            replace(
                body,
                mass_kg=LOW * body.mass_kg,
                **(
                    {"areal_density_kg_per_m2": LOW * body.areal_density_kg_per_m2}
                    if isinstance(body, Cloth)
                    else {}
                ),
            )
            for body in scene.deformables
        )
        yield "density x 0.8", replace(scene, deformables=bodies)


def _with_joints(scene: Scene, name: str) -> Iterator[tuple[str, Scene]]:
    title = "dry friction" if name.startswith("dry") else "viscous friction"
    for text, factor in (("off", 0.0), ("x 0.8", LOW)):
        changed = []
        for joint in scene.joints:
            dynamics = getattr(joint, "dynamics", None)
            if dynamics is not None and getattr(dynamics, name):
                change: Any = {name: factor * getattr(dynamics, name)}
                joint = replace(joint, dynamics=replace(dynamics, **change))
            changed.append(joint)
        if tuple(changed) != tuple(scene.joints):
            yield f"joint {title} {text}", replace(scene, joints=tuple(changed))


def motion(experiment: Experiment, scene: Scene) -> Episode:
    """Return the finished episode of a scene."""
    engine = backend_for("mujoco", experiment.model_file)
    simulation = engine.build(scene, None)
    try:
        simulation.reset(0)
        episode = Episode(
            replace(experiment, scene=scene),
            simulation,
            band=None,
            marker_proxy=MarkerProxy.MATERIAL,
        )
        episode.play()
        if episode.fault is not None:
            raise EpisodeError(f"{experiment.id}: diverged: {episode.fault}")
        return episode
    finally:
        simulation.close()


def compared_motion(band: Band, episode: Episode) -> FloatArray:
    """Return what the reference compares, at the frames, shape [T, C]."""
    trajectory = episode.trajectory()
    if band.points is not None:
        return 1e3 * trajectory.markers_m.reshape(len(trajectory.markers_m), -1)
    return band.project(trajectory.frames)


def distance(
    band: Band, nominal: Episode, changed: Episode, *, is_aligned: bool
) -> float:
    """Return the distance between two episodes in the norm of the score."""
    compared = band.points or band
    known = np.isfinite(compared.mean)
    first = np.where(known, compared_motion(band, nominal), np.nan)
    if is_aligned:
        times_s, values = changed.trajectory().dense
        return release_offset(
            times_s, band.project(values), first, frame_rate_hz=FRAME_RATE_HZ
        )[1]
    return root_mean_square(
        point_lengths(compared_motion(band, changed) - first, compared)
    )


def rows_of(name: str) -> Iterator[dict[str, Any]]:
    """Yield the rows of a variant."""
    experiment = load_experiment(name)
    band = reference_band(experiment)
    assert band is not None
    is_aligned = (
        band.grade.is_real and experiment.trial is None and not experiment.scene.drivers
    )
    nominal = motion(experiment, experiment.scene)
    unit = (band.points or band).unit
    for change, scene in changed_scenes(experiment.scene):
        try:
            moved = distance(
                band, nominal, motion(experiment, scene), is_aligned=is_aligned
            )
            text = f"{moved:.4g}"
        except GaugeError as error:
            print(f"{name}, {change}: {error}", file=sys.stderr)
            text = ""
        yield {"variant": name, "change": change, "distance": text, "unit": unit}


def measure(request: Request) -> None:
    """Measure the variants that the table lacks; a stopped run goes on."""
    file = power_file()
    done = set()
    if file.is_file():
        with file.open(encoding="utf-8") as text:
            done = {row["variant"] for row in csv.DictReader(text)}
    for variant in variants():
        name = variant.name
        is_wanted = any(fnmatchcase(name, pattern) for pattern in request.ids)
        if name in done or not is_wanted:
            continue
        if reference_band(load_experiment(name)) is None:
            continue
        rows = list(rows_of(name))
        is_new = not file.is_file()
        with file.open("a", newline="", encoding="utf-8") as text:
            writer = csv.DictWriter(text, POWER_COLUMNS, lineterminator="\n")
            if is_new:
                writer.writeheader()
            writer.writerows(rows)
        print(name, [(row["change"], row["distance"]) for row in rows], flush=True)
