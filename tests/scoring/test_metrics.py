from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from gauge_envs.errors import ShapeError
from gauge_envs.scoring.metrics import (
    signed_error,
    time_offset,
    trajectory_dtw,
    trajectory_rmse,
    z_scores,
)

VALUES = st.floats(-100, 100, allow_nan=False, width=32)


@st.composite
def trajectory_pairs(draw):
    coordinate_count = draw(st.integers(1, 4))
    shapes = [(draw(st.integers(1, 9)), coordinate_count) for _ in range(2)]
    return tuple(draw(arrays(float, shape, elements=VALUES)) for shape in shapes)


def plain_dtw(first, second):
    """Independent DTW: the textbook recursion, cell by cell; distances over the coordinates measured in both."""
    infinity = float("inf")
    cost = [[infinity] * (len(second) + 1) for _ in range(len(first) + 1)]
    local = [[0.0] * len(second) for _ in first]
    cost[0][0] = 0.0
    for i, a in enumerate(first):
        for j, b in enumerate(second):
            local[i][j] = math.sqrt(
                sum(
                    (p - q) ** 2
                    for p, q in zip(a, b, strict=True)
                    if not math.isnan(p - q)
                )
            )
            cost[i + 1][j + 1] = local[i][j] + min(
                cost[i][j], cost[i][j + 1], cost[i + 1][j]
            )
    i, j = len(first), len(second)
    path = [(i - 1, j - 1)]
    while (i, j) != (1, 1):
        i, j = min(
            [(i - 1, j - 1), (i - 1, j), (i, j - 1)],
            key=lambda cell: cost[cell[0]][cell[1]],
        )
        path.append((i - 1, j - 1))
    return cost[-1][-1], path[::-1]


# RMSE


def test_rmse_is_the_root_mean_square_of_the_frame_distances():
    real = np.zeros((2, 3))
    simulated = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 1.0]])
    assert trajectory_rmse(simulated, real) == pytest.approx(math.sqrt((25 + 1) / 2))


def test_rmse_leaves_out_missing_coordinates_and_frames_without_any():
    real = np.array([[0.0, np.nan], [np.nan, np.nan], [0.0, 0.0]])
    simulated = np.array([[3.0, 100.0], [100.0, 100.0], [3.0, 4.0]])
    assert trajectory_rmse(simulated, real) == pytest.approx(math.sqrt((9 + 25) / 2))


@pytest.mark.parametrize("score", [trajectory_rmse, trajectory_dtw])
@pytest.mark.parametrize(
    ("simulated", "real", "message"),
    [
        (np.zeros((3, 2)), np.zeros((3, 1)), "simulated has"),
        (np.zeros(3), np.zeros((3, 1)), r"simulated has shape \(3,\)"),
        (np.zeros((3, 0)), np.zeros((3, 0)), r"shape \(3, 0\)"),
        (
            np.array([[0.0], [np.inf]]),
            np.zeros((2, 1)),
            "simulated is inf at frame 1, coordinate 0",
        ),
        (
            np.zeros((2, 1)),
            np.array([[0.0], [np.inf]]),
            "real_mean is inf at frame 1, coordinate 0",
        ),
        (np.zeros((2, 1)), np.full((2, 1), np.nan), "no measured entry"),
    ],
)
def test_wrong_trajectories_are_refused_by_name(score, simulated, real, message):
    with pytest.raises(ShapeError, match=message):
        score(simulated, real)


# DTW


def plain_mean(first, second):
    """Mean distance along the path of the textbook recursion."""
    cost, path = plain_dtw(first, second)
    return cost / len(path)


@given(pair=trajectory_pairs())
def test_dtw_agrees_with_the_textbook_recursion(pair):
    path_cost, path = plain_dtw(*pair)
    found = trajectory_dtw(*pair)
    # Paths of one sum may differ in length: the sum is that of a path of some length.
    lengths = np.arange(max(map(len, pair)), sum(map(len, pair)))
    assert np.abs(found * lengths - path_cost).min() <= 1e-9 * max(path_cost, 1.0)
    assert len(path) in lengths


@pytest.mark.parametrize(
    "shape",
    [
        (60, 60, 7),
        (41, 60, 3),
        (60, 41, 3),
        (40, 41, 1),
        (1, 9, 2),
        (9, 1, 2),
        (1, 1, 1),
    ],
)
def test_dtw_of_random_walks_is_that_of_the_textbook(shape):
    first_count, second_count, coordinate_count = shape
    rng = np.random.default_rng(3)
    first = rng.normal(size=(first_count, coordinate_count)).cumsum(axis=0)
    second = rng.normal(size=(second_count, coordinate_count)).cumsum(axis=0)
    assert trajectory_dtw(first, second) == pytest.approx(
        plain_mean(first, second), rel=1e-12
    )


