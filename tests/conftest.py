"""Shared helpers of the tests."""

from __future__ import annotations

import os

# Set it before NumPy is imported, because threads of linear algebra wait for one another in a loop.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import gc
import itertools
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
import pytest
from hostile import install
from json_lines import check_invocation
from places import ROOT
from typer.testing import CliRunner

from gauge_envs import registry
from gauge_envs.backends import Support, backend, backend_names
from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.cli.app import app
from gauge_envs.envs import arguments
from gauge_envs.errors import MissingExtraError
from gauge_envs.tools.catalog import listing

TERMINAL = {
    "COLUMNS": "160",
    "TERM": "dumb",
    "NO_COLOR": "1",
    "FORCE_COLOR": None,
    "PYTHONWARNINGS": None,
}
"""Environment variables of a command, which give its output a fixed width and no colours."""


def pytest_configure(config):
    """Set the common environment of the tests and their programs.

    Nobody's imported data takes part, also while tests are collected. Bytecode is kept, also where the environment
    forbids it: hundreds of processes import the package.
    Examples of properties are the same on every machine, and none has a time limit.
    There is little garbage while tests are collected, and the search for it would visit all that is imported.
    Most experiments have no reference; tests of them need none, and those of the warning itself catch it. Its filter
    stands here, as one of `pyproject.toml` imports NumPy first.
    """
    gc.disable()
    config.addinivalue_line(
        "filterwarnings", "ignore::gauge_envs.errors.NoRewardWarning"
    )
    # Without this, MuJoCo writes warnings to MUJOCO_LOG.TXT in the working directory.
    mujoco.set_mju_user_warning(lambda text: None)
    sys.dont_write_bytecode = False
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    if find_spec("hypothesis"):
        from hypothesis import settings

        settings.register_profile("same everywhere", deadline=None, derandomize=True)
        settings.load_profile("same everywhere")
    os.environ["GAUGE_DATA_DIR"] = str(
        Path(tempfile.gettempdir()) / f"gauge-tests-without-data-{os.getpid()}"
    )


def pytest_collection_finish():
    """Exclude the objects of imports from garbage collection: millions of objects that stay until the end."""
    gc.freeze()
    gc.set_threshold(20_000)
    gc.enable()


@pytest.fixture(scope="session", autouse=True)
def json_lines():
    """Check that outputs with `--json` follow their schemas."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(CliRunner, "invoke", check_invocation)
        yield


@pytest.fixture(scope="session")
def unused_folders(tmp_path_factory):
    """Folders that do not exist; creating one for each test would take seconds."""
    base = tmp_path_factory.mktemp("gauge-data")
    return (base / str(number) for number in itertools.count())


@pytest.fixture(autouse=True)
def gauge_data_dir(unused_folders, monkeypatch):
    """Set an empty data folder of the user without task files for each test."""
    folder = next(unused_folders)
    monkeypatch.setenv("GAUGE_DATA_DIR", str(folder))
    monkeypatch.setenv("GAUGE_TASKS", "")
    return folder


@pytest.fixture
def gauge(tmp_path, monkeypatch):
    """Run the command in an empty folder: gauge("list", "--json") -> result with exit_code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)
    runner = CliRunner(env=TERMINAL)
    return lambda *words: runner.invoke(app, list(map(str, words)))


@pytest.fixture(scope="session")
def wheel(tmp_path_factory):
    """The wheel of this checkout, which is built from the sdist."""
    out = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "build", "--no-isolation", "-o", out, ROOT]
    subprocess.run(build, check=True, capture_output=True)
    small = [path.suffix for path in out.iterdir() if path.stat().st_size < 12e6]
    assert sorted(small) == [".gz", ".whl"]
    return next(out.glob("*.whl"))


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Install hostile backends: `installed("crash", "greedy")`."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    backend.cache_clear()

    def installs(*names):
        install(folder, *names)
        registry._scanned.cache_clear()

    yield installs
    backend.cache_clear()


@pytest.fixture(params=backend_names())
def engine(request):
    """Each installed engine, or the engines in the indirect parameters of a test."""
    try:
        return backend(request.param)
    except MissingExtraError as error:
        pytest.skip(str(error))


@pytest.fixture
def rigid_only(monkeypatch):
    """Leave only the MuJoCo backend, without support of deformable bodies."""

    def supports(self, scene):
        return Support(
            tuple(f"{body.name!r} is a deformable body" for body in scene.deformables)
        )

    monkeypatch.setattr(BackendMuJoCo, "supports", supports)
    for module in (arguments, listing):
        monkeypatch.setattr(module, "backend_names", lambda: ("mujoco",))


@pytest.fixture(scope="session")
def rollout():
    """Run an episode, or its first frames, with zero actions: rollout("SlopeSlider-2-wood", parameters=...)."""

    def run(name, *, frames=None, **options):
        env = gymnasium.make(f"GAUGE/{name}", **options)
        env.reset(seed=0)
        zero = (
            0
            if isinstance(env.action_space, gymnasium.spaces.Discrete)
            else np.zeros(env.action_space.shape)
        )
        over = False
        while not over:
            *_, terminated, truncated, info = env.step(zero)
            over = terminated or truncated or info["frame"] == frames
        return env.unwrapped, env.unwrapped.trajectory(), info

    return run
