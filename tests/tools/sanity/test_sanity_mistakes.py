"""Planted mistakes in an arm, a quadruped, a biped and a hand are named, and the robots without one have no flag."""

import re
from pathlib import Path

import arm_faults
import gymnasium
import mujoco
import numpy as np
import pytest
from more_faults import FURTHER, GOOD, LATER, MISTAKES, biped_xml

from gauge_envs.tools.sanity.model import Verdict
from gauge_envs.tools.sanity.phenomena import ROBOT_IDS
from gauge_envs.tools.sanity.robot.alike import factors
from gauge_envs.tools.sanity.robot.legs import bent_legs_nm
from gauge_envs.tools.sanity.robot.mujoco_model import mujoco_configuration
from gauge_envs.tools.sanity.robot.remedies import REMEDIES
from gauge_envs.tools.sanity.robot.stance_rows import outside
from gauge_envs.tools.sanity.target_checks import robot_row

UNNAMED = 1 / 20
"""Largest share of mistakes whose row is not flagged."""


def robot_of(xml):
    spec = mujoco.MjSpec.from_string(xml)
    found = mujoco_configuration(spec.compile(), name="robot", source="test", spec=spec)
    return found.robot


@pytest.mark.parametrize("name", GOOD)
def test_a_robot_without_a_mistake_has_no_flag(name):
    robot = robot_of(GOOD[name]())
    rows = [robot_row(one, robot) for one in ROBOT_IDS]
    assert [(row.phenomenon, row.configured) for row in rows if row.is_flag] == []


def test_all_rows_on_a_robot_are_measured_on_an_arm_or_say_why():
    robot = robot_of(GOOD["arm"]())
    rows = [robot_row(name, robot) for name in ROBOT_IDS]
    missing = [row for row in rows if row.verdict is Verdict.DECLINED]
    assert all(row.remark for row in missing)
    assert {f"robot-{name}" for name in OF_ARMS}.isdisjoint(
        row.phenomenon for row in missing
    )


OF_ARMS = (
    *("holds", "saturation", "overlap", "energy", "torque", "damping"),
    *("frictionloss", "armature", "rotor", "servo", "stiffness", "lag", "sag"),
)
"""Rows that must be measured on a fixed base."""

LINK = '<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03"/>'
NO_SHAPE = '<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>'
SERVO = '<position joint="j" kp="10" kv="1"/>'
ODD = {
    "no shape": (NO_SHAPE, '<motor joint="j" forcerange="-5 5"/>', ""),
    "no gear": (LINK, '<position joint="j" kp="10" gear="0"/>', ""),
    "adhesion": (LINK, f'{SERVO}<adhesion body="b" ctrlrange="0 1"/>', ""),
    "no gravity": (LINK, SERVO, '<option gravity="0 0 0"/>'),
}


@pytest.mark.parametrize("name", ODD)
def test_no_row_ends_in_an_error_on_an_odd_robot(name):
    link, actuators, option = ODD[name]
    robot = robot_of(
        f"""<mujoco><compiler angle="radian"/>{option}<worldbody><geom type="plane" size="5 5 0.1"/>
        <body name="b" pos="0 0 0.02"><joint name="j" axis="0 1 0" range="-1 1" armature="0.01"/>{link}</body>
        </worldbody><actuator>{actuators}</actuator></mujoco>"""
    )
    rows = {one: robot_row(one, robot) for one in ROBOT_IDS}
    # Without a size nothing is too strong for it, and lengths have no unit.
    assert (rows["robot-size"].verdict is Verdict.DECLINED) == (name == "no shape")
    assert rows["robot-torque"].configured != 0.0


def hand_of_two(*, motor="", extra="", coupling=""):
    """Return an arm of three joints with two fingers on slides, of which one has a motor."""
    fingers = "".join(
        f"""<body pos=".25 {y} 0"><joint name="{name}" type="slide" axis="0 {sign} 0" range="0 .04" armature=".1"/>
        <geom type="box" pos=".03 0 0" size=".03 .005 .01"/></body>"""
        for name, y, sign in (("left", 0.02, 1), ("right", -0.02, -1))
    )
    servo = 'kp="200" kv="12" forcerange="-30 30" ctrlrange="-1 1"'
    joint = 'axis="0 1 0" range="-1 1" armature=".02" damping="1" frictionloss=".3"'
    link = '<geom type="capsule" fromto=".06 0 0 .2 0 0" size=".03"/>'
    links = "".join(
        f'<body pos=".25 0 0"><joint name="{n}" {joint}/>{link}' for n in "abc"
    )
    return f"""<mujoco><compiler angle="radian"/><option integrator="implicitfast"/><worldbody>
      {links}{fingers}</body></body></body></worldbody><equality>{coupling}</equality><actuator>
      <position joint="a" {servo} {motor}/><position joint="b" {servo}/><position joint="c" {servo}/>{extra}
      <position joint="left" kp="500" kv="20" forcerange="-30 30"/></actuator></mujoco>"""


COUPLED = '<joint joint1="right" joint2="left" solref=".005 1"/>'
GEARED = '<joint joint1="b" joint2="c" polycoef="0 2 0 0 0" solref=".005 1"/>'
CHAINED = '<joint joint1="a" joint2="b" solref=".005 1"/>'
SECOND = '<position name="d" joint="b" kp="200" kv="12" forcerange="-30 30" ctrlrange="-1 1"/>'


