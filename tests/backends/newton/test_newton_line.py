"""Ropes and rods in Newton's vertex block descent against closed forms: stretch, swing, bending, friction."""

from __future__ import annotations

from dataclasses import replace
from math import cos, pi, sin

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_bvp, solve_ivp
from scipy.spatial.transform import Rotation

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.backends.base import Simulation, World
from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.errors import ShapeError, UnsupportedSceneError
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Attachment,
    Box,
    Contact,
    ContactMode,
    Motion,
    Pose,
    Region,
    RigidBody,
    Rod,
    Rope,
    Scene,
    Sphere,
)
from gauge_envs.scene.driver_path import DriverPath
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S

newton = pytest.importorskip("newton")
wp = pytest.importorskip("warp")

from gauge_envs.backends.newton.line import add_line  # noqa: E402
from gauge_envs.backends.newton.settings import ROD_SEGMENTS, SettingsLines  # noqa: E402
from gauge_envs.backends.newton.vbd import StepperVBD  # noqa: E402

ROPE_M, ROPE_RADIUS_M, ROPE_KG = 0.34, 0.002, 0.005
BALL_KG, BALL_M = 0.3122, 0.03
ROD_M, ROD_RADIUS_M, ROD_KG = 0.15, 0.005, 0.0149
SOFT_PA, HARD_PA = 9285115.0, 1e9
TOP = Pose(position_m=(0.0, 0.0, 0.0))
QUICK = {"timestep_s": 1 / 3600, "cell_m": 0.02, "rope_strain": 2e-3}
"""Settings of ropes in tests."""


def rope(
    direction: tuple[float, float, float] = (1.0, 0.0, 0.0), *, start: bool = True
) -> Rope:
    """A rope along a direction, with its low end or its middle at the origin."""
    turn = Rotation.align_vectors([direction], [[1.0, 0.0, 0.0]])[0]
    w, x, y, z = turn.as_quat(scalar_first=True).tolist()
    middle = tuple(
        (0.5 * ROPE_M * np.array(direction) if start else np.zeros(3)).tolist()
    )
    return Rope(
        name="rope",
        pose=Pose(position_m=middle, quaternion=(w, x, y, z)),
        length_m=ROPE_M,
        radius_m=ROPE_RADIUS_M,
        mass_kg=ROPE_KG,
        young_modulus_pa=795.0,
    )


def rod(young_pa: float = SOFT_PA, *, length_m: float = ROD_M) -> Rod:
    """A rod that hangs from the origin by its high end."""
    return Rod(
        name="rod",
        pose=Pose(position_m=(0.0, 0.0, -0.5 * length_m)),
        length_m=length_m,
        radius_m=ROD_RADIUS_M,
        mass_kg=ROD_KG,
        young_modulus_pa=young_pa,
        poisson_ratio=0.49,
    )


def holder(motion: Motion = Motion.FIXED) -> RigidBody:
    return RigidBody(
        name="top",
        shape=Box(size_m=(0.05, 0.05, 0.05)),
        motion=motion,
        pose=TOP,
        mass_kg=1.0,
    )


def ball(name: str, place_m: NDArray[np.float64]) -> RigidBody:
    pose = Pose(position_m=tuple(place_m.tolist()))
    return RigidBody(
        name=name,
        shape=Sphere(radius_m=BALL_M),
        motion=Motion.DYNAMIC,
        pose=pose,
        mass_kg=BALL_KG,
    )


def ball_on_rope(
    direction: tuple[float, float, float], motion: Motion = Motion.FIXED
) -> Scene:
    return Scene(
        bodies=(holder(motion), ball("ball", (ROPE_M + BALL_M) * np.array(direction))),
        deformables=(rope(direction),),
        attachments=(
            Attachment(
                deformable="rope", region=Region(axis="x", side="low"), to="top"
            ),
            Attachment(
                deformable="rope", region=Region(axis="x", side="high"), to="ball"
            ),
        ),
        duration_s=1.0,
    )


def build(scene: Scene, **settings: object) -> Simulation:
    simulation = backend("newton").build(scene, settings)
    simulation.reset(0)
    return simulation


