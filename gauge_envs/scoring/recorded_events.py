"""Compute the events that have a real value in a recording, such as the frequency of a swing.

Each event in a file `scoring/bands/<id>.toml` has the name of a function in `EVENTS`. The function returns NaN for an
event that does not happen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from gauge_envs.observables.deformation import deformation, solid_axes
from gauge_envs.scene import Scene, Sphere
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scene.timing import frame_times_s
from gauge_envs.scoring.events import local_maxima, oscillation_period, swing_times

CONTACT_S = 0.005
"""Time after a bounce that may belong to the contact [s]."""

MIN_SAMPLES = 4
"""Smallest number of samples of the flight after a bounce."""

MAX_MISFIT = 0.04
"""Largest distance of a flight from its parabola, over its size."""


@dataclass(frozen=True, kw_only=True)
class SampledMotion:
    """SampledMotion of one episode.

    Attributes:
        scene: Scene of the episode.
        times_s: Times of the samples [s], shape [S].
        samples: g(t) at those times, shape [S, C].
        markers_m: Markers at the 30 Hz frames [m], shape [T, M, 3]; M is 0 for rigid bodies.
        markers: Indices of the markers that the event uses; empty for all.
    """

    scene: Scene
    times_s: FloatArray
    samples: FloatArray
    markers_m: FloatArray
    markers: Sequence[int] = ()

    @property
    def frames_s(self) -> FloatArray:
        """Times of the frames [s], shape [T]."""
        return frame_times_s(len(self.markers_m))


def _angles_deg(start_m: FloatArray, end_m: FloatArray) -> FloatArray:
    """Return the angles of a line from the downward vertical, positive towards +y."""
    line_m = end_m - start_m
    return np.degrees(np.arctan2(line_m[:, 1], -line_m[:, 2]))


def _swinging_deg(motion: SampledMotion) -> FloatArray:
    """Return the angles of the line between two markers at the frames from 0.24 to 1.41 s after the release."""
    seen = (motion.frames_s > 0.24) & (motion.frames_s < 1.41)
    return _angles_deg(*motion.markers_m[seen][:, motion.markers].swapaxes(0, 1))


def _lag_mm(motion: SampledMotion, *, from_s: float, until_s: float) -> float:
    """Return the mean lag of the first point of g(t) behind the driver's translation over a span of time."""
    seen = (motion.times_s >= from_s) & (motion.times_s <= until_s)
    drive = motion.scene.drivers[0].motions[0]
    driven_mm = 1e3 * np.array([drive.value(t) for t in motion.times_s[seen]])
    moved_mm = (motion.samples[seen] - motion.samples[0])[:, :3] @ drive.axis
    return float(np.mean((driven_mm - moved_mm) * np.sign(driven_mm)))


def _cradle_s(motion: SampledMotion, *, times: str, number: int) -> float:
    """Return when the ball that starts at rest leaves or returns for the nth time, or how long it then rests."""
    heights_mm = motion.samples[:, 2]
    swings = swing_times(motion.times_s, heights_mm, rest_height_mm=heights_mm[0])
    found_s = swings[times][number - 1 : number]
    return float(found_s[0]) if len(found_s) else math.nan


def _slide_acceleration_m_per_s2(motion: SampledMotion) -> float:
    """Return the acceleration of a slide from rest, from 2 to 90 mm of its path."""
    path_mm = np.linalg.norm(motion.samples - motion.samples[0], axis=1)
    seen = np.logical_and.accumulate(path_mm < 90.0) & (path_mm > 2.0)
    if seen.sum() < 3:
        return math.nan
    slope = np.polyfit(motion.times_s[seen], np.sqrt(1e-3 * path_mm[seen]), 1)[0]
    return float(2.0 * slope**2)


def _turning_ratio(motion: SampledMotion) -> float:
    """Return the third turning angle of a pendulum over its angle at the release."""
    anchor_m = np.array(motion.scene.joints[0].anchor_m)
    string_m = 1e-3 * motion.samples - anchor_m
    angles = np.abs(np.arctan2(string_m[:, 0], -string_m[:, 2]))
    turns = local_maxima(angles)
    return float(angles[turns[2]] / angles[0]) if len(turns) > 2 else math.nan


