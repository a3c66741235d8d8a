"""Times of frames: repeated pictures, rest that is no repeat, stated times, and files that are cut off."""

import subprocess

import numpy as np
import pytest

cv2 = pytest.importorskip("cv2")

from clips import clip, written  # noqa: E402

from gauge_envs.errors import VideoError  # noqa: E402
from gauge_envs.tools.video import score  # noqa: E402
from gauge_envs.tools.video.frames import FileFrames, cadence_of  # noqa: E402
from gauge_envs.tools.video.tasks import video_task  # noqa: E402
from gauge_envs.tools.video.tracker import track_object  # noqa: E402


def shown(motion, source_fps, fps):
    """Return differences of frames that show the latest picture of a source with these differences."""
    count = int(len(motion) * fps / source_fps)
    pictures = (np.arange(count) * source_fps / fps + 1e-9).astype(int)
    differences = np.where(
        np.diff(pictures, prepend=-1) > 0,
        motion[np.minimum(pictures, len(motion) - 1)],
        3.0,
    )
    differences[0] = np.inf
    return np.asarray(differences)


MOTION = np.r_[np.full(15, 3.0), np.linspace(20.0, 120.0, 30), np.full(15, 3.0)]


@pytest.mark.parametrize(
    ("source", "fps"),
    [(25.0, 30.0), (24.0, 30.0), (15.0, 30.0), (24.0, 60.0), (12.0, 60.0)],
)
def test_pictures_that_are_shown_again_are_left_out(source, fps):
    found = cadence_of(shown(MOTION, source, fps), fps)
    assert found.fps == pytest.approx(source)
    assert abs(int(found.is_new.sum()) - len(MOTION)) <= 1
    assert found.times_s[1] == pytest.approx(1.0 / source)
    assert "show the picture before again" in found.text


@pytest.mark.parametrize(
    "differences",
    [
        MOTION,
        np.full(60, 3.0),
        np.r_[np.full(6, 3.0), 25.0, np.full(53, 3.0)],
        np.r_[MOTION, MOTION],
        # Halts in motion, without a rhythm.
        np.where(np.isin(np.arange(60), (18, 22, 31, 40)), 2.0, 60.0),
    ],
)
def test_a_body_at_rest_repeats_no_pictures(differences):
    found = cadence_of(np.r_[np.inf, differences], 30.0)
    assert found.is_new.all()
    assert found.fps == 30.0
    assert not found.text


def test_pictures_that_are_repeated_at_random_leave_the_times_unknown():
    rng = np.random.default_rng(3)
    moving = np.r_[np.inf, np.full(59, 60.0) + rng.normal(0.0, 5.0, 59)]
    halted = np.where(rng.random(60) < 0.14, 1.0, moving)
    assert "so that times are unknown" in cadence_of(halted, 30.0).fault
    assert not cadence_of(moving, 30.0).fault


def test_a_codec_that_opencv_lacks_is_decoded(tmp_path):
    program = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    source = ["-f", "lavfi", "-i", "testsrc=size=320x240:rate=24:duration=0.5"]
    coded = ["-c:v", "libaom-av1", "-cpu-used", "8", tmp_path / "av1.mp4"]
    subprocess.run([program, "-v", "error", *source, *coded], check=True)
    frames = FileFrames(tmp_path / "av1.mp4")
    assert frames.fps == 24.0 and sum(1 for _ in frames.native()) == 12


def test_stated_times_are_used_where_they_are_not_uniform():
    still = np.full(40, 3.0)
    uneven = np.cumsum(np.where(np.arange(40) % 7 == 3, 0.05, 1 / 30))
    found = cadence_of(still, 30.0, uneven)
    assert found.times_s == pytest.approx(uneven - uneven[0])
    assert "the times that the file states are used" in found.text
    rounded = cadence_of(still, 30.0, np.round(np.arange(40) / 30, 3))
    assert rounded.times_s == pytest.approx(np.arange(40) / 30)
    # Times that go back are damaged.
    assert not cadence_of(still, 30.0, uneven[::-1]).text


@pytest.mark.parametrize(
    ("task", "seed", "metric", "margin"),
    [
        ("SlopeSlider-2-metal", 11, "acceleration_m_s2", {"rel": 0.02}),
        # Counted as pictures of their own, they give 0.09 N.
        pytest.param(
            *("Turntable-2-metal", 3, "de", {"abs": 0.01}), marks=pytest.mark.slow
        ),
    ],
)
def test_25_pictures_shown_at_30_give_the_true_value(task, seed, metric, margin):
    one = clip(task, np.random.default_rng(seed), fps=25.0)
    shown_often = np.arange(len(one.frames)) % 5 == 4
    frames = np.repeat(np.asarray(one.frames), 1 + shown_often, axis=0)
    result = score(frames, 30.0, one.task)
    assert result.is_sound, result.reasons
    assert result.findings[0].startswith(
        "1 of every 6 frames show the picture before again"
    )
    assert result.metrics[metric] == pytest.approx(one.truth[metric], **margin)


def test_files_that_are_cut_off_are_named(tmp_path):
    one = clip("SlopeSlider-2-metal", np.random.default_rng(11), fps=12.0)
    written(one, tmp_path / "whole.avi", "MJPG")
    written(one, tmp_path / "whole.mp4")
    packed = (tmp_path / "whole.avi").read_bytes()
    (tmp_path / "cut.avi").write_bytes(packed[: int(0.7 * len(packed))])
    (tmp_path / "short.avi").write_bytes(packed[: int(0.1 * len(packed))])
    reasons = score(tmp_path / "cut.avi", None, one.task).reasons
    assert any(
        f"states {len(one.frames)} frames, and" in reason for reason in reasons
    ), reasons
    with pytest.raises(
        VideoError,
        match=f"that can be decoded, of the {len(one.frames)} that it states",
    ):
        track_object(FileFrames(tmp_path / "short.avi"), video_task(one.task))
    # An MP4 holds its table of contents at the end.
    packed = (tmp_path / "whole.mp4").read_bytes()
    (tmp_path / "cut.mp4").write_bytes(packed[: len(packed) // 2])
    with pytest.raises(VideoError, match="cannot decode it"):
        FileFrames(tmp_path / "cut.mp4")
