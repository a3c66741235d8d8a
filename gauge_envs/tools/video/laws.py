"""Fit the laws of the video tasks: constant acceleration, limited friction, impacts, damped oscillation.

Each fit takes times and positions of a track in SI units. The equations are those of GAUGE's paper (arXiv 2608.05948),
section "Physical-Consistency Analysis" of the appendix. `retained` selects the frames of a track for a fit.

Example:
    >>> import numpy as np
    >>> from gauge_envs.tools.video.laws import fit_constant_acceleration
    >>> times_s = np.arange(20) / 30
    >>> fit = fit_constant_acceleration(times_s, 0.5 * 2.58 * times_s**2)
    >>> round(fit.a_m_per_s2, 6)
    2.58
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter
from scipy.optimize import least_squares, minimize_scalar
from scipy.signal import find_peaks, lombscargle

from gauge_envs.scene.geometry import FloatArray, IntArray
from gauge_envs.tools.video.tasks import MotionKind, VideoTask
from gauge_envs.tools.video.track import Track

GRAVITY_M_PER_S2 = 9.80665
"""Gravity in the friction limit of the turntable, as in the paper."""


class AccelerationFit(NamedTuple):
    """Motion from rest with constant acceleration."""

    a_m_per_s2: float
    """Acceleration [m/s^2]."""
    release_s: float
    """Time of the release, on the clock of the samples [s]."""
    qfi: float
    """Quadratic form improvement: F statistic of an extra term in the fourth power of time, 1."""
    form: float
    """Root-mean-square residual divided by the displacement, 1: independent of acceleration and scale."""


class OscillationFit(NamedTuple):
    """Damped oscillation of an angle."""

    period_s: float
    """Period of the damped oscillation [s]."""
    damping_per_s: float
    """Rate at which the amplitude decays [1/s]; negative for a growing amplitude."""
    r2: float
    """Coefficient of determination, 1."""


def fit_constant_acceleration(
    times_s: FloatArray,
    displacement_m: FloatArray,
    *,
    release_s: float | None = None,
    release_within_s: float = 0.0,
) -> AccelerationFit:
    """Fit a motion from rest with constant acceleration, linear in squared time.

    Equations "c3-acceleration", "c3-quadratic" and "qfi" of the paper's appendix. In the paper, time starts at the
    first retained frame. A real release is between two frames, so the release time may be fitted too.

    Args:
        times_s: Times [s], shape [sample_count], increasing, at least four.
        displacement_m: Displacement along the fixed direction [m], shape [sample_count].
        release_s: Time of the release [s]; earlier samples are at rest. None means the first time.
        release_within_s: Half-width of the search interval around `release_s` [s].
    """
    release = times_s[0] if release_s is None else release_s

    def squared_residual(shift_s: float, *powers: int) -> float:
        since_s = np.maximum(times_s - release - shift_s, 0.0)
        return _squared(_residual(since_s[:, None] ** powers, displacement_m))

    shift_s = 0.0
    if release_within_s:
        shift_s = minimize_scalar(
            squared_residual,
            args=(0, 2),
            bounds=(-release_within_s, release_within_s),
            options={"xatol": 1e-3 * release_within_s},
        ).x
    linear = squared_residual(shift_s, 0, 2)
    quadratic = squared_residual(shift_s, 0, 2, 4)
    # Rounding errors do not show the form of the relation.
    is_exact = linear <= 1e-24 * _squared(displacement_m)
    freedom = len(times_s) - 3
    since_s = np.maximum(times_s - release - shift_s, 0.0)
    return AccelerationFit(
        a_m_per_s2=2.0 * float(np.polyfit(since_s**2, displacement_m, 1)[0]),
        release_s=float(release + shift_s),
        qfi=0.0 if is_exact else (linear / quadratic - 1.0) * freedom,
        form=float(np.sqrt(linear / len(times_s)) / np.ptp(displacement_m)),
    )


def dynamic_error(
    times_s: FloatArray, positions_m: FloatArray, *, mass_kg: float, friction: float
) -> float:
    """Return the mean excess of the required force over the available friction [N].

    Equations "c4-acceleration", "c4-unequal", "c4-friction" and "c4-de" of the paper's appendix: three-point
    accelerations of unsmoothed positions.

    Args:
        times_s: Times [s], shape [sample_count], increasing, at least three; gaps are allowed.
        positions_m: Positions in the plane [m], shape [sample_count, 2].
        mass_kg: Mass of the body [kg].
        friction: Coefficient of friction, 1.
    """
    steps_s = np.diff(times_s)[:, None]
    velocities = np.diff(positions_m, axis=0) / steps_s
    accelerations = 2.0 * np.diff(velocities, axis=0) / (steps_s[1:] + steps_s[:-1])
    magnitudes = np.linalg.norm(accelerations, axis=1)
    exceedance_n = mass_kg * (magnitudes - friction * GRAVITY_M_PER_S2)
    return float(np.maximum(0.0, exceedance_n).mean())


def fit_damped_oscillation(
    times_s: FloatArray, angles_rad: FloatArray
) -> OscillationFit:
    """Fit a damped oscillation to an angle over time.

    Equations "c7-fit", "c7-r2" and "c7-pd" of the paper's appendix. For each damping and angular frequency, linear
    least squares give the equilibrium and both amplitudes. The highest peak of the Lomb-Scargle periodogram is the
    start of a least-squares search. Its grid has 16 frequencies for each cycle in the window, from half a cycle to a
    quarter of the sampling rate. The damping may be negative.

    Args:
        times_s: Times [s], shape [sample_count], increasing, at least eight; gaps are allowed.
        angles_rad: Angles from the vertical [rad], shape [sample_count].
    """
    window_s = np.ptp(times_s)
    # The unit of damping and angular frequency is 1 / window.
    clock = (times_s - times_s[0]) / window_s

    def residual(search: FloatArray) -> FloatArray:
        waves = np.exp(-(search[0] + 1j * search[1]) * clock)
        basis = np.column_stack([np.ones_like(clock), waves.real, waves.imag])
        return _residual(basis, angles_rad)

    highest = 0.5 * np.pi / np.median(np.diff(clock))
    grid = np.arange(np.pi, highest, np.pi / 8.0)
    swing_rad = angles_rad - angles_rad.mean()
    guess = grid[lombscargle(clock, swing_rad, grid).argmax()]
    search = least_squares(residual, [0.0, guess], xtol=1e-9, ftol=1e-12).x
    damping, frequency = search.tolist()
    return OscillationFit(
        period_s=2.0 * math.pi / frequency * window_s,
        damping_per_s=damping / window_s,
        r2=1.0 - _squared(residual(search)) / _squared(swing_rad),
    )


def _residual(basis: FloatArray, values: FloatArray) -> FloatArray:
    """Return the residuals of linear least squares, shape [sample_count]."""
    return values - basis @ np.linalg.lstsq(basis, values)[0]


def _squared(values: FloatArray) -> float:
    return float(values @ values)


# --- retained frames -------------------------------------------------------------------------------------------------

WINDOW = 6
"""Number of frames in the window that decides between motion and rest, as in the paper."""

MOVING_PX, MOVING_DEG = 1.5, 0.8
"""Smallest displacement, or rotation of a pendulum, in a window with motion. Trackers scatter by 0.1 to 0.4 px."""

RELEASED_PX, RELEASED_DEG = 0.6, 0.32
"""Largest displacement and rotation from rest in the frame of the release."""

ESTABLISHED = 0.25
"""Displacement after which a motion is established, in sizes of the object."""

IMPACT = 0.25
"""Largest share of the speed after an impact."""

APEX_SEPARATION_S = 0.35
"""Shortest time between two apices [s]: about half a period of the balls."""

MIN_APEX_RAD = 0.08
"""Smallest angle of an apex [rad]; hanging balls stay below it."""

APEX_FALL = 0.1
"""Smallest decrease of the angle on both sides of an apex, relative to the apex. Trembling balls have less."""


def displacement_px(track: Track, task: VideoTask) -> FloatArray:
    """Return the displacement from the first place along the direction of a task [px], shape [frame_count]."""
    assert task.direction is not None
    first = track.points_px[track.is_found][0]
    return (track.points_px - first) @ np.array(task.direction)


def swing_angles_rad(track: Track, task: VideoTask) -> FloatArray:
    """Return the angle of the object about the pivot from the vertical [rad], shape [frame_count].

    Equation "c7-angle" of the paper's appendix; positive to the right.
    """
    assert task.pivot_px is not None
    right_px, down_px = (track.points_px - task.pivot_px).T
    return np.arctan2(right_px, down_px)


def retained(track: Track, task: VideoTask) -> tuple[int, int] | None:
    """Return the first and the last retained row of a track; None if the object does not move.

    Args:
        track: The track.
        task: The task; its kind of motion selects the rule.
    """
    rows = np.flatnonzero(track.is_found)
    if task.motion is MotionKind.CRADLE:
        is_swinging = swing_angles_rad(track, task)[rows] >= MIN_APEX_RAD
        return (int(rows[0]), int(rows[-1])) if is_swinging.any() else None
    if len(rows) <= WINDOW:
        return None
    if task.direction is not None:
        return _straight(track, task, rows)
    values, moving, released = track.points_px[rows], MOVING_PX, RELEASED_PX
    if task.motion is MotionKind.PENDULUM:
        values = np.degrees(swing_angles_rad(track, task)[rows, None])
        moving, released = MOVING_DEG, RELEASED_DEG
    window_steps = np.linalg.norm(values[WINDOW:] - values[:-WINDOW], axis=1)
    moving_rows = np.flatnonzero(window_steps > moving)
    if not len(moving_rows):
        return None
    away = np.linalg.norm(values[moving_rows[0] + 1 :] - values[moving_rows[0]], axis=1)
    first = int(rows[moving_rows[0] + (away > released).argmax()])
    last = int(rows[moving_rows[-1] + WINDOW])
    # Swings and rides continue, so frames without the object count.
    if task.motion is MotionKind.PENDULUM or last == rows[-1]:
        last = len(track.frames) - 1
    return (first, last) if last - first >= WINDOW else None


def _straight(track: Track, task: VideoTask, rows: IntArray) -> tuple[int, int] | None:
    """Return the first and last row of a slide or a fall."""
    # A displacement in a single frame is a tracking error.
    along_px = median_filter(displacement_px(track, task)[rows], 3, mode="nearest")
    is_established = along_px > ESTABLISHED * task.size_px
    if not is_established.any():
        return None
    established = int(is_established.argmax())
    # The release follows the last window without motion.
    window_px = along_px - along_px[np.maximum(np.arange(len(rows)) - WINDOW, 0)]
    resting = np.flatnonzero(window_px[: established + 1] <= MOVING_PX)
    start = max(0, int(resting[-1]) - WINDOW)
    away_px = along_px[start + 1 : established] - along_px[start]
    start += int(np.append(away_px > RELEASED_PX, True).argmax())
    end = len(rows) - 1
    for index in range(established, len(rows) - 1):
        if _stops(along_px, rows, index):
            # The exposure of the last frame may include the impact.
            is_before = along_px[index + 1] - along_px[index] > MOVING_PX
            end = index + int(is_before) - 2
            break
    return (int(rows[start]), int(rows[end])) if end - start >= 3 else None


def _stops(along_px: FloatArray, rows: IntArray, index: int) -> bool:
    """Return whether a body suddenly loses most of its speed, at rest or in an impact."""
    earlier = np.arange(max(0, index - 2), index + 1)
    before_px = (np.diff(along_px[earlier]) / np.diff(rows[earlier])).max()
    # The speed must stay small within the window.
    later = np.minimum([index + 2, index + WINDOW], len(rows) - 1)
    after_px = (along_px[later] - along_px[index]) / (rows[later] - rows[index])
    return bool(after_px.max() <= IMPACT * before_px)


def apices(frames: IntArray, angles_rad: FloatArray, fps: float) -> IntArray:
    """Return the rows of the apices of an outgoing ball, in order.

    An apex is the largest angle within `APEX_SEPARATION_S` on both sides. The ball must rise and fall, unlike trembling
    balls.

    Args:
        frames: Numbers of the frames with the ball, shape [frame_count].
        angles_rad: Angles of the ball from the vertical [rad], shape [frame_count].
        fps: Frames per second.
    """
    separation = max(1, int(APEX_SEPARATION_S * fps))
    every_frame = np.arange(frames[0], frames[-1] + 1)
    swing_rad = np.interp(every_frame, frames, angles_rad)
    peaks, shape = find_peaks(
        swing_rad,
        height=MIN_APEX_RAD,
        distance=separation + 1,
        prominence=0.0,
        wlen=2 * separation + 1,
    )
    is_swing = shape["prominences"] >= APEX_FALL * swing_rad[peaks]
    return np.searchsorted(frames, every_frame[peaks[is_swing]])


def peak(times_s: FloatArray, heights_m: FloatArray) -> float:
    """Return the largest height of a parabola through three places [m]: an apex is between two frames."""
    clock_s = times_s - times_s[1]
    a, b, height_m = np.polyfit(clock_s, heights_m, 2)
    # Three places on a nearly straight line have a distant vertex.
    is_between = a < 0.0 and clock_s[0] <= -0.5 * b / a <= clock_s[2]
    return float(height_m - 0.25 * b**2 / a if is_between else height_m)
