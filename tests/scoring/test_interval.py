"""95 % intervals of a distance: Student's closed form, and coverage of the truth over simulated trials."""

import math

import numpy as np
import pytest
from scipy.stats import binom, kurtosis, skew, t as student

from gauge_envs import load_experiment, reference_band
from gauge_envs.scoring.interval import (
    distance_interval,
    distances_without,
    jackknife_interval,
    prediction_limit,
    skewed_t,
    student_t,
    trials_interval,
)
from studies.coverage.intervals import REAL, UNSEEN_SHAPES, World, own, resampled

TIMES_S = np.arange(19) / 30.0


def slides(random, count):
    """Return slides whose release and acceleration scatter [mm], shape [count, T]."""
    late_s = 0.06 + 0.03 * random.standard_normal((count, 1))
    acceleration = 2.7 * (1.0 + 0.025 * random.standard_normal((count, 1)))
    return 500.0 * acceleration * np.square(np.maximum(TIMES_S - late_s, 0.0))


@pytest.mark.parametrize("factor", [0.0, 1.0, 3.0, 10.0])
@pytest.mark.parametrize(("count", "noise_mm"), [(5, 0.0), (20, 4.0)])
def test_intervals_hold_the_distance_from_the_mean_of_infinitely_many_trials(
    count, noise_mm, factor
):
    """An engine is 0 to 10 standard uncertainties off; chance fails one case of 10,000."""
    random, realities = np.random.default_rng(count), 300
    population = slides(random, 10_000)
    spread = float(population.var(axis=0).mean()) + noise_mm**2
    truth = factor * math.sqrt(spread / count)
    engine = population.mean(axis=0) + truth * TIMES_S**2 / np.sqrt(np.mean(TIMES_S**4))
    inside = 0
    for _ in range(realities):
        trials = slides(random, count)
        trials += noise_mm * random.standard_normal(trials.shape)
        deviation = engine - trials.mean(axis=0)
        low, high = trials_interval(deviation[:, None], trials[..., None])
        inside += low <= truth <= high
    assert inside >= binom.ppf(1e-4, realities, 0.92)
    # Far away an interval is not wider than it needs to be.
    assert factor < 10.0 or inside <= binom.ppf(1.0 - 1e-4, realities, 0.98)


def distances(trials):
    """Return the distance of each trial, shape [count, T], from the mean of the others."""
    count = len(trials)
    means = (trials.sum(axis=0) - trials) / (count - 1)
    return np.sqrt(np.mean(np.square(trials - means), axis=1))


def baselines_without(trials):
    """Return the mean distance of the trials without each of them."""
    count = len(trials)
    pairs = trials[:, None] + trials
    others = trials[:, None] - (trials.sum(axis=0) - pairs) / (count - 2)
    sizes = np.sqrt(np.mean(np.square(others), axis=2))
    return (sizes.sum(axis=0) - sizes.diagonal()) / (count - 1)


@pytest.mark.parametrize("factor", [0.3, 3.0, 10.0, 60.0])
@pytest.mark.parametrize("count", [5, 20])
def test_intervals_of_a_normalized_distance_hold_the_ratio_of_the_true_ones(
    count, factor
):
    """Both the distance and the mean distance of real trials, by which it is divided, come from the trials."""
    random, realities = np.random.default_rng(count), 300
    population = slides(random, 10_000)
    baseline = np.mean([distances(slides(random, count)).mean() for _ in range(1000)])
    truth = factor * math.sqrt(float(population.var(axis=0).mean()) / count)
    engine = population.mean(axis=0) + truth * TIMES_S**2 / np.sqrt(np.mean(TIMES_S**4))
    inside = 0
    for _ in range(realities):
        trials = slides(random, count)
        deviation = engine - trials.mean(axis=0)
        distance = math.sqrt(np.mean(np.square(deviation)))
        interval = trials_interval(deviation[:, None], trials[..., None])
        low, high = jackknife_interval(
            distance / distances(trials).mean(),
            np.divide(interval, distance),
            baselines=baselines_without(trials),
            distances=distances_without(deviation[:, None], trials[..., None]),
        )
        inside += low <= truth / baseline <= high
    assert inside >= binom.ppf(1e-4, realities, 0.93)
    assert factor < 10.0 or inside <= binom.ppf(1.0 - 1e-4, realities, 0.98)


