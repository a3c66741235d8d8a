"""Tasks of dm_control's suite by name, from the files of the package alone."""

from __future__ import annotations

import re
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.stacks import configuration

DOMAIN = """
from dm_control.utils import containers{editor}
raise ImportError("another MuJoCo")
SUITE = containers.TaggedTasks()

def helper():
    return 1

@SUITE.add('benchmarking')
def walk(time_limit=25):
    return helper(){use}

@SUITE.add()
def run(time_limit=25):
    return helper()
"""
"""Code of a domain, which cannot be imported."""

MODEL = """<mujoco model="{name}"><include file="./common/floor.xml"/><option timestep="0.0025"/>
  <default><geom friction=".7 .1 .1" solimp="0 .99 .01"/></default>
  <worldbody><body pos="0 0 1"><freejoint/><geom name="foot" size=".1"/></body></worldbody></mujoco>"""


@pytest.fixture
def suite(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package with the folders of dm_control's suite: domains `walker` and `dog`."""
    folder = tmp_path / "dm_control" / "suite"
    (folder / "common").mkdir(parents=True)
    (tmp_path / "dm_control" / "__init__.py").write_text("raise ImportError('another MuJoCo')")
    (folder / "common" / "floor.xml").write_text(
        '<mujoco><worldbody><geom name="floor" type="plane" size="5 5 .1"/></worldbody></mujoco>'
    )
    for name, editor, use in (("walker", "", ""), ("dog", "\nfrom lxml import etree", " + len(etree.__doc__)")):
        (folder / f"{name}.py").write_text(DOMAIN.format(editor=editor, use=use))
        (folder / f"{name}.xml").write_text(MODEL.format(name=name))
    (folder / "stray.xml").write_text("<mujoco/>")
    monkeypatch.syspath_prepend(tmp_path)
    return folder


def test_a_task_is_read_from_its_file(suite: Path) -> None:
    read = configuration("dm_control:walker/walk")
    assert (read.name, read.settings["timestep_s"]) == ("dm_control:walker/walk", 0.0025)
    assert read.settings["contact_solimp"] == [0.0, 0.99, 0.01, 0.5, 2.0]
    assert read.source.startswith("dm_control ") and read.source.endswith(", suite, walker.xml")
    assert [group.geoms for group in read.contact_groups] == ["floor with foot"]
    assert read.notes == ()
    assert read.is_model
    assert "dm_control" not in sys.modules
    assert configuration("dm_control:walker/walk", pair=("floor", "foot")).settings == read.settings


def test_a_file_that_the_code_changes_has_a_note(suite: Path) -> None:
    assert re.match(r"dm_control changes dog.xml before it loads it", configuration("dm_control:dog/run").notes[0])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("dm_control:walker/fly", "the domain 'walker' has no task 'fly'; it has walk, run"),
        ("dm_control:walker", "the domain 'walker' has no task ''; it has walk, run"),
        ("dm_control:wlaker/walk", "no domain 'wlaker'; it has dog, walker"),
        ("dm_control:../secret/walk", r"no domain '..'; it has dog, walker"),
        ("dm_control:stray/walk", "no domain 'stray'"),
    ],
)
def test_what_the_suite_does_not_have_says_what_it_has(suite: Path, name: str, message: str) -> None:
    with pytest.raises(TargetError, match=message):
        configuration(name)


def test_without_the_package_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gauge_envs.tools.sanity.python_source.source.find_spec", lambda _: None)
    with pytest.raises(TargetError, match="pip install --no-deps dm_control"):
        configuration("dm_control:walker/walk")


@pytest.mark.skipif(find_spec("dm_control") is None, reason="dm_control is not installed")
@pytest.mark.parametrize("name", ["walker/walk", "cheetah/run", "humanoid/run", "hopper/hop", "quadruped/walk"])
def test_the_package_itself(name: str) -> None:
    assert configuration(f"dm_control:{name}").contact_groups
