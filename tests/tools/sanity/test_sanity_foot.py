"""Rows on the robot's own foot: what is read of a model, what the scenes do, and which faults the rows find."""

import pickle
from dataclasses import replace
from functools import partial

import mujoco
import numpy as np
import pytest
from quadruped import FEET, FOOT_RADIUS_M, GOOD, quadruped_xml
from sanity_cases import moved
from scipy.spatial.transform import Rotation

from gauge_envs.backends import backend
from gauge_envs.errors import TargetError
from gauge_envs.scene import GRAVITY_M_PER_S2, Box, Capsule, ConvexUnion, Sphere
from gauge_envs.scoring.estimators import acceleration_m_per_s2
from gauge_envs.tools.sanity import Need, Verdict, check, configuration
from gauge_envs.tools.sanity.measure import Measurements, judged
from gauge_envs.tools.sanity.phenomena import phenomenon
from gauge_envs.tools.sanity.phenomena.foot import DEPTH_MM, DROP_M, PUSH, foot_scene
from gauge_envs.tools.sanity.robot.foot import REFERENCE_FOOT
from gauge_envs.tools.sanity.scenario import Scenario, run_scenario, settings_in_force

MUJOCO = backend("mujoco")

GO1 = {
    "timestep_s": 0.004,
    "integrator": "Euler",
    "iterations": 1,
    "ls_iterations": 5,
    "cone": "pyramidal",
    "impratio": 1.0,
    "contact_solref": (0.02, 1.0),
    "contact_solimp": (0.9, 0.95, 0.001, 0.5, 2.0),
}
"""Options of MuJoCo Playground's Go1 and Spot, with MuJoCo's default contacts."""


pytestmark = pytest.mark.usefixtures("shared_measurements")


def model(xml):
    return mujoco.MjModel.from_xml_string(xml)


def foot_of(target):
    foot = configuration(target).foot_geometry
    assert foot is not None
    return foot


def rows_of(report):
    return {row.phenomenon: row for row in report.rows}


def row(name, foot=REFERENCE_FOOT):
    return phenomenon(name, foot)


# --- what is read ----------------------------------------------------------------------------------------------------


def test_a_quadruped_stands_on_four_spheres():
    foot = foot_of(model(quadruped_xml()))
    assert (foot.name, foot.geoms, foot.foot_count) == (
        "FL_calf",
        "FL_foot (sphere)",
        4,
    )
    assert foot.load_kg == pytest.approx(3.0) and foot.robot_mass_kg == pytest.approx(
        12.0
    )
    (part,) = foot.parts
    assert part.shape == Sphere(radius_m=FOOT_RADIUS_M)
    np.testing.assert_allclose(
        part.pose.position_m, [0.0, 0.0, FOOT_RADIUS_M], atol=1e-12
    )
    assert foot.sets == tuple(configuration(model(quadruped_xml())).contact_sets)


@pytest.mark.parametrize(
    ("name", "geoms", "count", "mass_kg", "lean_deg"),
    [
        # The limits of the joints bend the ankles, which are straight in the initial pose.
        ("Ant-v5", "left_ankle_geom (capsule)", 4, 0.911, 60.0),
        ("HalfCheetah-v5", "bfoot (capsule)", 2, 14.0, 15.5),
        ("Hopper-v5", "foot_geom (capsule)", 1, 15.8, 90.0),
        # The shins end at the same height as the feet, which they carry.
        ("Walker2d-v5", "foot_geom (capsule)", 2, 23.7, 90.0),
        ("Humanoid-v5", "right_foot (sphere)", 2, 42.1, 1.5),
    ],
)
def test_feet_of_gymnasiums_robots(name, geoms, count, mass_kg, lean_deg):
    foot = foot_of(name)
    assert (foot.geoms, foot.foot_count) == (geoms, count)
    assert foot.robot_mass_kg == pytest.approx(mass_kg, rel=1e-2)
    assert foot.load_kg == pytest.approx(foot.robot_mass_kg / count)
    axis = foot.parts[0].pose.rotation.apply([0.0, 0.0, 1.0])
    assert np.degrees(np.arccos(min(abs(axis[2]), 1.0))) == pytest.approx(
        lean_deg, abs=1.0
    )


