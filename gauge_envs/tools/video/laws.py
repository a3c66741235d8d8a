"""Fit the laws that video models are judged by: constant acceleration, limited friction, impacts, damped oscillation.

Each function takes times and positions of a track in SI units and returns the fit with its metrics. The equations are
those of GAUGE's paper (arXiv 2608.05948), section "Physical-Consistency Analysis" of the appendix.

Example:
    >>> import numpy as np
    >>> from gauge_envs.tools.video.laws import fit_constant_acceleration
    >>> times_s = np.arange(20) / 30
    >>> fit = fit_constant_acceleration(times_s, 0.5 * 2.58 * times_s**2)
    >>> round(fit.a_m_per_s2, 6)
    2.58
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brute, minimize, minimize_scalar

from gauge_envs.errors import ParameterError
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.tasks import Motion, VideoTask
from gauge_envs.tools.video.track import Track

GRAVITY_M_PER_S2 = 9.80665
"""Gravity in the friction limit of the turntable, as the paper states it."""

LEAST_POINTS_QUADRATIC = 4
"""Fewest points of a fit with three coefficients that leaves a residual."""

LEAST_POINTS_OSCILLATION = 8
"""Fewest points of a fit of five coefficients that says something about the residual."""

FREQUENCIES_PER_WINDOW = 16
"""Candidates of the angular frequency for each cycle that fits into the window."""

MOST_DAMPING, DAMPING_STEP = 1.0, 0.25
"""Largest candidate of the damping, in inverse windows, and step between them; the search continues from the best."""


@dataclass(frozen=True, kw_only=True)
class AccelerationFit:
    """Motion from rest with constant acceleration.

    Attributes:
        a_m_per_s2: Acceleration [m/s^2], twice the slope over squared time.
        release_s: Time of the release, on the clock of the samples [s].
        qfi: Quadratic form improvement: F statistic of a further term in the fourth power of time, 1.
        form: Root-mean-square residual in travelled distances, 1: the same for any acceleration and camera.
    """

    a_m_per_s2: float
    release_s: float
    qfi: float
    form: float


@dataclass(frozen=True, kw_only=True)
class OscillationFit:
    """Damped oscillation of an angle.

    Attributes:
        period_s: Period of the damped oscillation [s].
        damping_per_s: Rate at which the amplitude decays [1/s]; negative for a growing one.
        r2: Coefficient of determination, 1.
        residuals_rad: What the law does not explain [rad], shape [sample_count].
    """

    period_s: float
    damping_per_s: float
    r2: float
    residuals_rad: FloatArray

    @property
    def guess(self) -> tuple[float, float]:
        """Damping [1/s] and angular frequency [rad/s], from which the search in a similar swing starts."""
        return self.damping_per_s, 2.0 * np.pi / self.period_s


def fit_constant_acceleration(
    times_s: ArrayLike,
    displacement_m: ArrayLike,
    *,
    release_within_s: float = 0.0,
    release_s: float | None = None,
) -> AccelerationFit:
    """Fit a motion from rest with constant acceleration, linear in squared time.

    Equations "c3-acceleration", "c3-quadratic" and "qfi" of the paper's appendix. The paper counts time from the first
    retained frame. A real release falls between two frames, so the time of release may be fitted too.

    Args:
        times_s: Times [s], shape [sample_count], increasing.
        displacement_m: Displacement along the fixed direction [m], shape [sample_count].
        release_within_s: Half-width of the interval around it in which the release is searched [s]; 0 for the paper's
            fit.
        release_s: Time about which the release is searched [s]; samples before it are at rest. The first one if None.
    """
    times, values = _samples(times_s, displacement_m, LEAST_POINTS_QUADRATIC)
    release = float(times[0]) if release_s is None else release_s
    if release_within_s > 0.0:
        found = minimize_scalar(
            lambda shift: _residual_square(_from_rest(times - release - shift), values),
            bounds=(-release_within_s, release_within_s),
            method="bounded",
            options={"xatol": 1e-3 * release_within_s},
        )
        release += float(found.x)
    basis = _from_rest(times - release)
    coefficients, residual = _least_squares(basis, values)
    linear = float(residual @ residual)
    quadratic = _residual_square(np.column_stack([basis, basis[:, 1] ** 2]), values)
    spread = float(((values - values.mean()) ** 2).sum())
    # Residuals of rounding size say nothing on the form of the relation.
    is_exact = linear <= 1e-24 * max(spread, float((values**2).sum()), 1e-300)
    qfi = (
        0.0
        if is_exact
        else (linear - quadratic) / max(quadratic / (len(values) - 3), 1e-300)
    )
    return AccelerationFit(
        a_m_per_s2=2.0 * float(coefficients[1]),
        release_s=release,
        qfi=qfi,
        form=float(np.sqrt(linear / len(values)) / max(float(np.ptp(values)), 1e-300)),
    )


def dynamic_error(
    times_s: ArrayLike, positions_m: ArrayLike, *, mass_kg: float, friction: float
) -> tuple[float, FloatArray]:
    """Return by how much the force that a motion needs exceeds the available friction, on average [N].

    The accelerations at inner samples come with it [m/s^2], shape [sample_count - 2].

    Equations "c4-acceleration", "c4-unequal", "c4-friction" and "c4-de" of the paper's appendix: three-point
    accelerations of unsmoothed positions, without their direction.

    Args:
        times_s: Times [s], shape [sample_count], increasing; gaps are allowed.
        positions_m: Positions in the plane [m], shape [sample_count, 2].
        mass_kg: Mass of the body [kg].
        friction: Coefficient of friction, 1.
    """
    times, values = _samples(times_s, positions_m, 3)
    steps = np.diff(times)[:, None]
    velocities = np.diff(values, axis=0) / steps
    accelerations = 2.0 * np.diff(velocities, axis=0) / (steps[1:] + steps[:-1])
    sizes: FloatArray = np.linalg.norm(accelerations, axis=1)
    exceedance: FloatArray = np.maximum(
        0.0, mass_kg * sizes - friction * mass_kg * GRAVITY_M_PER_S2
    )
    return float(exceedance.mean()), sizes


def fit_damped_oscillation(
    times_s: ArrayLike,
    angles_rad: ArrayLike,
    *,
    guess: tuple[float, float] | None = None,
) -> OscillationFit:
    """Fit a damped oscillation to an angle over time.

    Equations "c7-fit", "c7-r2" and "c7-pd" of the paper's appendix: for each damping and angular frequency, the
    equilibrium and both amplitudes follow by linear least squares. A grid gives the best pair, and a simplex search
    continues from it. Frequencies reach from half a cycle in the window up to a quarter of the sampling rate. The
    damping may be negative.

    Args:
        times_s: Times [s], shape [sample_count], increasing; gaps are allowed.
        angles_rad: Angles against the vertical [rad], shape [sample_count].
        guess: Damping [1/s] and angular frequency [rad/s] from which the search starts, instead of the grid.
    """
    times, values = _samples(times_s, angles_rad, LEAST_POINTS_OSCILLATION)
    spread = float(((values - values.mean()) ** 2).sum())
    clock = times - times[0]
    window = float(clock[-1])
    lowest, highest = np.pi / window, 0.5 * np.pi / float(np.median(np.diff(times)))

    def cost(scaled: FloatArray) -> float:
        beta, omega = scaled[0] / window, abs(scaled[1]) / window
        # The exponential stays finite, and one cycle stays inside of what the window resolves.
        if abs(scaled[0]) > 50.0 or not 0.5 * lowest <= omega <= 2.0 * highest:
            return spread * (2.0 + abs(float(scaled[0])))
        return _residual_square(_oscillation(clock, beta, omega), values)

    if guess is None:
        cycles = (highest - lowest) * window / (2.0 * np.pi)
        count = max(8, int(FREQUENCIES_PER_WINDOW * cycles))
        step = (highest - lowest) * window / count
        grid = (
            slice(-MOST_DAMPING, MOST_DAMPING + DAMPING_STEP, DAMPING_STEP),
            slice(lowest * window, highest * window, step),
        )
        best = brute(cost, grid, finish=None)
    else:
        best = np.array(guess) * window
    # From a guess, as for an interval, a thousandth of what the noise of a track changes is enough.
    fine = 1e-7 if guess is None else 1e-4
    options = {"xatol": fine, "fatol": fine**2 * spread, "maxiter": 2000}
    found = minimize(cost, best, method="Nelder-Mead", options=options)
    beta, omega = float(found.x[0]) / window, abs(float(found.x[1])) / window
    _, residual = _least_squares(_oscillation(clock, beta, omega), values)
    return OscillationFit(
        period_s=2.0 * np.pi / omega,
        damping_per_s=beta,
        r2=1.0 - float(residual @ residual) / spread,
        residuals_rad=residual,
    )


# --- least squares ---------------------------------------------------------------------------------------------------


def _from_rest(times_s: FloatArray) -> FloatArray:
    """Return the columns 1 and squared time after the release; before it, the body is at rest."""
    return np.column_stack([np.ones_like(times_s), np.maximum(times_s, 0.0) ** 2])


def _oscillation(
    times_s: FloatArray, damping_per_s: float, omega_rad_per_s: float
) -> FloatArray:
    decay = np.exp(-damping_per_s * times_s)
    phase = omega_rad_per_s * times_s
    return np.column_stack(
        [np.ones_like(times_s), decay * np.cos(phase), decay * np.sin(phase)]
    )


def _least_squares(
    basis: FloatArray, values: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return coefficients and residuals."""
    coefficients, *_ = np.linalg.lstsq(basis, values, rcond=None)
    return np.asarray(coefficients, dtype=float), values - basis @ coefficients


