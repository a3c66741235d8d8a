"""Exit codes, formats and the action of a sanity check: green only where all was measured and passed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml
from places import ROOT
from robot_faults import good_xml
from test_sanity_report import ADVICE, CREEP, NOTHING, PERIOD, SLIDE, WALL, report
from typer.testing import CliRunner

from gauge_envs.cli.app import app
from gauge_envs.pages.document import as_rows
from gauge_envs.tools import sanity
from gauge_envs.tools.sanity.words import sanity_document

RUNNER = CliRunner()


def run(monkeypatch: pytest.MonkeyPatch, checked: sanity.Report, *options: str):
    monkeypatch.setattr(sanity, "check", lambda *_, **__: checked)
    return RUNNER.invoke(app, ["sanity", "mujoco", *options])


@pytest.mark.parametrize(
    ("rows", "options", "code"),
    [
        ((PERIOD,), (), 0),
        ((PERIOD, ADVICE), (), 0),
        ((PERIOD, NOTHING), (), 0),
        ((CREEP, PERIOD), (), 1),
        ((SLIDE, PERIOD), (), 1),
        ((SLIDE, PERIOD), ("--fail-on", "wrong"), 0),
        ((CREEP, PERIOD), ("--fail-on", "never"), 0),
        ((CREEP, WALL), (), 1),
        ((PERIOD, WALL), (), 3),
        ((CREEP, WALL), ("--fail-on", "never"), 3),
        # Nothing was measured, whether it applies or not.
        ((NOTHING,), (), 3),
        ((WALL,), ("--fail-on", "never"), 3),
    ],
)
def test_exit_codes(monkeypatch, rows, options, code) -> None:
    assert run(monkeypatch, report(*rows), *options).exit_code == code


def test_a_row_that_was_asked_for_by_name_must_be_measured(monkeypatch) -> None:
    checked = replace(report(PERIOD, NOTHING), asked=("slip",))
    assert run(monkeypatch, checked).exit_code == 3
    assert checked.unmeasured == ("slip",)


def test_a_check_without_time_is_not_green() -> None:
    outcome = RUNNER.invoke(
        app,
        [
            "sanity",
            "HalfCheetah-v5",
            "--limits",
            "0s",
            "--only",
            "foot-*,creep-*,robot-servo",
        ],
    )
    assert outcome.exit_code == 3
    assert (
        outcome.stdout.startswith("Incomplete: ")
        and "rows were not measured: foot-creep, " in outcome.stdout
    )


def test_a_configuration_with_flags_ends_with_1() -> None:
    outcome = RUNNER.invoke(
        app, ["sanity", "HalfCheetah-v5", "--only", "creep-wood,gravity"]
    )
    assert outcome.exit_code == 1
    assert outcome.stdout.startswith("Mends most: <default><geom solimp=")


def test_feet_without_friction_are_not_green(tmp_path: Path) -> None:
    path = tmp_path / "robot.xml"
    path.write_text(good_xml().replace("<geom friction", '<geom condim="1" friction'))
    assert (
        RUNNER.invoke(app, ["sanity", str(path), "--only", "foot-creep"]).exit_code == 3
    )
    assert (
        RUNNER.invoke(
            app, ["sanity", str(path), "--only", "foot-creep,robot-friction"]
        ).exit_code
        == 1
    )


def test_success_is_one_line(monkeypatch) -> None:
    lines = run(monkeypatch, report(PERIOD)).stdout.splitlines()
    assert lines == ["Robot-v0: No flags: 1 row measured, nothing to change; 12 s"]
    assert (
        len(run(monkeypatch, report(PERIOD), "--format", "wide").stdout.splitlines())
        > 10
    )


def test_a_baseline_compares_values_with_their_intervals(
    monkeypatch, tmp_path: Path
) -> None:
    before = tmp_path / "before.json"
    before.write_text(
        "\n".join(json.dumps(row) for row in as_rows(sanity_document(report(CREEP))))
    )
    known = ("--baseline", str(before))
    # The interval is 0.5 mm/s wide on each side, and the creep was 28 mm/s.
    for creep, code in (
        (-28.0, 0),
        (-28.4, 0),
        (-20.0, 0),
        (-29.0, 1),
        (-280.0, 1),
        (28.0, 0),
        (None, 1),
    ):
        outcome = run(monkeypatch, report(replace(CREEP, configured=creep)), *known)
        assert outcome.exit_code == code, creep
    assert run(monkeypatch, report(CREEP, replace(SLIDE)), *known).exit_code == 1
    assert run(monkeypatch, report(CREEP, WALL), *known).exit_code == 3


@pytest.mark.parametrize("number", [10**400, 0, "x"])
def test_a_baseline_with_a_number_that_is_none_is_an_error(
    number: object, monkeypatch, tmp_path: Path
) -> None:
    row = {"phenomenon": "creep-wood", "verdict": "wrong", "configured": number}
    before = tmp_path / "before.json"
    before.write_text(json.dumps(row | {"reality": {"value": 0, "tolerance": 0}}))
    outcome = run(monkeypatch, report(CREEP), "--baseline", str(before))
    assert (
        outcome.exit_code == 2
        and "is not the output of gauge sanity --json" in outcome.stderr
    )


# --- formats ---------------------------------------------------------------------------------------------------------


def test_junit_has_failures_errors_and_skipped_rows(monkeypatch) -> None:
    suite = ElementTree.fromstring(
        run(
            monkeypatch, report(CREEP, PERIOD, WALL, NOTHING), "--format", "junit"
        ).stdout
    )
    counts = {
        name: suite.get(name) for name in ("tests", "failures", "errors", "skipped")
    }
    assert counts == {"tests": "4", "failures": "1", "errors": "1", "skipped": "1"}
    outcomes = {case.get("name"): [child.tag for child in case] for case in suite}
    assert outcomes == {
        "creep-wood": ["failure"],
        "period": [],
        "wall": ["error"],
        "slip": ["skipped"],
    }
    assert "-28 instead of 0 +- 0.5 mm/s" in suite.find("testcase/failure").get(
        "message"
    )


def test_annotations_of_github_stay_on_one_line(monkeypatch) -> None:
    row = replace(CREEP, title="50 % creep\nof a cube")
    lines = run(
        monkeypatch, report(row, WALL), "--format", "github"
    ).stdout.splitlines()
    assert lines[0].startswith(
        "::error title=gauge sanity creep-wood::50 %25 creep%0Aof a cube: -28 instead of 0"
    )
    assert lines[1] == "::error title=gauge sanity wall::was not measured"
    assert lines[2].startswith("::notice title=gauge sanity Robot-v0::1 flag")


# --- action ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_steps_of_the_action_run(tmp_path: Path) -> None:
    action = yaml.safe_load((ROOT / "action.yml").read_text(encoding="utf-8"))
    assert action["runs"]["using"] == "composite"
    values = {name: one.get("default", "") for name, one in action["inputs"].items()}
    command = f'#!/bin/sh\nexec {sys.executable} -c "from gauge_command import main; main()" "$@"\n'
    (tmp_path / "gauge").write_text(command)
    (tmp_path / "gauge").chmod(0o755)
    (tmp_path / "robot.xml").write_text(good_xml())
    faulty = good_xml().replace('<body name="trunk"', '<body name="trunk" gravcomp="1"')
    (tmp_path / "faulty robot.xml").write_text(faulty)
    for target, options, code in (
        ("robot.xml", "--only robot-*,floor-tilt", 0),
        ("faulty robot.xml", "--only robot-gravcomp --out rows.json", 1),
        (
            "faulty robot.xml",
            "--only 'robot-gravcomp, floor-tilt' --baseline rows.json",
            0,
        ),
        ("robot.xml", "--only foot-creep --limits 0s", 3),
        ("robot.xml; touch pwned\n$(touch pwned)", "--only robot-* ; touch pwned", 2),
        ("--fail-on=never", "--only `touch pwned`", 2),
    ):
        given = values | {"target": target, "options": options}
        (step,) = [one for one in action["runs"]["steps"] if one["name"] == "Check"]
        env = {
            name: given[text.strip("${ }").removeprefix("inputs.")]
            for name, text in step["env"].items()
        }
        path = os.pathsep.join([str(tmp_path), os.environ["PATH"]])
        environment = os.environ | env | {"PATH": path, "PYTHONPATH": str(ROOT)}
        done = subprocess.run(
            [sys.executable, "-c", step["run"]],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == code, done.stdout + done.stderr
        assert not (tmp_path / "pwned").exists()
        if code != 2:
            assert "::notice title=gauge sanity" in done.stdout
            assert (tmp_path / given["page"]).is_file()
