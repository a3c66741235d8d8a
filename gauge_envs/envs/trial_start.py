"""Start an episode as an imported trial starts, or drive it as a bundled one: option `trial` of a reset."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.errors import ParameterError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.imported import START_FRAMES, ImportedVariant, load_imported
from gauge_envs.references.tables import FileModel, read_toml, scoring_folder
from gauge_envs.references.user_data import DataSource
from gauge_envs.scene import Hinge, Pose, RigidBody, Scene, Sphere, Tether
from gauge_envs.scene.contact_faces import blocked_directions
from gauge_envs.scene.geometry import FloatArray, Vector, length_of, vector
from gauge_envs.scene.jitter import swung
from gauge_envs.scene.profiles import SampledProfile
from gauge_envs.scene.timing import FRAME_RATE_HZ

DIFFERENCE_PER_FRAME = (-1.5, 2.0, -0.5)
"""Weights of the first three frames in the velocity of the first one, exact for a constant acceleration."""

SAME_ANGLE_RAD = 1e-12
"""Largest rotation that rounding gives to a body that did not rotate [rad]."""


class _DrivenTrials(FileModel):
    times_s: tuple[float, ...]
    start_m: dict[str, tuple[Vector, ...]]
    motions: dict[str, tuple[tuple[tuple[float, ...], ...], ...]]


def driven_trial(experiment: Experiment, trial: int) -> Experiment | None:
    """Return an experiment with the start and driven path of a bundled trial, which scores it; None without such."""
    file = scoring_folder("trials") / f"{experiment.name}.toml"
    is_imported = DataSource.IMPORTED in (
        experiment.drivers,
        experiment.reference_source,
    )
    if experiment.edited or is_imported or not file.is_file():
        return None
    known = read_toml(file, _DrivenTrials)
    scene = experiment.scene
    count = min(map(len, known.start_m.values()))
    if not 0 <= trial < count:
        raise ParameterError(
            f"{experiment.id}: trial {trial} does not exist: choose 0 to {count - 1}"
        )
    starts = {
        name: replace(scene.body(name).pose, position_m=positions_m[trial])
        for name, positions_m in known.start_m.items()
    }
    drivers = []
    for driver in scene.drivers:
        point_m = starts[driver.body].position_m
        motions = []
        for motion, values in zip(
            driver.motions, known.motions[driver.body][trial], strict=True
        ):
            path = SampledProfile(times_s=known.times_s, values=values)
            # With `drivers="action"` nothing moves by itself.
            profiles = (path,) if motion.profiles else ()
            motions.append(replace(motion, point_m=point_m, profiles=profiles))
        drivers.append(replace(driver, motions=tuple(motions)))
    bodies = tuple(
        replace(body, pose=starts.get(body.name, body.pose)) for body in scene.bodies
    )
    return replace(
        experiment,
        scene=replace(scene, bodies=bodies, drivers=tuple(drivers)),
        trial=trial,
    )


def trial_scene(experiment: Experiment, trial: int) -> Scene:
    """Return the scene of an experiment with the start of an imported trial: poses and velocities.

    Velocities are differences of the first three frames, exact for a constant acceleration. Measurement noise of 0.1 mm
    makes a velocity wrong by 8 mm/s, and noise of 0.1 degrees a spin by 0.14 rad/s.

    Orientations count from the mean over the trials, which takes the place of the calibrated orientation. So the body
    frame that the motion capture chose does not matter. Without recorded orientations, orientation and spin stay those
    of the scene.

    Each recorded body moves as far as it can without starting inside another, as with a jitter:

    - A body that is neither a sphere nor on a joint moves and flies in the plane of the face at which it touches
      another one, and rotates about the normal of that face. Where it touches none, the normal is the body axis that is
      closest to vertical.
    - A sphere takes the recorded pose and velocities.
    - A hinged body rotates about its hinge. A tethered body swings with a tight string.
    - A body that is attached to a deformable body keeps its start.

    Args:
        experiment: An experiment that observes positions of rigid bodies.
        trial: Number of the trial, from 0.
    """
    scene = experiment.scene
    imported = _imported(experiment)
    positions_m = _first_positions_m(experiment, imported, trial)
    turns = _first_turns(imported, trial, len(experiment.recorded))
    attached = {attachment.to for attachment in scene.attachments}
    joints = {joint.body: joint for joint in scene.joints}
    started = {
        name: _started(
            scene.body(name),
            joints.get(name),
            blocked_directions(
                scene.body(name).pose, scene.contact_faces.normals([name])
            ),
            positions_m[:, index],
            *turns[index],
        )
        for index, name in enumerate(experiment.recorded)
        if name not in attached
    }
    if not started:
        raise ParameterError(
            f"{experiment.id}: every recorded body is attached to a deformable body, so no trial gives a start: remove "
            "the option 'trial'"
        )
    return replace(
        scene, bodies=tuple(started.get(body.name, body) for body in scene.bodies)
    )


def _imported(experiment: Experiment) -> ImportedVariant:
    """Return the import of an experiment that can start from its trials."""
    if experiment.score.observable is not Observable.POSITION:
        raise ParameterError(
            f"{experiment.id} observes {experiment.score.observable.value}: only experiments that observe positions of "
            "rigid bodies start from a trial. Remove the option 'trial'."
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


def _first_turns(
    imported: ImportedVariant, trial: int, body_count: int
) -> list[tuple[Rotation, FloatArray]]:
    """Return the rotation of each recorded body from the mean start, and its angular velocity [rad/s].

    Both are in the world frame, and are zero for a body whose orientation the trial does not have in all first frames.
    """
    still = (Rotation.identity(), np.zeros(3))
    quaternions = imported.start_quaternions
    if quaternions is None:
        return [still] * body_count
    turns = []
    for index in range(body_count):
        known = np.asarray(np.isfinite(quaternions[:, :, index]).all(axis=(1, 2)))
        if not known[trial]:
            turns.append(still)
            continue
        mean = Rotation.from_quat(quaternions[known, 0, index]).mean()
        frames = Rotation.from_quat(quaternions[trial, :, index])
        turned = (frames * frames[0].inv()).as_rotvec()
        turns.append(
            (
                frames[0] * mean.inv(),
                FRAME_RATE_HZ * np.asarray(DIFFERENCE_PER_FRAME) @ turned,
            )
        )
    return turns


def _started(
    body: RigidBody,
    joint: Hinge | Tether | None,
    blocked: FloatArray,
    positions_m: FloatArray,
    rotation: Rotation,
    spin: FloatArray,
) -> RigidBody:
    """Return a body at its recorded start.

    Args:
        body: The body.
        joint: Its joint, if any.
        blocked: Directions along which it cannot start elsewhere, shape [1 to 3, 3].
        positions_m: Its positions in the first frames [m], shape [START_FRAMES, 3].
        rotation: Its rotation from the mean start.
        spin: Its angular velocity [rad/s].
    """
    velocity = FRAME_RATE_HZ * np.asarray(DIFFERENCE_PER_FRAME) @ positions_m
    shift = positions_m[0] - body.pose.position_m
    if joint is not None:
        return _swinging(body, joint, positions_m[0], velocity)
    if not isinstance(body.shape, Sphere):
        for normal in blocked:
            shift, velocity = (
                one - (one @ normal) * normal for one in (shift, velocity)
            )
        is_single = len(blocked) == 1
        spin = (spin @ blocked[0]) * blocked[0] if is_single else np.zeros(3)
        rotation = _about(rotation, blocked[0]) if is_single else Rotation.identity()
    pose = Pose.from_rotation(
        vector(body.pose.position_m + shift), rotation * body.pose.rotation
    )
    if rotation.magnitude() < SAME_ANGLE_RAD:
        # A rotation of nothing keeps the orientation bit for bit.
        pose = replace(body.pose, position_m=pose.position_m)
    return replace(
        body,
        pose=pose,
        linear_velocity_m_per_s=vector(velocity),
        angular_velocity_rad_per_s=vector(spin),
    )


def _about(rotation: Rotation, axis: FloatArray) -> Rotation:
    """Return the part of a rotation that is about an axis (swing-twist decomposition)."""
    x, y, z, w = rotation.as_quat()
    return Rotation.from_rotvec(2.0 * np.arctan2(np.array([x, y, z]) @ axis, w) * axis)


def _swinging(
    body: RigidBody, joint: Hinge | Tether, position_m: FloatArray, velocity: FloatArray
) -> RigidBody:
    """Return a body that is rotated about its joint towards a position, and swings with a velocity [m/s]."""
    anchor = np.asarray(joint.anchor_m)
    arm, recorded = np.subtract(body.pose.position_m, anchor), position_m - anchor
    if isinstance(joint, Hinge):
        axis = np.asarray(joint.axis)
        flat, aim = (one - (one @ axis) * axis for one in (arm, recorded))
        rotation = Rotation.from_rotvec(
            np.arctan2(np.cross(flat, aim) @ axis, flat @ aim) * axis
        )
        arm = rotation.apply(flat)
        angular = np.cross(arm, velocity) @ axis / (arm @ arm) * axis
    else:
        turn = np.cross(arm, recorded)
        size = length_of(turn)
        rotation = Rotation.from_rotvec(
            np.arctan2(size, arm @ recorded) * turn / size if size else np.zeros(3)
        )
        arm = rotation.apply(arm)
        angular = np.cross(arm, velocity) / (arm @ arm)
    return replace(
        swung(body, rotation.as_quat(scalar_first=True), anchor),
        linear_velocity_m_per_s=vector(np.cross(angular, arm)),
        angular_velocity_rad_per_s=vector(angular),
    )
