"""Intervals, percentiles and implied parameters of scores, on the bundled real trials."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import gymnasium
import numpy as np
import pytest
from episodes import run_to_end
from scipy.special import betaincinv, stdtrit
from scipy.stats import binomtest, chi2, sem, t as student

from gauge_envs import load_experiment, reference_band
from gauge_envs.backends.registry import backend_for
from gauge_envs.references.band import bundled_band
from gauge_envs.references.published import published_baselines
from gauge_envs.runs.episodes import run_episode, run_episodes
from gauge_envs.runs.request import RunRequest
from gauge_envs.scene.jitter import Jitter
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.scoring.dependence import (
    GROUP_SHARE,
    LAG_MARGIN,
    WIDEST,
    refusal,
    widening,
)
from gauge_envs.scoring.deviation import (
    Deviation,
    percentile_among,
    percentile_interval,
    trial_distances,
)
from gauge_envs.scoring.error_sources import DRAW_COUNT
from gauge_envs.scoring.uncertainty import BELOW_NOISE, band_errors

SLIDES = ("SlopeSlider-2-wood", "SlopeSlider-2-plastic", "SlopeSlider-2-metal")
BALL = "BouncingBall-rubber"
GRAVITY = 9.80665
SLOPE = math.radians(30.0)


@pytest.fixture(scope="module")
def scores():
    return {name: run_episode(RunRequest(name)).score for name in (*SLIDES, BALL)}


# --- what the score shows --------------------------------------------------------------------------------------------


def test_the_aligned_score_prefers_the_real_friction_and_the_raw_one_does_not():
    """Late release cancels excess friction in the raw score."""
    real, wrong = (
        run_episode(RunRequest(SLIDES[0], parameters={"cube.friction": friction})).score
        for friction in (0.257145, 0.282)
    )
    assert (
        real.validation.rmse_normalized,
        real.validation.rmse_aligned_normalized,
    ) == pytest.approx((1.005, 1.24), abs=5e-3)
    assert (
        wrong.validation.rmse_normalized,
        wrong.validation.rmse_aligned_normalized,
    ) == pytest.approx((0.270, 7.09), abs=2e-2)
    assert real.primary == wrong.primary == "rmse_aligned"
    assert real.primary_normalized < wrong.primary_normalized


def test_an_earlier_release_is_simulated_and_not_held(scores):
    """Held at its last frame, the cube would be 12.5 mm away."""
    score = scores["SlopeSlider-2-plastic"]
    assert score.release_offset_s < 0.0
    assert score.rmse_aligned == pytest.approx(6.04, abs=0.05)


@pytest.mark.parametrize("name", SLIDES)
def test_an_aligned_error_is_over_that_of_aligned_trials(scores, name):
    score, band = scores[name], bundled_band(name)
    leave_one_out = []
    for number, trial in enumerate(band.trials):
        mean = np.nanmean(np.delete(band.trials, number, axis=0), axis=0)
        seen = np.isfinite(trial).all(axis=1)
        times_s = np.arange(len(trial))[seen] / 30.0
        near = min(
            np.arange(-0.3, 0.3, 0.01),
            key=partial(_shifted_rmse, times_s, trial[seen], mean),
        )
        shifts = [
            _shifted_rmse(times_s, trial[seen], mean, near + late)
            for late in np.arange(-0.01, 0.01, 2e-5)
        ]
        leave_one_out.append(min(shifts))
    assert (
        score.rmse_aligned / score.validation.rmse_aligned_normalized
        == pytest.approx(np.mean(leave_one_out), rel=0.02)
    )


def _shifted_rmse(times_s, values, mean, shift_s):
    queries_s = np.arange(len(mean)) / 30.0 - shift_s
    usable = (queries_s <= times_s[-1] + 1e-9) & np.isfinite(mean).all(axis=1)
    if usable.sum() < 0.6 * np.isfinite(mean).all(axis=1).sum():
        return np.inf
    moved = np.column_stack(
        [np.interp(queries_s[usable], times_s, column) for column in values.T]
    )
    return float(np.sqrt(np.square(moved - mean[usable]).sum(axis=1).mean()))


@pytest.mark.parametrize(
    ("name", "frames", "share"),
    list(zip(SLIDES, [(9, 19), (8, 17), (9, 19)], [31, 64, 48], strict=True)),
)
def test_extrapolated_frames_and_their_share_of_the_error_are_stated(
    scores, name, frames, share
):
    score = scores[name]
    assert (score.measured_frames, score.compared_frames) == frames
    assert 100.0 * score.extrapolated_share == pytest.approx(share, abs=0.6)


@pytest.mark.parametrize(
    ("name", "median"), list(zip(SLIDES, [0.79, 0.49, 0.85], strict=True))
)
def test_the_median_real_trial_is_not_at_1_and_the_percentile_says_so(name, median):
    distances = trial_distances(bundled_band(name)).raw
    baseline = published_baselines(name)["rmse"].mean
    assert np.median(distances) / baseline == pytest.approx(median, abs=6e-3)
    assert percentile_among(
        distances, float(np.median(distances)) + 1e-9
    ) == pytest.approx(50.0, abs=3.0)
    assert percentile_among(distances, 0.0) == 0.0
    assert percentile_among(distances, 1e9) == 100.0


def test_percentiles_are_those_of_the_real_trials(scores):
    for name, score in scores.items():
        distances = trial_distances(bundled_band(name))
        assert score.validation.percentile == 100.0 * np.mean(
            distances.raw < score.rmse
        )
        assert score.validation.percentile_aligned == 100.0 * np.mean(
            distances.aligned < score.rmse_aligned
        )
        assert (distances.aligned <= distances.raw + 1e-9).all()


def test_published_slide_scores_lie_in_the_interval_of_mujoco(scores):
    inside = [
        scores[name].validation.rmse_normalized_95[0]
        <= published
        <= scores[name].validation.rmse_normalized_95[1]
        for name in SLIDES
        for published in published_baselines(name)["rmse"].engines.values()
    ]
    assert sum(inside) >= 8
    for score in scores.values():
        for value, (low, high) in (
            (score.validation.rmse_normalized, score.validation.rmse_normalized_95),
            (
                score.validation.rmse_aligned_normalized,
                score.validation.rmse_aligned_normalized_95,
            ),
        ):
            assert 0.0 <= low <= value <= high


@pytest.mark.parametrize(
    ("name", "real"), list(zip(SLIDES, [0.257145, 0.236133, 0.270867], strict=True))
)
def test_a_slide_implies_its_friction_and_that_of_the_trials(scores, name, real):
    """The facts fit every listed sample; the band knows the frames that half of the trials show."""
    friction = next(one for one in scores[name].implied if one.parameter == "friction")
    calibrated = load_experiment(name).scene.contacts[0].friction
    assert friction.value == pytest.approx(calibrated, abs=1e-3)
    assert friction.real == pytest.approx(real, abs=1e-3)
    tilt = math.radians(0.3) * (1.0 + real * math.tan(SLOPE))
    assert friction.real_uncertainty == pytest.approx(
        math.hypot(
            tilt, friction.real_scatter / math.sqrt(len(bundled_band(name).trials))
        ),
        rel=1e-2,
    )


def test_a_bounce_implies_its_restitution_and_that_of_the_trials(scores):
    restitution = next(
        one for one in scores[BALL].implied if one.parameter == "restitution"
    )
    assert restitution.value == pytest.approx(0.577, abs=1e-3)
    assert (restitution.real, restitution.real_scatter) == pytest.approx(
        (0.736925, 0.002242), abs=3e-4
    )


def test_a_pendulum_implies_its_period():
    # Both periods are of one course, and a longer step is as good.
    score = run_episode(
        RunRequest("Pendulum-metal", settings={"timestep_s": 1 / 360})
    ).score
    period = next(one for one in score.implied if one.parameter == "period")
    assert period.value == pytest.approx(score.pd_s, rel=1e-3)
    assert (period.real, period.real_scatter) == (1.14, 0.066)


# --- errors of a band ------------------------------------------------------------------------------------------------


def errors_of_trials(trials):
    """Errors of the bouncing ball's band with other trials, their mean, and nothing else uncertain."""
    band = replace(
        bundled_band(BALL), trials=trials, mean=trials.mean(axis=0), uncertainty=None
    )
    return band_errors(band, None)


