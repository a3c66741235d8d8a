"""Registration of first frames that are stretched, cropped, padded or moved, and clips that are scored through it."""

from functools import cache

import numpy as np
import pytest

cv2 = pytest.importorskip("cv2")

from clips import clip  # noqa: E402

from gauge_envs.tools.video import score, video_task, video_tasks  # noqa: E402
from gauge_envs.tools.video.frames import (  # noqa: E402
    Registration,
    stretched,
)
from gauge_envs.tools.video.registration import (  # noqa: E402
    UNSEEN,
    registration_by_outline,
)

TASKS = [task.id for task in video_tasks()]

LAYOUTS = {
    # Name of the method, scales and offsets that bring the picture back to the grid.
    "stretch": (1.0, 480 / 464, 0.0, 0.0),
    "crop": (6 / 7, 6 / 7, (832 - 752 * 6 / 7) / 2, 0.0),
    "pad": (832 / 1080, 832 / 1080, 0.0, (480 - 1920 * 832 / 1080) / 2),
}


@cache
def first_picture(task, seed=1):
    frame = clip(task, np.random.default_rng(seed), fps=5.0).frames[0]
    return np.ascontiguousarray(frame[:, :, ::-1])


def laid_out(picture, method):
    if method == "stretch":
        return np.asarray(cv2.resize(picture, (832, 464), interpolation=cv2.INTER_AREA))
    sizes = {"crop": (752, 560), "pad": (1080, 1920)}
    scale_x, scale_y, x, y = LAYOUTS[method]
    matrix = np.array(
        [[1 / scale_x, 0.0, -x / scale_x], [0.0, 1 / scale_y, -y / scale_y]]
    )
    matrix[:, 2] += 0.5 * np.diag(matrix[:, :2]) - 0.5
    return np.asarray(cv2.warpAffine(picture, matrix, sizes[method]))


def numbers(one):
    return one.scale_x, one.scale_y, one.offset_x_px, one.offset_y_px


@pytest.mark.parametrize(
    ("task", "method"),
    [
        pytest.param(
            task,
            method,
            marks=() if (number - place) % len(LAYOUTS) == 0 else pytest.mark.slow,
        )
        for number, task in enumerate(TASKS)
        for place, method in enumerate(LAYOUTS)
    ],
)
def test_the_outline_tells_how_a_picture_was_laid_out(task, method):
    found = registration_by_outline(
        laid_out(first_picture(task), method), video_task(task)
    )
    assert not found.problem
    assert found.method == method
    assert numbers(found) == pytest.approx(LAYOUTS[method], abs=1e-3)


@pytest.mark.parametrize(
    "task",
    [
        "BouncingBall-rubber",
        "NewtonsCradle-metal",
        "Pendulum-metal",
        "Turntable-2-metal",
    ],
)
def test_an_object_at_another_place_is_doubtful(task):
    picture = first_picture(task)
    moved = np.ascontiguousarray(
        cv2.resize(picture, None, fx=1.2, fy=1.2)[10:500, 50:930]
    )
    assert registration_by_outline(moved, video_task(task)).problem == UNSEEN


@pytest.mark.parametrize("factor", [1.0, 2.5])
def test_a_registration_puts_pixels_where_it_says(factor):
    picture = np.zeros((round(560 * factor), round(752 * factor), 3), np.uint8)
    cv2.circle(
        picture,
        (round(300 * factor), round(200 * factor)),
        round(20 * factor),
        (255, 255, 255),
        -1,
    )
    x, y = (np.array([300, 200]) * factor).round() + 0.5
    scale = 6 / 7 / factor
    grid = Registration(
        scale_x=scale,
        scale_y=scale,
        offset_x_px=93.7,
        offset_y_px=2.0,
        method="pad",
    ).applied(picture)
    rows, columns = np.nonzero(grid[:, :, 0] > 127)
    assert (columns.mean() + 0.5, rows.mean() + 0.5) == pytest.approx(
        (x * scale + 93.7, y * scale + 2.0), abs=0.1
    )


def test_the_plain_registration_is_the_scaling_of_both_axes():
    picture = first_picture("SlopeSlider-2-wood")
    assert (stretched((832, 480)).applied(picture) == picture).all()


def test_a_cropped_clip_gives_the_true_acceleration():
    one = clip("SlopeSlider-2-metal", np.random.default_rng(11))
    frames = [laid_out(np.ascontiguousarray(frame), "crop") for frame in one.frames]
    result = score(frames, one.fps, one.task)
    assert result.is_sound, result.reasons
    assert result.to_dict()["registration"]["method"] == "crop"
    assert result.metrics["acceleration_m_s2"] == pytest.approx(
        one.truth["acceleration_m_s2"], rel=0.02
    )