@pytest.mark.parametrize(
    "ball",
    [
        '<body pos="nan 0 1"><freejoint/><geom size=".1"/></body>',
        '<body><freejoint/><geom size=".1"/><body><joint range="nan 1" limited="true"/><geom size=".1"/></body></body>',
    ],
)
def test_a_model_that_is_nowhere_is_refused(ball, tmp_path):
    """MuJoCo compiles a position and a range of NaN."""
    path = tmp_path / "nowhere.xml"
    path.write_text(
        f'<mujoco><worldbody><geom type="plane" size="1 1 1"/>{ball}</worldbody></mujoco>'
    )
    with pytest.raises(
        TargetError, match="the poses of the model's geoms are not finite"
    ):
        configuration(path)


BIPED = """<mujoco><asset><mesh name="wedge" vertex="-.1 -.03 0 .1 -.03 0 -.1 .03 0 .1 .03 0 -.1 0 .05"/></asset>
  <worldbody><geom type="plane" size="5 5 .1" {plane}/><body name="base" pos="0 0 1"><freejoint/>
    <geom type="box" size=".1 .1 .1" mass="8" pos="0 0 .5"/>
    <body name="left" pos="0 .1 0"><joint name="lift" type="slide" axis="0 0 1" range="-1 1"/>{left}</body>
    <body name="right" pos="0 -.1 0">{right}</body></body></worldbody>
  <keyframe><key name="crouch" qpos="0 0 1 1 0 0 0 .3"/><key name="home" qpos="0 0 1 1 0 0 0 -.02"/></keyframe>
</mujoco>"""
BOX_FOOT = (
    '<geom name="sole" type="box" size=".1 .04 .01" mass="1"/>'
    '<geom name="toe" size=".01" pos=".1 0 0" mass="1"/>'
)
MESH_FOOT = '<geom name="wedge" type="mesh" mesh="wedge" mass="1"/>'


def test_the_keyframe_home_decides_which_foot_is_lowest():
    foot = foot_of(model(BIPED.format(plane="", left=BOX_FOOT, right=MESH_FOOT)))
    assert foot.pose == "keyframe home"
    assert foot.name == "left" and foot.foot_count == 2
    # The toe touches the ground beside the sole.
    assert foot.geoms == "sole (box), toe (sphere)"
    sole, toe = foot.parts
    assert sole.shape == Box(size_m=(0.2, 0.08, 0.02))
    np.testing.assert_allclose(sole.pose.position_m, [0.0, 0.0, 0.01], atol=1e-9)
    np.testing.assert_allclose(toe.pose.position_m, [0.1, 0.0, 0.01], atol=1e-9)


def test_a_mesh_is_its_hull():
    other = '<geom size=".01" mass="1" pos="0 0 .9"/>'
    foot = foot_of(model(BIPED.format(plane="", left=other, right=MESH_FOOT)))
    assert foot.geoms == "wedge (hull of a mesh)"
    (part,) = foot.parts
    assert isinstance(part.shape, ConvexUnion)
    heights = np.sort(part.pose.to_world(part.shape.corners_m)[:, 2])
    np.testing.assert_allclose(heights, [0.0, 0.0, 0.0, 0.0, 0.05], atol=1e-7)


def test_the_ground_may_be_upright():
    xml = """<mujoco><option gravity="0 -9.81 0"/><worldbody><geom type="plane" size="5 5 .1" zaxis="0 1 0"/>
      <body name="base" pos="0 1 0"><joint type="slide" axis="0 1 0"/>
      <geom name="sole" type="capsule" fromto="0 -.5 0 0 -.1 0" size=".03" mass="2"/></body></worldbody></mujoco>"""
    foot = foot_of(model(xml))
    assert foot.foot_count == 1 and foot.load_kg == pytest.approx(2.0)
    (part,) = foot.parts
    assert part.shape == Capsule(radius_m=0.03, length_m=0.4)
    np.testing.assert_allclose(part.pose.position_m, [0.0, 0.0, 0.23], atol=1e-9)
    assert abs(part.pose.rotation.apply([0.0, 0.0, 1.0])[2]) == pytest.approx(1.0)


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
    "a box beside an arm without motor": (ARM + BOX, "", "box (box)"),
    "a base that can fall": (LIFTED.format(""), MOTOR, "box (box)"),
    "a base that is held": (LIFTED.format('damping="1e11"'), MOTOR, None),
    "a base that is lifted": (LIFTED.format('name="lift"'), LIFT, None),
}
"""Bodies above a plane, what drives them, and the foot; None where nothing stands."""


