"""Differences of two simulated engines whose truth is known, and means over experiments against closed forms."""

import numpy as np
import pytest
from scipy.stats import t as student
from simulated_trials import (
    Slide,
    World,
    align,
    aligned_errors,
    band_of,
    leave_one_out,
)

from gauge_envs.evaluation.error_sources import DRAW_COUNT
from gauge_envs.evaluation.uncertainty import band_errors
from gauge_envs.tools.compare.draws import (
    ScoreDraws,
    paired_scores,
    repeats_interval,
)
from gauge_envs.tools.compare.grades import (
    GradedExperiment,
    compare_grade,
    compare_pairs,
)

TRIAL_COUNT = 20


def slides(errors, **motion):
    """Slides whose release hides some of an excess friction, and engines with a friction error each."""
    return World(
        motion=Slide(**{"release_s": 0.03, **motion}), engine_errors=tuple(errors)
    )


def true_scores(world, *, aligned):
    kind = "aligned" if aligned else "raw"
    return [
        world.truth.ratio(kind, engine) for engine in range(len(world.engine_errors))
    ]


def observed(world, *, aligned, random, name="slide"):
    """One experimenter's scores of engines against the mean of 20 trials."""
    trials = world.trials(random, 1, TRIAL_COUNT)
    band = band_of(trials[0])
    of_band = band_errors(band, None)
    order = np.random.default_rng([*name.encode()]).permutation(DRAW_COUNT)
    baseline = float(
        np.sqrt(np.mean(np.square(trials - trials.mean(axis=1)), axis=-1)).mean()
    )
    distances = leave_one_out(trials)[1][0] if aligned else np.zeros(0)
    draws, intervals = [], []
    for engine in range(len(world.engine_errors)):
        deviation, own = (
            world.engine(engine, np.zeros(()))[:, None] - band.mean,
            of_band,
        )
        if aligned:
            shifted, velocities, shifts_s = align(world, engine, band.mean.T)
            deviation = shifted.T
            own = aligned_errors(
                world, engine, of_band, velocities, shifts_s, 0
            ).with_baseline(distances)
            baseline = float(distances.mean())
        score = np.array([np.linalg.norm(own.flat(deviation))]) / baseline
        drawn = own.draws(deviation)[None, order] / baseline
        influences = own.influences(deviation)[None] / baseline
        draws.append(ScoreDraws((0,), score, score, drawn, influences))
        ends = own.interval(deviation)
        intervals.append(
            None if ends is None else (ends[0] / baseline, ends[1] / baseline)
        )
    return GradedExperiment(
        id=name, draws=tuple(draws), intervals=tuple(intervals), trial_count=TRIAL_COUNT
    )


def paired(experiments):
    (pair,) = compare_pairs(experiments, [(0, 1)])
    return pair


@pytest.mark.parametrize(
    ("error", "aligned"),
    [pytest.param(0.0, True, marks=pytest.mark.slow), (0.01, False)],
)
def test_the_interval_of_a_mean_over_one_experiment_is_that_of_the_score_and_holds_it(
    error, aligned
):
    world = slides([error])
    (truth,) = true_scores(world, aligned=aligned)
    random = np.random.default_rng(3)
    held = 0
    for _ in range(150):
        one = observed(world, aligned=aligned, random=random)
        (grade,) = compare_grade("trials", withheld=False, experiments=[one])
        (score,) = grade.scores
        assert score.mean is not None and one.intervals[0] in (
            None,
            score.mean.interval_95,
        )
        held += (
            one.intervals[0] is None
            or score.mean.interval_95[0] <= truth <= score.mean.interval_95[1]
        )
    # Of 150 realities, a true 95 % gives at least 0.91 in 98 of 100 runs.
    assert held >= 0.91 * 150


