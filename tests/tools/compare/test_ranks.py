"""Ranks by paired bootstrap and intervals of means over repeats, against closed forms."""

import numpy as np
import pytest
from gauge_envs.scoring.uncertainty import band_errors
from scipy.stats import t as student

from gauge_envs.references.band import bundled_band
from gauge_envs.tools.compare.draws import (
    ScoreDraws,
    paired_scores,
    repeats_interval,
)
from gauge_envs.tools.compare.grades import (
    NEGLIGIBLE,
    GradedExperiment,
    compare_grade,
)


def scored(*scores, name="exact", scatter=0.0):
    """Scores with independent errors of a standard deviation, by default none."""
    random = np.random.default_rng([7, *name.encode()])
    draws = []
    for score in scores:
        drawn = score + scatter * random.standard_normal((1, 4000))
        value = np.array([score])
        draws.append(ScoreDraws((0,), value, value, drawn, np.zeros((1, 0))))
    return GradedExperiment(id=name, draws=tuple(draws))


def graded(*experiments, constants=None):
    """Comparisons over experiments of one grade."""
    count = len(experiments[0].draws)
    return compare_grade(
        "trials",
        withheld=False,
        experiments=experiments,
        constants=constants or ["calibrated"] * count,
    )


# --- ranks -----------------------------------------------------------------------------------------------------------


def test_ranks_of_exact_scores_are_those_of_the_scores():
    (grade,) = graded(scored(3.0, 1.0, 1.0, 2.0))
    (one,) = grade.experiments
    assert [one.ranks[index].value for index in range(4)] == [4.0, 1.5, 1.5, 3.0]
    assert [one.ranks[index].interval_95 for index in range(4)] == [
        (4, 4),
        (1, 2),
        (1, 2),
        (3, 3),
    ]


def test_a_difference_that_no_table_shows_is_a_tie():
    (grade,) = graded(scored(2.0, 2.0 + 0.9 * NEGLIGIBLE, 2.0 + 1.2 * NEGLIGIBLE))
    (one,) = grade.experiments
    assert [one.ranks[index].interval_95 for index in range(3)] == [
        (1, 2),
        (1, 3),
        (2, 3),
    ]


def test_a_rank_is_one_and_the_chances_that_others_are_closer():
    experiment = scored(1.0, 1.1, 1.2, scatter=0.1)
    (grade,) = graded(experiment)
    drawn = [one.draws[0] for one in experiment.draws]
    for index, score in enumerate(grade.scores):
        chances = 0.0
        for other in range(3):
            if other != index:
                apart = drawn[index] - drawn[other]
                ties = np.mean(np.abs(apart) <= NEGLIGIBLE)
                chances += np.mean(apart > NEGLIGIBLE) + 0.5 * ties
        assert score.mean_rank.value == pytest.approx(1.0 + chances)
        low, high = score.mean_rank.interval_95
        assert 1.0 <= low <= high <= 3.0


def test_a_common_error_of_the_reference_does_not_change_a_rank():
    error = 0.3 * np.random.default_rng(5).standard_normal((1, 4000))
    draws = []
    for score in (1.0, 1.1):
        value = np.array([score])
        draws.append(ScoreDraws((0,), value, value, value + error, np.zeros((1, 0))))
    (grade,) = graded(GradedExperiment(id="slide", draws=tuple(draws)))
    assert [one.mean_rank.interval_95 for one in grade.scores] == [(1, 1), (2, 2)]


def test_one_experiment_with_scores_fifty_times_larger_does_not_decide():
    """The first is closer in three of four; by the mean score, the second would be closer by far."""
    usual = [scored(1.0, 2.0, name=name, scatter=0.05) for name in ("a", "b", "c")]
    (grade,) = graded(*usual, scored(100.0, 50.0, name="d", scatter=0.05))
    first, second = grade.scores
    assert first.mean.value > second.mean.value
    assert [one.configuration for one in grade.ranked] == [0, 1]
    assert first.mean_rank.value == pytest.approx(1.25)


