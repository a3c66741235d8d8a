"""A damaged file gives an error of the package with the name of the file."""

from __future__ import annotations

import io
import json
import shutil

import numpy as np
import pytest
from places import ROOT

from gauge_envs import load_experiment, reference_band
from gauge_envs.errors import AssetError, GaugeError
from gauge_envs.experiments.task_reader import load_task
from gauge_envs.formats.usd.reader import from_usd
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import load_result
from gauge_envs.scoring.user_file.trajectory_file import read_trajectory
from gauge_envs.tools.conformance.results import read_columns
from gauge_envs.tools.run.spec import load_sweep_file
from gauge_envs.tools.sanity import configuration

ID = "SlopeSlider-2-wood"
OWN = ROOT / "examples" / "own_experiment"


def result():
    return json.dumps(run_episode(RunRequest(ID)).to_dict()).encode()


def trajectory():
    stream = io.BytesIO()
    np.savez_compressed(stream, g=np.zeros((19, 3)))
    return stream.getvalue()


def content_of(*parts):
    return ROOT.joinpath(*parts).read_bytes


def read_band(file):
    """Read the reference of a user's experiment, which includes the file."""
    for source in OWN.iterdir():
        if source.name != file.name:
            shutil.copy(source, file.parent)
    return reference_band(load_experiment(str(file.parent / "crate.toml")))


READERS = {
    "result.json": (result, load_result),
    "g.npz": (trajectory, lambda file: read_trajectory(file, load_experiment(ID))),
    "task.toml": (content_of("tasks", "pendulum.toml"), load_task),
    "CrateSlide-pine.band.npz": (
        (OWN / "CrateSlide-pine.band.npz").read_bytes,
        read_band,
    ),
    "conformance.json": (content_of("scoring", "conformance.json"), read_columns),
    "sweep.toml": (content_of("examples", "sweep.toml"), load_sweep_file),
    "scene.usda": (
        content_of("assets", "usd", f"{ID}.usda"),
        lambda file: from_usd(file, duration_s=1.0),
    ),
    "robot.xml": (content_of("assets", "mjcf", f"{ID}.xml"), configuration),
}
"""A valid file of each kind, and its reader."""


@pytest.mark.parametrize("damage", ["cut", "noise"])
@pytest.mark.parametrize("name", READERS)
def test_a_damaged_file_gives_an_error_with_its_name(name, damage, tmp_path):
    content, read = READERS[name]
    if callable(content):
        content = content()
    file = tmp_path / name
    file.write_bytes(content)
    read(file)
    is_cut = damage == "cut"
    damaged = content[: len(content) // 2] if is_cut else b"\x93" * 2000
    file.write_bytes(damaged)
    with pytest.raises(GaugeError, match=name):
        read(file)


@pytest.mark.parametrize("step", ["nan", "0", "-1"])
def test_a_time_step_that_is_not_positive_is_rejected(step, tmp_path):
    file = tmp_path / "step.xml"
    file.write_text(f'<mujoco><option timestep="{step}"/></mujoco>')
    with pytest.raises(AssetError, match=r"timestep|MuJoCo cannot load"):
        load_experiment(ID, asset=file)