def run(
    world: World, advance, scene: Scene, samples: int, name: str
) -> NDArray[np.float64]:
    """Nodes of a line after each interval, driven as the scene says, shape [samples, node_count, 3]."""
    paths = [DriverPath(driver, scene, samples // 6 + 2) for driver in scene.drivers]
    nodes = []
    for sample in range(samples):
        for path in paths:
            world.drive(path.body, *path.interval(sample, np.zeros(path.motion_count)))
        advance(SAMPLE_INTERVAL_S)
        nodes.append(world.nodes(name))
    return np.array(nodes)


def strain(nodes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Length of a rope over its own, less one."""
    return np.linalg.norm(np.diff(nodes, axis=-2), axis=-1).sum(axis=-1) / ROPE_M - 1.0


# --- rope ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_rope_carries_a_ball() -> None:
    """Its springs bounce about the length that the load asks for; at a held end they are twice as stiff."""
    scene = ball_on_rope((0.0, 0.0, -1.0))
    simulation = build(scene, **QUICK)
    assert np.linalg.norm(
        np.diff(simulation.nodes("rope"), axis=0), axis=1
    ) == pytest.approx(0.02, abs=1e-7)
    strains = strain(run(simulation, simulation.advance, scene, 60, "rope"))
    static = QUICK["rope_strain"]
    assert strains.min() > 0.0
    assert strains.max() < 2.1 * static
    assert strains.mean() == pytest.approx(static, rel=0.2)
    low = simulation.body_states(["ball"])[0, :3]
    assert simulation.nodes("rope")[-1] == pytest.approx(
        low + np.array([0.0, 0.0, BALL_M]), abs=1e-4
    )


def test_ball_swings_from_level_like_a_pendulum() -> None:
    scene = ball_on_rope((1.0, 0.0, 0.0))
    simulation = build(scene, **QUICK)
    strains = strain(run(simulation, simulation.advance, scene, 54, "rope"))
    assert np.abs(strains).max() < 6e-3
    fall = solve_ivp(
        lambda _, s: [s[1], GRAVITY_M_PER_S2 / (ROPE_M + BALL_M) * cos(s[0])],
        (0.0, 0.3),
        [0.0, 0.0],
        rtol=1e-9,
    )
    angle = fall.y[0, -1]
    expected = (ROPE_M + BALL_M) * np.array([cos(angle), 0.0, -sin(angle)])
    state = simulation.body_states(["ball"])[0]
    assert state[:3] == pytest.approx(expected, abs=4e-3)
    assert np.linalg.norm(state[7:10]) == pytest.approx(
        (ROPE_M + BALL_M) * fall.y[1, -1], rel=0.02
    )


@pytest.mark.slow
def test_rope_follows_a_driven_body() -> None:
    simulation = build(ball_on_rope((0.0, 0.0, -1.0), Motion.KINEMATIC), **QUICK)
    for index in range(36):
        pose = Pose(position_m=(0.0, 0.0, 1e-3 * index))
        simulation.drive(
            "top", pose, np.array([0.0, 0.0, 0.18, 0.0, 0.0, 0.0]), np.zeros(6)
        )
        simulation.advance(SAMPLE_INTERVAL_S)
    # The node is half way along the spring at the end, which the ball's weight stretches by 15 micrometres.
    assert simulation.nodes("rope")[0] == pytest.approx([0.0, 0.0, 0.036], abs=3e-5)
    assert simulation.body_states(["ball"])[0, 2] == pytest.approx(
        0.036 - ROPE_M - BALL_M, abs=2e-3
    )


@pytest.mark.slow
def test_two_balls_hang_over_a_beam() -> None:
    scene = load_experiment("RopeWinding-rubber").scene
    names = ("ball-1", "ball-2", "beam")
    scene = replace(
        scene,
        bodies=tuple(body for body in scene.bodies if body.name in names),
        contacts=tuple(
            c for c in scene.contacts if (c.first, c.second) == (("rope",), ("beam",))
        ),
        drivers=(),
    )
    simulation = build(scene)
    nodes = run(simulation, simulation.advance, scene, 72, "rope")
    assert np.abs(strain(nodes)).max() < 5e-3
    middle = np.array(scene.body("beam").pose.position_m)
    assert (nodes[:, [0, -1], 2].max(axis=1) - middle[2]).min() < -0.13
    # Segments touch the beam, so that a node between two of them stands off by up to 2.5 mm.
    assert 0.0068 < np.linalg.norm((nodes[-1, 17] - middle)[[0, 2]]) < 0.0097
    energy = sum(
        BALL_KG
        * (
            0.5 * np.square(state[7:10]).sum()
            + GRAVITY_M_PER_S2 * (state[2] - scene.body(name).pose.position_m[2])
        )
        for name, state in zip(
            names[:2], simulation.body_states(names[:2]), strict=True
        )
    )
    assert -0.15 < energy < 1e-3


# --- rod -------------------------------------------------------------------------------------------------------------


class Bench:
    """A rod that hangs from the origin without weight, loaded at its low end."""

    def __init__(
        self, young_pa: float, motion: Motion, *, damping_s: float, depth_m: float = 0.0
    ) -> None:
        builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
        top = -1
        if motion is Motion.KINEMATIC:
            top = builder.add_body(
                is_kinematic=True, mass=1.0, inertia=wp.mat33(np.eye(3))
            )
        grip = RigidAttachment(
            region=Region(axis="z", side="high", depth_m=depth_m),
            body="top",
            motion=motion,
            pose=TOP,
        )
        body = replace(rod(young_pa), length_m=ROD_M + depth_m)
        body = replace(body, pose=Pose(position_m=(0.0, 0.0, 0.5 * (depth_m - ROD_M))))
        settings = SettingsLines(
            preset="bench", timestep_s=1 / 3600, rod_damping_s=damping_s
        )
        self.part = add_line(
            builder, body, attachments=[grip], bodies={"top": top}, settings=settings
        )
        builder.color()
        self.builder = builder
        model = builder.finalize(device="cpu")
        driven = [top] if top >= 0 else []
        self.stepper = StepperVBD(model, driven=driven, settings=settings)
        self.stepper.record()

    def load(self, force_n: float, seconds: float) -> NDArray[np.float64]:
        """Nodes after a force has pulled the free end along x for a while."""
        half = 0.5 * ROD_M / len(self.part.segments)
        for _ in range(round(180 * seconds)):
            pose = self.stepper.now.body_q.numpy()[self.part.segments[0]]
            arm = Rotation.from_quat(pose[3:]).apply([0.0, 0.0, -half])
            wrench = np.zeros((self.builder.body_count, 6), dtype=np.float32)
            wrench[self.part.segments[0]] = [
                force_n,
                0.0,
                0.0,
                *np.cross(arm, [force_n, 0.0, 0.0]),
            ]
            for state in self.stepper._states:
                state.body_f.assign(wrench)
            self.stepper.advance(1 / 180)
        return self.part.nodes(self.stepper.now)


def test_segments_have_the_mass_and_inertia_of_their_pieces() -> None:
    bench = Bench(SOFT_PA, Motion.FIXED, damping_s=0.0, depth_m=0.03)
    masses = np.array(bench.builder.body_mass)
    assert masses == pytest.approx(ROD_KG * ROD_M / (ROD_M + 0.03) / 8)
    length = ROD_M / 8
    inertia = np.array(bench.builder.body_inertia[0]).reshape(3, 3)
    across = (3 * ROD_RADIUS_M**2 + length**2) / 12
    assert np.diag(inertia) == pytest.approx(
        masses[0] * np.array([across, across, 0.5 * ROD_RADIUS_M**2])
    )
    # The tip in the grip is a node, too.
    assert bench.part.rest_m[:, 2] == pytest.approx(
        [*np.linspace(-ROD_M, 0.0, 9), 0.03]
    )
    assert bench.part.nodes(bench.stepper.now) == pytest.approx(
        bench.part.rest_m, abs=1e-8
    )
    assert bench.part.pins == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("young_pa", "motion", "damping_s", "slack"),
    [
        (SOFT_PA, Motion.KINEMATIC, 0.04, 0.0),
        # The springs across give way by 8.5 F / k, which is 2 % of a stiff rod's deflection.
        (HARD_PA, Motion.FIXED, 0.002, 8.5 / 2e5),
    ],
)
def test_clamped_rod_bends_as_theory_says(
    young_pa: float, motion: Motion, damping_s: float, slack: float
) -> None:
    rigidity = young_pa * pi / 4 * ROD_RADIUS_M**4
    force = 3e-3 * rigidity / ROD_M**3
    bench = Bench(young_pa, motion, damping_s=damping_s)
    nodes = bench.load(force, 0.45 if young_pa == SOFT_PA else 0.1)
    # The sum over eight hinges in place of the integral.
    assert nodes[0, 0] == pytest.approx(1e-3 * (1 + 1 / 128) + slack * force, rel=0.004)
    assert nodes[-1] == pytest.approx(np.zeros(3), abs=2e-5)


@pytest.mark.slow
def test_large_deflection_is_the_elastica() -> None:
    solution = solve_bvp(
        lambda s, y: np.array([y[1], -2.5 * np.cos(y[0])]),
        lambda a, b: np.array([a[0], b[1]]),
        np.linspace(0, 1, 50),
        np.zeros((2, 50)),
        tol=1e-8,
    )
    s = np.linspace(0, 1, 1001)
    across = np.trapezoid(np.sin(solution.sol(s)[0]), s) * ROD_M
    rigidity = SOFT_PA * pi / 4 * ROD_RADIUS_M**4
    bench = Bench(SOFT_PA, Motion.FIXED, damping_s=0.02)
    nodes = bench.load(2.5 * rigidity / ROD_M**2, 1.5)
    assert nodes[0, 0] == pytest.approx(across, rel=0.01)


@pytest.mark.slow
def test_points_on_the_surface_turn_with_the_rod() -> None:
    bench = Bench(SOFT_PA, Motion.FIXED, damping_s=0.02)
    rest = np.array([[0.005, 0.0, -0.14], [0.0, 0.0, -0.14], [0.0, -0.005, -0.05]])
    read = bench.part.track(rest)
    assert read(bench.stepper.now) == pytest.approx(rest, abs=1e-8)
    nodes = bench.load(SOFT_PA * pi / 4 * ROD_RADIUS_M**4 / ROD_M**2, 0.3)
    surface, centre, other = read(bench.stepper.now)
    tangent = nodes[0] - nodes[1]
    assert np.linalg.norm(tangent[:2]) > 0.1 * np.linalg.norm(tangent)
    assert np.linalg.norm(surface - centre) == pytest.approx(0.005)
    # Half way between nodes the line turns half as much as there.
    assert (surface - centre) @ tangent / np.linalg.norm(tangent) == pytest.approx(
        0.0, abs=1e-4
    )
    assert other[1] == pytest.approx(-0.005, abs=1e-6)
    with pytest.raises(ShapeError, match="beyond an end"):
        bench.part.track(np.array([[0.0, 0.0, -0.2]]))


def sliding_lag_m(scene: Scene, *, contact_n_per_m: float, stretch_n: float) -> float:
    """How far the foot of a rod stays behind its base in steady sliding, with a rounded foot that just touches.

    The planar elastica that stretches, under its weight, the board's force and friction.
    """
    body, contact = scene.deformables[0], scene.contacts[0]
    assert isinstance(body, Rod)
    rigidity = body.young_modulus_pa * pi / 4 * body.radius_m**4
    weight = body.mass_kg * GRAVITY_M_PER_S2 / body.length_m

    def slopes(s, y, unknown):
        angle, moment, _, _ = y
        # Force of what is below a section on what is above it.
        along_x = -contact.friction * unknown[0] * np.ones_like(s)
        along_z = unknown[0] - weight * (body.length_m - s)
        x, z = np.sin(angle), -np.cos(angle)
        stretch = 1 + (along_x * x + along_z * z) / stretch_n
        return np.array(
            [
                moment / rigidity,
                stretch * (z * along_x - x * along_z),
                stretch * x,
                stretch * z,
            ]
        )

    def ends(top, foot, unknown):
        height = (
            body.radius_m * (1 - np.cos(foot[0]))
            - unknown[0] / contact_n_per_m
            - body.length_m
        )
        return np.array([top[0], top[2], top[3], foot[1], foot[3] - height])

    s = np.linspace(0, body.length_m, 201)
    start = np.array([-0.01 * s / body.length_m, 0 * s, 0 * s, -s])
    solution = solve_bvp(slopes, ends, s, start, p=[0.01], tol=1e-10, max_nodes=20000)
    assert solution.status == 0
    return float(-solution.y[2, -1])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["soft", "hard"])
def test_foot_that_slides_stays_behind_as_friction_and_elasticity_say(
    name: str,
) -> None:
    """The rod's own weight stretches it by 15 micrometres, and presses the foot on the board until it bends."""
    scene = load_experiment(f"StickStack-{name}").scene
    simulation = build(scene)
    settings = simulation.settings
    nodes = run(simulation, simulation.advance, scene, 180, "rod")
    lag = nodes[:, -1, 0] - nodes[:, 0, 0]
    segment = ROD_M / ROD_SEGMENTS
    body = scene.deformables[0]
    assert isinstance(body, Rod)
    expected = sliding_lag_m(
        scene,
        contact_n_per_m=body.mass_kg * GRAVITY_M_PER_S2 / settings["contact_depth_m"],
        stretch_n=min(
            body.young_modulus_pa * pi * ROD_RADIUS_M**2,
            settings["rod_joint_stiffness_n_per_m"] * segment,
        ),
    )
    # Stiff: springs across give way by 2 %, and that the last half segment is rigid adds 7 % to the force.
    assert lag[-45:].mean() == pytest.approx(
        expected, rel=0.02 if name == "soft" else 0.11
    )
    assert lag[-45:].std() < 0.005 * expected + 1e-6
    assert np.abs(nodes[:, :, 1] - body.pose.position_m[1]).max() < 1e-6
    marker = simulation.track("rod", np.array(scene.markers.positions_m))()
    assert np.abs(marker[:, 1] - (body.pose.position_m[1] - ROD_RADIUS_M)).max() < 1e-6


# --- contacts, attachments, worlds ------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_rope_slides_down_a_slope(friction: float) -> None:
    angle = np.radians(30.0)
    slope = Pose.from_euler_deg((0.0, 0.0, 0.0), (0.0, 30.0, 0.0))
    top = slope.to_world(np.array([0.0, 0.0, -0.05]))
    board = RigidBody(
        name="board",
        shape=Box(size_m=(2.0, 0.2, 0.1)),
        motion=Motion.FIXED,
        pose=replace(slope, position_m=tuple(top.tolist())),
        mass_kg=0.0,
    )
    middle = slope.to_world(np.array([0.0, 0.0, ROPE_RADIUS_M]))
    line = replace(rope(), pose=replace(slope, position_m=tuple(middle.tolist())))
    contact = Contact(
        first=("rope",), second=("board",), friction=friction, restitution=0.0
    )
    scene = Scene(
        bodies=(board,), deformables=(line,), contacts=(contact,), duration_s=0.3
    )
    simulation = build(scene, **QUICK)
    before = simulation.nodes("rope").mean(axis=0)
    run(simulation, simulation.advance, scene, 54, "rope")
    way = slope.rotation.apply(
        simulation.nodes("rope").mean(axis=0) - before, inverse=True
    )
    expected = (
        0.5 * GRAVITY_M_PER_S2 * (np.sin(angle) - friction * np.cos(angle)) * 0.3**2
    )
    assert way == pytest.approx([expected, 0.0, 0.0], abs=0.005 * expected)


@pytest.mark.slow
def test_a_lines_course_repeats_bit_for_bit() -> None:
    scene = load_experiment("StickStack-soft").scene
    simulation = build(scene)
    first = run(simulation, simulation.advance, scene, 6, "rod")
    state = simulation.state()
    simulation.advance(SAMPLE_INTERVAL_S)
    later = simulation.nodes("rod")
    simulation.restore(state)
    assert np.array_equal(simulation.nodes("rod"), first[-1])
    simulation.advance(SAMPLE_INTERVAL_S)
    assert np.array_equal(simulation.nodes("rod"), later)
    simulation.reset(0)
    assert np.array_equal(run(simulation, simulation.advance, scene, 6, "rod"), first)


@pytest.mark.slow
def test_worlds_are_as_single_ones() -> None:
    scene = load_experiment("StickStack-soft").scene
    lower = replace(
        scene.deformables[0], pose=Pose(position_m=(0.26265, 0.41963, 0.08915))
    )
    base = replace(scene.bodies[0], pose=Pose(position_m=(0.26265, 0.41963, 0.17615)))
    other = replace(scene, deformables=(lower,), bodies=(base, *scene.bodies[1:]))
    single = []
    for each in (scene, other):
        simulation = build(each)
        single.append(run(simulation, simulation.advance, each, 2, "rod")[-1])
    worlds = backend("newton").build_worlds([scene, other])
    worlds.reset(0)
    for sample in range(2):
        for world, each in zip(worlds.worlds, (scene, other), strict=True):
            path = DriverPath(each.drivers[0], each, 2)
            world.drive(path.body, *path.interval(sample, np.zeros(path.motion_count)))
        worlds.advance(SAMPLE_INTERVAL_S)
    for world, nodes in zip(worlds.worlds, single, strict=True):
        assert world.nodes("rod") == pytest.approx(nodes, abs=1e-8)


@pytest.mark.slow
def test_presets_are_for_lines_or_not() -> None:
    scene = load_experiment("StickStack-soft").scene
    settings = build(scene).settings
    assert (settings["preset"], settings["solver"], settings["cell_m"]) == (
        "rod",
        "SolverVBD",
        None,
    )
    assert len(build(scene).nodes("rod")) == ROD_SEGMENTS + 1
    for preset in ("cloth", "mpm", "rigid"):
        with pytest.raises(UnsupportedSceneError, match=preset):
            backend("newton").build(scene, {"preset": preset})
    with pytest.raises(UnsupportedSceneError, match="rope"):
        backend("newton").build(
            load_experiment("SlopeSlider-2-wood").scene, {"preset": "rope"}
        )


def test_what_cannot_be_built_is_named() -> None:
    engine = backend("newton")
    missing = " ".join(
        engine.supports(load_experiment("RopeWinding-rubber").scene).missing
    )
    assert (
        "'ball-1' rebounds from 'billiard'" in missing and "geometric mean" in missing
    )
    scene = ball_on_rope((1.0, 0.0, 0.0))
    region = Region(axis="x", side="low", depth_m=0.1)
    cases = [
        (
            replace(scene, attachments=(replace(scene.attachments[0], region=region),)),
            "over a length",
        ),
        (
            replace(
                scene,
                attachments=(
                    replace(scene.attachments[0], region=Region(axis="y", side="low")),
                ),
            ),
            "elsewhere",
        ),
        (replace(scene, deformables=(rope(), rod())), ""),
        (
            replace(
                scene,
                contacts=(
                    Contact(
                        first=("rope",),
                        second=("ball",),
                        friction=0.3,
                        restitution=0.5,
                        mode=ContactMode.IMPACT,
                    ),
                ),
            ),
            "no restitution",
        ),
        (
            replace(
                scene,
                deformables=(rope(), rod()),
                attachments=(
                    Attachment(
                        deformable="rod",
                        region=Region(axis="z", side="high"),
                        to="rope",
                    ),
                ),
            ),
            "not a rigid body",
        ),
        (
            replace(
                scene,
                deformables=(
                    rope(),
                    *load_experiment("FoamStretching-soft").scene.deformables,
                ),
            ),
            "with rigid bodies only",
        ),
    ]
    for each, message in cases:
        support = engine.supports(each)
        assert bool(support) == (not message)
        assert message in " ".join(support.missing)
    with pytest.raises(UnsupportedSceneError, match="over all"):
        attachment = RigidAttachment(
            region=Region(axis="z", side="high", depth_m=ROD_M),
            body="top",
            motion=Motion.FIXED,
            pose=TOP,
        )
        add_line(
            newton.ModelBuilder(),
            rod(),
            attachments=[attachment],
            bodies={"top": -1},
            settings=SettingsLines(preset="bench", timestep_s=1 / 3600),
        )
