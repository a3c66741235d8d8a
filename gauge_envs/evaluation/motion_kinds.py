"""Kinds of motion of a simulated trajectory (slide, rebound, swing), and the same motion faster, larger or shifted.

Recognition uses the trajectory and the scene, never a name. The kind decides the physical quantity that makes a motion
faster or larger:

- `uniform_acceleration`, from rest at a constant acceleration: another acceleration scales the displacement.
- `rebound`, free flight, one impact, free flight: another restitution changes the speed after the impact.
- `oscillation`, a body on a hinge or tether that completes a period: another period stretches time, and another
  amplitude scales the displacement from the rest position.
- `general`: time is stretched from the start on, and the displacement from the start is scaled.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from gauge_envs.errors import ShapeError
from gauge_envs.evaluation.estimators import first_bounce
from gauge_envs.evaluation.laws import free_flight
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.bands import Band
from gauge_envs.scene import ContactMode, Scene
from gauge_envs.scene.geometry import FloatArray, IntArray, length_of

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

Continuation = Callable[[FloatArray], FloatArray]

RATE_BOUNDS = (0.5, 2.0)
"""Least and largest factor of speed."""

SCALE_BOUNDS = (0.5, 2.0)
"""Least and largest factor of displacement."""

STARTS_AT_ONCE = 100
"""Number of starts of a motion that are fitted in one array."""

SHAPE_TOLERANCE = 0.04
"""Largest root-mean-square misfit of a law of motion, over the root mean square of the displacement.

The mean of real slides, which start at different times, has a misfit of up to 0.032 to uniform acceleration.
"""

IMPACT_WINDOW_S = 1.0 / 60.0
"""Longest duration of an impact [s]; that of the ball takes 5 ms."""

IMPACT_SHARE = 0.1
"""Smallest change of velocity in an impact, over the largest; a second impact has e times the change of the first."""

SELF_SIMILARITY = 0.8
"""Smallest correlation of an oscillation with itself one period later."""


class MotionKind(StrEnum):
    """Kind of a motion, which decides the quantities of its rate and scale."""

    UNIFORM_ACCELERATION = "uniform_acceleration"
    """From rest at constant acceleration: the acceleration is scaled."""
    REBOUND = "rebound"
    """Free flight before and after an impact: the coefficient of restitution is changed."""
    OSCILLATION = "oscillation"
    """Swings on a joint: period and amplitude are scaled."""
    GENERAL = "general"
    """Anything else: time and displacement from the start are scaled."""


@dataclass(frozen=True, kw_only=True)
class Change:
    """Change of one quantity of the simulation that fits best.

    Attributes:
        quantity: `release_time`, `offset`, `acceleration`, `restitution`, `period`, `amplitude`, `speed` (factor) or
            `displacement` (factor).
        unit: Unit of both values; `1` for a ratio.
        simulated: Value in the simulation.
        fitted: Value of the best fit.
        coordinate: Coordinate of an offset; else None.
        at_bound: Whether the fit ended at the end of its range, so that the change is at least as large.
    """

    quantity: str
    unit: str
    simulated: float
    fitted: float
    coordinate: str | None = None
    at_bound: bool = False


@dataclass(frozen=True, eq=False)
class Impact:
    """The first impact of a trajectory, between two free flights.

    Attributes:
        time_s: Time of the impact [s].
        until_s: End of the free flight after it [s]: the next impact, or the last sample.
        normal: Unit vector along which the velocity jumps, shape [C].
        speed_in: Speed against the normal just before it [mm/s].
        speed_out: Speed along the normal just after it [mm/s].
    """

    time_s: float
    until_s: float
    normal: FloatArray
    speed_in: float
    speed_out: float

    @property
    def restitution(self) -> float:
        """Ratio of the speeds along the normal after and before the impact."""
        return self.speed_out / self.speed_in


@dataclass(frozen=True, eq=False)
class RecognizedMotion:
    """A simulated trajectory that can be shifted in time, made faster and made larger.

    Attributes:
        kind: Kind of the motion.
        times_s: Times [s], strictly increasing, shape [S]; they reach past `end_s` as far as a faster motion needs.
        values: Coordinates at these times, shape [S, C].
        end_s: End of the simulation [s]; later values are a continuation.
        centre: Point from which displacement is scaled, shape [C].
        rate_bounds: Least and largest factor of speed; (1, 1) for a kind without such a change.
        scale_bounds: Least and largest `scale`.
        acceleration: Constant acceleration of `uniform_acceleration` [unit/s^2]; else None.
        impact: Impact of a `rebound`; else None.
        period_s: Period of an `oscillation` [s]; else None.
    """

    kind: MotionKind
    times_s: FloatArray
    values: FloatArray
    end_s: float
    centre: FloatArray
    rate_bounds: tuple[float, float] = (1.0, 1.0)
    scale_bounds: tuple[float, float] = (SCALE_BOUNDS[0] - 1.0, SCALE_BOUNDS[1] - 1.0)
    acceleration: float | None = None
    impact: Impact | None = None
    period_s: float | None = None

    def select(self, columns: IntArray) -> RecognizedMotion:
        """Return the same motion with some of its coordinates, in the order of the indices."""
        impact = self.impact
        if impact is not None:
            impact = replace(impact, normal=impact.normal[columns])
        return replace(
            self,
            values=self.values[:, columns],
            centre=self.centre[columns],
            impact=impact,
        )

    def at(
        self, times_s: FloatArray, shifts_s: FloatArray, rates: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the motion with time shifts and rates, and its change per unit of `scale`.

        Args:
            times_s: Times at which it is evaluated [s], shape [T].
            shifts_s: Time shifts [s], shape [G]; positive is later.
            rates: Factors of speed, shape [G].

        Returns:
            Coordinates, and their change per unit of scale, each of shape [G, T, C]. The unit of scale is the
            displacement; for a rebound, a unit of speed.
        """
        # A shifted motion is held at both ends, as in the score's release alignment.
        since_start = np.clip(times_s - shifts_s[:, None], 0.0, self.end_s)
        own_times = since_start * rates[:, None]
        played = self._curve(own_times)
        if self.impact is None:
            return played, played - self.centre
        flight = (
            np.clip(own_times, self.impact.time_s, self.impact.until_s)
            - self.impact.time_s
        )
        return played, flight[..., None] * self.impact.normal

    @cached_property
    def _curve(self) -> BSpline:
        from scipy.interpolate import make_interp_spline

        return make_interp_spline(self.times_s, self.values, k=1)

    def changes(
        self, rate: float, scale: float, *, rate_at_bound: bool, scale_at_bound: bool
    ) -> tuple[Change, ...]:
        """Return a rate and a scale in the quantities of this kind of motion."""
        larger = 1.0 + scale
        if self.acceleration is not None:
            metric = 1e-3 * self.acceleration
            return (
                _change(
                    "acceleration", "m/s^2", metric, larger * metric, scale_at_bound
                ),
            )
        if self.impact is not None:
            ratio = self.impact.restitution
            return (
                _change(
                    "restitution",
                    "1",
                    ratio,
                    ratio + scale / self.impact.speed_in,
                    scale_at_bound,
                ),
            )
        if self.period_s is not None:
            return (
                _change(
                    "period", "s", self.period_s, self.period_s / rate, rate_at_bound
                ),
                _change("amplitude", "1", 1.0, larger, scale_at_bound),
            )
        return (
            _change("speed", "1", 1.0, rate, rate_at_bound),
            _change("displacement", "1", 1.0, larger, scale_at_bound),
        )


