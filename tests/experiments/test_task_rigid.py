"""The rigid experiments: masses fit the shapes, bodies touch without overlap, motions are the stated ones."""

import itertools
import tomllib
from functools import cache

import numpy as np
import pytest
from places import RIGID_FAMILIES
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from gauge_envs import load_experiment
from gauge_envs.experiments.task_files import task_spec
from gauge_envs.experiments.task_format import ContactSpec
from gauge_envs.experiments.variants import variants
from gauge_envs.files import data_folder
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    ConvexUnion,
    Cylinder,
    Plane,
    Sphere,
)

NAMES = tuple(
    variant.name for variant in variants() if variant.family in RIGID_FAMILIES
)
TOLERANCE_M = 1e-3

RESTING = {
    "SlopeContact": (("teh", "base"), ("base", "ground")),
    "NonsmoothContact-1": (("squarebase", "ground"),),
    "NonsmoothContact-2": (("tribase", "ground"),),
    "NonsmoothContact-3": (("tribase", "ground"),),
    "SlopeSlider": (("cube", "board"),),
    "Turntable": (("cube", "plate"),),
    "WallBreaking": (
        ("brick-1", "ground"),
        ("brick-13", "brick-1"),
        ("brick-118", "brick-110"),
        ("brick-7", "brick-1"),
    ),
    "NewtonsCradle": (("ball-2", "ball-3"), ("ball-3", "ball-4"), ("ball-4", "ball-5")),
}


@cache
def experiment(name, parameters="calibrated"):
    return load_experiment(name, parameters)


# Geometry


def pieces(body):
    """World vertices of convex pieces; round shapes as prisms around them, so that nothing is missed."""
    shape = body.shape
    if isinstance(shape, ConvexUnion):
        local = [np.asarray(piece) for piece in shape.pieces_m]
    elif isinstance(shape, Cylinder):
        angles = np.linspace(0, 2 * np.pi, 64, endpoint=False)
        ring = (
            shape.radius_m
            / np.cos(np.pi / 64)
            * np.column_stack([np.cos(angles), np.sin(angles)])
        )
        ends = [
            np.column_stack([ring, np.full(64, z)])
            for z in (-0.5 * shape.length_m, 0.5 * shape.length_m)
        ]
        local = [np.concatenate(ends)]
    else:
        local = [shape.corners_m]
    return [body.pose.to_world(vertices) for vertices in local]


def overlap_depth(first, second):
    """Thickness of the common part of two convex polyhedra: twice its largest inscribed ball; negative when apart."""
    if (first.min(axis=0) > second.max(axis=0) + 0.01).any() or (
        second.min(axis=0) > first.max(axis=0) + 0.01
    ).any():
        return -np.inf
    faces = np.concatenate([ConvexHull(first).equations, ConvexHull(second).equations])
    # x inside every face by at least r, largest r: bounded, as each face normal has length one.
    matrix = np.column_stack([faces[:, :3], np.ones(len(faces))])
    result = linprog([0, 0, 0, -1], A_ub=matrix, b_ub=-faces[:, 3], bounds=(None, None))
    assert result.success
    return -2.0 * float(result.fun)


def depth(first, second):
    """How deep one body is in another [m]; negative when apart."""
    if isinstance(first.shape, Plane):
        first, second = second, first
    if isinstance(second.shape, Plane):
        lowest = min(
            float(second.pose.to_body(vertices)[:, 2].min())
            for vertices in pieces(first)
        )
        return -lowest
    if isinstance(first.shape, Sphere) and isinstance(second.shape, Sphere):
        distance = float(
            np.linalg.norm(np.subtract(first.pose.position_m, second.pose.position_m))
        )
        return first.shape.radius_m + second.shape.radius_m - distance
    return max(
        overlap_depth(a, b) for a, b in itertools.product(pieces(first), pieces(second))
    )


def close_pairs(found):
    """Pairs that may collide and whose bounding spheres meet."""
    radius = {
        b.name: float(np.linalg.norm(b.shape.corners_m, axis=1).max())
        for b in found.scene.bodies
    }
    pairs = {
        frozenset(pair)
        for contact in found.scene.contacts
        for pair in itertools.product(contact.first, contact.second)
    }
    for pair in sorted(tuple(sorted(names)) for names in pairs if len(names) == 2):
        first, second = (found.scene.body(name) for name in pair)
        gap = float(
            np.linalg.norm(np.subtract(first.pose.position_m, second.pose.position_m))
        )
        flat = isinstance(first.shape, Plane) or isinstance(second.shape, Plane)
        if flat or gap < radius[first.name] + radius[second.name]:
            yield first, second


# All files


@pytest.mark.parametrize("family", RIGID_FAMILIES)
def test_volume_times_density_is_the_mass(family):
    spec = task_spec(family)
    for name, tables in spec.constants.items():
        volume = spec.bodies[name].shape.volume_m3
        for material, constants in tables.items():
            density = constants.get("density_kg_per_m3")
            if density is not None:
                assert volume * density == pytest.approx(
                    constants["mass_kg"], rel=0.01
                ), (name, material)