@pytest.mark.parametrize(
    ("change", "row", "verdict"),
    [
        ({"coupling": COUPLED}, "robot-torque", Verdict.INSIDE),
        ({}, "robot-torque", Verdict.WRONG),
        ({"coupling": COUPLED}, "robot-command", Verdict.INSIDE),
        ({"motor": 'gear="-1"'}, "robot-command", Verdict.VISIBLE),
        ({"extra": SECOND}, "robot-command", Verdict.VISIBLE),
        (
            {"coupling": COUPLED + GEARED},
            "robot-lag",
            Verdict.INSIDE,
        ),
        (
            {"coupling": COUPLED + GEARED + CHAINED},
            "robot-lag",
            Verdict.INSIDE,
        ),
    ],
    ids=[
        "fingers",
        "a loose finger",
        "motors",
        "a turned motor",
        "two motors",
        "coupled servos",
        "a chain of couplings",
    ],
)
def test_what_can_be_on_purpose_is_not_wrong(change, row, verdict):
    assert robot_row(row, robot_of(hand_of_two(**change))).verdict is verdict


def pulled(*, coefficient=0.5, kp=500.0, per_control=1.0):
    """Return the hand of two fingers with a servo on a tendon of both, which 40 mm of its command close."""
    servo = f'''<general name="pull" tendon="pull" biastype="affine" gainprm="{kp * per_control}"
        biasprm="0 {-kp} -20" ctrlrange="0 .04" forcerange="-30 30"/>'''
    tendon = f'''<tendon><fixed name="pull"><joint joint="left" coef=".5"/>
        <joint joint="right" coef="{coefficient}"/></fixed></tendon></mujoco>'''
    return hand_of_two(extra=servo).replace("</mujoco>", tendon)


def chain(*, kp=200, last_range="-1 1", armature=0.02, last_armature=None):
    """Return an arm of five joints in a row, whose last servo, limits or armature are another one's."""
    bodies, servos = "", ""
    for number in range(5):
        is_last = number == 4
        joint_range = last_range if is_last else "-1 1"
        rotor = last_armature if is_last and last_armature else armature
        bodies += f'''<body pos=".2 0 0"><joint name="j{number}" axis="0 1 0" range="{joint_range}" armature="{rotor}"
            damping="1" frictionloss=".3"/><geom type="capsule" fromto=".06 0 0 .2 0 0" size=".03"/>'''
        gain = kp if is_last else 200
        servos += f'<position joint="j{number}" kp="{gain}" kv="12" forcerange="-30 30" ctrlrange="-1 1"/>'
    return f"""<mujoco><compiler angle="radian"/><worldbody>{bodies}{"</body>" * 5}</worldbody>
      <actuator>{servos}</actuator></mujoco>"""


def table(*, axis="1 0 0"):
    """Return four legs that swing aside, of which one may turn the other way."""
    legs, servos = "", ""
    for leg, (x, y) in enumerate(((0.3, 0.1), (0.3, -0.1), (-0.3, 0.1), (-0.3, -0.1))):
        legs += f'''<body pos="{x} {y} 0"><joint name="leg{leg}" axis="{axis if leg == 3 else "1 0 0"}" range="-1 1"/>
          <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03"/></body>'''
        servos += f'<position joint="leg{leg}" kp="100" kv="5"/>'
    return f"""<mujoco><compiler angle="radian"/><worldbody><body><geom type="box" size=".4 .1 .05"/>{legs}</body>
      </worldbody><actuator>{servos}</actuator></mujoco>"""


def claw(*, last_m=0.01):
    """Return three fingers around a palm, which swing aside; two are images of each other but for their ranges."""
    fingers, motors = "", ""
    for finger, turn in enumerate(np.radians((330.0, 90.0, 210.0))):
        place = f"{0.1 * np.cos(turn)} {0.1 * np.sin(turn)} 0"
        size = last_m if finger == 2 else 0.01
        fingers += f'''<body pos="{place}" euler="0 0 {turn}"><joint name="f{finger}" axis="1 0 0" range="-.4 1.3"/>
          <geom type="capsule" fromto="0 0 0 0 0 .1" size="{size}"/></body>'''
        motors += f'<motor joint="f{finger}" forcerange="-1 1" ctrlrange="-1 1"/>'
    return f"""<mujoco><compiler angle="radian"/><worldbody><body><geom size=".05"/>{fingers}</body></worldbody>
      <actuator>{motors}</actuator></mujoco>"""


def four_bar(*, kv=1):
    """Return a servo that turns a parallelogram, which a `connect` closes."""
    bar = 'type="capsule" size=".01" contype="0" conaffinity="0"'
    return f"""<mujoco><default><joint axis="0 1 0" damping=".01"/></default><worldbody>
      <body><joint name="driven"/><geom {bar} fromto="0 0 0 0 0 .1"/>
        <body name="coupler" pos="0 0 .1"><joint/><geom {bar} fromto="0 0 0 .1 0 0"/></body></body>
      <body name="follower" pos=".1 0 0"><joint/><geom {bar} fromto="0 0 0 0 0 .1"/></body></worldbody>
      <equality><connect body1="coupler" body2="follower" anchor=".1 0 0"/></equality>
      <actuator><position joint="driven" kp="10" kv="{kv}" forcerange="-20 20"/></actuator></mujoco>"""