def _change(
    quantity: str, unit: str, simulated: float, fitted: float, at_bound: bool
) -> Change:
    return Change(
        quantity=quantity,
        unit=unit,
        simulated=simulated,
        fitted=fitted,
        at_bound=at_bound,
    )


def recognized(
    experiment: Experiment,
    band: Band,
    times_s: FloatArray,
    values: FloatArray,
    *,
    until_s: float | None = None,
) -> RecognizedMotion:
    """Return the recognized motion of a trajectory.

    Args:
        experiment: The experiment of the trajectory.
        band: Band that states the coordinates.
        times_s: Times from 0 on [s], shape [S].
        values: Band coordinates at these times, shape [S, C].
        until_s: Last time at which an acceleration or an impact is searched [s], because later values are not compared.
            None searches the whole trajectory.
    """
    seen = (
        slice(None)
        if until_s is None
        else slice(0, int(np.searchsorted(times_s, until_s + 1e-6, side="right")))
    )
    single = (
        experiment.score.observable is Observable.POSITION
        and len(experiment.recorded) == 1
    )
    if single and not experiment.scene.drivers:
        motion = (
            _oscillation(experiment, band, times_s, values)
            or _rebound(experiment, band, times_s, values, seen)
            or _uniform_acceleration(times_s, values, seen)
        )
        if motion is not None:
            return motion
    return _stretchable(
        MotionKind.GENERAL, times_s, values, _coasting(times_s, values), values[0]
    )


# --- kinds -----------------------------------------------------------------------------------------------------------