def _residual_square(basis: FloatArray, values: FloatArray) -> float:
    """Return the squared residual of least squares."""
    _, residual = _least_squares(basis, values)
    return float(residual @ residual)


def _samples(
    times_s: ArrayLike, values: ArrayLike, least: int
) -> tuple[FloatArray, FloatArray]:
    times, samples = np.asarray(times_s, dtype=float), np.asarray(values, dtype=float)
    if len(times) < least:
        raise ParameterError(f"{len(times)} samples are too few: the fit needs {least}")
    return times, samples


WINDOW = 6
"""Frames of the window in which motion or rest is decided, as in the paper."""

MOVING_PX = 1.5
"""Displacement in a window with which an object moves [px]; trackers scatter by 0.1 to 0.4 px."""

MOVING_DEG = 0.8
"""Rotation in a window with which a pendulum moves [degrees]."""

RELEASED_PX = 0.6
"""Displacement from rest that a frame may have and still count as the release [px]."""

OFF_LINE = 0.5
"""Distance from the fixed line at which an object has left it, in its sizes."""

ESTABLISHED = 0.25
"""Displacement with which a motion is established, in sizes of the object."""

IMPACT = 0.25
"""Share of the speed that is left after an impact, at most."""

APEX_SEPARATION_S = 0.35
"""Shortest time between two apices [s]: about half a period of the cradle's balls."""

