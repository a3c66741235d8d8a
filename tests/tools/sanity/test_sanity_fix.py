"""The fix: planted contact faults are resolved by the first line and by the written file, and two targets differ."""

import json
import re
from difflib import SequenceMatcher

import mujoco
import pytest
from quadruped import GOOD, quadruped_xml

from gauge_envs.tools.sanity import check, configuration
from gauge_envs.tools.sanity.fixes.change import applied
from gauge_envs.tools.sanity.fixes.harm import motion_harm

pytestmark = pytest.mark.usefixtures("shared_measurements")

OPTION = 'timestep="0.002" integrator="implicitfast"'
FLAT = f'{OPTION} cone="elliptic" impratio="100"'

PLANTED = {
    "margin": ({"geom": GOOD["geom"] + ' margin="0.01"'}, "rest-height"),
    "solimp": ({"geom": 'solref="0.02 1" solimp="0 0.8 0.01"'}, "rest-height"),
    "solref": ({"geom": 'solref="0.2 1"'}, "rest-height"),
    "cone": ({"option": f'{OPTION} impratio="100"'}, "slide-turned"),
    "iterations": (
        {"option": 'timestep="0.004" iterations="1" ls_iterations="5"', "geom": ""},
        "slide-wood",
    ),
    "timestep": ({"option": FLAT.replace("0.002", "0.02")}, "slide-wood"),
}
"""Changes of the good quadruped, and a check that detects them, by the attribute of the fix."""


SLOW = ("solimp", "solref", "iterations")
"""Faults that further tests correct too, or that are of the kind of another one."""


@pytest.mark.parametrize(
    "attribute",
    [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in PLANTED],
)
def test_a_planted_fault_is_resolved_by_the_first_line(attribute):
    changes, name = PLANTED[attribute]
    model = mujoco.MjModel.from_xml_string(quadruped_xml(**changes))
    report = check(model, only=[name])
    assert [*report.flags] == [name]
    assert report.fix is not None and attribute in report.fix.line
    changed = applied(report.configuration, report.fix.changes)
    assert not check(changed, only=[name]).flags


def test_a_right_model_has_no_fix():
    model = mujoco.MjModel.from_xml_string(quadruped_xml())
    report = check(model, only=["foot-*", "creep-*", "slide-*"])
    assert not report.flags and report.fix is None


# --- the written file ------------------------------------------------------------------------------------------------

PAIRS = "".join(
    f'<pair geom1="floor" geom2="{leg}_foot" solref="0.2 1"/>'
    for leg in ("FL", "FR", "RL", "RR")
)


def written(gauge, folder, text, name):
    """Return the lines of a model that `--fix` changes, as pairs of before and after."""
    (folder / "robot.xml").write_text(text)
    outcome = gauge("sanity", "robot.xml", "--only", name, "--fix", "out/fixed.xml")
    assert "1 of 1 findings are" in outcome.stderr
    assert "finding" not in gauge("sanity", "out/fixed.xml", "--only", name).stdout
    lines = (folder / "out" / "fixed.xml").read_text().splitlines()
    blocks = SequenceMatcher(None, text.splitlines(), lines).get_opcodes()
    return [
        (text.splitlines()[a:b], lines[c:d])
        for kind, a, b, c, d in blocks
        if kind != "equal"
    ]


@pytest.mark.parametrize("name", ["solimp", "pairs", "timestep"])
def test_the_written_text_differs_in_attributes_alone(name, gauge, tmp_path):
    changes, check = PLANTED.get(name, ({}, "rest-height"))
    text = quadruped_xml(**changes)
    if name == "pairs":
        text = text.replace("</mujoco>", f"<contact>{PAIRS}</contact></mujoco>")
    number = re.compile(r'(timestep|solref|solimp)="[^"]*"')
    differing = written(gauge, tmp_path, text, check)
    assert differing
    for before, after in differing:
        texts = [[number.sub("", line) for line in lines] for lines in (before, after)]
        assert texts[0] == texts[1]


def test_attributes_that_a_file_lacks_are_inserted(gauge, tmp_path):
    text = quadruped_xml(option="", geom="", friction=0.6)
    text = text.replace("<option />", "")
    text = text.replace('<geom friction="0.6 0.005 0.0001" />', "")
    ((_, after),) = written(gauge, tmp_path, text, "slide-turned")
    assert ' cone="elliptic"' in "".join(after)