def paw(*, quat=".7071 .7071 0 0", kp=10, coefficient=1):
    """Return six fingers of four joints, each with a tendon; one may be turned, one pair of joints driven otherwise."""
    fingers, servos, tendons = "", "", ""
    for finger, name in enumerate(("ann", "bob", "cid", "dan", "eve", "fay")):
        turn = quat if name == "cid" else ".7071 .7071 0 0"
        fingers += (
            f'<body name="{name}" pos=".05 {0.05 * finger - 0.125} 0" quat="{turn}">'
        )
        for joint in range(4):
            part = f"{name}{joint}"
            fingers += f'''<joint name="{part}" axis="0 0 1" range="-1 1" damping=".1"/>
              <geom type="capsule" fromto="0 0 0 .04 0 0" size=".008"/><body pos=".04 0 0">'''
            gain = kp if joint == 0 and name in ("bob", "eve") else 10 * (joint + 1)
            servos += f'<position joint="{part}" kp="{gain}" forcerange="-{4 - joint} {4 - joint}"/>'
        fingers += '<geom size=".008"/>' + "</body>" * 5
        ratio = coefficient if name == "ann" else 1
        tendons += f'''<fixed name="{name}"><joint joint="{name}2" coef="1"/>
          <joint joint="{name}3" coef="{ratio}"/></fixed>'''
    return f"""<mujoco><compiler angle="radian"/><worldbody><body name="palm"><geom type="box" size=".05 .15 .02"/>
      {fingers}</body></worldbody><tendon>{tendons}</tendon><actuator>{servos}</actuator></mujoco>"""


def row_of_fingers(*places):
    """Return copies of a finger beside each other, whose links have more on one side, and the last one is longer."""
    fingers = "".join(
        f"""<body pos="0 {y} 0"><joint name="a{y}" axis="0 1 0" range="0 1"/>
        <geom type="box" pos="0 .005 .02" size=".005 .008 .02"/><body pos="0 0 .04"><joint axis="0 1 0" range="0 1"/>
        <geom type="capsule" fromto="0 0 0 0 0 {0.06 if y == places[-1] else 0.04}" size=".005"/></body></body>"""
        for y in places
    )
    return f"""<mujoco><compiler angle="radian"/><worldbody><body>
      <geom type="box" size=".02 .08 .01"/>{fingers}</body></worldbody>
      <actuator><position joint="a{places[0]}" kp="1"/></actuator></mujoco>"""


def two_arms(*, turn="0 0 0 1", weight_m=0.05, anchor="0 0 0"):
    """Return two arms of one part, side by side; the second is turned, its weight or the anchor of its hinge moved."""
    arms = ""
    for y, quat, x, place in (
        (0.3, "1 0 0 0", 0.05, "0 0 0"),
        (-0.3, turn, weight_m, anchor),
    ):
        link = f"""<joint axis="0 1 0" pos="{place}" damping=".1"/><geom size=".02" pos="{x} 0 .1" mass="1"/>
          <geom type="capsule" fromto="0 0 0 0 0 .2" size=".02" mass=".1"/>"""
        arms += f"""<body pos="0 {y} 0" quat="{quat}"><joint axis="0 0 1" damping=".1"/><geom size=".03" mass="1"/>
          <body pos="0 0 .1">{link}<body pos="0 0 .2">{link.replace(place, "0 0 0")}</body></body></body>"""
    return f"""<mujoco><worldbody><body><geom type="box" size=".1 .4 .05"/>{arms}</body></worldbody></mujoco>"""


def three_fingers(*, thumb=True):
    """Return two fingers of one part side by side, with more on one side, and a thumb of the same part opposite."""
    places = ((0.03, 0.03, "1 0 0 0"), (0.03, -0.03, "1 0 0 0"), (-0.03, 0, "0 0 0 1"))
    fingers = "".join(
        f"""<body pos="{x} {y} 0" quat="{quat}"><joint axis="0 1 0" damping=".01"/>
        <geom type="box" pos="0 .02 .02" size=".005 .02 .02" mass=".01"/></body>"""
        for x, y, quat in places[: 3 if thumb else 2]
    )
    return f"""<mujoco><worldbody><body><geom type="box" size=".03 .04 .01"/>{fingers}</body></worldbody></mujoco>"""


def with_screen(*, of_screen="", of_thumb=".001 .001 .001"):
    """Return links of 1 kg, each with a screen that is fixed to it, and a thumb of 2 g that has a joint."""
    screen = f'<body pos=".1 0 0">{of_screen}<geom type="box" size=".01 .1 .1" mass="1e-4"/></body>'
    links = "".join(
        f"""<body pos="0 0 {0.2 * k}"><joint name="j{k}" axis="0 1 0"/>
        <geom type="box" size=".03 .03 .1" mass="1"/>{screen}</body>"""
        for k in range(5)
    )
    thumb = f"""<body name="thumb" pos="0 .1 0"><joint axis="0 1 0"/><geom type="box" size="{of_thumb}"/>
      <inertial pos="0 0 0" mass=".002" diaginertia="1e-5 1e-5 1e-5"/></body>"""
    return f"""<mujoco><worldbody><body><geom size=".1"/>{links}{thumb}</body></worldbody></mujoco>"""


def two_sides(*limbs):
    """Return a trunk with limbs, each of axes of its joints on the left and on the right side, and ranges of both."""
    chains, motors = "", ""
    for limb, joints in enumerate(limbs):
        for side, y in enumerate((0.2, -0.2)):
            chains += f'<body pos="0 {y} {-0.5 * limb}">'
            for number, (*axes, ends) in enumerate(joints):
                name = f"{'lr'[side]}{limb}{number}"
                chains += f"""<joint name="{name}" axis="{axes[side]}" range="{ends.split(",")[-side]}"/>
                  <geom size=".02" mass="{limb + 1}"/><body pos="0 0 -.1">"""
                motors += f'<motor joint="{name}" forcerange="-9 9"/>'
            chains += "</body>" * (len(joints) + 1)
    return f"""<mujoco><compiler angle="radian"/><worldbody><body><geom type="box" size=".1 .2 .2"/>{chains}</body>
      </worldbody><actuator>{motors}</actuator></mujoco>"""


