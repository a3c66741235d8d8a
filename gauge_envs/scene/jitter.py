"""Random initial states of a scene, like the scatter of real trials that are set up by hand."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gauge_envs.errors import ParameterError
from gauge_envs.scene.bodies import Hinge, RigidBody, Tether
from gauge_envs.scene.contact_faces import TouchingGroup, face_normal
from gauge_envs.scene.geometry import (
    FloatArray,
    Pose,
    Sphere,
    quaternion_products,
    rotation_matrices,
    unit_quaternions,
    vector_quaternions,
)
from gauge_envs.scene.scene import Scene
from gauge_envs.scene.states import nominal_states

JITTER_FORMAT = 3
"""Version of the random draw; when it changes, a sweep runs its repeats again."""


@dataclass(frozen=True, kw_only=True)
class Jitter:
    """Standard deviations of initial poses and velocities.

    Attributes:
        position_m: Standard deviation of each coordinate of a position [m]. The heights of 22 real drops of a ball
            scatter by 1.0 mm. Cubes at rest on a slope of 10 degrees lie 0.6 to 1.9 mm from their mean (paper, Table
            5).
        angle_rad: Standard deviation of a rotation [rad]. It was not measured; 0.5 degrees is 0.2 mm at the edge of a
            cube of 50 mm.
        velocity_m_per_s: Standard deviation of each coordinate of a linear velocity [m/s].
        angular_velocity_rad_per_s: Standard deviation of each coordinate of an angular velocity [rad/s].

    Raises:
        ParameterError: A value is negative or not a number.
    """

    position_m: float = 1.0e-3
    angle_rad: float = math.radians(0.5)
    velocity_m_per_s: float = 0.0
    angular_velocity_rad_per_s: float = 0.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            if not (is_number and math.isfinite(value) and value >= 0.0):
                raise ParameterError(
                    f"jitter {name} is {value!r}: give a finite number of 0 or more"
                )

    def to_dict(self) -> dict[str, float]:
        """Return the standard deviations for a result, without those of velocities if they are 0."""
        return {
            name: value
            for name, value in vars(self).items()
            if value or name in ("position_m", "angle_rad")
        }


def can_scatter(scene: Scene) -> bool:
    """Return whether noise can move a body of a scene: a free rigid body, or a cloth that nothing clamps."""
    return bool(scene.free or scene.free_cloths)


def perturbed_states(scene: Scene, jitter: Jitter, *, seed: int) -> FloatArray:
    """Return random initial states that keep the contacts of the nominal start, shape [body_count, 13].

    - A dynamic body translates in the plane of the face at which it touches another body, and rotates about the normal
      of that face. Without such a face, the normal is the body axis closest to vertical. With faces of several
      directions, the body translates along all of them and does not rotate.
    - Bodies that touch one another, such as the bricks of a wall, move together as a rigid body.
    - A ball translates in all three coordinates.
    - A hinged body rotates about its hinge. A tethered body swings with a tight string.
    - A cloth without attachments translates and rotates in its plane.

    Random velocities add to those of the scene in the same directions: in the plane of the face and about its normal,
    about a hinge, or about the anchor of a string. Poses do not depend on the standard deviations of velocities.

    Fixed and driven bodies, and bodies attached to them, do not move.

    Args:
        scene: The scene.
        jitter: Standard deviations of the initial state.
        seed: Seed of the random numbers, 0 or more.

    Raises:
        ParameterError: Noise can move no body of the scene.
    """
    if not can_scatter(scene):
        raise ParameterError(
            "nothing to jitter: every body of this scene is fixed, driven, or attached to a fixed or driven body"
        )
    states = nominal_states(scene)
    noise = _Noise(scene, jitter, seed)
    joints = {joint.body: joint for joint in scene.joints}
    for state, body in zip(states, scene.bodies, strict=False):
        if body.name in joints and body.name in scene.free:
            noise.swing(state, joints[body.name])
        elif body.name in scene.free:
            noise.move(state, body)
    rows = states[len(scene.bodies) :]
    for state, soft in zip(rows, scene.deformables, strict=True):
        if soft.name in scene.free_cloths:
            noise.move_in_plane(state, soft.pose)
    return states


class _Noise:
    """Random translations, rotations and velocities of the bodies of a scene.

    Args:
        scene: The scene.
        jitter: Standard deviations of the initial state.
        seed: Seed of the random numbers.
    """

    def __init__(self, scene: Scene, jitter: Jitter, seed: int) -> None:
        self._scene, self._jitter = scene, jitter
        self._places = np.random.default_rng(seed)
        # Poses do not depend on the standard deviations of velocities.
        self._pushes = np.random.default_rng((seed, 1))
        self._moves: dict[TouchingGroup, tuple[FloatArray, ...]] = {}

    def move(self, state: FloatArray, body: RigidBody) -> None:
        """Move a body without a joint; the bodies that it touches get the same motion."""
        group = self._scene.touching_groups[body.name]
        is_ball = isinstance(body.shape, Sphere)
        blocked = np.zeros((0, 3)) if is_ball else group.blocked
        if group not in self._moves:
            move = self._drawn_move(blocked, _axis(group.blocked))
            self._moves[group] = (*move, *self._drawn_push())
        shift_m, rotation_rad, linear, angular = self._moves[group]
        rotate(state[:7], rotation_rad, group.centre_m)
        state[:3] += shift_m
        if not is_ball:
            linear = across(linear, blocked)
            angular = (angular @ _axis(blocked)) * _axis(blocked)
        if len(group.members) > 1:
            linear = linear + np.cross(angular, state[:3] - group.centre_m - shift_m)
        state[7:10] += linear
        state[10:] += angular

    def move_in_plane(self, state: FloatArray, pose: Pose) -> None:
        """Move a cloth, whose nominal pose is given, in its plane."""
        normal = face_normal(pose)
        shift_m, rotation_rad = self._drawn_move(normal[None], normal)
        rotate(state[:7], rotation_rad, state[:3].copy())
        state[:3] += shift_m

    def swing(self, state: FloatArray, joint: Hinge | Tether) -> None:
        """Rotate a body about its hinge, or about the anchor of its tight string."""
        is_hinge = isinstance(joint, Hinge)
        axis = np.asarray(joint.axis) if isinstance(joint, Hinge) else np.ones(3)
        angles = self._places.standard_normal(1 if is_hinge else 3)
        rotate(
            state, self._jitter.angle_rad * angles * axis, np.asarray(joint.anchor_m)
        )
        linear, angular = self._drawn_push()
        arm_m = state[:3] - joint.anchor_m
        if is_hinge:
            tangent_m = np.cross(axis, arm_m)
            radius_m2 = float(tangent_m @ tangent_m)
            # A linear velocity along the circle is a rate of rotation.
            along = tangent_m @ linear / radius_m2 if radius_m2 else 0.0
            angular = (angular @ axis + along) * axis
            linear = np.cross(angular, arm_m)
        else:
            radial = arm_m * (arm_m @ linear) / (arm_m @ arm_m)
            linear = linear - radial + np.cross(angular, arm_m)
        state[7:10] += linear
        state[10:] += angular

    def _drawn_move(
        self, blocked: FloatArray, axis: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return a random translation [m] without blocked directions, and a rotation vector [rad] about an axis."""
        shift_m = self._jitter.position_m * self._places.standard_normal(3)
        angle_rad = self._jitter.angle_rad * self._places.standard_normal()
        return across(shift_m, blocked), angle_rad * axis

    def _drawn_push(self) -> tuple[FloatArray, FloatArray]:
        """Return a random linear [m/s] and angular velocity [rad/s]."""
        linear, angular = self._pushes.standard_normal((2, 3))
        jitter = self._jitter
        return (
            jitter.velocity_m_per_s * linear,
            jitter.angular_velocity_rad_per_s * angular,
        )


def rotate(state: FloatArray, rotation_rad: FloatArray, point_m: FloatArray) -> None:
    """Rotate a pose, shape [7], or a state, shape [13], about a world point by a rotation vector [rad], in place."""
    quaternion = vector_quaternions(rotation_rad[None])[0]
    matrix = rotation_matrices(quaternion)
    state[:3] = matrix @ (state[:3] - point_m) + point_m
    state[3:7] = unit_quaternions(quaternion_products(quaternion, state[3:7]))
    state[7:] = (state[7:].reshape(-1, 3) @ matrix.T).ravel()


def across(vector: FloatArray, blocked: FloatArray) -> FloatArray:
    """Return the part of a vector perpendicular to orthonormal directions of shape [count, 3]."""
    for direction in blocked:
        vector = vector - (vector @ direction) * direction
    return vector


def _axis(blocked: FloatArray) -> FloatArray:
    """Return the only axis about which a body can rotate, shape [3]; zero if several faces prevent rotation."""
    return blocked[0] if len(blocked) == 1 else np.zeros(3)
