"""Copies among recorded tosses: what the files name, what the search finds, and planted copies."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import Rotation
from toss_copies import (
    TOLERANCE_M,
    copies,
    height_distances_m,
    placed_distance_m,
    recorded_corners_m,
)

from gauge_envs import load_experiment, reference_band
from gauge_envs.experiments.resolve import with_trial
from gauge_envs.references.single_shot import ShotSidecar, SingleShots, single_shots

CUBE, BLOCKS = "CubeToss-acrylic", "ElbowToss-blocks"
FEW = 24


def shots_of(name: str) -> SingleShots:
    found = single_shots(name)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def corners_m() -> dict[str, list[Any]]:
    return {name: recorded_corners_m(name) for name in (CUBE, BLOCKS)}


def laid_elsewhere(
    corners: Any,
    *,
    turn: Any = None,
    mirrored: bool = False,
    shift_m: Any = (0.3, -0.2, 0.0),
) -> Any:
    """Return a toss that is turned about the vertical or as stated, shifted, and has its corners in another order."""
    turn = Rotation.from_euler("z", 63.0, degrees=True) if turn is None else turn
    moved = (
        corners * [1.0, -1.0 if mirrored else 1.0, 1.0] @ turn.as_matrix().T + shift_m
    )
    return moved[:, np.random.default_rng(0).permutation(moved.shape[1])]


@pytest.mark.parametrize("name", [CUBE, pytest.param(BLOCKS, marks=pytest.mark.slow)])
def test_the_files_name_all_copies(corners_m: dict[str, list[Any]], name: str) -> None:
    assert copies(corners_m[name]) == shots_of(name).copies
    assert len(shots_of(name).copies) == {CUBE: 25, BLOCKS: 0}[name]


def test_independent_trials_are_far_apart(corners_m: dict[str, list[Any]]) -> None:
    """Sorted heights bound the distance from below: no toss is within twenty tolerances of another one."""
    some = [corners_m[CUBE][trial] for trial in shots_of(CUBE).trials()]
    assert height_distances_m(some)[0].min() > 20.0 * TOLERANCE_M


@pytest.mark.parametrize("name", [CUBE, BLOCKS])
@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("late", [0, 5])
def test_a_planted_copy_is_found(
    corners_m: dict[str, list[Any]], name: str, mirrored: bool, late: int
) -> None:
    some = corners_m[name][:FEW]
    planted = laid_elsewhere(some[7], mirrored=mirrored)[late:]
    planted = planted + np.random.default_rng(1).normal(0.0, 1e-5, planted.shape)
    assert copies([*some, planted]) == {FEW: 7}
    assert copies([planted, *some, planted]) == {8: 0, FEW + 1: 0}


def test_other_tosses_are_no_copies(corners_m: dict[str, list[Any]]) -> None:
    some = corners_m[CUBE][:FEW]
    tilted = Rotation.from_euler("x", 2.0, degrees=True)
    for other in (
        laid_elsewhere(some[7], shift_m=(0.0, 0.0, 1e-3)),
        laid_elsewhere(some[7], turn=tilted),
        1.01 * laid_elsewhere(some[7]),
    ):
        assert copies([*some, other]) == {}


def test_equal_heights_of_different_motions_are_refused(
    corners_m: dict[str, list[Any]],
) -> None:
    some = corners_m[CUBE][:FEW]
    # A motion that spins about the vertical has the same heights.
    turns = Rotation.from_rotvec(
        np.outer(0.02 * np.arange(len(some[7])), [0.0, 0.0, 1.0])
    ).as_matrix()
    spun = np.einsum("tij,tvj->tvi", turns, some[7])
    assert placed_distance_m(some[7], spun) > 1e-2
    with pytest.raises(ValueError, match="tosses 7 and 24 have equal heights, but are"):
        copies([*some, spun])


def test_trials_of_a_half_are_independent() -> None:
    shots = shots_of(CUBE)
    fit, judge = set(shots.trials("fit")), set(shots.trials("judge"))
    assert (len(shots), len(shots.trials()), len(fit), len(judge)) == (
        499,
        474,
        238,
        236,
    )
    assert fit | judge == set(shots.trials()) == set(range(499)) - set(shots.copies)
    assert {trial % 2 for trial in fit} == {0}
    # Parts of a half keep their tosses, less the copies.
    assert set(shots.trials("judge", every=10)) == set(range(1, 499, 20)) & judge
    # Numbers and recordings of the data set stay, those of the copies too.
    assert (shots.shot(49).source_number, shots.shot(123).source_number) == (56, 140)


def test_seeds_select_independent_trials_and_a_copy_says_so() -> None:
    shots = shots_of(CUBE)
    env = gymnasium.make(f"GAUGE/{CUBE}")
    assert [env.reset(seed=seed)[1]["trial"] for seed in (122, 123, 473, 474)] == [
        122,
        124,
        498,
        0,
    ]
    assert env.reset(options={"trial": 123})[1]["trial"] == 123
    env.close()
    experiment = load_experiment(CUBE)
    sources = [
        getattr(reference_band(with_trial(experiment, trial)), "source", "")
        for trial in (49, 123)
    ]
    assert sources[0].startswith(f"trial 49 of {shots.sidecar.source}")
    assert sources[1].startswith("trial 123 (the same recording as trial 49) of ")


@pytest.mark.parametrize(
    "wrong",
    [[(5, 7)], [(7, 7)], [(499, 3)], [(7, 3), (9, 7)], [(7, 3), (7, 4)]],
    ids=lambda pairs: str(pairs),
)
def test_wrong_copies_are_refused(wrong: list[tuple[int, int]]) -> None:
    values = shots_of(CUBE).sidecar.model_dump()
    listed = [{"trial": trial, "of": of} for trial, of in wrong]
    with pytest.raises(
        ValidationError,
        match="copies: each trial once, of an earlier one that is no copy",
    ):
        ShotSidecar.model_validate(values | {"copies": listed})
