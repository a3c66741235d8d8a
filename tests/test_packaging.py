"""The wheel alone in a clean environment outside the checkout."""

from __future__ import annotations

import json
import os
import subprocess
import venv
import zipfile
from pathlib import Path

import pytest

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
def test_installed_wheel_makes_an_environment_outside_the_checkout(wheel, tmp_path):
    venv.create(tmp_path / "venv", with_pip=True)
    python = tmp_path / "venv" / "bin" / "python"
    # Where PYTHONPATH leads to another copy with the same version, pip installs nothing and succeeds.
    variables = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith("PYTHON")
    }
    subprocess.run(
        [python, "-m", "pip", "install", "--quiet", str(wheel)],
        check=True,
        capture_output=True,
        env=variables,
    )
    script = (
        "import sys, gymnasium, gauge_envs\n"
        "env = gymnasium.make('GAUGE/BouncingBall-rubber'); env.reset(seed=0)\n"
        "done = False\n"
        "while not done: *_, stop, done, info = env.step(0)\n"
        "assert 'matplotlib' not in sys.modules and 'warp' not in sys.modules\n"
        "print(gauge_envs.__file__, len(gauge_envs.variants()), info['score'].rmse_normalized)\n"
    )
    run = subprocess.run(
        [python, "-I", "-c", script],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    file, count, rmse = run.stdout.split()
    assert Path(file).is_relative_to(tmp_path)
    assert count == "75"
    assert float(rmse) == pytest.approx(14.1, abs=0.1)
    pip = [python, "-m", "pip", "--disable-pip-version-check"]
    listed = subprocess.run(
        [*pip, "list", "--format", "json"],
        check=True,
        capture_output=True,
        text=True,
        env=variables,
    )
    names = {package["name"].lower() for package in json.loads(listed.stdout)}
    assert {"gymnasium", "mujoco", "numpy"} <= names
    assert names.isdisjoint(NOT_OF_THE_BASE)
    size_mb = sum(
        file.stat().st_size
        for file in (tmp_path / "venv").rglob("*")
        if file.is_file() and not file.is_symlink()
    )
    assert size_mb / 1e6 < MAX_BASE_MB

    def gauge(*words):
        return subprocess.run(
            [tmp_path / "venv" / "bin" / "gauge", *words],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
            env=variables,
        )

    assert "\n75 ids" in gauge("list").stdout
    (tmp_path / "slide.mp4").write_bytes(b"\0\0\0\x18ftypmp42")
    for words, extra in NEEDS_EXTRA:
        refused = gauge(*words)
        assert refused.returncode == 2
        assert f"pip install 'gauge-envs[{extra}]'" in refused.stderr
        assert len(refused.stderr.splitlines()) == 1
