"""Rigid scenes in PyBullet against closed forms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Attachment,
    Box,
    Contact,
    ContactMode,
    ConvexUnion,
    Motion,
    Plane,
    Pose,
    Region,
    RigidBody,
    Rope,
    Scene,
    SoftBody,
    Sphere,
)

pytest.importorskip("pybullet")

from gauge_envs.backends import backend
from gauge_envs.backends.pybullet.deformables import SOFT_MARGIN_M
from gauge_envs.backends.pybullet.settings import settings_for
from gauge_envs.backends.pybullet.simulation import SimulationPyBullet
from gauge_envs.backends.pybullet.world import BulletWorld
from gauge_envs.tools.conformance import Status, run_checks

ENGINE = backend("pybullet")
G = GRAVITY_M_PER_S2


def solid(
    name: str,
    shape: object,
    position_m: tuple,
    *,
    motion: Motion = Motion.DYNAMIC,
    mass_kg: float = 0.1,
):
    return RigidBody(
        name=name,
        shape=shape,
        motion=motion,
        pose=Pose(position_m=position_m),
        mass_kg=mass_kg,
    )


def dropped_ball(motion: Motion, restitution: float) -> Scene:
    ball = solid("ball", Sphere(radius_m=0.03), (0.0, 0.0, 0.43))
    plate = solid(
        "plate", Box(size_m=(0.5, 0.5, 0.02)), (0.0, 0.0, -0.01), motion=motion
    )
    contact = Contact(
        first=("ball",),
        second=("plate",),
        friction=0.5,
        restitution=restitution,
        mode=ContactMode.IMPACT,
    )
    return Scene(bodies=(ball, plate), contacts=(contact,), duration_s=1.0)


def rebound(scene: Scene, **settings: object) -> float:
    """Return the outgoing over the incoming speed of a ball that falls by 0.4 m, by energy."""
    simulation = ENGINE.build(scene, settings)
    simulation.reset(0)
    for _ in range(120):
        simulation.advance(1 / 180)
        state = simulation.body_states(["ball"])[0]
        height, speed = state[2] - 0.03, state[9]
        if speed > 0.1 and height > 1e-3:
            simulation.close()
            return float(np.sqrt((speed**2 + 2.0 * G * height) / (2.0 * G * 0.4)))
    raise AssertionError("the ball does not rebound")


def failures(*only: str) -> list[str]:
    results = list(run_checks("pybullet", only=only))
    assert len(results) >= len(only)
    return [
        f"{one.check}: {one.measured} {one.diagnosis}"
        for one in results
        if one.status is not Status.PASS
    ]


def test_velocity_correction_of_penetrations_would_add_to_the_rebound() -> None:
    assert rebound(dropped_ball(Motion.FIXED, 0.5), split_impulse="none") > 0.55


def pushed_cube(friction: float) -> Scene:
    """A cube on a board, and a bar behind it that is driven."""
    bodies = (
        solid("cube", Box(size_m=(0.05, 0.05, 0.05)), (0.0, 0.0, 0.025)),
        solid(
            "board",
            Box(size_m=(2.0, 2.0, 0.02)),
            (0.0, 0.0, -0.01),
            motion=Motion.FIXED,
        ),
        solid(
            "bar",
            Box(size_m=(0.02, 0.12, 0.03)),
            (-0.035, 0.0, 0.025),
            motion=Motion.KINEMATIC,
        ),
    )
    contact = Contact(
        first=("cube",), second=("board", "bar"), friction=friction, restitution=0.0
    )
    return Scene(bodies=bodies, contacts=(contact,), duration_s=1.0)


@pytest.mark.parametrize(("acceleration", "aside"), [(5.0, -0.15), (60.0, -1.2)])
def test_cube_that_a_bar_pushes_and_slips_along_moves_along_the_edge_of_the_friction_cone(
    acceleration: float, aside: float
) -> None:
    """While the bar slips, m (a, -mu a) is the bar's force less friction along the velocity (1, -mu)."""
    friction, step = 0.3, 1 / 180
    scene = pushed_cube(friction)
    simulation = ENGINE.build(scene)
    simulation.reset(0)
    place, velocity = (
        np.array(scene.body("bar").pose.position_m),
        np.array([0.0, aside, 0.0]),
    )
    change = np.array([acceleration, 0.0, 0.0])
    for _ in range(9):
        simulation.drive(
            "bar",
            Pose(position_m=tuple(place.tolist())),
            np.r_[velocity, 0, 0, 0],
            np.r_[change, 0, 0, 0],
        )
        simulation.advance(step)
        place, velocity = (
            place + (velocity + 0.5 * change * step) * step,
            velocity + change * step,
        )
    speed = simulation.body_states(["cube"])[0, 7:9]
    simulation.close()
    assert speed[0] == pytest.approx(velocity[0], rel=0.002)
    assert speed[1] / speed[0] == pytest.approx(-friction, rel=0.005)


