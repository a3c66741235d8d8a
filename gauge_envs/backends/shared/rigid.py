"""Rigid bodies, for every engine: states as rows of 13 numbers, hinges, strings as springs, and prescribed motion."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from gauge_envs.backends.settings import SteppedSettings
from gauge_envs.backends.simulation import Simulation
from gauge_envs.scene import Hinge, Motion, Pose, RigidBody, Scene, Tether
from gauge_envs.scene.geometry import (
    BoolArray,
    FloatArray,
    length_of,
    quaternion_products,
    quaternion_vectors,
    unit_quaternions,
    vector_quaternions,
)
from gauge_envs.scene.meshes import body_mass_properties

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])
"""Factors of a unit quaternion w, x, y, z that give the inverse rotation."""


def body_state(pose: Pose) -> FloatArray:
    """Return the state of a body at rest in a pose, shape [13]; see `Simulation.body_states`."""
    return np.array([*pose.position_m, *pose.quaternion, *np.zeros(6)])


def placed_states(scene: Scene) -> dict[str, FloatArray]:
    """Return the states of the fixed bodies of a scene, by name."""
    return {
        body.name: body_state(body.pose)
        for body in scene.bodies
        if body.motion is Motion.FIXED
    }


class MeanForces:
    """Mean contact forces of pairs of bodies over the steps of an interval, in one world.

    Args:
        pairs: The two bodies of each pair.
        touches: Function that yields the contacts of a step: two bodies, and the force on the first [N], shape [3].
    """

    def __init__(
        self,
        pairs: Sequence[tuple[Hashable, Hashable]],
        touches: Callable[[], Iterable[tuple[Hashable, Hashable, FloatArray]]],
    ) -> None:
        self._pairs = pairs
        self._touches = touches
        self.clear()

    def clear(self) -> None:
        """Begin an interval."""
        self._sums_n = np.zeros((len(self._pairs), 3))
        self._count = 0

    def add(self) -> None:
        """Add the forces of a step."""
        for first, second, force_n in self._touches():
            for sum_n, pair in zip(self._sums_n, self._pairs, strict=True):
                if pair == (first, second):
                    sum_n += force_n
                elif pair == (second, first):
                    sum_n -= force_n
        self._count += 1

    def mean(self) -> FloatArray:
        """Return the mean force on the first body of each pair [N], shape [1, pair_count, 3]."""
        return self._sums_n[None] / max(self._count, 1)


class PlacedSimulation(Simulation):
    """A simulation that stores the states of some bodies and reads all other states from the engine.

    Attributes:
        placed: States of the stored bodies by name, shape [13] or [world_count, 13].
    """

    placed: dict[str, FloatArray]

    @abstractmethod
    def moving_states(self, names: Sequence[str]) -> FloatArray:
        """Return the states of bodies that the engine moves, shape [world_count, len(names), 13]."""

    def body_states(self, names: Sequence[str]) -> FloatArray:
        """Return the states of bodies, shape [world_count, len(names), 13]; see `Simulation.body_states`."""
        if names and self.placed.keys().isdisjoint(names):
            return self.moving_states(names)
        states = np.empty((self.world_count, len(names), 13))
        moving = []
        for row, name in enumerate(names):
            if name in self.placed:
                states[:, row] = self.placed[name]
            else:
                moving.append(row)
        if moving:
            states[:, moving] = self.moving_states([names[row] for row in moving])
        return states


class SingleWorldSimulation(PlacedSimulation):
    """One world of a scene in an engine without batches and without random numbers.

    Attributes:
        scene: The scene.
        step_s: Time step [s].
        motions: Prescribed motions of driven bodies by name, shape [19].
        wrenches: Forces [N] and torques [N m] on dynamic bodies by name, shape [6].
    """

    def __init__(self, scene: Scene, settings: SteppedSettings) -> None:
        self.settings = settings.model_dump(mode="json")
        self.scene = scene
        self.step_s = settings.timestep_s

    def reset(
        self,
        starts: FloatArray | None = None,
        seed: int = 0,
        worlds: BoolArray | None = None,
    ) -> None:
        """Start the world; the seed has no effect."""
        self.placed = placed_states(self.scene)
        self.motions: dict[str, FloatArray] = {}
        self.wrenches: dict[str, FloatArray] = {}
        self.start(None if starts is None else starts[0])

    @abstractmethod
    def start(self, states: FloatArray | None) -> None:
        """Start at initial states, shape [body_count, 13], or at the nominal start."""

    def drive(self, body: str, targets: FloatArray) -> None:
        """Prescribe a kinematic body; see `Simulation.drive`."""
        self.motions[body] = targets[0].copy()

    def apply_wrench(self, body: str, wrenches: FloatArray) -> None:
        """Apply a force and a torque to a dynamic body; see `Simulation.apply_wrench`."""
        self.wrenches[body] = wrenches[0].copy()


def principal_axes(inertia_kg_m2: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the principal moments of inertia [kg m^2], shape [3], and a rotation matrix whose columns are their axes.

    Args:
        inertia_kg_m2: Inertia in the body frame [kg m^2], shape [3, 3]. A diagonal inertia keeps the axes of the body.
    """
    moments = np.diag(inertia_kg_m2)
    mixed = inertia_kg_m2 - np.diag(moments)
    if np.abs(mixed).max() <= 1e-12 * np.abs(moments).max():
        return moments, np.eye(3)
    moments, axes = np.linalg.eigh(inertia_kg_m2)
    axes[:, 2] *= np.linalg.det(axes)
    return moments, axes


