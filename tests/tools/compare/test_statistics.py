"""Intervals of differences and ranks, against closed forms and simulated worlds."""

import numpy as np
import pytest

from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.tools.compare.ranks import (
    NEGLIGIBLE,
    compare_kind,
    rank_deviations,
)
from gauge_envs.tools.compare.statistics import (
    Deviations,
    difference_interval,
    repeats_interval,
)

FRAMES = 40
WORLDS = 600
AXIS = np.full((FRAMES, 3), [1.0, 0.0, 0.0])


def band_of(mean, *, kind=Kind.TRIALS, trials=None, u=None):
    """Return a reference with three coordinates."""
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
        given_uncertainty=u,
    )


def deviations(band, *motions, seeds=None):
    apart = [motion - band.mean for motion in motions]
    return Deviations.of(
        band, apart, seeds or range(len(apart)), scale=1.0, is_aligned=False
    )


def scored(*scores, u=0.0):
    """Return configurations at these distances along one axis from a reference with standard uncertainty u."""
    band = band_of(0.0 * AXIS, kind=Kind.ANALYTIC, u=u)
    known = {index: score for index, score in enumerate(scores) if score is not None}
    return {key: deviations(band, score * AXIS) for key, score in known.items()}


def kinds_of(experiments, constants):
    ranks = {
        name: rank_deviations(known, constants) for name, known in experiments.items()
    }
    return compare_kind(Kind.ANALYTIC, ranks, constants)


def ranks(experiment, count):
    (kind,) = kinds_of({"exact": experiment}, ["published"] * count)
    (places,) = kind.ranks.values()
    return [places[index].interval_95 for index in range(count)]


def test_ranks_differ_only_for_resolved_differences():
    near = 1.0 + 0.9 * NEGLIGIBLE
    assert ranks(scored(3.0, near, 1.0, near), 4) == [(4, 4), (1, 3), (1, 3), (1, 3)]
    # 2 is closer than 1 if the error exceeds 1.5 u, with a probability of 7 %.
    assert ranks(scored(1.0, 2.0, 6.0, u=1.0), 3) == [(1, 2), (1, 2), (3, 3)]


def test_experiments_have_equal_weight_and_constants_are_ranked_apart():
    usual = dict.fromkeys(("a", "b", "c"), scored(1.0, 2.0))
    others = {"d": scored(100.0, 50.0), "exact": scored(9.0, None)}
    (kind,) = kinds_of(usual | others, ["published"] * 2)
    # Scores fifty times larger do not decide, and an experiment without a score does not count.
    assert kind.ids == ("a", "b", "c", "d")
    assert [mean.value for mean in kind.mean_ranks.values()] == [1.25, 1.75]
    constants = ("published", "measured", "published", "measured")
    kinds = kinds_of({"exact": scored(2.0, 0.2, 1.0, 0.1)}, constants)
    assert [kind.name for kind in kinds] == ["analytic", "analytic, measured"]
    best = [
        min(kind.mean_ranks, key=lambda at: kind.mean_ranks[at].value) for kind in kinds
    ]
    assert best == [2, 3]


@pytest.mark.parametrize(
    ("count", "correlation", "min_coverage"),
    [(5, 0.0, 0.92), (20, 0.0, 0.92), (20, 0.6, 0.84)],
)
def test_the_interval_of_a_difference_covers_the_true_difference(
    count, correlation, min_coverage
):
    """Two fixed simulations of a fall are compared; trials scatter in their release and sideways."""
    random = np.random.default_rng([count, int(10 * correlation)])
    times_s = np.arange(FRAMES)[:, None] / 30
    fall_mm = -4905.0 * np.square(times_s) * [0.0, 0.3, 1.0]
    velocity_mm_per_s = np.gradient(fall_mm, times_s[:, 0], axis=0)
    modes = np.array([0.004 * velocity_mm_per_s, 5.0 * AXIS])
    motions = fall_mm + 8.0 * AXIS, 0.98 * fall_mm + 30.0 * AXIS
    true = [np.linalg.norm(motion - fall_mm) / FRAMES**0.5 for motion in motions]
    covered = 0
    for _ in range(WORLDS):
        weights = random.standard_normal((count, 2))
        for place in range(1, count):
            weights[place] *= np.sqrt(1.0 - correlation**2)
            weights[place] += correlation * weights[place - 1]
        trials = fall_mm + np.einsum("nk,ktc->ntc", weights, modes)
        band = band_of(trials.mean(axis=0), trials=trials)
        first, second = (deviations(band, motion) for motion in motions)
        low, high = difference_interval(first, second)
        covered += low <= true[0] - true[1] <= high
    # The coverage of correlated trials is lower, as in the interval of a single score. It may exceed 95 %: both motions
    # deviate to one side, where an error of the mean changes the difference of squares and the sum alike.
    assert min_coverage <= covered / WORLDS <= 0.995


