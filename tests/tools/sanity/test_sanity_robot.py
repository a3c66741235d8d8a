"""The target's own robot: rows against closed forms and motion, planted mistakes, and cures that are applied."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from more_faults import biped_xml
from robot_faults import FAULTS, good_xml
from wobbling import told

from gauge_envs.tools.sanity import check, formats
from gauge_envs.tools.sanity.cure import applied
from gauge_envs.tools.sanity.model import Need, Verdict
from gauge_envs.tools.sanity.phenomena import ROBOT_IDS, phenomenon
from gauge_envs.tools.sanity.phenomena.base import facts
from gauge_envs.tools.sanity.robot.joints import growth
from gauge_envs.tools.sanity.robot.mujoco_model import mujoco_configuration
from gauge_envs.tools.sanity.robot.robot import never_touches
from gauge_envs.tools.sanity.robot.rows import ROWS
from gauge_envs.tools.sanity.stacks import configuration, dialect
from gauge_envs.tools.sanity.target_checks import robot_row, target_rows

G = 9.81


def read(xml):
    spec = mujoco.MjSpec.from_string(xml)
    return mujoco_configuration(
        spec.compile(), name="robot.xml", source="test", spec=spec
    )


def rows_of(xml, only=("gravity", *ROBOT_IDS)):
    found = target_rows(read(xml), dialect("mjcf"), only)
    return {row.phenomenon: row for row in found}


def row(name, xml):
    return robot_row(name, read(xml).robot)


ON_ROBOT = {
    name
    for name, fault in FAULTS.items()
    if any(one in (*ROBOT_IDS, "gravity") for one in fault.rows)
}


def test_the_rows_of_a_robot_are_listed():
    assert robot_row("robot-servo", None).verdict is Verdict.DECLINED
    assert set(ROWS) == set(ROBOT_IDS) == set(facts("robot_rows"))
    for known in facts("robot_rows").values():
        low, high = known["interval"]
        assert (
            known["consequence"].endswith(".")
            and low < high
            and known["source"]
            and known["limits"]
            and known["proof"] in ("contradiction", "mechanics", "usual")
        )


def test_a_good_robot_has_no_flag():
    found = rows_of(good_xml())
    assert [name for name, one in found.items() if one.is_flag] == []
    assert set(ROBOT_IDS) < set(found)
    assert {name for name, one in found.items() if not one.applies} == {
        *("robot-bound", "robot-action", "robot-delay"),
        *("robot-balance", "robot-level", "robot-coupling", "robot-keyframe"),
        "robot-maker",
    }
    for name in set(ROBOT_IDS) & set(found):
        reality, (low, high) = (
            found[name].reality,
            facts("robot_rows")[name]["interval"],
        )
        assert reality.value - reality.tolerance == pytest.approx(low, abs=1e-9 * high)
        assert reality.value + reality.tolerance == pytest.approx(high)


@pytest.mark.parametrize("name", sorted(ON_ROBOT))
def test_a_mistake_is_found_and_named(name):
    fault = FAULTS[name]
    only = [one for one in fault.rows if one in (*ROBOT_IDS, "gravity")]
    found = rows_of(fault.xml(), only)
    flags = {name: row for name, row in found.items() if row.is_flag}
    named = set(flags) & set(fault.rows)
    assert named or not set(fault.rows) <= {*ROBOT_IDS, "gravity"}, flags
    assert all(flags[one].consequence for one in named - {"gravity"})


SIMULATED = "holds stands loads saturation slip overlap energy dry lag sag"
"""Rows of rollouts."""


def test_what_models_state_is_told_in_the_approved_rows(approved):
    """Rows that simulate nothing, of each robot with a planted mistake and of the good one."""
    lines, good = [], {}
    for mistake in ("none", *sorted(ON_ROBOT)):
        robot = read(good_xml() if mistake == "none" else FAULTS[mistake].xml()).robot
        lines.append(mistake)
        for name in sorted(ROBOT_IDS):
            if name.removeprefix("robot-") in SIMULATED.split():
                continue
            text = told(replace(ROWS[name](robot), parts={})).replace("parts={}, ", "")
            # Each robot is the good one with a mistake.
            if text != good.setdefault(name, ""):
                lines.append(f"  {name}: {text}")
            if mistake == "none":
                good[name] = text
    approved("sanity/robot-rows", "\n".join(lines))


@pytest.mark.parametrize(
    ("name", "number", "value", "is_flag"),
    [
        ("action_rad", 0.3, 0.6, False),
        ("action_rad", np.degrees(0.3), np.degrees(0.6), True),
        ("action_rad", 0.001, 0.002, True),
        ("delay_s", 0.02, 20.0, False),
        ("delay_s", 0.11, 110.0, True),
    ],
)
def test_what_a_task_states_is_judged(name, number, value, is_flag):
    """A full action asks for kp of 80 Nm/rad times its angle, of 40 Nm; a delay is in ms."""
    row_name = f"robot-{name.partition('_')[0]}"
    robot = read(good_xml()).robot
    assert robot_row(row_name, robot).verdict is Verdict.DECLINED
    found = robot_row(row_name, replace(robot, **{name: number}))
    assert found.configured == pytest.approx(value)
    assert found.is_flag == is_flag and bool(found.consequence) == is_flag


# --- closed forms ----------------------------------------------------------------------------------------------------


def hinge_xml(kp, kv, armature, option):
    return f"""<mujoco><option {option}/><worldbody><body><joint name="j" axis="0 0 1" armature="{armature}"/>
      <geom type="sphere" size=".1" mass="1"/></body></worldbody>
      <actuator><position joint="j" kp="{kp}" kv="{kv}"/></actuator></mujoco>"""


@pytest.mark.parametrize("kp", [10.0, 900.0, 4000.0, 2e5])
@pytest.mark.parametrize(
    ("integrator", "is_implicit"), [("implicitfast", True), ("Euler", False)]
)
def test_the_growth_of_a_servo_is_its_eigenvalue_and_motion_grows_with_it(
    kp, integrator, is_implicit
):
    step, kv, armature = 0.005, 0.4, 0.001
    inertia = 0.4 * 0.1**2 + armature
    robot = read(
        hinge_xml(kp, kv, armature, f'timestep="{step}" integrator="{integrator}"')
    ).robot
    mass = inertia + (step * kv if is_implicit else 0.0)
    speed = np.array([-step * kp / mass, 1.0 - step * kv / mass])
    expected = np.abs(
        np.linalg.eigvals([[1.0 + step * speed[0], step * speed[1]], speed])
    ).max()
    assert growth(robot) == pytest.approx(expected, rel=1e-6)
    data = mujoco.MjData(robot.model)
    data.qpos[0] = 1e-6
    reach = []
    for _ in range(200):
        mujoco.mj_step(robot.model, data)
        reach.append(abs(data.qpos[0]) + step * abs(data.qvel[0]))
        if reach[-1] > 1e3:
            break
    assert (max(reach) > 1e-2) == (expected > 1.1)


def test_torque_damping_friction_and_armature_are_ratios_to_the_limb():
    text = good_xml()
    found = rows_of(text)
    robot = read(text).robot
    # With the foot below the hip at 0.8 of two shanks l, a knee holds a quarter of the weight at the lever 0.6 l.
    lever_m = 0.6 * 0.15 * 2**0.5
    knee_nm = robot.mass_kg * G / 4 * lever_m
    assert found["robot-torque"].configured == pytest.approx(40.0 / knee_nm, rel=0.25)
    assert found["robot-damping"].configured == pytest.approx(3.0 * 0.5 / 40.0)
    assert found["robot-frictionloss"].configured == pytest.approx(0.2 / 40.0)


def test_the_cure_of_an_armature_is_what_the_motor_of_each_heavy_joint_can_turn():
    """The limb is what the joint turns without armature: the diagonal of the inertia of a model that has none.

    40 Nm accelerate a motor of 0.04 kg m^2 by 1000 rad/s^2, and one of 1 kg m^2 by less than 100.
    """
    bare = read(good_xml().replace('armature="0.005"', 'armature="0"')).robot
    full = np.zeros((bare.model.nv, bare.model.nv))
    data = mujoco.MjData(bare.model)
    mujoco.mj_resetDataKeyframe(bare.model, data, 0)
    mujoco.mj_forward(bare.model, data)
    mujoco.mj_fullM(bare.model, data, full)
    limbs = {f"dof_armature[{dof}]": full[dof, dof] for dof in range(6, bare.model.nv)}
    light = ROWS["robot-armature"](read(good_xml()).robot)
    assert (light.value, light.changes) == (0.0, {})
    text = good_xml().replace('armature="0.005"', 'armature="1"')
    found = ROWS["robot-armature"](read(text).robot)
    assert found.value == pytest.approx(1.0 / min(limbs.values()), rel=1e-6)
    heavy = {name: max(limb, 0.04) for name, limb in limbs.items() if 20.0 * limb < 1.0}
    assert heavy and found.changes == pytest.approx(heavy, rel=1e-6)


def test_springs_gain_energy_beyond_the_longest_stable_step():
    sprung = good_xml().replace("<joint armature", '<joint stiffness="300" armature')
    sprung = sprung.replace('kv="2"', 'kv="0"')
    short, long = (
        row(
            "robot-energy", sprung.replace('timestep="0.002"', f'timestep="{step_s}"')
        ).configured
        for step_s in (0.002, 0.02)
    )
    assert 0.0 <= short < 0.01 and long > 1.0


def test_density_and_gravcomp_are_those_of_the_model():
    assert row(
        "robot-density", good_xml().replace('density="1500"', 'density="1.5"')
    ).configured == pytest.approx(1.5)
    lifted = good_xml().replace('<body name="trunk"', '<body name="trunk" gravcomp="1"')
    robot = read(lifted).robot
    share = robot.model.body("trunk").mass[0] / robot.model.body_subtreemass[1]
    assert row("robot-gravcomp", lifted).configured == pytest.approx(share)


def test_the_tilt_of_the_floor_is_the_slope_on_which_a_ball_rolls():
    xml = """<mujoco><option timestep="0.001"/><worldbody>
      <geom name="floor" type="plane" size="5 5 .1" euler="0 3.4 0" condim="1"/>
      <body pos="0 0 .1"><freejoint/><geom size=".1" condim="1"/></body></worldbody></mujoco>"""
    found = row("floor-tilt", xml)
    assert found.configured == pytest.approx(3.4) and found.verdict is Verdict.WRONG
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    while data.time < 0.4:
        mujoco.mj_step(model, data)
    downhill = np.linalg.norm(data.qvel[:3])
    assert downhill / data.time == pytest.approx(
        G * np.sin(np.radians(found.configured)), rel=0.02
    )


def test_the_friction_of_a_foot_is_what_a_slide_shows():
    # The floor states 0.1, and the greater friction counts: a block on 35 degrees slides as with 0.5.
    tilt = np.radians(35.0)
    xml = f"""<mujoco><option timestep="0.001" cone="elliptic" impratio="100"
      gravity="{G * np.sin(tilt)} 0 {-G * np.cos(tilt)}"/>
      <default><geom solref="0.004 1" solimp="0.95 0.95 0.001"/></default><worldbody>
      <geom name="floor" type="plane" size="9 9 .1" friction="0.1"/>
      <body pos="0 0 .05"><freejoint/><geom name="sole" type="box" size=".2 .2 .05" friction="0.5"/></body>
      </worldbody></mujoco>"""
    configuration = read(xml)
    assert configuration.robot.foot_rows
    assert robot_row("robot-friction", configuration.robot).configured == pytest.approx(
        0.5
    )
    assert robot_row(
        "robot-floor-friction", configuration.robot
    ).configured == pytest.approx(5.0)
    model = configuration.robot.model
    data = mujoco.MjData(model)
    speeds = []
    for _ in range(600):
        mujoco.mj_step(model, data)
        speeds.append(data.qvel[0])
    slides = (speeds[-1] - speeds[299]) / 0.3
    # A real slide resolves 4 % of the friction, the half-width of the interval of `slide-wood`.
    assert np.tan(tilt) - slides / (G * np.cos(tilt)) == pytest.approx(0.5, rel=0.04)


# --- joint by joint --------------------------------------------------------------------------------------------------

KP, ARM_KG, ARM_M = 40.0, 2.0, 0.3


def arm_xml(joint="", servo=""):
    """Return a horizontal arm, a point mass on a rod without mass, with a servo."""
    return f"""<mujoco><option timestep="0.0005"/><worldbody><body><joint name="j" axis="0 1 0" {joint}/>
      <geom type="sphere" size=".01" mass="{ARM_KG}" pos="{ARM_M} 0 0"/></body></worldbody>
      <actuator><position name="a" joint="j" kp="{KP}" {servo}/></actuator></mujoco>"""


@pytest.mark.parametrize(
    ("dry", "viscous"), [(0.2, 0.3), (0.02, 1.0), (0.5, 0.0), (0.0, 0.3), (0.0, 0.0)]
)
def test_the_dry_part_is_that_of_the_torque_that_keeps_a_joint_turning(dry, viscous):
    xml = arm_xml(f'frictionloss="{dry}" damping="{viscous}"')
    assert row("robot-dry", xml).configured == pytest.approx(
        dry / (dry + viscous) if dry else 0.0, abs=1e-9
    )
    model = mujoco.MjModel.from_xml_string(
        xml.replace("<option", '<option gravity="0 0 0"')
    )
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    data = mujoco.MjData(model)
    data.qvel[0], data.qfrc_applied[0] = 1.0, dry + viscous
    mujoco.mj_step(model, data, 1000)
    assert data.qvel[0] == pytest.approx(1.0, rel=1e-6)


def test_dry_friction_of_a_joint_that_is_too_light_for_it_is_a_drag():
    """A soft constraint of impedance d brakes by d / (1 - d) times inertia times damping, at most by the friction."""
    xml = arm_xml('frictionloss="1"').replace(f'mass="{ARM_KG}"', 'mass="0.0005"')
    found = row("robot-dry", xml)
    # No joint of the model has a rotor: advice.
    assert found.verdict.is_off and found.advisory
    assert found.configured == pytest.approx(0.0, abs=1e-9)
    assert found.cause.line.startswith("the armature of j")
    moved_rad = []
    for armature in ("0", "0.1"):
        text = xml.replace(
            'frictionloss="1"', f'frictionloss="1" armature="{armature}"'
        )
        model = mujoco.MjModel.from_xml_string(text)
        model.opt.gravity[:] = 0.0
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
        data = mujoco.MjData(model)
        data.qfrc_applied[0] = 0.05
        mujoco.mj_step(model, data, 4000)
        moved_rad.append(float(data.qpos[0]))
    inertia = 0.0005 * (ARM_M**2 + 0.4 * 0.01**2)
    drag_n_m_s_per_rad = 0.9 / 0.1 * inertia * 2.0 / (0.95 * 0.02)
    assert moved_rad[0] == pytest.approx(2.0 * 0.05 / drag_n_m_s_per_rad, rel=0.02)
    assert moved_rad[1] < 0.01
    assert row("robot-dry", text).configured == pytest.approx(1.0, abs=1e-6)
    # What does not hold a joint takes no part of its torque.
    lost = [row("robot-frictionloss", one).configured for one in (xml, text)]
    assert lost == pytest.approx([0.0, 1.0 / (0.5 * KP)], abs=1e-9)


def test_friction_that_the_engine_switches_off_is_none():
    off = arm_xml('frictionloss="0.2" damping="0.1"').replace(
        "/><worldbody>", '><flag frictionloss="disable"/></option><worldbody>'
    )
    found = row("robot-dry", off)
    assert found.configured == 0.0 and found.cause.line.startswith(
        '<flag frictionloss="enable"/> and frictionloss='
    )


def test_the_half_of_a_step_takes_a_sixth_of_a_period_or_what_the_limit_allows():
    inertia = ARM_KG * (ARM_M**2 + 0.4 * 0.01**2)
    free_s = np.pi / 3.0 * np.sqrt(inertia / KP)
    assert row("robot-lag", arm_xml()).configured == pytest.approx(
        1e3 * free_s, rel=5e-3
    )
    assert row(
        "robot-lag", arm_xml(servo='ctrlrange="-.1 .4"')
    ).configured == pytest.approx(1e3 * free_s, rel=5e-3)
    slow = row("robot-lag", arm_xml(servo='forcerange="-4 4"'))
    assert slow.configured == pytest.approx(
        1e3 * np.sqrt(0.3 * inertia / 4.0), rel=5e-3
    )
    # With a gear of 2 a step of the joint is twice as long for the actuator, and four times as stiff.
    assert row("robot-lag", arm_xml(servo='gear="2"')).configured == pytest.approx(
        0.5e3 * free_s, rel=1e-2
    )
    assert (
        row("robot-lag", arm_xml(servo='ctrlrange="-.1 .2"')).verdict
        is Verdict.DECLINED
    )


def test_a_servo_sags_by_its_weight_over_its_stiffness():
    sag = 1e3 * ARM_KG * G * ARM_M / KP
    assert row("robot-sag", arm_xml()).configured == pytest.approx(sag, rel=2e-3)
    assert row("robot-sag", arm_xml(servo='gear="2"')).configured == pytest.approx(
        sag / 4.0, rel=2e-3
    )
    stiff = row("robot-sag", arm_xml().replace('kp="40.0"', 'kp="40000"'))
    assert stiff.configured == pytest.approx(1e-3 * sag, rel=2e-3)
    assert stiff.verdict is Verdict.VISIBLE and stiff.advisory


def test_soft_gains_are_advice_where_a_policy_carries_the_weight_up_to_a_unit():
    """The largest sag is the weight over kp: a biped that sags by 700 mrad and by 1,400, and an arm by 700."""
    kp = 400.0 * row("robot-sag", biped_xml()).configured / 700.0
    soft, softest = (
        row("robot-sag", biped_xml().replace('kp="400"', f'kp="{one}"'))
        for one in (kp, kp / 2.0)
    )
    assert soft.configured == pytest.approx(700.0, rel=1e-3)
    assert soft.advisory and not soft.is_flag
    assert softest.is_flag
    arm_kp = ARM_KG * G * ARM_M / 0.7
    assert row("robot-sag", arm_xml().replace('kp="40.0"', f'kp="{arm_kp}"')).is_flag


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("robot-dry", 'frictionloss="0.2"', 'frictionloss="0.0001"'),
        ("robot-lag", 'kp="80" kv="2" forcerange="-40 40"', 'kp="8000" kv="4"'),
    ],
)
def test_joints_that_no_robot_has_are_found_and_their_cure_clears_the_flag(
    name, old, new
):
    text = good_xml()
    assert old in text
    before = read(text.replace(old, new))
    report = check(before, only=[name])
    assert (
        report.rows[0].is_flag
        and report.rows[0].consequence
        and report.cure is not None
    )
    after = check(applied(before, report.cure.changes)[0], only=["robot-*"])
    assert not after.flags


def test_friction_that_no_joint_states_is_advice():
    text = good_xml().replace('frictionloss="0.2"', "")
    (found,) = check(read(text), only=["robot-dry"]).rows
    assert found.verdict.is_off and not found.is_flag
    assert found.advisory == "the joint states no dry friction"


# --- what a robot can do ---------------------------------------------------------------------------------------------


def test_a_planar_robot_is_judged_in_its_plane():
    assert Need.SPACE in configuration("Walker2d-v5").inapplicable
    assert Need.SPACE not in configuration("Ant-v5").inapplicable
    (turned,) = check("Walker2d-v5", only=["slide-turned"]).rows
    assert turned.verdict is Verdict.DECLINED and not turned.applies


def test_a_robot_that_never_touches_is_not_judged_by_contacts():
    arm = """<mujoco><worldbody>{floor}<body pos="0 0 3"><joint axis="0 1 0"/><geom type="capsule" size=".05"
      fromto="0 0 0 0 0 1"/><body pos="0 0 1"><joint axis="0 1 0"/><geom type="capsule" size=".05"
      fromto="0 0 0 0 0 1"/></body></body></worldbody></mujoco>"""
    high = read(arm.format(floor='<geom type="plane" size="5 5 .1"/>'))
    assert never_touches(high.robot) and Need.CONTACT in high.inapplicable
    low = read(arm.format(floor='<geom type="plane" size="5 5 .1" pos="0 0 2"/>'))
    assert not never_touches(low.robot) and Need.CONTACT not in low.inapplicable


def test_a_body_in_a_margin_is_read_after_it_has_settled_and_its_throw_is_a_row():
    xml = good_xml().replace('name="floor"', 'name="floor" margin="0.02"')
    found = {
        r.phenomenon: r
        for r in check(
            read(xml), only=["creep-wood", "rest-height", "release", "slide-wood"]
        ).rows
    }
    assert found["rest-height"].configured == pytest.approx(20.0, abs=0.05)
    assert abs(found["creep-wood"].configured) < 0.05
    assert found["slide-wood"].verdict is Verdict.INSIDE
    assert found["release"].configured > 100.0
    assert (
        phenomenon("release").scenario.scene.bodies
        == phenomenon("rest-height").scenario.scene.bodies
    )


# --- cures -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "rows", "text"),
    [
        (
            "margin_of_the_floor",
            ["rest-height"],
            'margin="0" in floor, which the default does not reach',
        ),
        ("solimp_from_zero", ["rest-height"], "<default><geom solimp="),
        ("gravcomp", ["robot-gravcomp"], 'gravcomp="0" for trunk'),
        ("foot_cannot_collide", ["robot-feet"], "contype and conaffinity of FL_foot"),
        (
            "kp_diverges",
            ["robot-servo"],
            "^kp times 0.0175 for all servos: the one flag goes",
        ),
        (
            "euler_without_eulerdamp",
            ["robot-servo"],
            '^<option integrator="implicitfast"/>: the one flag goes',
        ),
        (
            "damping_by_40",
            ["robot-damping", "robot-dry"],
            '^<default><joint damping="0.35"/></default>: 2 of 2 flags',
        ),
        ("slippery_floor_loses", ["robot-floor-friction"], 'priority="1" for floor'),
    ],
)
def test_a_cure_is_applied_and_a_second_check_has_no_flag(name, rows, text):
    before = read(FAULTS[name].xml())
    report = check(before, only=rows)
    assert report.cure is not None and text in f"^{report.cure.line}"
    assert report.cure.mended_count == report.cure.flag_count
    after = check(applied(before, report.cure.changes)[0], only=rows)
    assert not after.flags


def test_a_change_that_does_not_reach_a_geom_is_no_cure():
    xml = good_xml().replace('name="floor"', 'name="floor" margin="0.02"')
    robot = read(xml).robot
    floor = robot.model.geom("floor").id
    assert floor not in robot.reached_by_default("contact_margin_m")
    assert robot.model.geom("trunk").id in robot.reached_by_default("contact_margin_m")
    changed, own = robot.changed({"contact_margin_m": 0.0})
    assert own == {"contact_margin_m": [floor]} and not changed.geom_margin.any()
    assert robot.model.geom_margin[floor] == pytest.approx(0.02)


def test_a_message_names_all_parts_of_a_row():
    message = formats._message(row("robot-damping", FAULTS["damping_by_40"].xml()))
    assert "FL_hip" in message and "RR_knee" in message