def _bounce(motion: SampledMotion) -> FloatArray:
    """Return the velocities of a ball before and after it strikes a level plane [m/s], shape [2, 3].

    They are NaN without a flight after it.

    The flight before follows from the start of the scene. The samples after it are on a parabola with a known gravity.
    """
    scene = motion.scene
    ball, plane = scene.body("ball"), scene.body("table")
    assert isinstance(ball.shape, Sphere)
    gravity = scene.gravity_m_per_s2
    contact_m = plane.pose.position_m[2] + ball.shape.radius_m
    velocity = np.array(ball.linear_velocity_m_per_s)
    drop_m = ball.pose.position_m[2] - contact_m
    fall_speed = math.sqrt(velocity[2] ** 2 + 2.0 * gravity * drop_m)
    since_s = motion.times_s - (velocity[2] + fall_speed) / gravity
    after = since_s > CONTACT_S
    without = np.full((2, 3), np.nan)
    if after.sum() < MIN_SAMPLES:
        return without
    since_s, path_m = since_s[after], 1e-3 * motion.samples[after]
    straight_m = path_m + 0.5 * gravity * np.outer(since_s**2, [0.0, 0.0, 1.0])
    rise, start_m = np.polyfit(since_s, straight_m, 1)
    residual_m = straight_m - start_m - np.outer(since_s, rise)
    if length_of(residual_m) > MAX_MISFIT * length_of(path_m - path_m.mean(axis=0)):
        return without
    # A soft contact ends later than the law says, so the speed counts where the ball leaves the plane.
    square = rise[2] ** 2 + 2.0 * gravity * (start_m[2] - contact_m)
    rise[2] = math.sqrt(max(square, 0.0))
    return np.array([[*velocity[:2], -fall_speed], rise])


def _restitution(motion: SampledMotion) -> float:
    """Return the speed of a ball away from a level plane after a bounce over that towards it before."""
    fall, rise = _bounce(motion)
    return float(rise[2] / -fall[2])


def _impulse_ratio(motion: SampledMotion) -> float:
    """Return the impulse against the motion along a level plane over that normal to it, in a bounce."""
    fall, rise = _bounce(motion)
    along = fall[:2] / length_of(fall[:2])
    return float((fall - rise)[:2] @ along / (rise - fall)[2])


def _chord_deg(
    motion: SampledMotion, extreme: Callable[..., float], from_s: float, until_s: float
) -> float:
    """Return an extreme angle, over a span of time, of the chord from a driven rod to the lowest row of markers."""
    (driver,) = motion.scene.drivers
    rod_m = driver.path(motion.scene.body(driver.body).pose, motion.frames_s)[:, :3]
    heights_m = motion.markers_m[0, :, 2]
    lowest = heights_m < heights_m.min() + 1e-3
    chords = _angles_deg(rod_m, motion.markers_m[:, lowest].mean(axis=1))
    seen = (motion.frames_s >= from_s) & (motion.frames_s <= until_s)
    return float(extreme(chords[seen]))


def _deformation(motion: SampledMotion, name: str) -> float:
    """Return a quantity of `deformation` at the last frame."""
    used = motion.markers or range(motion.markers_m.shape[1])
    rest_m, last_m = motion.markers_m[[0, -1]][:, used]
    return deformation(rest_m, last_m, solid_axes(motion.scene))[name]


EVENTS: dict[str, Callable[[SampledMotion], float]] = {
    "swing_frequency_hz": lambda motion: (
        1.0 / oscillation_period(_swinging_deg(motion))
    ),
    "mean_angle_deg": lambda motion: float(_swinging_deg(motion).mean()),
    "foot_lag_mm": partial(_lag_mm, from_s=1.0, until_s=3.0),
    "cube_lag_mm": partial(_lag_mm, from_s=1.5, until_s=2.0),
    "slide_acceleration_m_per_s2": _slide_acceleration_m_per_s2,
    "turning_ratio": _turning_ratio,
    "restitution": _restitution,
    "impulse_ratio": _impulse_ratio,
    "cloth_lag_deg": lambda motion: _chord_deg(motion, np.max, 0.0, 0.9),
    "cloth_swing_deg": lambda motion: _chord_deg(motion, np.min, 0.9, 2.1),
    "cloth_rebound_deg": lambda motion: _chord_deg(motion, np.max, 1.75, 2.8),
    **{
        name: partial(_deformation, name=name)
        for name in ("strain_zz", "strain_xz", "area_ratio")
    },
    **{
        f"{name}_{number}_s": partial(_cradle_s, times=f"{name}_s", number=number)
        for name in ("leaves", "returns", "rests")
        for number in (1, 2, 3)
    },
}
"""Functions of the events by name."""