def _uniform_acceleration(
    times_s: FloatArray, values: FloatArray, seen: slice
) -> RecognizedMotion | None:
    seen_s, moved = times_s[seen], values[seen] - values[0]
    size = float(np.sqrt(np.mean(np.square(moved))))
    if size == 0.0:
        return None
    # In a recording the body may rest for a while before it moves. Of each start, the best acceleration leaves a sum of
    # squares that is smaller by the square of the projection on the motion of unit acceleration.
    starts_s = seen_s[seen_s <= 0.5 * seen_s[-1]]
    largest, best = -1.0, np.zeros(0)
    for some_s in np.array_split(starts_s, math.ceil(len(starts_s) / STARTS_AT_ONCE)):
        motions = 0.5 * np.square(np.maximum(seen_s - some_s[:, None], 0.0))
        squares = np.square(motions).sum(axis=1)
        gained = np.square(motions @ moved).sum(axis=1) / squares
        if gained.max() > largest:
            largest, best = float(gained.max()), motions[gained.argmax()]
    acceleration = best @ moved / (best @ best)
    left = moved - best[:, None] * acceleration
    if float(np.sqrt(np.mean(np.square(left)))) > SHAPE_TOLERANCE * size:
        return None
    return RecognizedMotion(
        MotionKind.UNIFORM_ACCELERATION,
        times_s,
        values,
        float(times_s[-1]),
        values[0],
        acceleration=length_of(acceleration),
    )


def _rebound(
    experiment: Experiment,
    band: Band,
    times_s: FloatArray,
    values: FloatArray,
    seen: slice,
) -> RecognizedMotion | None:
    body = experiment.recorded[0]
    contacts = [c for c in experiment.scene.contacts if body in (*c.first, *c.second)]
    if (
        experiment.scene.joints
        or not contacts
        or any(c.mode is not ContactMode.IMPACT for c in contacts)
    ):
        return None
    impact = find_impact(
        times_s[seen],
        values[seen],
        gravity_m_per_s2=gravity_of(experiment.scene, band),
        contact_mm=_contact(experiment, band),
    )
    if impact is None:
        return None
    speeds = (
        -impact.restitution * impact.speed_in,
        (1.0 - impact.restitution) * impact.speed_in,
    )
    end_s = float(times_s[-1])
    return RecognizedMotion(
        MotionKind.REBOUND,
        times_s,
        values,
        end_s,
        values[0],
        scale_bounds=speeds,
        impact=impact,
    )


def gravity_of(scene: Scene, band: Band) -> FloatArray:
    """Return the acceleration of a free body in the coordinates of a band [m/s^2], shape [C]."""
    return np.asarray(band.projection @ [0.0, 0.0, -scene.gravity_m_per_s2])


def _contact(experiment: Experiment, band: Band) -> FloatArray | None:
    """Return the place at which the recorded body lands if it falls from rest, shape [C]; None if it does not."""
    scene, body = experiment.scene, experiment.recorded[0]
    if not scene.body(body).starts_at_rest:
        return None
    try:
        fall = free_flight(scene, body)
    except ShapeError:
        return None
    landed_m = fall.start_m + fall.distance_m * fall.direction
    return band.project(1e3 * landed_m[None])[0]


def find_impact(
    times_s: FloatArray,
    values: FloatArray,
    *,
    gravity_m_per_s2: FloatArray,
    contact_mm: FloatArray | None = None,
) -> Impact | None:
    """Return the first impact of a body between two free flights.

    The sharpest change of velocity gives the normal; `estimators.first_bounce` along it gives the speeds.

    Args:
        times_s: Times [s], strictly increasing, shape [S].
        values: Coordinates at these times [mm], shape [S, C].
        gravity_m_per_s2: Acceleration of a free body in the same coordinates, shape [C].
        contact_mm: Place of a body that touches the support, shape [C]; the body is let go at rest at the first sample.
            None of a motion for which neither is known.

    Returns:
        The impact. None if the velocity never reverses within `IMPACT_WINDOW_S`, or within two samples if they are
        further apart. None also if the coordinate along the normal is not a parabola before and after the impact.
    """
    steps = np.diff(times_s)
    window = max(2, round(IMPACT_WINDOW_S / float(np.median(steps))))
    velocity = np.diff(values, axis=0) / steps[:, None]
    if len(velocity) <= 2 * window:
        return None
    jumps = velocity[window:] - velocity[:-window]
    # The change of velocity in free flight is not part of an impact. A second impact may change it much less.
    sizes = np.linalg.norm(jumps - np.median(jumps, axis=0), axis=1)
    hits = np.flatnonzero(sizes >= IMPACT_SHARE * sizes.max())
    first = hits[0] + int(np.argmax(sizes[hits[0] : hits[0] + window]))
    if sizes[first] == 0.0:
        return None
    normal = jumps[first] / np.linalg.norm(jumps[first])
    if velocity[first] @ normal >= 0.0 or velocity[first + window] @ normal <= 0.0:
        return None
    heights_m = 1e-3 * values @ normal
    gravity = -float(gravity_m_per_s2 @ normal)
    if gravity <= 0.0:
        return None
    contact_m = None if contact_mm is None else 1e-3 * float(contact_mm @ normal)
    released_m = None if contact_mm is None else float(heights_m[0])
    bounce = first_bounce(
        times_s,
        heights_m,
        gravity_m_per_s2=gravity,
        contact_m=contact_m,
        released_m=released_m,
    )
    if (
        bounce is None
        or bounce.speed_out_m_per_s == 0.0
        or bounce.misfit > SHAPE_TOLERANCE
    ):
        return None
    return Impact(
        bounce.time_s,
        bounce.until_s,
        normal,
        1e3 * bounce.speed_in_m_per_s,
        1e3 * bounce.speed_out_m_per_s,
    )


