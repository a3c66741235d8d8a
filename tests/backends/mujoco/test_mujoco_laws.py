"""MuJoCo scenes against closed forms: what a rigid body must do, whatever the score says."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from gauge_envs.backends import backend
from gauge_envs.envs.env import GaugeEnv
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Box,
    Contact,
    ContactMode,
    Cylinder,
    Motion,
    Plane,
    Pose,
    RigidBody,
    Scene,
    Sphere,
)
from gauge_envs.scene.driver_path import DriverPath
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.profiles import TrapezoidProfile
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S

G = GRAVITY_M_PER_S2
MUJOCO = backend("mujoco")


def plane(height_m: float = 0.0) -> RigidBody:
    return RigidBody(
        name="ground",
        shape=Plane(),
        motion=Motion.FIXED,
        pose=Pose(position_m=(0, 0, height_m)),
        mass_kg=0.0,
    )


def ball(
    name: str,
    position_m: tuple[float, float, float],
    mass_kg: float = 0.1,
    radius_m: float = 0.03,
) -> RigidBody:
    return RigidBody(
        name=name,
        shape=Sphere(radius_m=radius_m),
        motion=Motion.DYNAMIC,
        pose=Pose(position_m=position_m),
        mass_kg=mass_kg,
    )


def test_impact_with_friction_stops_the_slip_and_does_not_reverse_it() -> None:
    scene = Scene(
        bodies=(
            RigidBody(
                name="slab",
                shape=Box(size_m=(0.2, 0.2, 0.02)),
                motion=Motion.DYNAMIC,
                pose=Pose(position_m=(0, 0, 0.2)),
                mass_kg=0.5,
            ),
            plane(),
        ),
        contacts=(
            Contact(
                first=("slab",),
                second=("ground",),
                friction=0.5,
                restitution=0.5,
                mode=ContactMode.IMPACT,
            ),
        ),
        duration_s=1.0,
    )
    simulation = MUJOCO.build(scene)
    simulation.reset(0)
    simulation.data.qvel[0] = 0.5
    simulation.advance(0.25)
    # Coulomb: the impulse mu (1 + e) m v exceeds m times the slip, so friction takes all of it.
    assert simulation.body_states(["slab"])[0, 7] == pytest.approx(0.0, abs=0.02)


@pytest.mark.slow
def test_pendulum_period_and_energy(rollout) -> None:
    env, trajectory, info = rollout("Pendulum-metal")
    score = info["score"]
    assert abs(score.el) < 1e-4
    assert 1.0 <= score.pd_normalized <= 1.1
    hinge = env.experiment.scene.joints[0]
    arm = np.linalg.norm(
        np.subtract(hinge.anchor_m, env.experiment.scene.bodies[0].pose.position_m)
    )
    # A sphere on a light rod, including its own inertia 2/5 m r^2.
    stiffness = G * arm / (arm**2 + 0.4 * 0.03**2)
    exact = solve_ivp(
        lambda _, y: [y[1], -stiffness * np.sin(y[0])],
        (0, 10),
        [-np.pi / 2, 0.0],
        rtol=1e-11,
        atol=1e-12,
        t_eval=[10],
    )
    expected = np.asarray(hinge.anchor_m)[[0, 2]] + arm * np.array(
        [np.sin(exact.y[0, 0]), -np.cos(exact.y[0, 0])]
    )
    assert 1e-3 * trajectory.frames[300, [0, 2]] == pytest.approx(expected, abs=2e-4)


def carried_scene(
    motions: tuple[DriverMotion, ...], friction: float, offset_m: float = 0.05
) -> Scene:
    table = RigidBody(
        name="table",
        shape=Cylinder(radius_m=0.3, length_m=0.02),
        motion=Motion.KINEMATIC,
        pose=Pose(position_m=(0, 0, 0.5)),
        mass_kg=1.0,
    )
    cube = RigidBody(
        name="cube",
        shape=Box(size_m=(0.05, 0.05, 0.05)),
        motion=Motion.DYNAMIC,
        pose=Pose(position_m=(offset_m, 0, 0.535)),
        mass_kg=0.2,
    )
    return Scene(
        bodies=(cube, table, plane()),
        contacts=(
            Contact(
                first=("cube",), second=("table",), friction=friction, restitution=0.0
            ),
        ),
        drivers=(Driver(body="table", motions=motions, provenance="nominal"),),
        duration_s=2.0,
    )


def drive(simulation, scene: Scene, seconds: float) -> np.ndarray:
    """Cube and table states after a driven run, shape [2, 13]."""
    simulation.reset(0)
    path = DriverPath(scene.drivers[0], scene, round(seconds * 30) + 2)
    for sample in range(round(seconds / SAMPLE_INTERVAL_S)):
        simulation.drive(
            "table", *path.interval(sample, np.zeros(len(scene.drivers[0].motions)))
        )
        simulation.advance(SAMPLE_INTERVAL_S)
    return simulation.body_states(["cube", "table"])


def test_turning_table_carries_a_cube_round_with_the_stated_outward_creep() -> None:
    speed = 2.0
    turn = TrapezoidProfile(
        start_s=0.0, duration_s=10.0, accelerate_s=0.5, brake_s=0.0, amount=speed * 9.75
    )
    scene = carried_scene(
        (DriverMotion(kind="rotate", axis=(0.0, 0.0, 1.0), profiles=(turn,)),),
        friction=0.35,
    )
    cube, _ = drive(MUJOCO.build(scene), scene, 1.75)
    angle = np.arctan2(cube[1], cube[0])
    assert np.angle(np.exp(1j * (angle - speed * 1.5))) == pytest.approx(0.0, abs=0.01)
    # MuJoCo leaves the contact point's own rotation out: outward creep of about omega^2 r tau / 2, 0.2 mm/s here.
    assert 0.0 < np.hypot(cube[0], cube[1]) - 0.05 < 6e-4


def test_driven_body_follows_its_path_exactly_under_load(rollout) -> None:
    env, trajectory, _ = rollout("SlopeSlider-3-metal")
    driver = env.experiment.scene.drivers[0]
    end = driver.pose(
        env.experiment.scene.body("board").pose, (len(trajectory.frames) - 1) / 30
    )
    board = env.simulation.body_states(["board"])[0]
    assert board[:3] == pytest.approx(end.position_m, abs=1e-6)
    assert abs(board[3:7] @ end.quaternion) == pytest.approx(1.0, abs=1e-9)


def test_tilting_board_lets_go_at_the_friction_angle(rollout) -> None:
    env, trajectory, _ = rollout("SlopeSlider-3-metal")
    driver, start = (
        env.experiment.scene.drivers[0],
        env.experiment.scene.body("board").pose,
    )
    poses = [driver.pose(start, t) for t in trajectory.times_s]
    along_board = np.array(
        [p.to_body(1e-3 * g)[0] for p, g in zip(poses, trajectory.samples, strict=True)]
    )
    first = int(np.flatnonzero(along_board - along_board[0] > 2e-4)[0])
    tilt_deg = np.degrees(driver.motions[0].value(trajectory.times_s[first]))
    friction = env.experiment.scene.contacts[0].friction
    # 0.2 mm of slip at the growing acceleration takes about 0.05 s, which is 0.7 degrees of tilt.
    assert (
        np.degrees(np.arctan(friction))
        < tilt_deg
        < np.degrees(np.arctan(friction)) + 1.2
    )


@pytest.mark.slow
def test_cradle_with_calibrated_restitution_repeats_the_papers_finding(rollout) -> None:
    *_, info = rollout("NewtonsCradle-metal")
    assert 0.2 <= info["score"].mte_normalized <= 0.3
    assert info["score"].lsd_normalized < 0.2


@pytest.mark.slow
def test_cradle_with_effective_restitution_is_the_real_one(rollout) -> None:
    _, trajectory, info = rollout("NewtonsCradle-metal", parameters="effective")
    assert info["score"].mte == pytest.approx(0.93, abs=0.01)
    assert info["score"].lsd_s > 0.2
    height = trajectory.frames[:90, 2] - trajectory.frames[0, 2]
    in_row = height < 1.0
    rests = np.flatnonzero(np.diff(in_row.astype(int)) == 1)
    assert len(rests) >= 3


@pytest.mark.slow
def test_wall_stands_until_it_is_hit(rollout) -> None:
    env, trajectory, info = rollout("WallBreaking-wood")
    bricks = trajectory.frames.reshape(len(trajectory.frames), -1, 3)
    moved = np.linalg.norm(bricks - bricks[0], axis=2)
    assert bricks.shape[1] == 118
    assert "diverged" not in info
    # The ball falls freely on its string for at least 0.2 s.
    assert moved[:7].max() < 1.0
    assert moved[-1].max() > 50.0
    assert env.simulation.settings["preset"] == "stack"


def test_steps_read_no_clock_but_that_of_the_user() -> None:
    """The timers of MuJoCo are differences of readings, so they stay at zero with a clock that stands still."""
    env = GaugeEnv("Pendulum-metal")
    env.reset(seed=0)
    env.step(0)
    assert env.simulation.data.timer[mujoco.mjtTimer.mjTIMER_STEP].duration == 0.0
    assert mujoco.get_mjcb_time() is None
    readings = itertools.count()
    mujoco.set_mjcb_time(lambda: float(next(readings)))
    try:
        env.step(0)
        assert mujoco.get_mjcb_time() is not None and next(readings) > 1
    finally:
        mujoco.set_mjcb_time(None)