LEAST_APEX_RAD = 0.08
"""Smallest angle of an apex [rad]; hanging balls are no event."""


MOST_APEX_STEPS, APEX_FALL, APEX_FALL_RAD = 2.5, 0.9, 0.04
"""Most frames from an apex to its neighbours, and angle on both sides that shows a swing, in that of the apex; or fall
of the angle [rad]: a quarter of a ball, which no trembling is."""


def displacement_px(track: Track, task: VideoTask) -> FloatArray:
    """Return the displacement along the fixed direction of a task since the first place [px], shape [frame_count]."""
    assert task.direction is not None
    points = track.points_px
    first = points[track.is_found][0]
    return (points - first) @ np.array(task.direction)


def swing_angles_rad(track: Track, task: VideoTask) -> FloatArray:
    """Return the angle of the object about the pivot, from the vertical [rad], shape [frame_count].

    Equation "c7-angle" of the paper's appendix; positive to the right.
    """
    assert task.pivot_px is not None
    offset = track.points_px - np.array(task.pivot_px)
    return np.arctan2(offset[:, 0], offset[:, 1])


def retained(track: Track, task: VideoTask) -> tuple[int, int] | None:
    """Return the first and the last retained row of a track; None when the object does not move.

    Args:
        track: The track.
        task: The task, whose kind of motion decides the rule.
    """
    rows = np.flatnonzero(track.is_found)
    if task.motion is Motion.CRADLE:
        swings = swing_angles_rad(track, task)[rows] >= LEAST_APEX_RAD
        return (int(rows[0]), int(rows[-1])) if swings.any() else None
    if len(rows) <= WINDOW:
        return None
    if task.motion in (Motion.SLIDE, Motion.FALL):
        found = _straight(track, task, rows)
    elif task.motion is Motion.TURN:
        found = _without_rest(track.points_px[rows], MOVING_PX, keeps_end=False)
    else:
        found = _without_rest(
            np.degrees(swing_angles_rad(track, task)[rows])[:, None],
            MOVING_DEG,
            keeps_end=True,
        )
    if found is None:
        return None
    first, last = int(rows[found[0]]), int(rows[found[1]])
    # A slide and a fall may end outside of the picture. A swing and a ride go on, so frames without the object count.
    goes_on = task.motion in (Motion.TURN, Motion.PENDULUM) and last == rows[-1]
    return first, len(track.frames) - 1 if goes_on else last