def test_the_interval_of_a_mean_over_repeats_holds_the_true_mean():
    random = np.random.default_rng(8)
    for count, shared, own in [(4, 0.1, 0.1), (3, 0.02, 0.2), (8, 0.2, 0.05)]:
        held = 0
        for _ in range(1000):
            scores = (
                2.0
                + shared * random.standard_normal()
                + own * random.standard_normal(count)
            )
            low, high = repeats_interval(
                [*scores],
                [(one - 1.96 * shared, one + 1.96 * shared) for one in scores],
            )
            held += low <= 2.0 <= high
        # A true 95 % of 1000 is 0.93 to 0.97 in 99 of 100 runs; the sum of a t and a normal in quadrature is wider.
        assert 0.93 <= held / 1000 <= 0.985
    assert repeats_interval([1.0], [(0.5, 2.5)]) == pytest.approx((0.5, 2.5))
    assert repeats_interval([1.0, 1.0], [(0.5, 2.5), (0.5, 2.5)]) == pytest.approx(
        (0.5, 2.5)
    )
    assert repeats_interval([0.1, 0.3], [(0.0, 0.2), (0.2, 0.4)])[0] == 0.0


@pytest.mark.parametrize("count", [2, 3, 5])
def test_engines_that_do_not_differ_are_told_apart_as_often_as_stated_from_few_repeats(
    count,
):
    """Scores that differ by their jittered starts alone; draws with replacement are right in 0.51, 0.75 and 0.87."""
    random = np.random.default_rng(5)

    def scores():
        values = 1.0 + 0.1 * random.standard_normal(count)
        drawn = np.repeat(values[:, None], 500, axis=1)
        none = np.zeros((count, 0))
        return ScoreDraws(tuple(range(count)), values, values, drawn, none)

    alike, held = 0, 0
    for _ in range(400):
        first, second = scores(), scores()
        alike += not paired(
            [GradedExperiment(id="slide", draws=(first, second))]
        ).distinguishable
        low, high = np.quantile(first.mean()[1], (0.025, 0.975))
        held += low <= 1.0 <= high
    # Of 400, a true 95 % gives 0.92 or more in 99 of 100 runs.
    assert alike >= 0.92 * 400
    assert held >= 0.92 * 400


def test_many_repeats_scatter_as_their_mean_does():
    """500 repeats of which 20 are drawn: an error of the reference of 0.2, and a scatter of 3 over the root of 500."""
    random = np.random.default_rng(7)
    values = 5.0 + 3.0 * random.standard_normal(500)
    error = 0.2 * random.standard_normal(4000)
    none = np.zeros((20, 0))

    def scores(values):
        drawn = values[:20, None] + error
        return ScoreDraws(tuple(range(500)), values, values, drawn, none)

    mean, draws = scores(values).mean()
    assert mean == pytest.approx(values.mean())
    assert draws.mean() == pytest.approx(mean, abs=0.02)
    expected = np.hypot(0.2, values.std(ddof=1) / np.sqrt(500))
    assert draws.std() == pytest.approx(expected, rel=0.04)
    # The same starts and the same reference: neither scatters in a difference.
    (_, first), (_, second) = paired_scores(scores(values), scores(values + 0.1))
    assert second - first == pytest.approx(0.1, abs=1e-9)


@pytest.mark.slow
def test_the_interval_of_a_mean_of_resolved_scores_holds_the_true_one():
    worlds = (
        slides([0.03]),
        slides([0.03], constant=0.3, release_s=0.05),
        slides([0.03], constant=0.2, release_s=0.02),
        slides([0.03], constant=0.25, release_std_s=0.02),
    )
    truth = float(np.mean([true_scores(world, aligned=True) for world in worlds]))
    random, held = np.random.default_rng(5), 0
    for _ in range(200):
        experiments = [
            observed(world, aligned=True, random=random, name=f"slide {number}")
            for number, world in enumerate(worlds)
        ]
        (grade,) = compare_grade("trials", withheld=False, experiments=experiments)
        mean = grade.scores[0].mean
        held += mean.interval_95[0] <= truth <= mean.interval_95[1]
    assert held >= 0.91 * 200


def test_the_sign_of_a_difference_is_that_of_students_test():
    """The difference of two squared distances is linear in the mean, so its test is exact for normal trials."""
    random = np.random.default_rng(2)
    world = slides([0.03, 0.01])
    for count in (5, 12):
        drawn = world.trials(random, 1, count)[0]
        errors = band_errors(band_of(drawn), None)
        first, second = (world.engine(one, np.zeros(()))[:, None] for one in (0, 1))
        mean = drawn.mean(axis=0)[:, None]
        nearer = np.mean(errors.draws(first - mean) < errors.draws(second - mean))
        single = np.square(first[:, 0] - drawn).sum(axis=1) - np.square(
            second[:, 0] - drawn
        ).sum(axis=1)
        # A one-sided test of single trials' differences has the same mean and Student's law.
        expected = student.cdf(
            -single.mean() / (single.std(ddof=1) / np.sqrt(count)), count - 1
        )
        assert 0.01 < expected < 0.99
        assert nearer == pytest.approx(expected, abs=0.03)


