"""The best path through candidates: what dynamic programming keeps and what it leaves out."""

import math

import cv2
import numpy as np
import pytest

from gauge_envs.tools.video import video_task
from gauge_envs.tools.video.follow import (
    Background,
    FaceFollower,
    ShapeFollower,
    Sight,
)
from gauge_envs.tools.video.path import best_path
from gauge_envs.tools.video.tracker import _is_neighbour


def sight(x, likeness):
    return Sight(x_px=x, y_px=0.0, likeness=likeness, size_ratio=1.0)


@pytest.mark.parametrize("decoys", [1, 3])
def test_a_likelier_place_far_away_is_left_out(decoys):
    frames = [[sight(4.0 * number, 0.7)] for number in range(20)]
    for number in range(8, 8 + decoys):
        frames[number].append(sight(150.0, 0.95))
    path = best_path(frames, np.zeros(2), 50.0)
    assert [one.x_px for one in path] == [4.0 * number for number in range(20)]


def test_a_gap_is_bridged_and_stays_empty():
    frames = [
        [sight(4.0 * number, 0.7)] if not 6 <= number < 12 else []
        for number in range(20)
    ]
    path = best_path(frames, np.zeros(2), 50.0)
    assert [
        number for number, one in enumerate(path) if not np.isfinite(one.x_px)
    ] == list(range(6, 12))


def test_nothing_is_found_where_there_is_no_candidate():
    assert all(
        one.likeness == 0.0 for one in best_path([[], [], []], np.zeros(2), 50.0)
    )


def test_a_struck_ball_is_followed_from_where_it_hangs():
    swing = [20.0, 75.0, 120.0, 150.0, 160.0, 150.0, 120.0, 75.0, 20.0]
    frames = [
        [sight(x, 0.6)] if x else [] for x in [0.0] * 9 + swing + [0.0] * 9 + swing
    ]
    found = {
        struck: [
            one.likeness > 0.0
            for one in best_path(frames, np.zeros(2), 20.0, 30.0, is_struck=struck)
        ]
        for struck in (True, False)
    }
    assert found[True] == [bool(ones) for ones in frames]
    assert found[False] != found[True]


def test_only_balls_of_the_cradle_are_its_balls():
    task = video_task("NewtonsCradle-metal")
    assert task.pivot_px is not None and task.rest_px is not None
    length, first_x = (
        task.rest_px[1] - task.pivot_px[1],
        task.pivot_px[0] - 4.0 * task.size_px,
    )
    at = 0.7 * length
    places = {
        "row": (first_x, task.rest_px[1]),
        "arc": (first_x - at, task.pivot_px[1] + math.sqrt(length**2 - at**2)),
    }
    for x, y in places.values():
        assert _is_neighbour(Sight(x_px=x, y_px=y, likeness=1.0), task)
    assert not _is_neighbour(
        Sight(x_px=first_x - 50.0, y_px=task.pivot_px[1] + 150.0, likeness=1.0), task
    )


@pytest.mark.parametrize("size", [1.0, 1.4, 1.6])
def test_an_object_that_outgrows_its_outline_has_its_size(size):
    pytest.importorskip("cv2")
    task = video_task("BouncingBall-rubber")
    rows, columns = np.mgrid[:480, :832]
    away_px = np.hypot(columns - task.centre_px[0], rows - task.centre_px[1])
    bare = np.full((480, 832, 3), 200, dtype=np.uint8)
    first, grown = bare.copy(), bare.copy()
    first[away_px < 0.5 * task.size_px] = 25
    grown[away_px < 0.5 * size * task.size_px] = 25
    sights = ShapeFollower(Background(bare), first, task).candidates(grown)
    assert sights[0].size_ratio == pytest.approx(size, rel=0.15)


@pytest.mark.parametrize("change", ["none", "grows", "second", "spreads"])
def test_a_cube_on_a_turntable_keeps_its_area_and_outline(change):
    """Correlation with a template alone follows a cube that grows, and does not see a second one."""
    task = video_task("Turntable-2-wood")
    # Where the plate has nearly the colour of the cube, the edges of its sides are left.
    plate = (150, 185, 205) if change == "spreads" else (210, 220, 225)
    pictures = []
    for is_later in (False, True):
        picture = np.full((480, 832, 3), 40, np.uint8)
        pivot = [round(value) for value in task.pivot_px]
        cv2.circle(picture, pivot, 225, plate, -1)
        half = 0.5 * task.size_px
        centre = np.array(task.centre_px)
        if is_later and change in ("grows", "spreads"):
            half *= 1.3 if change == "spreads" else 1.5
        places = [centre, np.add(centre, [200.0, 90.0])]
        for place in places[: 1 + (is_later and change == "second")]:
            low, high = (place - half).astype(int), (place + half).astype(int)
            cv2.rectangle(picture, low.tolist(), high.tolist(), (105, 150, 195), -1)
        for x, y in ((-20, -8), (14, 18), (16, -16)):
            spot = np.add(centre, [x, y]).astype(int).tolist()
            cv2.circle(picture, spot, 9, (60, 90, 120), -1)
        pictures.append(picture)
    follower = FaceFollower(pictures[0], task)
    chosen, *others = follower.candidates(pictures[1]) or [Sight()]
    far = [one for one in others if one.x_px > centre[0] + task.size_px]
    assert len(far) == (change == "second")
    is_whole = chosen.likeness > 0.0 and not chosen.size_ratio > 1.3
    assert is_whole is (change in ("none", "second"))
