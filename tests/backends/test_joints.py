"""Joints of free bodies, and joints in several worlds and after a restore; the conformance checks have the rest."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from cloths import fabric
from scipy.spatial.transform import Rotation
from servo_laws import BREAKAWAY, C, coasting_rate, numbers_of

from gauge_envs.backends import backend
from gauge_envs.backends.base import scene_support
from gauge_envs.backends.features import Feature
from gauge_envs.backends.worlds import Worlds
from gauge_envs.runs.rollout import record
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    BodyHinge,
    Box,
    Hinge,
    JointDynamics,
    Pose,
    Scene,
)
from gauge_envs.scene.driver_path import motor_commands
from gauge_envs.scene.motors import Servo, TorqueMotor
from gauge_envs.scene.profiles import SampledProfile
from gauge_envs.scene.servo_friction import ServoFriction
from gauge_envs.tools.bench.parts import body, box, box_inertia_kg_m2, ramp

ENGINES = {
    "mujoco": "mujoco",
    "newton": "newton",
    "drake": "pydrake",
    "pybullet": "pybullet",
    "physx": "sapien",
    "rapier": "rapier3d",
    "genesis": "genesis.version",
}
on_every_engine = pytest.mark.parametrize("name", ENGINES)
# Engines that take small steps, are compiled, or are not installed by default.
SLOW = ("newton", "pybullet", "drake", "genesis")
LAWS_BY_COST = [
    pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in ENGINES
]
STEP = ramp(0.03, start_s=0.0, duration_s=1e-6, ramp_s=0.0)


@on_every_engine
def test_a_motor_turns_two_free_bodies_apart_against_dry_friction(name):
    """Both centres are on the axis, so each body turns about its own."""
    pytest.importorskip(ENGINES[name])
    bodies = (
        box("small", (0.0, 0.0, 1.0), (0.1, 0.02, 0.03), mass_kg=0.3),
        box("large", (0.0, 0.1, 1.0), (0.2, 0.03, 0.03), mass_kg=0.5),
    )
    hinge = BodyHinge(
        first="large",
        second="small",
        anchor_m=(0.0, 0.05, 1.0),
        axis=(0.0, 1.0, 0.0),
        dynamics=JointDynamics(dry_friction_n_m=0.02),
        motor=TorqueMotor(command=STEP),
    )
    scene = Scene(
        bodies=bodies, body_hinges=(hinge,), duration_s=0.1, gravity_m_per_s2=0.0
    )
    engine = backend(name)
    if name in ("rapier", "genesis"):
        assert "free" in scene_support(engine, scene).missing[0]
        return
    simulation = engine.build(scene)
    simulation.reset(0)
    rollout = record(simulation, scene, 0.1)
    for one, sign in zip(bodies, (1.0, -1.0), strict=True):
        turned = rollout.rotation(one.name)[-1].as_rotvec()[1]
        assert turned == pytest.approx(
            sign * 0.5 * 0.01 * 0.1**2 / box_inertia_kg_m2(one)[1], rel=0.02
        )


def _arm(name="mujoco"):
    """Return two bars on the world, the upper one with a servo, the lower one with friction and a torque motor.

    On an engine that builds it, both have play too.
    """
    upper, lower = (
        body(
            name,
            Box(size_m=(0.02, 0.02, 0.2)),
            Pose(position_m=(0.0, 0.0, z)),
            mass_kg=0.2,
        )
        for name, z in (("upper", 0.9), ("lower", 0.7))
    )
    servo = Servo(
        command=ramp(0.5, start_s=0.0, duration_s=0.1, ramp_s=0.0),
        kp_n_m_per_rad=2.0,
        kv_n_m_s_per_rad=0.1,
    )
    friction = JointDynamics(
        dry_friction_n_m=0.005, viscous_friction_n_m_s_per_rad=0.001
    )
    first, second, bearing = "upper", "lower", JointDynamics()
    if Feature.BACKLASH in backend(name).features:
        # Both rotors turn the upper bar.
        first, second = second, first
        friction, bearing = (
            replace(one, armature_kg_m2=0.002, backlash_rad=0.02)
            for one in (friction, bearing)
        )
    axis = (0.0, 1.0, 0.0)
    inner = BodyHinge(
        first=first,
        second=second,
        anchor_m=(0.0, 0.0, 0.8),
        axis=axis,
        dynamics=friction,
        motor=TorqueMotor(command=STEP, delay_s=0.05),
    )
    outer = Hinge(
        body="upper", anchor_m=(0.0, 0.0, 1.0), axis=axis, motor=servo, dynamics=bearing
    )
    return Scene(
        bodies=(lower, upper), joints=(outer,), body_hinges=(inner,), duration_s=0.2
    )


def _played(world, first, last):
    states = []
    for values in motor_commands(_arm(), 36)[first:last]:
        if isinstance(world, Worlds):
            numbers = np.arange(len(world.worlds))
            world.command(np.tile(values, (len(numbers), 1)), numbers)
        else:
            world.command(values)
        world.advance(1 / 180)
        states.append(np.array(world.body_states(["upper", "lower"])))
    return states


@on_every_engine
def test_several_worlds_and_a_restored_one_move_as_one_does(name):
    pytest.importorskip(ENGINES[name])
    engine, scene = backend(name), _arm(name)
    simulation = engine.build(scene)
    simulation.reset(0)
    early = _played(simulation, 0, 18)
    state = copy.deepcopy(simulation.state())
    late = _played(simulation, 18, 36)
    assert np.abs(late[-1][:, :3] - early[0][:, :3]).max() > 0.01
    simulation.restore(state)
    np.testing.assert_array_equal(_played(simulation, 18, 36), late)
    simulation.reset(0)
    np.testing.assert_array_equal(_played(simulation, 0, 18), early)
    simulation.close()
    worlds = engine.build_worlds([scene, scene])
    worlds.reset(0)
    together = _played(worlds, 0, 36)
    for world in range(2):
        np.testing.assert_allclose(
            [states[world] for states in together], [*early, *late], atol=1e-5
        )
    worlds.close()


@on_every_engine
def test_a_bar_coasts_with_quadratic_friction_as_its_closed_form(name):
    """Without gravity I rate' = -c rate |rate|, so that rate = r / (1 + c r t / I).

    A motor that cancels the dry friction of the turning bar leaves the drag alone.
    """
    pytest.importorskip(ENGINES[name])
    rate, drag, seconds = 6.0, 1e-3, 0.2
    bar = replace(
        box("bar", (0.0, 0.0, 1.0), (0.2, 0.02, 0.03), mass_kg=0.3),
        angular_velocity_rad_per_s=(0.0, rate, 0.0),
    )
    friction = JointDynamics(quadratic_friction_n_m_s2_per_rad2=drag)
    hinge = Hinge(
        body="bar", anchor_m=(0.0, 0.0, 1.0), axis=(0.0, 1.0, 0.0), dynamics=friction
    )
    scene = Scene(
        bodies=(bar,), joints=(hinge,), duration_s=seconds, gravity_m_per_s2=0.0
    )
    engine = backend(name)
    inertia = float(box_inertia_kg_m2(bar)[1])
    for motor, dry in ((None, 0.0), (TorqueMotor(command=STEP), 0.03)):
        joint = replace(
            hinge, motor=motor, dynamics=replace(friction, dry_friction_n_m=dry)
        )
        moving = replace(scene, joints=(joint,))
        simulation = engine.build(moving)
        simulation.reset(0)
        rollout = record(simulation, moving, seconds)
        simulation.close()
        expected = rate / (1.0 + drag * rate * rollout.times_s / inertia)
        assert rollout.angular_velocity("bar")[:, 1] == pytest.approx(
            expected, rel=0.004
        )


DRY_N_M, SHARE = 0.02, 0.3
WEIGHT_N_M = 0.4 * GRAVITY_M_PER_S2 * 0.15
ABOUT_JOINT_KG_M2 = 0.4 * ((0.3**2 + 0.03**2) / 12.0 + 0.15**2)


def _loaded(angles_rad):
    """Return bars at rest on a level axis, whose friction has a dry part and a share of the load."""
    law = JointDynamics(
        dry_friction_n_m=DRY_N_M, servo=ServoFriction(load_friction=SHARE)
    )
    bars, hinges = [], []
    for number, angle in enumerate(angles_rad):
        turn = Rotation.from_rotvec([0.0, angle, 0.0])
        place = np.array([0.0, number, 1.0]) + turn.apply([0.0, 0.0, -0.15])
        pose = Pose.from_rotation(tuple(place.tolist()), turn)
        shape = Box(size_m=(0.03, 0.03, 0.3))
        bars.append(body(f"bar{number}", shape, pose, mass_kg=0.4))
        anchor_m = (0.0, float(number), 1.0)
        hinge = Hinge(body=f"bar{number}", anchor_m=anchor_m, axis=(0.0, 1.0, 0.0))
        hinges.append(replace(hinge, dynamics=law))
    return Scene(bodies=tuple(bars), joints=tuple(hinges), duration_s=0.1)


def test_cloth_beside_a_joint_with_friction_by_load_falls_as_alone():
    aside = Pose(position_m=(5.0, 0.0, 5.0), quaternion=(1.0, 0.0, 0.0, 0.0))
    sheet = fabric("satin", (0.1, 0.1), aside)
    loaded = replace(_loaded([0.8]), deformables=(sheet,))
    simulation = backend("mujoco").build(loaded)
    simulation.reset(0)
    fallen_m = simulation.nodes(sheet.name)[:, 2].copy()
    simulation.advance(0.1)
    fallen_m -= simulation.nodes(sheet.name)[:, 2]
    assert fallen_m == pytest.approx(0.5 * GRAVITY_M_PER_S2 * 0.1**2, rel=0.03)


@pytest.mark.parametrize("name", ["mujoco", "rapier"])
def test_worlds_have_the_friction_of_the_world_alone(name):
    pytest.importorskip(ENGINES[name])
    scenes = [_loaded([0.8]), _loaded([0.5])]
    worlds = backend(name).build_worlds(scenes)
    worlds.reset(0)
    worlds.advance(0.05)
    for scene, place in zip(scenes, worlds.body_states(["bar0"]), strict=True):
        alone = backend(name).build(scene)
        alone.reset(0)
        alone.advance(0.05)
        np.testing.assert_array_equal(place, alone.body_states(["bar0"]))


@on_every_engine
def test_friction_by_load_takes_a_share_of_the_work_of_a_falling_bar(name):
    """A fall of a weight w by the angle a loses dry a + share of w's work."""
    pytest.importorskip(ENGINES[name])
    start = 0.8
    scene = _loaded([start])
    simulation = backend(name).build(scene)
    simulation.reset(0)
    simulation.advance(0.05)
    state = copy.deepcopy(simulation.state())
    simulation.advance(0.05)
    states = simulation.body_states(["bar0"])
    simulation.restore(state)
    simulation.advance(0.05)
    np.testing.assert_array_equal(simulation.body_states(["bar0"]), states)
    simulation.close()
    angle = Rotation.from_quat(states[0, 3:7], scalar_first=True).as_rotvec()[1]
    work = (1.0 - SHARE) * WEIGHT_N_M * (np.cos(angle) - np.cos(start))
    work -= DRY_N_M * (start - angle)
    rate = -np.sqrt(2.0 * work / ABOUT_JOINT_KG_M2)
    assert states[0, 11] == pytest.approx(rate, rel=0.005)