def test_gravity_does_not_move_a_driven_body_within_a_step() -> None:
    box = Box(size_m=(0.1, 0.1, 0.1))
    plate = solid("plate", box, (0.0, 0.0, -0.05), motion=Motion.KINEMATIC)
    contact = Contact(first=("cube",), second=("plate",), friction=0.5, restitution=0.0)
    scene = Scene(
        bodies=(solid("cube", box, (0.0, 0.0, 0.05)), plate),
        contacts=(contact,),
        duration_s=1.0,
    )
    simulation = ENGINE.build(scene, {"timestep_s": 1 / 180})
    simulation.reset(0)
    simulation.advance(1.0)
    # The plate would yield at g h = 54 mm/s, and the cube would sink until the correction of its depth is as fast.
    assert simulation.body_states(["cube"])[0, 2] == pytest.approx(0.05, abs=2e-5)
    simulation.close()


ROPE = Rope(
    name="rope",
    pose=Pose(position_m=(0.0, 0.0, 1.0)),
    length_m=0.3,
    radius_m=0.002,
    mass_kg=0.01,
    young_modulus_pa=1e6,
)
BOB = Sphere(radius_m=0.02)
LOW, HIGH = Region(axis="x", side="low"), Region(axis="x", side="high")


@pytest.mark.parametrize("held", ["low", "high"])
@pytest.mark.parametrize("order", [1, -1])
def test_bob_on_a_light_rope_is_a_pendulum(held: str, order: int) -> None:
    """The bob's centre is at the rope's length plus its radius from the fixed end; 3 % of the mass is the rope's."""
    fixed, free = (LOW, HIGH) if held == "low" else (HIGH, LOW)
    # The free end of the rope is 5 degrees off the lowest point.
    pitch = 85.0 if held == "low" else -85.0
    rope = replace(ROPE, pose=Pose.from_euler_deg((0.0, 0.0, 1.0), (0.0, pitch, 0.0)))
    down = rope.pose.rotation.apply([1.0 if held == "low" else -1.0, 0.0, 0.0])
    bob = solid(
        "bob",
        BOB,
        tuple((np.array([0.0, 0.0, 1.0]) + 0.17 * down).tolist()),
        mass_kg=10.0,
    )
    frame = solid(
        "frame", Box(size_m=(0.1, 0.1, 0.1)), (0.0, 0.0, 3.0), motion=Motion.FIXED
    )
    attachments = (
        Attachment(deformable="rope", region=fixed, to="frame"),
        Attachment(deformable="rope", region=free, to="bob"),
    )
    scene = Scene(
        bodies=(bob, frame),
        deformables=(rope,),
        attachments=attachments[::order],
        duration_s=2.0,
    )
    simulation = ENGINE.build(scene)
    simulation.reset(0)
    picked = [0, 13, -1]
    start = simulation.nodes("rope")
    assert start == pytest.approx(
        rope.pose.to_world(np.linspace([-0.15, 0, 0], [0.15, 0, 0], 25)), abs=1e-9
    )
    read = simulation.track("rope", start[picked])
    place = []
    for _ in range(270):
        simulation.advance(1 / 180)
        place.append(simulation.body_states(["bob"])[0, 0])
    nodes = simulation.nodes("rope")
    simulation_points = read()
    simulation.close()
    assert nodes.shape == (25, 3)
    assert simulation_points == pytest.approx(nodes[picked], abs=1e-9)
    assert np.linalg.norm(np.diff(nodes, axis=0), axis=1).sum() == pytest.approx(
        0.3, rel=1e-9
    )
    pivot = -0.15 * down[0]
    assert abs(place[0] - pivot) == pytest.approx(
        0.32 * np.sin(np.radians(5.0)), rel=0.01
    )
    crossings = np.flatnonzero(np.diff(np.sign(np.array(place) - pivot)) != 0)
    assert len(crossings) >= 2
    assert np.diff(crossings).mean() / 180 == pytest.approx(
        np.pi * np.sqrt(0.32 / G), rel=0.01
    )


