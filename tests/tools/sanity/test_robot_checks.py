"""Checks of robots: right robots pass, and each check detects the mistakes that are planted for it."""

import mujoco
import numpy as np
import pytest
from quadruped import good_xml

from gauge_envs.tools.sanity import check, configuration
from gauge_envs.tools.sanity.model_checks import ground
from gauge_envs.tools.sanity.model_checks.drives import drives
from gauge_envs.tools.sanity.target_checks import READ, TARGET_CHECKS

NAMES = [check.id for check in (*READ, ground.holding_force, ground.stands)]


def read(xml, tmp_path, suffix="xml"):
    file = tmp_path / f"robot.{suffix}"
    file.write_text(xml)
    return configuration(str(file))


def flags_of(target):
    results = [TARGET_CHECKS[name].result(target) for name in NAMES]
    return {result.id: result.remark for result in results if result.verdict.is_off}


def test_a_right_quadruped_passes(tmp_path):
    target = read(good_xml(), tmp_path)
    assert flags_of(target) == {}
    inapplicable = {
        name for name in NAMES if not TARGET_CHECKS[name].result(target).applies
    }
    assert inapplicable == set()


FAULTS = {
    ("start-overlap", "RL_foot and FL_foot"): (
        'pos="-0.19 0.12 0"',
        'pos="0.18 0.12 0"',
    ),
    ("robot-stands", "above the ground"): ('qpos="0 0 .322', 'qpos="0 0 .9'),
    ("robot-torque", "0.4"): ('forcerange="-40 40"', 'forcerange="-.4 .4"'),
    ("robot-joint", "7 more"): (
        'armature="0.005" damping="0.5"',
        'armature="1" damping="30"',
    ),
    ("robot-joint", "friction 200"): ('frictionloss="0.2"', 'frictionloss="200"'),
    ("robot-drive", "step of 2 ms"): (
        "implicitfast",
        "Euler",
        'kp="80" kv="2"',
        'kp="800" kv="400"',
    ),
    ("robot-drive", "half of a small step"): ('kv="2"', 'kv="400"'),
    ("robot-drive", "swings"): (
        'damping="0.5" frictionloss="0.2"',
        "",
        'kv="2"',
        'kv="0"',
    ),
    ("robot-free", "in the air"): ("<freejoint/>", '<joint type="free"/>'),
    ("robot-feet", "FL_foot"): (
        'name="FL_foot"',
        'name="FL_foot" contype="2" conaffinity="2"',
    ),
    ("robot-friction", "condim 1"): (
        'name="FL_foot"',
        'name="FL_foot" condim="1" priority="1"',
    ),
}
"""Texts of the good quadruped and what replaces them, by the check that detects it and a part of its remark."""


@pytest.mark.parametrize("key", FAULTS)
def test_a_mistake_is_detected_and_named(key, tmp_path):
    name, words = key
    text, texts = good_xml(), FAULTS[key]
    for old, new in zip(texts[::2], texts[1::2], strict=True):
        assert old in text, old
        text = text.replace(old, new)
    flags = flags_of(read(text, tmp_path))
    assert words in flags[name], flags
    # All joints with armature and damping are one finding.
    assert words != "7 more" or len(flags) == 1


ARM = """<mujoco><option timestep="{step}"/><worldbody>{world}<body name="arm" pos="0 0 1"{body}>
  <joint name="elbow" axis="0 1 0" {joint}/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" {geom}/>{more}</body>
  </worldbody>{end}</mujoco>"""
MOTOR = '<actuator><position joint="elbow" {}/></actuator>'
PENDULUM = """<robot name="furuta"><link name="base"/><link name="arm">{0}</link><link name="rod">{0}</link>
  <joint name="yaw" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint>
  <joint name="swing" type="continuous"><parent link="arm"/><child link="rod"/><origin xyz=".1 0 0"/>
  <axis xyz="1 0 0"/></joint></robot>"""
LINK = """<inertial><mass value=".1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial>
  <visual><geometry><box size=".02 .02 .1"/></geometry></visual>"""


def arm(
    step=0.002,
    world="",
    body="",
    joint='damping=".5" armature=".01"',
    geom="",
    more="",
    end="",
):
    return ARM.format(
        step=step, world=world, body=body, joint=joint, geom=geom, more=more, end=end
    )


