"""Rigid scenes in PyBullet against closed forms."""

from contextlib import closing
from dataclasses import replace
from itertools import product
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
    ConvexUnion,
    Motion,
    Pose,
    Region,
    Rope,
    SoftBody,
)
from gauge_envs.scene.geometry import vector

pytest.importorskip("pybullet")

from rigid import plane_deg, scene_of, solid, states

from gauge_envs.backends import backend
from gauge_envs.backends.pybullet.deformables import SOFT_MARGIN_M
from gauge_envs.backends.pybullet.model import Model
from gauge_envs.backends.pybullet.world import pybullet
from gauge_envs.tools.bench.parts import ball, contact, driven_box, fixed_box
from gauge_envs.tools.conformance import run_checks

ENGINE = backend("pybullet")
G = GRAVITY_M_PER_S2


def dropped_ball(motion, restitution):
    touch = contact("ball", "plate", friction=0.5, restitution=restitution)
    plate = replace(
        fixed_box("plate", (0.0, 0.0, -0.01), (0.5, 0.5, 0.02)), motion=motion
    )
    return scene_of(ball("ball", (0.0, 0.0, 0.43)), plate, contacts=(touch,))


def rebound(scene, **settings):
    """Return the outgoing over the incoming speed of a ball that falls by 0.4 m, by energy."""
    rows = states(ENGINE, scene, ["ball"], 120 / 180, **settings)[:, 0]
    heights, speeds = rows[:, 2] - 0.03, rows[:, 9]
    first = np.flatnonzero((speeds > 0.1) & (heights > 1e-3))[0]
    energy = speeds[first] ** 2 + 2.0 * G * heights[first]
    return np.sqrt(energy / (2.0 * G * 0.4))


def test_velocity_correction_of_penetrations_would_add_to_the_rebound():
    assert rebound(dropped_ball(Motion.FIXED, 0.5), split_impulse="none") > 0.55


def pushed_cube(friction):
    """A cube on a board, and a bar behind it that is driven."""
    return scene_of(
        solid("cube", Box(size_m=(0.05, 0.05, 0.05)), (0.0, 0.0, 0.025)),
        fixed_box("board", (0.0, 0.0, -0.01), (2.0, 2.0, 0.02)),
        driven_box("bar", (-0.035, 0.0, 0.025), (0.02, 0.12, 0.03)),
        contacts=(contact("cube", ("board", "bar"), friction=friction),),
    )


