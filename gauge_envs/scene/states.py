"""Initial states of a scene as an array.

The rows are those of `Scene.bodies`, then of `Scene.deformables`. Each has 13 numbers in the world frame: position [m],
unit quaternion w x y z, linear velocity [m/s] and angular velocity [rad/s]. A deformable body starts at rest; its row
has the pose of its frame.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gauge_envs.scene.bodies import Motion, RigidBody
from gauge_envs.scene.geometry import FloatArray, Pose, vector
from gauge_envs.scene.scene import Scene


def nominal_states(scene: Scene) -> FloatArray:
    """Return the nominal initial states of a scene, shape [body_count, 13]."""
    states = np.zeros((len(scene.bodies) + len(scene.deformables), 13))
    for row, body in zip(states, (*scene.bodies, *scene.deformables), strict=True):
        row[:3] = body.pose.position_m
        row[3:7] = body.pose.quaternion
        if isinstance(body, RigidBody):
            row[7:10] = body.linear_velocity_m_per_s
            row[10:] = body.angular_velocity_rad_per_s
    return states


def row_of(scene: Scene, name: str) -> int:
    """Return the row of a body in the states of a scene."""
    names = [body.name for body in (*scene.bodies, *scene.deformables)]
    return names.index(name)


def bodies_at(scene: Scene, states: FloatArray) -> tuple[RigidBody, ...]:
    """Return the rigid bodies of a scene with other initial states; fixed bodies stay.

    Args:
        scene: The scene.
        states: Initial states of one world, shape [body_count, 13].
    """
    bodies = []
    for body, state in zip(scene.bodies, states, strict=False):
        if body.motion is not Motion.FIXED:
            body = replace(
                body,
                pose=Pose.of_state(state),
                linear_velocity_m_per_s=vector(state[7:10]),
                angular_velocity_rad_per_s=vector(state[10:]),
            )
        bodies.append(body)
    return tuple(bodies)


def scene_at(scene: Scene, states: FloatArray) -> Scene:
    """Return the scene with initial states of shape [body_count, 13] in place of the nominal ones."""
    rows = states[len(scene.bodies) :]
    deformables = tuple(
        replace(deformable, pose=Pose.of_state(row))
        for deformable, row in zip(scene.deformables, rows, strict=True)
    )
    bodies = bodies_at(scene, states)
    return replace(scene, bodies=bodies, deformables=deformables)