def moved_trials(steps):
    """Trials of the ball that are moved by as many millimetres along all coordinates."""
    mean = bundled_band(BALL).mean
    return mean + steps[:, None, None] * np.ones_like(mean)


def without_sources(errors, **changes):
    """The same errors without any source."""
    shapes = np.zeros((0, errors.known.size))
    return replace(errors, shapes=shapes, factors=(), sources=(), **changes)


@pytest.mark.parametrize("name", [*SLIDES, BALL])
def test_the_error_of_a_mean_is_a_shift_in_time_and_what_is_left(name):
    """The two add up to the residuals of the trials, and no part of the rest is along the velocity."""
    band = bundled_band(name)
    errors = band_errors(band, published_baselines(name)["rmse"])
    velocity = errors.flat(np.gradient(np.nan_to_num(band.mean), axis=0))
    velocity /= np.linalg.norm(velocity)
    shift, rest = (
        next(errors.shapes[one.columns] for one in errors.sources if one.kind == kind)
        for kind in ("release", "sampling")
    )
    assert np.abs(rest @ velocity).max() < 1e-9 * np.linalg.norm(rest)
    assert shift == pytest.approx(np.outer(shift @ velocity, velocity), abs=1e-9)
    residuals = errors.flat(band.trials - band.mean)
    assert -(shift + rest) == pytest.approx(residuals, abs=1e-9)


