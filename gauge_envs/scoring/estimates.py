"""Estimate friction, restitution and ringing, of a simulation and of real trials by the same method."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, NamedTuple

import numpy as np

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.band import Band, ExactLaw
from gauge_envs.scene import ContactMode
from gauge_envs.scene.geometry import BoolArray, FloatArray, length_of
from gauge_envs.scene.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.timing import FRAME_RATE_HZ, frame_times_s
from gauge_envs.scoring.answers import TELLING_SHARE, Answer
from gauge_envs.scoring.estimators import (
    acceleration_error_m_per_s2,
    acceleration_m_per_s2,
    first_bounce,
    slide_friction,
)
from gauge_envs.scoring.exact import law_holds
from gauge_envs.scoring.interval import COVERAGE_FACTOR

MIN_SAMPLES = 4
"""Smallest number of frames for an acceleration with its uncertainty."""

MIN_INCLINE, MAX_INCLINE = 0.05, 0.999
"""Range of the sine of a slope: on a flatter path the weight does not drive the slide; a steeper one is a fall."""

TILT_DEG = 0.3
"""Standard uncertainty of the tilt of the board in real slides [deg], measured in the recording of SlopeSlider-3."""

MAX_MISFIT = 0.04
"""Largest root-mean-square misfit of a law of motion, over the root mean square of the displacement.

