"""Grasps: which contacts of a hand are measured, creep against the grasped body, and the fix of a planted fault."""

import mujoco
import pytest

from gauge_envs.tools.sanity import SanityVerdict, check
from gauge_envs.tools.sanity.fixes.change import changed_model

GOOD = {
    "option": 'cone="elliptic" impratio="100"',
    "geom": 'solref="0.004 1" solimp=".95 .95 .001"',
}
BOX = "type='box' size='.005 .01 .02'"


def hand(option="", geom="", pad="", motors="left right", tip=BOX, height_m=0.03):
    """Return a gripper that holds a cube on a floor."""
    fingers = "".join(
        f"<body name='{name}' pos='{place} 0 .03'><joint name='{name}' type='slide' axis='1 0 0'/>"
        f"<geom name='{name}_pad' {tip} mass='.02' {pad}/></body>"
        for name, place in (("left", -0.025), ("right", 0.025))
    )
    driven = "".join(
        f"<motor joint='{name}' gear='{1 if name == 'left' else -1}'/>"
        for name in motors.split()
    )
    key = f"<keyframe><key ctrl='{'1 ' * len(motors.split())}'/></keyframe>"
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><option {option}/><default><geom {geom}/></default><worldbody>"
        f"<geom name='floor' type='plane' size='2 2 .1'/><body pos='0 0 {height_m}'><freejoint/>"
        f"<geom name='cube' type='box' size='.02 .02 .03' mass='.1'/></body>{fingers}</worldbody>"
        f"<actuator>{driven}</actuator>{key if motors else ''}</mujoco>"
    )


def result_of(model, **options):
    report = check(model, only=["grasp-creep"], **options)
    return report.checks[0], report


def test_the_contacts_of_a_hand_are_those_of_its_pads_and_a_free_body():
    result, _ = result_of(hand(option='impratio="0.1"'), explain=False)
    assert "left_pad creeps" in result.remark and "on cube" in result.remark
    # Fingers without motors grasp nothing.
    result, _ = result_of(hand(motors=""), explain=False)
    assert not result.applies


def test_a_good_hand_passes():
    result, report = result_of(hand(**GOOD))
    assert result.verdict is SanityVerdict.PASSED
    assert report.fix is None


def test_creep_out_of_a_grasp_is_that_of_the_whole_hand():
    """Two pads press a free box with 1 N each; gravity pulls it with 0.7 of the friction limit."""
    pads = "".join(
        f"<body pos='{place} 0 0'><joint name='{name}' type='slide' axis='1 0 0'/>"
        f"<geom name='{name}' type='box' size='.005 .01 .01' mass='.05'/></body>"
        for name, place in (("left", -0.025), ("right", 0.025))
    )
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option cone="elliptic"/><worldbody>{pads}
        <body><freejoint/><geom name="box" type="box" size=".02 .02 .02" mass="{1.4 / 9.81}"/></body></worldbody>
        <actuator><motor joint="left" ctrlrange="1 1"/><motor joint="right"/></actuator>
        <keyframe><key ctrl="1 -1"/></keyframe></mujoco>"""
    )
    result, _ = result_of(model, explain=False)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, nstep=250)
    early = data.body("world").xpos[2] - data.geom("box").xpos[2]
    mujoco.mj_step(model, data, nstep=250)
    late = -data.geom("box").xpos[2]
    assert result.configured == pytest.approx(1e3 * (late - early) / 0.5, rel=0.2)


@pytest.mark.slow
def test_a_planted_fault_of_a_hand_is_fixed():
    model = hand(option='impratio="0.1"')
    result, report = result_of(model)
    assert result.verdict.is_off and report.fix is not None
    fixed, _ = result_of(
        changed_model(report.configuration.robot, report.fix.changes)[0]
    )
    assert fixed.verdict is SanityVerdict.PASSED