@pytest.mark.parametrize("name", NAMES)
def test_bodies_start_outside_each_other(name):
    for first, second in close_pairs(experiment(name)):
        assert depth(first, second) < TOLERANCE_M, (first.name, second.name)


@pytest.mark.parametrize("name", NAMES)
def test_resting_bodies_touch_what_they_rest_on(name):
    found = experiment(name)
    family, subtask = found.variant.family, found.variant.subtask
    for first, second in RESTING.get(f"{family}-{subtask}", RESTING.get(family, ())):
        assert (
            abs(depth(found.scene.body(first), found.scene.body(second))) < TOLERANCE_M
        ), (first, second)


@pytest.mark.parametrize("family", RIGID_FAMILIES)
def test_pieces_of_a_shape_do_not_overlap(family):
    for body in task_spec(family).bodies.values():
        shape = body.shape
        if isinstance(shape, ConvexUnion):
            for first, second in itertools.combinations(shape.pieces_m, 2):
                assert overlap_depth(np.asarray(first), np.asarray(second)) < 1e-9


# One experiment each


@pytest.mark.parametrize("material", ["wood", "plastic"])
def test_slope_contact_parts_make_one_block(material):
    scene = experiment(f"SlopeContact-{material}").scene
    corners = np.concatenate(
        [
            scene.body(name).pose.to_world(scene.body(name).shape.corners_m)
            for name in ("teh", "base")
        ]
    )
    hull = ConvexHull(corners)
    assert hull.volume == pytest.approx(0.1 * 0.1 * 0.2, rel=1e-4)
    assert sum(
        scene.body(name).shape.volume_m3 for name in ("teh", "base")
    ) == pytest.approx(hull.volume, rel=1e-4)


@pytest.mark.parametrize(
    "name",
    ["SlopeContact-wood", *(n for n in NAMES if n.startswith("NonsmoothContact"))],
)
def test_origin_of_a_falling_polyhedron_is_its_centroid(name):
    found = experiment(name)
    shape = found.scene.body(found.recorded[0]).shape
    (piece,) = shape.pieces_m
    vertices = np.asarray(piece)
    # Cones from an inner point over the triangles of the hull.
    inner = vertices.mean(axis=0)
    triangles = vertices[ConvexHull(vertices).simplices]
    volumes = np.abs(np.linalg.det(triangles - inner)) / 6.0
    centroid = (volumes[:, None] * (triangles.sum(axis=1) + inner) / 4.0).sum(
        axis=0
    ) / volumes.sum()
    assert np.abs(centroid).max() < 1e-12


@pytest.mark.parametrize("name", [n for n in NAMES if n.startswith("NonsmoothContact")])
def test_nonsmooth_body_falls_into_the_groove(name):
    found = experiment(name)
    falling, base = (
        found.scene.body(n)
        for n in found.spec.subtasks[found.variant.subtask or ""].bodies[:2]
    )
    vertices = falling.pose.to_world(falling.shape.corners_m)
    tip = vertices[vertices[:, 2].argmin()] - base.pose.position_m
    half_width = 0.025 if base.name == "squarebase" else 0.0125
    assert abs(tip[0]) < half_width
    assert 0.03 < tip[2] < 0.08


def required_friction(name, time_s):
    """Friction coefficient without which the cube would not be carried along at a time."""
    found = experiment(name)
    (driver,) = found.scene.drivers
    (motion,) = driver.motions
    cube = np.asarray(found.scene.body("cube").pose.position_m)
    radius = float(np.linalg.norm((cube - motion.point_m)[:2]))
    step = 1e-4
    before, now, after = (motion.value(time_s + k * step) for k in (-1, 0, 1))
    rate, acceleration = (
        (after - before) / (2 * step),
        (after - 2 * now + before) / step**2,
    )
    return radius * float(np.hypot(rate**2, acceleration)) / GRAVITY_M_PER_S2


@pytest.mark.parametrize("material", ["wood", "plastic", "metal"])
def test_turntable_speeds_are_on_the_stated_side_of_slipping(material):
    friction = experiment(f"Turntable-2-{material}").scene.contacts[0].friction
    assert required_friction(f"Turntable-2-{material}", 0.4) > 1.9 * friction
    # Back and forth: no slip at steady speed, slip at the stop.
    assert required_friction(f"Turntable-3-{material}", 1.2) < 0.5 * friction
    assert required_friction(f"Turntable-3-{material}", 1.705) > 2.0 * friction


