"""Measure what each reference can tell: how far an episode moves as one constant of its scene is changed or taken away.

Each scene is run on MuJoCo with its default preset, as it is and with one change at a time. The distance between the
two motions, over the frames that the reference knows, is what the reference would see of the change; it does not depend
on the error of the reference. `scoring/power.csv` holds the distances, in the unit of the compared quantity.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Collection, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from gauge_envs.backends.registry import backend_for
from gauge_envs.envs.episode import Episode
from gauge_envs.errors import EpisodeError, GaugeError
from gauge_envs.evaluation.deviation import release_offset
from gauge_envs.evaluation.reference import reference_band, reference_loads
from gauge_envs.evaluation.verification import (
    load_length,
    point_lengths,
    root_mean_square,
)
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import beyond_variants, variants
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.references.bands import Band
from gauge_envs.references.power import POWER_COLUMNS, power_file
from gauge_envs.scene import Cloth, Scene, SoftBody
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from scripts.generated import Request, append_rows, read_rows

LOW = 0.8
"""Factor of a constant that is off by 20 %."""

NEARLY_NONE = 0.01
"""Factor of a stiffness that is taken away: without any, some solvers fail."""

STIFF = 10.0
"""Factor of the stretch of a sheet that hardly stretches."""

FRICTIONS = {
    "dry_friction_n_m": "dry friction",
    "viscous_friction_n_m_s_per_rad": "viscous friction",
    "quadratic_friction_n_m_s2_per_rad2": "quadratic friction",
}
PLATE = 1e4
"""Factor of the bending of a sheet that swings like a plate."""


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
        for name, title in FRICTIONS.items():
            yield from _with_joints(scene, name, title)


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
    if scene.has(Cloth):
        constants = {
            "bend_stiffness_n_m_per_rad": ("bending", (NEARLY_NONE, LOW, PLATE)),
            "shear_stiffness_n_per_m": ("shear", (NEARLY_NONE, LOW)),
            "stretch_stiffness_n_per_m": ("stretch", (LOW, STIFF)),
        }
    elif scene.deformables:
        constants = {"young_modulus_pa": ("Young's modulus", (LOW,))}
        if scene.has(SoftBody):
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


def _with_joints(scene: Scene, name: str, title: str) -> Iterator[tuple[str, Scene]]:
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


def motion(
    experiment: Experiment,
    scene: Scene,
    *,
    last_frame: int,
) -> Episode:
    """Return the episode of a scene up to a frame, with MuJoCo's default settings."""
    engine = backend_for("mujoco", experiment.model_file)
    simulation = engine.build(scene)
    try:
        simulation.reset(0)
        episode = Episode(
            replace(experiment, scene=scene),
            simulation,
            band=reference_band(experiment),
            marker_proxy=MarkerProxy.MATERIAL,
        )
        episode.begin()
        while not episode.is_over and episode.frame != last_frame:
            episode.advance(episode.no_rates)
            episode.end_frame()
        if episode.fault is not None:
            raise EpisodeError(f"{experiment.id}: diverged: {episode.fault}")
        return episode
    finally:
        simulation.close()


def compared_motion(band: Band, episode: Episode) -> FloatArray:
    """Return what the reference compares, at its frames, shape [T, C]; NaN at frames that were not run."""
    trajectory = episode.trajectory()
    found = band.project(trajectory.frames)
    if band.points is not None:
        found = 1e3 * trajectory.markers_m.reshape(len(trajectory.markers_m), -1)
    whole = np.full((band.points or band).mean.shape, np.nan)
    count = min(len(found), len(whole))
    whole[:count] = found[:count]
    return whole


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


def rows_of(
    experiment: Experiment, band: Band, done: Collection[tuple[str, str]]
) -> Iterator[dict[str, Any]]:
    """Yield the rows of a variant that the table lacks.

    Args:
        experiment: The experiment.
        band: Its reference.
        done: Change and quantity of the rows that the table has; the quantity of what the score is of is empty.
    """
    loads = reference_loads(experiment, band)
    # Loads tell of cloth and foam alone, and no load of them of the rest of a scene.
    deformable = {change for change, _ in _with_deformables(experiment.scene)}
    wanted = [
        (change, scene, missing)
        for change, scene in changed_scenes(experiment.scene)
        if (
            missing := [
                quantity
                for quantity in ("", *(load.quantity for load in loads))
                if (change, quantity) not in done
                and (not quantity or change in deformable)
            ]
        )
    ]
    if not wanted:
        return
    is_aligned = (
        band.grade.is_real and experiment.trial is None and not experiment.scene.drivers
    )
    last_load = max((last for load in loads for _, last in load.windows), default=0)
    # No frame after the last known one is compared; an alignment needs the frames after it.
    known = np.isfinite((band.points or band).mean).any(axis=1)
    last_known = int(np.flatnonzero(known)[-1])
    last_main = experiment.frame_count if is_aligned else max(last_load, last_known)
    ends = [last_main if "" in missing else last_load for _, _, missing in wanted]
    nominal = motion(experiment, experiment.scene, last_frame=max(ends))
    holders = experiment.scene.holders
    unit = (band.points or band).unit
    for (change, scene, missing), last_frame in zip(wanted, ends, strict=True):
        row = {"variant": experiment.name, "change": change}
        try:
            changed = motion(experiment, scene, last_frame=last_frame)
        except GaugeError as error:
            print(f"{experiment.name}, {change}: {error}", file=sys.stderr)
            if "" in missing:
                yield row | {"distance": "", "unit": unit, "quantity": ""}
            continue
        if "" in missing:
            moved = distance(band, nominal, changed, is_aligned=is_aligned)
            yield row | {"distance": f"{moved:.4g}", "unit": unit, "quantity": ""}
        for load in loads:
            if load.quantity not in missing:
                continue
            before, after = (
                load.values(holders, one.trajectory().wrenches)
                for one in (nominal, changed)
            )
            yield row | {
                "distance": f"{load_length(after - before):.4g}",
                "unit": load.unit,
                "quantity": load.quantity,
            }


def measure(request: Request) -> None:
    """Measure the changes that the table lacks; a stopped run goes on."""
    file = power_file()
    done: dict[str, set[tuple[str, str]]] = defaultdict(set)
    for row in read_rows(file):
        done[row["variant"]].add((row["change"], row["quantity"]))
    for variant in (*variants(), *beyond_variants()):
        name = variant.name
        experiment = load_experiment(name)
        band = reference_band(experiment)
        if band is not None and request.wants(name):
            append_rows(file, POWER_COLUMNS, rows_of(experiment, band, done[name]))