def test_laws_of_foam() -> None:
    assert failures("foam-*") == []


def foam_between_plates() -> Scene:
    foam = SoftBody(
        name="foam",
        shape=Box(size_m=(0.05, 0.05, 0.2)),
        pose=Pose(position_m=(0.0, 0.0, 1.0)),
        mass_kg=0.05,
        young_modulus_pa=1e4,
        poisson_ratio=0.3,
    )
    plates = tuple(
        solid(name, Box(size_m=(0.06, 0.06, 0.01)), (0.0, 0.0, height), motion=motion)
        for name, height, motion in (
            ("low", 0.9, Motion.FIXED),
            ("high", 1.1, Motion.KINEMATIC),
        )
    )
    attachments = tuple(
        Attachment(
            deformable="foam",
            region=Region(axis="z", side=plate.name, depth_m=0.012),
            to=plate.name,
        )
        for plate in plates
    )
    return Scene(
        bodies=plates, deformables=(foam,), attachments=attachments, duration_s=1.0
    )


def test_attached_layers_of_foam_follow_their_plates_and_runs_repeat() -> None:
    scene = foam_between_plates()
    simulation = ENGINE.build(scene)

    def rollout() -> np.ndarray:
        simulation.reset(0)
        for step in range(18):
            place = Pose(position_m=(0.0, 0.0, 1.1 + 0.1 * step / 180))
            simulation.drive(
                "high", place, np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]), np.zeros(6)
            )
            simulation.advance(1 / 180)
        return simulation.nodes("foam")

    simulation.reset(0)
    start = simulation.nodes("foam")
    end = rollout()
    again = rollout()
    simulation.close()
    height = start[:, 2]
    # 11 cells of 16 mm between the attached layers.
    assert sorted({round(z, 9) for z in height if z < 0.93}) == pytest.approx(
        [0.9, 0.912, 0.928], abs=1e-9
    )
    assert end[height < 0.9121] == pytest.approx(start[height < 0.9121], abs=1e-9)
    assert (end - start)[height > 1.0879] == pytest.approx(
        np.broadcast_to([0, 0, 0.01], (32, 3)), abs=1e-6
    )
    assert np.array_equal(end, again)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["FoamTwisting-soft", "FoamShearing-hard", "FoamCompressing-hard"]
)
def test_foam_of_the_benchmark_stays_bounded(name: str) -> None:
    assert run_episode(RunRequest(name, backend="pybullet")).outcome == "finished"


def test_free_rope_falls() -> None:
    simulation = ENGINE.build(Scene(bodies=(), deformables=(ROPE,), duration_s=1.0))
    simulation.reset(0)
    start = simulation.nodes("rope")
    simulation.advance(0.2)
    fallen = simulation.nodes("rope") - start
    simulation.close()
    assert fallen == pytest.approx(
        np.broadcast_to([0.0, 0.0, -0.5 * G * 0.2**2], start.shape), abs=2e-4
    )


def test_pieces_of_a_solid_carry_a_ball_between_them() -> None:
    corners = [
        (x, y, z) for x in (0.0, 0.05) for y in (-0.05, 0.05) for z in (-0.02, 0.0)
    ]
    left = tuple((x - 0.06, y, z) for x, y, z in corners)
    right = tuple((x + 0.01, y, z) for x, y, z in corners)
    rails = solid(
        "rails",
        ConvexUnion(pieces_m=(left, right)),
        (0.0, 0.0, 0.5),
        motion=Motion.FIXED,
    )
    # A ball of radius 30 mm sinks by 30 - sqrt(30^2 - 10^2) mm into a gap of 20 mm.
    height = float(np.sqrt(0.03**2 - 0.01**2))
    ball = solid("ball", Sphere(radius_m=0.03), (0.0, 0.0, 0.5 + height))
    contact = Contact(first=("ball",), second=("rails",), friction=0.5, restitution=0.0)
    simulation = ENGINE.build(
        Scene(bodies=(ball, rails), contacts=(contact,), duration_s=1.0)
    )
    simulation.reset(0)
    simulation.advance(0.5)
    assert simulation.body_states(["ball"])[0, :3] == pytest.approx(
        [0.0, 0.0, 0.5 + height], abs=1e-4
    )
    simulation.close()


