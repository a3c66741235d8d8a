"""Compounds of solids: mass properties in closed form, and laws on every engine that builds them."""

from importlib.util import find_spec

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.backends.mujoco.model import build_model
from gauge_envs.backends.mujoco.settings import settings_for
from gauge_envs.errors import ParameterError
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Box,
    Capsule,
    Compound,
    ConvexUnion,
    Cylinder,
    Ellipsoid,
    Part,
    Pose,
    Sphere,
    mass_properties,
)
from gauge_envs.scoring.estimators import acceleration_m_per_s2
from gauge_envs.tools.assets.build import shape_to_obj
from gauge_envs.tools.bench.recording import record
from gauge_envs.tools.sanity.phenomena.foot import foot_scene
from gauge_envs.tools.sanity.robot.foot import FootGeometry
from gauge_envs.tools.usd.writer import to_usd

TETRAHEDRON = ConvexUnion(
    pieces_m=(((0.0, 0.0, 0.0), (0.06, 0.0, 0.0), (0.0, 0.05, 0.0), (0.0, 0.0, 0.04)),)
)
SOLIDS = {
    "box": (Box(size_m=(0.06, 0.04, 0.03)), 0.015),
    "sphere": (Sphere(radius_m=0.02), 0.02),
    "cylinder": (Cylinder(radius_m=0.02, length_m=0.05), 0.025),
    "capsule": (Capsule(radius_m=0.02, length_m=0.05), 0.045),
    "ellipsoid": (Ellipsoid(radii_m=(0.03, 0.02, 0.015)), 0.015),
    "hull": (TETRAHEDRON, 0.0),
}
"""A solid of each kind, and the height of its origin when it stands on the ground [m]."""

ENGINES = [
    pytest.param(
        name,
        marks=pytest.mark.skipif(find_spec(module) is None, reason=f"no {module}"),
    )
    for name, module in (
        ("mujoco", "mujoco"),
        ("newton", "newton"),
        ("physx", "sapien"),
    )
]


def foot_of(kind):
    solid, height = SOLIDS[kind]
    part = Part(shape=solid, pose=Pose(position_m=(0.0, 0.0, height)))
    return FootGeometry(
        name=kind,
        geoms=kind,
        parts=(part,),
        load_kg=1.0,
        robot_mass_kg=4.0,
        foot_count=4,
    )


def compiled(scene):
    return build_model(scene, settings_for(scene))[1]


def test_mass_properties_of_a_mesh_do_not_depend_on_the_order_of_sums():
    """Another processor sums in another order; a centre that is 0 but for rounding is 0."""
    mesh = load_experiment("NonsmoothContact-1-wood").scene.body("pyramid").shape
    expected = mass_properties(mesh, 0.2)
    assert not np.any(expected[0])
    for seed in range(20):
        order = np.random.default_rng(seed).permutation(len(mesh.pieces_m[0]))
        points_m = tuple(mesh.pieces_m[0][place] for place in order)
        found = mass_properties(ConvexUnion(pieces_m=(points_m,)), 0.2)
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize("kind", SOLIDS)
def test_mass_properties_are_those_of_the_model(kind):
    turn = Rotation.from_euler("xyz", [20.0, -40.0, 70.0], degrees=True)
    parts = (
        Part(shape=SOLIDS[kind][0], pose=Pose.from_rotation((0.1, 0.0, 0.02), turn)),
        Part(shape=Sphere(radius_m=0.03), pose=Pose(position_m=(-0.1, 0.05, 0.0))),
    )
    shape = Compound(parts=parts)
    foot = FootGeometry(
        name="", geoms="", parts=parts, load_kg=0.5, robot_mass_kg=2.0, foot_count=4
    )
    model = compiled(foot_scene(foot, friction=0.3))
    centre, inertia = mass_properties(foot.shape, foot.mass_kg)
    body = model.body("foot")
    assert body.mass[0] == pytest.approx(2.0)
    np.testing.assert_allclose(centre, body.ipos, atol=1e-9)
    axes = Rotation.from_quat(body.iquat, scalar_first=True).as_matrix()
    np.testing.assert_allclose(
        inertia, axes @ np.diag(body.inertia) @ axes.T, rtol=1e-6, atol=1e-9
    )
    assert shape.volume_m3 == pytest.approx(
        SOLIDS[kind][0].volume_m3 + 4.0 / 3.0 * np.pi * 0.03**3
    )


