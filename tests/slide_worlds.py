"""Simulated realities: Coulomb slides with a true friction, tilt and start, and trials that are drawn from them.

A reality is a slide with a true friction, tilt and start. Trials are drawn from it, with their own friction and release
time. The experimenter knows friction, tilt and start with the uncertainties of `scoring/uncertainties.toml`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from gauge_envs.references.bands import Band, BandGrade
from gauge_envs.references.sensitivities import InputUncertainty, Sensitivities, input_uncertainties

FloatArray = NDArray[np.float64]

FRAMES = 19
TIMES_S = np.arange(FRAMES) / 30.0
GRAVITY = 9.80665
SLOPE = math.radians(30.0)
TRIAL_COUNT = 20


@dataclass(frozen=True)
class World:
    """One simulated reality: mean and scatter of friction and release, and the bias of the engine."""

    friction: float = 0.257
    friction_scatter: float = 0.008
    release_s: float = 0.03
    release_scatter_s: float = 0.03
    engine_friction_error: float = 0.0
    """Friction that the engine adds to the one that it is given; it is part of the true score."""


def slide_mm(friction: FloatArray, release_s: FloatArray, tilt_rad: FloatArray, start_mm: FloatArray) -> FloatArray:
    """Return downhill positions [mm], shape [..., FRAMES]."""
    slope = SLOPE + np.asarray(tilt_rad)
    acceleration = GRAVITY * (np.sin(slope) - np.asarray(friction) * np.cos(slope))
    since = np.maximum(TIMES_S - np.asarray(release_s)[..., None], 0.0)
    return np.asarray(start_mm)[..., None] + 500.0 * acceleration[..., None] * since**2


def trials_of(world: World, count: int, random: np.random.Generator) -> FloatArray:
    """Return trials of a world with true tilt 0 and start 0, shape [count, FRAMES]."""
    friction = world.friction + world.friction_scatter * random.standard_normal(count)
    release = world.release_s + world.release_scatter_s * random.standard_normal(count)
    return slide_mm(friction, release, np.zeros(count), np.zeros(count))


def band_of(trials: FloatArray) -> Band:
    values = trials[:, :, None]
    return Band(
        grade=BandGrade.TRIALS,
        unit="mm",
        coordinates=("downhill",),
        projection=np.eye(1),
        mean=values.mean(axis=0),
        sigma=values.std(axis=0, ddof=1),
        measured=np.ones(FRAMES, dtype=bool),
        trial_count=len(trials),
        source="simulated",
        trials=values,
    )


def simulated_mm(friction: float, tilt_rad: float, start_mm: float) -> FloatArray:
    one = slide_mm(np.array([friction]), np.zeros(1), np.array([tilt_rad]), np.array([start_mm]))
    return one[0][:, None]


def sensitivities(friction: float) -> Sensitivities:
    known = input_uncertainties()
    steps = {
        "friction": (known.friction.std, 0.0, 0.0),
        "tilt": (0.0, math.radians(known.tilt.std), 0.0),
        "start": (0.0, 0.0, 1e3 * known.start.std),
    }
    inputs = []
    for name, (mu, tilt, start) in steps.items():
        high, low = (simulated_mm(friction + sign * mu, sign * tilt, sign * start) for sign in (1.0, -1.0))
        inputs.append(
            InputUncertainty(name=name, kind=name, std=1.0, unit="1", source="test", change=0.5 * (high - low))
        )
    return Sensitivities(variant="simulated", backend="test", versions={}, settings={}, inputs=tuple(inputs))


def rmse(deviation: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(deviation))))


def aligned(values: FloatArray, friction: float, mean: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the deviation of the slide that is shifted in time to fit best, and its velocity."""
    start = float(values[0, 0])

    def moved(shift: float) -> FloatArray:
        return start + slide_mm(np.array([friction]), np.array([shift]), np.zeros(1), np.zeros(1))[0][:, None]

    best = minimize_scalar(lambda shift: rmse(moved(shift) - mean), bounds=(-0.3, 0.3), method="bounded")
    shift = float(best.x)
    return moved(shift) - mean, (moved(shift - 5e-4) - moved(shift + 5e-4)) / 1e-3


def equivalent_friction(friction: float, tilt_rad: float) -> float:
    """Return the friction on the nominal slope that gives the acceleration on a tilted one."""
    slope = SLOPE + tilt_rad
    acceleration = GRAVITY * (math.sin(slope) - friction * math.cos(slope))
    return (math.sin(SLOPE) - acceleration / GRAVITY) / math.cos(SLOPE)


def true_baseline(population: FloatArray) -> float:
    """Return the mean score of trials against their true mean, for trials of shape [count, FRAMES]."""
    residuals = population - population.mean(axis=0)
    return float(np.sqrt(np.mean(np.square(residuals), axis=1)).mean())


def sample_baseline(band: Band) -> float:
    """Return the mean score of the trials of a band against their own mean."""
    assert band.trials is not None
    return float(np.sqrt(np.mean(np.square(band.trials - band.mean), axis=(1, 2))).mean())