def test_out_of_box_is_the_engine_as_it_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    """The values of the preset are PyBullet's: a world to which they are not given moves bit for bit as one to which
    they are.
    """
    scene = load_experiment("NonsmoothContact-1-wood").scene
    kept = {
        "fixedTimeStep",
        "numSubSteps",
        "deterministicOverlappingPairs",
        "enableFileCaching",
    }
    call = BulletWorld.call

    def without_parameters(
        self: BulletWorld, function: str, *arguments: object, **named: object
    ) -> object:
        if function == "setPhysicsEngineParameter":
            named = {name: value for name, value in named.items() if name in kept}
        return call(self, function, *arguments, **named)

    def rollout(**changes: object) -> np.ndarray:
        simulation = SimulationPyBullet(
            scene, settings_for(scene, {"preset": "out_of_box", **changes})
        )
        positions = simulation.sample_positions(["pyramid"], 60, 1 / 180)
        simulation.close()
        return positions

    changes = [{}, {"reduced_coordinates": False}]
    given = [rollout(**one) for one in changes]
    differs = rollout(reduced_coordinates=False, warm_starting=0.85)
    monkeypatch.setattr(BulletWorld, "call", without_parameters)
    assert all(
        np.array_equal(rollout(**one), positions)
        for one, positions in zip(changes, given, strict=True)
    )
    assert not np.array_equal(differs, given[1])


@pytest.mark.slow
def test_closing_frees_worlds() -> None:
    # PyBullet has room for 1024 worlds in one process.
    for _ in range(1100):
        simulation = ENGINE.build(dropped_ball(Motion.FIXED, 0.5))
        simulation.close()


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="no list of open files")
def test_closing_leaves_no_open_file_and_happens_once() -> None:
    scene = load_experiment("NonsmoothContact-1-wood").scene
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(3):
        simulation = ENGINE.build(scene)
        simulation.reset(0)
        simulation.close()
        simulation.close()
    assert len(list(Path("/proc/self/fd").iterdir())) == before


@pytest.mark.slow
def test_wall_stands_and_its_ball_stays_on_the_string() -> None:
    scene = load_experiment("WallBreaking-wood").scene
    calm = replace(
        scene,
        bodies=tuple(body for body in scene.bodies if body.name != "ball"),
        joints=(),
        contacts=tuple(
            contact for contact in scene.contacts if "ball" not in contact.first
        ),
    )
    names = [body.name for body in calm.dynamic_bodies]
    simulation = ENGINE.build(calm)
    simulation.reset(0)
    start = simulation.body_states(names)[:, :3]
    simulation.advance(0.5)
    assert (
        np.linalg.norm(simulation.body_states(names)[:, :3] - start, axis=1).max()
        < 1e-4
    )
    simulation.close()


def test_a_body_beyond_the_plane_ends_the_episode() -> None:
    ground = solid("ground", Plane(), (0.0, 0.0, 0.0), motion=Motion.FIXED, mass_kg=0.0)
    ball = replace(
        solid("ball", Sphere(radius_m=0.03), (7.5, 0.0, 0.03)),
        linear_velocity_m_per_s=(3.0, 0.0, 0.0),
    )
    contact = Contact(
        first=("ball",), second=("ground",), friction=0.5, restitution=0.0
    )
    simulation = ENGINE.build(
        Scene(bodies=(ground, ball), contacts=(contact,), duration_s=1.0)
    )
    assert simulation.fault() is None
    simulation.advance(0.5)
    assert (
        simulation.fault() == "ball is beyond the 8 m that this backend's planes reach"
    )
    simulation.close()