def test_two_balls_on_a_rod_without_mass():
    ball = Sphere(radius_m=0.02)
    shape = Compound(
        parts=tuple(
            Part(shape=ball, pose=Pose(position_m=(x, 0.0, 0.0))) for x in (-0.1, 0.3)
        )
    )
    centre, inertia = mass_properties(shape, 6.0)
    np.testing.assert_allclose(centre, [0.1, 0.0, 0.0], atol=1e-12)
    own = 0.4 * 6.0 * 0.02**2
    np.testing.assert_allclose(
        inertia, np.diag([own, own + 6.0 * 0.2**2, own + 6.0 * 0.2**2]), atol=1e-12
    )


@pytest.mark.parametrize("kind", SOLIDS)
def test_feet_carry_the_same_load_whatever_their_form(kind):
    foot = foot_of(kind)
    centre, _ = mass_properties(foot.shape, foot.mass_kg)
    np.testing.assert_allclose(centre[:2], 0.0, atol=1e-12)
    assert foot.half_side_m >= 4.0 * centre[2]
    assert foot.shape.corners_m[:, 2].min() == pytest.approx(0.0, abs=1e-12)
    assert foot.mass_kg == 4.0


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(
            kind, marks=[] if kind in ("capsule", "ellipsoid") else pytest.mark.slow
        )
        for kind in SOLIDS
    ],
)
def test_feet_slide_by_coulombs_law_and_stay_on_the_ground(engine, kind):
    scene = foot_scene(foot_of(kind), friction=0.3, slope_deg=30.0, seconds=0.3)
    support = backend(engine).supports(scene)
    if not support:
        assert (engine, kind) == ("physx", "ellipsoid")
        assert "ellipsoid" in support.missing[0]
        return
    simulation = backend(engine).build(scene, {})
    try:
        places = record(simulation, scene, 0.3).displacement("foot")
    finally:
        simulation.close()
    along = scene.body("ground").pose.rotation.apply(places, inverse=True)
    law = GRAVITY_M_PER_S2 * (np.sin(np.radians(30.0)) - 0.3 * np.cos(np.radians(30.0)))
    assert acceleration_m_per_s2(np.arange(55) / 180.0, along[:, 0]) == pytest.approx(
        law, rel=0.02
    )
    assert np.abs(along[:, 1:]).max() < 1e-3


def test_the_inverse_weight_of_dynamic_bodies_is_scaled():
    scene = foot_scene(foot_of("sphere"), friction=0.3)
    plain, softer = (
        build_model(scene, settings_for(scene, {"inverse_weight_scale": s}))[1]
        for s in (1.0, 5.0)
    )
    foot = plain.body("foot").id
    np.testing.assert_allclose(
        softer.body_invweight0[foot], 5.0 * plain.body_invweight0[foot]
    )
    assert plain.body_invweight0[foot, 0] == pytest.approx(1.0 / 4.0)


def test_files_have_no_compounds(tmp_path):
    scene = foot_scene(foot_of("sphere"), friction=0.3)
    with pytest.raises(ParameterError, match="'foot' is a compound of solids"):
        to_usd(scene, tmp_path / "scene.usda")
    with pytest.raises(ParameterError, match=r"a compound .* has no OBJ file"):
        shape_to_obj(scene.body("foot").shape, "foot")


def test_inertia_of_a_right_tetrahedron_is_the_closed_form():
    """Legs a, b, c: variances 3 a^2 / 80, covariances -a b / 80 about the centroid (a, b, c) / 4."""
    legs_m, corner_m, mass_kg = (
        np.array([0.1, 0.2, 0.4]),
        np.array([0.3, -0.2, 0.5]),
        2.0,
    )
    points_m = corner_m + np.vstack([np.zeros(3), np.diag(legs_m)])
    centre_m, inertia = mass_properties(
        ConvexUnion(pieces_m=(tuple(map(tuple, points_m.tolist())),)), mass_kg
    )
    covariance = -np.outer(legs_m, legs_m) / 80.0
    np.fill_diagonal(covariance, 3.0 * legs_m**2 / 80.0)
    expected = mass_kg * (np.trace(covariance) * np.eye(3) - covariance)
    assert centre_m == pytest.approx(corner_m + legs_m / 4.0, abs=1e-9)
    assert inertia == pytest.approx(expected, rel=1e-6)
