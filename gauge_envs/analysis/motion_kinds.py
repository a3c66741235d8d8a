"""What a simulated trajectory does (slides, rebounds, swings), and the same motion made faster, larger or shifted.

Recognition looks at the trajectory and at what is in the scene, never at a name. What it finds decides the physical
quantity in which a faster or larger motion is told:

- `uniform_acceleration`: from rest, at a constant acceleration: another acceleration scales the displacement.
- `rebound`: free flight, one impact, free flight: another restitution changes the speed after the impact.
- `oscillation`: a body on a hinge or tether that completes a period: another period stretches time, another amplitude
  the displacement from where the body hangs at rest.
- `general`: time is stretched from the start on, and the displacement from the start is scaled.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline
from scipy.optimize import brentq
from scipy.signal import correlate, find_peaks

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.bands import Band
from gauge_envs.scene import ContactMode

__all__ = [
    "RATE_BOUNDS",
    "SCALE_BOUNDS",
    "Change",
    "Impact",
    "RecognizedMotion",
    "MotionKind",
    "find_impact",
    "recognized",
]

FloatArray = NDArray[np.float64]
Continuation = Callable[[FloatArray], FloatArray]

RATE_BOUNDS = (0.5, 2.0)
"""How many times as fast a motion may be made."""

SCALE_BOUNDS = (0.5, 2.0)
"""How many times as large a motion may be made."""

SHAPE_TOLERANCE = 0.04
"""Root mean square misfit, over that of the displacement, up to which a law of motion counts as followed.