def test_two_trials_are_as_far_from_each_other_and_one_from_none():
    band = bundled_band(SLIDES[0])
    pair = band.trials[:2]
    apart = np.square(pair[0] - pair[1]).sum(axis=-1)
    raw = trial_distances(replace(band, trials=pair, mean=pair.mean(axis=0))).raw
    assert raw == pytest.approx(np.sqrt(np.nanmean(apart)) * np.ones(2))
    assert trial_distances(replace(band, trials=pair[:1], mean=pair[0])) is None


@pytest.mark.parametrize("over_baseline", [True, False])
@pytest.mark.parametrize("size_mm", [0.3, 3.0, 30.0])
@pytest.mark.parametrize("name", [SLIDES[0], "SlopeSlider-1-wood"])
def test_intervals_scale_with_the_unit(name, size_mm, over_baseline):
    """Below the noise, about it and above it, against real trials and a law: millimetres and metres say the same."""
    band = reference_band(load_experiment(name))
    errors = band_errors(band, published_baselines(SLIDES[0])["rmse"])
    deviation = size_mm * np.sin(np.arange(band.mean.size)).reshape(band.mean.shape)
    in_metres = replace(errors, shapes=1e-3 * errors.shapes)
    low, high = errors.interval(deviation, over_baseline=over_baseline)
    assert low <= high
    assert in_metres.interval(
        1e-3 * deviation, over_baseline=over_baseline
    ) == pytest.approx((1e-3 * low, 1e-3 * high), rel=1e-6, abs=1e-12)
    if over_baseline:
        drawn = errors.draws(deviation)
        assert in_metres.draws(1e-3 * deviation) == pytest.approx(1e-3 * drawn)


@pytest.mark.parametrize("scatter", [0.0, 0.02, 0.1, 0.6])
@pytest.mark.parametrize("count", [5, 12])
def test_few_alike_trials_count_as_scattered_in_their_number_of_directions(
    count, scatter
):
    """Trials that each deviate along a direction of their own have count - 1 of them about their mean.

    Distances of normal deviations in so many directions scatter by sqrt((pi / 2 - 1) / (count - 1)) of their mean.
    """
    errors = band_errors(reference_band(load_experiment("SlopeSlider-1-wood")), None)
    residuals = np.eye(count, errors.known.size) - 1.0 / count
    residuals[:, count:] = 0.0
    errors = without_sources(errors, trial_count=count).with_source(
        "sampling", residuals, np.zeros((DRAW_COUNT, count))
    )
    steps = np.linspace(-1.0, 1.0, count)
    distances = 3.0 * (1.0 + scatter * steps / steps.std(ddof=1))
    normal = math.sqrt((0.5 * math.pi - 1.0) / (count - 1))
    variance = ((count - 1) * scatter**2 + 10.0 * max(scatter, normal) ** 2) / (
        count - 1 + 10.0
    )
    found = errors.with_baseline(distances)
    expected = math.sqrt(variance) if scatter else 0.0
    assert found.influence.std(ddof=1) == pytest.approx(expected, abs=1e-12)
    assert found.influence.sum() == pytest.approx(0.0, abs=1e-12)
    assert found.baseline_bias == pytest.approx(math.sqrt(count / (count - 1)))


