"""Differences of two configurations and their ranks, against closed forms and simulated worlds."""

import numpy as np
import pytest

from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.tools.compare.difference import (
    Deviations,
    difference_interval,
    repeats_interval,
)
from gauge_envs.tools.compare.ranks import (
    NEGLIGIBLE,
    ScoredExperiment,
    compare_kind,
)

FRAMES = 40
WORLDS = 1000


def band_of(mean, *, kind=Kind.TRIALS, trials=None, u=None):
    """A reference with three coordinates."""
    return Band(
        kind=kind,
        unit="mm",
        coordinates=("x", "y", "z"),
        projection=np.eye(3),
        mean=mean,
        sigma=np.ones_like(mean),
        measured=np.ones(len(mean), dtype=bool),
        source="a simulated world",
        trials=trials,
        trial_count=None if trials is None else len(trials),
        stated_uncertainty=u,
    )


def deviations(band, *motions, seeds=None):
    apart = [one - band.mean for one in motions]
    return Deviations.of(band, apart, seeds or range(len(apart)), scale=1.0)


def scored(*scores, name="exact", u=0.0):
    """Configurations off by these distances along one axis, against a reference with a standard uncertainty."""
    band = band_of(np.zeros((FRAMES, 3)), kind=Kind.ANALYTIC, u=u)
    found = [
        None if score is None else deviations(band, np.full((FRAMES, 3), [score, 0, 0]))
        for score in scores
    ]
    nothing = (None,) * len(found)
    return ScoredExperiment(id=name, deviations=tuple(found), intervals=nothing)


def compared(*experiments, constants=None):
    count = len(experiments[0].deviations)
    return compare_kind("analytic", experiments, constants or ["calibrated"] * count)


def test_ranks_are_those_of_scores_whose_differences_are_resolved():
    (kind,) = compared(scored(3.0, 1.0, 1.0 + 0.9 * NEGLIGIBLE, 2.0))
    (one,) = kind.experiments
    assert [one.ranks[index].value for index in range(4)] == [4.0, 1.5, 1.5, 3.0]
    ends = [one.ranks[index].interval_95 for index in range(4)]
    assert ends == [(4, 4), (1, 2), (1, 2), (3, 3)]
    # Whether 1 or 2 is closer hangs on whether the error exceeds 1.5 u, which has a chance of 7 %.
    (kind,) = compared(scored(1.0, 2.0, 6.0, u=1.0))
    ends = [kind.experiments[0].ranks[index].interval_95 for index in range(3)]
    assert ends == [(1, 2), (1, 2), (3, 3)]


def test_constants_and_experiments_that_one_did_not_score_are_apart():
    usual = [scored(1.0, 2.0, name=name) for name in ("a", "b", "c")]
    (kind,) = compared(*usual, scored(100.0, 50.0, name="d"), scored(9.0, None))
    first, second = kind.scores
    # One experiment with scores fifty times larger does not decide, and one that lacks a score does not count.
    assert kind.ids == ("a", "b", "c", "d")
    assert first.mean.value > second.mean.value
    assert [one.configuration for one in kind.ranked] == [0, 1]
    assert first.mean_rank.value == pytest.approx(1.25)
    constants = ("calibrated", "effective", "calibrated", "effective")
    found = compared(scored(2.0, 0.2, 1.0, 0.1), constants=constants)
    assert [one.name for one in found] == ["analytic", "analytic, effective"]
    ranks = [
        {one.configuration: one.mean_rank.value for one in kind.scores}
        for kind in found
    ]
    assert ranks == [{0: 2.0, 2: 1.0}, {1: 2.0, 3: 1.0}]