The mean of real slides, which start at different times, misses uniform acceleration by up to 0.032.
"""

IMPACT_WINDOW_S = 1.0 / 60.0
"""An impact reverses the velocity within this time [s]; that of the ball takes 5 ms."""

IMPACT_SHARE = 0.1
"""Change of velocity, over the largest, from which on it is an impact: the second one has the share e of the first."""

SELF_SIMILARITY = 0.8
"""Correlation of a motion with itself one period later from which on it counts as an oscillation."""


class MotionKind(StrEnum):
    """What a trajectory does, and so in which quantity its rate is told."""

    UNIFORM_ACCELERATION = "uniform_acceleration"
    """From rest at constant acceleration: the acceleration is scaled."""
    REBOUND = "rebound"
    """Free flight into and out of an impact: the coefficient of restitution is changed."""
    OSCILLATION = "oscillation"
    """Swings on a joint: period and amplitude are scaled."""
    GENERAL = "general"
    """Anything else: time and displacement from the start are scaled."""


@dataclass(frozen=True, kw_only=True)
class Change:
    """One quantity that the simulation has, and what it would have to be for the best fit.

    Attributes:
        quantity: `release_time`, `offset`, `acceleration`, `restitution`, `period`, `amplitude`, `speed` (how many
            times as fast) or `displacement` (how many times as far).
        coordinate: Coordinate that it is of, for an offset.
        unit: Unit of both values; `1` for a ratio.
        simulated: What the simulation has.
        fitted: What fits best.
        at_bound: Whether the fit ended at the limit of what was tried, so that it says "at least as much".
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
        time_s: When it is [s].
        until_s: End of the free flight after it: the next impact, or the end of what was looked at [s].
        normal: Unit vector along which the velocity jumps, shape [C].
        speed_in: Speed against the normal just before it [unit/s].
        speed_out: Speed along the normal just after it [unit/s].
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
    """A simulated trajectory that can be played later, faster and larger.

    Attributes:
        kind: What it does.
        times_s: Times [s], strictly increasing, shape [S]; they reach past `end_s` as far as a faster motion needs.
        values: Coordinates at these times, shape [S, C].
        end_s: Where the simulation ended [s]; what comes after it is its continuation.
        centre: From where displacement is scaled, shape [C].
        rate_bounds: How many times as fast it may be made; (1, 1) where its kind has no such change.
        scale_bounds: Least and largest `scale`.
        acceleration: Constant acceleration [unit/s^2], of `uniform_acceleration`.
        impact: The impact of a `rebound`.
        period_s: Period of an `oscillation` [s].
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

    def select(self, columns: NDArray[np.intp]) -> RecognizedMotion:
        """The same motion with some of its coordinates, in the order of the indices."""
        impact = self.impact
        if impact is not None:
            impact = Impact(impact.time_s, impact.until_s, impact.normal[columns], impact.speed_in, impact.speed_out)
        return RecognizedMotion(
            kind=self.kind,
            times_s=self.times_s,
            values=self.values[:, columns],
            end_s=self.end_s,
            centre=self.centre[columns],
            rate_bounds=self.rate_bounds,
            scale_bounds=self.scale_bounds,
            acceleration=self.acceleration,
            impact=impact,
            period_s=self.period_s,
        )

    def at(self, times_s: FloatArray, shifts_s: FloatArray, rates: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The motion played later and faster, and what one unit of `scale` adds to it.

        Args:
            times_s: Times to tell it at [s], shape [T].
            shifts_s: How much later it is played [s], shape [G].
            rates: How many times as fast, shape [G].

        Returns:
            Coordinates, and their change per unit of scale (a share of the displacement; for a rebound, a unit of
            speed), each of shape [G, T, C].
        """
        # Shifted, it is held at both ends, as the score's release alignment holds it.
        since_start = np.clip(times_s - shifts_s[:, None], 0.0, self.end_s)
        own_times = since_start * rates[:, None]
        played = self._curve(own_times)
        if self.impact is None:
            return played, played - self.centre
        flight = np.clip(own_times, self.impact.time_s, self.impact.until_s) - self.impact.time_s
        return played, flight[..., None] * self.impact.normal

    @cached_property
    def _curve(self) -> BSpline:
        return make_interp_spline(self.times_s, self.values, k=1)

    def changes(self, rate: float, scale: float, *, rate_at_bound: bool, scale_at_bound: bool) -> tuple[Change, ...]:
        """What a rate and a scale mean in the quantities of this kind of motion."""
        larger = 1.0 + scale
        if self.acceleration is not None:
            metric = 1e-3 * self.acceleration
            return (_change("acceleration", "m/s^2", metric, larger * metric, scale_at_bound),)
        if self.impact is not None:
            ratio = self.impact.restitution
            return (_change("restitution", "1", ratio, ratio + scale / self.impact.speed_in, scale_at_bound),)
        if self.period_s is not None:
            return (
                _change("period", "s", self.period_s, self.period_s / rate, rate_at_bound),
                _change("amplitude", "1", 1.0, larger, scale_at_bound),
            )
        return (
            _change("speed", "1", 1.0, rate, rate_at_bound),
            _change("displacement", "1", 1.0, larger, scale_at_bound),
        )


def _change(quantity: str, unit: str, simulated: float, fitted: float, at_bound: bool) -> Change:
    return Change(quantity=quantity, unit=unit, simulated=simulated, fitted=fitted, at_bound=at_bound)


def recognized(
    experiment: Experiment, band: Band, times_s: FloatArray, values: FloatArray, *, until_s: float | None = None
) -> RecognizedMotion:
    """What a trajectory does, ready to be changed.

    Args:
        experiment: The experiment that it is of.
        band: Band in whose coordinates it is.
        times_s: Times from 0 on [s], shape [S].
        values: Its band coordinates at these times, shape [S, C].
        until_s: Look no further than this [s] for an acceleration or an impact: what comes later is not compared. None
            looks at all of it.
    """
    seen = slice(None) if until_s is None else slice(0, int(np.searchsorted(times_s, until_s + 1e-6, side="right")))
    single = experiment.score.observable is Observable.POSITION and len(experiment.recorded) == 1
    if single and not experiment.scene.drivers:
        motion = (
            _oscillation(experiment, band, times_s, values)
            or _rebound(experiment, times_s, values, seen)
            or _uniform_acceleration(times_s, values, seen)
        )
        if motion is not None:
            return motion
    return _stretchable(MotionKind.GENERAL, times_s, values, _coasting(times_s, values), values[0])


