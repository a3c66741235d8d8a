"""Laws and contract of the PhysX backend, against closed forms."""

from contextlib import closing

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("sapien")

from rigid import plane_deg, scene_of, solid, states

from gauge_envs.backends import backend
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Box,
    ConvexUnion,
    Cylinder,
    Hinge,
    Motion,
    Pose,
)
from gauge_envs.scene.meshes import prism
from gauge_envs.tools.bench.parts import ball, contact
from gauge_envs.tools.conformance import run_checks

PHYSX = backend("physx")


@pytest.mark.parametrize("restitution", [0.3, 0.577, 0.9])
def test_rebounds_have_the_restitution_and_the_bias_of_a_step(restitution):
    """PhysX adds the speed g h of one more step of gravity to the speed of approach."""
    touch = contact("ball", "ground", friction=0.8, restitution=restitution)
    scene = scene_of(ball("ball", (0, 0, 0.33)), plane_deg(), contacts=(touch,))
    rows = states(PHYSX, scene, ["ball"], 2.0)[:, 0]
    energy = 0.5 * rows[:, 9] ** 2 + GRAVITY_M_PER_S2 * (rows[:, 2] - 0.03)
    tops = np.flatnonzero((rows[:-1, 9] > 0) & (rows[1:, 9] <= 0))
    speeds = np.sqrt(2.0 * np.array([GRAVITY_M_PER_S2 * 0.3, *energy[tops]][:4]))
    assert len(speeds) == 4
    assert speeds[1] / speeds[0] == pytest.approx(restitution, rel=0.01)
    biased = restitution * (speeds[:-1] + GRAVITY_M_PER_S2 / 1800)
    assert speeds[1:] == pytest.approx(biased, rel=0.01)


def rolling_share(length_m):
    """Way of a cylinder of 30 mm radius that rolls down 20 degrees for 0.6 s, over that of the law."""
    lean = Rotation.from_euler("y", 20, degrees=True)
    place = tuple((0.03 * lean.apply([0, 0, 1.0])).tolist())
    pose = Pose.from_rotation(place, lean * Rotation.from_euler("x", 90, degrees=True))
    roller = solid("roller", Cylinder(radius_m=0.03, length_m=length_m), pose=pose)
    touch = contact("roller", "ground", friction=0.5)
    scene = scene_of(roller, plane_deg(20.0), contacts=(touch,))
    rows = states(PHYSX, scene, ["roller"], 0.6)[:, 0]
    along = rows[:, :3] @ lean.apply([1.0, 0.0, 0.0])
    law = 2.0 / 3.0 * GRAVITY_M_PER_S2 * np.sin(np.radians(20))
    return 2.0 * (along[-1] - along[0]) / 0.6**2 / law


def test_long_cylinders_roll_and_short_ones_are_prisms():
    """docs/engines/physx.md states what a cylinder that is shorter than its diameter loses."""
    assert rolling_share(0.08) == pytest.approx(1.0, abs=0.001)
    assert rolling_share(0.06) == pytest.approx(1.0, abs=0.005)
    assert rolling_share(0.04) == pytest.approx(0.952, abs=0.005)


def test_a_cube_that_spins_on_its_face_is_braked_at_its_corners():
    """docs/engines/physx.md: 1.8 times the torque of an even pressure, 0.383 mu m g a."""
    edge, mass, friction = 0.05, 0.1, 0.2
    spin = (0.0, 0.0, 20.0)
    cube = solid(
        "cube",
        Box(size_m=(edge,) * 3),
        (0, 0, edge / 2),
        mass_kg=mass,
        angular_velocity_rad_per_s=spin,
    )
    touch = contact("cube", "ground", friction=friction)
    scene = scene_of(cube, plane_deg(), contacts=(touch,))
    rows = states(PHYSX, scene, ["cube"], 0.05)[:, 0]
    torque = mass * edge**2 / 6.0 * 180.0 * np.diff(rows[:, 12]).mean()
    share = -torque / (friction * mass * GRAVITY_M_PER_S2 * edge)
    assert share == pytest.approx(0.5**0.5, rel=0.02)


