"""The cure: planted contact faults are corrected by the first line and by the written file, and two targets differ."""

import json

import mujoco
import pytest
from quadruped import GOOD, quadruped_xml

from gauge_envs.tools.sanity import check, configuration
from gauge_envs.tools.sanity.candidates import CANDIDATES
from gauge_envs.tools.sanity.cure import applied

OPTION = 'timestep="0.002" integrator="implicitfast"'
FLAT = f'{OPTION} cone="elliptic" impratio="100"'

PLANTED = {
    "gravity": ({"option": f'{FLAT} gravity="0 0 -9"'}, "gravity", "gravity"),
    "margin": ({"geom": GOOD["geom"] + ' margin="0.01"'}, "rest-height", "margin"),
    "solimp": (
        {"geom": 'solref="0.02 1" solimp="0 0.8 0.01"'},
        "rest-height",
        "solimp",
    ),
    "solref": ({"geom": 'solref="0.2 1"'}, "rest-height", "solref"),
    "foot": ({"foot": 'priority="1" solref="0.2 1"'}, "rest-height", "solref"),
    "cone": ({"option": f'{OPTION} impratio="100"'}, "slide-turned", "cone"),
    "impratio": (
        {"option": f'{OPTION} cone="elliptic" impratio="0.01"'},
        "creep-wood",
        "impratio",
    ),
    "iterations": (
        {"option": 'timestep="0.004" iterations="1" ls_iterations="5"', "geom": ""},
        "slide-wood",
        "iterations",
    ),
    "step": ({"option": FLAT.replace("0.002", "0.02")}, "point", "timestep"),
}
"""Changes of the good quadruped, a row that finds them, and an attribute of the first line."""


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_fault_is_corrected_by_the_first_line(name):
    changes, row, attribute = PLANTED[name]
    model = mujoco.MjModel.from_xml_string(quadruped_xml(**changes))
    report = check(model, only=[row])
    assert [*report.flags] == [row]
    assert report.cure is not None and attribute in report.cure.line
    changed, _ = applied(report.configuration, report.cure.changes)
    assert not check(changed, only=[row]).flags


def test_a_right_model_has_no_cure():
    model = mujoco.MjModel.from_xml_string(quadruped_xml())
    report = check(model, only=["foot-*", "creep-*", "slide-*"])
    assert not report.flags and report.cure is None and report.tried == ()


def test_candidates_change_known_settings_alone():
    known = configuration("HalfCheetah-v5").settings
    names = {name for one in CANDIDATES["mujoco"] for name in one}
    assert names - {*known} == {"condim", "contact_margin_m", "o_friction"}


PAIRS = "".join(
    f'<pair geom1="floor" geom2="{leg}_foot" solref="0.2 1"/>'
    for leg in ("FL", "FR", "RL", "RR")
)
PICTURE = '<asset><texture name="one" type="2d" file="absent.png"/></asset>'


@pytest.mark.parametrize("name", ["solimp", "foot", "pairs", "step"])
def test_the_fixed_file_has_the_change_and_no_flag(name, gauge, tmp_path):
    changes, row, _ = PLANTED.get(name, ({}, "rest-height", "solref"))
    text = quadruped_xml(**changes).replace("<worldbody>", f"{PICTURE}<worldbody>")
    if name == "pairs":
        text = text.replace("</mujoco>", f"<contact>{PAIRS}</contact></mujoco>")
    (tmp_path / "robot.xml").write_text(text)
    outcome = gauge("sanity", "robot.xml", "--only", row, "--fix", "out/fixed.xml")
    assert outcome.exit_code == 1
    assert "1 of 1 flags are gone" in outcome.stderr
    fixed = (tmp_path / "out" / "fixed.xml").read_text()
    assert "<!-- gauge sanity: " in fixed and 'file="absent.png"' in fixed
    assert gauge("sanity", "out/fixed.xml", "--only", row).exit_code == 0


def test_nothing_is_written_without_a_cure(gauge, tmp_path):
    (tmp_path / "robot.xml").write_text(quadruped_xml())
    outcome = gauge("sanity", "robot.xml", "--only", "gravity", "--fix", "fixed.xml")
    assert outcome.exit_code == 0
    assert "is not written: nothing is flagged" in outcome.stderr
    assert not (tmp_path / "fixed.xml").exists()


def test_two_targets_are_shown_row_by_row(gauge, tmp_path):
    soft = quadruped_xml(geom=PLANTED["solref"][0]["geom"])
    (tmp_path / "good.xml").write_text(quadruped_xml())
    (tmp_path / "soft.xml").write_text(soft)
    words = ["sanity", "good.xml", "--only", "gravity,rest-height", "--against"]
    assert gauge(*words, "good.xml").exit_code == 0
    outcome = gauge(*words, "soft.xml", "--json")
    assert outcome.exit_code == 1
    assert gauge(*words, "soft.xml", "--fail-on", "never").exit_code == 0
    names, gravity, rest = map(json.loads, outcome.stdout.splitlines())
    assert names == {"first": "good.xml", "second": "soft.xml"}
    assert not gravity["is_changed"] and rest["is_changed"]
    assert rest["first_verdict"] == "inside" and rest["second_verdict"] == "wrong"
    assert abs(rest["first"]) < 0.1 and rest["second"] < -1.0
