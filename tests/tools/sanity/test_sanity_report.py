"""The sanity check as people and programs read it: screen, exit codes, JSON, wrapper and action."""

import json
import os
import subprocess
import sys
import warnings
from dataclasses import replace
from io import StringIO

import gymnasium
import numpy as np
import pytest
import yaml
from places import ROOT
from rich.console import Console
from typer.testing import CliRunner

from gauge_envs.cli.app import app
from gauge_envs.pages.terminal import Terminal
from gauge_envs.tools import sanity
from gauge_envs.tools.sanity import SanityWarning, SanityWrapper
from gauge_envs.tools.sanity.report import sanity_document
from gauge_envs.tools.sanity.verdict import (
    Fix,
    PartOutcome,
    Reality,
    Report,
    SanityResult,
    SanityVerdict,
    TrainingConfiguration,
)


def part(value, verdict=SanityVerdict.FAILED):
    """Return the part of a check whose interval is 0.5 wide on each side."""
    deviation = np.inf if value is None else abs(value) / 0.5
    return (PartOutcome(name="", value=value, verdict=verdict, deviation=deviation),)


CREEP = SanityResult(
    id="creep-wood",
    title="creep of a <cube> [of wood]",
    experiment="GAUGE/SlopeSlider-1-wood",
    unit="mm/s",
    reality=Reality(0.0, tolerance=0.5, source="paper", rationale="cubes <rest>"),
    configured=-28.0,
    verdict=SanityVerdict.FAILED,
    parts=part(-28.0),
)
SLIDE = replace(CREEP, id="slide", configured=1.1, verdict=SanityVerdict.WARNING)
PERIOD = replace(
    CREEP,
    id="period",
    configured=0.1,
    verdict=SanityVerdict.PASSED,
    parts=part(0.1, SanityVerdict.PASSED),
)
WALL = replace(
    CREEP,
    id="wall",
    configured=None,
    verdict=SanityVerdict.NOT_MEASURED,
    remark="'brick' is too heavy",
)
NOTHING = replace(WALL, id="slip", remark="no gravity", applies=False)
SPIN = replace(
    CREEP,
    id="model-spin",
    experiment="",
    remark="box loses 62 % in 2 s, a refined run 0.1 %",
    place='body "box"',
    file="toss.xml",
    line=6,
)
DRIFT = replace(SPIN, verdict=SanityVerdict.WARNING, parts=part(0.6))
FIX = Fix(
    changes={"cone": "elliptic"},
    line='<option cone="elliptic"/>',
    fixed={"creep-wood": 0.5},
    lines=('- <option timestep="0.01"/>', '+ <option cone="elliptic"/>'),
    speed_ratio=0.8,
)


def report(*results, **attributes):
    configuration = TrainingConfiguration(
        name="Robot-v0", source="a <model>", backend="mujoco", settings={}
    )
    return Report(
        configuration=configuration,
        checks=results,
        versions={},
        **attributes,
    )


def screen(checked, **options):
    stream = StringIO()
    shown = Terminal(sanity_document(checked, **options))
    Console(file=stream, width=100).print(shown)
    return stream.getvalue().splitlines()


def run(monkeypatch, checked, *options):
    monkeypatch.setattr(sanity, "check", lambda *_, **__: checked)
    return CliRunner().invoke(app, ["sanity", "mujoco", *options])


# --- the screen ------------------------------------------------------------------------------------------------------


def test_the_screen_has_the_answer_then_the_model_then_objects_then_the_fix():
    lines = screen(report(CREEP, SPIN, SLIDE, PERIOD, fix=FIX))
    assert lines[0] == "Robot-v0: 1 error, 2 advice, 1 check passed"
    places = [
        next(n for n, line in enumerate(lines) if text in line)
        for text in ("box loses", "toss.xml:6", "creep-wood", "+ <option", "--all")
    ]
    assert places == sorted(places)
    assert "Best fix: resolves 1 of 3 findings; as fast" in lines