@pytest.mark.parametrize("folder", [pytest.param(".", marks=pytest.mark.slow), "out"])
def test_an_included_file_is_written_beside_the_fixed_one(folder, gauge, tmp_path):
    """A class of a file that another included file includes; the user's files stay."""
    text = quadruped_xml(**PLANTED["solref"][0])
    files = {
        "robot.xml": text,
        "body.xml": '<mujoco><include file="robot.xml"/></mujoco>',
        "scene.xml": '<mujoco>\n  <include file="body.xml"/>\n</mujoco>',
    }
    for name, content in files.items():
        (tmp_path / name).write_text(content)
    words = ("sanity", "--only", "rest-height")
    outcome = gauge(*words, "scene.xml", "--fix", f"{folder}/new.xml")
    assert "1 of 1 findings are resolved" in outcome.stderr
    assert "finding" not in gauge(*words, f"{folder}/new.xml").stdout
    assert 'file="new_body.xml"' in (tmp_path / folder / "new.xml").read_text()
    assert {name: (tmp_path / name).read_text() for name in files} == files
    assert not [*tmp_path.rglob(".*")]


@pytest.mark.parametrize("is_included", [True, False])
def test_attributes_that_findings_name_are_written(is_included, gauge, tmp_path):
    text = quadruped_xml(foot='solimp=".9 .1 .001"')
    (tmp_path / "robot.xml").write_text(text)
    (tmp_path / "scene.xml").write_text('<mujoco><include file="robot.xml"/></mujoco>')
    name = "scene.xml" if is_included else "robot.xml"
    words = ("sanity", "--only", "stated-solimp")
    outcome = gauge(*words, name, "--fix", "new.xml")
    assert "1 of 1 findings are resolved" in outcome.stderr
    assert gauge(*words, "--strict", "new.xml").exit_code == 0


def test_nothing_is_written_when_all_checks_pass(gauge, tmp_path):
    (tmp_path / "robot.xml").write_text(quadruped_xml())
    outcome = gauge("sanity", "robot.xml", "--only", "gravity", "--fix", "fixed.xml")
    assert outcome.exit_code == 0
    assert "is not written: all checks passed" in outcome.stderr
    assert not (tmp_path / "fixed.xml").exists()


def test_a_fix_keeps_the_task(tmp_path):
    """On a slope by a tilted gravity, a pyramid of friction is 63 % off in its diagonal."""
    text = """<mujoco>
  <option timestep="0.002" gravity="3.4684 3.4684 -8.4957"/>
  <worldbody>
    <geom name="board" type="plane" size="5 5 0.1" friction="0.4"/>
    <body pos="0 0 0.05"><freejoint/><geom type="box" size="0.05 0.05 0.05" friction="0.4" mass="1"/></body>
  </worldbody>
</mujoco>"""
    (tmp_path / "slope.xml").write_text(text)
    report = check(str(tmp_path / "slope.xml"), only=["gravity", "slide-turned"])
    assert "slide-turned" in report.flags
    assert report.fix.changes == {"cone": "elliptic"}
    assert report.fix.lines == (
        '- <option timestep="0.002" gravity="3.4684 3.4684 -8.4957"/>',
        '+ <option timestep="0.002" gravity="3.4684 3.4684 -8.4957" cone="elliptic"/>',
    )


# --- harm ------------------------------------------------------------------------------------------------------------

BURIED = """<mujoco>
  <option timestep="0.002" cone="elliptic"/>
  <default><geom solref="0.02 1" friction="0.6"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 0.1"/>
    <body name="trunk" pos="0 0 {height}"><freejoint/><geom type="box" size="0.1 0.08 0.05" mass="2"/>
      <body pos="0.08 0 0.05"><joint name="neck" axis="0 1 0" damping="0.5"/><geom size="0.02" mass="0.1"/></body>
    </body>
  </worldbody>
  <actuator><position joint="neck" kp="5"/></actuator>
</mujoco>"""


@pytest.mark.parametrize(("depth_m", "is_harm"), [(0.017, True), (0.0, False)])
def test_a_change_that_throws_the_model_up_is_rejected(depth_m, is_harm):
    """A contact that is five times stiffer pushes a box out of the floor 25 times as hard: it leaves the floor fast."""
    text = BURIED.format(height=0.05 - depth_m)
    soft = configuration(mujoco.MjModel.from_xml_string(text))
    stiff = applied(soft, {"contact_solref": (0.004, 1.0)})
    assert motion_harm(soft.robot, stiff.robot) is is_harm


