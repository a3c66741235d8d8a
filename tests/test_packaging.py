"""What a user installs: the wheel alone, in a clean environment, outside the checkout."""

from __future__ import annotations

import os
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest
from places import ROOT


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    out = tmp_path_factory.mktemp("wheel")
    # The wheel is built from the sdist.
    command = [
        sys.executable,
        "-m",
        "build",
        "--no-isolation",
        "--outdir",
        str(out),
        str(ROOT),
    ]
    subprocess.run(command, check=True, capture_output=True)
    assert {path.suffix for path in out.iterdir() if path.stat().st_size < 12e6} == {
        ".gz",
        ".whl",
    }
    return next(out.glob("*.whl"))


def test_wheel_carries_the_data(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert (
        sum(
            name.startswith("gauge_envs/tasks/") and name.endswith(".toml")
            for name in names
        )
        >= 23
    )
    assert "gauge_envs/scoring/single_shot/CubeToss-acrylic.npz" in names
    assert "gauge_envs/scoring/single_shot/CubeToss-acrylic.LICENSE" in names
    assert "gauge_envs/scoring/single_shot/ElbowToss-blocks.npz" in names
    assert "gauge_envs/scoring/single_shot/ElbowToss-blocks.LICENSE" in names
    assert "gauge_envs/scoring/published/engine_results.csv" in names
    assert "gauge_envs/scoring/bands/SlopeSlider-2-wood.csv" in names
    assert "gauge_envs/py.typed" in names
    assert "gauge_command.py" in names
    assert not any(name.startswith(("tests", "studies")) for name in names)


@pytest.mark.slow  # `make test-matrix` installs the wheel too, and runs more than this.
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
    # `gauge sanity` reads Gymnasium's MuJoCo environments, which import more than Gymnasium declares.
    subprocess.run(
        [
            python,
            "-I",
            "-c",
            "import gymnasium; gymnasium.make('HalfCheetah-v5').reset()",
        ],
        cwd=tmp_path,
        check=True,
    )
    listed = subprocess.run(
        [tmp_path / "venv" / "bin" / "gauge", "list"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
        env=variables,
    )
    assert "75 ids in 22 families" in listed.stdout
