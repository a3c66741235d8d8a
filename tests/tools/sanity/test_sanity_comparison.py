"""Two configurations against each other: what changes between where a policy was trained and where it runs."""

import json
import math
import re
from dataclasses import replace

import mujoco
import pytest
from planted import PLANTED, Planted, model_xml
from robot_faults import good_xml

from gauge_envs.errors import UnknownNameError
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.sanity.comparison import Change, compare
from gauge_envs.tools.sanity.robot.quantities import QUANTITIES
from gauge_envs.tools.sanity.run import check
from gauge_envs.tools.sanity.stacks import configuration


def model(planted=None):
    return mujoco.MjModel.from_xml_string(model_xml(planted))


def rows(comparison):
    return {row.id: row for row in comparison.rows}


def test_nothing_changes_between_equals():
    comparison = compare(model(), model(), only=["gravity,rest-height,slide-turned"])
    assert {row.change for row in comparison.rows} == {Change.NONE}
    assert comparison.changed == ()


def test_the_friction_of_a_foot_is_the_stated_one_times_what_slides():
    one = Planted(geom={"friction": "0.6"})
    other = Planted(geom={"friction": "1.2"}, option={"cone": "pyramidal"})
    found = rows(compare(model(one), model(other), only=["slide-wood", "slide-turned"]))
    straight, turned = found["foot-straight"], found["foot-turned"]
    # A real slide resolves 4 % of the friction, the half-width of the interval of the row.
    assert (straight.trained, straight.deployed) == pytest.approx((0.6, 1.2), rel=0.04)
    assert turned.trained == pytest.approx(0.6, rel=0.01)
    # Between the edges of a pyramid, friction is lower by the square root of 2 at most.
    assert turned.deployed == pytest.approx(1.2 / 2**0.5, rel=0.05)
    assert straight.change is turned.change is Change.LARGE
    assert found["slide-wood"].change is Change.NONE
    assert found["slide-turned"].change is Change.LARGE


def test_step_and_gravity_are_compared():
    fault = Planted(option={"timestep": "0.004", "gravity": "0 0 -9"})
    found = rows(compare(model(), model(fault), only=["step,gravity"]))
    assert set(found) == {"step", "gravity"}
    assert (found["step"].trained, found["step"].deployed) == (0.002, 0.004)
    assert found["step"].change is Change.VISIBLE
    assert (found["gravity"].trained, found["gravity"].deployed) == (9.81, 9.0)
    assert found["gravity"].change is Change.LARGE


def test_a_tilt_is_a_change_of_gravity():
    (row,) = (
        r
        for r in compare(
            model(), model(PLANTED["gravity_tilted"]), only=["gravity"]
        ).rows
        if r.id == "gravity"
    )
    assert row.trained == pytest.approx(row.deployed, abs=0.01)
    assert (row.change, row.remark) == (Change.LARGE, "the directions differ")


def test_a_backend_has_the_gravity_and_the_friction_of_the_scenes():
    found = rows(compare("mujoco", model(), only=["gravity", "slide-wood"]))
    assert found["gravity"].trained == GRAVITY_M_PER_S2
    assert found["gravity"].change is Change.NONE
    assert found["foot-straight"].trained == pytest.approx(1.0, abs=0.01)
    assert found["foot-straight"].title.endswith("over the stated one")


def test_what_is_not_measured_is_unknown():
    sliding = Planted(geom={"condim": "1"})
    found = rows(compare(model(), model(sliding), only=["creep-wood"]))
    assert found["creep-wood"].change is Change.UNKNOWN
    assert found["creep-wood"].remark.startswith("deployed: condim 1")
    late = compare(model(), model(), only=["creep-wood"], time_limit_s=0.0)
    assert rows(late)["creep-wood"].remark == (
        "trained: not measured within the time limit; deployed: not measured within the time limit"
    )
    with pytest.raises(UnknownNameError):
        compare(model(), model(), only=["colour"])