def test_springs_of_contacts_carry_and_throw_back_a_cube() -> None:
    """Four corners on springs: depth at rest m g / 4 k, and depth v sqrt(m / 4 k) of a fast impact."""
    stiffness, mass_kg, half_m = 1e4, 0.37, 0.0524
    upright = {"cube.euler_deg": (0.0, 0.0, 0.0), "cube.restitution": 0.0}
    springs = {"contact_stiffness_n_per_m": stiffness, "split_impulse": "none"}

    def heights_m(start_m: float, damping: float, seconds: float) -> np.ndarray:
        experiment = load_experiment(
            "CubeToss-acrylic", {"cube.position_m": (0.0, 0.0, start_m), **upright}
        )
        settings = {**springs, "contact_damping_n_s_per_m": damping}
        simulation = SimulationPyBullet(
            experiment.scene, settings_for(experiment.scene, settings)
        )
        simulation.reset(0)
        found = []
        for _ in range(round(900 * seconds)):
            simulation.advance(1 / 900)
            found.append(simulation.body_states(("cube",))[0, 2])
        simulation.close()
        return np.array(found)

    at_rest_m = half_m - heights_m(half_m, 30.0, 0.3)[-1]
    assert at_rest_m == pytest.approx(
        mass_kg * GRAVITY_M_PER_S2 / (4.0 * stiffness), rel=0.01
    )
    deepest_m = half_m - heights_m(half_m + 0.05, 1e-6, 0.15).min()
    speed = np.sqrt(2.0 * GRAVITY_M_PER_S2 * 0.05)
    # Bullet integrates the spring implicitly, which damps it by the ratio w h / 2. Gravity adds the depth at rest.
    rate = np.sqrt(4.0 * stiffness / mass_kg)
    closed_m = speed / rate * np.exp(-0.25 * np.pi * rate / 9000.0) + at_rest_m
    assert deepest_m == pytest.approx(closed_m, rel=0.01)


def test_checks_see_a_driven_body_that_bullet_does_not_move(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The state of a driven body is Bullet's: one that gets no velocity falls, whatever its driver prescribes."""
    from gauge_envs.backends.pybullet import simulation

    for name in ("resetBasePositionAndOrientation", "resetBaseVelocity"):
        monkeypatch.setattr(simulation.pybullet, name, lambda *args, **named: None)
    results = list(run_checks("pybullet", only=["driven-*"]))
    assert [one.check for one in results if one.is_bad] == [
        "driven-velocity",
        "driven-path",
        "driven-flick",
    ]
    assert results[0].measured == 0.0


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_foam_slides_by_the_law_one_margin_above_the_board(friction: float) -> None:
    half, middle = np.radians(15.0), 0.05 + 0.02 + SOFT_MARGIN_M
    turn = (float(np.cos(half)), 0.0, float(np.sin(half)), 0.0)
    up, down = (
        np.array([np.sin(2 * half), 0.0, np.cos(2 * half)]),
        np.array([np.cos(2 * half), 0.0, -np.sin(2 * half)]),
    )
    board = RigidBody(
        name="board",
        shape=Box(size_m=(2.0, 0.5, 0.1)),
        motion=Motion.FIXED,
        mass_kg=1.0,
        pose=Pose(position_m=(0.0, 0.0, 0.0), quaternion=turn),
    )
    foam = SoftBody(
        name="foam",
        shape=Box(size_m=(0.04, 0.04, 0.04)),
        pose=Pose(position_m=tuple(middle * up), quaternion=turn),
        mass_kg=0.0064,
        young_modulus_pa=1e4,
        poisson_ratio=0.3,
    )
    contacts = (
        Contact(first=("foam",), second=("board",), friction=friction, restitution=0.0),
    )
    simulation = backend("pybullet").build(
        Scene(bodies=(board,), deformables=(foam,), contacts=contacts, duration_s=1.0)
    )
    places = []
    for _ in range(60):
        simulation.advance(1 / 180)
        places.append(simulation.nodes("foam").mean(axis=0))
    fit = np.polyfit(np.arange(40) / 180, np.array(places)[20:] @ down, 2)
    assert 2.0 * fit[0] == pytest.approx(
        GRAVITY_M_PER_S2 * (0.5 - friction * np.sqrt(0.75)), rel=1e-3
    )
    assert places[-1] @ up == pytest.approx(middle, abs=1e-4)