@pytest.mark.parametrize("count", [5, 10, 20])
@pytest.mark.parametrize(("correlation", "least"), [(0.0, 0.92), (0.3, 0.87)])
@pytest.mark.parametrize("second", ["close", "far", "slow"])
def test_the_interval_of_a_difference_covers_the_true_one(
    count, correlation, least, second
):
    """Two fixed simulations of a fall; trials scatter in their release and sideways, consecutive ones alike or not."""
    random = np.random.default_rng([count, int(10 * correlation), len(second)])
    times_s = np.arange(FRAMES)[:, None] / 30
    fall_mm = -4905.0 * np.square(times_s) * [0.0, 0.3, 1.0]
    velocity_mm_per_s = np.gradient(fall_mm, times_s[:, 0], axis=0)
    side = np.broadcast_to([1.0, 0.0, 0.0], fall_mm.shape)
    modes = np.array([0.004 * velocity_mm_per_s, 5.0 * side])
    motions = fall_mm + 8.0 * side, fall_mm + {
        "close": 8.3 * side,
        "far": 30.0 * side - 0.02 * fall_mm,
        "slow": 0.004 * fall_mm,
    }[second]  # fmt: skip
    true = [np.square(one - fall_mm).sum() / FRAMES for one in motions]
    held = 0
    for _ in range(WORLDS):
        weights = random.standard_normal((count, 2))
        for place in range(1, count):
            weights[place] *= np.sqrt(1.0 - correlation**2)
            weights[place] += correlation * weights[place - 1]
        trials = fall_mm + np.einsum("nk,ktc->ntc", weights, modes)
        band = band_of(trials.mean(axis=0), trials=trials)
        one, other = (deviations(band, motion) for motion in motions)
        sum_mm = one.scores[0] + other.scores[0]
        low, high = difference_interval(one, other)
        held += low <= (true[0] - true[1]) / sum_mm <= high
    # Trials that are like the one before cover less, as in the interval of a single score.
    assert least <= held / WORLDS <= 0.98


def test_engines_as_far_from_a_solution_are_rarely_told_apart():
    """The error of the solution has the size u and any direction; an engine that is 8 u off is told from none."""
    random = np.random.default_rng(5)
    apart, found = 0, 0
    for _ in range(300):
        basis = np.linalg.qr(random.standard_normal((3 * FRAMES, 4)))[0]
        basis = np.sqrt(FRAMES) * basis.T.reshape(-1, FRAMES, 3)
        error = random.standard_normal() * basis[0]
        band = band_of(error, kind=Kind.NUMERICAL, u=1.0)
        one, two, solved = (
            deviations(band, motion)
            for motion in (8.0 * basis[0], 8.0 * basis[1], 0.0 * basis[0])
        )
        low, high = difference_interval(one, two)
        apart += low > 0.0 or high < 0.0
        found += difference_interval(one, solved)[0] > 0.0
    assert apart / 300 <= 0.05 + 3.0 * np.sqrt(0.05 * 0.95 / 300)
    assert found / 300 > 0.9


def test_repeats_are_paired_by_seed_and_their_scatter_counts():
    band = band_of(np.zeros((FRAMES, 3)), kind=Kind.ANALYTIC, u=0.0)
    axis = np.full((FRAMES, 3), [1.0, 0.0, 0.0])
    ours = deviations(band, 1.0 * axis, 2.0 * axis, 3.0 * axis, seeds=[1, 2, 3])
    theirs = deviations(band, 2.5 * axis, 3.5 * axis, seeds=[2, 3])
    assert difference_interval(ours, theirs) == pytest.approx((-0.5, -0.5))
    others = deviations(band, 2.5 * axis, 3.5 * axis, seeds=[8, 9])
    low, high = difference_interval(ours, others)
    assert (low + high) / 2 == pytest.approx(-1.0)
    assert high - low > 5.0


def test_the_interval_of_a_mean_over_repeats_holds_the_true_mean():
    random = np.random.default_rng(8)
    for count, shared, own in [(4, 0.1, 0.1), (3, 0.02, 0.2), (8, 0.2, 0.05)]:
        held = 0
        for _ in range(1000):
            scores = 2.0 + shared * random.standard_normal()
            scores = scores + own * random.standard_normal(count)
            low, high = repeats_interval(
                [*scores],
                [(one - 1.96 * shared, one + 1.96 * shared) for one in scores],
            )
            held += low <= 2.0 <= high
        # A true 95 % of 1000 is 0.93 to 0.97 in 99 of 100 runs; the sum of a t and a normal in quadrature is wider.
        assert 0.93 <= held / 1000 <= 0.985
    assert repeats_interval([1.0], [(0.5, 2.5)]) == pytest.approx((0.5, 2.5))
    assert repeats_interval([0.1, 0.3], [(0.0, 0.2), (0.2, 0.4)])[0] == 0.0
