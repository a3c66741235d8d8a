"""Hostile or damaged tracks, camera files, films and options of the video commands end in an error for people."""

import numpy as np
import pytest
from approval import refused_commands

cv2 = pytest.importorskip("cv2")

from gauge_envs.errors import GaugeError, UnknownNameError, VideoError  # noqa: E402
from gauge_envs.tools.video import read_track, score, video_task  # noqa: E402
from gauge_envs.tools.video.frames import FileFrames  # noqa: E402
from gauge_envs.tools.video.plane import read_camera  # noqa: E402

HUGE = "9" * 400
"""An integer that no floating-point number holds."""

SIZE = "size_px = [1280, 720]\n"
CAMERA = SIZE + "[board]\nsquare_m = 0.035\noffset_m = 0.01\n"

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
CAMERAS = [
    (SIZE, "board: missing key"),
    (SIZE + "[board]\nsquare_m = 0.035\n", "board.offset_m: missing key"),
    (SIZE + "[board]\noffset_m = 0\nsquare_m = 0\n", "board.square_m: .*given: 0"),
    (SIZE + "[board]\noffset_m = 0\nsquare_m = 30\n", "board.square_m: .*given: 30"),
    (SIZE + "[board]\nsquare = 0.035\n", "board.square_m: missing key"),
    (CAMERA + "sigma = 1\n", "board.sigma: unknown key"),
    (CAMERA + "[motion]\npivot_m = [0.1, 0.2]\n", "pivot_sigma_m go together"),
    (
        CAMERA + "[lens]\nmatrix = [[1, 0, 9], [0, 1, 9], [0, 0, 2]]\n",
        "lens.matrix: .*no camera matrix",
    ),
    ("size_px = [1280", "Unclosed array"),
    ("a = " + "[" * 5000, "nested too deeply"),
    ("a." * 5000 + "b = 1", "dots between two delimiters"),
    (CAMERA.replace("1280", HUGE), "size_px.0: "),
    (CAMERA.replace("0.01", HUGE), "board.offset_m: "),
]


def tracked(file):
    text = file.read_text() if file.exists() else ""
    return read_track(file, fps=None if text.startswith("time,x,") else 30.0)


@pytest.mark.parametrize(
    ("name", "read", "content", "words"),
    [
        *(("track.csv", tracked, *row) for row in TRACKS),
        *(("camera.toml", read_camera, *row) for row in CAMERAS),
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


WRONG = """
video board board.jpg
video score track.csv --id SlopeSlider-2-wood --fps=30 --out drawn
video score film.mp4 --id SlopeSlider-2-wood --camera camera.toml
video score track.csv --id SlopeSlider-2-wood --fps=30 --camera camera.toml
"""


def test_wrong_options_are_named(tmp_path, gauge, approved):
    (tmp_path / "track.csv").write_text("frame,x,y\n1,2,3\n")
    (tmp_path / "camera.toml").write_text(CAMERA)
    boxes = [
        f"film.mp4 --id slide --object={box}" for box in ("1,2,3", "1,2,0,4", "a,b,c,d")
    ]
    scores = [f"video score {words}" for words in boxes]
    commands = [*WRONG.strip().splitlines(), *scores]
    approved("video/wrong_options", refused_commands(gauge, *commands))
