"""Swings of a plain pendulum, integrated by SciPy."""

import math

import numpy as np
from scipy.integrate import solve_ivp


def swung_rad(
    times_s, start_rad, rate_rad_per_s=0.0, *, square_rate, damping_per_s=0.0
):
    """Return the angle of a pendulum at times from 0, to 1e-12.

    Args:
        times_s: Times [s], strictly ascending.
        start_rad: Angle at time 0 [rad].
        rate_rad_per_s: Angular velocity at time 0.
        square_rate: Square of the angular frequency of small swings [1/s^2].
        damping_per_s: Rate at which the amplitude of small swings decays.
    """

    def slopes(_, state):
        angle, rate = state
        return [rate, -square_rate * math.sin(angle) - 2.0 * damping_per_s * rate]

    return solve_ivp(
        slopes,
        (0.0, float(np.max(times_s))),
        [start_rad, rate_rad_per_s],
        "DOP853",
        times_s,
        rtol=1e-12,
        atol=1e-13,
    ).y[0]