def centre_velocity(body: RigidBody, centre_m: ArrayLike) -> FloatArray:
    """Return the initial velocity of a body's centre of mass [m/s], shape [3], which many engines expect.

    Args:
        body: The body, whose velocity is that of its origin.
        centre_m: Centre of mass in the body frame [m], shape [3].
    """
    arm_m = body.pose.rotation.apply(centre_m)
    return body.linear_velocity_m_per_s + np.cross(
        body.angular_velocity_rad_per_s, arm_m
    )


def hinge_frame(hinge: Hinge) -> Pose:
    """Return the frame in the world at a hinge's anchor, whose x axis is that of the hinge."""
    from scipy.spatial.transform import Rotation

    rotation = Rotation.align_vectors([hinge.axis], [[1.0, 0.0, 0.0]])[0]
    return Pose.from_rotation(hinge.anchor_m, rotation)


def hinge_angle(hinge: Hinge, nominal: Pose, state: FloatArray) -> float:
    """Return the angle by which a body has turned about its hinge [rad], at most half a turn.

    Args:
        hinge: The hinge.
        nominal: Pose of the body at the nominal start.
        state: State of the body, shape [13].
    """
    inverse = CONJUGATE * nominal.quaternion
    rotation = quaternion_products(state[3:7], inverse)
    return float(quaternion_vectors(rotation[None])[0] @ hinge.axis)


@dataclass(frozen=True)
class TetherSpring:
    """A string for engines without strings: a stiff spring with critical damping, which only pulls.

    Attributes:
        tether: The string.
        mass_kg: Mass of its body.
        centre_m: Centre of mass in the body frame [m], shape [3].
        inverse_inertia: Inverse of the inertia about the centre of mass, body axes [1/(kg m^2)], shape [3, 3].
    """

    tether: Tether
    mass_kg: float
    centre_m: FloatArray
    inverse_inertia: FloatArray

    @classmethod
    def of(cls, scene: Scene) -> list[TetherSpring]:
        """Return the springs of the strings of a scene."""
        springs = []
        for joint in scene.joints:
            if isinstance(joint, Tether):
                body = scene.body(joint.body)
                centre_m, inertia = body_mass_properties(body)
                inverse = np.linalg.inv(inertia).astype(np.float64)
                springs.append(cls(joint, body.mass_kg, centre_m, inverse))
        return springs

    def end_mass_kg(self, rotation: Rotation, direction: FloatArray) -> float:
        """Return the effective mass at the body's origin: a force there over the acceleration along it.

        With r from the centre of mass to the origin, 1 / m_end = 1 / m + (r x n) . I^-1 (r x n).

        Args:
            rotation: Rotation of the body.
            direction: Direction n of the force in the world, a unit vector, shape [3].
        """
        if not self.centre_m.any():
            return self.mass_kg
        along = rotation.apply(direction, inverse=True)
        lever = np.cross(-self.centre_m, along)
        return 1.0 / (1.0 / self.mass_kg + float(lever @ self.inverse_inertia @ lever))

    def pull_n(self, state: FloatArray, frequency_per_s: float) -> FloatArray | None:
        """Return the force of the string on the origin of its body [N], shape [3], or None if the string is slack.

        Args:
            state: State of the body, shape [13].
            frequency_per_s: Angular frequency of the spring [1/s].
        """
        from scipy.spatial.transform import Rotation

        arm = self.tether.anchor_m - state[:3]
        length = length_of(arm)
        if length <= self.tether.length_m:
            return None
        along = arm / length
        lengthening = -float(along @ state[7:10])
        acceleration = (
            frequency_per_s**2 * (length - self.tether.length_m)
            + 2.0 * frequency_per_s * lengthening
        )
        if acceleration <= 0.0:
            return None
        rotation = Rotation.from_quat(state[3:7], scalar_first=True)
        return self.end_mass_kg(rotation, along) * acceleration * along


def later_targets(targets: FloatArray, seconds: float | FloatArray) -> FloatArray:
    """Return the targets of `Simulation.drive` after some seconds, shape [N, 19].

    Args:
        targets: The targets, shape [N, 19].
        seconds: The time, or a time for each row, shape [N, 1].
    """
    moved = targets.copy()
    velocity, acceleration = targets[:, 7:13], targets[:, 13:]
    travel = seconds * velocity + 0.5 * seconds**2 * acceleration
    moved[:, :3] += travel[:, :3]
    turns = vector_quaternions(travel[:, 3:])
    moved[:, 3:7] = unit_quaternions(quaternion_products(turns, targets[:, 3:7]))
    moved[:, 7:13] += seconds * acceleration
    return moved


def motion_steps(
    target: FloatArray, step_s: float, count: int
) -> tuple[FloatArray, FloatArray]:
    """Divide a prescribed motion into steps of constant velocity that end at the pose of the next step.

    A semi-implicit engine moves a body by its new velocity times the step, and so follows the motion exactly.

    Args:
        target: A row of `Simulation.drive`, shape [19].
        step_s: Length of a step [s].
        count: Number of steps.

    Returns:
        Pose at the start of each step, position [m] and quaternion w, x, y, z, shape [count, 7]; and linear [m/s]
        and angular [rad/s] velocity in it, world frame, shape [count, 6].
    """
    times_s = step_s * np.arange(count + 1, dtype=np.float64)[:, None]
    travel = (target[7:13] + 0.5 * target[13:] * times_s) * times_s
    turned = vector_quaternions(travel[:, 3:])
    start = unit_quaternions(target[3:7])
    poses = np.hstack([target[:3] + travel[:, :3], quaternion_products(turned, start)])
    steps = np.diff(travel, axis=0)
    turns = quaternion_products(turned[1:], turned[:-1] * CONJUGATE)
    steps[:, 3:] = quaternion_vectors(turns)
    return poses[:-1], steps / step_s
