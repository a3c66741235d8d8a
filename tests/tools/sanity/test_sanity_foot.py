"""Checks of the robot's own feet: which are read of a model, creep against the whole robot, and planted faults."""

import mujoco
import numpy as np
import pytest
from quadruped import FEET, GOOD, quadruped_xml

from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.sanity import SanityVerdict, check, configuration
from gauge_envs.tools.sanity.robot.robot import geom_name


def model(xml):
    return mujoco.MjModel.from_xml_string(xml)


def feet(target):
    """Return the names of the geoms of each foot; None where nothing stands."""
    robot = configuration(target).robot
    if robot.standing is None:
        return None
    return [
        [geom_name(robot.model, geom) for geom in geoms]
        for geoms in robot.standing.feet.values()
    ]


# --- what is read ----------------------------------------------------------------------------------------------------


def test_a_quadruped_stands_on_four_spheres():
    assert feet(model(quadruped_xml())) == [[name] for name in FEET]


@pytest.mark.parametrize(
    ("name", "geoms"),
    [
        # The shins end at the same height as the feet, which they carry.
        ("Walker2d-v5", [["foot_geom"], ["foot_left_geom"]]),
        ("Humanoid-v5", [["right_foot"], ["left_foot"]]),
    ],
)
def test_feet_of_gymnasiums_robots(name, geoms):
    assert feet(name) == geoms


PLANE = '<geom type="plane" size="5 5 .1"/>'
ARM = """<body pos="0 0 1"><joint name="arm" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 .9 0 0" size=".03"/></body>"""
BOX = """<body name="box" pos="1 1 .1"><freejoint/>
  <geom name="box" type="box" size=".1 .1 .1"/></body>"""
LIFTED = """<body pos="0 0 .1"><joint type="slide" axis="0 0 1" {}/>
  <geom name="box" type="box" size=".1 .1 .1"/>
  <body><joint name="arm" axis="0 1 0"/><geom size=".05" pos="0 0 .3"/></body></body>"""
HAND = BOX.replace(
    "</body>", '<body><joint name="arm"/><geom size=".05"/></body></body>'
)
MOTOR = '<motor joint="arm"/>'
LIFT = f'{MOTOR}<position joint="lift" kp="1"/>'
STANDS = {
    "a fixed arm": (ARM, "", None),
    "a box beside a driven arm": (ARM + BOX, MOTOR, None),
    "a box beside an arm without motor": (ARM + BOX, "", None),
    "a base that can fall": (LIFTED.format(""), MOTOR, [["box"]]),
    "a base that is held": (LIFTED.format('damping="1e11"'), MOTOR, None),
    "a base that is lifted": (LIFTED.format('name="lift"'), LIFT, None),
    "a free base": (HAND, MOTOR, [["box"]]),
    "a free base that a weld holds": (
        HAND + '</worldbody><equality><weld body1="box"/></equality><worldbody>',
        MOTOR,
        None,
    ),
}
"""Bodies above a plane, what drives them, and the foot; None where nothing stands."""


@pytest.mark.parametrize("name", STANDS)
def test_a_robot_that_stands_under_its_own_weight_has_a_foot(name):
    bodies, actuators, geoms = STANDS[name]
    xml = f"<mujoco><worldbody>{PLANE}{bodies}</worldbody><actuator>{actuators}</actuator></mujoco>"
    assert feet(model(xml)) == geoms


@pytest.mark.parametrize("tilt", ["", "30 0 0", "0 50 20"])
@pytest.mark.parametrize(
    ("shape", "vertices"),
    [
        ('type="box" size=".1 .2 .3"', [(0.1, 0.2, 0.3)]),
        (
            'type="cylinder" size=".1 .3"',
            [(0.1 * np.cos(a), 0.1 * np.sin(a), 0.3) for a in np.linspace(0, 7, 9999)],
        ),
    ],
)
def test_the_lowest_point_of_a_shape_is_that_of_its_corners(shape, vertices, tilt):
    joint = '<freejoint/><geom size=".01" mass="1"/><body><joint name="arm"/>'
    xml = f"""<mujoco><worldbody>{PLANE}<body pos="0 0 1">{joint}
      <geom name="foot" {shape} euler="{tilt or "0 0 0"}"/></body></body></worldbody>
      <actuator>{MOTOR}</actuator></mujoco>"""
    robot = configuration(model(xml)).robot
    foot = robot.model.geom("foot").id
    signs = np.array([[i, j, k] for i in (1, -1) for j in (1, -1) for k in (1, -1)])
    corners = (np.array(vertices)[:, None] * signs).reshape(-1, 3)
    low = robot.stance.rotations[foot].apply(corners)[:, 2].min() + 1.0
    assert robot.standing.support_m[foot] == pytest.approx(low, abs=1e-6)


# --- creep -----------------------------------------------------------------------------------------------------------


def test_the_foot_creeps_like_a_robot_with_locked_joints():
    option = 'timestep="0.002" integrator="implicitfast" cone="elliptic" impratio="1"'
    robot = model(quadruped_xml(option=option, friction=0.2, locked=True))
    (result,) = check(robot, only=["foot-creep"], explain=False).checks
    # Gravity along the slope pushes with 0.7 of the friction limit, and is as large across it.
    robot.opt.gravity[:] = np.array([0.7 * 0.2, 0.0, -1.0]) * GRAVITY_M_PER_S2
    data, places = mujoco.MjData(robot), []
    while data.time < 1.0:
        mujoco.mj_step(robot, data)
        places.append(np.mean([data.geom(name).xpos[0] for name in FEET]))
    late = places[len(places) // 2 :]
    crept = 1e3 * (late[-1] - late[0]) / (len(late) - 1) / robot.opt.timestep
    assert result.configured == pytest.approx(crept, rel=0.1)


# --- faults ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("option", "verdict"),
    [
        (GOOD["option"], SanityVerdict.PASSED),
        (GOOD["option"].replace('"100"', '"0.1"'), SanityVerdict.WARNING),
    ],
)
def test_feet_that_creep_are_a_warning(option, verdict):
    xml = quadruped_xml(option=option)
    (result,) = check(model(xml), only=["foot-creep"], explain=False).checks
    assert result.verdict is verdict


CART = """<mujoco><worldbody>{plane}<body pos="0 0 .1"><freejoint/><geom type="box" size=".2 .1 .02" mass="5"/>
  {wheels}</body></worldbody><actuator>{motors}</actuator></mujoco>"""
WHEEL = """<body pos="{x} {y} 0"><joint name="{x}{y}" axis="0 1 0" pos="{off} 0 0"/>
  <geom type="{kind}" size=".1 .02 .1" zaxis="0 1 0" mass=".5"/></body>"""


@pytest.mark.parametrize("off", [0.0, 0.05])
@pytest.mark.parametrize("kind", ["sphere", "cylinder", "capsule", "ellipsoid"])
def test_a_wheel_is_no_foot_that_creeps(kind, off):
    places = [(x, y) for x in (0.2, -0.2) for y in (0.1, -0.1)]
    wheels = "".join(WHEEL.format(x=x, y=y, off=off, kind=kind) for x, y in places)
    motors = "".join(f'<motor joint="{x}{y}"/>' for x, y in places)
    xml = CART.format(plane=PLANE, wheels=wheels, motors=motors)
    (result,) = check(model(xml), only=["foot-creep"], explain=False).checks
    assert result.verdict.is_off is bool(off)
