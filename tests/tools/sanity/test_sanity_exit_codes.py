"""Exit codes, formats and the action of a sanity check: green only where all was measured and passed."""

import json
import os
import subprocess
import sys
from dataclasses import replace

import pytest
import yaml
from places import ROOT
from robot_faults import faulty_xml, good_xml
from test_sanity_report import ADVICE, CREEP, NOTHING, PERIOD, SLIDE, WALL, report
from typer.testing import CliRunner

from gauge_envs.cli.app import app
from gauge_envs.pages.document import as_rows
from gauge_envs.tools import sanity
from gauge_envs.tools.sanity import check
from gauge_envs.tools.sanity.model import Verdict
from gauge_envs.tools.sanity.words import sanity_document

RUNNER = CliRunner()


def run(monkeypatch, checked, *options):
    monkeypatch.setattr(sanity, "check", lambda *_, **__: checked)
    return RUNNER.invoke(app, ["sanity", "mujoco", *options])


@pytest.mark.parametrize(
    ("rows", "options", "code"),
    [
        ((PERIOD, ADVICE), (), 0),
        ((PERIOD, NOTHING), (), 0),
        ((CREEP, PERIOD), (), 1),
        ((SLIDE, PERIOD), (), 1),
        ((SLIDE, PERIOD), ("--fail-on", "wrong"), 0),
        ((CREEP, PERIOD), ("--fail-on", "never"), 0),
        ((CREEP, WALL), (), 1),
        ((PERIOD, WALL), (), 3),
        # Nothing was measured, whether it applies or not.
        ((NOTHING,), (), 3),
        ((WALL,), ("--fail-on", "never"), 3),
    ],
)
def test_exit_codes(monkeypatch, rows, options, code):
    assert run(monkeypatch, report(*rows), *options).exit_code == code


def test_a_row_that_was_asked_for_by_name_must_be_measured(monkeypatch):
    checked = replace(report(PERIOD, NOTHING), asked=("slip",))
    assert run(monkeypatch, checked).exit_code == 3
    assert checked.unmeasured == ("slip",)


def test_rows_that_do_not_apply_and_rows_that_cannot_run_say_why(gauge, tmp_path):
    # The servos of this quadruped diverge: it stands, and what the pose would show cannot be measured.
    (tmp_path / "quadruped.xml").write_text(faulty_xml("robot-holds"))
    only = "robot-holds,robot-stands,robot-coupling"
    words = ["sanity", "quadruped.xml", "--only", only, "--json"]
    whole, *rows = map(json.loads, gauge(*words).stdout.splitlines())
    assert whole["counts"] == {"measured": 1, "declined": 1, "not_applicable": 1}
    found = {row["phenomenon"]: row for row in rows}
    assert found["robot-holds"]["verdict"] == "wrong"
    assert found["robot-stands"]["remark"].startswith("the state diverges at")
    assert found["robot-stands"]["applies"]
    assert not found["robot-coupling"]["applies"]


def test_a_check_without_time_is_not_green(gauge):
    outcome = gauge(
        *[
            "sanity",
            "HalfCheetah-v5",
            "--timeout",
            "0s",
            "--only",
            "foot-*,creep-*,robot-servo",
        ]
    )
    assert outcome.exit_code == 3
    assert (
        outcome.stdout.startswith("Incomplete: ")
        and "rows were not measured: foot-creep, " in outcome.stdout
    )


def test_feet_without_friction_are_not_green(tmp_path, gauge):
    path = tmp_path / "robot.xml"
    path.write_text(good_xml().replace("<geom friction", '<geom condim="1" friction'))
    assert gauge("sanity", path, "--only", "foot-creep").exit_code == 3
    assert gauge("sanity", path, "--only", "foot-creep,robot-friction").exit_code == 1


def test_success_is_one_line(monkeypatch):
    lines = run(monkeypatch, report(PERIOD)).stdout.splitlines()
    assert lines == ["Robot-v0: No flags: 1 row measured; 12 s"]
    assert (
        len(run(monkeypatch, report(PERIOD), "--format", "wide").stdout.splitlines())
        > 10
    )


WORSE = replace(PERIOD, configured=1.0, verdict=Verdict.VISIBLE)


@pytest.mark.parametrize(
    ("rows", "options", "code"),
    [
        # The interval is 0.5 mm/s wide on each side, and the creep was 28 mm/s.
        *(((replace(CREEP, configured=c),), (), 0) for c in (-28.4, -20.0, 28.0)),
        *(((replace(CREEP, configured=c),), (), 1) for c in (-29.0, -280.0, None)),
        ((CREEP, SLIDE), (), 1),
        ((CREEP, WALL), (), 3),
        ((CREEP, PERIOD), (), 0),
        ((CREEP, WORSE), (), 1),
        ((CREEP, WORSE), ("--fail-on", "wrong"), 0),
        ((ADVICE, PERIOD), (), 0),
    ],
)
def test_a_baseline_compares_values_with_their_intervals(
    rows, options, code, monkeypatch, tmp_path
):
    before = tmp_path / "before.json"
    known = as_rows(sanity_document(report(CREEP, PERIOD)))
    before.write_text("\n".join(map(json.dumps, known)))
    options = ("--baseline", str(before), *options)
    outcome = run(monkeypatch, report(*rows), *options)
    assert outcome.exit_code == code
    if WORSE in rows and code:
        assert (
            "period: visible, 1 mm/s, 2 half-widths from reality; was inside"
            in outcome.stderr
        )


