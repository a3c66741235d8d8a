"""The 95 % intervals hold the distance from the mean of infinitely many simulated trials."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom, t as student

from gauge_envs.scoring.interval import distance_interval, trials_interval

FloatArray = NDArray[np.float64]

FRAMES_S = np.arange(19) / 30.0
FINE_S = np.arange(-40, 230) / 300.0
SHIFTS_S = np.arange(-400, 401) / 3000.0
POPULATION = 10_000
DISTANCES = (0.0, 0.5, 1.0, 2.0, 5.0, 10.0)
"""Distances of an engine, over the standard uncertainty of the mean."""


@dataclass(frozen=True)
class World:
    """Slides whose trials start late by a random time.

    Attributes:
        release_std_s: Scatter of the release.
        noise_mm: Noise within a trial, AR(1) over frames with 0.9.
        order: Correlation of the releases of consecutive trials.
        least: Least share of intervals that hold the truth; chance fails one row of 10,000.
    """

    release_std_s: float
    noise_mm: float = 0.0
    order: float = 0.0
    least: float = 0.92

    def trials(
        self, random: np.random.Generator, shape: tuple[int, int], times_s: FloatArray
    ) -> FloatArray:
        """Return trials without noise [mm], shape [reality_count, trial_count, T]."""
        late_s = 0.06 + self.release_std_s * autoregressive(random, shape, self.order)
        acceleration = 2.7 * (1.0 + 0.025 * random.standard_normal(shape))
        since_s = np.maximum(times_s - late_s[..., None], 0.0)
        return 500.0 * acceleration[..., None] * since_s**2


WORLDS = {
    "release": World(0.03),
    "release and noise": World(0.02, noise_mm=4.0),
    "noise": World(0.003, noise_mm=4.0),
    "order 0.3": World(0.03, order=0.3, least=0.87),
}


def autoregressive(
    random: np.random.Generator, shape: tuple[int, ...], correlation: float
) -> FloatArray:
    values = random.standard_normal(shape)
    for k in range(1, shape[-1]):
        values[..., k] *= math.sqrt(1.0 - correlation**2)
        values[..., k] += correlation * values[..., k - 1]
    return values


def rms(values: FloatArray) -> FloatArray:
    return np.sqrt(np.mean(np.square(values), axis=-1))


def held_shares(
    world: World, count: int, realities: int, *, is_aligned: bool
) -> FloatArray:
    """Return shares of intervals and of percentile bootstraps that hold each distance."""
    random = np.random.default_rng(count)
    population = world.trials(random, (POPULATION, 1), FINE_S)[:, 0]
    fine_mean = population.mean(axis=0)
    spread = float(np.interp(FRAMES_S, FINE_S, population.var(axis=0)).mean())
    uncertainty = math.sqrt((spread + world.noise_mm**2) / count)
    shape = np.maximum(FINE_S - 0.06, 0.0) ** 2
    shape /= float(rms(np.interp(FRAMES_S, FINE_S, shape)))
    trials = world.trials(random, (realities, count), FRAMES_S)
    trials += world.noise_mm * autoregressive(random, trials.shape, 0.9)
    resampled = random.multinomial(count, np.full(count, 1.0 / count), 400) / count
    shifts_s = SHIFTS_S if is_aligned else SHIFTS_S[399:402]
    true_mean = np.interp(FRAMES_S, FINE_S, fine_mean)
    shares = np.zeros((len(DISTANCES), 2))
    for row, factor in enumerate(DISTANCES):
        engine = fine_mean + factor * uncertainty * shape
        moved = [np.interp(FRAMES_S - shift_s, FINE_S, engine) for shift_s in shifts_s]
        engines = np.array(moved)
        truth = rms(engines - true_mean)[1:-1].min()
        for one in trials:
            mean = one.mean(axis=0)
            best = int(rms(engines - mean)[1:-1].argmin()) + 1
            deviation = engines[best] - mean
            velocity = (engines[best - 1] - engines[best + 1])[:, None]
            low, high = trials_interval(
                deviation[:, None],
                one[..., None],
                velocity=velocity if is_aligned else None,
            )
            ends = np.quantile(rms(engines[best] - resampled @ one), [0.025, 0.975])
            shares[row] += low <= truth <= high, ends[0] <= truth <= ends[1]
    return shares / realities


@pytest.mark.parametrize("realities", [40, pytest.param(1000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("is_aligned", [False, True])
@pytest.mark.parametrize("count", [5, 10, 20])
@pytest.mark.parametrize("name", WORLDS)
def test_intervals_hold_the_truth(
    name: str, count: int, is_aligned: bool, realities: int
) -> None:
    world = WORLDS[name]
    shares = held_shares(world, count, realities, is_aligned=is_aligned)
    ours, bootstrap = shares.T
    assert ours.min() >= binom.ppf(1e-4, realities, world.least) / realities, ours
    assert ours[-1] <= binom.ppf(1.0 - 1e-4, realities, 0.98) / realities, ours
    assert bootstrap.mean() < 0.85 < ours.mean()


def test_far_from_trials_that_differ_in_one_direction_it_is_students() -> None:
    offsets = np.array([1.0, -1.0, -2.0, 2.0, -2.0, 1.0, -1.0, 2.0])
    trials = offsets[:, None, None] * np.ones((8, 5, 1))
    low, high = trials_interval(np.full((5, 1), 1000.0), trials)
    half = student.ppf(0.975, 7) * offsets.std(ddof=1) / math.sqrt(8)
    assert (1000.0 - low, high - 1000.0) == pytest.approx((half, half), rel=0.01)


def test_trials_that_agree_leave_the_distance() -> None:
    interval = trials_interval(np.full((5, 1), 3.0), np.zeros((4, 5, 1)))
    assert interval == pytest.approx((3.0, 3.0))


def test_unknown_values_and_shared_errors_widen() -> None:
    trials = np.random.default_rng(1).standard_normal((9, 6, 2))
    deviation = np.full((6, 2), 3.0)
    low, high = trials_interval(deviation, trials)
    trials[::2, 3:] = np.nan
    fewer = trials_interval(deviation, trials)
    shared = trials_interval(deviation, trials, uncertainty=np.full((6, 2), 1.0))
    assert shared[0] < fewer[0] < low < high < fewer[1] < shared[1]


def test_an_interval_of_a_stated_uncertainty_ends_at_zero() -> None:
    assert distance_interval(5.0, 1.0) == pytest.approx((3.04, 6.96))
    assert distance_interval(1.0, 1.0) == pytest.approx((0.0, 2.96))
