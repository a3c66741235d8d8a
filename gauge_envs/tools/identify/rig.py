"""Scenes of logged joints: one joint with its load, or the chain of an experiment, at the angles of a log."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, Protocol, Self, TypeVar

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from gauge_envs.backends.base import Backend
from gauge_envs.backends.settings import with_drive_interval
from gauge_envs.errors import ParameterError
from gauge_envs.runs.rollout import Rollout, record
from gauge_envs.scene import (
    BodyHinge,
    Hinge,
    JointDynamics,
    Motion,
    Plane,
    Pose,
    RigidBody,
    Scene,
    Sphere,
)
from gauge_envs.scene.geometry import FloatArray, length_of, vector
from gauge_envs.scene.hinged import (
    hinge_angle_rad,
    hinge_frames,
    joint_sign,
    other_end,
    parent_hinges,
)
from gauge_envs.scene.meshes import body_mass_properties
from gauge_envs.scene.motors import Servo, TorqueMotor
from gauge_envs.scene.profiles import SampledProfile
from gauge_envs.scene.servo_friction import SERVO_FRICTION, ServoFriction
from gauge_envs.scene.timing import DRIVE_INTERVAL_S
from gauge_envs.tools.identify.logs import Log

BACKLASH = "backlash_rad"
DYNAMICS = tuple(
    one.name for one in fields(JointDynamics) if one.name not in (BACKLASH, "servo")
)
SERVO = ("kp_n_m_per_rad", "kv_n_m_s_per_rad", "delay_s")
LIMIT = "torque_limit_n_m"
OFFSET = "offset_rad"
"""Angle that a servo adds to its command [rad], of both signs."""

AnyHinge = TypeVar("AnyHinge", Hinge, BodyHinge)

Terms = Mapping[str, float]
"""Numbers of one joint, by name of the field of `JointDynamics` or `Servo`."""


class Machine(Protocol):
    """Joints whose numbers change, in a simulator."""

    @property
    def name(self) -> str:
        """Name of the engine."""

    @property
    def stated(self) -> Sequence[Terms]:
        """Numbers that the scene or the model states, by joint, in the order of the logs."""

    @property
    def timestep_s(self) -> float:
        """Step of the simulation [s]."""

    def with_step(self, step_s: float) -> Self:
        """Return the same joints with another step [s]."""

    def size(self) -> tuple[float, float]:
        """Return the size of an inertia about a joint [kg m^2], and of the torque of a weight [N m]."""

    def angles(
        self, log: Log, terms: Sequence[Terms], start: tuple[FloatArray, FloatArray]
    ) -> FloatArray:
        """Return the angles of the joints at the times of a log [rad], shape [N, J].

        Args:
            log: The log.
            terms: Numbers of each joint; those that are not given are as stated.
            start: Angles [rad] and rates [rad/s] at the first sample, shape [J] each.

        Raises:
            DivergedError: The simulation diverges.
        """


@dataclass(frozen=True)
class SceneJoints:
    """Hinges of a scene on an engine of this package; see `Machine`."""

    engine: Backend
    scene: Scene
    settings: Mapping[str, Any]

    @property
    def name(self) -> str:
        """Name of the engine."""
        return self.engine.name

    @property
    def stated(self) -> Sequence[Terms]:
        """Numbers that the scene states, by joint."""
        return numbers(self.scene)

    @property
    def timestep_s(self) -> float:
        """Step of the simulation [s]."""
        given = with_drive_interval(self.settings, DRIVE_INTERVAL_S)
        return float(self.engine.build(self.scene, given).settings["timestep_s"])

    def with_step(self, step_s: float) -> Self:
        """Return the same joints with another step [s]."""
        return replace(self, settings={**self.settings, "timestep_s": step_s})

    def size(self) -> tuple[float, float]:
        """Return inertia [kg m^2] and weight [N m] of all moving bodies about the first hinge."""
        scene, anchor_m = self.scene, self.scene.hinges[0].anchor_m
        inertia = weight = 0.0
        for body in scene.dynamic_bodies:
            arm_m = length_of(np.subtract(body.pose.position_m, anchor_m))
            inertia += float(np.trace(body_mass_properties(body)[1])) / 3.0
            inertia += body.mass_kg * arm_m**2
            weight += scene.gravity_m_per_s2 * body.mass_kg * arm_m
        return inertia, weight

    def angles(
        self, log: Log, terms: Sequence[Terms], start: tuple[FloatArray, FloatArray]
    ) -> FloatArray:
        """Return the angles of the joints at the times of a log [rad], shape [N, J]; see `Machine`."""
        return simulated(self.engine, self.scene, log, terms, start, self.settings)


WORLD = RigidBody(
    name="world",
    shape=Plane(),
    motion=Motion.FIXED,
    pose=Pose(position_m=(0.0, 0.0, 0.0)),
    mass_kg=0.0,
)
"""What a hinge to the world hangs on."""


def one_joint(
    mass_kg: float, length_m: float, inertia_kg_m2: float | None = None
) -> Scene:
    """Return a joint about y that carries a load, which hangs straight down at angle 0.

    Args:
        mass_kg: Mass of the load.
        length_m: Distance from the axis to its centre of mass; 0 for a load that gravity does not turn.
        inertia_kg_m2: Moment of inertia about its centre of mass; None is that of a ball a tenth of the length wide.
    """
    radius_m = (
        0.05 * (length_m or 1.0)
        if inertia_kg_m2 is None
        else float(np.sqrt(2.5 * inertia_kg_m2 / mass_kg))
    )
    load = RigidBody(
        name="load",
        shape=Sphere(radius_m=radius_m),
        motion=Motion.DYNAMIC,
        pose=Pose(position_m=(0.0, 0.0, -length_m)),
        mass_kg=mass_kg,
    )
    hinge = Hinge(body="load", anchor_m=(0.0, 0.0, 0.0), axis=(0.0, 1.0, 0.0))
    return Scene(bodies=(load,), joints=(hinge,), duration_s=1.0)


def posed(
    scene: Scene,
    angles_rad: Sequence[float] | FloatArray,
    rates: Sequence[float] | FloatArray,
) -> Scene:
    """Return a scene whose hinges start at other angles, and turn.

    Args:
        scene: A scene in which each hinge is at angle 0, and its bodies at rest.
        angles_rad: Angles of its hinges, in the order of `Scene.hinges` [rad].
        rates: Rates of its hinges [rad/s].
    """
    pairs = zip(angles_rad, rates, strict=True)
    moving = {
        id(hinge): (float(angle), float(rate))
        for hinge, (angle, rate) in zip(scene.hinges, pairs, strict=True)
    }
    parents = parent_hinges(scene.body_hinges, scene.hung)
    bodies = {body.name: body for body in scene.bodies}
    placed: dict[str, BodyHinge] = {}
    order: list[tuple[str, Hinge | BodyHinge]] = [
        (one.body, one) for one in scene.joints if isinstance(one, Hinge)
    ]
    for name, hinge in [*order, *parents.items()]:
        angle, rate = (joint_sign(hinge, name) * one for one in moving[id(hinge)])
        carrier = (
            bodies[other_end(hinge, name)] if isinstance(hinge, BodyHinge) else WORLD
        )
        before = scene.body(carrier.name).pose if carrier is not WORLD else WORLD.pose
        anchor_m = carrier.pose.to_world(before.to_body(np.asarray(hinge.anchor_m)))
        carried = carrier.pose.rotation * before.rotation.inv()
        axis = carried.apply(hinge.axis)
        turn = Rotation.from_rotvec(angle * axis) * carried
        old = scene.body(name)
        arm_m = turn.apply(np.subtract(old.pose.position_m, hinge.anchor_m))
        spin = rate * axis + carrier.angular_velocity_rad_per_s
        reach_m = anchor_m - np.asarray(carrier.pose.position_m)
        speed = carrier.linear_velocity_m_per_s + np.cross(
            carrier.angular_velocity_rad_per_s, reach_m
        )
        bodies[name] = replace(
            old,
            pose=Pose.from_rotation(vector(anchor_m + arm_m), turn * old.pose.rotation),
            linear_velocity_m_per_s=vector(speed + np.cross(spin, arm_m)),
            angular_velocity_rad_per_s=vector(spin),
        )
        if isinstance(hinge, BodyHinge):
            placed[name] = replace(
                hinge,
                anchor_m=vector(anchor_m),
                axis=vector(axis / np.linalg.norm(axis)),
            )
    by_hinge = {id(parents[name]): hinge for name, hinge in placed.items()}
    return replace(
        scene,
        bodies=tuple(bodies.values()),
        body_hinges=tuple(by_hinge[id(hinge)] for hinge in scene.body_hinges),
    )


def with_terms(
    scene: Scene, terms: Sequence[Terms], log: Log, start_rad: FloatArray
) -> Scene:
    """Return a scene whose hinges have the terms, and the motors that follow a log.

    Args:
        scene: The scene; a torque limit of its servos stays.
        terms: Numbers of each hinge, in the order of `Scene.hinges`. Those that are not given stay.
        log: The log.
        start_rad: Angles of the hinges at the start, from which servos count [rad].
    """

    def changed(place: int, hinge: AnyHinge) -> AnyHinge:
        given = terms[place]
        terms_given: dict[str, Any] = {
            name: given[name] for name in (*DYNAMICS, BACKLASH) if name in given
        }
        servo = {name: given[name] for name in SERVO_FRICTION if name in given}
        if servo:
            before = hinge.dynamics.servo or ServoFriction()
            terms_given["servo"] = replace(before, **servo)
        dynamics = replace(hinge.dynamics, **terms_given)
        motor, profile = hinge.motor, partial(_profile, log, place)
        gains: dict[str, Any] = {
            name: given[name] for name in (*SERVO, LIMIT) if name in given
        }
        if log.command_rad is not None:
            zero_rad = float(start_rad[place]) - given.get(OFFSET, 0.0)
            command = profile(log.command_rad, zero_rad, stays=True)
            if isinstance(motor, Servo):
                motor = replace(motor, command=command, **gains)
            else:
                motor = replace(Servo(command=command, kp_n_m_per_rad=1.0), **gains)
        elif log.torque_n_m is not None:
            motor = TorqueMotor(
                command=profile(log.torque_n_m, 0.0), delay_s=given.get("delay_s", 0.0)
            )
        return replace(hinge, dynamics=dynamics, motor=motor)

    places = {id(hinge): place for place, hinge in enumerate(scene.hinges)}
    return replace(
        scene,
        joints=tuple(
            changed(places[id(one)], one) if isinstance(one, Hinge) else one
            for one in scene.joints
        ),
        body_hinges=tuple(changed(places[id(one)], one) for one in scene.body_hinges),
    )


def _profile(
    log: Log, joint: int, values: FloatArray, zero: float, *, stays: bool = False
) -> SampledProfile:
    """Return a line through samples; or, as a servo gets its commands, each sample until the next."""
    times_s, values = log.times_s - log.times_s[0], values[:, joint] - zero
    if stays:
        ends_s = times_s[1:] - 1e-3 * np.diff(times_s)
        times_s = np.append(np.stack([times_s[:-1], ends_s], axis=1), times_s[-1])
        values = np.append(np.repeat(values[:-1], 2), values[-1])
    return SampledProfile(
        times_s=tuple(times_s.tolist()), values=tuple(values.tolist())
    )


def simulated(
    engine: Backend,
    scene: Scene,
    log: Log,
    terms: Sequence[Terms],
    start: tuple[FloatArray, FloatArray],
    settings: Mapping[str, object] | None = None,
) -> FloatArray:
    """Return the angles of a scene's hinges on an engine at the times of a log [rad], shape [N, J].

    Args:
        engine: The engine.
        scene: A scene in which each hinge is at angle 0.
        log: The log.
        terms: Numbers of each hinge.
        start: Angles [rad] and rates [rad/s] at the first sample, shape [J] each.
        settings: Numerical settings of the engine.
    """
    moving = posed(replace(scene, duration_s=log.duration_s), *start)
    moving = with_terms(moving, terms, log, start[0])
    given = with_drive_interval(settings or {}, DRIVE_INTERVAL_S)
    simulation = engine.build(moving, given)
    interval_s = float(simulation.settings.get("drive_interval_s", DRIVE_INTERVAL_S))
    try:
        simulation.reset(0)
        longest_s = log.duration_s + max(0.02, interval_s)
        rollout = record(simulation, moving, longest_s, interval_s=interval_s)
    finally:
        simulation.close()
    angles = start[0] + np.stack(
        [_angle_rad(rollout, hinge) for hinge in moving.hinges], axis=1
    )
    return np.asarray(
        CubicSpline(rollout.times_s, angles)(log.times_s - log.times_s[0])
    )


def _angle_rad(rollout: Rollout, hinge: Hinge | BodyHinge) -> FloatArray:
    """Return the angle of a hinge since the start [rad], shape [sample_count]."""
    scene, world = rollout.scene, Pose(position_m=(0.0, 0.0, 0.0))
    name = hinge.body if isinstance(hinge, Hinge) else hinge.second
    still = Rotation.identity(len(rollout.times_s))
    if isinstance(hinge, Hinge):
        joined = BodyHinge(
            first="", second=name, anchor_m=hinge.anchor_m, axis=hinge.axis
        )
        return np.unwrap(
            hinge_angle_rad(
                hinge_frames(joined, world, scene.body(name).pose),
                still,
                rollout.rotation(name),
            )
        )
    frames = hinge_frames(hinge, scene.body(hinge.first).pose, scene.body(name).pose)
    return np.unwrap(
        hinge_angle_rad(frames, rollout.rotation(hinge.first), rollout.rotation(name))
    )


def numbers(scene: Scene) -> list[dict[str, float]]:
    """Return the numbers of each hinge by name, in the order of `Scene.hinges`; 0 is none."""
    known = [
        vars(hinge.dynamics)
        | (vars(hinge.motor) if hinge.motor else {})
        | (vars(hinge.dynamics.servo) if hinge.dynamics.servo else {})
        for hinge in scene.hinges
    ]
    return [
        {
            name: float(one.get(name) or 0.0)
            for name in (*DYNAMICS, BACKLASH, *SERVO, LIMIT, OFFSET, *SERVO_FRICTION)
        }
        for one in known
    ]


def check_joints(scene: Scene, log: Log) -> None:
    """Raise `ParameterError` unless a log has as many joints as a scene has hinges, which have no play."""
    if any(hinge.dynamics.backlash_rad for hinge in scene.hinges):
        raise ParameterError(
            "the scene has joints with backlash_rad: set it to 0, and fit it (--fit M1,backlash)"
        )
    if log.position_rad.shape[1] != len(scene.hinges):
        raise ParameterError(
            f"{log.name} has {log.position_rad.shape[1]} joints, and the scene {len(scene.hinges)} hinges: one column "
            "of position_rad for each hinge is needed, in the order of the scene"
        )