@pytest.mark.parametrize(("acceleration", "aside"), [(5.0, -0.15), (60.0, -1.2)])
def test_cube_that_a_bar_pushes_and_slips_along_moves_along_the_edge_of_the_friction_cone(
    acceleration, aside
):
    """While the bar slips, m (a, -mu a) is the bar's force less friction along the velocity (1, -mu)."""
    friction, step = 0.3, 1 / 180
    scene = pushed_cube(friction)
    place = np.array(scene.body("bar").pose.position_m)
    velocity = np.array([0.0, aside, 0.0])
    change = np.array([acceleration, 0.0, 0.0])
    turn, still = [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
    with closing(ENGINE.build(scene)) as simulation:
        for _ in range(9):
            target = np.r_[place, turn, velocity, still, change, still]
            simulation.drive("bar", target[None])
            simulation.advance(step)
            place = place + (velocity + 0.5 * change * step) * step
            velocity = velocity + change * step
        speed = simulation.body_states(["cube"])[0, 0, 7:9]
    assert speed[0] == pytest.approx(velocity[0], rel=0.002)
    assert speed[1] / speed[0] == pytest.approx(-friction, rel=0.005)


def test_gravity_does_not_move_a_driven_body_within_a_step():
    scene = scene_of(
        solid("cube", Box(size_m=(0.1, 0.1, 0.1)), (0.0, 0.0, 0.05)),
        driven_box("plate", (0.0, 0.0, -0.05), (0.1, 0.1, 0.1)),
        contacts=(contact("cube", "plate", friction=0.5),),
    )
    rows = states(ENGINE, scene, ["cube"], 1.0, timestep_s=1 / 180)
    # The plate would yield at g h = 54 mm/s, and the cube would sink until the correction of its depth is as fast.
    assert rows[-1, 0, 2] == pytest.approx(0.05, abs=2e-5)


ROPE = Rope(
    name="rope",
    pose=Pose(position_m=(0.0, 0.0, 1.0)),
    length_m=0.3,
    radius_m=0.002,
    mass_kg=0.01,
    young_modulus_pa=1e6,
)
LOW, HIGH = Region(axis="x", side="low"), Region(axis="x", side="high")


@pytest.mark.parametrize("held", ["low", "high"])
@pytest.mark.parametrize("order", [1, -1])
def test_bob_on_a_light_rope_is_a_pendulum(held, order):
    """The bob's centre is at the rope's length plus its radius from the fixed end; 3 % of the mass is the rope's."""
    fixed, free = (LOW, HIGH) if held == "low" else (HIGH, LOW)
    # The free end of the rope is 5 degrees off the lowest point.
    pitch = 85.0 if held == "low" else -85.0
    rope = replace(ROPE, pose=Pose.from_euler_deg((0.0, 0.0, 1.0), (0.0, pitch, 0.0)))
    down = rope.pose.rotation.apply([1.0 if held == "low" else -1.0, 0.0, 0.0])
    place = vector(np.array([0.0, 0.0, 1.0]) + 0.17 * down)
    attachments = (
        Attachment(deformable="rope", region=fixed, to="frame"),
        Attachment(deformable="rope", region=free, to="bob"),
    )
    scene = scene_of(
        ball("bob", place, radius_m=0.02, mass_kg=10.0),
        fixed_box("frame", (0.0, 0.0, 3.0), (0.1, 0.1, 0.1)),
        deformables=(rope,),
        attachments=attachments[::order],
    )
    with closing(ENGINE.build(scene)) as simulation:
        start, picked = simulation.nodes("rope")[0], [0, 13, -1]
        read = simulation.track("rope", start[picked])
        moved = []
        for _ in range(270):
            simulation.advance(1 / 180)
            moved.append(simulation.body_states(["bob"])[0, 0, 0])
        nodes, points = simulation.nodes("rope")[0], read()[0]
    line = np.linspace([-0.15, 0, 0], [0.15, 0, 0], 25)
    assert start == pytest.approx(rope.pose.to_world(line), abs=1e-9)
    assert points == pytest.approx(nodes[picked], abs=1e-9)
    length = np.linalg.norm(np.diff(nodes, axis=0), axis=1).sum()
    assert length == pytest.approx(0.3, rel=1e-9)
    moved = np.array(moved) + 0.15 * down[0]
    assert abs(moved[0]) == pytest.approx(0.32 * np.sin(np.radians(5.0)), rel=0.01)
    crossings = np.flatnonzero(np.diff(np.sign(moved)) != 0)
    assert len(crossings) >= 2
    half_period = np.pi * np.sqrt(0.32 / G)
    assert np.diff(crossings).mean() / 180 == pytest.approx(half_period, rel=0.01)


def test_attached_layers_of_foam_are_rows_of_cells():
    foam = SoftBody(
        name="foam",
        shape=Box(size_m=(0.05, 0.05, 0.2)),
        pose=Pose(position_m=(0.0, 0.0, 1.0)),
        mass_kg=0.05,
        young_modulus_pa=1e4,
        poisson_ratio=0.3,
    )
    region = Region(axis="z", side="low", depth_m=0.012)
    scene = scene_of(
        fixed_box("plate", (0.0, 0.0, 0.9), (0.06, 0.06, 0.01)),
        deformables=(foam,),
        attachments=(
            Attachment(deformable="foam", region=region, to="plate"),
            Attachment(
                deformable="foam", region=replace(region, side="high"), to="plate"
            ),
        ),
    )
    with closing(ENGINE.build(scene)) as simulation:
        heights = simulation.nodes("foam")[0, :, 2]
    # 11 cells of 16 mm between the attached layers.
    low = sorted({round(z, 9) for z in heights if z < 0.93})
    assert low == pytest.approx([0.9, 0.912, 0.928], abs=1e-9)
    assert np.count_nonzero(heights > 1.0879) == 32


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["FoamTwisting-soft", "FoamShearing-hard", "FoamCompressing-hard"]
)
def test_foam_of_the_benchmark_stays_bounded(name):
    assert run_episode(RunRequest(name, backend="pybullet")).outcome == "finished"