def test_engines_at_equal_distance_from_a_solution_are_rarely_resolved():
    """The error of the solution has the size u and any direction. A distance of 8 u differs from an exact motion."""
    random = np.random.default_rng(5)
    apart, resolved = 0, 0
    for _ in range(300):
        basis = np.linalg.qr(random.standard_normal((3 * FRAMES, 4)))[0]
        basis = np.sqrt(FRAMES) * basis.T.reshape(-1, FRAMES, 3)
        error = random.standard_normal() * basis[0]
        band = band_of(error, kind=Kind.NUMERICAL, u=1.0)
        first, second, exact = (
            deviations(band, motion)
            for motion in (8.0 * basis[0], 8.0 * basis[1], 0.0 * basis[0])
        )
        low, high = difference_interval(first, second)
        apart += low > 0.0 or high < 0.0
        resolved += difference_interval(first, exact)[0] > 0.0
    assert apart / 300 <= 0.05 + 3.0 * np.sqrt(0.05 * 0.95 / 300)
    assert resolved / 300 > 0.9


def test_repeats_are_paired_by_seed_and_their_scatter_counts():
    band = band_of(0.0 * AXIS, kind=Kind.ANALYTIC, u=0.0)
    ours = deviations(band, AXIS, 2.0 * AXIS, 3.0 * AXIS, seeds=[1, 2, 3])
    theirs = deviations(band, 2.5 * AXIS, 3.5 * AXIS, seeds=[2, 3])
    assert difference_interval(ours, theirs) == pytest.approx((-0.5, -0.5))
    unpaired = deviations(band, 2.5 * AXIS, 3.5 * AXIS, seeds=[8, 9])
    low, high = difference_interval(ours, unpaired)
    assert (low + high) / 2 == pytest.approx(-1.0)
    # Student's t of two and three repeats, in quadrature: 12.706 sqrt(0.5 / 2) and 4.303 sqrt(1 / 3).
    assert (high - low) / 2 == pytest.approx(
        np.hypot(12.706 * 0.5, 4.303 / 3**0.5), rel=1e-3
    )


def test_the_interval_of_a_mean_over_repeats_covers_the_true_mean():
    random = np.random.default_rng(8)
    for count, shared, single in [(4, 0.1, 0.1), (3, 0.02, 0.2), (8, 0.2, 0.05)]:
        covered = 0
        for _ in range(1000):
            scores = 2.0 + shared * random.standard_normal()
            scores = scores + single * random.standard_normal(count)
            ends = [(score - 1.96 * shared, score + 1.96 * shared) for score in scores]
            low, high = repeats_interval([*scores], ends)
            covered += low <= 2.0 <= high
        # A true 95 % of 1000 is 0.93 to 0.97 in 99 of 100 runs; the sum of a t and a normal in quadrature is wider.
        assert 0.93 <= covered / 1000 <= 0.985
    assert repeats_interval([1.0], [(0.5, 2.5)]) == pytest.approx((0.5, 2.5))
    assert repeats_interval([0.1, 0.3], [(0.0, 0.2), (0.2, 0.4)])[0] == 0.0
