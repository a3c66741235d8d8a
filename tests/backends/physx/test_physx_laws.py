"""Laws and contract of the PhysX backend, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("sapien")

from straight import fitted_acceleration

from gauge_envs.backends import backend
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Box,
    Contact,
    ContactMode,
    ConvexUnion,
    Cylinder,
    Hinge,
    Motion,
    Plane,
    Pose,
    RigidBody,
    Scene,
    Shape,
    Sphere,
)
from gauge_envs.scene.meshes import prism
from gauge_envs.tools.conformance import run_checks

PHYSX = backend("physx")


def fixed(name: str, shape: Shape, pose: Pose) -> RigidBody:
    return RigidBody(
        name=name,
        shape=shape,
        motion=Motion.FIXED,
        pose=pose,
        mass_kg=0.0 if shape.kind == "plane" else 1,
    )


def states(
    scene: Scene, names: list[str], seconds: float, **settings: object
) -> np.ndarray:
    """States at 180 Hz, shape [sample_count, len(names), 13]."""
    simulation = PHYSX.build(scene, settings)
    rows = [simulation.body_states(names)]
    for _ in range(round(180 * seconds)):
        simulation.advance(1 / 180)
        rows.append(simulation.body_states(names))
    simulation.close()
    return np.array(rows)


@pytest.mark.parametrize("restitution", [0.3, 0.577, 0.9])
def test_rebounds_have_the_restitution_and_the_bias_of_a_step(
    restitution: float,
) -> None:
    """PhysX adds the speed g h of one more step of gravity to the speed of approach."""
    pose = Pose(position_m=(0, 0, 0.33))
    ball = RigidBody(
        name="ball",
        shape=Sphere(radius_m=0.03),
        motion=Motion.DYNAMIC,
        pose=pose,
        mass_kg=0.1,
    )
    contact = Contact(
        first=("ball",),
        second=("ground",),
        friction=0.8,
        restitution=restitution,
        mode=ContactMode.IMPACT,
    )
    ground = fixed("ground", Plane(), Pose(position_m=(0, 0, 0)))
    rows = states(
        Scene(bodies=(ball, ground), contacts=(contact,), duration_s=2.0), ["ball"], 2.0
    )[:, 0]
    energy = 0.5 * rows[:, 9] ** 2 + GRAVITY_M_PER_S2 * (rows[:, 2] - 0.03)
    tops = np.flatnonzero((rows[:-1, 9] > 0) & (rows[1:, 9] <= 0))
    speeds = np.sqrt(2.0 * np.array([GRAVITY_M_PER_S2 * 0.3, *energy[tops]][:4]))
    assert len(speeds) == 4
    assert speeds[1] / speeds[0] == pytest.approx(restitution, rel=0.01)
    biased = restitution * (speeds[:-1] + GRAVITY_M_PER_S2 / 1800)
    assert speeds[1:] == pytest.approx(biased, rel=0.01)


def rolling_share(length_m: float) -> float:
    """Acceleration of a cylinder of 30 mm radius that rolls down 20 degrees, over that of the law."""
    lean = Rotation.from_euler("y", 20, degrees=True)
    place = tuple((0.03 * lean.apply([0, 0, 1.0])).tolist())
    pose = Pose.from_rotation(place, lean * Rotation.from_euler("x", 90, degrees=True))
    shape = Cylinder(radius_m=0.03, length_m=length_m)
    body = RigidBody(
        name="roller", shape=shape, motion=Motion.DYNAMIC, pose=pose, mass_kg=0.2
    )
    plane = fixed("plane", Plane(), Pose.from_rotation((0, 0, 0), lean))
    contact = Contact(
        first=("roller",), second=("plane",), friction=0.5, restitution=0.0
    )
    rows = states(
        Scene(bodies=(body, plane), contacts=(contact,), duration_s=0.6),
        ["roller"],
        0.6,
    )[:, 0]
    along = rows[:, :3] @ lean.apply([1.0, 0.0, 0.0])
    law = 2.0 / 3.0 * GRAVITY_M_PER_S2 * np.sin(np.radians(20))
    return float(
        fitted_acceleration(np.arange(len(along)) / 180, along - along[0]) / law
    )


def test_long_cylinders_roll_and_short_ones_are_prisms() -> None:
    """docs/engines/physx.md states what a cylinder that is shorter than its diameter loses."""
    assert rolling_share(0.08) == pytest.approx(1.0, abs=0.001)
    assert rolling_share(0.06) == pytest.approx(1.0, abs=0.005)
    assert rolling_share(0.04) == pytest.approx(0.952, abs=0.005)


def test_a_cube_that_spins_on_its_face_is_braked_at_its_corners() -> None:
    """docs/engines/physx.md: 1.8 times the torque of an even pressure, 0.383 mu m g a."""
    edge, mass, friction = 0.05, 0.1, 0.2
    cube = RigidBody(
        name="cube",
        shape=Box(size_m=(edge,) * 3),
        motion=Motion.DYNAMIC,
        pose=Pose(position_m=(0, 0, edge / 2)),
        mass_kg=mass,
        angular_velocity_rad_per_s=(0.0, 0.0, 20.0),
    )
    ground = fixed("ground", Plane(), Pose(position_m=(0, 0, 0)))
    contact = Contact(
        first=("cube",), second=("ground",), friction=friction, restitution=0.0
    )
    rows = states(
        Scene(bodies=(cube, ground), contacts=(contact,), duration_s=0.2),
        ["cube"],
        0.05,
    )[:, 0]
    torque = mass * edge**2 / 6.0 * 180.0 * np.diff(rows[:, 12]).mean()
    assert -torque / (friction * mass * GRAVITY_M_PER_S2 * edge) == pytest.approx(
        0.5**0.5, rel=0.02
    )


@pytest.mark.parametrize(
    ("hinges", "tolerance"), [("articulation", 1e-4), ("joint", 2e-4)]
)
def test_both_kinds_of_hinge_swing_with_the_period_of_the_pendulum(
    hinges: str, tolerance: float
) -> None:
    ball = RigidBody(
        name="bob",
        shape=Sphere(radius_m=0.02),
        motion=Motion.DYNAMIC,
        pose=Pose(position_m=(0.02, 0, 0.8)),
        mass_kg=0.3,
    )
    length = float(np.hypot(0.02, 0.2))
    scene = Scene(
        bodies=(ball,),
        joints=(Hinge(body="bob", anchor_m=(0, 0, 1), axis=(0, 1, 0)),),
        duration_s=8,
    )
    rows = states(scene, ["bob"], 8.0, hinges=hinges)[:, 0]
    assert np.hypot(rows[:, 0], rows[:, 2] - 1.0) == pytest.approx(length, abs=2e-6)
    up = np.flatnonzero((rows[:-1, 0] < 0) & (rows[1:, 0] >= 0))
    crossings = (up - rows[up, 0] / (rows[up + 1, 0] - rows[up, 0])) / 180
    amplitude = np.arctan2(0.02, 0.2)
    law = (
        2
        * np.pi
        * np.sqrt((length**2 + 0.4 * 0.02**2) / (GRAVITY_M_PER_S2 * length))
        * (1 + amplitude**2 / 16)
    )
    assert np.diff(crossings).mean() == pytest.approx(law, rel=tolerance)


def test_thin_and_round_pieces_keep_their_vertices() -> None:
    """PhysX leaves out vertices within 0.7 mm of a plane of others, if it makes the mesh in metres."""
    sliver = ConvexUnion(
        pieces_m=(
            ((0, 0, 0), (0.2, 0, 0), (0, 0.2, 0), (0.1, 0.1, 0.0005), (0, 0, 0.0005)),
        )
    )
    plate = prism(Cylinder(radius_m=0.15, length_m=0.01))
    pose = Pose(position_m=(0, 0, 1))
    bodies = [
        RigidBody(name=name, shape=shape, motion=Motion.DYNAMIC, pose=pose, mass_kg=0.1)
        for name, shape in (("sliver", sliver), ("plate", plate))
    ]
    ground = fixed("ground", Plane(), Pose(position_m=(0, 0, 0)))
    contact = Contact(
        first=("sliver", "plate"), second=("ground",), friction=0.3, restitution=0.0
    )
    simulation = PHYSX.build(
        Scene(bodies=(*bodies, ground), contacts=(contact,), duration_s=1.0)
    )
    for body in bodies:
        (shape,) = simulation._inner._model.parts[body.name].component.collision_shapes
        corners = np.asarray(body.shape.pieces_m[0])
        gaps = np.linalg.norm(
            corners[:, None] - shape.vertices * shape.scale, axis=2
        ).min(axis=1)
        assert gaps.max() < 1e-7
    simulation.close()


def test_a_piece_that_physx_simplifies_is_an_error() -> None:
    turns = 2.0 * np.pi * np.arange(120) / 120
    rings = [
        np.column_stack([np.cos(turns), np.sin(turns), np.full(120, height)])
        for height in (0.0, 1.0)
    ]
    drum = RigidBody(
        name="drum",
        shape=ConvexUnion(
            pieces_m=(tuple(map(tuple, np.concatenate(rings).tolist())),)
        ),
        motion=Motion.DYNAMIC,
        pose=Pose(position_m=(0, 0, 1)),
        mass_kg=0.1,
    )
    ground = fixed("ground", Plane(), Pose(position_m=(0, 0, 0)))
    contact = Contact(
        first=("drum",), second=("ground",), friction=0.3, restitution=0.0
    )
    scene = Scene(bodies=(drum, ground), contacts=(contact,), duration_s=1.0)
    assert not PHYSX.supports(scene)
    with pytest.raises(
        UnsupportedSceneError, match="PhysX simplifies a convex piece of 240 vertices"
    ):
        PHYSX.build(scene)


def turned_deg(plate: Shape, *, acceleration: float, **settings: object) -> float:
    """Return by how much a cube has turned after 0.1 s on a plate that accelerates along x [degrees]."""
    cube = Box(size_m=(0.05, 0.05, 0.05))
    bodies = (
        RigidBody(
            name="cube",
            shape=cube,
            motion=Motion.DYNAMIC,
            pose=Pose(position_m=(0, -0.075, 0.025)),
            mass_kg=0.09,
        ),
        RigidBody(
            name="plate",
            shape=plate,
            motion=Motion.KINEMATIC,
            pose=Pose(position_m=(0, 0, -0.01)),
            mass_kg=1.0,
        ),
    )
    contact = Contact(
        first=("cube",), second=("plate",), friction=0.38, restitution=0.0
    )
    simulation = PHYSX.build(
        Scene(bodies=bodies, contacts=(contact,), duration_s=1.0), settings
    )
    change = np.array([acceleration, 0.0, 0.0, 0.0, 0.0, 0.0])
    for sample in range(18):
        time_s = sample / 180
        place = Pose(position_m=(0.5 * acceleration * time_s**2, 0.0, -0.01))
        simulation.drive("plate", place, change * time_s, change)
        simulation.advance(1 / 180)
    row = simulation.body_states(["cube"])[0]
    simulation.close()
    return abs(
        float(
            np.degrees(Rotation.from_quat(row[3:7], scalar_first=True).as_rotvec()[2])
        )
    )


def test_persistent_contacts_turn_a_cube_that_slides_on_a_convex_mesh() -> None:
    """Pressure and friction are symmetric about the line of motion: a cube must not turn. It slips above 3.7 m/s^2."""
    disc, slab = Cylinder(radius_m=0.15, length_m=0.02), Box(size_m=(0.3, 0.3, 0.02))
    assert turned_deg(disc, acceleration=3.0) < 1e-3
    assert turned_deg(slab, acceleration=4.2) < 1e-2
    assert turned_deg(disc, acceleration=4.2, persistent_manifolds=False) < 1e-2
    assert turned_deg(disc, acceleration=4.2) > 0.1


def test_checks_see_a_driven_body_that_physx_does_not_move(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
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
        "driven-flick",
    ]
    assert results[0].measured == 0.0