@pytest.mark.parametrize("over_baseline", [True, False])
@pytest.mark.parametrize("size", [0.002, 0.3, 1.0, 2.5, 40.0])
def test_an_interval_along_one_error_follows_from_its_draws(size, over_baseline):
    """A deviation s along an error d, both in units of its scatter, and the baseline measured r times too large.

    The truth is s - d sgn(s - d'), with the next draw d' in place of the unknown one: the root of
    t^2 + 2 t d sgn(s - d') + d^2 = s^2.
    """
    random, scatter = np.random.default_rng(5), 0.7
    errors = band_errors(reference_band(load_experiment("SlopeSlider-1-wood")), None)
    direction = np.sin(np.arange(errors.known.size)).reshape(errors.known.shape)
    direction *= errors.known / np.linalg.norm(errors.flat(direction))
    logarithm, drawn = 0.1 * random.normal(size=DRAW_COUNT), random.normal(size=4000)
    errors = without_sources(
        errors, baseline=logarithm, baseline_bias=1.1, trial_count=0
    ).with_source(
        "start",
        scatter * errors.flat(direction)[None],
        drawn[:, None],
    )
    ratio = 1.1 * np.exp(logarithm) if over_baseline else np.ones(DRAW_COUNT)
    reached = np.mean(drawn**2 <= size**2)
    if reached < BELOW_NOISE:
        low, high = 0.0, np.quantile(np.abs(size - drawn) * ratio, 0.95)
    else:
        truths = (size - drawn[:-1] * np.sign(size - drawn[1:])) * ratio[:-1]
        low = max(np.quantile(truths, 0.025, method="lower"), 0.0)
        high = np.quantile(truths, 1.0 - 0.025 * reached, method="higher")
    found = errors.interval(scatter * size * direction, over_baseline=over_baseline)
    assert np.array(found) / scatter == pytest.approx(
        [min(low, size), max(high, size)], rel=1e-4, abs=1e-9
    )


def test_draws_of_no_deviation_are_less_than_zero_by_what_the_mean_errs():
    """The squares of draws are, on average, the squared deviation less the variance of the mean of the trials."""
    band = bundled_band(BALL)
    steps = np.random.default_rng(4).permutation(22)
    errors = errors_of_trials(moved_trials(steps))
    errors = replace(errors, baseline=np.zeros_like(errors.baseline), baseline_bias=1.0)
    drawn = errors.draws(np.zeros_like(band.mean))
    of_mean = band.mean.shape[1] * steps.var(ddof=1) / 22
    assert np.mean(np.sign(drawn) * drawn**2) == pytest.approx(-of_mean, rel=1e-6)


def test_an_interval_of_a_distance_in_one_direction_is_that_of_student():
    """Along the error of each trial, with a deviation far above its errors and nothing but the trials uncertain."""
    band = bundled_band(BALL)
    trials = moved_trials(np.random.default_rng(4).permutation(22))
    errors = errors_of_trials(trials)
    low, high = errors.interval(np.full_like(band.mean, 1e3), over_baseline=False)
    values = trials[:, 0, 0]
    wider = widening(values)
    half = wider * stdtrit(21, 0.975) * values.std(ddof=1) / math.sqrt(22)
    assert (high - 1e3, 1e3 - low) == pytest.approx((half, half), rel=0.05)


def test_the_effect_of_a_trial_on_the_baseline_is_that_of_its_weight():
    """By its own distance, and by the mean that it moves: here an outlier moves it away from all others."""
    values = np.array([0.1, -0.4, 0.9, -1.3, 0.6, 7.0, -0.8, 0.3])

    def baseline(weights: np.ndarray) -> float:
        return float(weights @ np.abs(values - weights @ values))

    equal = np.full(8, 1.0 / 8.0)
    # Weight that one trial gains, all others lose.
    changes = [
        baseline(0.999 * equal + 0.001 * unit) / baseline(equal) - 1.0
        for unit in np.eye(8)
    ]
    errors = errors_of_trials(moved_trials(values))
    assert errors.influence == pytest.approx(np.array(changes) / 0.001, abs=0.01)


