"""Rigid bodies that hinges join to trees: their order, their frames, and what contradicts a hinge."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gauge_envs.scene.bodies import (
    BodyHinge,
    Hinge,
    JointDynamics,
    Motion,
    RigidBody,
    Tether,
)
from gauge_envs.scene.geometry import FloatArray, Pose, length_of, vector

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

UNIT = 1e-6
"""Largest deviation of an axis from unit length."""

SAME_VELOCITY = 1e-5
"""Largest velocity with which a hinge may start to tear [m/s, rad/s], relative to the largest number."""


@dataclass(frozen=True, eq=False)
class HingeFrames:
    """A hinge between two bodies in their own frames.

    Attributes:
        first_anchor_m: Point of the axis in the frame of the first body [m], shape [3].
        second_anchor_m: The same point in the frame of the second body [m], shape [3].
        first_axis: Direction of the axis in the frame of the first body, shape [3].
        second_axis: The same direction in the frame of the second body, shape [3].
        turn: Orientation of the second body in the frame of the first, at the start.
    """

    first_anchor_m: FloatArray
    second_anchor_m: FloatArray
    first_axis: FloatArray
    second_axis: FloatArray
    turn: Rotation


def hinge_frames(hinge: BodyHinge, first: Pose, second: Pose) -> HingeFrames:
    """Return a hinge in the frames of its bodies, which have the given poses at the start."""
    anchor_m, axis = np.asarray(hinge.anchor_m), np.asarray(hinge.axis)
    return HingeFrames(
        first_anchor_m=first.to_body(anchor_m),
        second_anchor_m=second.to_body(anchor_m),
        first_axis=first.rotation.apply(axis, inverse=True),
        second_axis=second.rotation.apply(axis, inverse=True),
        turn=first.rotation.inv() * second.rotation,
    )


def carried(hinge: BodyHinge, before: Pose, after: Pose) -> BodyHinge:
    """Return a hinge that moves with a frame from one pose to another."""
    axis = after.rotation.apply(before.rotation.apply(hinge.axis, inverse=True))
    anchor_m = after.to_world(before.to_body(np.asarray(hinge.anchor_m)))
    return replace(hinge, anchor_m=vector(anchor_m), axis=vector(axis))


def moved_along(body: RigidBody, before: RigidBody, after: RigidBody) -> RigidBody:
    """Return a body that moves with another one as if both were one body, when the other one starts elsewhere.

    Args:
        body: The body.
        before: The other body as it started.
        after: The other body as it starts now, with its velocities.
    """
    turn = after.pose.rotation * before.pose.rotation.inv()
    arm_m = np.subtract(body.pose.position_m, before.pose.position_m)
    spin, old_spin = (
        np.asarray(after.angular_velocity_rad_per_s),
        np.asarray(before.angular_velocity_rad_per_s),
    )
    slip = np.subtract(
        body.linear_velocity_m_per_s, before.linear_velocity_m_per_s
    ) - np.cross(old_spin, arm_m)
    reach_m = turn.apply(arm_m)
    return replace(
        body,
        pose=Pose.from_rotation(
            vector(after.pose.position_m + reach_m), turn * body.pose.rotation
        ),
        linear_velocity_m_per_s=vector(
            after.linear_velocity_m_per_s + np.cross(spin, reach_m) + turn.apply(slip)
        ),
        angular_velocity_rad_per_s=vector(
            spin + turn.apply(np.asarray(body.angular_velocity_rad_per_s) - old_spin)
        ),
    )


def hinge_angle_rad(
    frames: HingeFrames, first: Rotation, second: Rotation
) -> FloatArray:
    """Return the angle of a hinge since the start [rad], from -pi to pi.

    The part of the relative rotation that is not about the axis does not count.

    Args:
        frames: The hinge in the frames of its bodies.
        first: Orientations of the first body, body to world, T of them.
        second: Orientations of the second body.

    Returns:
        Shape [T].
    """
    # In the frame of the first body: identity at the start, a rotation about the axis later.
    x, y, z, w = (first.inv() * second * frames.turn.inv()).as_quat().T
    angle = 2.0 * np.arctan2(np.stack([x, y, z], axis=-1) @ frames.first_axis, w)
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)


def parent_hinges(
    hinges: Iterable[BodyHinge], hung: Collection[str] = ()
) -> dict[str, BodyHinge]:
    """Return the hinge through which each body hangs on another one in its tree, by the name of the body.

    The root of a tree is its body on a hinge to the world, or the first body of its first hinge, in the order of the
    scene.

    Args:
        hinges: Hinges between bodies.
        hung: Names of the bodies on hinges to the world.
    """
    parents: dict[str, BodyHinge] = {}
    for tree in hinge_trees(hinges):
        members = [name for hinge in tree for name in (hinge.first, hinge.second)]
        reached = {next((name for name in members if name in hung), members[0])}
        waiting = list(tree)
        while waiting:
            hinge = next(one for one in waiting if {one.first, one.second} & reached)
            waiting.remove(hinge)
            child = hinge.second if hinge.first in reached else hinge.first
            parents[child] = hinge
            reached.add(child)
    return parents


def other_end(hinge: BodyHinge, body: str) -> str:
    """Return the other body of a hinge."""
    return hinge.second if body == hinge.first else hinge.first


def start_rate_rad_per_s(hinge: BodyHinge, body: RigidBody, other: RigidBody) -> float:
    """Return the rate at which a body of a hinge rotates about its axis at the start, relative to the other one."""
    return float(
        np.subtract(body.angular_velocity_rad_per_s, other.angular_velocity_rad_per_s)
        @ hinge.axis
    )


def hinge_trees(hinges: Iterable[BodyHinge]) -> list[tuple[BodyHinge, ...]]:
    """Return the hinges in groups that share bodies, in their order."""
    groups: list[list[BodyHinge]] = []
    for hinge in hinges:
        touching = [
            group
            for group in groups
            if any({hinge.first, hinge.second} & {o.first, o.second} for o in group)
        ]
        joined = [*(one for group in touching for one in group), hinge]
        place = min((groups.index(group) for group in touching), default=len(groups))
        groups = [group for group in groups if group not in touching]
        groups.insert(place, joined)
    return [tuple(group) for group in groups]


def hinge_fault(
    hinges: Iterable[BodyHinge],
    bodies: Mapping[str, RigidBody],
    fastened: Collection[str],
    hung: Collection[str],
) -> str | None:
    """Return what is wrong with the hinges between bodies of a scene, and what would be right; None if nothing is.

    Args:
        hinges: The hinges.
        bodies: Rigid bodies of the scene, by name.
        fastened: Names of bodies that are on a string or attached to a deformable body.
        hung: Names of the bodies on hinges to the world, one for each hinge.
    """
    group: dict[str, str] = {}
    for hinge in hinges:
        title = f"the hinge of {hinge.first!r} and {hinge.second!r}"
        for name in (hinge.first, hinge.second):
            if name not in bodies:
                return f"{title}: there is no rigid body {name!r}; known: {', '.join(bodies)}"
            if bodies[name].motion is not Motion.DYNAMIC:
                motion = bodies[name].motion.value
                return f"{title}: {name!r} is {motion}. Join dynamic bodies, or use a Hinge to the world"
            if name in fastened:
                return f"{title}: {name!r} has a string or an attachment as well: remove one of them"
        length = length_of(hinge.axis)
        if not abs(length - 1.0) <= UNIT:
            return f"{title}: its axis {hinge.axis} is not a unit vector: normalize it"
        roots = [_root(group, name) for name in (hinge.first, hinge.second)]
        if roots[0] == roots[1]:
            return f"{title} closes a loop: hinges join bodies to trees. Remove one hinge of the loop"
        group[roots[1]] = roots[0]
        torn = _torn(hinge, bodies[hinge.first], bodies[hinge.second])
        if torn is not None:
            return f"{title}: {torn}"
    roots = [_root(group, name) for name in hung]
    twice = next(
        (name for name, root in zip(hung, roots, strict=True) if roots.count(root) > 1),
        None,
    )
    if twice is not None:
        return f"{twice!r} and bodies that hinges join to it have two hinges to the world: remove one of them"
    return None


def joint_sign(hinge: Hinge | BodyHinge, child: str) -> float:
    """Return 1 where the angle of a hinge turns a body relative to what it hangs on, and -1 where the other way."""
    return -1.0 if isinstance(hinge, BodyHinge) and child == hinge.first else 1.0


def joint_fields(joint: Hinge | BodyHinge | Tether) -> dict[str, Any]:
    """Return the fields of a joint, without friction, armature, motor and limits if it has none."""
    without = {"dynamics": asdict(JointDynamics()), "motor": None, "limits_rad": None}
    return {
        name: value
        for name, value in asdict(joint).items()
        if name not in without or value != without[name]
    }


def _root(group: Mapping[str, str], name: str) -> str:
    while name in group:
        name = group[name]
    return name


def _torn(hinge: BodyHinge, first: RigidBody, second: RigidBody) -> str | None:
    """Return how the start velocities of two bodies tear their hinge, or None."""
    velocities = []
    for body in (first, second):
        angular = np.asarray(body.angular_velocity_rad_per_s)
        arm = np.subtract(hinge.anchor_m, body.pose.position_m)
        velocities.append(
            (np.asarray(body.linear_velocity_m_per_s) + np.cross(angular, arm), angular)
        )
    slip = velocities[1][0] - velocities[0][0]
    spin = velocities[1][1] - velocities[0][1]
    askew = spin - np.asarray(hinge.axis) * (spin @ hinge.axis)
    largest = max(float(np.abs(one).max()) for pair in velocities for one in pair)
    if np.abs([slip, askew]).max() <= SAME_VELOCITY * largest:
        return None
    return (
        f"its ends start with {np.linalg.norm(slip):.3g} m/s, and its axes with {np.linalg.norm(askew):.3g} rad/s, "
        "relative to each other. Give both bodies the velocity of the hinge, and angular velocities that differ along "
        "its axis alone"
    )
