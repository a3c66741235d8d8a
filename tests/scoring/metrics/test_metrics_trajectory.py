from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from gauge_envs.errors import ShapeError
from gauge_envs.scoring.metrics import (
    band_coverage,
    dtw_path,
    mean_abs_z,
    release_offset,
    signed_error,
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


def assert_is_warping_path(path, first_count, second_count):
    assert tuple(path[0]) == (0, 0)
    assert tuple(path[-1]) == (first_count - 1, second_count - 1)
    assert {tuple(step) for step in np.diff(path, axis=0)} <= {(1, 0), (0, 1), (1, 1)}


# RMSE


def test_rmse_is_the_root_mean_square_of_the_frame_distances():
    real = np.zeros((2, 3))
    simulated = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 1.0]])
    assert trajectory_rmse(simulated, real) == pytest.approx(math.sqrt((25 + 1) / 2))


def test_rmse_leaves_out_missing_coordinates_and_frames_without_any():
    real = np.array([[0.0, np.nan], [np.nan, np.nan], [0.0, 0.0]])
    simulated = np.array([[3.0, 100.0], [100.0, 100.0], [3.0, 4.0]])
    assert trajectory_rmse(simulated, real) == pytest.approx(math.sqrt((9 + 25) / 2))


def test_rmse_of_a_real_trial_with_gaps_needs_permission():
    trial, mean = np.array([[1.0], [np.nan]]), np.zeros((2, 1))
    assert trajectory_rmse(trial, mean, allow_missing=True) == 1.0
    with pytest.raises(ShapeError, match="simulated is nan at frame 1, coordinate 0"):
        trajectory_rmse(trial, mean)


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


@given(pair=trajectory_pairs())
def test_dtw_cost_agrees_with_the_textbook_recursion(pair):
    cost, path = dtw_path(*pair)
    assert cost == pytest.approx(plain_dtw(*pair)[0], rel=1e-9, abs=1e-9)
    assert_is_warping_path(path, *map(len, pair))


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
def test_dtw_path_agrees_with_the_textbook_recursion(shape):
    first_count, second_count, coordinate_count = shape
    rng = np.random.default_rng(3)
    first = rng.normal(size=(first_count, coordinate_count)).cumsum(axis=0)
    second = rng.normal(size=(second_count, coordinate_count)).cumsum(axis=0)
    cost, path = dtw_path(first, second)
    plain_cost, plain_path = plain_dtw(first, second)
    assert path.tolist() == [list(cell) for cell in plain_path]
    assert cost == pytest.approx(plain_cost, rel=1e-12)
    assert trajectory_dtw(first, second) == pytest.approx(
        plain_cost / len(plain_path), rel=1e-12
    )


def test_dtw_agrees_where_distances_nearly_cancel():
    """A wide motion that slows down to steps of a nanometre: to a plain matrix product all of these are 0 or noise."""
    rng = np.random.default_rng(4)
    wide = rng.normal(size=(80, 3)).cumsum(axis=0) * 1e3
    first, second = (
        np.concatenate(
            (wide, wide[-1] + 1e-6 * rng.normal(size=(20, 3)).cumsum(axis=0))
        )
        for _ in range(2)
    )
    assert dtw_path(first, second)[0] == pytest.approx(
        plain_dtw(first, second)[0], rel=1e-9
    )


def test_dtw_agrees_when_both_rest():
    rng = np.random.default_rng(5)
    first, second = 5.0 + 1e-9 * rng.normal(size=(2, 30, 2))
    assert dtw_path(first, second)[0] == pytest.approx(
        plain_dtw(first, second)[0], rel=1e-9
    )


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
    assert dtw_path(simulated, real)[1].tolist() == [[k, k] for k in range(40)]
    assert trajectory_dtw(simulated, real) == pytest.approx(simulated.sum() / 40)


def test_dtw_uses_coordinates_measured_in_both():
    rng = np.random.default_rng(6)
    simulated, real = rng.normal(size=(20, 3)), rng.normal(size=(22, 3))
    real[3:9, 1] = np.nan
    real[10:15, 2] = np.nan
    simulated[4, 0] = np.nan
    cost, path = dtw_path(simulated, real, allow_missing=True)
    plain_cost, plain_path = plain_dtw(simulated, real)
    assert cost == pytest.approx(plain_cost, rel=1e-12)
    assert path.tolist() == [list(cell) for cell in plain_path]


def test_dtw_skips_frames_with_nothing_measured():
    simulated = np.arange(6.0)[:, None]
    real = simulated.copy()
    real[2] = np.nan
    _, path = dtw_path(simulated, real)
    assert 2 not in path[:, 1]
    assert path[-1].tolist() == [5, 5]


def test_dtw_refuses_frames_that_share_no_coordinate():
    simulated = np.array([[0.0, np.nan], [0.0, 1.0]])
    real = np.array([[np.nan, 0.0], [0.0, 1.0]])
    with pytest.raises(ShapeError, match="share no measured coordinate"):
        dtw_path(simulated, real, allow_missing=True)


# Release offset