@pytest.mark.parametrize("name", STANDS)
def test_what_stands_under_its_own_weight_has_a_foot(name):
    bodies, actuators, geoms = STANDS[name]
    read = configuration(
        model(
            f"<mujoco><worldbody>{PLANE}{bodies}</worldbody>"
            f"<actuator>{actuators}</actuator></mujoco>"
        )
    )
    found = read.foot_geometry
    assert (None if found is None else found.geoms) == geoms
    assert (Need.FOOT in read.inapplicable) == (geoms is None)


def test_robots_that_tendons_move_stand_too():
    xml = quadruped_xml().replace(
        "</mujoco>",
        '<tendon><fixed name="pull"><joint joint="FL_knee" coef="1"/></fixed></tendon>'
        '<actuator><motor tendon="pull"/></actuator></mujoco>',
    )
    assert foot_of(model(xml)).foot_count == 4


def test_settings_without_a_model_have_no_foot():
    report = check("mujoco", only=["foot-creep", "gravity"])
    foot = rows_of(report)["foot-creep"]
    assert foot.verdict is Verdict.DECLINED and not foot.applies
    assert foot.remark == "the target states no geoms of a robot, so it has no foot"


def test_a_pair_that_is_no_foot_is_declined():
    robot = model(quadruped_xml(foot='priority="1" solref="0.2 1"'))
    trunk = check(configuration(robot, pair=("floor", "trunk")), only=["foot-creep"])
    assert (
        rows_of(trunk)["foot-creep"].remark
        == "the chosen geoms are no foot on the ground"
    )
    foot = check(
        configuration(robot, pair=("floor", "RL_foot")), only=["foot-landing-depth"]
    )
    assert rows_of(foot)["foot-landing-depth"].verdict is Verdict.WRONG


# --- scenes ----------------------------------------------------------------------------------------------------------


def slid(_, *, friction, slope_deg):
    return foot_scene(REFERENCE_FOOT, friction=friction, slope_deg=slope_deg)


def acceleration(settings, *, friction, slope_deg):
    change = partial(slid, friction=friction, slope_deg=slope_deg)
    scenario = Scenario(
        name="slid", variant="SlopeSlider-2-wood", seconds=0.6, change=change
    )
    rollout = run_scenario(MUJOCO, scenario, settings)
    downhill = rollout.scene.body("ground").pose.rotation.apply(
        rollout.displacement("foot"), inverse=True
    )[:, 0]
    return acceleration_m_per_s2(rollout.times_s, downhill)


@pytest.mark.parametrize(
    ("slope_deg", "friction", "law"),
    [(40.0, 0.6, 1.80), (35.0, 0.6, 0.81), (30.0, 0.274, 2.58)],
)
def test_twelve_kilograms_on_four_feet_stay_where_they_should_slide(
    slope_deg, friction, law
):
    slide = partial(acceleration, friction=friction, slope_deg=slope_deg)
    assert abs(slide(GO1)) < 0.06
    assert slide(GO1 | {"iterations": 3, "timestep_s": 0.002}) < 0.9 * law
    assert slide(
        GO1 | {"iterations": 4, "ls_iterations": 8, "timestep_s": 0.01}
    ) == pytest.approx(law, abs=0.03)
    assert slide(
        GO1 | {"iterations": 100, "ls_iterations": 50, "timestep_s": 0.002}
    ) == pytest.approx(law, abs=0.01)


def locked_robot(settings, geom, friction, slope_deg, lift_m):
    """Return times and the mean position of the feet of a quadruped with locked joints."""
    robot = model(
        quadruped_xml(option=settings, geom=geom, friction=friction, locked=True)
    )
    slope = np.radians(slope_deg)
    robot.opt.gravity[:] = [
        GRAVITY_M_PER_S2 * np.sin(slope),
        0.0,
        -GRAVITY_M_PER_S2 * np.cos(slope),
    ]
    data = mujoco.MjData(robot)
    data.qpos[2] += lift_m
    mujoco.mj_forward(robot, data)
    times, places = [], []
    while data.time < 1.0:
        times.append(data.time)
        places.append(np.mean([data.geom(name).xpos for name in FEET], axis=0))
        mujoco.mj_step(robot, data)
    return np.array(times), np.array(places)


