"""Times of frames: repeated pictures, rest that is no repeat, and times in a file."""

import numpy as np
import pytest

pytest.importorskip("cv2")

from clips import clip

from gauge_envs.tools.video import score
from gauge_envs.tools.video.frames import cadence_of

MOTION = np.r_[np.full(15, 3.0), np.linspace(20.0, 120.0, 30), np.full(15, 3.0)]


@pytest.mark.parametrize(
    ("source", "fps"), [(25.0, 30.0), (24.0, 30.0), (15.0, 30.0), (12.0, 60.0)]
)
def test_pictures_that_are_shown_again_are_left_out(source, fps):
    numbers = (np.arange(len(MOTION) * fps / source) * source / fps + 1e-9).astype(int)
    is_new = np.diff(numbers, prepend=-1) > 0
    differences = np.where(is_new, MOTION[numbers], 3.0)
    found = cadence_of(np.r_[np.inf, differences[1:]], fps)
    assert found.fps == pytest.approx(source)
    assert abs(int(found.is_new.sum()) - len(MOTION)) <= 1
    assert found.times_s[1] == pytest.approx(1.0 / source)
    assert "show the picture before again" in found.text


@pytest.mark.parametrize(
    "differences",
    [
        MOTION,
        np.full(60, 3.0),
        # Halts in motion, without a rhythm.
        np.where(np.isin(np.arange(60), (18, 22, 31, 40)), 2.0, 60.0),
    ],
)
def test_a_body_at_rest_repeats_no_pictures(differences):
    found = cadence_of(np.r_[np.inf, differences], 30.0)
    assert found.is_new.all()
    assert found.fps == pytest.approx(30.0)
    assert not found.text


def test_times_in_a_file_are_used_unless_they_are_damaged():
    still = np.full(40, 3.0)
    uneven_s = np.cumsum(np.where(np.arange(40) % 7 == 3, 0.05, 1 / 30))
    found = cadence_of(still, 30.0, uneven_s)
    assert found.times_s == pytest.approx(uneven_s - uneven_s[0])
    damaged = cadence_of(still, 30.0, uneven_s[::-1])
    assert damaged.times_s == pytest.approx(np.arange(40) / 30)


@pytest.mark.parametrize(
    ("task", "seed", "metric", "margin"),
    [
        ("SlopeSlider-2-metal", 11, "acceleration_m_s2", {"rel": 0.02}),
        # Counted as pictures that differ, they give 0.09 N.
        ("Turntable-2-metal", 3, "de", {"abs": 0.01}),
    ],
)
def test_25_pictures_shown_at_30_give_the_true_value(task, seed, metric, margin):
    one = clip(task, np.random.default_rng(seed), fps=25.0)
    is_repeated = np.arange(len(one.frames)) % 5 == 4
    frames = np.repeat(np.asarray(one.frames), 1 + is_repeated, axis=0)
    result = score(frames, 30.0, one.task)
    assert result.is_sound, result.reasons
    assert result.findings[0].startswith("1 of every 6 frames show the picture before")
    assert result.metrics[metric] == pytest.approx(one.truth[metric], **margin)