def test_other_constants_are_ranked_apart():
    constants = ("calibrated", "effective", "calibrated", "effective")
    experiment = scored(2.0, 0.2, 1.0, 0.1)
    found = graded(experiment, constants=constants)
    assert [one.name for one in found] == ["trials", "trials, effective"]
    ranks = [
        {one.configuration: one.mean_rank.value for one in grade.scores}
        for grade in found
    ]
    assert ranks == [{0: 2.0, 2: 1.0}, {1: 2.0, 3: 1.0}]


def test_an_experiment_that_one_did_not_score_counts_for_no_mean_rank():
    partial = scored(1.0, 2.0, name="partial")
    partial = GradedExperiment(id="partial", draws=(partial.draws[0], None))
    (grade,) = graded(scored(2.0, 1.0, name="whole"), partial)
    assert grade.ids == ("whole",)
    assert [one.mean_rank.value for one in grade.scores] == [2.0, 1.0]
    assert [one.id for one in grade.experiments] == ["whole", "partial"]


# --- draws -----------------------------------------------------------------------------------------------------------


def test_the_chance_that_one_is_closer_is_that_of_students_test():
    """The difference of two squared distances is linear in the mean, so its test is exact for normal trials."""
    band = bundled_band("SlopeSlider-2-wood")
    errors = band_errors(band, None)
    known = np.isfinite(band.mean).all(axis=1)
    trials = band.trials[:, known]
    shift = 0.05 * (band.trials[3] - band.trials[0])
    first, second = band.mean + 8.0 + shift, band.mean - 8.0
    nearer = np.mean(errors.draws(first - band.mean) < errors.draws(second - band.mean))
    single = np.square(first[known] - trials).sum(axis=(1, 2))
    single -= np.square(second[known] - trials).sum(axis=(1, 2))
    count = len(trials)
    expected = student.cdf(
        -single.mean() / (single.std(ddof=1) / np.sqrt(count)), count - 1
    )
    assert nearer == pytest.approx(expected, abs=0.05)


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
    assert repeats_interval([0.1, 0.3], [(0.0, 0.2), (0.2, 0.4)])[0] == 0.0


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


# --- distances from a solution ---------------------------------------------------------------------------------------


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


def first_is_closer(motions, error):
    """Whether the rank of the first engine is 1 in 95 % of the draws."""
    (grade,) = graded(of_solution(motions, error))
    return grade.scores[0].mean_rank.interval_95 == (1.0, 1.0)


@pytest.mark.parametrize("directions", [1, 30])
@pytest.mark.parametrize("size_in_u", [1.0, 8.0])
def test_engines_that_are_as_far_from_the_solution_rarely_rank_apart(
    directions, size_in_u
):
    """The error has the size u and any number of directions; two engines are off by as much in two of them."""
    random = np.random.default_rng([directions, int(size_in_u)])
    worlds, apart = 200, 0
    for _ in range(worlds):
        basis = np.linalg.qr(random.standard_normal((40, max(directions, 2))))[0]
        error = basis[:, :directions] @ random.standard_normal(directions)
        error /= np.sqrt(directions)
        motions = size_in_u * basis[:, 0], size_in_u * basis[:, 1]
        apart += first_is_closer(motions, error)
    # By chance the first is closer in 2.5 %.
    assert apart / worlds <= 0.025 + 3.0 * np.sqrt(0.025 * 0.975 / worlds)


def test_an_engine_that_solves_the_scene_ranks_before_one_that_is_off_by_6_u():
    random = np.random.default_rng(5)
    basis = np.linalg.qr(random.standard_normal((40, 2)))[0]
    found = []
    for _ in range(100):
        error = basis @ random.standard_normal(2) / np.sqrt(2.0)
        found.append(first_is_closer((np.zeros(40), 6.0 * basis[:, 0]), error))
    # 6 u are told apart where the error along the difference is below 3 u - 1.96 u: its standard deviation is 0.71 u.
    assert np.mean(found) > 0.85
