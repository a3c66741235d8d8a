"""Scenes of the ids: masses, sizes, poses and prescribed motions of the paper, and bodies without overlap.

Numbers are from the metadata and the videos of the paper. MuJoCo finds overlaps.
"""

import tomllib
from functools import cache

import mujoco
import numpy as np
import pytest
from places import RIGID, RIGID_FAMILIES, first_of_each_kind
from scipy.spatial import ConvexHull

from gauge_envs import load_experiment, variants
from gauge_envs.backends import backend
from gauge_envs.experiments.task_files import task_spec
from gauge_envs.files import data_folder
from gauge_envs.observables.functions import (
    face_areas_mm2,
)
from gauge_envs.scene import (
    Cloth,
    Rod,
    Rope,
)

G = 9.80665
TOLERANCE_M = 1e-3
FEW_BODIES = first_of_each_kind(name for name in RIGID if name != "WallBreaking-wood")
SOFT = [variant.name for variant in variants() if variant.name not in RIGID]
FOAMS = [
    f"Foam{motion}-soft"
    for motion in ("Stretching", "Compressing", "Shearing", "Twisting", "Bending")
]

experiment = cache(load_experiment)


def scene_of(name, *parameters):
    return experiment(name, *parameters).scene


# --- numbers of the paper ---


@pytest.mark.parametrize(
    ("name", "body", "mass_kg", "position_m", "frames"),
    [
        ("SlopeSlider-2-wood", "cube", 0.0903, (0.097247, 0.406934, 0.359354), 19),
        ("SlopeSlider-3-metal", "cube", 0.3397, (0.072298, 0.387577, 0.268944), 60),
        ("Turntable-2-plastic", "cube", 0.1469, (0.478944, 0.408666, 0.214725), 17),
        ("BouncingBall-rubber", "ball", 0.121, (0.418911, 0.435316, 0.451023), 18),
        ("NewtonsCradle-metal", "ball-5", 0.033, (0.448794, 0.457852, 0.178669), 1027),
        ("FoamStretching-hard", "foam", 0.0131, (0.40950, 0.39464, 0.13223), 30),
        ("RopeWinding-rubber", "rope", 0.005, (0.441, 0.416, 0.31111), 90),
        ("StickStack-soft", "rod", 0.0149, (0.26265, 0.41963, 0.08965), 120),
    ],
)
def test_masses_places_and_frames_are_published(
    name, body, mass_kg, position_m, frames
):
    scene = scene_of(name)
    bodies = {body.name: body for body in (*scene.bodies, *scene.deformables)}
    assert bodies[body].mass_kg == mass_kg
    assert bodies[body].pose.position_m == pytest.approx(position_m, abs=1e-9)
    assert experiment(name).frame_count == frames
    assert scene.duration_s == pytest.approx((frames - 1) / 30)


def test_constants_are_published():
    contact, impact = scene_of("SlopeSlider-2-wood").contacts
    assert (contact.friction, contact.restitution) == (0.273673, 0.223583)
    assert impact.mode == "impact"
    (foam,) = scene_of("FoamStretching-hard").deformables
    assert (foam.young_modulus_pa, foam.poisson_ratio) == (99372.0, 0.34)
    (cloth,) = scene_of("TextileStretching-satin").deformables
    assert (cloth.size_m, cloth.areal_density_kg_per_m2) == ((0.4, 0.4), 0.07121)
    # The published Poisson ratio is 0.62, but an isotropic solid has less than 0.5.
    (rod,) = scene_of("StickStack-soft").deformables
    assert rod.poisson_ratio == 0.49
    rod_spec = task_spec("StickStack").constants["rod"]["soft"]
    assert rod_spec["poisson_ratio"].published == 0.62


def test_measured_sets_are_the_recorded_means():
    facts = data_folder("scoring") / "facts"
    ball = tomllib.loads((facts / "bouncing_ball_summary.toml").read_text())
    scene = scene_of("BouncingBall-rubber", "measured")
    radius_m = scene.body("ball").shape.radius_m
    ground_m = scene.body("ground").pose.position_m[2]
    assert scene.body("ball").pose.position_m[2] == ball["start_height_m"]["mean"]
    contact_m = ball["contact_height_m"]["mean"]
    assert ground_m == pytest.approx(contact_m - radius_m, abs=1e-12)
    assert scene.contacts[0].restitution == ball["rebound_ratio"]["mean"]
    # Four impacts transfer 93.02 % of the velocity.
    cradle = scene_of("NewtonsCradle-metal", "measured").contacts[0]
    assert (0.5 + 0.5 * cradle.restitution) ** 4 == pytest.approx(0.9302, abs=1e-12)


# --- masses and volumes ---