def beside(extra):
    """Return the chain of five joints beside something else on the same mount, and a motor of a joint that it lacks."""
    lacking = """<body pos="0 0 20"><joint name="none"/>
      <inertial pos="0 0 0" mass=".001" diaginertia="1e-6 1e-6 1e-6"/></body>"""
    robot = chain().replace("<worldbody>", f"<worldbody>{lacking}<body>")
    robot = robot.replace("</worldbody>", f"{extra}</body></worldbody>")
    return robot.replace("</actuator>", '<motor joint="none"/></actuator>')


TURNED, UPRIGHT = ("0 0 1", "0 0 1"), [("0 0 1", "0 0 -1", "-1 1")] * 2
ARM, LEG = (
    [("1 0 0", "1 0 0", "-1 1")] * 3,
    [("1 0 0", "-1 0 0", "-1 1"), ("0 1 0", "0 1 0", "-1 1")],
)
PICTURE = """<body><joint axis="0 1 0"/><geom pos=".3 0 0" size=".05" contype="0" conaffinity="0"/></body>"""
UNEQUAL = '<joint joint1="right" joint2="left" polycoef="0 .5 0 0 0" solref=".005 1"/>'
ODD_PARTS = [
    ("robot-command", pulled(), pulled(coefficient=-0.5), "coefficient of right"),
    ("robot-command", pulled(), pulled(per_control=0.003), "ctrlrange of pull"),
    (
        "robot-coupling",
        hand_of_two(coupling=COUPLED),
        hand_of_two(coupling=UNEQUAL),
        "ratio of 1 or -1: right and left",
    ),
    ("robot-sides", chain(), chain(kp=50), "kp of j4"),
    ("robot-sides", chain(), chain(last_range="-1.2 .8"), "ctrlrange of j4"),
    ("robot-sides", table(), table(axis="-1 0 0"), "axis or the gear of one"),
    ("robot-sides", paw(), paw(kp=8), "kp of bob0"),
    ("robot-wiring", paw(), paw(quat=".7071 0 0 .7071"), "quat of cid"),
    ("robot-wiring", paw(), paw(coefficient=0.8), "coef of ann and fay"),
]


@pytest.mark.parametrize(("row", "good", "odd", "words"), ODD_PARTS)
def test_a_part_that_contradicts_those_like_it_is_named(row, good, odd, words):
    assert not robot_row(row, robot_of(good)).verdict.is_off
    found = robot_row(row, robot_of(odd))
    assert found.is_flag and words in found.cause.line


AFLOAT = (
    table()
    .replace("<body><geom", '<body><freejoint/><geom condim="1"')
    .replace('size=".03"/>', 'size=".03" condim="1"/>')
)


def ranged(command="-.2 .9"):
    """Return an arm of five joints with a range each, of which the third may have the commands of another one."""
    bodies, servos = "", ""
    ranges = ("-1 1", "-.5 1.2", "-.2 .9", "-.7 .7", "-1.2 .4")
    for number, ends in enumerate(ranges):
        bodies += f"""<body pos=".2 0 0"><joint name="j{number}" axis="0 1 0" range="{ends}" armature=".02"/>
            <geom type="capsule" fromto=".06 0 0 .2 0 0" size=".03"/>"""
        stated = command if number == 2 else ends
        servos += f'<position joint="j{number}" kp="200" kv="12" ctrlrange="{stated}"/>'
    return f"""<mujoco><compiler angle="radian"/><worldbody>{bodies}{"</body>" * 5}</worldbody>
      <actuator>{servos}</actuator></mujoco>"""


def with_soles(*, right_m=-0.02):
    """Return the biped with a site on each sole, of which the right one may lie on the side of the left one."""
    text = biped_xml()
    for side, y_m in (("left", 0.02), ("right", right_m)):
        site = f'<site name="{side}_sole" pos=".03 {y_m} -.06"/>'
        text = re.sub(f'(<body name="{side}_foot"[^>]*>)', rf"\1{site}", text)
    return text


def with_excludes(*pairs):
    """Return the biped whose links touch nothing of each other, pair by pair."""
    several = "".join(
        f'<exclude body1="{one}" body2="{other}"/>'
        for one, other in map(str.split, pairs)
    )
    return biped_xml().replace("</mujoco>", f"<contact>{several}</contact></mujoco>")


LEGS = ("left_hip left_foot", "right_hip right_foot", "left_thigh left_foot")


def carried_fingers(*names):
    """Return the hand whose controller carries fingers."""
    parts = "|".join(f"{name}|{name}_tip" for name in names)
    return re.sub(f'<body name="({parts})"', r'\g<0> gravcomp="1"', GOOD["hand"]())


def with_torques(last="RR_knee"):
    """Return the quadruped with sensors of the forces of its motors, of which the last may read another one."""
    names = [
        f"{leg}_{joint}" for leg in ("FL", "FR", "RR") for joint in ("hip", "knee")
    ]
    sensors = "".join(
        f'<actuatorfrc name="{name}_torque" actuator="{last if name == "RR_knee" else name}"/>'
        for name in names
    )
    return GOOD["quadruped"]().replace(
        "</mujoco>", f"<sensor>{sensors}</sensor></mujoco>"
    )