def fall_mm(time_s):
    """A ball let go at time 0 that falls for 0.3 s and then lies: height and a drift sideways, mm."""
    time_s = np.clip(time_s, 0.0, 0.3)
    return np.column_stack((500 - 0.5 * 9810 * time_s**2, 40 * time_s))


@pytest.mark.parametrize("offset_s", [0.0, 0.1234, -0.0567, 0.3])
@pytest.mark.parametrize(
    ("sample_rate_hz", "accuracy_s"), [(180.0, 2e-4), (30.0, 4e-3)]
)
def test_release_offset_finds_the_shift_of_a_late_release(
    offset_s, sample_rate_hz, accuracy_s
):
    times_s = np.arange(int(4 / 3 * sample_rate_hz) + 1) / sample_rate_hz
    real = fall_mm(np.arange(31) / 30 - offset_s)
    found_s, aligned = release_offset(times_s, fall_mm(times_s), real)
    assert found_s == pytest.approx(offset_s, abs=accuracy_s)
    assert aligned <= trajectory_rmse(fall_mm(np.arange(31) / 30), real) + 1e-9
    assert aligned < 1.0 if sample_rate_hz == 180.0 else aligned < 20.0


@pytest.mark.parametrize("later_s", [0.0, 0.1])
def test_release_offset_never_assumes_motion_after_the_end(later_s):
    """Two slides of the same acceleration, the real one 0.2 s earlier: the shift ends where the simulation ends."""
    times_s = np.arange(round(180 * (1.0 + later_s)) + 1) / 180
    real = 500 * 3.0 * np.square(np.arange(31) / 30 + 0.2)[:, None]
    found_s, _ = release_offset(times_s, 500 * 3.0 * np.square(times_s)[:, None], real)
    assert found_s == pytest.approx(-later_s, abs=1e-6)


def test_release_offset_is_exact_for_a_uniform_motion():
    times_s = np.arange(181) / 180
    found_s, aligned = release_offset(
        times_s,
        100 * times_s[:, None],
        100 * np.clip(np.arange(31) / 30 - 0.05137, 0, 1)[:, None],
    )
    assert found_s == pytest.approx(0.05137, abs=1e-6)
    assert aligned < 1e-4


def test_release_offset_stays_within_its_limit_and_ignores_missing_entries():
    times_s = np.arange(181) / 180
    real = fall_mm(np.arange(31) / 30 - 0.2)
    real[::3, 1] = np.nan
    real[4] = np.nan
    assert release_offset(times_s, fall_mm(times_s), real)[0] == pytest.approx(
        0.2, abs=2e-4
    )
    assert release_offset(times_s, fall_mm(times_s), real, max_offset_s=0.05)[
        0
    ] == pytest.approx(0.05, abs=1e-6)


def test_release_offset_of_an_object_at_rest_is_zero():
    times_s = np.arange(61) / 30
    assert release_offset(times_s, np.full((61, 2), 0.1), np.zeros((40, 2))) == (
        0.0,
        pytest.approx(0.1 * math.sqrt(2)),
    )


@pytest.mark.parametrize("times_s", [[0.0, 0.0, 1.0], [0.0, 1.0], [0.0, 2.0, 1.0]])
def test_release_offset_refuses_times_that_do_not_fit(times_s):
    with pytest.raises(ShapeError, match="strictly ascending"):
        release_offset(times_s, np.zeros((3, 1)), np.zeros((3, 1)))


# Scatter


def test_z_scores_are_nan_without_scale_or_measurement():
    z = z_scores([[2.0, 2.0, 2.0]], [[1.0, np.nan, 0.0]], [[0.5, 1.0, 0.0]])
    np.testing.assert_array_equal(z, [[2.0, np.nan, np.nan]])


def test_z_statistics_count_measured_entries_only():
    z = np.array([[0.5, -1.0, np.nan], [-3.0, np.nan, 1.5]])
    assert mean_abs_z(z) == pytest.approx(6.0 / 4)
    assert [band_coverage(z, k) for k in (0.1, 1.0, 2.0, 3.0)] == [0.0, 0.5, 0.75, 1.0]
    assert math.isnan(mean_abs_z(np.full(3, np.nan)))
    assert math.isnan(band_coverage(np.full(3, np.nan), 1.0))


def test_z_scores_take_one_sigma_for_all_frames_and_refuse_others():
    assert z_scores(np.ones((4, 2)), np.zeros((4, 2)), [0.5, 2.0])[3].tolist() == [
        2.0,
        0.5,
    ]
    with pytest.raises(ShapeError, match=r"\(3,\), which does not fit \(4, 2\)"):
        z_scores(np.ones((4, 2)), np.zeros((4, 2)), np.ones(3))
    with pytest.raises(ShapeError, match="never negative"):
        z_scores(np.ones((4, 2)), np.zeros((4, 2)), -1.0)


def test_signed_error_keeps_direction_and_skips_missing_frames():
    real = np.array([[0.0, 0.0, np.nan], [np.nan, 0.0, np.nan]])
    np.testing.assert_array_equal(
        signed_error([[1.0, -2.0, 5.0], [9.0, 4.0, 5.0]], real), [1.0, 1.0, np.nan]
    )
