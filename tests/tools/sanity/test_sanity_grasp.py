"""Grasps: readings against closed forms, contacts of a hand, and the fix of planted faults."""

import mujoco
import numpy as np
import pytest
from sanity_cases import moved

from gauge_envs.backends import backend
from gauge_envs.scene import GRAVITY_M_PER_S2 as G
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
    report = check(model, only=["grasp-*", "rolling"])
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


@pytest.mark.parametrize("share", [0.383, 3.0])
def test_torque_is_read_from_the_energy_of_the_spin(share):
    check = object_check("grasp-torsion")
    times = np.linspace(0.0, 0.15, 1501)
    # 2 mu N side share over m (a^2 + b^2) / 12; at 3.0 the box stops within the time.
    rate = share * 2.0 * 0.5 * 2.0 * 0.2 * G * 0.02 / (0.2 * (0.06**2 + 0.16**2) / 12.0)
    rollout = moved(check.scenario, times)
    rollout.states["object"][:, 10] = np.maximum(20.0 - rate * times, 0.0)
    assert check.value(rollout) == pytest.approx(share, rel=1e-3)
    # Even pressure has (sqrt 2 + ln(1 + sqrt 2)) / 6, pressure at the corners 1 / sqrt 2.
    low = check.reality.value - check.reality.tolerance
    high = check.reality.value + check.reality.tolerance
    assert (low, high) == pytest.approx((0.383, 0.707), abs=0.007)


@pytest.mark.parametrize("arm_mm", [0.5, 20.0])
def test_rolling_friction_is_read_from_the_path(arm_mm):
    check = object_check("rolling")
    times = np.linspace(0.0, 0.5, 2001)
    # Rolling without slip: a = 5/7 g arm / r, until the ball stops.
    rate = 5.0 / 7.0 * G * 1e-3 * arm_mm / 0.03
    until = np.minimum(times, 0.3 / rate)
    path = np.outer(0.3 * until - 0.5 * rate * until**2, [1.0, 0.0, 0.0])
    assert check.value(moved(check.scenario, times, ball=path)) == pytest.approx(
        arm_mm, rel=2e-3
    )


# --- MuJoCo ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arm_m", "verdict"), [(1e-3, SanityVerdict.PASSED), (0.1, SanityVerdict.FAILED)]
)
def test_rolling_friction_of_mujoco(arm_m, verdict):
    settings = {"condim": 6, "rolling_friction_m": arm_m}
    measured = MUJOCO.measure(object_check("rolling"), settings)
    assert measured.verdict is verdict
    # A larger rolling friction stops the ball before the end.
    if verdict is SanityVerdict.PASSED:
        assert measured.value == pytest.approx(1e3 * arm_m, rel=0.01)


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


@pytest.mark.parametrize(
    ("pad", "spins"), [("", True), ('condim="4" friction="1 .002 0"', False)]
)
def test_round_fingertips_without_torsional_friction_are_named(pad, spins):
    """MuJoCo does the same: 5 N on two tips resist 20 mN m with a lever of 2 mm each, or nothing."""
    model = hand(**GOOD, pad=f'priority="1" {pad}', tip="size='.01'", height_m=0.1)
    verdicts, report = checked(model)
    assert verdicts["grasp-torsion"] is SanityVerdict.NOT_MEASURED
    assert not any(verdict.is_off for verdict in verdicts.values())
    assert ["holds no torque" in note for note in report.notes] == [True] * spins
    model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    data.ctrl[:] = 5.0, -5.0
    mujoco.mj_step(model, data, 200)
    data.xfrc_applied[1, 3] = 0.018
    mujoco.mj_step(model, data, 100)
    # I = m (4 a^2 + 4 b^2) / 12 about the line between the tips, with half edges of 20 and 30 mm.
    free = 0.2 * 0.018 / (0.1 * 4.0 * (0.02**2 + 0.03**2) / 12.0)
    assert data.qvel[3] == pytest.approx(
        free if spins else 0.0, rel=0.01, abs=1e-2 * free
    )


def test_a_good_hand_passes():
    verdicts, report = checked(hand(**GOOD))
    assert verdicts == dict.fromkeys(GRASP, SanityVerdict.PASSED)
    assert (report.fix, report.notes) == (None, ())


FAULTS = {
    "grasp-creep": {},
    "grasp-sink": GOOD | {"pad": 'priority="1" solref=".2 1"'},
    "grasp-torsion": GOOD | {"pad": 'condim="4" friction="1 .05 .0001"'},
    "rolling": GOOD | {"pad": 'condim="6" friction="1 .005 .1"'},
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
