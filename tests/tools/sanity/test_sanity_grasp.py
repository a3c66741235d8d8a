"""Grasps: readings against closed forms, contacts of a hand, and the fix of planted faults."""

import mujoco
import numpy as np
import pytest
from sanity_cases import moved

from gauge_envs.backends import backend
from gauge_envs.tools.sanity.fixes.change import changed_model
from gauge_envs.tools.sanity.object_checks import GRASP, object_check
from gauge_envs.tools.sanity.object_checks.measure import Measurements
from gauge_envs.tools.sanity.readers import configuration
from gauge_envs.tools.sanity.run import check
from gauge_envs.tools.sanity.verdict import SanityVerdict

MUJOCO = Measurements(backend("mujoco"))
GOOD = {
    "option": 'cone="elliptic" impratio="100"',
    "geom": 'solref="0.004 1" solimp=".95 .95 .001"',
}


BOX = "type='box' size='.005 .01 .02'"


def hand(option="", geom="", pad="", motors="left right", tip=BOX, height_m=0.03):
    """Return a gripper above a cube on a floor."""
    fingers = "".join(
        f"<body name='{name}' pos='{place} 0 .1'><joint name='{name}' type='slide' axis='1 0 0'/>"
        f"<geom name='{name}_pad' {tip} mass='.02' {pad}/></body>"
        for name, place in (("left", -0.04), ("right", 0.04))
    )
    driven = "".join(f"<motor joint='{name}'/>" for name in motors.split())
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><option {option}/><default><geom {geom}/></default><worldbody>"
        f"<geom name='floor' type='plane' size='2 2 .1'/><body pos='0 0 {height_m}'><freejoint/>"
        f"<geom name='cube' type='box' size='.02 .02 .03' mass='.1'/></body>{fingers}</worldbody>"
        f"<actuator>{driven}</actuator></mujoco>"
    )


def checked(model):
    report = check(model, only=["grasp-*"])
    return {result.id: result.verdict for result in report.checks}, report


# --- readings --------------------------------------------------------------------------------------------------------


def test_creep_and_depth_of_a_box_are_relative_to_its_pads():
    creep = object_check("grasp-creep")
    times = np.linspace(0.0, 1.5, 151)
    down, inward = (
        np.outer(times, [0.0, 0.0, -1e-6]),
        np.outer(times > 0.0, [3e-5, 0.0, 0.0]),
    )
    rollout = moved(
        creep.scenario,
        times,
        object=30.0 * down,
        left=10.0 * down + inward,
        right=10.0 * down - inward,
    )
    assert creep.value(rollout) == pytest.approx(20.0)
    assert object_check("grasp-sink").value(rollout) == pytest.approx(30.0)


# --- MuJoCo ----------------------------------------------------------------------------------------------------------


# --- hands -----------------------------------------------------------------------------------------------------------


def grasping(model, **options):
    """Return the contact groups of a hand."""
    groups = configuration(model, **options).contact_groups
    return [group for group in groups if group.is_held]


def test_the_contacts_of_a_hand_are_those_of_its_pads_and_a_free_body():
    (group,) = grasping(hand(pad='condim="4"'))
    assert group.geoms == "cube, left_pad and right_pad with each other"
    assert group.settings["condim"] == 4
    # Fingers without motors grasp nothing, and a chosen pair stands for all contacts.
    assert not grasping(hand(motors=""))
    assert not grasping(hand(), pair=("floor", "cube"))


def test_a_good_hand_passes():
    verdicts, report = checked(hand(**GOOD))
    assert verdicts == dict.fromkeys(GRASP, SanityVerdict.PASSED)
    assert report.fix is None


FAULTS = {
    "grasp-creep": {},
    "grasp-sink": GOOD | {"pad": 'priority="1" solref=".2 1"'},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS)
def test_a_planted_fault_of_a_hand_is_fixed(name):
    model = hand(**FAULTS[name])
    verdicts, report = checked(model)
    assert verdicts[name].is_off
    assert report.fix is not None
    assert len(report.fix.fixed) == report.fix.flag_count
    robot = report.configuration.robot
    fixed, _ = checked(changed_model(robot, report.fix.changes)[0])
    assert set(fixed.values()) == {SanityVerdict.PASSED}