def test_turntable_three_repeats_the_recorded_strokes():
    (motion,) = experiment("Turntable-3-metal").scene.drivers[0].motions
    degrees = [np.degrees(motion.value(t)) for t in (0.0, 1.75, 3.70, 6.0)]
    assert degrees == pytest.approx([0.0, 366.52, -30.59, 386.0], abs=0.05)
    for start, end, rate in [(0.6, 1.6, 4.0), (2.5, 3.6, -4.0), (4.3, 5.6, 4.0)]:
        assert (motion.value(end) - motion.value(start)) / (
            end - start
        ) == pytest.approx(rate, rel=0.005)


def test_ball_parameter_sets_are_the_recorded_means():
    facts = tomllib.loads(
        (data_folder("scoring") / "facts" / "bouncing_ball_summary.toml").read_text()
    )
    recorded = experiment("BouncingBall-rubber", "recorded")
    ball, ground = recorded.scene.body("ball"), recorded.scene.body("ground")
    assert ball.pose.position_m[2] == facts["start_height_m"]["mean"]
    contact_height = facts["contact_height_m"]["mean"]
    assert ground.pose.position_m[2] == pytest.approx(
        contact_height - ball.shape.radius_m, abs=1e-12
    )
    for parameters in ("effective", "recorded"):
        (contact,) = experiment("BouncingBall-rubber", parameters).scene.contacts
        assert contact.restitution == facts["rebound_ratio"]["mean"]


@pytest.mark.parametrize("material", ["wood", "plastic", "metal"])
def test_the_effective_friction_is_that_of_the_recorded_slides(material):
    file = data_folder("scoring") / "facts" / "slope_slider_30deg_summary.toml"
    facts = tomllib.loads(file.read_text())
    contact, _ = experiment(f"SlopeSlider-2-{material}", "effective").scene.contacts
    assert contact.friction == facts[material]["friction"]["mean"]


def test_cradle_starts_level_and_its_effective_restitution_transfers_the_recorded_share():
    scene = experiment("NewtonsCradle-metal", "effective").scene
    assert ((1.0 + scene.contacts[0].restitution) / 2.0) ** 4 == pytest.approx(
        0.9302, abs=1e-12
    )
    first, hinge = scene.body("ball-1"), scene.joints[0]
    assert np.subtract(first.pose.position_m, hinge.anchor_m) == pytest.approx(
        [0.0, -0.138251, 0.0], abs=1e-12
    )
    for index in range(2, 6):
        x, y, z = scene.body(f"ball-{index}").pose.position_m
        assert (x, y, z) == pytest.approx(
            (0.448794, 0.377852 + 0.02 * (index - 1), 0.178669), abs=1e-12
        )


def test_pendulum_is_level_and_has_the_recorded_length():
    scene = experiment("Pendulum-metal").scene
    arm = np.subtract(scene.body("ball").pose.position_m, scene.joints[0].anchor_m)
    assert arm[1:] == pytest.approx([0.0, 0.0], abs=1e-12)
    # A solid ball that turns with its rod swings like a point at l + 2/5 r^2 / l.
    length = float(np.linalg.norm(arm)) + 0.4 * 0.03**2 / float(np.linalg.norm(arm))
    assert length == pytest.approx(0.269881, abs=1e-6)


def test_wall_is_hit_by_the_swinging_ball():
    found = experiment("WallBreaking-wood")
    bricks = np.array(
        [found.scene.body(name).pose.position_m for name in found.recorded]
    )
    assert len(bricks) == 118
    assert (
        sorted(np.unique(bricks[:, 2].round(6), return_counts=True)[1].tolist())
        == [8] + [10] * 5 + [12] * 5
    )
    (tether,) = found.scene.joints
    ball = found.scene.body("ball")
    assert ball.pose.position_m[0] < tether.anchor_m[0]
    # Where the ball's front first reaches the wall's face, on the circle that the string allows.
    reach = bricks[:, 0].min() - 0.01 - ball.shape.radius_m - tether.anchor_m[0]
    length = float(np.linalg.norm(np.subtract(ball.pose.position_m, tether.anchor_m)))
    height = tether.anchor_m[2] - np.sqrt(length**2 - reach**2)
    assert reach == pytest.approx(0.022, abs=5e-4)
    hit = bricks[np.abs(bricks[:, 2] - height) < 0.0075][:, 2]
    assert np.unique(hit).tolist() == [0.10928]


@pytest.mark.parametrize(
    ("constants", "is_complete"),
    [
        ({"constants_of": "cube"}, True),
        ({"friction": 0.1, "restitution": 0.2}, True),
        ({"constants_of": "cube", "friction": 0.1}, True),
        ({"friction": 0.1}, False),
        ({"restitution": 0.2}, False),
        ({}, False),
    ],
)
def test_a_pair_without_constants_needs_both_numbers(constants, is_complete):
    pair = {"bodies": ("cube", "slope")} | constants
    if is_complete:
        assert ContactSpec.model_validate(pair).bodies == ("cube", "slope")
    else:
        with pytest.raises(ValueError, match="both friction and restitution"):
            ContactSpec.model_validate(pair)
