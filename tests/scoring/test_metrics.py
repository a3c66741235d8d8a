"""Distances of the paper (RMSE, DTW), time shift and scatter, against hand numbers and a textbook recursion."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from gauge_envs.errors import ShapeError
from gauge_envs.scoring.metrics import (
    MAX_TIME_OFFSET_S,
    frame_index,
    interpolated,
    time_offset,
    trajectory_dtw,
    trajectory_rmse,
)

FRAMES_S = np.arange(31) / 30


def test_rmse_is_the_root_mean_square_over_frames_that_were_measured():
    real = np.array([[0.0, np.nan], [np.nan, np.nan], [0.0, 0.0]])
    simulated = np.array([[3.0, 100.0], [100.0, 100.0], [3.0, 4.0]])
    assert trajectory_rmse(simulated, real) == pytest.approx(math.sqrt((9 + 25) / 2))


@pytest.mark.parametrize("score", [trajectory_rmse, trajectory_dtw])
@pytest.mark.parametrize(
    ("simulated", "real", "message"),
    [
        ([[0.0], [np.inf]], np.zeros((2, 1)), "inf at frame 1, coordinate 0"),
        (np.zeros((2, 1)), np.full((2, 1), np.nan), "no measured entry"),
    ],
)
def test_arrays_without_a_distance_raise_an_error(score, simulated, real, message):
    with pytest.raises(ShapeError, match=message):
        score(simulated, real)


# --- DTW -------------------------------------------------------------------------------------------------------------


def textbook_dtw(first, second):
    """Return the mean distance along the path of the recursion, cell by cell; ties prefer the diagonal."""
    local = np.sqrt(np.nansum(np.square(first[:, None] - second), axis=2))
    cost = np.full((len(first) + 1, len(second) + 1), np.inf)
    cost[0, 0] = 0.0
    for i, j in np.ndindex(local.shape):
        before = min(cost[i, j], cost[i, j + 1], cost[i + 1, j])
        cost[i + 1, j + 1] = local[i, j] + before
    cell, length = local.shape, 1
    while cell != (1, 1):
        i, j = cell
        cell = min(
            [(i - 1, j - 1), (i - 1, j), (i, j - 1)], key=lambda place: cost[place]
        )
        length += 1
    return cost[-1, -1] / length


@given(st.integers(1, 30), st.integers(1, 30), st.integers(1, 4), st.integers(0, 99))
def test_dtw_of_random_walks_is_that_of_the_textbook(rows, columns, width, seed):
    random = np.random.default_rng(seed)
    first = random.normal(size=(rows, width)).cumsum(axis=0)
    second = random.normal(size=(columns, width)).cumsum(axis=0)
    second[columns // 2 :, 1:] = np.nan
    expected = textbook_dtw(first, second)
    gap = np.insert(second, columns // 3, np.nan, axis=0)
    assert trajectory_dtw(first, gap) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_dtw_ties_prefer_the_diagonal(seed):
    """A first frame on the real mean makes waiting there free; without the rule, waiting would lower the mean."""
    simulated = np.random.default_rng(seed).uniform(1.0, 2.0, size=(40, 1))
    simulated[0] = 0.0
    distance = trajectory_dtw(simulated, np.zeros((40, 1)))
    assert distance == pytest.approx(simulated.mean())


# --- time shift ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("offset_s", [0.05137, -0.0567, 0.3])
def test_the_time_shift_of_a_late_release_is_found(offset_s):
    """A uniform motion is linear between samples, so the shift is exact; 3 mm across it remain in 20 known frames."""

    def place_mm(times_s, across_mm):
        along_mm = np.clip(100 * times_s, 0, 50)
        return np.column_stack([along_mm, np.full(len(times_s), across_mm)])

    times_s = np.arange(241) / 180
    real = place_mm(FRAMES_S - offset_s, 3.0)
    real[20:] = np.nan
    shift_s, rmse = time_offset(times_s, place_mm(times_s, 0.0), real)
    assert shift_s == pytest.approx(offset_s, abs=1e-7)
    assert rmse == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("frame_count", "early_s", "expected_s"),
    [(31, 0.1, -0.1), (31, 1.0, -MAX_TIME_OFFSET_S), (11, 1.0, -4 / 30)],
)
def test_a_shift_to_earlier_times_compares_the_frames_that_both_motions_have(
    frame_count, early_s, expected_s
):
    """Two slides of the same acceleration, the real one earlier: at most 10 frames, and 7 of 11 are compared."""
    times_s = np.arange(6 * frame_count - 5) / 180
    real = 500 * 3.0 * np.square(FRAMES_S[:frame_count] + early_s)[:, None]
    simulated = 500 * 3.0 * np.square(times_s)[:, None]
    shift_s, rmse = time_offset(times_s, simulated, real)
    assert shift_s == pytest.approx(expected_s, abs=1e-6)
    assert (rmse == pytest.approx(0.0, abs=1e-2)) == (expected_s == -early_s)
    unshifted_s, _ = time_offset(times_s, simulated, real, earliest_s=0.0)
    assert unshifted_s == 0.0


def test_the_time_shift_of_an_object_at_rest_is_zero():
    still = np.full((61, 2), 0.1)
    expected = 0.0, pytest.approx(0.1 * math.sqrt(2))
    assert time_offset(np.arange(61) / 30, still, np.zeros((40, 2))) == expected
    with pytest.raises(ShapeError, match="strictly ascending"):
        time_offset([0.0, 0.0, 1.0], still[:3], np.zeros((3, 2)))


# --- samples ---------------------------------------------------------------------------------------------


def test_frames_are_the_samples_at_30_hz_within_a_tenth_of_a_millisecond():
    times_s = np.arange(19) / 180
    for shift_s in (-9e-5, 0.0, 9e-5):
        assert frame_index(times_s + shift_s, 4).tolist() == [0, 6, 12, 18]
    for shift_s in (-1.1e-4, 1.1e-4):
        with pytest.raises(ShapeError, match="no sample at frame 0"):
            frame_index(times_s + shift_s, 4)
    with pytest.raises(ShapeError, match=r"no sample at frame 2 \(t = 0\.0667 s\)"):
        frame_index(np.delete(times_s, 12), 4)
    with pytest.raises(ShapeError, match="needs 5 frames"):
        frame_index(times_s, 5)
    values = np.array([[0.0, 4.0], [2.0, 0.0]])
    between = interpolated(np.array([-1.0, 0.25, 2.0]), np.array([0.0, 1.0]), values)
    assert between.tolist() == [[0.0, 4.0], [0.5, 3.0], [2.0, 0.0]]