ON_PURPOSE = [
    ("robot-friction", AFLOAT, AFLOAT.replace("<freejoint/>", "")),
    ("robot-rotor", chain(armature=1e-3), chain(last_armature=1e-5)),
    ("robot-lag", four_bar(), four_bar(kv=20)),
    ("robot-mirror", claw(), claw(last_m=0.011)),
    (
        "robot-sides",
        row_of_fingers(-0.06, -0.02, 0.02, 0.06),
        row_of_fingers(-0.06, 0.06),
    ),
    # Arms of one part are copies, and no mirror images; a hinge is the same wherever on its axis it is stated.
    ("robot-sides", two_arms(), two_arms(weight_m=0)),
    ("robot-sides", two_arms(anchor="0 .05 0"), two_arms(anchor=".1 0 0")),
    ("robot-sides", three_fingers(), three_fingers(thumb=False)),
    # The link that it is fixed to states its mass; of the thumb no shape is known.
    ("robot-density", with_screen(), with_screen(of_screen='<joint axis="0 1 0"/>')),
    ("robot-inertia", with_screen(), with_screen(of_thumb=".004 .004 .004")),
    # A first joint that turns unlike those behind it, with ranges that mirror each other.
    (
        "robot-sides",
        two_sides([(*TURNED, "-1 .5,-.5 1"), *UPRIGHT]),
        two_sides([(*TURNED, "-1 1"), *UPRIGHT]),
    ),
    # A leg whose joints all turn as mirror images beside an arm whose do not.
    (
        "robot-sides",
        two_sides(ARM, [*LEG, UPRIGHT[0]]),
        two_sides(ARM, [*LEG, (*TURNED, "-1 1")]),
    ),
    (
        "robot-size",
        beside(""),
        beside('<body pos="0 0 20"><joint/><geom size=".1"/></body>'),
    ),
    ("robot-torque", beside(PICTURE), beside(re.sub(r'con.*"0"', "", PICTURE))),
    ("robot-sides", ranged(), ranged("-1 1")),
    ("robot-sides", with_soles(), with_soles(right_m=0.02)),
    (
        "robot-wiring",
        with_excludes(*LEGS, "right_thigh right_foot"),
        with_excludes(*LEGS, "right_thigh right_shin"),
    ),
    (
        "robot-wiring",
        carried_fingers("index", "ring", "thumb"),
        carried_fingers("index", "ring"),
    ),
    ("robot-wiring", with_torques(), with_torques("FR_knee")),
]


@pytest.mark.parametrize(("row", "good", "odd"), ON_PURPOSE)
def test_what_a_good_robot_has_is_no_mistake_where_a_like_one_is_flagged(
    row, good, odd
):
    assert not robot_row(row, robot_of(good)).is_flag
    assert robot_row(row, robot_of(odd)).is_flag


def test_a_keyframe_that_commands_another_angle_than_its_own_slows_no_servo():
    robot = robot_of(biped_xml().replace('ctrl="0 ', 'ctrl="-.4 '))
    assert robot_row("robot-lag", robot).verdict is Verdict.INSIDE


@pytest.mark.parametrize("name", FURTHER)
def test_a_row_is_flagged_for_its_mistake(name):
    change, expected = FURTHER[name]
    text = GOOD[name.partition(",")[0]]()
    changed = change(text)
    assert changed != text
    assert robot_row(expected, robot_of(changed)).is_flag


@pytest.mark.parametrize(("axis", "is_flag"), [("0 -1 0", False), ("0 1 0", True)])
def test_fingers_that_slide_the_same_way_are_flagged(axis, is_flag):
    finger = (
        '<body pos="0 {} .1"><joint type="slide" axis="{}" range="0 .04" limited="true"/>'
        '<geom size=".01 .01 .03" type="box" mass=".05"/></body>'
    )
    fingers = finger.format(-0.05, "0 1 0") + finger.format(0.05, axis)
    gripper = (
        '<mujoco><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 .3"><geom size=".04" mass=".5"/>'
        f"{fingers}</body></worldbody></mujoco>"
    )
    assert robot_row("robot-wiring", robot_of(gripper)).is_flag == is_flag


def test_a_robot_without_servos_has_no_gains_to_scale():
    motors = re.sub(r'<position (joint="[^"]*")[^>]*>', r"<motor \1/>", biped_xml())
    motors = re.sub(r'ctrl="[^"]*"', "", motors)
    for remedy in REMEDIES["robot-servo"](robot_of(motors)):
        assert "kp" not in remedy.text


ARMS = {
    f"arm, {name}": mistake
    for name, mistake in (arm_faults.MISTAKES | arm_faults.LATER).items()
}


@pytest.mark.parametrize(
    "mistakes", [MISTAKES, LATER, ARMS], ids=["known", "later", "arms"]
)
def test_mistakes_are_named(mistakes):
    unnamed = []
    for name, (change, expected) in mistakes.items():
        text = GOOD[name.partition(",")[0]]()
        changed = change(text)
        assert changed != text, name
        row = robot_row(expected, robot_of(changed))
        if not (row.is_flag and row.cause is not None and row.consequence):
            unnamed.append((name, expected, row.configured, row.remark))
    assert len(unnamed) <= UNNAMED * len(mistakes), unnamed


def test_a_range_that_is_no_mirror_image_counts_less_where_both_sides_are_one_part():
    """Hinges about the vertical of which one states the range of the other one, or a third one."""
    pasted, third = (
        robot_row("robot-mirror", robot_of(two_sides([("0 0 1", "0 0 1", ends), *LEG])))
        for ends in ("-1 .5", "-1 .5,-.8 .5")
    )
    assert pasted.is_flag and third.configured > pasted.configured


def wheels(*, names="abcd", armature="1e-4", ends="-1e6 1e6", forcerange=""):
    """Return a car of four wheels on springs, whose motors, the last two out of order, have a name each."""
    parts, motors = "", ""
    for k, (x, y) in enumerate(((0.2, 0.1), (0.2, -0.1), (-0.2, 0.1), (-0.2, -0.1))):
        parts += f"""<body pos="{x} {y} 0"><joint type="slide" axis="0 0 1" range="-.02 .02" stiffness="500"/>
          <geom size=".02" mass=".1"/><body><joint name="wheel_{"abcd"[k]}" axis="0 1 0" range="{ends}"
          armature="{armature}"/><geom type="cylinder" size=".04 .01" zaxis="0 1 0" mass=".1"/></body></body>"""
    for k, name in zip((0, 1, 3, 2), names, strict=True):
        motors += f'<velocity name="drive_{name}" joint="wheel_{"abcd"[k]}" kv="1" {forcerange}/>'
    return f"""<mujoco><compiler angle="radian"/><worldbody><body><freejoint/>
      <geom type="box" size=".25 .08 .02" mass="2"/>{parts}</body></worldbody><actuator>{motors}</actuator></mujoco>"""


