"""Balls that spin or roll on level ground, and the resisting torque over the normal force."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import vector
from gauge_envs.scoring.estimators import steady_speed_m_per_s
from gauge_envs.tools.bench.drop import RADIUS_M
from gauge_envs.tools.bench.parts import ball, contact, ground
from gauge_envs.tools.bench.recording import Recording

SPIN, ROLL = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
"""Axes about which a ball spins on a point, and rolls along x."""

INERTIA_SHARES = {SPIN: 2.0 / 5.0, ROLL: 7.0 / 5.0}
"""Moment of inertia of a ball about its contact point and each axis, over m r^2."""


def turning_scene(
    seconds: float, velocity: float, spin: tuple[float, ...], **turning: Any
) -> Scene:
    """Return a ball with torsional or rolling friction on a plane.

    Args:
        seconds: Duration [s].
        velocity: Speed along x at the start [m/s].
        spin: Angular velocity at the start [rad/s].
        **turning: `torsion_m` or `rolling_m` of the contact [m].
    """
    turns = replace(
        ball("ball", (0.0, 0.0, RADIUS_M)),
        linear_velocity_m_per_s=(velocity, 0.0, 0.0),
        angular_velocity_rad_per_s=vector(spin),
    )
    touch = replace(contact("ball", "ground", friction=0.5), **turning)
    return Scene(bodies=(turns, ground()), contacts=(touch,), duration_s=seconds)


def turning_arm_m(
    rollout: Recording, axis: tuple[float, float, float], *, start_s: float = 0.0
) -> float:
    """Return the resisting torque over the normal force [m], from the loss of spin of a ball: -I / (m g) dw/dt.

    Args:
        rollout: The rollout.
        axis: `SPIN` or `ROLL`.
        start_s: Start of the measurement [s].
    """
    seen = rollout.times_s >= start_s
    spin_rad_per_s = rollout.angular_velocity("ball")[seen] @ np.array(axis)
    rate_rad_per_s2 = steady_speed_m_per_s(rollout.times_s[seen], spin_rad_per_s)
    return (
        -INERTIA_SHARES[axis]
        * RADIUS_M**2
        * rate_rad_per_s2
        / rollout.scene.gravity_m_per_s2
    )
