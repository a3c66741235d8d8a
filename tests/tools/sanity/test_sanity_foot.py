"""Checks of the robot's own foot: what is read of a model, scenes against the whole robot, and planted faults."""

import mujoco
import numpy as np
import pytest
from quadruped import FEET, FOOT_RADIUS_M, GOOD, quadruped_xml

from gauge_envs.backends import backend
from gauge_envs.scene import GRAVITY_M_PER_S2, Sphere
from gauge_envs.tools.sanity import SanityVerdict, check, configuration
from gauge_envs.tools.sanity.object_checks import object_check
from gauge_envs.tools.sanity.object_checks.measure import Measurements
from gauge_envs.tools.sanity.training import Need

MUJOCO = backend("mujoco")

pytestmark = pytest.mark.usefixtures("shared_measurements")


def model(xml):
    return mujoco.MjModel.from_xml_string(xml)


# --- what is read ----------------------------------------------------------------------------------------------------


def test_a_quadruped_stands_on_four_spheres():
    read = configuration(model(quadruped_xml()))
    foot = read.foot_geometry
    assert (foot.name, len(read.robot.standing.feet)) == ("FL_calf", 4)
    # Four copies, each with a quarter of the 12 kg, form a rigid body.
    assert (foot.load_kg, foot.mass_kg) == pytest.approx((3.0, 12.0))
    (part,) = foot.parts
    assert part.shape == Sphere(radius_m=FOOT_RADIUS_M)
    assert part.pose.position_m == pytest.approx([0.0, 0.0, FOOT_RADIUS_M])


@pytest.mark.parametrize(
    ("name", "geoms", "count"),
    [
        # The shins end at the same height as the feet, which they carry.
        ("Walker2d-v5", "foot_geom (capsule)", 2),
        ("Humanoid-v5", "right_foot (sphere)", 2),
    ],
)
def test_feet_of_gymnasiums_robots(name, geoms, count):
    read = configuration(name)
    assert (read.foot_geometry.geoms, len(read.robot.standing.feet)) == (geoms, count)


PLANE = '<geom type="plane" size="5 5 .1"/>'
ARM = """<body pos="0 0 1"><joint name="arm" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 .9 0 0" size=".03"/></body>"""
BOX = """<body pos="1 1 .1"><freejoint/>
  <geom name="box" type="box" size=".1 .1 .1"/></body>"""
LIFTED = """<body pos="0 0 .1"><joint type="slide" axis="0 0 1" {}/>
  <geom name="box" type="box" size=".1 .1 .1"/>
  <body><joint name="arm" axis="0 1 0"/><geom size=".05" pos="0 0 .3"/></body></body>"""
MOTOR = '<motor joint="arm"/>'
LIFT = f'{MOTOR}<position joint="lift" kp="1"/>'
STANDS = {
    "a fixed arm": (ARM, "", None),
    "a box beside a driven arm": (ARM + BOX, MOTOR, None),
    "a box beside an arm without motor": (ARM + BOX, "", None),
    "a base that can fall": (LIFTED.format(""), MOTOR, "box (box)"),
    "a base that is held": (LIFTED.format('damping="1e11"'), MOTOR, None),
    "a base that is lifted": (LIFTED.format('name="lift"'), LIFT, None),
}
"""Bodies above a plane, what drives them, and the foot; None where nothing stands."""


@pytest.mark.parametrize("name", STANDS)
def test_a_robot_that_stands_under_its_own_weight_has_a_foot(name):
    bodies, actuators, geoms = STANDS[name]
    read = configuration(
        model(
            f"<mujoco><worldbody>{PLANE}{bodies}</worldbody>"
            f"<actuator>{actuators}</actuator></mujoco>"
        )
    )
    assert getattr(read.foot_geometry, "geoms", None) == geoms
    assert (Need.FOOT in read.inapplicable) == (geoms is None)


# --- scenes ----------------------------------------------------------------------------------------------------------


def locked_robot(settings, friction, slope_deg):
    """Return times and the mean position of the feet of a quadruped with locked joints."""
    robot = model(quadruped_xml(option=settings, friction=friction, locked=True))
    slope = np.radians(slope_deg)
    robot.opt.gravity[:] = [
        GRAVITY_M_PER_S2 * np.sin(slope),
        0.0,
        -GRAVITY_M_PER_S2 * np.cos(slope),
    ]
    data = mujoco.MjData(robot)
    mujoco.mj_forward(robot, data)
    times, places = [], []
    while data.time < 1.0:
        times.append(data.time)
        places.append(np.mean([data.geom(name).xpos for name in FEET], axis=0))
        mujoco.mj_step(robot, data)
    return np.array(times), np.array(places)


def test_the_foot_creeps_like_a_robot_with_locked_joints():
    option = 'timestep="0.002" integrator="implicitfast" cone="elliptic" impratio="1"'
    read = configuration(model(quadruped_xml(option=option, locked=True)))
    foot, known = read.foot_geometry, Measurements(MUJOCO)
    (settings,) = read.contact_sets.values()
    creep = object_check("foot-creep", foot)
    friction = creep.scenario.scene.contacts[0].friction
    times, places = locked_robot(option, friction, 10.0)
    late = times > 0.5
    crept = 1e3 * np.polyfit(times[late], places[late, 0], 1)[0]
    assert known.measure(creep, settings).value == pytest.approx(crept, rel=0.05)


# --- faults ----------------------------------------------------------------------------------------------------------

FAULTS = {
    "foot-creep": {"option": GOOD["option"].replace('"100"', '"0.1"')},
}
"""Changes of the good quadruped, by the check that fails."""


def test_a_good_quadruped_passes():
    report = check(model(quadruped_xml()), only=["foot-*"], explain=False)
    assert not [result.id for result in report.checks if result.verdict.is_off]


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_the_feet_fails(fault):
    xml = quadruped_xml(**FAULTS[fault])
    (result,) = check(model(xml), only=[fault], explain=False).checks
    assert result.verdict is SanityVerdict.FAILED
