"""Hostile or damaged tracks, films and options of the video commands end in an error for people."""

import numpy as np
import pytest

cv2 = pytest.importorskip("cv2")

from gauge_envs.errors import GaugeError, UnknownNameError, VideoError  # noqa: E402
from gauge_envs.tools.video import read_track, score, video_task  # noqa: E402
from gauge_envs.tools.video.frames import FileFrames  # noqa: E402

# What is written to a file, and the place and the fault in the words of the error.
TRACKS = [
    ("frame,x,y\n1e11,1,2\n", "line 2: frame is '1e11'; it must be a number from 0 to"),
    ("frame,x,y\n1,2," + "3" * 200_000, "it is no CSV: "),
    ("\x00", "there is no row|it is no CSV"),
    ("frame,x\n0,1\n", "no column y"),
    ("frame,x,y\n0,1,abc\n", "line 2: y is 'abc'; it must be a number"),
    ("frame,x,y\n0.5,1,1\n", "frame must increase from row to row, by integers"),
    ("frame,x,y\n3,1,1\n3,1,1\n", "frame must increase"),
    ("time,x,y\n0.1,1,1\n0,1,1\n", "time must increase"),
    ("x_mm,y_mm\n1,1\n", "no column time"),
    ("time,y,x\n0,1,1\n", "its times state the rate"),
    ("frame,x,y\n", "no row"),
    ("frame,x,y\n0,inf,1\n", "line 2: x is 'inf'"),
    ("frame,x,y\n0,1,481\n", "leave the picture of 832 x 480 pixels"),
    ("frame,x,y,confidence\n0,1,1,60\n", "line 2: confidence is '60'; .* from 0 to 1"),
]


def tracked(file):
    text = file.read_text() if file.exists() else ""
    return read_track(file, fps=None if text.startswith("time,x,") else 30.0)


@pytest.mark.parametrize(
    ("name", "read", "content", "words"),
    [
        *(("track.csv", tracked, *row) for row in TRACKS),
        ("text.mp4", FileFrames, "no video\n" * 100, "OpenCV cannot decode it"),
        ("zeros.mp4", FileFrames, "\0" * 1000, "OpenCV cannot decode it"),
        ("none.mp4", FileFrames, None, "there is no such file"),
        (".", FileFrames, None, "there is no such file"),
    ],
)
def test_a_damaged_file_is_an_error_that_names_it(name, read, content, words, tmp_path):
    file = tmp_path / name
    if content is not None:
        file.write_text(content, newline="")
    with pytest.raises(GaugeError, match=words) as caught:
        read(file)
    assert str(file) in str(caught.value)


@pytest.mark.parametrize(
    ("shape", "fps", "words"),
    [
        ((0, 480, 832, 3), 30.0, "0 frames"),
        ((5, 480, 832, 3), 30.0, "5 frames"),
        ((12, 480, 832, 3), 1.0, "1 frames per second"),
        ((12, 480, 832), 30.0, "shape"),
    ],
)
def test_frames_that_cannot_be_judged_are_errors(shape, fps, words):
    with pytest.raises(VideoError, match=words):
        score(np.zeros(shape, dtype=np.uint8), fps, "SlopeSlider-2-wood")


def test_an_unknown_task_is_an_error():
    with pytest.raises(UnknownNameError, match="SlopeSlider-2-wood"):
        video_task("SlopeSlider-2-woof")
