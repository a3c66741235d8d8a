"""Hostile tracks, camera files and outputs of the video commands end in an error for people."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from gauge_envs.cli.app import app
from gauge_envs.errors import VideoError
from gauge_envs.tools.video import read_camera, read_track

CAMERA = "size_px = {size}\n[points]\npx = {px}\nm = {px}\nsigma_px = {sigma}\nsigma_m = 0.001\n"
POINTS = "[[400, 600], [900, 600], [800, 300], [500, 300]]"
HUGE = "9" * 400
"""An integer that no floating-point number holds."""


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("frame,x,y\n1e300,1,2\n", "a whole number from 0 to 1000000000"),
        (f"frame,x,y\n{HUGE},1,2\n", "must be a finite number"),
        ("frame,x,y\n1,2," + "3" * 200_000, "it is no CSV: "),
        ("frame,x,y\n\x001,2,3", "it is no CSV: |finite number"),
        ("\x00", "there is no column|it is no CSV"),
    ],
)
def test_a_damaged_track_is_an_error(text: str, reason: str, tmp_path: Path) -> None:
    file = tmp_path / "track.csv"
    file.write_text(text, newline="")
    with pytest.raises(VideoError, match=reason) as caught:
        read_track(file, fps=30.0)
    assert str(file) in str(caught.value)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("a = " + "[" * 5000, "nested too deeply"),
        ("a." * 5000 + "b = 1", "dots between two delimiters"),
        (CAMERA.format(size=f"[{HUGE}, 1]", px=POINTS, sigma=0.5), "size_px.0: "),
        (
            CAMERA.format(size="[1280, 720]", px=f"[[{HUGE}, 1]]", sigma=0.5),
            "points.px.0.0: ",
        ),
        (CAMERA.format(size="[1280, 720]", px=POINTS, sigma=HUGE), "points.sigma_px: "),
    ],
)
def test_a_damaged_camera_file_is_an_error(
    text: str, reason: str, tmp_path: Path
) -> None:
    file = tmp_path / "camera.toml"
    file.write_text(text)
    with pytest.raises(VideoError, match=reason):
        read_camera(file)


def test_a_camera_in_json_is_not_nested_without_end(tmp_path: Path) -> None:
    (tmp_path / "camera.json").write_text("[" * 100_000)
    with pytest.raises(VideoError, match="nested too deeply"):
        read_camera(tmp_path / "camera.json")


@pytest.mark.parametrize("size", ["\u00b2x2", "0x4", "4x", "9999999x4", "4x4x4"])
def test_a_size_is_two_numbers(size: str, tmp_path: Path) -> None:
    (tmp_path / "track.csv").write_text("frame,x,y\n1,2,3\n")
    options = ["--id", "SlopeSlider-2-wood", "fps=30", f"size={size}"]
    result = CliRunner().invoke(
        app, ["video", "score", str(tmp_path / "track.csv"), *options]
    )
    assert result.exit_code == 2 and "give width and height in pixels" in result.stderr
