"""The 95 % interval of a score holds the true score, in simulated realities whose truth is known.

A reality is a Coulomb slide with a true friction, tilt and start. Twenty trials are drawn from it, with their own
friction and release time. The experimenter knows friction, tilt and start with the uncertainties of
`scoring/uncertainties.toml`, simulates with these, and scores. The true score is that of a simulation with the true
inputs against the mean of infinitely many trials, over their mean score.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from gauge_envs.evaluation.uncertainty import band_errors
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


def coverage(world: World, *, repeats: int, inputs_known: bool = False, align: bool = False, seed: int = 1) -> float:
    """Return the share of simulated realities whose interval holds the true score."""
    random = np.random.default_rng(seed)
    population = trials_of(world, 40_000, random)
    truth = population.mean(axis=0)[:, None]
    true_baseline = float(np.sqrt(np.mean(np.square(population - truth[:, 0]), axis=1)).mean())
    known = input_uncertainties()
    true_run = simulated_mm(world.friction + world.engine_friction_error, 0.0, 0.0)
    true_deviation = true_run - truth
    if align:
        true_deviation, _ = aligned(true_run, world.friction + world.engine_friction_error, truth)
    true_score = rmse(true_deviation) / true_baseline
    table = None if inputs_known else sensitivities(world.friction)
    held = 0
    for _ in range(repeats):
        band = band_of(trials_of(world, TRIAL_COUNT, random))
        errors = np.zeros(3) if inputs_known else random.standard_normal(3)
        friction = world.friction + world.engine_friction_error + known.friction.std * errors[0]
        tilt, start = math.radians(known.tilt.std) * errors[1], 1e3 * known.start.std * errors[2]
        run = simulated_mm(friction, tilt, start)
        of_band = band_errors(band, None, table)
        deviation = run - band.mean
        if align:
            # A tilt acts as a change of friction.
            slope = SLOPE + tilt
            acceleration = GRAVITY * (math.sin(slope) - friction * math.cos(slope))
            equivalent = (math.sin(SLOPE) - acceleration / GRAVITY) / math.cos(SLOPE)
            deviation, velocity = aligned(run, equivalent, band.mean)
            of_band = of_band.aligned(velocity)
        baseline = float(np.sqrt(np.mean(np.square(band.trials - band.mean), axis=(1, 2))).mean())
        low, high = (end / baseline for end in of_band.interval(deviation))
        held += low <= true_score <= high
    return held / repeats


WORLDS = {
    "released late": World(),
    "wrong friction": World(engine_friction_error=0.03),
    "both": World(release_s=0.06, engine_friction_error=-0.03),
}


RESOLVED = [("released late", False), ("both", False), ("wrong friction", True), ("both", True)]
"""Worlds, and whether scores are aligned, whose true score is above its errors."""

BELOW = [("wrong friction", False), ("released late", True)]
"""Those whose true score is below its errors: late release cancels excess friction, or nothing is left to align."""


@pytest.mark.parametrize(
    ("name", "align"), [RESOLVED[0], *(pytest.param(*one, marks=pytest.mark.slow) for one in RESOLVED[1:])]
)
def test_interval_holds_the_true_score_in_95_percent_of_500_simulated_realities(name: str, align: bool) -> None:
    assert 0.93 <= coverage(WORLDS[name], repeats=500, align=align) <= 0.97


@pytest.mark.slow
@pytest.mark.parametrize(("name", "align"), BELOW)
def test_interval_of_a_score_below_its_errors_is_not_too_short(name: str, align: bool) -> None:
    assert coverage(WORLDS[name], repeats=500, align=align) >= 0.93