@pytest.mark.parametrize("number", [10**400, 0, "x"])
def test_a_baseline_with_a_number_that_is_none_is_an_error(
    number, monkeypatch, tmp_path
):
    row = {
        "phenomenon": "creep-wood",
        "verdict": "wrong",
        "configured": number,
        "parts": [],
    }
    before = tmp_path / "before.json"
    before.write_text(json.dumps(row | {"reality": {"value": 0, "tolerance": 0}}))
    outcome = run(monkeypatch, report(CREEP), "--baseline", str(before))
    assert (
        outcome.exit_code == 2
        and "is not the output of this version's gauge sanity --json" in outcome.stderr
    )


FINGER = (
    '<geom name="trunk"',
    '<body name="finger" pos=".22 0 .1"><joint name="finger" axis="0 1 0" range="-1 1" armature="0.3" damping="0"/>'
    '<geom type="capsule" fromto="0 0 0 .04 0 0" size=".01" contype="0" conaffinity="0"/></body><geom name="trunk"',
)
"""A finger whose armature is far larger than it can have, on the back of the quadruped."""


def with_finger(*changes):
    text = good_xml()
    servo = '<position name="finger" joint="finger" kp="2" kv="0.1" forcerange="-2 2"/></actuator>'
    end = ('qpos="0 0 .322 1 0 0 0 0', 'qpos="0 0 .322 1 0 0 0 0 0')
    for old, new in (FINGER, ("</actuator>", servo), end, *changes):
        assert old in text, old
        text = text.replace(old, new)
    return text


def test_a_known_part_hides_no_other_part_of_its_row(gauge, tmp_path):
    (tmp_path / "robot.xml").write_text(with_finger())
    words = [
        "sanity",
        "robot.xml",
        "--only",
        "robot-armature,robot-damp*,robot-inertia",
    ]
    before = gauge(*words, "--json")
    (tmp_path / "before.json").write_text(before.stdout)
    known = {
        row["phenomenon"]: row
        for row in map(json.loads, before.stdout.splitlines()[1:])
    }
    flagged = {
        one["name"]
        for one in known["robot-armature"]["parts"]
        if one["verdict"] != "inside"
    }
    assert flagged == {"finger"}
    again = gauge(*words, "--baseline", "before.json")
    assert (again.exit_code, "regression" in again.stderr) == (0, False)
    heavy = with_finger(('<joint armature="0.005"', '<joint armature="1"'))
    (tmp_path / "robot.xml").write_text(heavy)
    outcome = gauge(*words, "--baseline", "before.json")
    legs = {
        f"{leg}_{joint}"
        for leg in ("FL", "FR", "RL", "RR")
        for joint in ("hip", "knee")
    }
    named = {
        line.split(", ")[1].split(":")[0]
        for line in outcome.stderr.splitlines()
        if "regression" in line
    }
    assert (outcome.exit_code, named) == (1, legs)


def test_a_baseline_without_parts_is_to_be_written_again(monkeypatch, tmp_path):
    rows = as_rows(sanity_document(report(CREEP, PERIOD)))
    for row in rows:
        row.pop("parts", None)
    before = tmp_path / "before.json"
    before.write_text("\n".join(map(json.dumps, rows)))
    outcome = run(monkeypatch, report(CREEP), "--baseline", str(before))
    assert outcome.exit_code == 2 and "write it again" in outcome.stderr


# --- action ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("target", "options", "more", "code"),
    [
        ("robot.xml", "--only robot-friction", {}, 0),
        ("my robot.xml", "--only 'robot-friction, gravity'", {}, 1),
        ("my robot.xml", "--only robot-friction", {"baseline": "rows.json"}, 0),
        ("robot.xml", "--only foot-creep --timeout 0s", {}, 3),
        ("robot.xml; touch pwned", "--only gravity ; touch pwned", {}, 2),
        ("--fail-on=never", "--only `touch pwned`", {}, 2),
    ],
)
def test_the_check_of_the_action_runs(tmp_path, target, options, more, code):
    action = yaml.safe_load((ROOT / "action.yml").read_text())
    values = {name: one.get("default", "") for name, one in action["inputs"].items()}
    command = f'#!/bin/sh\nexec {sys.executable} -c "from gauge_command import main; main()" "$@"\n'
    (tmp_path / "gauge").write_text(command)
    (tmp_path / "gauge").chmod(0o755)
    (tmp_path / "robot.xml").write_text(good_xml())
    (tmp_path / "my robot.xml").write_text(faulty_xml("robot-friction"))
    report = check(str(tmp_path / "my robot.xml"), only=["robot-friction"])
    known = as_rows(sanity_document(report))
    (tmp_path / "rows.json").write_text("\n".join(map(json.dumps, known)))
    given = values | {"target": target, "options": options} | more
    (step,) = [one for one in action["runs"]["steps"] if one["name"] == "Check"]
    env = {
        name: given[text.strip("${ }").removeprefix("inputs.")]
        for name, text in step["env"].items()
    }
    path = os.pathsep.join([str(tmp_path), os.environ["PATH"]])
    env |= {"PATH": path, "PYTHONPATH": str(ROOT), "GITHUB_STEP_SUMMARY": "summary.md"}
    done = subprocess.run(
        [sys.executable, "-c", step["run"]],
        cwd=tmp_path,
        env=os.environ | env,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == code, done.stdout + done.stderr
    assert not (tmp_path / "pwned").exists()
    assert (code == 2) != (tmp_path / "gauge-sanity.md").is_file()
    assert (code == 2) != (tmp_path / "summary.md").is_file()
