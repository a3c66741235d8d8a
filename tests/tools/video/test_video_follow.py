"""The tracker follows only the object, and reports planted faults of a film."""

from functools import cache

import numpy as np
import pytest

cv2 = pytest.importorskip("cv2")

from clips import clip, scored  # noqa: E402

from gauge_envs.tools.video import video_task  # noqa: E402
from gauge_envs.tools.video.shape import Detection, ShapeDetector  # noqa: E402
from gauge_envs.tools.video.soundness import MAX_MISFIT  # noqa: E402
from gauge_envs.tools.video.tracker import followed  # noqa: E402

BALL = video_task("BouncingBall-rubber")
SLIDE, PLASTIC = "SlopeSlider-2-wood", "Turntable-2-plastic"
ROWS, COLUMNS = np.mgrid[:480, :832]


def seen(x_px, y_px=0.0, likeness=0.7):
    return Detection(np.add(BALL.centre_px, [x_px, y_px]), likeness)


# --- which detection is the object ------------------------------------------------------------------------------------


def test_the_tracker_ignores_distant_places_and_bridges_a_gap():
    frames = [[seen(4.0 * number)] for number in range(20)]
    for number in range(8, 11):
        frames[number].append(seen(150.0, likeness=0.95))
    frames[12:17] = [[]] * 5
    places_px = 4.0 * np.arange(20)
    places_px[12:17] = np.nan
    path = followed(frames, BALL, 30.0)
    found_px = [detection.place_px[0] - BALL.centre_px[0] for detection in path]
    assert found_px == pytest.approx(places_px, nan_ok=True)


def test_a_ball_is_followed_through_its_impact():
    times_s = np.arange(20) / 30.0 - 0.31
    gravity_px_s2 = 9.81 / BALL.scale_m_per_px
    falls_px = 0.5 * gravity_px_s2 * (0.31**2 - (times_s + 0.31) ** 2)
    rises_px = gravity_px_s2 * times_s * (0.31 * 0.8 - 0.5 * times_s)
    heights_px = np.where(times_s < 0.0, falls_px, rises_px)
    frames = [[seen(0.0, heights_px[0] - height)] for height in heights_px]
    lost = [detection.likeness == 0.0 for detection in followed(frames, BALL, 30.0)]
    assert sum(lost) <= 2, lost


# --- size, shape and place --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "size", "is_same"),
    [
        ("none", 1.4, False),
        ("smeared", 1.0, True),
        ("melted", 1.0, False),
    ],
)
def test_motion_blur_keeps_the_size_and_shape_of_an_object(change, size, is_same):
    bare = np.full((480, 832, 3), 200, np.uint8)
    down_px, right_px = ROWS - BALL.centre_px[1], COLUMNS - BALL.centre_px[0]
    radius_px = 0.5 * BALL.size_px
    first, later = bare.copy(), bare.copy()
    first[np.hypot(down_px, right_px) < radius_px] = 25
    wide = 1.7 if change == "melted" else 1.0
    away_px = np.hypot(down_px * wide, right_px / wide)
    later[away_px < size * radius_px] = 25
    if change == "smeared":
        later = cv2.blur(later, (1, 45))
    (detection, *_) = ShapeDetector(first, bare, BALL).candidates(later)
    assert (detection.misfit < MAX_MISFIT) is is_same


def test_visible_dark_sides_do_not_shift_the_face_of_a_black_cube():
    task = video_task("SlopeSlider-2-plastic")
    places_px = task.centre_px + np.outer([0.0, 60.0, 100.0, 140.0], task.direction)
    corners_px = cv2.boxPoints(((0.0, 0.0), (task.size_px,) * 2, -31.6))
    depth = 0.04
    pictures = []
    for place in places_px:
        picture = np.full((480, 832, 3), 200, np.uint8)
        face = corners_px + place
        # In a pinhole camera, the back of the cube is smaller and nearer to the centre of the picture.
        back = (face + depth * np.array([416.0, 240.0])) / (1.0 + depth)
        hull = cv2.convexHull(np.rint(16.0 * np.vstack([face, back])).astype(int))
        cv2.fillConvexPoly(picture, hull, (20,) * 3, cv2.LINE_AA, 4)
        pictures.append(picture)
    detector = ShapeDetector(pictures[0], pictures[-1], task)
    found_px = [detector.candidates(picture)[0].place_px for picture in pictures]
    along_px = (found_px - places_px) @ task.direction
    # Without a correction for the sides, the displacement would be 2 % too short.
    assert np.abs(along_px).max() < 0.6


# --- planted faults ---------------------------------------------------------------------------------------------------


@cache
def film(task):
    return clip(task, np.random.default_rng(0))


def empty(frames):
    """Return the scene without the cube; it slides from the right half to the left half."""
    return np.hstack([frames[0][:, :400], frames[-1][:, 400:]])


def second(frames):
    patch = frames[0][3:103, 557:657]
    for frame in frames[14:]:
        frame[100:200, 100:200] = patch
    return frames


def replaced(frames):
    scene = empty(frames).astype(int)
    for frame in frames[20:]:
        frame[np.abs(frame - scene).max(axis=2) > 60] = (60, 200, 90)
    return frames


def vanished(frames):
    return [*frames[:20], *[empty(frames)] * 20]


def mirrored(frames):
    return [np.ascontiguousarray(frame[:, ::-1]) for frame in frames]


def cut(frames):
    return [*frames[:20], *[255 - frame for frame in frames[20:]]]


def missing(frames):
    return [*frames[:18], *frames[20:]]


def zoomed(frames):
    zooms = [
        cv2.getRotationMatrix2D((416, 240), 0.0, 1.0 + 0.001 * number)
        for number in range(len(frames))
    ]
    return [
        cv2.warpAffine(frame, zoom, (832, 480))
        for frame, zoom in zip(frames, zooms, strict=True)
    ]


FAULTS = [
    (SLIDE, second, "a second object of the same shape and colour is visible in"),
    pytest.param(SLIDE, replaced, "changes its look", marks=pytest.mark.slow),
    pytest.param(SLIDE, vanished, "vanishes after frame", marks=pytest.mark.slow),
    pytest.param(SLIDE, zoomed, "the camera moves from frame", marks=pytest.mark.slow),
    pytest.param(SLIDE, mirrored, "from its place", marks=pytest.mark.slow),
    (SLIDE, cut, "the camera moves from frame 20"),
    (SLIDE, missing, "frames seem to be missing, 2 before frame 18"),
]


@pytest.mark.parametrize("task", [SLIDE, pytest.param(PLASTIC, marks=pytest.mark.slow)])
def test_the_film_without_a_fault_is_sound(task):
    assert scored(film(task).frames, film(task).fps, task).is_sound


@pytest.mark.parametrize(("task", "fault", "words"), FAULTS)
def test_a_planted_fault_is_reported(task, fault, words):
    frames = fault([frame.copy() for frame in film(task).frames])
    result = scored(frames, film(task).fps, task)
    assert not result.is_sound
    assert any(words in reason for reason in result.reasons), result.reasons