def _oscillation(
    experiment: Experiment, band: Band, times_s: FloatArray, values: FloatArray
) -> RecognizedMotion | None:
    joint = next(
        (j for j in experiment.scene.joints if j.body == experiment.recorded[0]), None
    )
    period_s = None if joint is None else _period(times_s, values)
    if joint is None or period_s is None:
        return None
    arm_m = math.dist(joint.anchor_m, experiment.scene.body(joint.body).pose.position_m)
    rest_m = np.asarray(joint.anchor_m) - [0.0, 0.0, arm_m]
    centre = band.project(1e3 * rest_m[None])[0]

    def periodic(late_s: FloatArray) -> FloatArray:
        cycles = np.ceil((late_s - times_s[-1]) / period_s)
        return _interpolated(times_s, values, late_s - cycles * period_s)

    return _stretchable(
        MotionKind.OSCILLATION, times_s, values, periodic, centre, period_s=period_s
    )


def _period(times_s: FloatArray, values: FloatArray) -> float | None:
    """Return the lag at which the motion repeats itself [s], or None if it does not repeat."""
    from scipy.signal import correlate, find_peaks

    step_s = float(np.median(np.diff(times_s)))
    even_s = (
        np.arange(int((times_s[-1] - times_s[0]) / step_s) + 1) * step_s + times_s[0]
    )
    even = _interpolated(times_s, values, even_s)
    even = even - even.mean(axis=0)
    count = len(even)
    lags = np.arange(count)
    products = sum(
        correlate(column, column, method="fft")[count - 1 :] for column in even.T
    )
    # Each lag is divided by the energy of the overlap, so that a small number of periods does not weaken it.
    energy = np.concatenate([[0.0], np.cumsum(np.square(even).sum(axis=1))])
    overlap = np.sqrt((energy[count] - energy[lags]) * energy[count - lags])
    alike = np.divide(products, overlap, out=np.zeros(count), where=overlap > 0.0)[
        : max(3, int(0.9 * count))
    ]
    peaks, _ = find_peaks(alike, height=SELF_SIMILARITY)
    if not peaks.size:
        return None
    peak = int(peaks[0])
    left, top, right = alike[peak - 1 : peak + 2]
    return float((peak + 0.5 * (left - right) / (left - 2.0 * top + right)) * step_s)


# --- curves ----------------------------------------------------------------------------------------------------------


def _stretchable(
    kind: MotionKind,
    times_s: FloatArray,
    values: FloatArray,
    continuation: Continuation,
    centre: FloatArray,
    *,
    period_s: float | None = None,
) -> RecognizedMotion:
    """Return a motion that can be made faster, with a continuation past its end."""
    end_s, step_s = float(times_s[-1]), float(np.median(np.diff(times_s)))
    late_s = end_s + step_s * np.arange(
        1, math.ceil((RATE_BOUNDS[1] - 1.0) * end_s / step_s) + 2, dtype=np.float64
    )
    return RecognizedMotion(
        kind,
        np.concatenate([times_s, late_s]),
        np.concatenate([values, continuation(late_s)]),
        end_s,
        centre,
        rate_bounds=RATE_BOUNDS,
        period_s=period_s,
    )


def _coasting(times_s: FloatArray, values: FloatArray) -> Continuation:
    """Return a continuation at the constant velocity of the last two frames.

    An acceleration would amplify the jitter of the last samples.
    """
    recent = times_s >= times_s[-1] - IMPACT_WINDOW_S * 4.0
    recent[-2:] = True
    since = times_s[recent] - times_s[recent].mean()
    velocity = since @ values[recent] / (since @ since)
    return lambda late_s: values[-1] + (late_s - times_s[-1])[:, None] * velocity


def _interpolated(
    times_s: FloatArray, values: FloatArray, at_s: FloatArray
) -> FloatArray:
    """Return all coordinates by linear interpolation, shape [*shape of at_s, C]."""
    from scipy.interpolate import make_interp_spline

    return make_interp_spline(times_s, values, k=1)(
        np.clip(at_s, times_s[0], times_s[-1])
    )