def test_a_hinge_without_an_articulation_swings_with_the_period_of_the_pendulum():
    """The conformance checks swing the default, an articulation."""
    bob = ball("bob", (0.02, 0, 0.8), radius_m=0.02)
    length = float(np.hypot(0.02, 0.2))
    hinge = Hinge(body="bob", anchor_m=(0, 0, 1), axis=(0, 1, 0))
    scene = scene_of(bob, joints=(hinge,), seconds=8)
    rows = states(PHYSX, scene, ["bob"], 8.0, hinges="joint")[:, 0]
    assert np.hypot(rows[:, 0], rows[:, 2] - 1.0) == pytest.approx(length, abs=2e-6)
    up = np.flatnonzero((rows[:-1, 0] < 0) & (rows[1:, 0] >= 0))
    crossings = (up - rows[up, 0] / (rows[up + 1, 0] - rows[up, 0])) / 180
    amplitude = np.arctan2(0.02, 0.2)
    arm_m = (length**2 + 0.4 * 0.02**2) / length
    law = 2 * np.pi * np.sqrt(arm_m / GRAVITY_M_PER_S2) * (1 + amplitude**2 / 16)
    assert np.diff(crossings).mean() == pytest.approx(law, rel=2e-4)


def test_thin_and_round_pieces_keep_their_vertices():
    """PhysX leaves out vertices within 0.7 mm of a plane of others, if it makes the mesh in metres."""
    corners = ((0, 0, 0), (0.2, 0, 0), (0, 0.2, 0), (0.1, 0.1, 0.0005), (0, 0, 0.0005))
    bodies = (
        solid("sliver", ConvexUnion(pieces_m=(corners,)), (0, 0, 1)),
        solid("plate", prism(Cylinder(radius_m=0.15, length_m=0.01)), (0, 0, 1)),
    )
    touch = contact(("sliver", "plate"), "ground", friction=0.3)
    with closing(
        PHYSX.build(scene_of(*bodies, plane_deg(), contacts=(touch,)))
    ) as simulation:
        for one in bodies:
            component = simulation._model.parts[one.name].component
            (shape,) = component.collision_shapes
            apart = (
                np.asarray(one.shape.pieces_m[0])[:, None]
                - shape.vertices * shape.scale
            )
            assert np.linalg.norm(apart, axis=2).min(axis=1).max() < 1e-7


def turned_deg(plate, *, acceleration, **settings):
    """Return by how much a cube has turned after 0.1 s on a plate that accelerates along x [degrees]."""
    edge = Box(size_m=(0.05, 0.05, 0.05))
    cube = solid("cube", edge, (0, -0.075, 0.025), mass_kg=0.09)
    support = solid("plate", plate, (0, 0, -0.01), motion=Motion.KINEMATIC)
    touch = contact("cube", "plate", friction=0.38)
    scene = scene_of(cube, support, contacts=(touch,))
    target = np.zeros((1, 19))
    target[0, 2:4] = -0.01, 1.0
    target[0, 13] = acceleration
    with closing(PHYSX.build(scene, settings)) as simulation:
        for sample in range(18):
            time_s = sample / 180
            target[0, 0] = 0.5 * acceleration * time_s**2
            target[0, 7] = acceleration * time_s
            simulation.drive("plate", target)
            simulation.advance(1 / 180)
        quaternion = simulation.body_states(["cube"])[0, 0, 3:7]
    turn = Rotation.from_quat(quaternion, scalar_first=True).as_rotvec()
    return abs(float(np.degrees(turn[2])))


def test_persistent_contacts_turn_a_cube_that_slides_on_a_convex_mesh():
    """Pressure and friction are symmetric about the line of motion: a cube must not turn. It slips above 3.7 m/s^2."""
    disc, slab = Cylinder(radius_m=0.15, length_m=0.02), Box(size_m=(0.3, 0.3, 0.02))
    assert turned_deg(disc, acceleration=3.0) < 1e-3
    assert turned_deg(slab, acceleration=4.2) < 1e-2
    assert turned_deg(disc, acceleration=4.2, persistent_manifolds=False) < 1e-2
    assert turned_deg(disc, acceleration=4.2) > 0.1


def test_checks_see_a_driven_body_that_physx_does_not_move(monkeypatch):
    """The state of a driven body is PhysX's: one that gets no targets stands still, whatever its driver prescribes."""
    from gauge_envs.backends.physx import simulation
    from gauge_envs.backends.physx.model import physx

    monkeypatch.setattr(
        physx.PhysxRigidDynamicComponent,
        "set_kinematic_target",
        lambda self, pose: None,
    )
    monkeypatch.setattr(simulation, "SAME_POSE", np.inf)
    results = list(run_checks(PHYSX, only=["driven-*"]))
    assert [one.check for one in results if one.is_bad] == [
        "driven-velocity",
        "driven-path",
        "driven-slow",
    ]
    assert results[0].measured >= 99.0