@pytest.mark.parametrize(
    ("cone", "geom", "tolerance"),
    [
        ("elliptic", 'solref="0.02 1"', 0.03),
        ("elliptic", 'solref="0.02 1" solimp="0 0.8 0.01"', 0.03),
        ("elliptic", GOOD["geom"], 0.05),
        # The edges of a pyramid act along the axes of the robot, whose feet do not carry the same load.
        ("pyramidal", 'solref="0.02 1"', 0.15),
    ],
)
def test_the_scenes_do_what_the_robot_does_with_locked_joints(cone, geom, tolerance):
    option = f'timestep="0.002" integrator="implicitfast" cone="{cone}" impratio="1"'
    read = configuration(model(quadruped_xml(option=option, geom=geom, locked=True)))
    assert (
        read.foot_geometry is not None
        and read.foot_geometry.softening == pytest.approx(15.1, abs=0.1)
    )
    (settings,) = read.contact_sets.values()
    known = Measurements(MUJOCO)
    creep, depth = (
        row("foot-creep", read.foot_geometry),
        row("foot-landing-depth", read.foot_geometry),
    )
    friction = creep.scenario.scene.contacts[0].friction
    times, places = locked_robot(option, geom, friction, 10.0, 0.0)
    late = times > 0.5
    crept = 1e3 * np.polyfit(times[late], places[late, 0], 1)[0]
    assert known.measure(creep, settings).value == pytest.approx(crept, rel=tolerance)
    _, places = locked_robot(option, geom, friction, 0.0, DROP_M)
    sunk = 1e3 * (FOOT_RADIUS_M - places[:, 2].min())
    assert known.measure(depth, settings).value == pytest.approx(
        sunk, rel=tolerance, abs=0.02
    )
    # Without the softness of the foot's link, the robot creeps many times faster than the scene.
    plain = known.measure(
        row("foot-creep", replace(read.foot_geometry, softening=None)), settings
    ).value
    assert plain is not None and abs(crept) > 3.0 * abs(plain)


def test_scenes_reach_other_processes_and_differ_by_foot():
    foot = foot_of(model(quadruped_xml()))
    ours, reference = row("foot-creep", foot).scenario, row("foot-creep").scenario
    assert ours.name != reference.name
    copy = pickle.loads(pickle.dumps(ours))
    assert copy.scene == ours.scene
    assert settings_in_force(MUJOCO, copy, {})["inverse_weight_scale"] == pytest.approx(
        foot.softening
    )
    assert settings_in_force(MUJOCO, reference, {})["inverse_weight_scale"] == 1.0


# --- readings of motions that are known ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["foot-push", "foot-slide"])
def test_acceleration_is_read_along_the_slope(name):
    slide = row(name)
    times = np.linspace(0.0, 0.5, 126)
    downhill = slide.scenario.scene.body("ground").pose.rotation.apply([1.0, 0.0, 0.0])
    rollout = moved(
        slide.scenario, times, foot=np.outer(0.5 * 1.3 * times**2, downhill)
    )
    assert slide.value(rollout) == pytest.approx(1.3)
    (contact,) = slide.scenario.scene.contacts
    slope = -np.arcsin(downhill[2])
    if name == "foot-push":
        assert np.tan(slope) == pytest.approx(PUSH * contact.friction)
    law = GRAVITY_M_PER_S2 * (np.sin(slope) - contact.friction * np.cos(slope))
    assert slide.reality.value == pytest.approx(law)


def landing(heights_m, times):
    """Return the rollout of a foot that is at heights [m] above the ground."""
    up = np.zeros((len(times), 3))
    up[:, 2] = heights_m - DROP_M
    return moved(row("foot-rest").scenario, times, foot=up)


