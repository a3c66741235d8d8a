"""Option `trial` of a reset: initial states of imported trials, and initial states and driven paths of bundled ones."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.errors import ParameterError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.imported import START_FRAMES, ImportedVariant, load_imported
from gauge_envs.references.tables import FileModel, read_toml
from gauge_envs.scene import Hinge, RigidBody, Sphere, Tether
from gauge_envs.scene.contact_faces import blocked_directions, outer_normals
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.geometry import FloatArray, Vector, length_of, vector
from gauge_envs.scene.jitter import across, rotate
from gauge_envs.scene.profiles import SampledProfile
from gauge_envs.scene.states import nominal_states, row_of
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.reference import driven_trials_file

START_RATES_HZ = FRAME_RATE_HZ * np.array([-1.5, 2.0, -0.5])
"""Weights of the first three frames in the initial velocity, exact for a constant acceleration."""


class _DrivenTrials(FileModel):
    times_s: tuple[float, ...]
    start_m: dict[str, tuple[Vector, ...]]
    motions: dict[str, tuple[tuple[tuple[float, ...], ...], ...]]


class DrivenTrial(NamedTuple):
    """Initial states and driven paths of a trial.

    Attributes:
        states: Initial states, shape [body_count, 13].
        drivers: Drivers with the paths of the trial.
    """

    states: FloatArray
    drivers: tuple[Driver, ...]


def driven_trial(experiment: Experiment, trial: int) -> DrivenTrial | None:
    """Return initial states and driven paths of a bundled trial; None if the experiment has no such trials."""
    file = driven_trials_file(experiment)
    if file is None:
        return None
    known = read_toml(file, _DrivenTrials)
    scene = experiment.scene
    count = min(map(len, known.start_m.values()))
    if not 0 <= trial < count:
        raise ParameterError(
            f"{experiment.id}: trial {trial} does not exist: choose 0 to {count - 1}"
        )
    states = nominal_states(scene)
    for name, positions_m in known.start_m.items():
        states[row_of(scene, name), :3] = positions_m[trial]
    drivers = []
    for driver in scene.drivers:
        point_m = vector(states[row_of(scene, driver.body), :3])
        motions = []
        for motion, values in zip(
            driver.motions, known.motions[driver.body][trial], strict=True
        ):
            path = SampledProfile(times_s=known.times_s, values=values)
            # With `drivers="action"` only actions move bodies.
            profiles = (path,) if motion.profiles else ()
            motions.append(replace(motion, point_m=point_m, profiles=profiles))
        drivers.append(replace(driver, motions=tuple(motions)))
    return DrivenTrial(states, tuple(drivers))


def trial_states(experiment: Experiment, trial: int) -> FloatArray:
    """Return the initial states of an imported trial, shape [body_count, 13].

    Velocities are differences of the first three frames, exact for a constant acceleration. Measurement noise of 0.1 mm
    makes a velocity wrong by 8 mm/s, and noise of 0.1 degrees a spin by 0.14 rad/s.

    Orientations are relative to the mean over the trials, which corresponds to the published orientation. So the body
    frame of the motion capture does not matter. Without recorded orientations, orientation and angular velocity stay
    nominal.

    Recorded bodies move only in directions in which they do not start inside another body, as with noise:

    - A body without a joint, except a sphere, translates in the plane of the face at which it touches another body. It
      rotates about the normal of that face. Without such a face, the normal is the body axis closest to vertical.
    - A sphere takes the recorded pose and velocities.
    - A hinged body rotates about its hinge. A tethered body swings with a tight string.
    - A body attached to a deformable body keeps its nominal state.

    Args:
        experiment: An experiment that observes positions of rigid bodies.
        trial: Number of the trial, from 0.
    """
    scene = experiment.scene
    imported = _imported(experiment)
    positions_m = _first_positions_m(experiment, imported, trial)
    rotations = _first_rotations(imported, trial, len(experiment.recorded))
    attached = {attachment.to for attachment in scene.attachments}
    joints = {joint.body: joint for joint in scene.joints}
    names = [name for name in experiment.recorded if name not in attached]
    if not names:
        raise ParameterError(
            f"{experiment.id}: every recorded body is attached to a deformable body, so no trial sets its start: "
            "remove the option 'trial'"
        )
    states = nominal_states(scene)
    for name in names:
        index = experiment.recorded.index(name)
        state, body = states[row_of(scene, name)], scene.body(name)
        if name in joints:
            _swing(state, joints[name], positions_m[:, index])
            continue
        normals = outer_normals(scene.contact_normals, [name])
        blocked = blocked_directions(body.pose, normals)
        _move(state, body, blocked, positions_m[:, index], *rotations[index])
    return states


def _imported(experiment: Experiment) -> ImportedVariant:
    """Return the import of an experiment that can start from its trials."""
    if experiment.score.observable is not Observable.POSITION:
        raise ParameterError(
            f"{experiment.id} observes {experiment.score.observable.value}, but only experiments that observe "
            "positions of rigid bodies can start from a trial. Remove the option 'trial'."
        )
    imported = load_imported(experiment.name)
    if imported is None:
        raise ParameterError(
            f"{experiment.id}: option 'trial' needs imported trials, and none were imported. Run `gauge data import "
            "DIR` first."
        )
    return imported


def _first_positions_m(
    experiment: Experiment, imported: ImportedVariant, trial: int
) -> FloatArray:
    """Return the positions of the recorded bodies in the first frames [m], shape [START_FRAMES, body_count, 3]."""
    trials = imported.band.trials
    if trials is None:
        raise ParameterError(
            f"{experiment.id}: the import holds no single trials. Run `gauge data import DIR` again for option 'trial'."
        )
    if not 0 <= trial < len(trials):
        raise ParameterError(
            f"{experiment.id}: trial {trial} does not exist: choose 0 to {len(trials) - 1}"
        )
    first = trials[trial, :START_FRAMES]
    if len(first) < START_FRAMES or np.isnan(first).any():
        raise ParameterError(
            f"{experiment.id}: trial {trial} was not measured in all of its first {START_FRAMES} frames, "
            "which give the velocity. Choose another trial."
        )
    return 1e-3 * first.reshape(len(first), -1, 3)


def _first_rotations(
    imported: ImportedVariant, trial: int, body_count: int
) -> list[tuple[Rotation, FloatArray]]:
    """Return the rotation of each recorded body from the mean start, and its angular velocity [rad/s].

    Both are in the world frame. They are zero for a body without an orientation in all first frames of the trial.
    """
    still = (Rotation.identity(), np.zeros(3))
    quaternions = imported.start_quaternions
    if quaternions is None:
        return [still] * body_count
    rotations = []
    for index in range(body_count):
        known = np.asarray(np.isfinite(quaternions[:, :, index]).all(axis=(1, 2)))
        if not known[trial]:
            rotations.append(still)
            continue
        mean = Rotation.from_quat(quaternions[known, 0, index]).mean()
        frames = Rotation.from_quat(quaternions[trial, :, index])
        turned = (frames * frames[0].inv()).as_rotvec()
        rotations.append((frames[0] * mean.inv(), START_RATES_HZ @ turned))
    return rotations


def _move(
    state: FloatArray,
    body: RigidBody,
    blocked: FloatArray,
    positions_m: FloatArray,
    rotation: Rotation,
    spin: FloatArray,
) -> None:
    """Write the recorded initial state of a body without a joint to its state.

    Args:
        state: Its nominal state, shape [13].
        body: The body.
        blocked: Directions in which it must not move, shape [1 to 3, 3].
        positions_m: Its positions in the first frames [m], shape [START_FRAMES, 3].
        rotation: Its rotation from the mean start.
        spin: Its angular velocity [rad/s].
    """
    velocity = START_RATES_HZ @ positions_m
    shift = positions_m[0] - state[:3]
    if not isinstance(body.shape, Sphere):
        shift, velocity = across(shift, blocked), across(velocity, blocked)
        is_single = len(blocked) == 1
        spin = (spin @ blocked[0]) * blocked[0] if is_single else np.zeros(3)
        rotation = _about(rotation, blocked[0]) if is_single else Rotation.identity()
    rotate(state[:7], rotation.as_rotvec(), state[:3].copy())
    state[:3] += shift
    state[7:10], state[10:] = velocity, spin


def _about(rotation: Rotation, axis: FloatArray) -> Rotation:
    """Return the part of a rotation that is about an axis (swing-twist decomposition)."""
    x, y, z, w = rotation.as_quat()
    return Rotation.from_rotvec(2.0 * np.arctan2(np.array([x, y, z]) @ axis, w) * axis)


def _swing(state: FloatArray, joint: Hinge | Tether, positions_m: FloatArray) -> None:
    """Rotate a state about its joint towards the first recorded position, with the recorded velocity along the arc."""
    velocity = START_RATES_HZ @ positions_m
    anchor = np.asarray(joint.anchor_m)
    arm, recorded = state[:3] - anchor, positions_m[0] - anchor
    if isinstance(joint, Hinge):
        axis = np.asarray(joint.axis)
        flat, aim = across(arm, axis[None]), across(recorded, axis[None])
        rotation_rad = np.arctan2(np.cross(flat, aim) @ axis, flat @ aim) * axis
        arm = Rotation.from_rotvec(rotation_rad).apply(flat)
        angular = np.cross(arm, velocity) @ axis / (arm @ arm) * axis
    else:
        normal = np.cross(arm, recorded)
        size = length_of(normal)
        angle = np.arctan2(size, arm @ recorded)
        rotation_rad = angle * normal / size if size else np.zeros(3)
        arm = Rotation.from_rotvec(rotation_rad).apply(arm)
        angular = np.cross(arm, velocity) / (arm @ arm)
    rotate(state[:7], rotation_rad, anchor)
    state[7:10], state[10:] = np.cross(angular, arm), angular