def test_pieces_of_a_solid_carry_a_ball_between_them():
    corners = np.array(list(product((0.0, 0.05), (-0.05, 0.05), (-0.02, 0.0))))
    pieces = tuple(
        tuple(map(tuple, (corners + np.array([shift, 0.0, 0.0])).tolist()))
        for shift in (-0.06, 0.01)
    )
    shape = ConvexUnion(pieces_m=pieces)
    # A ball of radius 30 mm sinks by 30 - sqrt(30^2 - 10^2) mm into a gap of 20 mm.
    place = (0.0, 0.0, 0.5 + float(np.sqrt(0.03**2 - 0.01**2)))
    scene = scene_of(
        ball("ball", place),
        solid("rails", shape, (0.0, 0.0, 0.5), motion=Motion.FIXED),
        contacts=(contact("ball", "rails", friction=0.5),),
    )
    end = states(ENGINE, scene, ["ball"], 0.5)[-1, 0]
    assert end[:3] == pytest.approx(place, abs=1e-4)


def test_out_of_box_is_the_engine_as_it_starts(monkeypatch):
    """The values of the preset are PyBullet's: a world to which they are not given moves as one to which they are."""
    scene = load_experiment("NonsmoothContact-1-wood").scene

    def without_parameters(model):
        model.client.setGravity(0.0, 0.0, -scene.gravity_m_per_s2)
        model.client.setPhysicsEngineParameter(
            fixedTimeStep=1 / 180, deterministicOverlappingPairs=1, enableFileCaching=0
        )

    def rollout(**changes):
        settings = {"preset": "out_of_box", **changes}
        return states(ENGINE, scene, ["pyramid"], 60 / 180, **settings)

    changes = [{}, {"reduced_coordinates": False}]
    given = [rollout(**one) for one in changes]
    differs = rollout(reduced_coordinates=False, warm_starting=0.85)
    monkeypatch.setattr(Model, "_set_parameters", without_parameters)
    for one, expected in zip(changes, given, strict=True):
        assert rollout(**one) == pytest.approx(expected, abs=1e-9)
    assert differs != pytest.approx(given[1], abs=1e-9)


def open_worlds():
    """Number of PyBullet's worlds in this process, of which it has room for 1024."""
    return sum(pybullet.isConnected(number) for number in range(1024))


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="no list of open files")
def test_closing_leaves_no_world_and_no_open_file_and_happens_once():
    scene = load_experiment("NonsmoothContact-1-wood").scene
    files = len(list(Path("/proc/self/fd").iterdir()))
    worlds = open_worlds()
    simulation = ENGINE.build(scene)
    assert open_worlds() == worlds + 1
    simulation.close()
    simulation.close()
    forgotten = ENGINE.build(scene)
    del forgotten
    assert open_worlds() == worlds
    assert len(list(Path("/proc/self/fd").iterdir())) == files


@pytest.mark.slow
def test_a_wall_stands():
    scene = load_experiment("WallBreaking-wood").scene
    bodies = tuple(one for one in scene.bodies if one.name != "ball")
    contacts = tuple(one for one in scene.contacts if "ball" not in one.first)
    calm = replace(scene, bodies=bodies, joints=(), contacts=contacts)
    names = [one.name for one in calm.dynamic_bodies]
    rows = states(ENGINE, calm, names, 0.5)[..., :3]
    assert np.linalg.norm(rows[-1] - rows[0], axis=1).max() < 1e-4


def test_a_body_beyond_the_plane_ends_the_episode():
    runs = replace(
        ball("ball", (7.5, 0.0, 0.03)), linear_velocity_m_per_s=(3.0, 0.0, 0.0)
    )
    touch = contact("ball", "ground", friction=0.5)
    with closing(
        ENGINE.build(scene_of(plane_deg(), runs, contacts=(touch,)))
    ) as simulation:
        assert simulation.diverged() == {}
        simulation.advance(0.5)
        assert "beyond the 8 m" in simulation.diverged()[0]