Real slides start at different times. So their mean has a misfit of up to 0.032 from uniform acceleration.
"""

IMPACT_WINDOW_S = 1.0 / 60.0
"""Longest duration of an impact [s]; the impact of the ball takes 5 ms."""

IMPACT_SHARE = 0.1
"""Smallest change of velocity in an impact, over the largest; the second impact has e times the change of the first."""

REST_MM = 2.0
"""Path below which a body has not slid [mm]: the law does not hold before the release."""

LARGEST_DAMPING_RATIO = 0.5
"""Damping ratio above which a body creeps: each half swing is less than a sixth of the previous one."""

MIN_RINGING_SAMPLES = 12
"""Smallest number of samples for the five constants of the law with their uncertainty."""

HIGHER_MODES_S = 0.15
"""Time after the release that the fit skips [s]: higher bending modes are strongest in the first swing of the beam."""

PADDING = 8
"""Length of the padded signal, whose spectrum gives the first guess of the fit, over the length of the signal."""


@dataclass(frozen=True, kw_only=True)
class ComparedQuantity:
    """One quantity of a simulated motion, with its value in real trials.

    Attributes:
        value: Value of the simulation; None if the event does not happen.
        unit: Unit of all numbers; `1` for a ratio.
        uncertainty: Standard uncertainty of `value` from the fit; 0 for an event.
        real: Value of the real trials or the recording; None if it is not known.
        real_uncertainty: Standard uncertainty of `real`, including the set-up; None if it is not known.
    """

    PRINTED: ClassVar[tuple[str, ...]] = ("over_real",)
    """Properties that `Score.to_dict` adds."""

    value: float | None
    unit: str
    uncertainty: float = 0.0
    real: float | None = None
    real_uncertainty: float | None = None

    @property
    def over_real(self) -> float | None:
        """Value over the real value; None if either is unknown or the real value is 0."""
        return self.value / self.real if self.value is not None and self.real else None

    @property
    def answer(self) -> Answer | None:
        """Whether the value is within 1.96 standard uncertainties of the real value; None if that is not known.

        An interval above 20 % of the values cannot tell.
        """
        if self.real is None or not self.real_uncertainty:
            return None
        if self.value is None:
            return Answer.NO
        half_width = COVERAGE_FACTOR * self.real_uncertainty
        if abs(self.value - self.real) > half_width:
            return Answer.NO
        largest = max(abs(self.value), abs(self.real))
        is_telling = half_width <= TELLING_SHARE * largest
        return Answer.YES if is_telling else Answer.CANNOT_TELL


RealValue = tuple[float | None, float | None]
"""Value of real trials and its standard uncertainty; None is unknown."""


def _measured(
    real: RealValue, value: float, uncertainty: float, unit: str = "1"
) -> ComparedQuantity:
    """Return a quantity with nine digits; the last bits of a fit depend on the alignment of memory."""
    mean, error = real
    return ComparedQuantity(
        value=float(f"{value:.9g}"),
        unit=unit,
        uncertainty=float(f"{uncertainty:.9g}"),
        real=mean,
        real_uncertainty=error,
    )


def _of_trials(values: list[float]) -> RealValue:
    """Return mean and standard uncertainty of the values of trials; None for fewer than two."""
    if len(values) < 2:
        return None, None
    scatter = float(np.std(values, ddof=1))
    return float(np.mean(values)), scatter / math.sqrt(len(values))


def estimates(
    experiment: Experiment,
    band: Band | None,
    *,
    times_s: FloatArray,
    values: FloatArray,
) -> dict[str, ComparedQuantity]:
    """Return the constants that follow from the motion of one undriven body, or from the ringing of markers.

    Args:
        experiment: The experiment.
        band: Its reference; slides, rebounds and ringing need one.
        times_s: Times from frame 0 on [s], shape [S].
        values: g(t) at those times [mm], shape [S, D].

    Returns:
        `friction`, `restitution`, or `frequency`, `decay_rate` and `droop`, by name; empty for other motions.
    """
    scene, score = experiment.scene, experiment.score
    if band is None or scene.drivers:
        return {}
    is_of_markers = score.observable is Observable.MARKER_POSITION
    if is_of_markers and score.period_axis is not None:
        seen = times_s <= (len(band.mean) - 1) / FRAME_RATE_HZ + 1e-6
        return _ringing(band, times_s[seen], band.project(values[seen])[:, 0])
    is_position = score.observable is Observable.POSITION
    if not is_position or scene.joints or len(experiment.recorded) != 1:
        return {}
    seen = times_s <= np.flatnonzero(band.known)[-1] / FRAME_RATE_HZ + 1e-6
    return _of_free_body(experiment, band, times_s[seen], values[seen])


def _of_free_body(
    experiment: Experiment, band: Band, times_s: FloatArray, values: FloatArray
) -> dict[str, ComparedQuantity]:
    """Return the restitution of a rebound, or the friction of a slide.

    Friction of an oblique impact turns the change of velocity away from the normal, so only a drop has a restitution.
    """
    scene, (name,) = experiment.scene, experiment.recorded
    modes = {
        contact.mode
        for contact in scene.contacts
        if name in (*contact.first, *contact.second)
    }
    if modes == {ContactMode.IMPACT} and scene.body(name).starts_at_rest:
        gravity = scene.gravity_m_per_s2
        restitution = _rebound(band, times_s, band.project(values), gravity)
        if restitution is not None:
            return {"restitution": _measured(_real_restitution(band), restitution, 0.0)}
    holds = law_holds(experiment, values, band)
    if holds[0]:
        times_s, values = times_s[holds], values[holds]
    path_mm = length_of(values[-1] - values[0])
    is_slide = band.exact_law is ExactLaw.COULOMB_SLIDE
    real, error = _real_friction(band) if is_slide else (None, None)
    if real is not None and path_mm < REST_MM:
        none = ComparedQuantity(value=None, unit="1", real=real, real_uncertainty=error)
        return {"friction": none}
    # Motion across the slide is not of a slide from rest.
    if not modes or not is_uniformly_accelerated(times_s, values):
        return {}
    direction = _direction(values)
    if not MIN_INCLINE <= -direction[2] <= MAX_INCLINE:
        return {}
    path_mm = (values - values[0]) @ direction
    slope_rad = math.asin(-float(direction[2]))
    slide = _friction(times_s, path_mm, slope_rad, scene.gravity_m_per_s2)
    return {"friction": _measured(_real_friction(band), *slide)}


def is_uniformly_accelerated(times_s: FloatArray, values: FloatArray) -> bool:
    """Return whether a motion is one of constant acceleration from rest.

    In a recording the body may rest before it moves, so each sample of the first half is tried as the start. For each
    start, the best acceleration reduces the sum of squares by the squared projection on unit acceleration.

    Args:
        times_s: Times from 0 on [s], shape [S].
        values: Coordinates at these times, shape [S, C].
    """
    moved = values - values[0]
    total = float(np.square(moved).sum())
    if total == 0.0:
        return False
    start_times_s = times_s[times_s <= 0.5 * times_s[-1]]
    motions = 0.5 * np.square(np.maximum(times_s - start_times_s[:, None], 0.0))
    gained = np.square(motions @ moved).sum(axis=1)
    largest = float((gained / np.square(motions).sum(axis=1)).max())
    return total - largest <= MAX_MISFIT**2 * total


# --- slide -----------------------------------------------------------------------------------------------------------


def _direction(places: FloatArray) -> FloatArray:
    """Return the unit vector from the first to the last place, shape [C]."""
    path: FloatArray = places[-1] - places[0]
    return path / length_of(path)


def _friction(
    times_s: FloatArray, path_mm: FloatArray, slope_rad: float, gravity: float
) -> tuple[float, float]:
    """Return the friction of a path down a slope from 0, mu = (g sin - a) / (g cos), and its standard error.

    The fit uses only samples after `REST_MM` of travel.
    """
    moving = path_mm > REST_MM
    if moving.sum() < MIN_SAMPLES:
        moving[:] = True
    path = times_s[moving], 1e-3 * path_mm[moving]
    acceleration = acceleration_m_per_s2(*path)
    error = acceleration_error_m_per_s2(*path) / (gravity * math.cos(slope_rad))
    return slide_friction(acceleration, slope_rad, gravity_m_per_s2=gravity), error


@lru_cache(maxsize=64)
def _real_friction(band: Band) -> RealValue:
    """Return mean and standard uncertainty, tilt included, of the friction of real trials."""
    if band.trials is None:
        return None, None
    along = _direction(band.mean[band.measured])
    direction = np.linalg.pinv(band.projection) @ along
    sine = -float(direction[2] / length_of(direction))
    if not MIN_INCLINE < sine < 1.0:
        return None, None
    slope_rad = math.asin(sine)
    frictions = []
    for times_s, places in _seen_trials(band, band.measured):
        if len(places) >= MIN_SAMPLES:
            path_mm = (places - places[0]) @ along
            slide = _friction(times_s, path_mm, slope_rad, GRAVITY_M_PER_S2)
            frictions.append(slide[0])
    mean, error = _of_trials(frictions)
    if mean is None or error is None:
        return None, None
    # mu = tan - a / (g cos), so d mu / d slope = 1 + mu tan.
    of_tilt = math.radians(TILT_DEG) * (1.0 + mean * math.tan(slope_rad))
    return mean, math.hypot(error, of_tilt)


def _seen_trials(
    band: Band, frames: BoolArray | bool = True
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield the times [s] and places of each real trial at some frames, where all coordinates were captured."""
    times_s = frame_times_s(len(band.mean))
    for trial in () if band.trials is None else band.trials:
        seen = frames & np.isfinite(trial).all(axis=1)
        yield times_s[seen], trial[seen]


