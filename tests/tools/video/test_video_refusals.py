"""Hostile or damaged tracks, films and options of the video commands end in an error for people."""

import numpy as np
import pytest

cv2 = pytest.importorskip("cv2")

from gauge_envs.errors import GaugeError, UnknownNameError, VideoError  # noqa: E402
from gauge_envs.tools.video import read_track, score, video_task  # noqa: E402
from gauge_envs.tools.video.frames import FileFrames  # noqa: E402

HUGE = "9" * 400
"""An integer that no floating-point number holds."""

# What is written to a file, how it is read, and the place and the fault in the words of the error.
TRACKS = [
    ("frame,x,y\n1e11,1,2\n", "line 2: frame: .*less than or equal to 1000000000"),
    (f"frame,x,y\n{HUGE},1,2\n", "line 2: frame: .*less than or equal to"),
    ("frame,x,y\n1,2," + "3" * 200_000, "it is no CSV: "),
    ("frame,x,y\n\x001,2,3", "it is no CSV: |valid number"),
    ("\x00", "there is no row|it is no CSV"),
    ("frame,x\n0,1\n", "no column y"),
    ("frame,x,y\n0,1,abc\n", "line 2: y: .*given: 'abc'"),
    ("frame,x,y\n0.5,1,1\n", "line 2: frame: .*multiple of 1"),
    ("frame,x,y\n3,1,1\n3,1,1\n", "frame must increase"),
    ("time,x,y\n0.1,1,1\n0,1,1\n", "time must increase"),
    ("x_mm,y_mm\n1,1\n", "no column time"),
    ("time,y,x\n0,1,1\n", "its times state the rate"),
    ("frame,x,y\n", "no row"),
    ("frame,x,y\n0,inf,1\n", "line 2: x: .*given: 'inf'"),
    ("frame,x,y\n0,1,1\n,1,1\n", "frame must increase"),
    ("frame,x,y\n0,1,5,1\n", "line 2 has more cells"),
    ("frame,x,y\n0,1,481\n", "leave the picture of 832 x 480 pixels"),
    ("frame,x,y,size\n0,1,1,0\n", "line 2: size: .*greater than 0"),
    ("frame,x,y,confidence\n0,1,1,60\n", "line 2: confidence: .*equal to 1"),
]


def tracked(file):
    text = file.read_text() if file.exists() else ""
    return read_track(file, fps=None if text.startswith("time,x,") else 30.0)


@pytest.mark.parametrize(
    ("name", "read", "content", "words"),
    [
        *(("track.csv", tracked, *row) for row in TRACKS),
        ("text.mp4", FileFrames, "no video\n" * 100, "it is a text and no video"),
        (
            "list.mp4",
            FileFrames,
            "ffconcat version 1.0\nfile other.mp4\n",
            "it is a text and no video",
        ),
        ("zeros.mp4", FileFrames, "\0" * 1000, "OpenCV cannot decode it"),
        ("none.mp4", FileFrames, None, "there is no such file"),
        (".", FileFrames, None, "it is a folder"),
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
        ((0, 480, 832, 3), 30.0, "no frame"),
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


def test_a_film_of_a_track_is_refused(tmp_path, gauge):
    (tmp_path / "track.csv").write_text("frame,x,y\n1,2,3\n")
    words = "score track.csv --id SlopeSlider-2-wood --fps=30 --out drawn"
    result = gauge("video", *words.split())
    assert (result.exit_code, result.stdout) == (2, "")
    assert "--out needs the video" in result.stderr
