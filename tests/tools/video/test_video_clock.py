"""The clock of a motion: missing frames and a changed speed of the film are named, and smooth motions are not."""

import numpy as np
import pytest

pytest.importorskip("cv2")

from clips import motion_on_grid, track_of

from gauge_envs.tools.video import score_track, video_task

FPS = 30.0
BALL = video_task("BouncingBall-rubber")


def judged(name, clock, seed):
    """Score the track of a known motion, whose frame numbers a clock changes to those that are shown."""
    rng = np.random.default_rng(seed)
    place, _, duration_s = motion_on_grid(video_task(name), rng)
    numbers = clock(np.arange(int(duration_s * FPS)))
    places = np.array([place(number / FPS)[0] for number in numbers])
    places += rng.normal(0.0, 0.1, places.shape)
    return score_track(track_of(places, FPS), video_task(name))


CLOCKS = {
    "": lambda frames: frames,
    "a frame seems to be shown again ": lambda frames: np.r_[frames[:24], frames[23:]],
    "frames seem to be missing, 3 ": lambda frames: frames[frames // 3 != 8],
    "seems to change by 2 ": lambda frames: np.r_[frames[:23], frames[23::2]],
}


@pytest.mark.parametrize("words", CLOCKS)
@pytest.mark.parametrize(
    ("name", "seed"), [("SlopeSlider-2-wood", 4), ("Turntable-2-metal", 3)]
)
def test_a_clock_that_is_not_that_of_the_motion_is_named(name, seed, words):
    result = judged(name, CLOCKS[words], seed)
    assert result.is_sound is (words == ""), result.reasons
    assert words in " ".join(result.reasons)


def test_a_jerky_motion_is_no_change_of_speed():
    """By chance, some of its windows fit a film that is slower from there on."""
    rng = np.random.default_rng(21)
    place, *_ = motion_on_grid(BALL, np.random.default_rng(1))
    numbers = np.arange(51) + rng.uniform(-0.4, 0.4, 51)
    places_px = np.array([place(number / 60.0)[0] for number in numbers])
    result = score_track(track_of(places_px, 60.0), BALL)
    assert result.is_sound, result.reasons
