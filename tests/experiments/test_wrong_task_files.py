"""A scene that cannot be built, and a wrong experiment file, are errors when they are loaded."""

import shutil

import pytest
from places import ROOT

from gauge_envs import load_experiment_file
from gauge_envs.errors import ReferenceFileError, TaskFileError
from gauge_envs.experiments.task_files import load_task
from gauge_envs.experiments.variants import task_path

EXAMPLE = ROOT / "examples" / "usd_experiment"


def test_a_scene_that_cannot_be_built_is_found(tmp_path):
    text = task_path("SlopeSlider").read_text()
    file = tmp_path / "slope_slider.toml"
    file.write_text(text.replace('board = "kinematic"', 'board = "dynamic"'))
    assert file.read_text() != text
    with pytest.raises(
        TaskFileError,
        match=r"slope_slider\.toml: drivers: 'board' is driven but dynamic",
    ):
        load_task(file)


# --- experiment files ------------------------------------------------------------------------------------------------


@pytest.fixture
def crate(tmp_path):
    """A copy of the example."""
    shutil.copytree(EXAMPLE, tmp_path / "example")
    return tmp_path / "example" / "crate.toml"


@pytest.mark.parametrize("frames", [18_001, 10**9, 10**30])
def test_the_number_of_frames_is_limited(frames, crate):
    lines = [
        line if not line.startswith("frames") else f"frames = {frames}"
        for line in crate.read_text().splitlines()
    ]
    crate.write_text("\n".join(lines))
    with pytest.raises(TaskFileError, match=r"crate\.toml: frames: "):
        load_experiment_file(crate)


def test_a_number_that_python_cannot_write_is_an_error(crate):
    crate.write_text(
        crate.read_text().replace("frames = ", f"frames = 0x{'f' * 9000} # ")
    )
    with pytest.raises(TaskFileError, match=r"crate\.toml: frames: "):
        load_experiment_file(crate)


def test_an_error_of_a_band_prints_no_text_of_the_file(crate, tmp_path):
    private = tmp_path / "private.csv"
    private.write_text("root:secret:0,frame\n1,2\n")
    band = next(
        line for line in crate.read_text().splitlines() if line.startswith("file = ")
    )
    crate.write_text(crate.read_text().replace(band, f'file = "{private}"'))
    with pytest.raises(ReferenceFileError) as caught:
        load_experiment_file(crate)
    assert "expected columns frame" in str(caught.value) and "secret" not in str(
        caught.value
    )
