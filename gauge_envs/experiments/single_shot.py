"""Start an experiment as one of its recorded single-shot trials."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

from gauge_envs.errors import ParameterError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.single_shot import SingleShots, single_shots
from gauge_envs.scene import Pose, Scene
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.hinged import carried

AnyExperiment = TypeVar("AnyExperiment", bound=Experiment)


def shots_of(experiment: Experiment) -> SingleShots | None:
    """Return the single-shot trials that an experiment starts from, or None.

    An experiment whose start was replaced, by an override or by a file, has none.
    """
    return None if experiment.trial is None else single_shots(experiment.name)


def with_trial(experiment: AnyExperiment, trial: int) -> AnyExperiment:
    """Return an experiment with the measured start of a single-shot trial.

    Args:
        experiment: An experiment with single-shot trials.
        trial: Number of the trial, from 0.
    """
    shots = single_shots(experiment.name)
    if shots is None:
        raise ParameterError(f"{experiment.id} has no single-shot trials")
    return replace(experiment, scene=_started(experiment.scene, shots, trial), trial=trial)


def _started(scene: Scene, shots: SingleShots, trial: int) -> Scene:
    started = {body.name: body for body in scene.bodies}
    for name in shots.sidecar.bodies:
        shot = shots.shot(trial, name)
        w, x, y, z = shot.quaternions[0].tolist()
        started[name] = replace(
            scene.body(name),
            pose=Pose(position_m=vector(shot.positions_m[0]), quaternion=(w, x, y, z)),
            linear_velocity_m_per_s=vector(shot.velocity_m_per_s),
            angular_velocity_rad_per_s=vector(shot.angular_velocity_rad_per_s),
        )
    # A hinge goes with its first body.
    hinges = tuple(
        carried(hinge, scene.body(hinge.first).pose, started[hinge.first].pose) for hinge in scene.body_hinges
    )
    return replace(scene, bodies=tuple(started.values()), body_hinges=hinges)