def test_trials_that_drift_tell_no_engines_apart():
    """The same trials in another order do; their scores have no interval in the order of the drift."""
    world = slides([0.06, -0.06])
    drift = np.linspace(-1.0, 1.0, TRIAL_COUNT)
    verdicts = []
    for order in (
        np.arange(TRIAL_COUNT),
        np.random.default_rng(4).permutation(TRIAL_COUNT),
    ):
        constant, release_s = 0.257 + 0.008 * drift[order], 0.03 + 0.03 * drift[order]
        trials = world.motion.positions_mm(constant, release_s, np.zeros(TRIAL_COUNT))
        errors, mean = band_errors(band_of(trials), None), trials.mean(axis=0)[:, None]
        draws, refused = [], []
        for engine in (0, 1):
            deviation = world.engine(engine, np.zeros(()))[:, None] - mean
            refused.append(errors.interval(deviation) is None)
            score, drawn = (
                np.array([np.linalg.norm(errors.flat(deviation))]),
                errors.draws(deviation)[None],
            )
            influences = errors.influences(deviation)[None]
            draws.append(ScoreDraws((0,), score, score, drawn, influences))
        pair = paired(
            [GradedExperiment(id="slide", draws=tuple(draws), trial_count=TRIAL_COUNT)]
        )
        verdicts.append((all(refused), pair.distinguishable))
    assert verdicts == [(True, False), (False, True)]


# --- distances from a solution ---


def of_solution(motions, error):
    """Return engines that are observed against a solution with an error, in units of u, shape [entry_count] each."""
    draws = []
    for motion in motions:
        deviation = (motion - error)[None]
        distance = np.linalg.norm(deviation, axis=1)
        errors = np.random.default_rng(3).standard_normal(4000)
        drawn = np.maximum(distance[:, None] + errors, 0.0)
        draws.append(
            ScoreDraws(
                (0,), distance, distance, drawn, np.zeros((1, 0)), deviation, errors
            )
        )
    return GradedExperiment(id="solved", draws=tuple(draws), scale_unit="u")


@pytest.mark.parametrize("directions", [1, 30])
@pytest.mark.parametrize("size_in_u", [1.0, 8.0])
def test_engines_that_are_as_far_from_the_solution_are_rarely_told_apart(
    directions, size_in_u
):
    """The error has the size u and any number of directions; two engines are off by as much in two of them."""
    random = np.random.default_rng([directions, int(size_in_u)])
    worlds, apart = 400, 0
    for _ in range(worlds):
        basis = np.linalg.qr(random.standard_normal((40, max(directions, 2))))[0]
        error = basis[:, :directions] @ random.standard_normal(directions)
        error /= np.sqrt(directions)
        motions = size_in_u * basis[:, 0], size_in_u * basis[:, 1]
        (pair,) = compare_pairs([of_solution(motions, error)], [(0, 1)])
        apart += pair.experiments[0].p < 0.05
    assert apart / worlds <= 0.05 + 3.0 * np.sqrt(0.05 * 0.95 / worlds)


def test_an_engine_that_solves_the_scene_is_told_from_one_that_is_off_by_6_u():
    random = np.random.default_rng(5)
    basis = np.linalg.qr(random.standard_normal((40, 2)))[0]
    found = []
    for _ in range(100):
        error = basis @ random.standard_normal(2) / np.sqrt(2.0)
        motions = np.zeros(40), 6.0 * basis[:, 0]
        (pair,) = compare_pairs([of_solution(motions, error)], [(0, 1)])
        found.append(pair.experiments[0].p < 0.05 and pair.closer == 0)
    # 6 u are told apart where the error along the difference is below 3 u - 1.96 u: its standard deviation is 0.71 u.
    assert np.mean(found) > 0.85