def test_what_wheels_and_an_order_of_motors_state_is_no_proof():
    """Names that fit are right in any order; without them the order is visible, and names that do not fit are wrong."""
    verdicts = [
        robot_row("robot-command", robot_of(wheels(names=names))).verdict
        for names in ("abdc", "pqrs", "abcd")
    ]
    assert verdicts == [Verdict.INSIDE, Verdict.VISIBLE, Verdict.WRONG]
    assert not robot_row("robot-range", robot_of(wheels())).is_flag
    assert robot_row("robot-range", robot_of(wheels(ends="-360 360"))).is_flag
    assert not robot_row("robot-wiring", robot_of(wheels())).is_flag
    rotor, limited = (
        wheels(armature="1"),
        wheels(armature="1", forcerange='forcerange="-.1 .1"'),
    )
    rows = [robot_row("robot-armature", robot_of(xml)) for xml in (rotor, limited)]
    assert [row.verdict for row in rows] == [Verdict.VISIBLE, Verdict.VISIBLE]
    assert "no torque is stated" in rows[0].remark


def test_a_rotor_whose_motor_states_no_torque_is_never_advised_away():
    geom = '<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03"/>'
    robot = robot_of(f"""<mujoco><worldbody>
      <body><joint name="shoulder" axis="0 1 0" armature=".1"/>{geom}
        <body pos=".3 0 0"><joint name="elbow" axis="0 1 0" armature="30"/>{geom}</body></body></worldbody>
      <actuator><motor joint="shoulder" forcerange="-50 50" ctrlrange="-50 50"/>
        <velocity joint="elbow" kv="5"/></actuator>
      </mujoco>""")
    found = robot_row("robot-armature", robot)
    assert "no torque is stated" in found.remark
    assert found.verdict is Verdict.VISIBLE
    assert 'armature="0"' not in found.cause.line


SHAPE = '<geom name="link2"'
BOX = "-.05 -.05 0 .05 -.05 0 -.05 .05 0 .05 .05 0 -.05 -.05 .4 .05 -.05 .4 -.05 .05 .4 .05 .05 .4"
BEFORE = f"(?s)<worldbody>(.*?){SHAPE}"
MESH = '<geom type="mesh" mesh="box" contype="0" conaffinity="0"/>'
MESHED = rf'<asset><mesh name="box" vertex="{BOX}"/></asset><worldbody>\1{MESH}{SHAPE}'
DRAWN = '<geom type="capsule" fromto="0 0 0.055 0 0 0.389" size="0.055" contype="0" conaffinity="0"'
SERVO = '<position name="servo6" joint="joint6" kp="500" kv="25" forcerange="-28 28"/>'
COMMANDED = SERVO.replace("/>", ' ctrlrange="-{0} {0}"/>')
LINK = '<geom name="link6" '
INERTIAL = (
    '<inertial pos="0 0 .05" mass=".3" diaginertia="{0} {0} {0}"/><geom name="link6" '
)
OF_LAST = 'name="joint6" axis="0 1 0" range="-170 170" armature="0.1" damping="1" frictionloss="1.0"'
HIP = 'name="RL_hip" axis'
THIGH = 'name="RL_thigh" type="capsule" fromto="0 0 0 -.15 0 -.15" size=".025" density="1200"'
POSITION = r'<position (.*?)kp="\d+" kv="\d+"'
MOTOR = r'<general \1 biastype="affine"'


@pytest.mark.parametrize(
    ("good", "row", "old", "unusual", "wrong"),
    [
        ("arm", "robot-command", SERVO, COMMANDED.format(0.2), COMMANDED.format(300)),
        ("arm", "robot-command", POSITION, MOTOR, (SERVO, '<general joint="joint6" biastype="affine"/>')),
        ("arm", "robot-inertia", LINK, INERTIAL.format(0.06), INERTIAL.format(1)),
        ("arm", "robot-frictionloss", OF_LAST, OF_LAST.replace("1.0", "20"), OF_LAST.replace("1.0", "40")),
        ("arm", "robot-range", OF_LAST, OF_LAST.replace("170", "20000"), OF_LAST.replace("170", "1")),
        ("quadruped", "robot-sides", HIP, f'damping="9" {HIP}', (THIGH, THIGH.replace("1200", "400"))),
        ("arm", "robot-visual-mass", SHAPE, f"{DRAWN}/>{SHAPE}", (BEFORE, MESHED)),
        ("arm", "robot-torque", 'servo3" joint="joint3"', 'servo3" joint="joint2"', ()),
        ("arm", "robot-torque", r"(joint2.*)-150 150", r"\1-1 1", ()),
    ],
    ids=["range", "voltages", "shape", "gears", "turns", "rubbing", "bones", "passive", "weak"],
)  # fmt: skip
def test_what_is_only_unusual_is_visible_and_what_contradicts_is_wrong(
    good, row, old, unusual, wrong
):
    """The first edit can be meant by its maker; the second one contradicts the model or mechanics."""
    xml, verdicts = GOOD[good](), []
    edits = [(old, unusual), wrong if isinstance(wrong, tuple) else (old, wrong)]
    for before, after in filter(None, edits):
        changed, count = re.subn(before, after, xml)
        assert count
        verdicts.append(robot_row(row, robot_of(changed)).verdict)
    assert verdicts == [Verdict.VISIBLE, Verdict.WRONG][: len(verdicts)]