# --- rebound ---------------------------------------------------------------------------------------------------------


def rebound(
    times_s: FloatArray, values: FloatArray, *, gravity_m_per_s2: FloatArray
) -> float | None:
    """Return the restitution of the first impact of a body between two free flights; None without one.

    The sharpest change of velocity gives the normal. `estimators.first_bounce` along the normal gives the speeds where
    the parabolas before and after the impact meet.

    Args:
        times_s: Times [s], strictly increasing, shape [S].
        values: Coordinates at these times [mm], shape [S, C].
        gravity_m_per_s2: Acceleration of a free body in the same coordinates, shape [C].
    """
    steps = np.diff(times_s)
    window = max(2, round(IMPACT_WINDOW_S / float(np.median(steps))))
    velocity = np.diff(values, axis=0) / steps[:, None]
    if len(velocity) <= 2 * window:
        return None
    jumps = velocity[window:] - velocity[:-window]
    # Subtract the change of velocity in free flight. A second impact may change the velocity much less.
    sizes = np.linalg.norm(jumps - np.median(jumps, axis=0), axis=1)
    hit = int(np.argmax(sizes >= IMPACT_SHARE * sizes.max()))
    first = hit + int(np.argmax(sizes[hit : hit + window]))
    if sizes[first] == 0.0:
        return None
    normal = jumps[first] / length_of(jumps[first])
    gravity = -float(gravity_m_per_s2 @ normal)
    is_reversed = velocity[first] @ normal < 0.0 < velocity[first + window] @ normal
    if not is_reversed or gravity <= 0.0:
        return None
    heights_m = 1e-3 * values @ normal
    bounce = first_bounce(times_s, heights_m, gravity_m_per_s2=gravity, contact_m=None)
    if bounce is None or bounce.misfit > MAX_MISFIT:
        return None
    return bounce.restitution


def _rebound(
    band: Band, times_s: FloatArray, projected: FloatArray, gravity: float
) -> float | None:
    """Return the restitution of a motion in the coordinates of a band."""
    along = band.projection @ [0.0, 0.0, -gravity]
    return rebound(times_s, projected, gravity_m_per_s2=along)


@lru_cache(maxsize=64)
def _real_restitution(band: Band) -> RealValue:
    """Return mean and standard uncertainty of the restitution of real trials."""
    restitutions = [
        _rebound(band, times_s, places, GRAVITY_M_PER_S2)
        for times_s, places in _seen_trials(band)
        if len(places) > 2 * MIN_SAMPLES
    ]
    return _of_trials([value for value in restitutions if value is not None])


# --- ringing ---------------------------------------------------------------------------------------------------------


