"""Which candidate is the object, and whether it has kept its size, shape and look."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from gauge_envs.tools.video import video_task
from gauge_envs.tools.video.face import FaceFollower
from gauge_envs.tools.video.shape import ShapeFollower
from gauge_envs.tools.video.sight import Sight, rotation_of
from gauge_envs.tools.video.soundness import LEAST_CONFIDENCE, MOST_MISFIT
from gauge_envs.tools.video.tracker import (
    _hidden,
    _is_neighbour,
    followed,
)

BALL = video_task("BouncingBall-rubber")
CRADLE = video_task("NewtonsCradle-metal")


def sight(x_px, likeness=0.7):
    return Sight(place=np.add(BALL.centre_px, [x_px, 0.0]), likeness=likeness)


@pytest.mark.parametrize("decoys", [1, 3])
def test_a_likelier_place_far_away_is_left_out_and_a_gap_is_bridged(decoys):
    frames = [[sight(4.0 * number)] for number in range(20)]
    for number in range(8, 8 + decoys):
        frames[number].append(sight(150.0, 0.95))
    frames[12:17] = [[]] * 5
    path = followed(frames, BALL, 30.0)
    places = [4.0 * number for number in range(20)]
    places[12:17] = [np.nan] * 5
    found = [one.place[0] - BALL.centre_px[0] for one in path]
    assert found == pytest.approx(places, nan_ok=True)


def test_a_ball_is_followed_through_its_impact():
    times_s = np.arange(20) / 30.0 - 0.31
    gravity_px_s2 = 9.81 / BALL.scale_m_per_px
    falls = 0.5 * gravity_px_s2 * (0.31**2 - (times_s + 0.31) ** 2)
    rises = 0.31 * 0.8 * gravity_px_s2 * times_s - 0.5 * gravity_px_s2 * times_s**2
    heights_px = np.where(times_s < 0.0, falls, rises)
    start_px = BALL.centre_px[1] + heights_px[0]
    frames = [
        [Sight(place=np.array([BALL.centre_px[0], start_px - one]), likeness=0.6)]
        for one in heights_px
    ]
    lost = [one.likeness == 0.0 for one in followed(frames, BALL, 30.0)]
    assert sum(lost) <= 2, lost


def test_a_struck_ball_is_followed_from_where_it_hangs_and_nowhere_else():
    length = CRADLE.rest_px[1] - CRADLE.pivot_px[1]
    # It is struck just before a frame: the first step is short, and the next one is not.
    swing = (0.75 * np.sin(np.pi * (np.arange(9) + 0.35) / 9.0)).tolist()

    def at(angle, length):
        offset = length * np.array([math.sin(angle), math.cos(angle)])
        return Sight(place=CRADLE.pivot_px + offset, likeness=0.6)

    angles = [0.0] * 9 + swing + [0.0] * 9 + swing
    for share, is_on_arc in ((1.0, True), (0.5, False)):
        frames = [[at(angle, share * length)] if angle else [] for angle in angles]
        found = [one.likeness > 0.0 for one in followed(frames, CRADLE, 30.0)]
        assert found == [is_on_arc and angle > 0.0 for angle in angles]


def test_only_balls_of_the_cradle_are_its_balls():
    task = CRADLE
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
        assert _is_neighbour(Sight(place=np.array([x, y]), likeness=1.0), task)
    others = [
        (first_x - 50.0, task.pivot_px[1] + 150.0),
        (first_x - 4.0 * task.size_px, task.rest_px[1]),
    ]
    for x, y in others:
        assert not _is_neighbour(Sight(place=np.array([x, y]), likeness=1.0), task)


@pytest.mark.parametrize(
    ("change", "size"),
    [
        ("none", 1.0),
        ("none", 1.4),
        ("none", 1.6),
        ("smeared", 1.0),
        ("melted", 1.0),
        ("square", 1.0),
        ("split", 1.0),
    ],
)
def test_an_object_has_its_size_and_shape_though_its_motion_smears_it(change, size):
    task = video_task("BouncingBall-rubber")
    rows, columns = np.mgrid[:480, :832]
    down_px, right_px = rows - task.centre_px[1], columns - task.centre_px[0]
    bare = np.full((480, 832, 3), 200.0)
    first, later = bare.copy(), bare.copy()
    radius_px = 0.5 * task.size_px
    first[np.hypot(down_px, right_px) < radius_px] = 25
    wide = 1.7 if change == "melted" else 1.0
    away_px = np.hypot(down_px * wide, right_px / wide)
    if change == "square":
        away_px = np.maximum(abs(down_px), abs(right_px))
    if change == "split":
        # One half is where the ball was, and the other one a diameter above it.
        parted_px = np.where(down_px < 0.0, down_px + 2.0 * radius_px, down_px)
        is_half = (down_px > 0.0) | (down_px < -radius_px)
        away_px = np.where(is_half, np.hypot(parted_px, right_px), np.inf)
    later[away_px < size * radius_px] = 25
    if change == "smeared":
        later = cv2.blur(later, (1, 45))
    first, later = first.astype(np.uint8), later.astype(np.uint8)
    follower = ShapeFollower(first, bare.astype(np.uint8), task)
    follower.candidates(first)
    sight = max(follower.candidates(later), key=lambda one: one.place[1])
    expected = 0.71 if change == "split" else size
    assert sight.size_ratio == pytest.approx(expected, rel=0.15)
    if size > 1.0 or change in ("melted", "square", "split"):
        assert sight.misfit > MOST_MISFIT
    else:
        assert sight.misfit < 0.1


def test_a_ball_that_stops_beside_its_first_place_is_no_part_of_the_background():
    rows, columns = np.mgrid[:480, :832]
    first, moving, last = (
        np.full((480, 832, 3), 200, np.uint8) for _ in ("first", "moving", "last")
    )
    for picture, away in ((first, 0.0), (moving, 0.7), (last, 1.1)):
        down_px = rows - BALL.centre_px[1] - away * BALL.size_px
        away_px = np.hypot(down_px, columns - BALL.centre_px[0])
        picture[away_px < 0.5 * BALL.size_px] = 25
    follower = ShapeFollower(first, last, BALL)
    follower.candidates(first)
    for picture, away in ((moving, 0.7), (last, 1.1)):
        (sight,) = follower.candidates(picture)
        wanted_px = np.add(BALL.centre_px, (0.0, away * BALL.size_px))
        assert math.dist(sight.place, wanted_px) < 1.0
        assert sight.size_ratio == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    "change", ["none", "grows", "second", "spreads", "darkens", "flattens", "rounds"]
)
def test_a_cube_on_a_turntable_keeps_its_area_and_outline(change):
    """Correlation with a template alone follows a cube that grows, and does not see a second one.

    The brightness of metal follows the lamp, and its tint does not.
    """
    is_metal = change in ("darkens", "flattens")
    task = video_task("Turntable-2-metal" if is_metal else "Turntable-2-wood")
    # Where the plate has nearly the colour of the cube, the edges of its sides are left.
    plate = (150, 185, 205) if change == "spreads" else (210, 220, 225)
    plate = (140, 165, 185) if is_metal else plate
    pictures = []
    for is_later in (False, True):
        picture = np.full((480, 832, 3), 40, np.uint8)
        pivot = [round(value) for value in task.pivot_px]
        cv2.circle(picture, pivot, 225, plate, -1)
        half = 0.5 * task.size_px
        centre = np.array(task.centre_px)
        if is_later and change in ("grows", "spreads"):
            half *= 1.3 if change == "spreads" else 1.5
        metal = (195, 195, 195) if is_later else (240, 240, 240)
        colour = metal if is_metal else (105, 150, 195)
        places = [centre, np.add(centre, [200.0, 90.0])]
        for place in places[: 1 + (is_later and change == "second")]:
            # A cube that flattens keeps its area.
            flat = 1.2 if is_later and change == "flattens" else 1.0
            sides = half * np.array([flat, 1.0 / flat])
            low, high = (place - sides).astype(int), (place + sides).astype(int)
            if is_later and change == "rounds":
                cv2.circle(picture, place.astype(int).tolist(), int(half), colour, -1)
                continue
            cv2.rectangle(picture, low.tolist(), high.tolist(), colour, -1)
        spots = [(-20, -8), (14, 18), (16, -16)] if change != "flattens" else []
        for x, y in spots:
            spot = np.add(centre, [x, y]).astype(int).tolist()
            cv2.circle(picture, spot, 9, (60, 90, 120), -1)
        pictures.append(picture)
    follower = FaceFollower(pictures[0], task)
    chosen, *others = follower.candidates(pictures[1]) or [Sight()]
    far = [one for one in others if one.place[0] > centre[0] + task.size_px]
    assert len(far) == (change == "second")
    is_whole = chosen.likeness > 0.0 and not abs(chosen.size_ratio - 1.0) > 0.3
    is_whole = is_whole and chosen.misfit < MOST_MISFIT
    assert is_whole is (change in ("none", "second", "darkens"))


@pytest.mark.parametrize(
    ("task_id", "most_away"), [("Turntable-2-metal", 0.1), ("Turntable-2-wood", 0.25)]
)
def test_a_plain_face_on_a_turntable_is_known_by_its_area(task_id, most_away):
    """A reflection passes over metal, and beside wood a shadow keeps its direction while the cube turns."""
    task = video_task(task_id)
    pivot, start = np.array(task.pivot_px), np.array(task.centre_px)
    scene = np.full((480, 832, 3), 40, np.uint8)
    plate = (140, 165, 185) if task.is_shiny else (210, 220, 225)
    cv2.circle(scene, pivot.round().astype(int).tolist(), 225, plate, -1)
    follower = None
    for frame in range(50):
        angle_deg = -1.5 * frame
        turn = cv2.getRotationMatrix2D(pivot.tolist(), -angle_deg, 1.0)
        centre = turn @ [*start, 1.0]
        picture = scene.copy()
        away_px = np.arange(832.0) - centre[0] + 30.0 - 0.5 * frame
        metal = 190.0 + 60.0 * np.exp(-((away_px / 12.0) ** 2))[:, None]
        looks = [(0.0, metal if task.is_shiny else (105, 150, 195))]
        if not task.is_shiny:
            looks.insert(0, (30.0, (120, 125, 130)))
        for aside_px, colour in looks:
            middle = np.add(centre, (aside_px, -0.6 * aside_px))
            box = (middle.tolist(), (task.size_px,) * 2, angle_deg)
            covered = np.zeros(scene.shape[:2], np.uint8)
            cv2.fillPoly(covered, [cv2.boxPoints(box).round().astype(int)], 1)
            picture = np.where(covered[..., None] > 0, colour, picture)
        picture = picture.astype(np.uint8)
        follower = follower or FaceFollower(picture, task)
        sight = follower.candidates(picture)[0]
        assert sight.likeness > LEAST_CONFIDENCE
        assert math.dist(sight.place, centre) < most_away * task.size_px


def test_a_swing_before_a_table_of_its_colour_is_said_to_be_missed():
    """The mean of the apices that are seen would be too large."""
    picture = np.full((480, 832, 3), 200, np.uint8)
    x, y = CRADLE.rest_px
    cv2.circle(
        picture, (round(x), round(y)), round(0.5 * CRADLE.size_px), (30,) * 3, -1
    )
    dark = picture.copy()
    dark[round(y - 0.5 * CRADLE.size_px) :] = 32
    for shown, is_hidden in ((picture, False), (dark, True)):
        follower = ShapeFollower(shown, shown, CRADLE)
        assert bool(_hidden(follower, CRADLE)) is is_hidden


@pytest.mark.parametrize(
    ("plate", "is_hidden"), [((140, 165, 185), False), ((190,) * 3, True)]
)
def test_metal_on_a_plate_of_its_tint_is_said_to_hide(plate, is_hidden):
    task = video_task("Turntable-2-metal")
    picture = np.full((480, 832, 3), 40, np.uint8)
    cv2.circle(picture, [round(value) for value in task.pivot_px], 225, plate, -1)
    corners = np.add([[-0.5], [0.5]] * np.array(task.size_px), task.centre_px)
    cv2.rectangle(picture, *corners.astype(int).tolist(), (240,) * 3, -1)
    assert bool(_hidden(FaceFollower(picture, task), task)) is is_hidden


@pytest.mark.parametrize("pattern_std", [0.0, 3.0])
def test_a_face_with_a_faint_pattern_does_not_drift(pattern_std):
    """A shadow, a dark side and the light of a lamp keep their direction in the room while the cube turns."""
    task = video_task("Turntable-2-wood")
    size_px, side = task.size_px, 2 * round(0.5 * task.size_px) + 1
    rng = np.random.default_rng(0)
    pattern = cv2.GaussianBlur(rng.normal(size=(side, side)), (0, 0), 5.0)
    pattern *= pattern_std / pattern.std()
    rows, columns = np.mgrid[:480, :832]
    turns_rad = -np.linspace(0.0, 2.4, 49)
    pictures, centres = [], []
    for turn_rad in turns_rad:
        turn = rotation_of(turn_rad)
        centre = task.pivot_px + turn @ (np.array(task.centre_px) - task.pivot_px)
        picture = np.full((480, 832), 200.0)
        corners = size_px * np.array(
            [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]
        )
        for away_px, grey in ((16.0, 140.0), (7.0, 60.0)):
            moved = (corners @ turn.T + centre + away_px).astype(int)
            cv2.fillPoly(picture, [moved], grey)
        place = np.column_stack([turn, centre - turn @ [side // 2, side // 2]])
        face = cv2.warpAffine(150.0 + pattern, place, (832, 480))
        shown = cv2.warpAffine(np.ones((side, side)), place, (832, 480))
        lit = 1.0 + 0.0008 * (columns - rows)
        picture = lit * (shown * face + (1.0 - shown) * picture)
        pictures.append(
            np.repeat(picture[..., None], 3, axis=2).clip(0, 255).astype(np.uint8)
        )
        centres.append(centre)
    follower = FaceFollower(pictures[0], task)
    sights = [(follower.candidates(one) or [Sight()])[0] for one in pictures]
    lowest = min(one.likeness for one in sights)
    if not pattern_std:
        assert lowest < 0.9
        return
    assert lowest > 0.9
    places = np.array([one.place for one in sights])
    assert np.linalg.norm(places - centres, axis=1).max() < 0.03 * size_px
    assert follower._pose[0] == pytest.approx(turns_rad[-1], abs=math.radians(1.0))


def test_a_slide_that_stops_at_once_is_followed_to_its_rest():
    task = video_task("SlopeSlider-2-wood")
    along_px = np.minimum(2.4 * np.arange(24.0) ** 2, 400.0)
    places = task.centre_px + along_px[:, None] * task.direction
    frames = [[Sight(place=place, likeness=0.9)] for place in places]
    assert all(one.likeness > 0.0 for one in followed(frames, task, 30.0))


# Beyond the middle of the picture, a cube slides away from where no side is seen.
@pytest.mark.parametrize(("ahead_px", "limit_px"), [(0.0, 0.5), (400.0, 1.0)])
@pytest.mark.parametrize("depth", [0.0, 0.04, 0.08])
def test_a_black_cube_has_its_face_where_its_dark_sides_are_seen_too(
    depth, ahead_px, limit_px
):
    task = video_task("SlopeSlider-2-plastic")
    first_px = np.array(task.centre_px) + ahead_px * np.array(task.direction)
    task = replace(task, centre_px=tuple(first_px))
    corners = cv2.boxPoints(((0.0, 0.0), (task.size_px, task.size_px), 31.6 - 90.0))
    middle_px = np.array([416.0, 240.0])
    places = task.centre_px + np.outer([0.0, 60.0, 100.0, 140.0], task.direction)
    pictures = []
    for place in places:
        picture = np.full((480, 832, 3), 200, np.uint8)
        face = corners + place
        # A pinhole camera sees the back of the cube smaller, towards the middle of the picture.
        back = middle_px + (face - middle_px) / (1.0 + depth)
        for points, colour in ((np.vstack([face, back]), (18,) * 3), (face, (28,) * 3)):
            hull = cv2.convexHull(np.round(16.0 * points).astype(np.int32))
            cv2.fillConvexPoly(picture, hull, colour, cv2.LINE_AA, 4)
        pictures.append(picture)
    follower = ShapeFollower(pictures[0], pictures[-1], task)
    found = [follower.candidates(picture)[0].place for picture in pictures]
    along_px = (found - places) @ task.direction
    assert np.abs(along_px).max() < limit_px, along_px


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_a_cube_is_placed_without_its_shadow_on_the_board(share):
    """The shadow has the colour of the cube, so that both are as high as 1.3 cubes."""
    task = video_task("SlopeSlider-2-wood")
    direction = np.array(task.direction)
    across = np.array([-direction[1], direction[0]])
    angle_deg = math.degrees(math.atan2(*direction[::-1]))
    pictures, places = [], task.centre_px + np.outer([0.0, 90.0, 200.0], direction)
    for place in places:
        picture = np.full((480, 832, 3), 40, np.uint8)
        middle = place - 0.5 * share * task.size_px * across
        box = (middle.tolist(), (task.size_px, (1.0 + share) * task.size_px), angle_deg)
        cv2.fillPoly(picture, [cv2.boxPoints(box).round().astype(int)], (105, 150, 195))
        pictures.append(picture)
    follower = ShapeFollower(pictures[0], pictures[-1], task)
    found = [follower.candidates(picture)[0].place for picture in pictures]
    assert np.linalg.norm(found - places, axis=1).max() < 0.1 * task.size_px