DENSE = [
    (family, name, material)
    for family in RIGID_FAMILIES
    for name, tables in task_spec(family).constants.items()
    for material, constants in tables.items()
    if "density_kg_per_m3" in constants
]
"""Family, body and material of each published density."""


@pytest.mark.parametrize(("family", "name", "material"), DENSE)
def test_volume_times_density_is_the_mass(family, name, material):
    spec = task_spec(family)
    constants = spec.constants[name][material]
    mass_kg = spec.bodies[name].shape.volume_m3 * constants["density_kg_per_m3"]
    assert mass_kg == pytest.approx(constants["mass_kg"], rel=0.01)


@pytest.mark.parametrize("name", SOFT)
def test_deformable_bodies_have_the_mass_of_their_density(name):
    spec = experiment(name).spec
    for body in scene_of(name).deformables:
        if isinstance(body, Cloth):
            mass_kg = body.areal_density_kg_per_m2 * np.prod(body.size_m)
            assert body.mass_kg == pytest.approx(mass_kg, rel=0.01)
            continue
        tables = spec.constants[body.name]
        material = experiment(name).variant.material
        constants = tables.get(material, next(iter(tables.values())))
        # Rubber has 1130 kg/m^3; no density of the rope and of the blocks of the cantilever is published.
        density = constants.get("density_kg_per_m3", 1130.0)
        is_round = isinstance(body, Rope | Rod)
        disc_m2 = np.pi * body.radius_m**2 if is_round else 0.0
        volume_m3 = disc_m2 * body.length_m if is_round else body.shape.volume_m3
        assert body.mass_kg == pytest.approx(density * volume_m3, rel=0.06)


def test_pieces_make_the_volumes_of_their_solids():
    ring = scene_of("Funnel-satin").body("board").shape
    # The hole is a polygon of 32 sides around a circle of 0.1 m, and 0.3 % larger.
    area_m2 = 0.25 - np.pi * 0.1**2
    assert ring.volume_m3 == pytest.approx(area_m2 * 0.012, rel=0.001)
    parts = [scene_of("SlopeContact-wood").body(name) for name in ("teh", "base")]
    corners = [part.pose.to_world(part.shape.corners_m) for part in parts]
    hull_m3 = ConvexHull(np.concatenate(corners)).volume
    assert hull_m3 == pytest.approx(0.1 * 0.1 * 0.2, rel=1e-4)
    assert sum(part.shape.volume_m3 for part in parts) == pytest.approx(hull_m3, 1e-4)


@pytest.mark.parametrize("name", ["SlopeContact-wood", "NonsmoothContact-2-wood"])
def test_the_origin_of_a_falling_polyhedron_is_its_centroid(name):
    (piece,) = scene_of(name).dynamic_bodies[0].shape.pieces_m
    vertices = np.asarray(piece)
    inner = vertices.mean(axis=0)
    triangles = vertices[ConvexHull(vertices).simplices]
    volumes = np.abs(np.linalg.det(triangles - inner))
    centres = (triangles.sum(axis=1) + inner) / 4.0
    assert np.abs(volumes @ centres / volumes.sum()).max() < 1e-12


# --- bodies that touch ---


def gaps_m(scene):
    """Return the gap of each pair of bodies that are nearer than the tolerance, as MuJoCo finds it."""
    simulation = backend("mujoco").build(scene)
    model, data = simulation.model, simulation.data
    model.pair_margin[:] = TOLERANCE_M
    mujoco.mj_forward(model, data)
    gaps = {}
    for contact in data.contact:
        bodies = model.geom_bodyid[contact.geom]
        pair = frozenset(model.body(body).name for body in bodies)
        gaps[pair] = min(gaps.get(pair, np.inf), contact.dist)
    return gaps


@pytest.mark.parametrize(
    "name", [pytest.param("WallBreaking-wood", marks=pytest.mark.slow), *FEW_BODIES]
)
def test_rigid_bodies_do_not_overlap_at_the_start(name):
    assert min(gaps_m(scene_of(name)).values(), default=0.0) > -TOLERANCE_M


@pytest.mark.parametrize(
    ("name", "pairs"),
    [
        ("SlopeContact-wood", [("teh", "base")]),
        ("SlopeSlider-2-wood", [("cube", "board")]),
        ("Turntable-1-wood", [("cube", "plate")]),
        ("WallBreaking-wood", [("brick-1", "ground")]),
        ("NewtonsCradle-metal", [("ball-2", "ball-3"), ("ball-4", "ball-5")]),
    ],
)
def test_resting_bodies_touch_what_they_rest_on(name, pairs):
    assert gaps_m(scene_of(name)).keys() >= set(map(frozenset, pairs))


# --- markers as they are observed ---