def test_the_worlds_of_the_study_have_the_distances_of_the_score():
    band = reference_band(load_experiment("SlopeSlider-2-wood"))
    world = World(band.trials, resampled("SlopeSlider-2-wood").motions)
    assert world.trial_distances == pytest.approx(band.trial_rmse_aligned, abs=1e-6)
    assert world.baselines_without == pytest.approx(band.baselines_without, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_intervals_hold_the_truth_in_worlds_resampled_from_the_real_trials(name):
    """Few trials are far from the others, so worlds without them seem certain; studies/coverage has the shares."""
    _, (of_distance, of_ratio) = resampled(name).coverage(200, seed=3)
    assert min(of_distance.min(), of_ratio.min()) >= binom.ppf(1e-4, 200, 0.90) / 200


@pytest.mark.slow
@pytest.mark.parametrize("count", [5, 20])
@pytest.mark.parametrize("name", [*UNSEEN_SHAPES])
def test_intervals_hold_the_truth_if_trials_scatter_in_another_shape(name, count):
    population = own(name, UNSEEN_SHAPES[name], count)
    _, (of_distance, of_ratio) = population.coverage(200, seed=3)
    assert min(of_distance.min(), of_ratio.min()) >= binom.ppf(1e-4, 200, 0.91) / 200


def test_the_interval_of_skewed_trials_is_longer_on_the_side_of_the_tail():
    """Johnson's t of skewness g and N values: t + g (1 + 2 t^2) / (6 sqrt(N))."""
    sample = np.array([0.0, 0.0, 1.0, 1.0, 1.0, 9.0])
    t = student_t(2.0 / (2.0 / 5.0 + kurtosis(sample) / 6.0))
    longer = 1.5 * skew(sample, bias=False) * (1.0 + 2.0 * t**2) / (6.0 * 6.0**0.5)
    assert skewed_t(sample) == pytest.approx((t, t + longer))
    assert skewed_t(-sample) == pytest.approx((t + longer, t))
    assert skewed_t(np.ones(4)) == (student_t(3), student_t(3))


@pytest.mark.parametrize(
    ("count", "least", "most"), [(5, 0.95, 0.99), (20, 0.93, 0.98), (60, 0.93, 0.97)]
)
def test_one_more_trial_is_within_the_limit_in_95_percent_of_worlds(count, least, most):
    """The limit of fewer than 19 trials is too wide rather than too narrow."""
    random, realities = np.random.default_rng(count), 600
    inside = 0
    for _ in range(realities):
        trials = slides(random, count + 1)
        trials += 4.0 * random.standard_normal(trials.shape)
        known, new = trials[:count], trials[count]
        distance = np.sqrt(np.mean(np.square(new - known.mean(axis=0))))
        inside += distance <= prediction_limit(distances(known))
    assert binom.ppf(1e-4, realities, least) <= inside
    assert inside <= binom.ppf(1.0 - 1e-4, realities, most)


def test_four_trials_predict_no_limit():
    assert prediction_limit(np.arange(1.0, 5.0)) is None


@pytest.mark.parametrize(
    ("offsets", "lag"),
    [([1.0, -1, -2, 2, -2, 1, -1, 2], 0.0), ([-2.0, -1, 1, 2], 0.3 + 0.25)],
)
def test_far_from_trials_that_differ_in_one_direction_the_interval_is_students(
    offsets, lag
):
    """Correlated trials count as fewer, by their AR(1) correlation and its bias 1/N."""
    count = len(offsets)
    trials = np.array(offsets)[:, None, None] * np.ones((count, 5, 1))
    low, high = trials_interval(np.full((5, 1), 1000.0), trials)
    half = student.ppf(0.975, count - 1) * np.std(offsets, ddof=1) / math.sqrt(count)
    half *= math.sqrt((1.0 + lag) / (1.0 - lag))
    assert (1000.0 - low, high - 1000.0) == pytest.approx((half, half), rel=0.01)


def test_zero_is_excluded_where_students_test_excludes_it():
    offsets = np.array([1.0, -1, -2, 2, -2, 1, -1, 2])
    limit = student.ppf(0.975, 7) * offsets.std(ddof=1) / math.sqrt(8)
    trials = offsets[:, None, None] * np.ones((8, 5, 1))
    for factor, is_excluded in ((0.999, False), (1.001, True)):
        deviation = np.full((5, 1), factor * limit)
        assert (trials_interval(deviation, trials)[0] > 0.0) is is_excluded


@pytest.mark.parametrize("coverage", [0.5, 0.95, 0.999])
def test_students_t_is_that_of_scipy(coverage):
    for freedom in (1, 2, 3, 9, 30, 1_000, 100_000):
        expected = student.ppf(0.5 + 0.5 * coverage, freedom)
        assert student_t(freedom, coverage) == pytest.approx(expected, rel=1e-9)


def test_an_error_along_the_velocity_is_removed_by_the_shift():
    offsets = np.array([1.0, -1, -2, 2])[:, None, None]
    along = np.array([[3.0, 0.0], [4.0, 0.0]])
    deviation = np.array([[0.0, 5.0], [0.0, 5.0]])
    interval = trials_interval(deviation, offsets * along, velocity=2.0 * along)
    assert interval == pytest.approx((5.0, 5.0))


def test_unknown_values_and_shared_errors_widen():
    trials = np.random.default_rng(1).standard_normal((9, 6, 2))
    deviation = np.full((6, 2), 3.0)
    low, high = trials_interval(deviation, trials)
    trials[::2, 3:] = np.nan
    fewer = trials_interval(deviation, trials)
    shared = trials_interval(deviation, trials, uncertainty=np.full((6, 2), 1.0))
    assert shared[0] < fewer[0] < low < high < fewer[1] < shared[1]
    # All frames share an error of 1, and trials have no scatter.
    shared = trials_interval(
        np.full((5, 1), 1000.0), np.zeros((4, 5, 1)), uncertainty=np.ones((5, 1))
    )
    half = student.ppf(0.975, 3)
    assert shared == pytest.approx((1000.0 - half, 1000.0 + half), abs=0.01 * half)


def test_an_interval_of_a_given_uncertainty_ends_at_zero():
    assert distance_interval(5.0, 1.0) == pytest.approx((3.04, 6.96))
    assert distance_interval(1.0, 1.0) == pytest.approx((0.0, 2.96))
