"""Physical parameters that a trajectory implies, beside those that the real trials imply by the same method."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.bands import Band
from gauge_envs.references.uncertainties import PUBLISHED_TRIALS, TILT_DEG
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.estimators import (
    acceleration_error_m_per_s2,
    acceleration_m_per_s2,
    slide_friction,
)
from gauge_envs.scoring.impact import MAX_MISFIT, find_impact, simulated_impact
from gauge_envs.scoring.metrics.events import oscillation_period

LEAST_SAMPLES = 4
"""Smallest number of frames that determine an acceleration with its uncertainty."""

LEAST_INCLINE = 0.05
"""Sine of the slope below which a body that slides is not driven by its weight."""

LARGEST_DAMPING_RATIO = 0.5
"""Damping ratio above which a body creeps: each half swing is less than a sixth of the one before."""

LEAST_RINGING_SAMPLES = 12
"""Smallest number of samples that determine the five constants of the law with their uncertainty."""

HIGHER_MODES_S = 0.15
"""Time after the release that is left out [s]: about the first swing of the recorded beam, which holds the most of
higher bending modes."""

STARTS_AT_ONCE = 100
"""Number of starts of a motion that are fitted in one array."""

PADDING = 8
"""Length of the spectrum that starts the fit, over that of the signal."""

STEEPEST_INCLINE = 0.999
"""Largest sine of the slope of a slide: a steeper path is a fall, in which nothing presses on the body."""


RealValue = tuple[float | None, float | None, float | None]
"""Value of the real trials, its standard uncertainty, and the standard deviation between trials."""


@dataclass(frozen=True, kw_only=True)
class ImpliedParameter:
    """One parameter that a trajectory implies.

    Attributes:
        parameter: `friction`, `restitution`, `release_time`, `period`, `decay_rate`, `frequency` or `droop`.
        unit: Unit of all numbers; `1` for a ratio.
        value: Value that the simulated trajectory implies.
        uncertainty: Standard uncertainty of `value`, from the misfit of the law.
        real: The same of the real trials, their mean; None if it is not known.
        real_uncertainty: Standard uncertainty of `real`; None if it is not known.
        real_scatter: Standard deviation between real trials; None if it is not known.
        source: Law that was fitted, and origin of the real value.
    """

    parameter: str
    unit: str
    value: float
    uncertainty: float
    real: float | None
    real_uncertainty: float | None
    real_scatter: float | None
    source: str

    @classmethod
    def beside(
        cls,
        real: RealValue | None,
        parameter: str,
        unit: str,
        value: float,
        uncertainty: float,
        *,
        source: str,
    ) -> ImpliedParameter:
        """Return a parameter beside that of the real trials, with nine significant digits of its own value.

        The last bits of a fit depend on the memory that holds its samples.
        """
        mean, error, scatter = real or (None, None, None)
        return cls(
            parameter=parameter,
            unit=unit,
            value=float(f"{value:.9g}"),
            uncertainty=float(f"{uncertainty:.9g}"),
            real=mean,
            real_uncertainty=error,
            real_scatter=scatter,
            source=source,
        )


def implied_parameters(
    experiment: Experiment,
    band: Band | None,
    *,
    times_s: FloatArray,
    values: FloatArray,
    release_offset_s: float | None = None,
) -> tuple[ImpliedParameter, ...]:
    """Return the parameters that a trajectory of a single undriven body, or a ringing of markers, implies.

    Args:
        experiment: The experiment.
        band: Its band; None leaves motions that need one.
        times_s: Times from frame 0 on [s], shape [S].
        values: g(t) at those times [mm], shape [S, D].
        release_offset_s: Release offset of the score [s]; None without one.
    """
    single = (
        experiment.score.observable is Observable.POSITION
        and len(experiment.recorded) == 1
    )
    rings = (
        experiment.score.observable is Observable.MARKER_POSITION
        and experiment.score.period_axis is not None
    )
    if not (single or rings) or experiment.scene.drivers:
        return ()
    if rings:
        return () if band is None else tuple(_ringing(band, times_s, values))
    found = []
    if band is not None:
        last_s = (
            float(np.flatnonzero(np.isfinite(band.mean).any(axis=1))[-1])
            / FRAME_RATE_HZ
        )
        seen = times_s <= last_s + 1e-6
        if not experiment.scene.joints:
            found += _of_free_body(experiment, band, times_s[seen], values[seen])
            if release_offset_s is not None:
                found.append(_release_time(band, release_offset_s))
    if experiment.score.period_axis is not None or "pd" in experiment.score.metrics:
        found += _swing(experiment, times_s, values)
    return tuple(found)


def _of_free_body(
    experiment: Experiment, band: Band, times_s: FloatArray, values: FloatArray
) -> list[ImpliedParameter]:
    """Return the restitution of a rebound, or the friction of a slide."""
    projected = band.project(values)
    impact = simulated_impact(experiment, band, times_s, projected)
    if impact is not None:
        return [
            ImpliedParameter.beside(
                _real_restitution(band),
                "restitution",
                "1",
                impact.restitution,
                0.0,
                source="speeds at the contact of the parabolas before and after the first impact; "
                "real: of each trial, where its parabolas meet",
            )
        ]
    if is_uniformly_accelerated(times_s, projected):
        return _friction(experiment, band, times_s, values)
    return []


def is_uniformly_accelerated(times_s: FloatArray, values: FloatArray) -> bool:
    """Return whether a motion is one of constant acceleration from rest.

    In a recording the body may rest for a while before it moves. Of each start, the best acceleration leaves a sum of
    squares that is smaller by the square of the projection on the motion of unit acceleration.

    Args:
        times_s: Times from 0 on [s], shape [S].
        values: Coordinates at these times, shape [S, C].
    """
    moved = values - values[0]
    total = float(np.square(moved).sum())
    if total == 0.0:
        return False
    starts_s = times_s[times_s <= 0.5 * times_s[-1]]
    largest = 0.0
    for some_s in np.array_split(starts_s, math.ceil(len(starts_s) / STARTS_AT_ONCE)):
        motions = 0.5 * np.square(np.maximum(times_s - some_s[:, None], 0.0))
        gained = np.square(motions @ moved).sum(axis=1)
        largest = max(largest, float((gained / np.square(motions).sum(axis=1)).max()))
    return total - largest <= MAX_MISFIT**2 * total


def _of_trials(found: list[float]) -> tuple[float, float, float] | None:
    """Return the value of several trials; None of fewer than two."""
    if len(found) < 2:
        return None
    scatter = float(np.std(found, ddof=1))
    return float(np.mean(found)), scatter / math.sqrt(len(found)), scatter


# --- slide -----------------------------------------------------------------------------------------------------------


def _friction(
    experiment: Experiment, band: Band, times_s: FloatArray, values: FloatArray
) -> list[ImpliedParameter]:
    """Return the friction of a slide: mu = (g sin - a) / (g cos), with the slope of the path."""
    body = experiment.recorded[0]
    if not any(
        body in (*contact.first, *contact.second)
        for contact in experiment.scene.contacts
    ):
        return []
    path = values[-1] - values[0]
    direction = path / np.linalg.norm(path)
    if not LEAST_INCLINE <= -direction[2] <= STEEPEST_INCLINE:
        return []
    gravity = experiment.scene.gravity_m_per_s2
    acceleration, error = _acceleration(
        times_s, 1e-3 * (values - values[0]) @ direction
    )
    slope_rad = math.asin(-float(direction[2]))
    return [
        ImpliedParameter.beside(
            _real_friction(band),
            "friction",
            "1",
            slide_friction(acceleration, slope_rad, gravity_m_per_s2=gravity),
            error / (gravity * math.cos(slope_rad)),
            source="quadratic through the slide, (g sin - a) / (g cos); real: the same for each trial, tilt included",
        )
    ]


def _acceleration(times_s: FloatArray, path_m: FloatArray) -> tuple[float, float]:
    """Return the acceleration of the moving part of a path that starts at 0, and its standard error [m/s^2].

    Only the part after 2 mm of travel is fitted: a body that is held is not in the law.
    """
    moving = path_m > 2e-3
    if moving.sum() < LEAST_SAMPLES:
        moving = np.ones(len(path_m), dtype=bool)
    moving_s, moving_m = times_s[moving], path_m[moving]
    return acceleration_m_per_s2(moving_s, moving_m), acceleration_error_m_per_s2(
        moving_s, moving_m
    )


@lru_cache(maxsize=64)
def _real_friction(band: Band) -> tuple[float, float, float] | None:
    """Return mean, standard uncertainty and scatter over trials of the friction; None without single trials."""
    if band.trials is None or len(band.trials) < 2:
        return None
    path = band.mean[band.measured][-1] - band.mean[band.measured][0]
    along = path / np.linalg.norm(path)
    direction = np.linalg.pinv(band.projection) @ along
    sine = -float(direction[2] / np.linalg.norm(direction))
    if not LEAST_INCLINE < sine < 1.0:
        return None
    slope_rad = math.asin(sine)
    times_s = np.arange(len(band.mean)) / FRAME_RATE_HZ
    found = []
    for trial in band.trials:
        seen = band.measured & np.isfinite(trial).all(axis=1)
        if seen.sum() < LEAST_SAMPLES:
            continue
        path_m = 1e-3 * (trial[seen] - trial[seen][0]) @ along
        acceleration, _ = _acceleration(times_s[seen], path_m)
        found.append(
            slide_friction(acceleration, slope_rad, gravity_m_per_s2=GRAVITY_M_PER_S2)
        )
    real = _of_trials(found)
    if real is None:
        return None
    mean, error, scatter = real
    tilt_rad = math.radians(TILT_DEG)
    # mu = tan - a / (g cos), so d mu / d slope = 1 + mu tan.
    return (
        mean,
        math.hypot(error, tilt_rad * (1.0 + mean * math.tan(slope_rad))),
        scatter,
    )


# --- rebound ---------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=64)
def _real_restitution(band: Band) -> tuple[float, float, float] | None:
    if band.trials is None:
        return None
    times_s = np.arange(len(band.mean)) / FRAME_RATE_HZ
    gravity = band.projection @ [0.0, 0.0, -GRAVITY_M_PER_S2]
    found = []
    for trial in band.trials:
        seen = np.isfinite(trial).all(axis=1)
        if seen.sum() <= 2 * LEAST_SAMPLES:
            continue
        impact = find_impact(times_s[seen], trial[seen], gravity_m_per_s2=gravity)
        if impact is not None:
            found.append(impact.restitution)
    return _of_trials(found)


# --- release and swing -----------------------------------------------------------------------------------------------


def _release_time(band: Band, release_offset_s: float) -> ImpliedParameter:
    scatter = _release_scatter_s(band)
    count = 0 if band.trials is None else len(band.trials)
    return ImpliedParameter.beside(
        (
            release_offset_s,
            None if scatter is None else scatter / math.sqrt(count),
            scatter,
        ),
        "release_time",
        "s",
        0.0,
        0.0,
        source="the simulation starts at frame 0; real: the time shift that fits this simulation best",
    )


@lru_cache(maxsize=64)
def _release_scatter_s(band: Band) -> float | None:
    """Return the standard deviation over trials of their time shift against the mean, to first order [s]."""
    if band.trials is None or len(band.trials) < 2:
        return None
    velocity = np.nan_to_num(np.gradient(band.mean, 1.0 / FRAME_RATE_HZ, axis=0))
    residuals = np.nan_to_num(band.trials - band.mean)
    size = float(np.square(velocity).sum())
    return (
        float(np.std((residuals * velocity).sum(axis=(1, 2)) / size, ddof=1))
        if size > 0.0
        else None
    )


def _swing(
    experiment: Experiment, times_s: FloatArray, values: FloatArray
) -> list[ImpliedParameter]:
    """Return period and decay rate of a swing."""
    axis = "xyz".index(experiment.score.period_axis or "x")
    step_s = float(np.median(np.diff(times_s)))
    swing = (
        values[:, axis] - 1e3 * experiment.scene.joints[0].anchor_m[axis]
        if experiment.scene.joints
        else None
    )
    if swing is None or np.ptp(swing) == 0.0:
        return []
    baseline = experiment.baselines.get("pd")
    frames = experiment.frame_count if baseline is None else baseline.frames
    seen = times_s <= (frames - 1) / FRAME_RATE_HZ + 1e-6
    period_s = oscillation_period(swing[seen], frame_rate_hz=1.0 / step_s)
    real = None
    if baseline is not None:
        real = (
            baseline.mean,
            None
            if baseline.std is None
            else baseline.std / math.sqrt(PUBLISHED_TRIALS),
            baseline.std,
        )
    found = [
        ImpliedParameter.beside(
            real,
            "period",
            "s",
            period_s,
            0.0,
            source=f"strongest frequency of the windowed spectrum; real: published mean, {PUBLISHED_TRIALS} trials",
        )
    ]
    size = np.abs(swing)
    apexes = np.flatnonzero((size[1:-1] > size[:-2]) & (size[1:-1] >= size[2:])) + 1
    if len(apexes) >= LEAST_SAMPLES:
        line, covariance = np.polyfit(
            times_s[apexes], np.log(size[apexes]), 1, cov=True
        )
        found.append(
            ImpliedParameter.beside(
                None,
                "decay_rate",
                "1/s",
                -float(line[0]),
                math.sqrt(float(covariance[0, 0])),
                source="slope of the logarithm of the turning points; no real value is published",
            )
        )
    return found


# --- ringing ---------------------------------------------------------------------------------------------------------


def _ringing(
    band: Band, times_s: FloatArray, values: FloatArray
) -> list[ImpliedParameter]:
    """Return frequency, decay rate and droop of the first coordinate of the band."""
    seen = times_s <= (len(band.mean) - 1) / FRAME_RATE_HZ + 1e-6
    heights = band.project(values[seen])[:, 0]
    # The simulated body starts level. A recorded one is held by hand, and may be pushed as it is let go.
    level_mm = float(heights[0])
    simulated = fit_ringing(times_s[seen], heights, level_mm=level_mm)
    if simulated is None:
        return []
    trials, found = _real_ringing(band, level_mm), []
    # What creeps to its place has no frequency: the fit then describes the creep by any one.
    creeps = simulated.damping_ratio > LARGEST_DAMPING_RATIO
    for name, unit in (("frequency", "Hz"), ("decay_rate", "1/s"), ("droop", "mm")):
        if creeps and name != "droop":
            continue
        real_values = [one.constants[name][0] for one in trials]
        real = _of_trials(real_values) or (
            real_values[0] if real_values else None,
            None,
            None,
        )
        source = "damped swing fitted from 0.15 s on; real: the same for each trial"
        found.append(
            ImpliedParameter.beside(
                real, name, unit, *simulated.constants[name], source=source
            )
        )
    return found


@lru_cache(maxsize=64)
def _real_ringing(band: Band, level_mm: float) -> tuple[Ringing, ...]:
    trials = band.mean[None] if band.trials is None else band.trials
    times_s = np.arange(len(band.mean)) / FRAME_RATE_HZ
    fits = [fit_ringing(times_s, trial[:, 0], level_mm=level_mm) for trial in trials]
    return tuple(fit for fit in fits if fit is not None)


@dataclass(frozen=True, kw_only=True)
class Ringing:
    """Constants of z(t) = level - droop + A exp(-decay t) cos(2 pi f t + phase), each with its standard uncertainty.

    Attributes:
        frequency_hz: Frequency of the damped swing, and its uncertainty [Hz].
        decay_rate_per_s: Decay rate of the amplitude, and its uncertainty [1/s].
        droop_mm: How far the end hangs below its height in the level body, and its uncertainty [mm].
        residual_mm: Root mean square of what the law leaves [mm].
    """

    frequency_hz: tuple[float, float]
    decay_rate_per_s: tuple[float, float]
    droop_mm: tuple[float, float]
    residual_mm: float

    @property
    def constants(self) -> dict[str, tuple[float, float]]:
        """The constants with their uncertainties, by the name of the implied parameter."""
        return {
            "frequency": self.frequency_hz,
            "decay_rate": self.decay_rate_per_s,
            "droop": self.droop_mm,
        }

    @property
    def damping_ratio(self) -> float:
        """Decay rate over the angular frequency of the same swing without damping."""
        angular = 2.0 * math.pi * self.frequency_hz[0]
        return self.decay_rate_per_s[0] / math.hypot(angular, self.decay_rate_per_s[0])


def fit_ringing(
    times_s: FloatArray, heights_mm: FloatArray, *, level_mm: float
) -> Ringing | None:
    """Fit one damped swing to heights after a release.

    The first 0.15 s are left out: one sinusoid does not describe higher bending modes.

    Args:
        times_s: Times after the release, evenly spaced [s], shape [sample_count].
        heights_mm: Heights at those times [mm], shape [sample_count].
        level_mm: Height from which the droop counts, that of the level body [mm].

    Returns:
        The constants; None for heights that are not finite, do not swing, or have too few samples.
    """
    later = times_s >= HIGHER_MODES_S
    times, signal = times_s[later], heights_mm[later]
    if (
        len(times) < LEAST_RINGING_SAMPLES
        or not np.isfinite(signal).all()
        or np.ptp(signal) == 0.0
    ):
        return None
    step_s, mean = float(times[1] - times[0]), float(signal.mean())
    spectrum = np.fft.rfft(
        (signal - mean) * np.exp(-(times - times[0])), PADDING * len(signal)
    )
    strongest = 1 + int(np.abs(spectrum[1:]).argmax())
    start_hz = strongest / (PADDING * len(signal) * step_s)

    from scipy.optimize import least_squares

    def misfit(constants: FloatArray) -> FloatArray:
        hang, cosine, sine, decay, frequency = constants
        angle = 2.0 * math.pi * frequency * (times - times[0])
        swing = np.exp(-decay * (times - times[0])) * (
            cosine * np.cos(angle) + sine * np.sin(angle)
        )
        return np.asarray(hang + swing - signal)

    # The spectrum leaves the phase open. Two starts a quarter of a swing apart reach the same least sum.
    half = 0.5 * float(np.ptp(signal))
    starts = ((half, 0.0), (0.0, half))
    fits = [
        least_squares(
            misfit, [mean, *size, 1.0, start_hz], x_scale=[1.0, 1.0, 1.0, 1.0, 0.1]
        )
        for size in starts
    ]
    best = min(fits, key=lambda fit: fit.cost)
    count = len(times) - 5
    # A law that fits exactly, as in a test, has a covariance of 0.
    covariance = np.linalg.pinv(best.jac.T @ best.jac) * (2.0 * best.cost / count)
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    hang, _, _, decay, frequency = (float(value) for value in best.x)
    return Ringing(
        frequency_hz=(abs(frequency), float(errors[4])),
        decay_rate_per_s=(decay, float(errors[3])),
        droop_mm=(level_mm - hang, float(errors[0])),
        residual_mm=math.sqrt(2.0 * best.cost / len(times)),
    )