def _motored(cases, *, gravity_m_per_s2, rate=0.0, scale=0.1):
    """Return level bars that turn at a rate, each with a law of a rate r [rad/s] and a motor of a torque [N m]."""
    scene = _loaded([0.5 * np.pi] * len(cases))
    bars, hinges = [], []
    for bar, hinge, (law, torque) in zip(
        scene.bodies, scene.joints, cases, strict=True
    ):
        spin = (0.0, rate, 0.0)
        speed = np.cross(spin, np.subtract(bar.pose.position_m, hinge.anchor_m))
        moving = {"angular_velocity_rad_per_s": spin}
        moving["linear_velocity_m_per_s"] = tuple(speed.tolist())
        bars.append(replace(bar, **moving))
        friction = ServoFriction(**numbers_of(law, WEIGHT_N_M, scale))
        terms = JointDynamics(dry_friction_n_m=C * WEIGHT_N_M, servo=friction)
        steady = SampledProfile(times_s=(0.0, 1.0), values=(torque, torque))
        motor = TorqueMotor(command=steady)
        hinges.append(replace(hinge, dynamics=terms, motor=motor))
    return replace(
        scene,
        bodies=tuple(bars),
        joints=tuple(hinges),
        gravity_m_per_s2=gravity_m_per_s2,
    )