def test_an_exact_simulation_is_as_far_from_trials_as_their_releases_smear_them():
    """A fall that starts at different times has a mean above that of the mean start: half the variance times g."""
    frames_s = np.arange(12) / 30.0
    releases_s = 0.03 * np.array([-1.2, 0.9, -0.5, 1.1, -0.3])
    late_s = 0.1 + releases_s - releases_s.mean()

    def fall(release_s: np.ndarray) -> np.ndarray:
        return (
            500.0
            * GRAVITY
            * np.square(1.0 + frames_s - np.asarray(release_s)[..., None])[..., None]
        )

    trials = fall(late_s)
    band = replace(
        bundled_band(BALL),
        trials=trials,
        mean=trials.mean(axis=0),
        sigma=trials.std(axis=0),
        measured=np.ones(12, dtype=bool),
        uncertainty=None,
    )
    errors = band_errors(band, None)
    velocity = fall(np.array(0.0995)) - fall(np.array(0.1005))
    own = errors.aligned(1e3 * velocity, lambda more_s: fall(0.1 + more_s))
    deviation = fall(np.array(0.1)) - band.mean
    # Along the velocity is a shift; the rest is an offset that no shift takes away.
    flat = own.flat(velocity) / np.linalg.norm(own.flat(velocity))
    offset = (
        500.0 * GRAVITY * releases_s.var() * np.sqrt(1.0 - flat.sum() ** 2 / len(flat))
    )
    vector = own.flat(deviation)
    assert np.linalg.norm(vector - (vector @ flat) * flat) == pytest.approx(
        offset, rel=1e-6
    )
    smear = own.sources[-1]
    assert smear.kind == "smear"
    # Drawn smears, less the observed one, have the law of the variance of five normal numbers.
    squares = np.square(releases_s - releases_s.mean())
    degrees = 4.0 / widening(squares) ** 2
    drawn = own.factors[-1] @ own.shapes[smear.columns]
    sizes = np.sort(
        np.sign(drawn @ (np.ones(12) - flat.sum() * flat))
        * np.linalg.norm(drawn, axis=1)
    )
    for share in (0.1, 0.5, 0.9):
        ratio = 1.25 * degrees / chi2.ppf(1.0 - share, degrees)
        expected = offset * (ratio - 1.0)
        assert sizes[int(share * 4000)] == pytest.approx(
            expected, abs=0.12 * offset * ratio
        )


def test_a_widening_is_that_of_its_definition():
    alternating = np.tile([1.0, -1.0], 10)
    ramp = np.arange(20.0)
    assert widening(alternating) == 1.0
    assert widening(ramp) > WIDEST and "alike" in refusal(ramp)
    assert refusal(np.array([1.0, 2.0])) == "2 trials: an interval needs at least 3"
    assert refusal(np.zeros(0)) is None and widening(np.ones(20)) == 1.0
    random = np.random.default_rng(0)
    drawn = random.standard_normal((2000, 20))
    # Nineteen in twenty of independent samples are widened by less than 2, and few are refused.
    assert np.quantile([widening(one) for one in drawn], 0.95) < 2.0
    assert np.mean([refusal(one) is not None for one in drawn]) < 0.01


@pytest.mark.parametrize("blocks", [0.0, 1.0, 2.0])
def test_a_widening_is_that_of_lags_or_of_groups(blocks):
    """By SciPy's intervals of a mean: of four group means, and of single trials, the first of which are pairs."""
    random = np.random.default_rng(5)
    series = random.permuted(np.arange(22.0)) + blocks * np.repeat(
        [-3.0, 4.0, 3.0, -4.0], [6, 6, 5, 5]
    )
    if blocks == 0.0:
        series = np.repeat(random.permuted(np.arange(11.0)), 2)
    centred = series - np.mean(series)
    lag = np.sum(centred[1:] * centred[:-1]) / np.sum(centred**2)
    lag = np.clip(lag + 1 / 22 + LAG_MARGIN / 22**0.5, 0.0, 0.99)
    means = [np.mean(group) for group in np.split(series, [6, 12, 17])]
    (_, grouped), (_, single) = (
        student.interval(0.95, len(one) - 1, scale=sem(one)) for one in (means, series)
    )
    expected = max(((1 + lag) / (1 - lag)) ** 0.5, GROUP_SHARE * grouped / single)
    assert widening(series) == pytest.approx(expected)
    assert widening(series[:7]) >= 1.0