RIGHT = {
    "gravity compensation": arm(
        body=' gravcomp="1"', end=MOTOR.format('kp="50" kv="2" forcerange="-20 20"')
    ),
    "free play": arm(
        more='<body pos=".3 0 0"><joint name="play" range="-1 1"/><geom size=".02"/></body>',
        end=MOTOR.format('kp="50" kv="2" forcerange="-20 20"'),
    ),
    "loose box": arm(
        world='<body><freejoint/><geom type="box" size=".05 .05 .05" mass="60"/></body>'
    ),
    "no joint": '<mujoco><worldbody><geom type="box" size="1 1 .1"/></worldbody></mujoco>',
    "furuta": PENDULUM.format(LINK),
}


@pytest.mark.parametrize("name", RIGHT)
def test_right_models_pass(name, tmp_path):
    suffix = "urdf" if name == "furuta" else "xml"
    assert flags_of(read(RIGHT[name], tmp_path, suffix)) == {}


def test_forces_and_gains_of_a_servo_pass_its_gear(tmp_path):
    """A gear of 3 gives the joint 3 times the force, and 9 times stiffness and damping."""
    servo = MOTOR.format('gear="3" kp="50" kv="2" forcerange="-20 20"')
    (drive,) = drives(read(arm(end=servo), tmp_path).robot)
    assert (drive.limit, drive.kp, drive.kv) == pytest.approx((60.0, 450.0, 18.0))


def test_a_servo_without_a_gain_is_named(tmp_path):
    flags = flags_of(read(arm(end=MOTOR.format("")), tmp_path))
    assert "default kp of MuJoCo" in flags["robot-drive"]


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(n, marks=pytest.mark.slow) for n in range(2, 40))]
)
def test_dry_friction_hides_no_servo_that_grows(seed, tmp_path):
    """A step of Euler maps position and speed of a hinge by a matrix; a servo grows where an eigenvalue exceeds 1."""
    random = np.random.default_rng(seed)
    kp, kv = 10 ** random.uniform(1.5, 6.0), 10 ** random.uniform(-0.5, 4.0)
    step_s, damping = random.choice([0.002, 0.005]), 0.5
    text = arm(
        step=step_s,
        joint=f'damping="{damping}" armature=".01" frictionloss="{random.choice([0, 0.2])}"',
        end=MOTOR.format(f'kp="{kp}" kv="{kv}" forcerange="-90 90"'),
    )
    model = mujoco.MjModel.from_xml_string(text)
    inertia = float(model.dof_M0[0]) + step_s * damping
    speed = np.array([-kp, inertia - step_s * damping - step_s * kv]) / inertia
    speed[0] *= step_s
    matrix = [speed[[1, 0]], [step_s * speed[1], 1.0 + step_s * speed[0]]]
    growth = np.abs(np.linalg.eigvals(matrix)).max()
    flag = flags_of(read(text, tmp_path)).get("robot-drive", "")
    assert ("grows" in flag) == (growth > 1.0) or abs(growth - 1.0) < 0.01, growth


STIFF = """<mujoco><option timestep="0.005"/><worldbody><body name="hand" pos="0 0 1">
  <geom type="box" size=".05 .02 .02"/><body><joint name="finger" type="slide" axis="1 0 0" range="0 .05" {}/>
  <geom type="box" size=".005 .01 .03" mass=".005"/></body></body></worldbody>
  <actuator><position joint="finger" kp="2000"/></actuator></mujoco>"""
"""A servo whose swing of 101 Hz has two steps; with a rotor of 50 g it has seven."""


@pytest.mark.parametrize(
    ("rotor", "fix"),
    [("", 'joint "finger": armature="0.05"; 1 more'), ('armature=".05" damping="10"', "")],
)  # fmt: skip
def test_a_servo_that_the_step_does_not_resolve_gets_a_rotor(rotor, fix, tmp_path):
    (tmp_path / "hand.xml").write_text(STIFF.format(rotor))
    (result,) = check(str(tmp_path / "hand.xml"), only=["robot-drive"]).checks
    assert (result.is_flag, result.fix) == (bool(fix), fix)
