"""Slides, creep and rest on a support: displacements along and off it, and measures of them.

A body moves on a plane or on the upper face of a box, level or leaning. `Slope` gives the axes of that face.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gauge_envs.scene import Pose
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scoring.estimators import (
    acceleration_m_per_s2,
    slide_friction,
    steady_speed_m_per_s,
)
from gauge_envs.tools.bench.recording import Recording

LEVEL = 1e-9
"""Sine of the slope below which a support is level; x of its frame is then the first axis."""


@dataclass(frozen=True)
class Slope:
    """The upper face of a support, across the z axis of its frame.

    Attributes:
        axes: Unit vectors downhill, across and off the face in the world, shape [3, 3].
        angle_rad: Slope [rad].
    """

    axes: FloatArray
    angle_rad: float

    @classmethod
    def of(cls, support: Pose) -> Slope:
        """Return the face of a support at a pose."""
        frame = support.matrix
        normal = frame[:, 2]
        downhill = normal[2] * normal - [0.0, 0.0, 1.0]
        sine = length_of(downhill)
        downhill = downhill / sine if sine > LEVEL else frame[:, 0]
        axes = np.array([downhill, np.cross(normal, downhill), normal])
        return cls(axes=axes, angle_rad=math.atan2(sine, float(normal[2])))


def slope_of(rollout: Recording, support: str) -> Slope:
    """Return the face of a support of a rollout, as it starts."""
    return Slope.of(rollout.scene.body(support).pose)


def moved_m(rollout: Recording, body: str, support: str) -> FloatArray:
    """Return the displacement of a body downhill, across and off its support [m], shape [sample_count, 3]."""
    return np.asarray(rollout.displacement(body) @ slope_of(rollout, support).axes.T)


def acceleration_downhill_m_per_s2(
    rollout: Recording, body: str, support: str, *, start_s: float = 0.0
) -> float:
    """Return the acceleration of a body down its support from a time on."""
    later = rollout.between(start_s, math.inf)
    return acceleration_m_per_s2(
        rollout.times_s[later], moved_m(rollout, body, support)[later, 0]
    )


def creep_m_per_s(
    rollout: Recording, body: str, support: str, *, start_s: float
) -> float:
    """Return the speed with which a body creeps down its support from a time on."""
    later = rollout.between(start_s, math.inf)
    return steady_speed_m_per_s(
        rollout.times_s[later], moved_m(rollout, body, support)[later, 0]
    )


def friction_of_slide(
    rollout: Recording, body: str, support: str, *, start_s: float
) -> float:
    """Return the friction of a body that slides down its support from a time on, and may hop on it."""
    later = rollout.between(start_s, math.inf)
    moved = moved_m(rollout, body, support)[later]
    # Both accelerations are means over the same time with the same weights.
    down, off = (
        acceleration_m_per_s2(rollout.times_s[later], moved[:, axis]) for axis in (0, 2)
    )
    slope_rad = slope_of(rollout, support).angle_rad
    return slide_friction(
        down,
        slope_rad,
        gravity_m_per_s2=rollout.scene.gravity_m_per_s2,
        lift_m_per_s2=off,
    )
