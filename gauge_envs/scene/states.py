"""Initial states of a scene as an array.

States have the rows of `Scene.bodies` and then of `Scene.deformables`, and 13 numbers each: position [m], unit
quaternion w x y z, linear velocity [m/s] and angular velocity [rad/s], in the world frame. A deformable body starts at
rest; its row has the pose of its frame.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from gauge_envs.scene.bodies import RigidBody
from gauge_envs.scene.geometry import FloatArray, Pose
from gauge_envs.scene.scene import Scene


def nominal_states(scene: Scene) -> FloatArray:
    """Return the initial states that the scene gives, shape [body_count, 13]."""
    states = np.zeros((len(scene.bodies) + len(scene.deformables), 13))
    for row, body in zip(states, (*scene.bodies, *scene.deformables), strict=True):
        row[:3] = body.pose.position_m
        row[3:7] = body.pose.quaternion
        if isinstance(body, RigidBody):
            row[7:10] = body.linear_velocity_m_per_s
            row[10:] = body.angular_velocity_rad_per_s
    return states


def scene_at(scene: Scene, states: FloatArray) -> Scene:
    """Return the scene whose nominal start is given by states, shape [body_count, 13]."""
    bodies = []
    for body, state in zip(scene.bodies, states.tolist(), strict=False):
        changes: dict[str, Any] = {
            "pose": Pose(position_m=tuple(state[:3]), quaternion=tuple(state[3:7])),
            "linear_velocity_m_per_s": tuple(state[7:10]),
            "angular_velocity_rad_per_s": tuple(state[10:]),
        }
        bodies.append(replace(body, **changes))
    deformables = []
    rows = states[len(bodies) :].tolist()
    for deformable, state in zip(scene.deformables, rows, strict=True):
        pose = Pose(position_m=tuple(state[:3]), quaternion=tuple(state[3:7]))
        deformables.append(replace(deformable, pose=pose))
    return replace(scene, bodies=tuple(bodies), deformables=tuple(deformables))


def row_of(scene: Scene, name: str) -> int:
    """Return the row of a body in the states of a scene."""
    names = [body.name for body in (*scene.bodies, *scene.deformables)]
    return names.index(name)
