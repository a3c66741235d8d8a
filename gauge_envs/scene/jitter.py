"""Random start poses of a scene, like the scatter of manual set-ups of real trials."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.errors import ParameterError
from gauge_envs.scene.bodies import Cloth, Hinge, Motion, RigidBody, Tether
from gauge_envs.scene.geometry import Pose, Sphere, vector
from gauge_envs.scene.scene import Scene

__all__ = ["Jitter", "jittered"]


@dataclass(frozen=True, kw_only=True)
class Jitter:
    """Standard deviations of start poses.

    Attributes:
        position_m: Standard deviation of each coordinate of a position [m]. The heights of 22 real drops of a ball
            scatter by 1.0 mm. Cubes at rest on a slope of 10 degrees, whose scatter is that of their start, lie 0.6 to
            1.9 mm from their mean (paper, Table 5).
        angle_rad: Standard deviation of a rotation [rad]. It has not been measured; 0.5 degrees is 0.2 mm at the edge
            of a cube of 50 mm.

    Raises:
        ParameterError: A value is negative or not a number.
    """

    position_m: float = 1.0e-3
    angle_rad: float = math.radians(0.5)

    def __post_init__(self) -> None:
        for name in ("position_m", "angle_rad"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ParameterError(f"jitter {name} is {value!r}: give a finite number of 0 or more")


def jittered(scene: Scene, jitter: Jitter, *, seed: int) -> Scene:
    """Return the scene with random start poses, chosen so that no body starts inside another.

    - A dynamic body translates in the plane of the face that it rests on, and rotates about the normal of that face:
      the body axis that is closest to vertical.
    - A ball translates in all three coordinates.
    - A hinged body rotates about its hinge. A tethered body swings with a tight string.
    - A cloth without attachments translates and rotates in its plane.

    Fixed and driven bodies and the bodies attached to them do not move: their start poses belong to the set-up.

    Args:
        scene: The scene.
        jitter: Standard deviations of the start poses.
        seed: Seed of the random numbers, 0 or more.

    Raises:
        ParameterError: No body in the scene can start elsewhere.
    """
    random = np.random.default_rng(seed)
    hinges = {joint.body: joint for joint in scene.joints if isinstance(joint, Hinge)}
    tethers = {joint.body: joint for joint in scene.joints if isinstance(joint, Tether)}
    attached = {attachment.deformable for attachment in scene.attachments} | {a.to for a in scene.attachments}
    moved = 0
    bodies: list[RigidBody] = []
    for body in scene.bodies:
        pose = body.pose
        if body.motion is Motion.DYNAMIC and body.name not in attached:
            moved += 1
            if body.name in hinges:
                hinge = hinges[body.name]
                pose = _rotated_about(pose, hinge.axis, hinge.anchor_m, jitter.angle_rad * random.standard_normal())
            elif body.name in tethers:
                swing = Rotation.from_rotvec(jitter.angle_rad * random.standard_normal(3))
                pose = _rotated(pose, swing, np.asarray(tethers[body.name].anchor_m))
            else:
                pose = _shifted(pose, jitter, random, is_free=isinstance(body.shape, Sphere))
        bodies.append(replace(body, pose=pose))
    deformables: list[Any] = []
    for deformable in scene.deformables:
        if isinstance(deformable, Cloth) and deformable.name not in attached:
            moved += 1
            deformable = replace(deformable, pose=_shifted(deformable.pose, jitter, random, is_free=False))
        deformables.append(deformable)
    if not moved:
        raise ParameterError("nothing to jitter: every body of this scene is fixed, driven, or attached to one that is")
    return replace(scene, bodies=tuple(bodies), deformables=tuple(deformables))


def _shifted(pose: Pose, jitter: Jitter, random: np.random.Generator, *, is_free: bool) -> Pose:
    shift = jitter.position_m * random.standard_normal(3)
    angle_rad = jitter.angle_rad * random.standard_normal()
    axes = pose.rotation.as_matrix().T
    normal = axes[int(np.abs(axes[:, 2]).argmax())]
    if not is_free:
        shift -= (shift @ normal) * normal
    rotated = _rotated_about(pose, normal, pose.position_m, angle_rad)
    return replace(rotated, position_m=vector(np.asarray(rotated.position_m) + shift))


def _rotated_about(pose: Pose, axis: Any, point_m: Any, angle_rad: float) -> Pose:
    return _rotated(pose, Rotation.from_rotvec(angle_rad * np.asarray(axis)), np.asarray(point_m))


def _rotated(pose: Pose, rotation: Rotation, point_m: NDArray[np.float64]) -> Pose:
    position = rotation.apply(np.asarray(pose.position_m) - point_m) + point_m
    return Pose.from_rotation(vector(position), rotation * pose.rotation)
