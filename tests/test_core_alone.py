"""The core alone, without other tools, other engines, pictures and USD, lists, shows, runs and scores."""

from __future__ import annotations

import json
import os
import shutil
from types import SimpleNamespace

import programs
import pytest
from places import ROOT

from gauge_envs import variants

CORE_INSTRUMENTS = {"catalog", "control", "run"}
"""Tools that list, show, run and score, and the control tasks, which the package registers."""

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
"""Packages that the core does not need."""

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

FIRST_OF_EACH_GROUP = (
    "SlopeSlider-2-wood",
    "RopeWinding-rubber",
    "TextileBending-satin",
    "CantileverBeam-hard",
)


@pytest.fixture(scope="module")
def core(tmp_path_factory):
    """A folder with the core of the package, its data, and a start file that hides optional packages."""
    folder = tmp_path_factory.mktemp("core")
    package = folder / "gauge_envs"
    shutil.copytree(
        ROOT / "gauge_envs", package, ignore=shutil.ignore_patterns("__pycache__")
    )
    for name in ("assets", "scoring", "tasks"):
        (folder / name).symlink_to(ROOT / name)
    for guests, kept in (("tools", CORE_INSTRUMENTS), ("backends", CORE_BACKENDS)):
        for entry in (package / guests).iterdir():
            if entry.is_dir() and entry.name not in kept:
                shutil.rmtree(entry)
    shutil.rmtree(package / "rendering")
    (folder / "sitecustomize.py").write_text(BLOCKER)
    return folder


def python(core, *arguments):
    """Return the output of a program that sees only the core."""
    return programs.printed(
        *arguments, cwd=core, env={**os.environ, "PYTHONPATH": str(core)}
    )


COMMANDS = """
import sys
from contextlib import suppress
from importlib import import_module
from shlex import split

for package in {packages!r}:
    with suppress(ImportError):
        import_module(package)
        raise SystemExit(f"{{package}} is not hidden")

import gauge_envs
from gauge_envs.cli.app import app

print(gauge_envs.__file__)
for command in sys.argv[1:]:
    app(split(command), standalone_mode=False)
"""


@pytest.fixture(scope="module")
def printed(core):
    """Output of a process of the core: the folder of the package, the help, rows of a list, and a page."""
    code = COMMANDS.format(packages=GUEST_PACKAGES)
    commands = ("--help", "list --json", "show SlopeSlider-2-wood --json")
    place, *lines = python(core, "-c", code, *commands).splitlines()
    *rows, page = (json.loads(line) for line in lines if line.startswith("{"))
    return SimpleNamespace(place=place, help="".join(lines), rows=rows, page=page)


def test_the_core_lists_all_ids_on_its_engine(printed):
    rows = printed.rows
    assert [row["id"] for row in rows] == [variant.id for variant in variants()]
    assert {tuple(row["backends"]) for row in rows} == {("mujoco",)}


def scored(text):
    """Rows of `gauge run` without times."""
    rows = [json.loads(line) for line in text.splitlines()]
    return [{key: row[key] for key in ("id", "outcome", "score")} for row in rows]


def test_the_core_runs_and_scores_as_the_whole_package(core, gauge):
    words = ("run", "SlopeSlider-2-wood", "BouncingBall-rubber", "--json")
    code = "import sys; sys.argv[0] = 'gauge'; from gauge_envs.__main__ import main; main()"
    assert scored(python(core, "-c", code, *words)) == scored(gauge(*words).stdout)


@pytest.mark.parametrize(
    "names",
    [
        pytest.param(FIRST_OF_EACH_GROUP, id="groups"),
        pytest.param(
            tuple(variant.name for variant in variants()),
            id="all",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_the_core_builds_and_steps(core, names):
    assert python(core, "-c", STEPPED, *names).split() == list(names)