# --- kinds -----------------------------------------------------------------------------------------------------------


def _uniform_acceleration(times_s: FloatArray, values: FloatArray, seen: slice) -> RecognizedMotion | None:
    seen_s, moved = times_s[seen], values[seen] - values[0]
    size = float(np.sqrt(np.mean(np.square(moved))))
    if size == 0.0:
        return None
    best, acceleration = math.inf, np.zeros(values.shape[1])
    # A recording may show the body at rest for a while; a simulation rarely does.
    for start_s in seen_s[seen_s <= 0.5 * seen_s[-1]]:
        course = 0.5 * np.square(np.maximum(seen_s - start_s, 0.0))
        slope = course @ moved / (course @ course)
        misfit = float(np.sqrt(np.mean(np.square(moved - course[:, None] * slope))))
        if misfit < best:
            best, acceleration = misfit, slope
    if best > SHAPE_TOLERANCE * size:
        return None
    return RecognizedMotion(
        MotionKind.UNIFORM_ACCELERATION,
        times_s,
        values,
        float(times_s[-1]),
        values[0],
        acceleration=float(np.linalg.norm(acceleration)),
    )


def _rebound(experiment: Experiment, times_s: FloatArray, values: FloatArray, seen: slice) -> RecognizedMotion | None:
    body = experiment.recorded[0]
    contacts = [c for c in experiment.scene.contacts if body in (*c.first, *c.second)]
    if experiment.scene.joints or not contacts or any(c.mode is not ContactMode.IMPACT for c in contacts):
        return None
    impact = find_impact(times_s[seen], values[seen])
    if impact is None:
        return None
    speeds = (-impact.restitution * impact.speed_in, (1.0 - impact.restitution) * impact.speed_in)
    end_s = float(times_s[-1])
    return RecognizedMotion(MotionKind.REBOUND, times_s, values, end_s, values[0], scale_bounds=speeds, impact=impact)


def find_impact(times_s: FloatArray, values: FloatArray) -> Impact | None:
    """The first impact of a body that flies freely into it and out of it.

    Args:
        times_s: Times [s], strictly increasing, shape [S].
        values: Coordinates at these times, shape [S, C].

    Returns:
        The impact; None where the velocity never reverses within a sixtieth of a second (two samples, where they are
        further apart), or where the coordinate along the normal is not a parabola before and after it.
    """
    steps = np.diff(times_s)
    window = max(2, round(IMPACT_WINDOW_S / float(np.median(steps))))
    velocity = np.diff(values, axis=0) / steps[:, None]
    if len(velocity) <= 2 * window:
        return None
    jumps = velocity[window:] - velocity[:-window]
    # What free flight changes meanwhile is no part of an impact; what a second one changes may be much less.
    sizes = np.linalg.norm(jumps - np.median(jumps, axis=0), axis=1)
    hits = np.flatnonzero(sizes >= IMPACT_SHARE * sizes.max())
    first = hits[0] + int(np.argmax(sizes[hits[0] : hits[0] + window]))
    later = hits[hits > first + 2 * window]
    last = int(later[0]) + window if later.size else len(times_s) - 1
    if sizes[first] == 0.0:
        return None
    normal = jumps[first] / np.linalg.norm(jumps[first])
    if velocity[first] @ normal >= 0.0 or velocity[first + window] @ normal <= 0.0:
        return None
    height = values @ normal
    before, after = slice(0, first + 2), slice(first + window, last + 1)
    # Where it was still held, it was not in flight.
    fell = np.abs(height[before] - height[0]) > 0.1 * abs(height[first + 1] - height[0])
    flight_in = _parabola(times_s[before][fell], height[before][fell])
    flight_out = _parabola(times_s[after], height[after])
    if flight_in is None or flight_out is None:
        return None
    # The flights meet at the contact: before it the one out of it lies below the floor, after it the one into it does.
    gap, around = flight_in - flight_out, times_s[[first, min(first + window + 1, last)]]
    if gap(around[0]) <= 0.0 or gap(around[1]) >= 0.0:
        return None
    time_s = float(brentq(gap, *around, xtol=1e-12))
    speed_in, speed_out = -float(flight_in.deriv()(time_s)), float(flight_out.deriv()(time_s))
    if speed_in <= 0.0 or speed_out <= 0.0:
        return None
    return Impact(time_s, float(times_s[last]), normal, speed_in, speed_out)


