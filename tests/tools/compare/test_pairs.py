"""Differences of two simulated engines whose truth is known, and means over repeats."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray
from slide_worlds import (
    TRIAL_COUNT,
    World,
    aligned,
    band_of,
    equivalent_friction,
    rmse,
    sample_baseline,
    sensitivities,
    simulated_mm,
    trials_of,
    true_baseline,
)

from gauge_envs.evaluation.uncertainty import band_errors
from gauge_envs.references.sensitivities import input_uncertainties
from gauge_envs.tools.compare.draws import ScoreDraws, repeats_interval
from gauge_envs.tools.compare.grades import (
    GradedExperiment,
    PairComparison,
    compare_grade,
    compare_pairs,
)

FloatArray = NDArray[np.float64]

WORLD = World()


def true_scores(world: World, errors: Sequence[float], *, align: bool) -> list[float]:
    """True normalized score of engines with a friction error each, against infinitely many trials."""
    population = trials_of(world, 40_000, np.random.default_rng(7))
    mean = population.mean(axis=0)[:, None]
    scores = []
    for error in errors:
        run = simulated_mm(world.friction + error, 0.0, 0.0)
        deviation = aligned(run, world.friction + error, mean)[0] if align else run - mean
        scores.append(rmse(deviation) / true_baseline(population))
    return scores


def observed(
    world: World, errors: Sequence[float], *, align: bool, random: np.random.Generator, name: str = "slide"
) -> GradedExperiment:
    """One experimenter's scores of engines: 20 trials, and inputs that are known with their uncertainty.

    All engines are given the same inputs, so their errors are common.
    """
    known = input_uncertainties()
    band = band_of(trials_of(world, TRIAL_COUNT, random))
    of_band = band_errors(band, None, sensitivities(world.friction))
    inputs = random.standard_normal(3)
    tilt, start = math.radians(known.tilt.std) * inputs[1], 1e3 * known.start.std * inputs[2]
    order = np.random.default_rng([*name.encode()]).permutation(len(of_band.factors))
    draws, intervals = [], []
    for error in errors:
        friction = world.friction + error + known.friction.std * inputs[0]
        run = simulated_mm(friction, tilt, start)
        deviation, own = run - band.mean, of_band
        if align:
            deviation, velocity = aligned(run, equivalent_friction(friction, tilt), band.mean)
            own = of_band.aligned(velocity)
        score = np.array([rmse(deviation)]) / sample_baseline(band)
        drawn = own.draws(deviation)[None, order] / sample_baseline(band)
        draws.append(ScoreDraws(seeds=(0,), raw=score, raw_draws=drawn, primary=score, primary_draws=drawn))
        low, high = own.interval(deviation)
        intervals.append((low / sample_baseline(band), high / sample_baseline(band)))
    return GradedExperiment(id=name, draws=tuple(draws), intervals=tuple(intervals), trial_count=TRIAL_COUNT)


def paired(experiments: Sequence[GradedExperiment]) -> PairComparison:
    (pair,) = compare_pairs(experiments, [(0, 1)])
    return pair


def coverage(errors: tuple[float, float], *, align: bool, repeats: int, seed: int = 3) -> float:
    """Share of simulated realities in which the interval of the difference holds the true one."""
    first, second = true_scores(WORLD, errors, align=align)
    random = np.random.default_rng(seed)
    held = 0
    for _ in range(repeats):
        (one,) = paired([observed(WORLD, errors, align=align, random=random)]).experiments
        held += one.difference_95[0] <= first - second <= one.difference_95[1]
    return held / repeats


CASES = [((0.03, -0.03), False), ((0.0, 0.03), True), ((0.0, 0.01), False), ((0.03, -0.03), True)]
"""Friction errors of two engines, and whether their scores are aligned."""


@pytest.mark.parametrize(("errors", "align"), [pytest.param(*CASES[0], marks=pytest.mark.slow), CASES[1]])
def test_the_interval_of_a_difference_holds_the_true_one(errors: tuple[float, float], align: bool) -> None:
    # Of 150 realities, a true 95 % gives 0.91 to 0.99 in 98 of 100 runs.
    assert 0.91 <= coverage(errors, align=align, repeats=150) <= 0.99


@pytest.mark.slow
@pytest.mark.parametrize(("errors", "align"), CASES)
def test_the_interval_of_a_difference_holds_the_true_one_in_95_percent_of_500(
    errors: tuple[float, float], align: bool
) -> None:
    assert 0.93 <= coverage(errors, align=align, repeats=500) <= 0.97


@pytest.mark.parametrize(("error", "align"), [pytest.param(0.0, True, marks=pytest.mark.slow), (0.01, False)])
def test_the_interval_of_a_mean_over_one_experiment_holds_the_true_score(error: float, align: bool) -> None:
    (truth,) = true_scores(WORLD, [error], align=align)
    random = np.random.default_rng(3)
    held = 0
    for _ in range(150):
        one = observed(WORLD, [error], align=align, random=random)
        (grade,) = compare_grade("trials", withheld=False, experiments=[one])
        (score,) = grade.scores
        assert score.mean is not None and score.mean.interval_95 == one.intervals[0]
        held += score.mean.interval_95[0] <= truth <= score.mean.interval_95[1]
    # Of 150 realities, a true 95 % gives at least 0.91 in 98 of 100 runs.
    assert held >= 0.91 * 150


def test_the_interval_of_a_mean_over_repeats_holds_the_true_mean() -> None:
    random = np.random.default_rng(8)
    for count, shared, own in [(4, 0.1, 0.1), (3, 0.02, 0.2), (8, 0.2, 0.05)]:
        held = 0
        for _ in range(1000):
            scores = 2.0 + shared * random.standard_normal() + own * random.standard_normal(count)
            low, high = repeats_interval([*scores], [(one - 1.96 * shared, one + 1.96 * shared) for one in scores])
            held += low <= 2.0 <= high
        # A true 95 % of 1000 is 0.93 to 0.97 in 99 of 100 runs; the sum of a t and a normal in quadrature is wider.
        assert 0.93 <= held / 1000 <= 0.985
    assert repeats_interval([1.0], [(0.5, 2.5)]) == pytest.approx((0.5, 2.5))
    assert repeats_interval([1.0, 1.0], [(0.5, 2.5), (0.5, 2.5)]) == pytest.approx((0.5, 2.5))
    assert repeats_interval([0.1, 0.3], [(0.0, 0.2), (0.2, 0.4)])[0] == 0.0


@pytest.mark.parametrize("count", [2, 3, 5])
def test_engines_that_do_not_differ_are_told_apart_as_often_as_stated_from_few_repeats(count: int) -> None:
    """Scores that differ by their jittered starts alone; draws with replacement are right in 0.51, 0.75 and 0.87."""
    random = np.random.default_rng(5)

    def scores() -> ScoreDraws:
        values = 1.0 + 0.1 * random.standard_normal(count)
        drawn = np.repeat(values[:, None], 500, axis=1)
        return ScoreDraws(seeds=tuple(range(count)), raw=values, raw_draws=drawn, primary=values, primary_draws=drawn)

    alike, held = 0, 0
    for _ in range(400):
        first, second = scores(), scores()
        alike += not paired([GradedExperiment(id="slide", draws=(first, second))]).distinguishable
        low, high = np.quantile(first.mean()[1], (0.025, 0.975))
        held += low <= 1.0 <= high
    # Of 400, a true 95 % gives 0.92 or more in 99 of 100 runs.
    assert alike >= 0.92 * 400
    assert held >= 0.92 * 400


def test_identical_engines_are_never_distinguishable_and_a_large_difference_is() -> None:
    random = np.random.default_rng(11)
    for _ in range(50):
        same, apart = (
            paired([observed(WORLD, errors, align=True, random=random)]) for errors in ((0.02, 0.02), (0.0, 0.2))
        )
        (alike,), (far,) = same.experiments, apart.experiments
        assert (alike.difference, alike.difference_95, same.distinguishable) == (0.0, (0.0, 0.0), False)
        assert (same.probability_of_improvement, same.p) == (0.5, 1.0)
        assert apart.distinguishable
        assert far.difference_95[1] < 0.0
        assert apart.probability_of_improvement > 0.99
