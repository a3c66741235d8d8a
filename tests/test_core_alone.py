"""The core runs alone: without instruments, other engines, pictures and USD it lists, shows, runs and scores."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT

from gauge_envs import variants

CORE_INSTRUMENTS = {"catalog", "run"}
"""Instruments that list, show, run and score."""

CORE_BACKENDS = {"mujoco", "shared"}

GUEST_PACKAGES = (
    "PIL",
    "imageio",
    "matplotlib",
    "newton",
    "packaging",
    "pxr",
    "sapien",
    "trimesh",
    "yaml",
)
"""Packages that the core does without."""

BLOCKER = f"""
import sys


class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {GUEST_PACKAGES!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)


sys.meta_path.insert(0, Absent())
"""

STEPPED = """
import sys
import gymnasium
import gauge_envs

for name in sys.argv[1:]:
    env = gymnasium.make(f"GAUGE/{name}")
    env.reset(seed=0)
    env.step(env.action_space.sample())
    env.close()
    print(name)
"""

ONE_OF_EACH_GROUP = (
    "SlopeSlider-2-wood",
    "RopeWinding-rubber",
    "TextileBending-satin",
    "CantileverBeam-hard",
)


@pytest.fixture(scope="module")
def core(tmp_path_factory):
    """A folder with the core of the package, its data, and a start file that hides the packages of guests."""
    folder = tmp_path_factory.mktemp("core")
    package = folder / "gauge_envs"
    shutil.copytree(
        ROOT / "gauge_envs", package, ignore=shutil.ignore_patterns("__pycache__")
    )
    shutil.copy(ROOT / "gauge_command.py", folder)
    for name in ("assets", "scoring", "tasks"):
        (folder / name).symlink_to(ROOT / name)
    for guests, kept in (("tools", CORE_INSTRUMENTS), ("backends", CORE_BACKENDS)):
        for entry in (package / guests).iterdir():
            if entry.is_dir() and entry.name not in kept:
                shutil.rmtree(entry)
    shutil.rmtree(package / "rendering")
    (folder / "sitecustomize.py").write_text(BLOCKER, encoding="utf-8")
    return folder


def python(core, *arguments):
    """What a program that sees only the core prints."""
    environment = {**os.environ, "PYTHONPATH": str(core)}
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=core,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def gauge(core, *arguments):
    code = f"import sys; sys.argv = ['gauge', *{list(arguments)!r}]; from gauge_command import main; main()"
    return python(core, "-c", code)


def test_the_copy_is_used_and_guests_are_absent(core):
    shown = python(core, "-c", "import gauge_envs; print(gauge_envs.__file__)")
    assert Path(shown.strip()).is_relative_to(core)
    for package in GUEST_PACKAGES:
        python(
            core,
            "-c",
            f"try:\n import {package}\nexcept ImportError:\n pass\nelse:\n raise SystemExit(1)",
        )


def test_the_core_lists_all_ids_on_its_engine(core):
    rows = [json.loads(line) for line in gauge(core, "list", "--json").splitlines()]
    assert [row["id"] for row in rows] == [variant.id for variant in variants()]
    assert {tuple(row["backends"]) for row in rows} == {("mujoco",)}


def test_the_core_shows_an_experiment(core):
    (shown,) = map(
        json.loads, gauge(core, "show", "SlopeSlider-2-wood", "--json").splitlines()
    )
    assert [row["engine"] for row in shown["engines"]] == ["mujoco"]


def test_the_help_has_only_commands_of_the_core(core):
    shown = gauge(core, "--help")
    assert "score" in shown and "sanity" not in shown and "leaderboard" not in shown


def scored(text):
    """Rows of `gauge run` without times."""
    rows = [json.loads(line) for line in text.splitlines()]
    return [{key: row[key] for key in ("id", "outcome", "score")} for row in rows]


def test_the_core_runs_and_scores_as_the_whole_package(core, tmp_path):
    command = ("run", "SlopeSlider-2-*", "BouncingBall-rubber", "--json", "--out")
    assert scored(gauge(core, *command, str(tmp_path / "core"))) == scored(
        gauge(ROOT, *command, str(tmp_path / "all"))
    )


@pytest.mark.parametrize(
    "names",
    [
        pytest.param(ONE_OF_EACH_GROUP, id="groups"),
        pytest.param(
            tuple(variant.name for variant in variants()),
            id="all",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_the_core_builds_and_steps(core, names):
    assert python(core, "-c", STEPPED, *names).split() == list(names)