def test_a_floor_without_gravity_is_not_tilted():
    """What is left of gravity says no direction."""
    good = GOOD["arm"]()
    for gravity, applies in (("0 1 -9", True), ("0 1e-4 1e-4", False)):
        xml = good.replace("<option ", f'<option gravity="{gravity}" ')
        row = robot_row("floor-tilt", robot_of(xml))
        assert row.applies == row.is_flag == applies


def test_wheels_that_roll_down_a_slope_do_not_slip():
    """A neck has a servo, so that the car stands; its wheels turn freely."""
    neck = '<body pos="0 0 .1"><joint name="neck"/><geom size=".03" mass=".1"/></body>'
    floor = '<worldbody><geom type="plane" size="9 9 1"/><body pos="0 0 .04">'
    servo = '<position joint="neck" kp="5" kv="1"/></actuator>'
    xml = wheels(ends="0 0").replace("<worldbody><body>", f"{floor}{neck}")
    row = robot_row("robot-slip", robot_of(xml.replace("</actuator>", servo)))
    assert not row.applies and row.remark == "wheels roll on a slope"


@pytest.mark.parametrize(
    ("touch", "verdict"),
    [("", Verdict.WRONG), ('contype="0" conaffinity="0"', Verdict.VISIBLE)],
)
def test_a_free_robot_without_a_ground_lifts_nothing_for_certain(touch, verdict):
    """0.3 Nm hold no leg that stands."""
    weak = GOOD["quadruped"]().replace("-40 40", "-.3 .3")
    xml = weak.replace('<geom name="floor" ', f'<geom name="floor" {touch} ')
    assert robot_row("robot-torque", robot_of(xml)).verdict is verdict


def test_a_waist_carries_no_foot():
    """The floating body of this humanoid is its chest, below which a waist of two bodies carries both legs."""
    folder = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"
    robot = robot_of((folder / "humanoid.xml").read_text())
    loads_nm = bent_legs_nm(robot)
    dofs = {
        name: robot.model.joint(name).dofadr[0] for name in ("abdomen_y", "right_knee")
    }
    assert loads_nm[dofs["abdomen_y"]] == 0.0 < loads_nm[dofs["right_knee"]]


def test_a_difference_of_two_sides_is_that_of_their_numbers():
    """The mass of one thigh is 4/5 of the other one, and the share of the larger one is 1/5."""
    good = GOOD["quadruped"]()
    thigh = '(name="RL_thigh" type="capsule" fromto="0 0 0 -.15 0 -.15" size=".025" density=")1200'
    changed, count = re.subn(thigh, r"\g<1>960", good)
    assert count == 1
    assert robot_row("robot-sides", robot_of(good)).configured == pytest.approx(
        0.0, abs=1e-9
    )
    assert robot_row("robot-sides", robot_of(changed)).configured == pytest.approx(0.2)


def test_a_number_is_compared_alone_and_over_what_it_grows_with():
    """A gain of ten times the others is no mistake where its motor has ten times their torque."""
    gains, torques = np.array([2.0, 2.0, 2.0, 2.0, 20.0]), np.array([1.0, 1, 1, 1, 10])
    assert factors(gains, [torques]) == pytest.approx(np.ones(5))
    assert factors(gains, [torques[::-1]])[4] == pytest.approx(10.0)
    assert factors(1.0 / gains, [torques[::-1]])[4] == pytest.approx(0.1)


@pytest.mark.parametrize(("toes_m", "is_wrong"), [(0.16, True), (-0.16, False)])
def test_a_knee_that_bends_towards_the_toes_is_wrong(toes_m, is_wrong):
    """The foot lies ahead of the ankle, or behind it: the same ranges bend the wrong way, or the right one."""
    spec = mujoco.MjSpec.from_string(biped_xml())
    for side in ("left", "right"):
        knee = spec.joint(f"{side}_knee")
        knee.range = -np.array(knee.range)[::-1]
        spec.body(f"{side}_foot").geoms[0].pos[0] = toes_m
    remark = robot_row("robot-balance", robot_of(spec.to_xml())).remark
    assert remark.startswith("towards the toes bends left_knee") == is_wrong


@pytest.mark.parametrize(("step_s", "is_finite"), [(0.054, True), (0.057, False)])
def test_a_motor_diverges_under_sines_by_the_law_of_its_step(step_s, is_finite):
    """A servo of w = 6 pi/s and damping 1.4 w in steps h is stable up to w^2 h^2 + 2.8 w h = 4, which is 0.0552 s."""
    xml = f"""<mujoco><option timestep="{step_s}"/><worldbody><body><joint name="j"/>
      <geom size=".1" pos=".1 0 0" mass="1"/></body></worldbody>
      <actuator><motor joint="j" ctrlrange="-1e15 1e15"/></actuator></mujoco>"""
    assert (robot_row("robot-holds", robot_of(xml)).configured == 1.0) == is_finite


def test_an_oblique_axis_is_unlike_those_of_the_copies():
    spec = mujoco.MjSpec.from_string(GOOD["hand"]())
    spec.joint("ring_inner").axis = np.ones(3)
    row = robot_row("robot-sides", robot_of(spec.to_xml()))
    assert row.is_flag and row.remark.startswith("obliqueness of ring_inner and ")


def test_no_largest_torque_is_advice_where_all_joints_state_none_and_wrong_where_one_does():
    good = GOOD["arm"]()
    none = robot_row("robot-torque", robot_of(re.sub(' forcerange="[^"]*"', "", good)))
    one = robot_row(
        "robot-torque", robot_of(re.sub(' forcerange="[^"]*"', "", good, count=1))
    )
    assert none.advisory and not none.is_flag and one.is_flag


