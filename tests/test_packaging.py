"""The wheel alone in a clean environment outside the checkout."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import zipfile

import pytest

from scripts.test_matrix import make_environment

NOT_OF_THE_BASE = {
    "imageio",
    "matplotlib",
    "packaging",
    "pillow",
    "pyyaml",
    "trimesh",
    "usd-core",
}
"""Packages that extras install."""

MAX_BASE_MB = 500.0
"""Largest size of an environment with the wheel alone [MB], including pip."""

NEEDS_EXTRA = (
    (("sanity", "HalfCheetah-v5"), "sanity"),
    (("data", "scenes", "--check"), "usd"),
    (("video", "score", "slide.mp4", "--id", "SlopeSlider-2-wood"), "video"),
)
"""Commands that need an extra, and this extra in their messages."""


def test_the_wheel_contains_the_data(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert (
        sum(
            name.startswith("gauge_envs/_data/tasks/") and name.endswith(".toml")
            for name in names
        )
        >= 23
    )
    assert "gauge_envs/_data/scoring/single_shot/CubeToss-acrylic.npz" in names
    assert "gauge_envs/_data/scoring/single_shot/CubeToss-acrylic.LICENSE" in names
    assert "gauge_envs/_data/scoring/published/engine_results.csv" in names
    assert "gauge_envs/_data/scoring/bands/SlopeSlider-2-wood.npz" in names
    assert "gauge_envs/py.typed" in names
    assert not any(name.startswith(("tests", "studies")) for name in names)


@pytest.mark.slow  # `.ci/matrix` installs the wheel too, and runs more than this.
def test_the_wheel_alone_is_small_and_names_missing_extras(
    wheel, tmp_path, monkeypatch
):
    folder = tmp_path / "venv"
    commands = make_environment(folder, python=sys.executable, wheel=wheel, extras=[])
    monkeypatch.delenv("PYTHONPATH", raising=False)
    monkeypatch.chdir(tmp_path)

    def run(command, *words):
        return subprocess.run(
            [commands / command, *words], capture_output=True, text=True, check=False
        )

    listed = json.loads(run("pip", "list", "--format", "json").stdout)
    names = {package["name"].lower() for package in listed}
    assert {"gymnasium", "mujoco", "numpy"} <= names
    assert names.isdisjoint(NOT_OF_THE_BASE)
    files = [file for file in folder.rglob("*") if file.is_file()]
    size_bytes = sum(file.lstat().st_size for file in files)
    assert size_bytes / 1e6 < MAX_BASE_MB
    (tmp_path / "slide.mp4").write_bytes(b"\0\0\0\x18ftypmp42")
    for words, extra in NEEDS_EXTRA:
        refused = run("gauge", *words)
        assert refused.returncode == 2
        # The wheel file of this test is no index: the command names the file.
        assert re.search(rf"pip install '\S+\.whl\[{extra}\]'", refused.stderr)
        assert len(refused.stderr.splitlines()) == 1