def _parabola(times_s: FloatArray, height: FloatArray) -> np.polynomial.Polynomial | None:
    if len(times_s) < 4:
        return None
    fitted = np.polynomial.Polynomial.fit(times_s, height, 2).convert()
    misfit = float(np.sqrt(np.mean(np.square(fitted(times_s) - height))))
    return fitted if misfit <= SHAPE_TOLERANCE * float(np.ptp(height)) else None


def _oscillation(
    experiment: Experiment, band: Band, times_s: FloatArray, values: FloatArray
) -> RecognizedMotion | None:
    joint = next((j for j in experiment.scene.joints if j.body == experiment.recorded[0]), None)
    period_s = None if joint is None else _period(times_s, values)
    if joint is None or period_s is None:
        return None
    arm_m = math.dist(joint.anchor_m, experiment.scene.body(joint.body).pose.position_m)
    rest_m = np.asarray(joint.anchor_m) - [0.0, 0.0, arm_m]
    centre = band.project(1e3 * rest_m[None])[0]

    def periodic(late_s: FloatArray) -> FloatArray:
        cycles = np.ceil((late_s - times_s[-1]) / period_s)
        return _interpolated(times_s, values, late_s - cycles * period_s)

    return _stretchable(MotionKind.OSCILLATION, times_s, values, periodic, centre, period_s=period_s)


def _period(times_s: FloatArray, values: FloatArray) -> float | None:
    """Lag at which the motion repeats itself [s]; None where it does not within its length."""
    step_s = float(np.median(np.diff(times_s)))
    even_s = np.arange(int((times_s[-1] - times_s[0]) / step_s) + 1) * step_s + times_s[0]
    even = _interpolated(times_s, values, even_s)
    even = even - even.mean(axis=0)
    count = len(even)
    lags = np.arange(count)
    products = sum(correlate(column, column, method="fft")[count - 1 :] for column in even.T)
    # Each lag over the energy of the parts that overlap, so that few periods do not weaken the correlation.
    energy = np.concatenate([[0.0], np.cumsum(np.square(even).sum(axis=1))])
    overlap = np.sqrt((energy[count] - energy[lags]) * energy[count - lags])
    alike = np.divide(products, overlap, out=np.zeros(count), where=overlap > 0.0)[: max(3, int(0.9 * count))]
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
    """A motion that can be made faster; what it then shows from beyond its end is its continuation."""
    end_s, step_s = float(times_s[-1]), float(np.median(np.diff(times_s)))
    late_s = end_s + step_s * np.arange(1, math.ceil((RATE_BOUNDS[1] - 1.0) * end_s / step_s) + 2, dtype=np.float64)
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
    """Constant velocity, that of the last two frames; an acceleration would carry any jitter of the end far away."""
    recent = times_s >= times_s[-1] - IMPACT_WINDOW_S * 4.0
    recent[-2:] = True
    since = times_s[recent] - times_s[recent].mean()
    velocity = since @ values[recent] / (since @ since)
    return lambda late_s: values[-1] + (late_s - times_s[-1])[:, None] * velocity


def _interpolated(times_s: FloatArray, values: FloatArray, at_s: FloatArray) -> FloatArray:
    """Linear interpolation of all coordinates at once, shape [*shape of at_s, C]."""
    found: FloatArray = make_interp_spline(times_s, values, k=1)(np.clip(at_s, times_s[0], times_s[-1]))
    return found
