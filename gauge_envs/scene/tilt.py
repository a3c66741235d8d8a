"""Scenes that lean as a whole: the same as another direction of gravity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.scene.bodies import Hinge, RigidBody
from gauge_envs.scene.geometry import Pose, Vector, vector
from gauge_envs.scene.scene import Scene


def tilted(scene: Scene, rotation_rad: ArrayLike, about_m: ArrayLike) -> Scene:
    """Return a scene that is rotated as a whole about a point.

    Gravity stays vertical. In the rotated frame, the motion is that of the original scene with leaning gravity.

    Args:
        scene: The scene.
        rotation_rad: Rotation vector [rad], shape [3].
        about_m: Fixed point of the rotation [m], shape [3].
    """
    rotation, centre = Rotation.from_rotvec(rotation_rad), np.asarray(about_m, dtype=np.float64)

    def place(point_m: ArrayLike) -> Vector:
        moved: NDArray[np.float64] = rotation.apply(np.asarray(point_m) - centre) + centre
        return vector(moved)

    def direction(axis: ArrayLike) -> Vector:
        return vector(rotation.apply(axis))

    def pose(start: Pose) -> Pose:
        return Pose.from_rotation(place(start.position_m), rotation * start.rotation)

    def tilted_body(body: RigidBody) -> RigidBody:
        if body.starts_at_rest:
            return replace(body, pose=pose(body.pose))
        return replace(
            body,
            pose=pose(body.pose),
            linear_velocity_m_per_s=direction(body.linear_velocity_m_per_s),
            angular_velocity_rad_per_s=direction(body.angular_velocity_rad_per_s),
        )

    markers = scene.markers
    return replace(
        scene,
        bodies=tuple(map(tilted_body, scene.bodies)),
        deformables=tuple(replace(body, pose=pose(body.pose)) for body in scene.deformables),
        joints=tuple(
            replace(joint, anchor_m=place(joint.anchor_m), axis=direction(joint.axis))
            if isinstance(joint, Hinge)
            else replace(joint, anchor_m=place(joint.anchor_m))
            for joint in scene.joints
        ),
        body_hinges=tuple(
            replace(hinge, anchor_m=place(hinge.anchor_m), axis=direction(hinge.axis)) for hinge in scene.body_hinges
        ),
        drivers=tuple(
            replace(
                driver,
                motions=tuple(
                    replace(motion, axis=direction(motion.axis), point_m=place(motion.point_m))
                    for motion in driver.motions
                ),
            )
            for driver in scene.drivers
        ),
        markers=None if markers is None else replace(markers, positions_m=tuple(map(place, markers.positions_m))),
    )