def test_a_distance_and_its_ratio_to_the_baseline_are_refused_apart():
    """The baseline alone depends on trials that are alike."""
    band = bundled_band(SLIDES[0])
    errors = band_errors(band, published_baselines(SLIDES[0])["rmse"])
    one = Deviation(
        values=np.ones_like(band.mean),
        rmse=1.0,
        errors=replace(errors, influence=1e6 * np.linspace(-1.0, 1.0, 20)),
        baseline=2.0,
    )
    refusal, normalized_refusal = one.refusals
    assert refusal is None and one.interval is not None
    assert "alike" in normalized_refusal and one.normalized_interval is None
    alone = replace(one, baseline=None)
    assert alone.refusals == (None, None) and alone.normalized_interval is None
    assert alone.interval == one.interval


def test_two_trials_have_a_score_without_an_interval_and_say_why():
    score = run_episode(RunRequest("SlopeSlider-2-wood")).score
    assert score.validation.refused == () and score.validation.rmse_95 is not None
    band = bundled_band(SLIDES[0])
    errors = band_errors(
        replace(band, trials=band.trials[:2], mean=band.trials[:2].mean(axis=0)), None
    )
    assert errors.interval(np.ones_like(band.mean)) is None
    assert (
        errors.refusal(np.ones_like(band.mean))
        == "2 trials: an interval needs at least 3"
    )


def test_the_interval_of_a_percentile_of_independent_trials_is_wider_than_that_of_clopper_and_pearson():
    distances = np.random.default_rng(3).permutation(np.arange(1.0, 21.0))
    low, high = percentile_interval(distances, 10.5, (10.5, 10.5))
    exact = binomtest(10, 20).proportion_ci(method="exact")
    count = 20 / widening(distances) ** 2
    assert low <= 100.0 * exact.low and high >= 100.0 * exact.high
    assert (low, high) == pytest.approx(
        (
            100.0 * betaincinv(0.5 * count, 0.5 * count + 1, 0.025),
            100.0 * betaincinv(0.5 * count + 1, 0.5 * count, 0.975),
        )
    )
    assert percentile_interval(distances, 10.5, None) is None
    wide = percentile_interval(distances, 10.5, (1.5, 19.5))
    assert wide[0] < low and wide[1] > high


# --- past the end ----------------------------------------------------------------------------------------------------


def test_an_episode_runs_on_after_its_last_frame_for_the_alignment_alone():
    env = gymnasium.make(
        f"GAUGE/{SLIDES[1]}", render_mode="rgb_array", width=64, height=48
    )
    _, info = run_to_end(env)
    inner = env.unwrapped
    trajectory = inner.trajectory()
    assert info["frame"] == 16 == len(trajectory.frames) - 1
    assert (
        len(trajectory.later_times_s) == 60
        and np.isfinite(trajectory.later_samples).all()
    )
    # The engine alone, without an environment, gives the same motion.
    simulation = backend_for("mujoco", None).build(inner.experiment.scene)
    simulation.reset(0)
    alone = 1e3 * simulation.sample_positions(
        ("cube",), 156, SAMPLE_INTERVAL_S
    ).reshape(156, 3)
    np.testing.assert_array_equal(
        alone, np.concatenate([trajectory.samples, trajectory.later_samples])[1:]
    )
    # Poses stay those of the last frame, so the picture is that of the observation.
    np.testing.assert_allclose(
        1e3 * inner.episode.poses()["cube"][:3], trajectory.samples[-1], atol=1e-9
    )
    assert env.render().shape == (48, 64, 3)
    assert info["score"] == inner.score()


def test_worlds_of_a_vector_environment_score_as_one_alone():
    alone = run_to_end(gymnasium.make(f"GAUGE/{SLIDES[1]}"))[1]["score"]
    envs = gymnasium.make_vec(f"GAUGE/{SLIDES[1]}", num_envs=2)
    envs.reset(seed=0)
    for _ in range(16):
        *_, infos = envs.step([0, 0])
    assert list(infos["score"]) == [alone, alone]


def test_repeats_run_on_too():
    results = run_episodes(RunRequest(SLIDES[1], repeats=2, jitter=Jitter()))
    assert all(len(result.trajectory.later_times_s) == 60 for result in results)
    assert all(result.score.release_offset_s < 0.0 for result in results)


def test_an_experiment_of_a_law_does_not_run_on():
    env = gymnasium.make("GAUGE/SlopeSlider-1-wood")
    run_to_end(env)
    assert not len(env.unwrapped.trajectory().later_times_s)
    assert reference_band(env.unwrapped.experiment).grade == "law"