def test_the_command_compares_two_targets(tmp_path, gauge):
    margin = Planted(geom={"margin": "0.001"})
    for name, planted in {"a": None, "b": margin}.items():
        (tmp_path / f"{name}.xml").write_text(model_xml(planted))
    arguments = [
        "sanity",
        str(tmp_path / "a.xml"),
        "--against",
        str(tmp_path / "b.xml"),
        "--only",
        "rest-height",
    ]
    outcome = gauge(*arguments)
    assert outcome.exit_code == 1
    assert outcome.stdout.startswith(
        "1 of 2 rows change; most of all resting height: gap between cube and board: from"
    )
    assert "rest-height" in outcome.stdout
    first, _, row = map(json.loads, gauge(*arguments, "--json").stdout.splitlines())
    assert first["deployed"]["name"] == "b.xml"
    # Margins of both geoms add up.
    assert row["deployed"] - row["trained"] == pytest.approx(2.0, abs=0.05)
    assert gauge(*arguments, "--fail-on", "wrong").exit_code == 1
    assert gauge(*arguments, "--fail-on", "never").exit_code == 0
    assert "| rest-height |" in gauge(*arguments, "--format", "markdown").stdout
    refused = gauge(*arguments, "--out", tmp_path / "x.html")
    assert refused.exit_code == 2
    assert "expected a suffix of .md, .json" in refused.output


# --- the robot -------------------------------------------------------------------------------------------------------


def robot(xml, **changes):
    return replace(configuration(mujoco.MjModel.from_xml_string(xml)), **changes)


STATED = [f"{','.join(QUANTITIES)},control-step,robot-*,gravity"]
"""Rows of a comparison that run none of the suite's experiments."""

CHANGES = {
    "trunk of 9.6 to 16 kg": (('density="1500"', 'density="2500"'), "mass", {"trunk"}),
    "kp 80 to 40": (('kp="80"', 'kp="40"'), "kp", {"FL_hip", "RR_knee"}),
    "kv 2 to 8": (('kv="2"', 'kv="8"'), "kv", {"FL_hip", "RR_knee"}),
    "kp of one knee": (
        ('joint="FL_knee" kp="80"', 'joint="FL_knee" kp="40"'),
        "kp",
        {"FL_knee"},
    ),
    "armature": (('armature="0.005"', 'armature="0.01"'), "armature", {"FR_hip"}),
    "damping": (('damping="0.5"', 'damping="0.8"'), "damping", {"FR_hip"}),
    "a delay of 20 ms": (
        ('joint="FL_hip"', 'joint="FL_hip" delay="0.02" nsample="11"'),
        "motor-delay",
        {"FL_hip"},
    ),
    # The others were written after the comparison.
    "frictionloss": (
        ('frictionloss="0.2"', 'frictionloss="0.5"'),
        "frictionloss",
        {"FL_hip"},
    ),
    "one reversed axis": (
        ('name="RL_knee" axis="0 1 0"', 'name="RL_knee" axis="0 -1 0"'),
        "joint-axis",
        {"RL_knee y"},
    ),
    "a weaker motor": (
        (
            'joint="RR_hip" kp="80" kv="2" forcerange="-40 40"',
            'joint="RR_hip" kp="80" kv="2" forcerange="-20 20"',
        ),
        "motor-limit",
        {"RR_hip"},
    ),
    "a gear": (
        ('joint="RR_hip" kp', 'joint="RR_hip" gear="2" kp'),
        "kp",
        {"RR_hip"},
    ),
    "a longer thigh": (
        (
            '<body name="FL_calf" pos="-.15 0 -.15">',
            '<body name="FL_calf" pos="-.15 0 -.17">',
        ),
        "link-place",
        {"FL_calf z"},
    ),
    "a payload in front": (
        (
            '<geom name="trunk"',
            '<geom size=".03" mass="1" pos=".15 0 .05" contype="0" conaffinity="0"/><geom name="trunk"',
        ),
        "centre-of-mass",
        {"trunk x"},
    ),
    "a smaller range": (
        ('range="-60 240"', 'range="-60 200"'),
        "joint-range",
        {"FL_hip high"},
    ),
    "no range": (
        ('name="FL_hip" axis="0 1 0" range="-60 240"', 'name="FL_hip" axis="0 1 0"'),
        "joint-range",
        {"FL_hip low"},
    ),
    "a spring": (
        ("<joint armature", '<joint stiffness="5" armature'),
        "stiffness",
        {"FL_hip"},
    ),
    "a filter": (
        ('joint="FL_knee" kp', 'joint="FL_knee" timeconst="0.03" kp'),
        "motor-lag",
        {"FL_knee"},
    ),
    "torque instead of position": (
        (
            '<position name="FR_hip" joint="FR_hip" kp="80" kv="2"',
            '<motor name="FR_hip" joint="FR_hip"',
        ),
        "motor-gain",
        {"FR_hip"},
    ),
    "limits of a control": (
        ('joint="FR_knee" kp', 'joint="FR_knee" ctrlrange="-1 1" kp'),
        "control-range",
        {"FR_knee low"},
    ),
    "another name": (("RR_thigh", "RR_upper"), "mass", {"RR_thigh", "RR_upper"}),
    "another pose": (
        ('qpos="0 0 .322 1 0 0 0 0 0', 'qpos="0 0 .322 1 0 0 0 .1 -.1'),
        "pose",
        {"FL_hip", "FL_knee"},
    ),
    "gravcomp": (
        ('<body name="trunk"', '<body name="trunk" gravcomp="0.3"'),
        "robot-gravcomp",
        set(),
    ),
    "a leg without weight": (
        ('<body name="RL_calf"', '<body name="RL_calf" gravcomp="1"'),
        "gravcomp",
        {"RL_calf"},
    ),
    "a foot that touches nothing": (
        ('name="FL_foot"', 'name="FL_foot" contype="0" conaffinity="0"'),
        "geoms",
        {"FL_calf"},
    ),
    "a larger foot": (
        (
            'name="RR_foot" pos=".15 0 -.15" size=".022"',
            'name="RR_foot" pos=".15 0 -.15" size=".033"',
        ),
        "geom-size",
        {"RR_calf"},
    ),
    "a slippery foot": (
        ('name="RR_foot"', 'name="RR_foot" friction="2"'),
        "geom-friction",
        {"RR_calf sliding"},
    ),
    "a turned link": (
        ('<body name="FR_calf"', '<body name="FR_calf" euler="90 0 0"'),
        "link-turn",
        {"FR_calf x"},
    ),
    "a joint elsewhere": (
        ('name="RL_knee" axis', 'name="RL_knee" pos="0 0 .02" axis'),
        "joint-place",
        {"RL_knee z"},
    ),
}
"""Changes of a robot: texts, row, and parts that it names."""


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_of_the_robot_is_named(name):
    (old, new), row, parts = CHANGES[name]
    assert old in good_xml()
    trained, deployed = robot(good_xml()), robot(good_xml().replace(old, new))
    found = rows(compare(trained, deployed, only=[row]))[row]
    assert found.change in (Change.VISIBLE, Change.LARGE)
    assert parts <= {one.name for one in found.parts}