def test_dtw_leaves_out_what_was_not_measured():
    rng = np.random.default_rng(6)
    simulated, real = rng.normal(size=(20, 3)), rng.normal(size=(22, 3))
    real[3:9, 1] = np.nan
    expected = plain_mean(simulated, real)
    gap = np.insert(real, 10, np.nan, axis=0)
    assert trajectory_dtw(simulated, gap) == pytest.approx(expected, rel=1e-12)


def test_dtw_ignores_a_pause_that_rmse_punishes():
    motion = np.linspace(0.0, 50.0, 26)[:, None]
    paused = np.concatenate((np.repeat(motion[:1], 5, axis=0), motion))
    assert trajectory_dtw(motion, paused) == 0.0
    assert trajectory_rmse(motion, paused[:26]) > 5.0


@pytest.mark.parametrize("seed", range(6))
def test_dtw_ties_prefer_the_diagonal(seed):
    """A first frame on the real mean makes waiting there free: without the rule the path could grow, the mean fall."""
    simulated, real = (
        np.random.default_rng(seed).uniform(1.0, 2.0, size=(40, 1)),
        np.zeros((40, 1)),
    )
    simulated[0] = 0.0
    assert trajectory_dtw(simulated, real) == pytest.approx(simulated.sum() / 40)


# Time offset


def fall_mm(time_s):
    """A ball let go at time 0 that falls for 0.3 s and then lies: height and a drift sideways, mm."""
    time_s = np.clip(time_s, 0.0, 0.3)
    return np.column_stack((500 - 0.5 * 9810 * time_s**2, 40 * time_s))


@pytest.mark.parametrize("offset_s", [0.0, 0.1234, -0.0567, 0.3])
@pytest.mark.parametrize(
    ("sample_rate_hz", "accuracy_s"), [(180.0, 2e-4), (30.0, 4e-3)]
)
def test_time_offset_finds_the_shift_of_a_late_release(
    offset_s, sample_rate_hz, accuracy_s
):
    times_s = np.arange(int(4 / 3 * sample_rate_hz) + 1) / sample_rate_hz
    real = fall_mm(np.arange(31) / 30 - offset_s)
    found_s, aligned = time_offset(times_s, fall_mm(times_s), real)
    assert found_s == pytest.approx(offset_s, abs=accuracy_s)
    assert aligned <= trajectory_rmse(fall_mm(np.arange(31) / 30), real) + 1e-9
    assert aligned < 1.0 if sample_rate_hz == 180.0 else aligned < 20.0


@pytest.mark.parametrize("later_s", [0.0, 0.1])
def test_time_offset_never_assumes_motion_after_the_end(later_s):
    """Two slides of the same acceleration, the real one 0.2 s earlier: the shift ends where the simulation ends."""
    times_s = np.arange(round(180 * (1.0 + later_s)) + 1) / 180
    real = 500 * 3.0 * np.square(np.arange(31) / 30 + 0.2)[:, None]
    found_s, _ = time_offset(times_s, 500 * 3.0 * np.square(times_s)[:, None], real)
    assert found_s == pytest.approx(-later_s, abs=1e-6)


def test_time_offset_is_exact_for_a_uniform_motion():
    times_s = np.arange(181) / 180
    found_s, aligned = time_offset(
        times_s,
        100 * times_s[:, None],
        100 * np.clip(np.arange(31) / 30 - 0.05137, 0, 1)[:, None],
    )
    assert found_s == pytest.approx(0.05137, abs=1e-6)
    assert aligned < 1e-4


def test_time_offset_of_an_object_at_rest_is_zero():
    times_s = np.arange(61) / 30
    assert time_offset(times_s, np.full((61, 2), 0.1), np.zeros((40, 2))) == (
        0.0,
        pytest.approx(0.1 * math.sqrt(2)),
    )


@pytest.mark.parametrize("times_s", [[0.0, 0.0, 1.0], [0.0, 2.0, 1.0]])
def test_time_offset_refuses_times_that_do_not_fit(times_s):
    with pytest.raises(ShapeError, match="strictly ascending"):
        time_offset(times_s, np.zeros((3, 1)), np.zeros((3, 1)))


# Scatter


def test_z_scores_are_nan_without_scale_or_measurement():
    z = z_scores([[2.0, 2.0, 2.0]], [[1.0, np.nan, 0.0]], [[0.5, 1.0, 0.0]])
    np.testing.assert_array_equal(z, [[2.0, np.nan, np.nan]])


def test_z_scores_take_one_sigma_for_all_frames():
    assert z_scores(np.ones((4, 2)), np.zeros((4, 2)), [0.5, 2.0])[3].tolist() == [
        2.0,
        0.5,
    ]


def test_signed_error_keeps_direction_and_skips_missing_frames():
    real = np.array([[0.0, 0.0, np.nan], [np.nan, 0.0, np.nan]])
    np.testing.assert_array_equal(
        signed_error([[1.0, -2.0, 5.0], [9.0, 4.0, 5.0]], real), [1.0, 1.0, np.nan]
    )