@pytest.mark.parametrize("name", FOAMS)
def test_foam_has_the_twelve_published_faces(name):
    """Their markers stand in rows at thirds of the width of 50 mm, in steps of 25 mm."""
    markers = scene_of(name).markers
    assert len(set(markers.faces)) == 12
    assert {index for face in markers.faces for index in face} == set(range(14))
    areas = face_areas_mm2(np.asarray(markers.positions_m)[None], markers.faces)
    np.testing.assert_allclose(areas, 0.5 * 25.0 * 50.0 / 3.0, rtol=1e-3)


# --- drives ---


def driven_pose(name, body, time_s):
    scene = scene_of(name)
    driver = next(driver for driver in scene.drivers if driver.body == body)
    return driver.pose(scene.body(body).pose, time_s)


@pytest.mark.parametrize(
    ("name", "axis", "shift_mm", "uncertainty_mm"),
    [
        ("FoamStretching-soft", 2, 9.2, 0.2),
        ("FoamCompressing-soft", 2, -9.0, 0.2),
        ("FoamShearing-soft", 1, 60.5, 0.9),
        ("FoamBending-soft", 2, -48.3, 1.0),
    ],
)
def test_foam_is_driven_as_the_video_shows(name, axis, shift_mm, uncertainty_mm):
    (driver,) = scene_of(name).drivers
    poses = [driven_pose(name, driver.body, time_s) for time_s in (0.0, 10.0)]
    moved_mm = 1e3 * np.subtract(poses[1].position_m, poses[0].position_m)
    assert moved_mm[axis] == pytest.approx(shift_mm, abs=uncertainty_mm)
    assert np.abs(np.delete(moved_mm, axis)).max() < 2.0
    assert driver.provenance == "video"


def test_foam_is_twisted_about_its_own_axis():
    start, end = (driven_pose("FoamTwisting-soft", "base-2", t) for t in (0.0, 10.0))
    np.testing.assert_allclose(end.position_m, start.position_m, atol=1e-12)
    turned_deg = np.degrees((end.rotation * start.rotation.inv()).as_rotvec())
    np.testing.assert_allclose(turned_deg, [0.0, 0.0, -89.3], atol=0.1)


def test_the_turntable_repeats_the_recorded_strokes():
    (motion,) = scene_of("Turntable-3-metal").drivers[0].motions
    degrees = [np.degrees(motion.value(time_s)) for time_s in (0.0, 1.75, 3.70, 6.0)]
    assert degrees == pytest.approx([0.0, 366.52, -30.59, 386.0], abs=0.05)
    for start_s, end_s, rate in [(0.6, 1.6, 4.0), (2.5, 3.6, -4.0), (4.3, 5.6, 4.0)]:
        turned = motion.value(end_s) - motion.value(start_s)
        assert turned / (end_s - start_s) == pytest.approx(rate, rel=0.005)


@pytest.mark.parametrize("material", ["wood", "plastic", "metal"])
def test_turntables_slip_or_stick_as_published(material):
    """A cube at radius r needs the friction r |(omega^2, alpha)| / g."""

    def needed(name, time_s):
        scene = scene_of(name)
        (motion,) = scene.drivers[0].motions
        cube_m = np.asarray(scene.body("cube").pose.position_m)
        radius_m = np.linalg.norm((cube_m - motion.point_m)[:2])
        step_s = 1e-4
        before, middle, after = (motion.value(time_s + k * step_s) for k in (-1, 0, 1))
        omega = (after - before) / (2 * step_s)
        alpha = (after - 2 * middle + before) / step_s**2
        return radius_m * np.hypot(omega**2, alpha) / G

    friction = scene_of(f"Turntable-2-{material}").contacts[0].friction
    assert needed(f"Turntable-1-{material}", 1.0) < 0.05 * friction
    assert needed(f"Turntable-2-{material}", 0.4) > 1.9 * friction
    assert needed(f"Turntable-3-{material}", 1.2) < 0.5 * friction
    assert needed(f"Turntable-3-{material}", 1.705) > 2.0 * friction


# --- joints ---


def test_pendulum_and_cradle_start_level_with_the_recorded_lengths():
    scene = scene_of("Pendulum-metal")
    arm_m = np.subtract(scene.body("ball").pose.position_m, scene.joints[0].anchor_m)
    assert arm_m[1:] == pytest.approx([0.0, 0.0], abs=1e-12)
    # A solid ball that turns with its rod swings like a point at l + 2/5 r^2 / l.
    length_m = np.abs(arm_m[0]) + 0.4 * 0.03**2 / np.abs(arm_m[0])
    assert length_m == pytest.approx(0.269881, abs=1e-6)
    scene = scene_of("NewtonsCradle-metal", "measured")
    arm_m = np.subtract(scene.body("ball-1").pose.position_m, scene.joints[0].anchor_m)
    assert arm_m == pytest.approx([0.0, -0.138251, 0.0], abs=1e-12)