PARTS = """<mujoco><worldbody><body name="hand"><joint name="wrist"/><geom size=".05"/><site name="imu"/>
  <body name="left" pos=".1 0 0"><joint name="left" type="slide"/><geom size=".02"/></body>
  <body name="right" pos="-.1 0 0"><joint name="right" type="slide"/><geom size=".02"/></body></body>
  <body name="cube" pos="0 1 0"><freejoint/><geom size=".02" mass=".04"/></body></worldbody>
  <tendon><fixed name="split"><joint joint="left" coef="1"/><joint joint="right" coef=".5"/></fixed></tendon>
  <equality><joint joint1="left" joint2="right" polycoef="0 1 0 0 0"/></equality>
  <contact><exclude body1="hand" body2="left"/></contact>
  <actuator><position name="grip" tendon="split" kp="10"/><motor name="turn" joint="wrist" gear="2"/></actuator>
  <sensor><jointpos name="s" joint="left"/><gyro name="g" site="imu" cutoff="9"/></sensor></mujoco>"""

PART_CHANGES = {
    'coef=".5"': ('coef="-.5"', "tendon-coefficient", "split of right"),
    'mass=".04"': ('mass="40"', "mass", "cube"),
    "0 1 0 0 0": ("0 -1 0 0 0", "coupling", "left and right 1"),
    'body2="left"': ('body2="right"', "exclude", "hand and left"),
    'gear="2"': ('gear="-2"', "motor-gear", "wrist"),
    'joint="left"/><gyro': (
        'joint="right"/><gyro',
        "sensor",
        "s reads jointpos of left",
    ),
    'cutoff="9"': ('cutoff="90"', "sensor-cutoff", "g"),
    '"imu"/>': ('"imu" pos="0 .03 0"/>', "site-place", "imu y"),
}
"""Texts of `PARTS`, what they become, the row that changes and a part that it names."""