def _recorded(name, scene, seconds):
    simulation = backend(name).build(scene)
    simulation.reset(0)
    rollout = record(simulation, scene, seconds)
    simulation.close()
    return rollout


@pytest.mark.parametrize("name", LAWS_BY_COST)
def test_a_loaded_joint_breaks_away_at_the_torque_of_its_law(name):
    """A level bar rests a percent inside of both torques, and moves a percent outside."""
    pytest.importorskip(ENGINES[name])
    cases, expected = [], []
    for law, (up, down) in BREAKAWAY.items():
        for edge, side in ((up, 1), (down, -1)):
            inside, outside = edge * (1.0 - 0.01 * side), edge * (1.0 + 0.01 * side)
            cases += [(law, inside * WEIGHT_N_M), (law, outside * WEIGHT_N_M)]
            expected += [0, side]
    scene = _motored(cases, gravity_m_per_s2=GRAVITY_M_PER_S2)
    rollout = _recorded(name, scene, 0.015)
    for bar, case, side in zip(scene.bodies, cases, expected, strict=True):
        turns = rollout.rotation(bar.name)
        moved_rad = (turns[-1] * turns[0].inv()).as_rotvec()[1]
        if side:
            assert side * moved_rad > 1e-5, case
        else:
            assert abs(moved_rad) < 1e-6, case


@pytest.mark.parametrize("name", LAWS_BY_COST)
def test_a_braked_joint_coasts_as_its_law(name):
    pytest.importorskip(ENGINES[name])
    brake_n_m, rate = 0.5 * WEIGHT_N_M, 1.0
    cases = [(law, -brake_n_m) for law in BREAKAWAY]
    scene = _motored(cases, gravity_m_per_s2=0.0, rate=rate, scale=rate)
    rollout = _recorded(name, scene, 0.025)
    for bar, (law, _) in zip(scene.bodies, cases, strict=True):
        # An engine may have rates half a step off: from the first interval on all count alike.
        times_s = rollout.times_s[1:] - rollout.times_s[1]
        rates = rollout.angular_velocity(bar.name)[1:, 1]
        numbers = (WEIGHT_N_M, brake_n_m, ABOUT_JOINT_KG_M2, rate, rates[0])
        expected = coasting_rate(law, *numbers, times_s)
        assert expected[-1] > 0.3 * rate
        assert rates == pytest.approx(expected, abs=0.001 * rate), law