def test_a_landing_has_a_depth_a_hop_and_a_time():
    times = np.arange(0.0, 0.6, 0.001)
    fall = np.sqrt(2.0 * DROP_M / GRAVITY_M_PER_S2)
    after = times - fall
    dip = np.where(after < 0.0, DROP_M - 0.5 * GRAVITY_M_PER_S2 * times**2, 0.0)
    dip -= np.where(
        (after >= 0.0) & (after < 0.02), 0.003 * np.sin(np.pi * after / 0.02), 0.0
    )
    # A hop of 2 mm lasts 40 ms.
    dip += np.where(
        (after >= 0.02) & (after < 0.06),
        0.002 * np.sin(np.pi * (after - 0.02) / 0.04),
        0.0,
    )
    rollout = landing(dip, times)
    assert row("foot-landing-depth").value(rollout) == pytest.approx(3.0, abs=0.01)
    assert row("foot-rebound").value(rollout) == pytest.approx(0.2, abs=1e-3)
    rest = judged(row("foot-rest"), rollout)
    assert rest.value == pytest.approx(0.06, abs=2e-3) and not rest.remark
    shaking = landing(np.where(after < 0.0, dip, 0.002 * np.sin(60.0 * after)), times)
    assert judged(row("foot-rest"), shaking).remark == "it still moves at the end"


def test_the_lowest_sole_counts_when_the_body_leans():
    depth = row("foot-landing-depth")
    times = np.linspace(0.0, 0.6, 61)
    rollout = landing(np.zeros(61), times)
    states = dict(rollout.states)
    states["foot"] = states["foot"].copy()
    states["foot"][30:, 3:7] = Rotation.from_euler("y", 1.0, degrees=True).as_quat(
        scalar_first=True
    )
    side = REFERENCE_FOOT.half_side_m
    expected = 1e3 * side * np.sin(np.radians(1.0))
    assert depth.value(replace(rollout, states=states)) == pytest.approx(
        expected, rel=1e-6
    )


def test_the_tolerance_of_a_landing_is_that_of_a_rubber_ball():
    radius, mass, modulus, poisson = 0.02, REFERENCE_FOOT.load_kg, 2e6, 0.5
    stiffness = 4.0 / 3.0 * modulus / (1.0 - poisson**2) * np.sqrt(radius)
    # All energy of the fall is in the compression x of a force k x^1.5.
    compression = (2.5 * mass * GRAVITY_M_PER_S2 * DROP_M / stiffness) ** 0.4
    assert 1e3 * compression == pytest.approx(DEPTH_MM, rel=0.02)


# --- faults ----------------------------------------------------------------------------------------------------------

FAULTS = {
    "few_iterations": (
        {
            "option": 'timestep="0.004" iterations="1" ls_iterations="5" cone="pyramidal" impratio="1"',
            "geom": "",
        },
        "foot-push",
        {"iterations", "cone"},
    ),
    "soft_foot": (
        {"foot": 'priority="1" solref="0.2 1"'},
        "foot-landing-depth",
        {"contact_solref"},
    ),
    "margin": ({"foot": 'margin="0.03"'}, "foot-landing-depth", {"contact_margin_m"}),
    "pyramidal_default": (
        {
            "option": 'timestep="0.002" integrator="implicitfast" cone="pyramidal" impratio="1"',
            "geom": "",
        },
        "foot-creep",
        {"impratio", "cone"},
    ),
    "no_impratio": (
        {
            "option": 'timestep="0.002" integrator="implicitfast" cone="elliptic" impratio="0.1"'
        },
        "foot-creep",
        {"impratio"},
    ),
    "springy_foot": (
        {"foot": 'priority="1" solref="-3000 -5"'},
        "foot-rebound",
        {"contact_solref"},
    ),
}
"""Changes of the good quadruped, a row that is wrong, and the settings of which the cure changes one."""


def test_a_good_quadruped_passes():
    report = check(model(quadruped_xml()), only=["foot-*"])
    assert {
        one.phenomenon: one.verdict
        for one in report.rows
        if one.verdict is not Verdict.INSIDE
    } == {}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_of_the_feet_is_wrong_and_named(name):
    changes, fault, culprits = FAULTS[name]
    report = check(model(quadruped_xml(**changes)), only=["foot-*"])
    found = rows_of(report)[fault]
    assert found.is_flag and found.verdict is Verdict.WRONG
    assert culprits & {*report.cure.changes}, report.cure
    if "foot" in changes:
        assert (
            "in FL_foot, FR_foot, RL_foot and RR_foot, which the default does not reach"
            in report.cure.line
        )
