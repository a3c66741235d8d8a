"""Registration of stretched, cropped, padded or moved first frames, and the score of a cropped clip."""

from functools import cache

import numpy as np
import pytest

cv2 = pytest.importorskip("cv2")

from clips import clip, scored  # noqa: E402

from gauge_envs.tools.video import video_task  # noqa: E402
from gauge_envs.tools.video.frames import (  # noqa: E402
    UNSEEN,
    registration_by_outline,
)

LAYOUTS = {
    # Scales and offsets from the picture to the grid, and size of the video.
    "stretch": (1.0, 480 / 464, 0.0, 0.0, (832, 464)),
    "crop": (6 / 7, 6 / 7, (832 - 752 * 6 / 7) / 2, 0.0, (752, 560)),
    "pad": (832 / 1080, 832 / 1080, 0.0, (480 - 1920 * 832 / 1080) / 2, (1080, 1920)),
}


@cache
def first_picture(task):
    return clip(task, np.random.default_rng(1), fps=5.0).frames[0]


def laid_out(picture, method):
    scale_x, scale_y, x_px, y_px, size = LAYOUTS[method]
    scale, offset = np.array([scale_x, scale_y]), np.array([x_px, y_px])
    matrix = np.column_stack([np.diag(1.0 / scale), (0.5 - offset) / scale - 0.5])
    return cv2.warpAffine(picture, matrix, size)


@pytest.mark.parametrize("method", LAYOUTS)
@pytest.mark.parametrize("task", ["SlopeSlider-2-wood", "NewtonsCradle-metal"])
def test_the_outline_determines_the_layout_of_a_picture(task, method):
    picture = laid_out(first_picture(task), method)
    registration = registration_by_outline(picture, video_task(task))
    assert not registration.problem
    assert registration.method == method
    numbers = (
        registration.scale_x,
        registration.scale_y,
        registration.offset_x_px,
        registration.offset_y_px,
    )
    assert numbers == pytest.approx(LAYOUTS[method][:4], abs=1e-3)


@pytest.mark.parametrize("task", ["BouncingBall-rubber", "Turntable-2-metal"])
def test_an_object_at_another_place_is_doubtful(task):
    picture = cv2.resize(first_picture(task), None, fx=1.2, fy=1.2)[10:500, 50:930]
    moved = np.ascontiguousarray(picture)
    assert registration_by_outline(moved, video_task(task)).problem == UNSEEN


@pytest.mark.slow
def test_a_cropped_clip_gives_the_true_acceleration():
    film = clip("SlopeSlider-2-metal", np.random.default_rng(11))
    frames = [laid_out(frame, "crop") for frame in film.frames]
    result = scored(frames, film.fps, film.task)
    assert result.is_sound, result.reasons
    assert result.to_dict()["registration"]["method"] == "crop"
    truth = film.truth["acceleration_m_s2"]
    assert result.metrics["acceleration_m_s2"] == pytest.approx(truth, rel=0.02)