@pytest.mark.parametrize("old", PART_CHANGES)
def test_a_change_of_what_joins_parts_is_named(old):
    new, row, part = PART_CHANGES[old]
    assert PARTS.count(old) == 1
    found = rows(compare(robot(PARTS), robot(PARTS.replace(old, new)), only=[row]))[row]
    assert found.change is Change.LARGE
    assert part in {one.name for one in found.parts}


def test_sides_with_a_prefix_each_stay_apart():
    arms = """<mujoco><worldbody><body name="l/arm"><joint name="l/elbow"/><geom size=".1" mass="1"/></body>
      <body name="r/arm" pos="1 0 0"><joint name="r/elbow"/><geom size=".1" mass="1"/></body></worldbody>
      <actuator><motor joint="l/elbow"/><motor joint="r/elbow"/></actuator></mujoco>"""
    heavier = arms.replace('mass="1"/></body></w', 'mass="2"/></body></w')
    found = rows(compare(robot(arms), robot(heavier), only=["mass"]))["mass"]
    assert {one.name for one in found.parts} == {"r/arm"}


def test_motors_in_another_order_are_named():
    servo = re.compile("<position name=.._hip[^>]*/>".replace("name=", 'name="'))
    first, second = servo.findall(good_xml())[:2]
    swapped = good_xml().replace(first, "X").replace(second, first).replace("X", second)
    found = rows(compare(robot(good_xml()), robot(swapped), only=["motor-*,mass"]))
    assert {one.name for one in found["motor-order"].parts} == {"FL_hip", "FR_hip"}
    assert found["mass"].change is Change.NONE


def test_the_same_robot_has_no_change():
    comparison = compare(robot(good_xml()), robot(good_xml()), only=STATED)
    assert comparison.changed == ()
    assert {"mass", "kp", "robot-lag", "robot-stands"} <= {
        row.id for row in comparison.rows if row.change is Change.NONE
    }


def test_the_time_of_an_action_is_compared_and_judged():
    four, eight = (robot(good_xml(), frame_skip=steps) for steps in (4, 8))
    row = rows(compare(four, eight, only=["control-step"]))["control-step"]
    assert (row.trained, row.deployed, row.change) == (8.0, 16.0, Change.LARGE)
    judged = [
        check(robot(good_xml(), frame_skip=steps), only=["control-step"]).rows[0]
        for steps in (4, 10, 400)
    ]
    assert [row.is_flag for row in judged] == [False, False, True]
    # Half of the time in which a fall grows by e.
    height_m = four.robot.standing.height_m
    steps = math.floor(0.5 * math.sqrt(height_m / GRAVITY_M_PER_S2) / 0.002)
    assert f"at most {steps} steps for an action instead of 400" in judged[2].remark


def test_a_target_without_a_model_is_said_to_be_unknown():
    found = rows(compare(robot(good_xml()), "mujoco", only=["mass,robot-lag"]))
    assert found["mass"].change is found["robot-lag"].change is Change.UNKNOWN
    reason = "the target's own model is not read"
    assert found["mass"].remark == f"deployed: {reason}"
    both = rows(compare("mujoco", "mujoco", only=["mass,robot-lag"]))
    assert {(row.change, row.remark) for row in both.values() if row.id != "step"} == {
        (Change.NEITHER, reason)
    }


def test_the_command_names_masses_and_gains_and_fails(tmp_path, gauge):
    for name, text in {
        "a": good_xml(),
        "b": good_xml().replace('kp="80"', 'kp="40"'),
    }.items():
        (tmp_path / f"{name}.xml").write_text(text)
    outcome = gauge(
        "sanity", "a.xml", "--against", "b.xml", "--only", "mass,kp,kv,robot-delay"
    )
    assert outcome.exit_code == 1
    assert outcome.stdout.startswith(
        "1 of 4 rows change; 1 not compared; most of all stiffness of a servo (kp) (FL_hip)"
    )
    assert "FL_hip 80 to 40, FL_knee 80 to 40" in outcome.stdout
    assert (
        "not compared, neither the task nor an actuator states a delay: robot-delay"
        in outcome.stdout
    )
    same = gauge("sanity", "a.xml", "--against", "a.xml", "--only", "mass,kp")
    assert (same.exit_code, same.stdout.split("\n")[0]) == (
        0,
        "Nothing changes in 3 rows",
    )