def apices(
    times_s: FloatArray, angles_rad: FloatArray, step_s: float
) -> NDArray[np.intp]:
    """Return the rows of the apices of a ball that swings out, in order.

    An apex is the largest angle within `APEX_SEPARATION_S` on both sides, and the ball is seen next to it on both. It
    rises from below and falls again: balls that hang and tremble do not.

    Args:
        times_s: Times of the frames in which the ball was found [s], shape [frame_count].
        angles_rad: Its angles from the vertical [rad], shape [frame_count].
        step_s: Time from frame to frame of the video [s].
    """
    found: list[int] = []
    for row in range(1, len(times_s) - 1):
        near = np.abs(times_s - times_s[row]) <= APEX_SEPARATION_S
        is_highest = angles_rad[row] >= angles_rad[near].max()
        is_seen = (
            max(times_s[row + 1] - times_s[row], times_s[row] - times_s[row - 1])
            <= MOST_APEX_STEPS * step_s
        )
        sides = (angles_rad[:row][near[:row]], angles_rad[row + 1 :][near[row + 1 :]])
        fallen = max(APEX_FALL * angles_rad[row], angles_rad[row] - APEX_FALL_RAD)
        is_swing = all(side.min(initial=np.inf) <= fallen for side in sides)
        is_new = not (found and near[found[-1]])
        if (
            is_highest
            and is_seen
            and is_swing
            and is_new
            and angles_rad[row] >= LEAST_APEX_RAD
        ):
            found.append(row)
    return np.array(found, dtype=np.intp)


def peak(times_s: FloatArray, heights_m: FloatArray) -> float:
    """Return the largest height of a parabola through three places [m]: an apex lies between two frames."""
    clock_s = times_s - times_s[1]
    a, b, height_m = np.polyfit(clock_s, heights_m, 2)
    # The other vertex of nearly a line lies far away.
    is_between = a < 0.0 and 2.0 * a * clock_s[2] <= -b <= 2.0 * a * clock_s[0]
    return float(height_m - 0.25 * b * b / a if is_between else height_m)


def swings_without_apex(track: Track, task: VideoTask) -> list[NDArray[np.intp]]:
    """Return the rows of each swing of a cradle's ball, an event of unknown height, unless the video ends in it."""
    rows = np.flatnonzero(track.is_found)
    angles_rad, times_s = swing_angles_rad(track, task)[rows], track.times_s[rows]
    known = rows[apices(times_s, angles_rad, 1.0 / track.fps)]
    rows = rows[angles_rad >= LEAST_APEX_RAD]
    swings = np.split(rows, np.flatnonzero(np.diff(rows) > MOST_APEX_STEPS) + 1)
    return [
        one
        for one in swings
        if len(one)
        and not np.isin(known, one).any()
        and one[-1] < len(track.frames) - 1
    ]