@pytest.mark.parametrize(("friction", "is_harm"), [(0.2, True), (0.9, False)])
def test_a_change_that_lets_a_resting_body_slide_is_rejected(friction, is_harm):
    """Coulomb: a box on a slope of 27 degrees rests with friction above 0.5."""
    text = """<mujoco><option cone="elliptic" gravity="4.4 0 -8.77"/>
  <default><geom friction="{}"/></default>
  <worldbody><geom type="plane" size="5 5 0.1"/>
    <body pos="0 0 0.1"><freejoint/><geom type="box" size="0.1 0.1 0.1" mass="1"/></body>
  </worldbody>
</mujoco>"""
    rests, changed = (
        configuration(mujoco.MjModel.from_xml_string(text.format(value))).robot
        for value in (0.8, friction)
    )
    assert motion_harm(rests, changed) is is_harm


def test_a_connection_that_opens_gets_stiffer_alone(tmp_path):
    """A load of 60 kg on a hook of 20 g; a weld of another softness, such as one for mocap, stays."""
    text = """<mujoco>
  <worldbody>
    <body name="hook" pos="0 0 1"><joint type="slide" axis="0 0 1"/><geom size="0.02" mass="0.02"/></body>
    <body name="load" pos="0 0 0.8"><freejoint/><geom type="box" size="0.05 0.05 0.05" mass="60"/></body>
    <body name="hand" pos="1 0 1" mocap="true"/>
    <body name="tool" pos="1 0 1"><freejoint/><geom size="0.02" mass="0.02"/></body>
  </worldbody>
  <equality>
    <connect body1="hook" anchor="0 0 0"/>
    <connect body1="load" body2="hook" anchor="0 0 0.2"/>
    <weld body1="hand" body2="tool" solref="0.1 1"/>
  </equality>
</mujoco>"""
    (tmp_path / "hang.xml").write_text(text)
    report = check(str(tmp_path / "hang.xml"), only=["model-constraints"])
    assert [*report.fix.fixed] == ["model-constraints"]
    changed = applied(report.configuration, report.fix.changes).robot.model
    assert changed.eq_solref[2].tolist() == [0.1, 1.0]


def test_a_check_that_no_setting_changes_does_not_hide_the_fix():
    """A body ten times as dense as lead stays."""
    text = quadruped_xml(geom='solref="0.2 1"').replace("7.84", "784")
    model = mujoco.MjModel.from_xml_string(text)
    report = check(model, only=["density", "rest-height"])
    assert {"density", "rest-height"} <= set(report.flags)
    assert len(report.fix.fixed) == 1


@pytest.mark.slow
def test_a_wrong_sparse_solver_is_replaced_by_the_dense_one():
    """Eight chains of five links in a pile, which MuJoCo 4.0.0 solves wrongly with a sparse Jacobian."""
    link = '<geom type="capsule" fromto="0 0 0 .1 0 0" size=".03"/>'
    joint = '<body pos=".1 0 0"><joint axis="0 {} {}" range="-90 90"/>'
    chain = link + "".join(joint.format(n % 2, 1 - n % 2) + link for n in range(4))
    bodies = "".join(
        f'<body name="c{k}" pos="{0.03 * (k * 5 % 7) - 0.1} {0.03 * (k * 3 % 7) - 0.1} {0.1 + 0.09 * k}"><freejoint/>'
        f"{chain}{4 * '</body>'}</body>"
        for k in range(8)
    )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="0.004"/><worldbody><geom type="plane" size="2 2 1"/>{bodies}</worldbody></mujoco>'
    )
    report = check(model, only=["model-solver"])
    assert not report.flags or report.fix.changes == {"jacobian": "dense"}


# --- two targets -----------------------------------------------------------------------------------------------------


def test_two_targets_are_shown_side_by_side(gauge, tmp_path):
    soft = quadruped_xml(geom=PLANTED["solref"][0]["geom"])
    (tmp_path / "good.xml").write_text(quadruped_xml())
    (tmp_path / "soft.xml").write_text(soft)
    words = ["sanity", "good.xml", "--only", "gravity,rest-height", "--against"]
    assert gauge(*words, "good.xml").exit_code == 0
    outcome = gauge(*words, "soft.xml", "--json", "--out", "both.json")
    assert json.loads((tmp_path / "both.json").read_text())[2]["is_changed"]
    assert outcome.exit_code == 0
    assert gauge(*words, "soft.xml", "--strict").exit_code == 1
    names, gravity, rest = map(json.loads, outcome.stdout.splitlines())
    assert (names["first"], names["second"]) == ("good.xml", "soft.xml")
    assert "solref of geom FL_foot: 0.004 1 to 0.2 1" in names["changes"]
    assert not gravity["is_changed"] and rest["is_changed"]
    assert (rest["first_verdict"], rest["second_verdict"]) == ("passed", "failed")
    assert abs(rest["first"]) < 0.1 and rest["second"] < -1.0