def test_a_report_that_passes_is_a_line():
    answer = "Robot-v0: 1 check passed"
    assert screen(report(PERIOD)) == [answer]


def test_a_model_that_diverges_writes_no_log_and_no_warning_of_mujoco(tmp_path):
    model = """<mujoco><option timestep="0.05" integrator="Euler"/><worldbody><geom type="plane" size="5 5 .1"/>
      <body pos="0 0 .5"><freejoint/><geom size=".1"/><body pos=".2 0 0"><joint name="j" axis="0 1 0"/>
      <geom size=".02" pos=".3 0 0"/></body></body></worldbody>
      <actuator><position joint="j" kp="50000"/></actuator></mujoco>"""
    (tmp_path / "robot.xml").write_text(model)
    program = "from gauge_envs.__main__ import main; main()"
    words = ["sanity", "robot.xml", "--only", "robot-holds,robot-energy,rest-height"]
    done = subprocess.run(
        [sys.executable, "-c", program, *words],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.startswith("robot.xml: ") and "state diverges" in done.stdout
    assert done.stderr == ""
    assert [file.name for file in tmp_path.iterdir()] == ["robot.xml"]


# --- exit codes and JSON ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("results", "options", "code"),
    [
        ((PERIOD, NOTHING), (), 0),
        ((CREEP, PERIOD), ("--strict",), 0),
        ((SPIN, PERIOD), (), 1),
        ((DRIFT, PERIOD), (), 0),
        ((DRIFT, PERIOD), ("--strict",), 1),
        ((replace(SPIN, cause="density"), PERIOD), ("--strict",), 0),
        ((PERIOD, WALL), (), 3),
        ((SPIN, WALL), (), 1),
        # Nothing was measured, whether it applies or not.
        ((NOTHING,), (), 3),
    ],
)
def test_exit_codes(monkeypatch, results, options, code):
    assert run(monkeypatch, report(*results), *options).exit_code == code


def test_a_check_that_is_requested_by_name_must_be_measured(monkeypatch):
    checked = report(PERIOD, NOTHING, asked=("slip",))
    assert run(monkeypatch, checked).exit_code == 3


@pytest.mark.usefixtures("shared_measurements")
def test_the_json_of_a_real_configuration(gauge):
    words = ["sanity", "HalfCheetah-v5", "--only", "rest-height", "--json"]
    first, check = map(json.loads, gauge(*words).stdout.splitlines())
    assert first["configuration"]["name"] == "HalfCheetah-v5"
    assert first["worst"] == "failed" and check["severity"] == "advice"
    assert [*first["fix"]["fixed"]] == ["rest-height"]
    # solimp 0 0.8 0.01 lets a cube sink by millimetres.
    assert (check["verdict"], check["configured"] < -1.0) == ("failed", True)


# --- in training -----------------------------------------------------------------------------------------------------


def test_the_wrapper_warns_of_a_failed_check_and_checks_once(monkeypatch):
    calls = []

    def check(env, only):
        calls.append(only)
        return report(CREEP if "bad" in only else PERIOD, fix=FIX)

    monkeypatch.setattr("gauge_envs.tools.sanity.wrapper.check", check)
    for _ in range(2):
        with pytest.warns(SanityWarning, match='creep-wood.*cone="elliptic"'):
            SanityWrapper(gymnasium.make("CartPole-v1"), only=["bad"])
    with warnings.catch_warnings():
        warnings.simplefilter("error", SanityWarning)
        env = SanityWrapper(gymnasium.make("CartPole-v1"), only=["good"])
    assert calls == [["bad"], ["good"]]
    assert env.report.worst is SanityVerdict.PASSED


def test_the_action_never_puts_an_input_into_a_script():
    """An input with `; touch pwned` stays a word: scripts read inputs from the environment."""
    action = yaml.safe_load((ROOT / "action.yml").read_text())
    for step in action["runs"]["steps"]:
        assert "${{" not in step["run"]
        compile(step["run"], "action.yml", "exec")