def _ringing(
    band: Band, times_s: FloatArray, heights_mm: FloatArray
) -> dict[str, ComparedQuantity]:
    """Return frequency, decay rate and droop of heights, and of the first coordinate of a band."""
    # The simulated body starts level. In a recording, a hand holds the body and may push it at the release.
    level_mm = float(heights_mm[0])
    simulated = fit_ringing(times_s, heights_mm, level_mm=level_mm)
    if simulated is None:
        return {}
    trials = _real_ringing(band, level_mm)
    quantities = {}
    for name, unit in (("frequency", "Hz"), ("decay_rate", "1/s"), ("droop", "mm")):
        # A body that creeps has no frequency; the fit would give an arbitrary one.
        if simulated.damping_ratio > LARGEST_DAMPING_RATIO and name != "droop":
            continue
        values = [getattr(trial, name)[0] for trial in trials]
        real = (values[0], None) if len(values) == 1 else _of_trials(values)
        value, uncertainty = getattr(simulated, name)
        quantities[name] = _measured(real, value, uncertainty, unit)
    return quantities


@lru_cache(maxsize=64)
def _real_ringing(band: Band, level_mm: float) -> tuple[Ringing, ...]:
    """Return the ringing of each real trial, or of the mean without trials."""
    trials = band.mean[None] if band.trials is None else band.trials
    times_s = frame_times_s(len(band.mean))
    fits = (fit_ringing(times_s, trial[:, 0], level_mm=level_mm) for trial in trials)
    return tuple(fit for fit in fits if fit is not None)


class Ringing(NamedTuple):
    """Constants of z(t) = level - droop + A exp(-decay t) cos(2 pi f t + phase), each with its standard uncertainty.

    Attributes:
        frequency: Frequency of the damped swing, and its uncertainty [Hz].
        decay_rate: Decay rate of the amplitude, and its uncertainty [1/s].
        droop: Height of the end in the level body minus its height at rest, and its uncertainty [mm].
    """

    frequency: tuple[float, float]
    decay_rate: tuple[float, float]
    droop: tuple[float, float]

    @property
    def damping_ratio(self) -> float:
        """Decay rate over the angular frequency of the undamped swing."""
        angular = 2.0 * math.pi * self.frequency[0]
        return self.decay_rate[0] / math.hypot(angular, self.decay_rate[0])


def fit_ringing(
    times_s: FloatArray, heights_mm: FloatArray, *, level_mm: float
) -> Ringing | None:
    """Fit one damped swing to heights after a release.

    The fit skips the first 0.15 s, because one sinusoid does not describe higher bending modes.

    Args:
        times_s: Times after the release, evenly spaced [s], shape [sample_count].
        heights_mm: Heights at those times [mm], shape [sample_count].
        level_mm: Height of the level body, from which the droop counts [mm].

    Returns:
        The constants; None if a height is not finite, all heights are equal, or there are too few samples.
    """
    from scipy.optimize import curve_fit

    later = times_s >= HIGHER_MODES_S
    signal = heights_mm[later]
    # The range of heights of which one is unknown is NaN.
    if len(signal) < MIN_RINGING_SAMPLES or not np.ptp(signal) > 0.0:
        return None
    since_s = times_s[later] - times_s[later][0]
    mean = float(signal.mean())
    padded_count = PADDING * len(signal)
    spectrum = np.fft.rfft((signal - mean) * np.exp(-since_s), padded_count)
    strongest = 1 + int(np.abs(spectrum[1:]).argmax())
    start_hz = strongest / (padded_count * float(since_s[1]))
    # The spectrum does not give the phase. Two first guesses a quarter of a swing apart reach the same minimum.
    half = 0.5 * float(np.ptp(signal))
    fits = [
        curve_fit(
            damped_swing,
            since_s,
            signal,
            [mean, *size, 1.0, start_hz],
            method="trf",
            x_scale=[1.0, 1.0, 1.0, 1.0, 0.1],
            full_output=True,
        )
        for size in ((half, 0.0), (0.0, half))
    ]
    constants, covariance, *_ = min(fits, key=lambda fit: length_of(fit[2]["fvec"]))
    hang, _, _, decay, frequency = constants.tolist()
    errors = np.sqrt(np.diag(covariance)).tolist()
    return Ringing(
        frequency=(abs(frequency), errors[4]),
        decay_rate=(decay, errors[3]),
        droop=(level_mm - hang, errors[0]),
    )


def damped_swing(
    times_s: FloatArray,
    hang: float,
    cosine: float,
    sine: float,
    decay: float,
    frequency: float,
) -> FloatArray:
    """Return the heights of a damped swing about a height."""
    angle = 2.0 * math.pi * frequency * times_s
    swing = cosine * np.cos(angle) + sine * np.sin(angle)
    return hang + np.exp(-decay * times_s) * swing
