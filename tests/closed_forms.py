"""Closed forms of the two motions with measured trials, apart from the package: a Coulomb slide, and a bouncing ball.

Positions are in mm, shape [S, 3], at times since frame 0 [s], shape [S]. A late body rests until its release.
"""

import numpy as np

GRAVITY = 9.80665
SLOPE_RAD = np.radians(30.0)
RADIUS_M = 0.03


def slide_mm(start_m, times_s, *, friction, gravity=GRAVITY, late_s=0.0):
    """Return the centre of a cube that slides down a board of 30 degrees, or sticks."""
    since_s = np.clip(times_s - late_s, 0.0, None)
    pull = np.sin(SLOPE_RAD) - friction * np.cos(SLOPE_RAD)
    travel_m = 0.5 * gravity * max(pull, 0.0) * since_s**2
    downhill = np.array([np.cos(SLOPE_RAD), 0.0, -np.sin(SLOPE_RAD)])
    return 1e3 * (start_m + travel_m[:, None] * downhill)


def ball_mm(start_m, times_s, *, restitution, plane_m, gravity=GRAVITY, late_s=0.0):
    """Return the centre of a ball that falls on a plane and rebounds: impact n + 1 follows 2 v_n / g after impact n."""
    since_s = np.clip(times_s - late_s, 0.0, None)
    lowest_m = plane_m + RADIUS_M
    fall_s = np.sqrt(2.0 * (start_m[2] - lowest_m) / gravity)
    starts_s, speeds = [-fall_s], [gravity * fall_s]
    starts_s.append(fall_s)
    speeds.append(restitution * speeds[0])
    while starts_s[-1] < since_s[-1] and speeds[-1] > 1e-7:
        starts_s.append(starts_s[-1] + 2.0 * speeds[-1] / gravity)
        speeds.append(restitution * speeds[-1])
    # The fall is the second half of an arc that begins before the release.
    arc = np.searchsorted(starts_s, since_s, side="right") - 1
    in_arc_s = since_s - np.array(starts_s)[arc]
    heights_m = np.array(speeds)[arc] * in_arc_s - 0.5 * gravity * in_arc_s**2
    positions_m = np.tile(np.asarray(start_m, float), (len(times_s), 1))
    positions_m[:, 2] = lowest_m + np.maximum(heights_m, 0.0)
    return 1e3 * positions_m
