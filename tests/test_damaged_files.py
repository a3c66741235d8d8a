"""A damaged file is read, or it is an error of the package that names the file."""

from __future__ import annotations

import io
import json
import shutil

import numpy as np
import pytest
from places import ROOT

from gauge_envs import load_experiment, reference_band
from gauge_envs.errors import AssetError, GaugeError
from gauge_envs.experiments.resolve import load_experiment_from_asset
from gauge_envs.experiments.task_reader import load_task
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import load_result
from gauge_envs.scoring.trajectory_file import read_trajectory
from gauge_envs.tools.assets.build import assets_folder
from gauge_envs.tools.conformance.results import read_columns, read_expected
from gauge_envs.tools.sanity import configuration
from gauge_envs.tools.sanity.comparison import read_baseline
from gauge_envs.tools.sweep.spec import load_sweep_file
from gauge_envs.tools.usd.reader import from_usd
from gauge_envs.tools.video.track import read_track

ID = "SlopeSlider-2-wood"
OWN = ROOT / "examples" / "own_experiment"
DAMAGES = {
    "empty": lambda content: b"",
    "noise": lambda content: np.random.default_rng(0).bytes(2000),
    "cut": lambda content: content[: len(content) // 2],
}


def result():
    return json.dumps(run_episode(RunRequest(ID)).to_dict()).encode()


def arrays(**values):
    stream = io.BytesIO()
    np.savez_compressed(stream, **values)
    return stream.getvalue()


def content_of(*parts):
    return ROOT.joinpath(*parts).read_bytes


def trajectory(file):
    return read_trajectory(file, load_experiment(ID))


def band(file):
    """Read the reference of an experiment of one's own, of which the file has one part."""
    for source in OWN.iterdir():
        if source.name != file.name:
            shutil.copy(source, file.parent)
    return reference_band(load_experiment(str(file.parent / "crate.toml")))


BASELINE = {
    "phenomenon": "slide",
    "configured": 1.0,
    "verdict": "wrong",
    "reality": {"value": 2.0, "tolerance": 0.1},
    "parts": [],
}
MJCF = b'<mujoco><worldbody><body><freejoint/><geom size="0.1"/></body></worldbody></mujoco>'

READERS = {
    "result.json": (result, load_result),
    "g.csv": (lambda: b"0,0,0\n" * 19, trajectory),
    "g.npz": (lambda: arrays(g=np.zeros((19, 3))), trajectory),
    "task.toml": (content_of("tasks", "pendulum.toml"), load_task),
    "crate.toml": ((OWN / "crate.toml").read_bytes, band),
    "CrateSlide-pine.band.toml": (
        (OWN / "CrateSlide-pine.band.toml").read_bytes,
        band,
    ),
    "CrateSlide-pine.band.npz": ((OWN / "CrateSlide-pine.band.npz").read_bytes, band),
    "settings.toml": (content_of("examples", "sanity", "good.toml"), configuration),
    "settings.yaml": (lambda: b"sim:\n  dt: 0.01\n  physx: {a: 1}\n", configuration),
    "track.csv": (
        lambda: b"frame,x,y\n" + b"".join(b"%d,2,3\n" % n for n in range(40)),
        lambda file: read_track(file, fps=30.0),
    ),
    "expected.toml": (
        lambda: b'slide = { measured = 1.0, reason = "known" }\n',
        read_expected,
    ),
    "matrix.json": (content_of("scoring", "conformance.json"), read_columns),
    "sweep.toml": (content_of("examples", "sweep.toml"), load_sweep_file),
    "baseline.json": (json.dumps(BASELINE).encode, read_baseline),
    "scene.usda": (
        (assets_folder() / "usd" / f"{ID}.usda").read_bytes,
        lambda file: from_usd(file, duration_s=1.0),
    ),
    "scene.xml": (
        (assets_folder() / "mjcf" / f"{ID}.xml").read_bytes,
        lambda file: load_experiment_from_asset(ID, file),
    ),
    "robot.xml": (lambda: MJCF, configuration),
}
"""A valid file and the reader of each kind."""


def error_of(read, file):
    try:
        read(file)
    except GaugeError as error:
        return error
    return None


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("name", READERS)
def test_a_damaged_file_is_an_error_with_its_name(name, damage, tmp_path):
    make, read = READERS[name]
    content = make()
    file = tmp_path / name
    file.write_bytes(DAMAGES[damage](content))
    error = error_of(read, file)
    # A part of a table or of settings can be a valid file.
    is_optional = damage == "cut" or name in ("sweep.toml", "expected.toml")
    assert (is_optional and error is None) or name in str(error)


@pytest.mark.parametrize("step", ["nan", "0", "-1", "1e-320"])
def test_a_time_step_that_is_no_step_is_refused(step, tmp_path):
    file = tmp_path / "step.xml"
    file.write_text(f'<mujoco><option timestep="{step}"/></mujoco>')
    with pytest.raises(AssetError, match=r"timestep|MuJoCo cannot load"):
        load_experiment_from_asset(ID, file)