@pytest.mark.parametrize(
    ("place", "distance"),
    [((0.5, 0.5), 0.0), ((2.0, 0.5), 1.0), ((-3.0, -4.0), 5.0), ((0.5, 1.25), 0.25)],
)
def test_the_distance_outside_a_hull_is_that_to_its_edge(place, distance):
    square = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [0.5, 0.5]])
    assert outside(square, np.array(place)) == pytest.approx(distance, abs=1e-12)


def test_a_stop_yields_by_the_law_of_its_softness():
    """At rest the angle is (1 - d) a T^2 for a time constant T, a damping ratio of 1 and a constant impedance d."""
    for time_constant_s, impedance in ((0.02, 0.95), (0.1, 0.9)):
        stop = f'solreflimit="{time_constant_s} 1" solimplimit="{impedance} {impedance} 0.001"'
        xml = f"""<mujoco><worldbody><body><joint name="j" range="-1 1" {stop}/>
          <geom size=".1" pos=".1 0 0" mass="1"/></body></worldbody>
          <actuator><motor joint="j" ctrlrange="-50 50"/></actuator></mujoco>"""
        found = robot_row(
            "robot-stops",
            robot_of(
                xml.replace("<worldbody>", '<compiler angle="radian"/><worldbody>')
            ),
        )
        angle_rad = (1.0 - impedance) * 100.0 * time_constant_s**2
        assert found.configured == pytest.approx(1e3 * angle_rad, abs=0.1)


def test_the_centre_of_mass_of_a_biped_is_judged_by_its_lean():
    robot = robot_of(
        biped_xml().replace('type="box" pos="0 0 .2"', 'type="box" pos=".5 0 .2"')
    )
    data = mujoco.MjData(robot.model)
    mujoco.mj_resetDataKeyframe(robot.model, data, 0)
    mujoco.mj_forward(robot.model, data)
    centre = data.subtree_com[robot.model.body("torso").id]
    toes = data.geom("left_foot").xpos[0] + 0.11
    lean_deg = np.degrees(np.arctan2(centre[0] - toes, centre[2]))
    assert robot_row("robot-balance", robot).configured == pytest.approx(
        lean_deg, abs=0.1
    )


def test_a_foot_with_toes_without_a_shape_ends_no_run():
    toes = '<body><joint/><inertial pos="0 0 0" mass=".01" diaginertia="1e-5 1e-5 1e-5"/></body>'
    text = re.sub("(?s)<keyframe>.*</keyframe>", "", biped_xml())
    text = re.sub(r'(name="\w+_foot" type="box".*?/>)', rf"\1{toes}", text)
    assert text.count(toes) == 2
    assert robot_row("robot-balance", robot_of(text)).applies


@pytest.mark.parametrize("name", ["half_cheetah.xml", "humanoidstandup.xml"])
def test_legs_one_behind_the_other_and_a_lying_robot_are_no_biped(name):
    file = Path(gymnasium.__file__).parent / "envs/mujoco/assets" / name
    robot = robot_of(file.read_text())
    for row in ("robot-level", "robot-balance"):
        assert robot_row(row, robot).verdict is Verdict.DECLINED


CART = """<body name="cart"><inertial pos="0 0 0" mass="60" diaginertia="0.001 0.001 0.001"/>
  <joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
  <joint name="turn" axis="0 0 1" range="-30 30"/><geom type="box" size="0.3 0.2 0.01" contype="0" conaffinity="0"/>"""


def on_a_cart(text):
    """An arm whose base two slides and a hinge place in the world, as makers do instead of wheels."""
    text = text.replace('<body name="link1"', f'{CART}<body name="link1"')
    text = text.replace("</worldbody>", "</body></worldbody>").replace(
        '="0 -.5', '="0 0 0 0 -.5'
    )
    servos = '<position joint="turn" kp="50000" kv="1000" ctrlrange="-1 1"/>'
    for slide in "yx":
        servos = f'<position joint="{slide}" kp="1e6" kv="50000"/>{servos}'
    return text.replace("<actuator>", f"<actuator>{servos}")


def carried(text):
    """An arm without friction, whose controller carries its weight."""
    text = text.replace('<body name="link', '<body gravcomp="1" name="link')
    text = re.sub(r'damping="1" frictionloss="[^"]*"', "", text)
    text = re.sub(r'kv="\d+"', 'kv="1"', text)
    return text.replace("0 -.5 1.2 -.7", "0 1.5 0 0")


def with_another_keyframe(text):
    """A quadruped that starts in the air, and stands in its only keyframe, which is not `home`."""
    qpos = " ".join(map(str, mujoco.MjModel.from_xml_string(text).qpos0))
    text = re.sub("<key name=.*/>", f'<key name="walk" qpos="{qpos}"/>', text)
    return text.replace(
        '<body name="trunk" pos="0 0 .322">', '<body name="trunk" pos="0 0 1">'
    )


@pytest.mark.parametrize(
    ("change", "name", "rows"),
    [
        (on_a_cart, "arm", ("robot-torque", "robot-inertia", "robot-command")),
        (carried, "arm", ("robot-energy",)),
        (with_another_keyframe, "quadruped", ("robot-stands", "robot-level")),
    ],
    ids=["a base that slides place", "carried by its controller", "another keyframe"],
)
def test_what_makers_do_on_purpose_has_no_flag(change, name, rows):
    text = GOOD[name]()
    changed = change(text)
    assert changed != text
    robot = robot_of(changed)
    found = {row: robot_row(row, robot) for row in rows}
    assert {row: one.configured for row, one in found.items() if one.is_flag} == {}
    assert any(one.verdict is Verdict.INSIDE for one in found.values())