def test_springs_of_contacts_carry_and_throw_back_a_cube():
    """Four corners on springs: depth at rest m g / 4 k, and depth v sqrt(m / 4 k) of a fast impact."""
    stiffness, mass_kg, half_m = 1e4, 0.37, 0.0524
    upright = {"cube.euler_deg": (0.0, 0.0, 0.0), "cube.restitution": 0.0}

    def heights_m(start_m, damping, seconds):
        start = upright | {"cube.position_m": (0.0, 0.0, start_m)}
        scene = load_experiment("CubeToss-acrylic", start).scene
        settings = {
            "split_impulse": "none",
            "contact_stiffness_n_per_m": stiffness,
            "contact_damping_n_s_per_m": damping,
        }
        rows = states(
            ENGINE,
            scene,
            ["cube"],
            seconds,
            interval_s=1 / 900,
            **settings,
            drive_interval_s=1 / 900,
        )
        return rows[:, 0, 2]

    at_rest_m = half_m - heights_m(half_m, 30.0, 0.3)[-1]
    assert at_rest_m == pytest.approx(mass_kg * G / (4.0 * stiffness), rel=0.01)
    deepest_m = half_m - heights_m(half_m + 0.05, 1e-6, 0.15).min()
    speed = np.sqrt(2.0 * G * 0.05)
    # Bullet integrates the spring implicitly, which damps it by the ratio w h / 2. Gravity adds the depth at rest.
    rate = np.sqrt(4.0 * stiffness / mass_kg)
    closed_m = speed / rate * np.exp(-0.25 * np.pi * rate / 9000.0) + at_rest_m
    assert deepest_m == pytest.approx(closed_m, rel=0.01)


def test_checks_see_a_driven_body_that_bullet_does_not_move(monkeypatch):
    """The state of a driven body is Bullet's: one that gets no velocity falls, whatever its driver prescribes."""
    from gauge_envs.backends.pybullet import simulation

    for name in ("resetBasePositionAndOrientation", "resetBaseVelocity"):
        monkeypatch.setattr(simulation.pybullet, name, lambda *args, **named: None)
    results = list(run_checks("pybullet", only=["driven-*"]))
    assert [one.check for one in results if one.is_bad] == [
        "driven-velocity",
        "driven-path",
        "driven-slow",
    ]
    assert results[0].measured >= 99.0


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_foam_slides_by_the_law_one_margin_above_the_board(friction):
    middle, lean = 0.05 + 0.02 + SOFT_MARGIN_M, (0.0, 30.0, 0.0)
    slope = Pose.from_euler_deg((0.0, 0.0, 0.0), lean).rotation
    foam = SoftBody(
        name="foam",
        shape=Box(size_m=(0.04, 0.04, 0.04)),
        pose=Pose.from_rotation(vector(slope.apply([0.0, 0.0, middle])), slope),
        mass_kg=0.0064,
        young_modulus_pa=1e4,
        poisson_ratio=0.3,
    )
    scene = scene_of(
        fixed_box("board", (0.0, 0.0, 0.0), (2.0, 0.5, 0.1), euler_deg=lean),
        deformables=(foam,),
        contacts=(contact("foam", "board", friction=friction),),
    )
    places = []
    with closing(ENGINE.build(scene)) as simulation:
        for _ in range(60):
            simulation.advance(1 / 180)
            centre = simulation.nodes("foam")[0].mean(axis=0)
            places.append(slope.apply(centre, inverse=True))
    down, _, up = np.transpose(places)
    found = 2.0 * np.polyfit(np.arange(40) / 180, down[20:], 2)[0]
    assert found == pytest.approx(G * (0.5 - friction * np.sqrt(0.75)), rel=1e-3)
    assert up[-1] == pytest.approx(middle, abs=1e-4)


def test_a_free_rope_falls():
    with closing(ENGINE.build(scene_of(deformables=(ROPE,)))) as simulation:
        start = simulation.nodes("rope")
        simulation.advance(0.2)
        fallen = simulation.nodes("rope") - start
    expected = np.broadcast_to([0.0, 0.0, -0.5 * G * 0.2**2], start.shape)
    assert fallen == pytest.approx(expected, abs=2e-4)