def _straight(
    track: Track, task: VideoTask, rows: NDArray[np.intp]
) -> tuple[int, int] | None:
    seen = displacement_px(track, task)[rows]
    # A place that lasts one frame is a slip of the tracker and no motion.
    along = np.median(
        [np.r_[seen[:1], seen[:-1]], seen, np.r_[seen[1:], seen[-1:]]], axis=0
    )
    rest = float(np.median(along[:WINDOW]))
    far = np.flatnonzero(along - rest > ESTABLISHED * task.size_px)
    if not len(far):
        return None
    # Back from where motion is established, to the window in which there is none.
    start = established = int(far[0])
    while start > 0 and along[start] - along[max(0, start - WINDOW)] > MOVING_PX:
        start -= 1
    start = max(0, start - WINDOW)
    before = along[start]
    # A shadow that appears after the first frame moves its place by a pixel, and not that of the next ones.
    later = along[start + 1 : start + 3]
    if np.ptp(later) <= RELEASED_PX < abs(later[0] - before) <= MOVING_PX:
        before = later[0]
    while start + 1 < established and along[start + 1] - before <= RELEASED_PX:
        start += 1
    end = len(rows) - 1
    if task.motion is Motion.FALL and rows[-1] < len(track.frames) - 1:
        # A ball that is lost has often hit the ground, and the last frame that shows it may contain that.
        end -= 1
    for row in range(established, len(rows) - 1):
        later = min(row + WINDOW, len(rows) - 1)
        # Less than half a window before the end of a clip, the step before it must be larger.
        is_long = later - row >= WINDOW // 2
        is_stop = is_long or along[row] - along[row - 1] > MOVING_PX
        is_at_rest = along[row + 1 : later + 1].max() - along[row] < MOVING_PX
        is_impact = _is_impact(along, rows, row)
        if (is_stop and is_at_rest) or is_impact:
            is_before = is_impact and along[row + 1] - along[row] > MOVING_PX
            # The exposure of the last frame before it may hold it.
            end = row + is_before - 2
            break
    if task.motion is Motion.SLIDE:
        end = min(end, _last_on_line(track, task, rows, start))
    return (start, end) if end - start >= 3 else None


def _is_impact(along: FloatArray, rows: NDArray[np.intp], row: int) -> bool:
    """Return whether most of the speed is lost at once, and does not come back: a body stops, or rebounds.

    Args:
        along: Displacements along the motion [px].
        rows: Their frames, in which the object is found.
        row: Which of them.
    """
    earlier = np.arange(max(0, row - 2), row + 1)
    before_px = float((np.diff(along[earlier]) / np.diff(rows[earlier])).max())
    for count in (2, WINDOW):
        later = min(row + count, len(rows) - 1)
        after_px = (along[later] - along[row]) / (rows[later] - rows[row])
        if after_px > min(IMPACT * before_px, before_px - MOVING_PX):
            return False
    return True


def _last_on_line(
    track: Track, task: VideoTask, rows: NDArray[np.intp], start: int
) -> int:
    """Return the last row before the object leaves the line of its motion."""
    assert task.direction is not None
    across = np.array([-task.direction[1], task.direction[0]])
    distance = np.abs((track.points_px[rows] - track.points_px[rows[start]]) @ across)
    off = np.flatnonzero(distance[start:] > OFF_LINE * task.size_px)
    return start + int(off[0]) - 1 if len(off) else len(rows) - 1


def _without_rest(
    values: FloatArray, threshold: float, *, keeps_end: bool
) -> tuple[int, int] | None:
    """Return the first and last row without the rest before and, unless it is kept, after the motion."""
    moved = np.linalg.norm(values[WINDOW:] - values[:-WINDOW], axis=1) > threshold
    moving = np.flatnonzero(moved)
    if not len(moving):
        return None
    start = int(moving[0])
    rest = values[start]
    while (
        start + 1 < len(values)
        and np.linalg.norm(values[start + 1] - rest) <= 0.4 * threshold
    ):
        start += 1
    end = len(values) - 1 if keeps_end else int(moving[-1]) + WINDOW
    return (start, end) if end - start >= WINDOW else None
