"""Measure how a simulated trajectory changes with each uncertain input: constants, start, tilt and time step."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.backends.base import Backend
from gauge_envs.backends.registry import backend_for
from gauge_envs.backends.shared.resampled import in_intervals
from gauge_envs.envs.episode import Episode
from gauge_envs.errors import EpisodeError, GaugeError
from gauge_envs.experiments.experiment import Experiment, TaskExperiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.uncertain import (
    free_directions,
    overrides_at,
    uncertain_parameters,
)
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.sensitivities import (
    ConstantUncertainty,
    InputUncertainty,
    Sensitivities,
    StandardUncertainty,
    input_uncertainties,
)
from gauge_envs.runs.request import RunRequest
from gauge_envs.scene import Contact, Motion, Scene
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.scene.jitter import tilted

DISCRETIZATION_FACTOR = 2.0 / math.sqrt(3.0)
"""Standard uncertainty of a discretization over the change by half its size.

An error of first order is twice that change. It is the half width of a rectangular distribution (GUM 4.3.7).
"""


@dataclass(frozen=True, kw_only=True)
class _Perturbation:
    """Two scenes, one standard uncertainty of an input below and above.

    Attributes:
        name: Name of the input.
        kind: Its kind, as in `evaluation.uncertainty`.
        known: Its standard uncertainty, with unit and source.
        low: Scene below.
        high: Scene above.
        tilt: Rotation about the origin of the scene above; that of the scene below is its inverse.
    """

    name: str
    kind: str
    known: StandardUncertainty
    low: Scene
    high: Scene
    tilt: Rotation | None = None


def measure_sensitivities(request: RunRequest) -> Sensitivities:
    """Run an experiment with each uncertain input one standard uncertainty lower and higher.

    Inputs are the friction and restitution of each contact, the constants of joints, the start of the recorded bodies,
    the tilt of the set-up against gravity, the time step, and the cell of deformable bodies.
    `scoring/uncertainties.toml` states their uncertainties.

    Args:
        request: The run; `seed`, `repeats` and `jitter` do not apply.
    """
    experiment = request.experiment()
    engine = backend_for(request.backend, experiment.model_file)
    nominal, settings = _frames(request, engine, experiment, request.settings)
    inputs, left_out = [], []
    for one in _perturbations(experiment):
        try:
            low, high = (
                _frames(
                    request, engine, replace(experiment, scene=scene), request.settings
                )[0]
                for scene in (one.low, one.high)
            )
        except GaugeError as error:
            left_out.append(f"{one.name}: {error}")
            continue
        if one.tilt is not None:
            low, high = _rotated(low, one.tilt), _rotated(high, one.tilt.inv())
        known = one.known
        # A constant is moved far, so that up and down differ; of the others, half the difference is the change.
        change, below = (
            (high - nominal, low - nominal)
            if one.kind == "constant"
            else (0.5 * (high - low), None)
        )
        inputs.append(
            InputUncertainty(
                name=one.name,
                kind=one.kind,
                std=known.std,
                unit=known.unit,
                source=known.source,
                change=change,
                change_below=below,
            )
        )
    for setting, name, unit in (
        ("timestep_s", "time step", "s"),
        ("cell_m", "cell", "m"),
    ):
        size = settings.get(setting)
        if not isinstance(size, float) or (
            setting == "cell_m" and not experiment.scene.deformables
        ):
            continue
        try:
            finer, _ = _frames(
                request,
                engine,
                experiment,
                {**(request.settings or {}), setting: 0.5 * size},
            )
        except GaugeError as error:
            left_out.append(f"{name}: {error}")
            continue
        inputs.append(
            InputUncertainty(
                name=name,
                kind="discretization",
                std=size,
                unit=unit,
                source=f"change of the trajectory by half the {name}; the error of first order is twice that",
                change=DISCRETIZATION_FACTOR * (finer - nominal),
            )
        )
    if experiment.scene.deformables:
        left_out.append("constants of deformable bodies: no uncertainty is published")
    return Sensitivities(
        variant=experiment.name,
        backend=request.backend,
        versions=engine.versions(),
        settings={
            key: settings[key]
            for key in ("preset", "timestep_s", "cell_m")
            if settings.get(key) is not None
        },
        inputs=tuple(inputs),
        left_out=tuple(left_out),
    )


def _frames(
    request: RunRequest,
    engine: Backend,
    experiment: Experiment,
    settings: Mapping[str, Any] | None,
) -> tuple[FloatArray, Mapping[str, Any]]:
    """Return g(t) at the frames, shape [T, D], and the settings in force."""
    scene = experiment.scene
    simulation = in_intervals(engine.build(scene, settings), scene)
    try:
        simulation.reset(0)
        episode = Episode(experiment, simulation, band=None, marker_proxy=request.proxy)
        episode.play()
        if episode.fault is not None:
            raise EpisodeError(f"{experiment.id}: diverged: {episode.fault}")
        return episode.trajectory().frames, simulation.settings
    finally:
        simulation.close()


def _rotated(frames: FloatArray, rotation: Rotation) -> FloatArray:
    """Return positions that are rotated about the origin."""
    return np.asarray(rotation.apply(frames.reshape(-1, 3)).reshape(frames.shape))


def _perturbations(experiment: Experiment) -> Iterator[_Perturbation]:
    scene, known = experiment.scene, input_uncertainties()
    material = (
        experiment.variant.material if isinstance(experiment, TaskExperiment) else None
    )
    for constant in ("friction", "restitution"):
        entry: ConstantUncertainty = getattr(known, constant)
        # Contacts with one value share one calibrated number.
        for value in dict.fromkeys(
            getattr(contact, constant) for contact in scene.contacts
        ):
            std = entry.std(value, material)
            if std == 0.0:
                continue
            group = [
                contact
                for contact in scene.contacts
                if getattr(contact, constant) == value
            ]
            low, high = max(value - std, 0.0), value + std
            if constant == "restitution":
                high = min(high, 1.0)
            pairs = ", ".join(
                f"{contact.first[0]}/{contact.second[0]}" for contact in group
            )
            yield _Perturbation(
                name=f"{constant} {pairs}",
                kind="constant",
                known=StandardUncertainty(std=std, unit="1", source=entry.source),
                low=_with_contacts(scene, group, constant, low),
                high=_with_contacts(scene, group, constant, high),
            )
    # A file states constants of its own.
    if isinstance(experiment, TaskExperiment) and experiment.asset is None:
        yield from _joint_perturbations(experiment)
    for name, direction in _start_directions(experiment):
        shift = known.start.std * direction
        yield _Perturbation(
            name=f"start of {', '.join(experiment.recorded)} along {name}",
            kind="start",
            known=known.start,
            low=_shifted(scene, experiment.recorded, -shift),
            high=_shifted(scene, experiment.recorded, shift),
        )
    if (
        experiment.score.observable is not Observable.POSITION
        or not experiment.recorded
    ):
        return
    for axis, name in zip(
        math.radians(known.tilt.std) * np.eye(3)[:2], "xy", strict=True
    ):
        yield _Perturbation(
            name=f"tilt about {name}",
            kind="tilt",
            known=known.tilt,
            low=tilted(scene, -axis, np.zeros(3)),
            high=tilted(scene, axis, np.zeros(3)),
            tilt=Rotation.from_rotvec(axis),
        )


def _joint_perturbations(experiment: TaskExperiment) -> Iterator[_Perturbation]:
    for one in uncertain_parameters(experiment):
        if one.key.rpartition(".")[2] in input_uncertainties().joint:
            at = [
                {**experiment.overrides, **overrides_at([one], [sign])}
                for sign in (-1.0, 1.0)
            ]
            low, high = (
                load_experiment(experiment.variant, overrides).scene for overrides in at
            )
            known = StandardUncertainty(std=one.std, unit=one.unit, source=one.source)
            yield _Perturbation(
                name=one.name, kind="constant", known=known, low=low, high=high
            )


def _with_contacts(
    scene: Scene, group: list[Contact], constant: str, value: float
) -> Scene:
    change: dict[str, Any] = {constant: value}
    changed = tuple(
        replace(one, **change) if one in group else one for one in scene.contacts
    )
    return replace(scene, contacts=changed)


def _start_directions(experiment: Experiment) -> Iterator[tuple[str, FloatArray]]:
    """Yield directions in which the recorded bodies may start elsewhere, so that none starts inside another."""
    scene = experiment.scene
    if not experiment.recorded or scene.joints:
        return
    bodies = [scene.body(name) for name in experiment.recorded]
    if all(body.motion is Motion.DYNAMIC for body in bodies):
        yield from free_directions(bodies)


def _shifted(scene: Scene, names: tuple[str, ...], shift_m: FloatArray) -> Scene:
    bodies = tuple(
        replace(
            body,
            pose=replace(
                body.pose, position_m=vector(np.asarray(body.pose.position_m) + shift_m)
            ),
        )
        if body.name in names
        else body
        for body in scene.bodies
    )
    hinges = tuple(
        replace(hinge, anchor_m=vector(np.asarray(hinge.anchor_m) + shift_m))
        if hinge.first in names
        else hinge
        for hinge in scene.body_hinges
    )
    return replace(scene, bodies=bodies, body_hinges=hinges)
