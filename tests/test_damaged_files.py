"""A damaged file gives an error of the package with the name of the file, in each format, and never hangs."""

from __future__ import annotations

import sys

import damage
import pytest

from gauge_envs import load_experiment
from gauge_envs.errors import AssetError
from gauge_envs.runs.workers import Worker

SAMPLE = range(8)
"""Seeds of the damages of a kind of file."""

MANY = range(1000, 1400)
"""Seeds of the slow test."""

EXTRAS = {"film.mp4": "cv2", "log.parquet": "pyarrow"}
"""Modules that readers need."""


@pytest.fixture(scope="module")
def process():
    """Another process, which a crash of a library or a hang would end."""
    with Worker(300.0) as worker:
        yield worker


@pytest.fixture(params=damage.TARGETS)
def name(request):
    pytest.importorskip(EXTRAS.get(request.param, "numpy"))
    return request.param


def test_a_damaged_file_gives_an_error_with_its_name(name, process, tmp_path):
    found, _ = process.call(damage.faults, name, tmp_path, SAMPLE)
    assert found == []


@pytest.mark.slow
def test_many_damaged_files_give_an_error_with_their_name(name, process, tmp_path):
    found, good = process.call(damage.faults, name, tmp_path, MANY)
    assert found == []
    # Files of dense data hardly survive a damage; a reader of trials or sweeps has findings in place of errors.
    assert good > 0


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no named pipes")
def test_a_pipe_a_folder_or_a_device_is_no_file(name, process, tmp_path):
    assert process.call(damage.special_faults, name, tmp_path) == []


@pytest.mark.parametrize("step", ["nan", "0", "-1"])
def test_a_time_step_that_is_not_positive_is_rejected(step, tmp_path):
    file = tmp_path / "step.xml"
    file.write_text(f'<mujoco><option timestep="{step}"/></mujoco>')
    with pytest.raises(AssetError, match=r"timestep|MuJoCo can load"):
        load_experiment(damage.ID, asset=file)
