"""What the engines refuse: settings, presets for other scenes, and scenes that they do not build."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.backends.base import scene_support
from gauge_envs.errors import GaugeError, ParameterError
from gauge_envs.scene import (
    Attachment,
    Box,
    Compound,
    ConvexUnion,
    Hinge,
    Motion,
    Part,
    Pose,
    Region,
    Rope,
    Scene,
    SoftBody,
    Sphere,
    Tether,
)
from gauge_envs.tools.bench.parts import ball, contact, fixed_box, ground

SLIDE = "SlopeSlider-2-wood"
CLOTH = "TextileBending-satin"
FOAM = "FoamStretching-soft"
ROD = "StickStack-soft"
ROPE = "RopeWinding-rubber"


def of(*bodies, **parts):
    """Return a scene of some bodies."""
    return Scene(bodies=bodies, duration_s=1.0, **parts)


def in_contact(*pairs, friction_step=0.0):
    """Return balls and a ground in sustained contacts, whose friction differs by a step from pair to pair."""
    names = sorted({name for pair in pairs for name in pair} - {"ground"})
    contacts = tuple(
        contact(*pair, friction=0.1 + friction_step * number)
        for number, pair in enumerate(pairs)
    )
    balls = (ball(name, (0.1 * k, 0.0, 0.1)) for k, name in enumerate(names))
    return of(*balls, ground(), contacts=contacts)


def hull(count):
    """Return one convex body with many vertices on a sphere."""
    heights = np.linspace(-0.99, 0.99, count)
    turns, radii = np.pi * (1.0 + 5.0**0.5) * np.arange(count), np.sqrt(1 - heights**2)
    points = np.column_stack([radii * np.cos(turns), radii * np.sin(turns), heights])
    shape = ConvexUnion(pieces_m=(tuple(map(tuple, points.tolist())),))
    return of(replace(ball("a", (0.0, 0.0, 1.0)), shape=shape))


def drum():
    """Return a convex body of two rings of 120 vertices, on the ground."""
    turns = 2.0 * np.pi * np.arange(120) / 120
    rings = [
        np.column_stack([np.cos(turns), np.sin(turns), np.full(120, height)])
        for height in (0.0, 1.0)
    ]
    shape = ConvexUnion(pieces_m=(tuple(map(tuple, np.concatenate(rings).tolist())),))
    body = replace(ball("drum", (0.0, 0.0, 1.0)), shape=shape)
    touch = contact("drum", "ground", friction=0.3)
    return of(body, ground(), contacts=(touch,))


HINGES = tuple(
    Hinge(body="ball-1", anchor_m=(0.0, 0.0, 2.0), axis=axis)
    for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
)
BALL = Part(shape=Sphere(radius_m=0.02), pose=Pose(position_m=(0.0, 0.0, 0.02)))
COMPOUND = of(
    replace(ball("foot", (0.0, 0.0, 0.0)), shape=Compound(parts=(BALL,))), ground()
)
STRING = Tether(body="ball-1", anchor_m=(0.0, 0.0, 1.0), length_m=0.3)


def on_string(height_m, speed_m_per_s):
    """Return a ball below the anchor of a string, which it leaves sideways."""
    bob = replace(
        ball("ball-1", (0.0, 0.0, height_m)),
        linear_velocity_m_per_s=(speed_m_per_s, 0.0, 0.0),
    )
    return of(bob, joints=(STRING,))


def rope_between(motion):
    """Return a rope between two bodies, one of which is fixed."""
    rope = Rope(
        name="rope",
        pose=Pose(position_m=(0.0, 0.0, 1.0)),
        length_m=0.3,
        radius_m=0.002,
        mass_kg=0.01,
        young_modulus_pa=1e6,
    )
    held = {"low": Motion.FIXED, "high": motion}
    bodies = (
        replace(fixed_box(side, (0.0, 0.0, 2.0), (0.1,) * 3), motion=one)
        for side, one in held.items()
    )
    ends = tuple(
        Attachment(deformable="rope", region=Region(axis="x", side=side), to=side)
        for side in held
    )
    return of(*bodies, deformables=(rope,), attachments=ends)


def held(scene, **region):
    """Return a scene whose first attachment has another region."""
    first, *others = scene.attachments
    first = replace(first, region=replace(first.region, **region))
    return replace(scene, attachments=(first, *others))


def edges_of(name, motion):
    """Return an experiment whose driven bodies move otherwise."""
    scene = load_experiment(name).scene
    bodies = tuple(
        replace(one, motion=motion) if one.motion is Motion.KINEMATIC else one
        for one in scene.bodies
    )
    return replace(scene, bodies=bodies, drivers=())


def blocks(*touching):
    """Return two blocks of foam above a slab, which some of them touch."""
    foam = SoftBody(
        name="held",
        shape=Box(size_m=(0.05,) * 3),
        pose=Pose(position_m=(0.0, 0.0, 0.03)),
        mass_kg=0.01,
        young_modulus_pa=1e5,
        poisson_ratio=0.3,
    )
    passing = replace(foam, name="passing", pose=Pose(position_m=(0.2, 0.0, 0.03)))
    return of(
        fixed_box("slab", (0.0, 0.0, -0.05), (1.0, 1.0, 0.1)),
        deformables=(foam, passing),
        contacts=(contact(touching, "slab", friction=0.3),),
    )


def two_cloths(*contacts):
    """Return the scene of a pulled tablecloth with a second cloth, and more contacts."""
    scene = load_experiment("TableclothPulling-metal").scene
    other = replace(scene.deformables[0], name="other")
    return replace(
        scene,
        deformables=(*scene.deformables, other),
        contacts=(*scene.contacts, *contacts),
    )


def dense_air():
    """Return a flung cloth in air as dense as water."""
    scene = load_experiment("TextileFlinging-satin", "air").scene
    return replace(scene, air=replace(scene.air, density_kg_per_m3=1000.0))


IN_MUJOCO_AND_NEWTON = (
    (CLOTH, {"cell_m": 1e-4}, "'cell_m'.*given: 0.0001"),
    (CLOTH, {"cell_m": 2.0}, "'cell_m'.*given: 2.0"),
    (CLOTH, {"cell_m": 0.5}, "500 mm, more than the 400 mm that 'textile' allows"),
    (CLOTH, {"cell_m": 0.0006}, "0.6 mm, which gives 'textile' about [0-9]+ nodes"),
    (FOAM, {"cell_m": 0.001}, "gives 'foam' about [0-9]+ nodes, more than"),
    (ROD, {"cell_m": 0.9}, "more than the [0-9.]+ mm that 'rod' allows"),
    (held(load_experiment(CLOTH).scene, axis="z"), {}, "by its face"),
    (edges_of(CLOTH, Motion.DYNAMIC), {}, "moves under forces"),
    (edges_of(FOAM, Motion.DYNAMIC), {}, "moves under forces"),
    (held(load_experiment(ROD).scene, axis="y"), {}, "elsewhere"),
    (held(load_experiment(FOAM).scene, axis="x"), {}, "elsewhere"),
)

SETTINGS_OF_ALL = (
    ({"preset": "nope"}, "nope"),
    ({"tau": 1.0}, "'tau'.*unknown setting; known: "),
    ({"timestep_s": -1.0}, "'timestep_s'"),
    ({"timestep_s": 1e-320}, "'timestep_s'.*given: 1e-320"),
    ({"timestep_s": 0.001}, "not a whole number"),
    ({"drive_interval_s": math.inf}, "'drive_interval_s'"),
    ({"drive_interval_s": 1e300}, "'drive_interval_s'.*given: 1e.300"),
    ({"preset": ["stack"]}, "unknown .* preset"),
    ({3: 1}, "setting .3. in preset"),
    ([1], "expected a mapping"),
)

ROWS = (
    ("mujoco", SLIDE, {"integrator": "magic"}, "'integrator'"),
    ("mujoco", SLIDE, {"sustained_solref": (math.nan, 1.0)}, "solref.0'.*given: nan"),
    ("mujoco", SLIDE, {"impratio": math.inf}, "'impratio'.*given: inf"),
    ("mujoco", SLIDE, {"iterations": 10**21}, "'iterations'.*at most 2147483647"),
    ("mujoco", SLIDE, {"noslip_iterations": np.int64(2**40)}, "noslip_iterations"),
    (
        "mujoco",
        CLOTH,
        {"integrator": "implicitfast"},
        "with these settings: .*discrete",
    ),
    (
        "mujoco",
        CLOTH,
        {"cloth_softness_m2_per_kg": 0.01},
        "either this or cloth_solimp",
    ),
    ("mujoco", dense_air(), {}, r"steps of 0\.00111 s are stable up to .* reduce"),
    (
        "mujoco",
        two_cloths(contact("other", "table", friction=0.5)),
        {},
        "'table' touches deformable bodies with several frictions",
    ),
    ("rapier", SLIDE, {"solver_iterations": 0}, "'solver_iterations'"),
    ("rapier", SLIDE, {"friction_model": "pyramid"}, "'friction_model'"),
    ("rapier", SLIDE, {"contact_frequency_hz": -1.0}, "'contact_frequency_hz'"),
    (
        "rapier",
        in_contact(*((f"b{k:02}", "ground") for k in range(17)), friction_step=0.01),
        {},
        "17 kinds of contact",
    ),
    (
        "rapier",
        of(ball("ball-1", (0.0, 0.0, 0.9)), joints=(HINGES[0], STRING)),
        {},
        "'ball-1' hangs on 2 joints",
    ),
    (
        "physx",
        SLIDE,
        {"contact_offset_m": 0.001, "rest_offset_m": 0.002},
        "contact_offset_m must be larger than rest_offset_m",
    ),
    ("physx", SLIDE, {"position_iterations": 0}, "'position_iterations'"),
    ("physx", SLIDE, {"solver": "newton"}, "'solver'"),
    ("physx", SLIDE, {"friction_type": "patch"}, "'friction_type'"),
    (
        "physx",
        in_contact(*(("a", f"b{k:02}") for k in range(33))),
        {},
        "33 contacts have the same friction and restitution.*32",
    ),
    (
        "physx",
        of(
            ball("a", (0.0, 0.0, 1.0)),
            ground(),
            contacts=(contact("a", "ground", friction=0.1, restitution=1.2),),
        ),
        {},
        "'a' and 'ground' rebound with a restitution of 1.2: PhysX takes at most 1",
    ),
    ("physx", CLOTH, {}, "is deformable.*GPU"),
    ("physx", hull(300), {}, "piece 0 of 'a' has 300 vertices.*more than 128"),
    ("physx", drum(), {}, "piece 0 of 'drum' has 240 vertices"),
    (
        "pybullet",
        SLIDE,
        {"contact_stiffness_n_per_m": 1e4, "split_impulse": "none"},
        "must be given together",
    ),
    (
        "pybullet",
        SLIDE,
        {"contact_stiffness_n_per_m": 1e4, "contact_damping_n_s_per_m": 1.0},
        "split_impulse must be 'none'",
    ),
    ("pybullet", ROPE, {}, "'rope' touches other bodies or itself"),
    (
        "pybullet",
        replace(rope_between(Motion.FIXED), attachments=()),
        {"cell_m": 0.005},
        "5 mm, which gives 'rope' about 61 nodes, more than 28",
    ),
    ("pybullet", rope_between(Motion.FIXED), {}, "held at both ends"),
    ("pybullet", rope_between(Motion.KINEMATIC), {}, "which is driven"),
    ("pybullet", on_string(1.0, 0.0), {}, "no direction"),
    ("pybullet", on_string(0.8, 1.0), {}, "start velocity"),
    ("pybullet", "CantileverBeam-soft", {}, "'cube-2' is attached to 'cube-1'.*bonds"),
    ("pybullet", ROD, {}, "'rod' is a rod"),
    ("pybullet", CLOTH, {}, "is cloth"),
    ("newton", SLIDE, {"tolerance": 1e-8}, "'tolerance'.*given: 1e-08"),
    (
        "newton",
        "TextileFlinging-satin",
        {"timestep_s": 1 / 180},
        "3 iterations .* at 1/180 s are too few",
    ),
    ("newton", FOAM, {"preset": "mpm", "cell_m": 0.002}, "nodes, more than 200000"),
    *(
        ("newton", name, {"preset": preset}, f"'{preset}'")
        for name, preset in (
            ("TextileFlinging-satin", "mpm"),
            (FOAM, "rigid"),
            (SLIDE, "cloth"),
            (SLIDE, "mpm"),
            (SLIDE, "rope"),
            (ROD, "cloth"),
            (ROD, "mpm"),
            (ROD, "rigid"),
        )
    ),
    ("newton", ROPE, {}, "'ball-1' rebounds from 'billiard'.*no restitution"),
    (
        "newton",
        replace(load_experiment(ROPE).scene, contacts=()),
        {"preset": "paper"},
        "'paper' does not support 'rope'",
    ),
    (
        "newton",
        edges_of("FoamBending-soft", Motion.DYNAMIC),
        {"preset": "mpm"},
        "'cube' moves freely",
    ),
    *(
        (name, held(load_experiment(ROPE).scene, depth_m=0.1), {}, "over a length")
        for name in ("mujoco", "newton")
    ),
    (
        "newton",
        replace(
            rope_between(Motion.FIXED),
            contacts=(contact("rope", "low", friction=0.3, restitution=0.5),),
        ),
        {},
        "'rope' rebounds from 'low'.*no restitution",
    ),
    (
        "newton",
        replace(
            rope_between(Motion.FIXED),
            deformables=(
                *rope_between(Motion.FIXED).deformables,
                *load_experiment(FOAM).scene.deformables,
            ),
        ),
        {},
        "with rigid bodies only",
    ),
    (
        "newton",
        two_cloths(contact("other", "table", friction=0.5)),
        {},
        "two coefficients",
    ),
    ("newton", two_cloths(), {}, "other would touch table as well"),
    ("newton", blocks("held"), {"preset": "soft"}, "passing would touch slab as well"),
    ("drake", SLIDE, {"approximation": "pgs"}, "'approximation'"),
    ("drake", SLIDE, {"sustained_rate": 0.0}, "'sustained_rate'"),
    ("drake", "FoamTwisting-soft", {}, "5.43 mm.*5.89 mm"),
    ("drake", CLOTH, {}, ""),
    *(
        (name, COMPOUND, {}, "compound of solids")
        for name in ("drake", "pybullet", "rapier")
    ),
    ("genesis", SLIDE, {"friction_cone": "pyramidal"}, "friction_cone"),
    ("genesis", SLIDE, {"constraint_solver": "CG"}, "constraint_solver"),
    ("genesis", SLIDE, {"noslip_iterations": 5}, "noslip_iterations"),
)


def refusal(engine, scene, settings):
    """Return why an engine does not build a scene with some settings."""
    if isinstance(scene, str):
        scene = load_experiment(scene).scene
    missing = scene_support(engine, scene).missing
    if missing and not settings:
        return "; ".join(missing)
    with pytest.raises((GaugeError, LookupError)) as caught:
        engine.build(scene, settings).close()
    return str(caught.value)


@pytest.mark.parametrize(
    ("engine", "scene", "settings", "words"), ROWS, indirect=["engine"]
)
def test_what_an_engine_refuses_has_its_reason(engine, scene, settings, words):
    assert re.search(words, refusal(engine, scene, settings))


@pytest.mark.parametrize("engine", ["mujoco", "newton"], indirect=True)
@pytest.mark.parametrize(("scene", "settings", "words"), IN_MUJOCO_AND_NEWTON)
def test_cells_and_attachments_out_of_bounds(engine, scene, settings, words):
    assert re.search(words, refusal(engine, scene, settings))


@pytest.mark.parametrize(("settings", "words"), SETTINGS_OF_ALL)
def test_impossible_settings_are_named(engine, settings, words):
    assert re.search(words, refusal(engine, SLIDE, settings))


def rolled(**terms):
    """Return a ball on the ground, whose contact has more terms."""
    touch = replace(contact("ball", "ground", friction=0.5), **terms)
    return of(ball("ball", (0.0, 0.0, 0.03)), ground(), contacts=(touch,))


@pytest.mark.parametrize(
    ("field", "words"),
    [("torsion_m", "torsional friction"), ("rolling_m", "rolling friction")],
)
@pytest.mark.parametrize("engine", ["rapier"], indirect=True)
def test_an_engine_without_a_kind_of_friction_declines_in_words(engine, field, words):
    scene = rolled(**{field: 0.001})
    (reason,) = scene_support(engine, scene).missing
    expected = (
        f"'ball' and 'ground' touch with {words}, which this backend does not build"
    )
    assert reason == expected
    assert scene_support(backend("mujoco"), scene)


def test_torsion_needs_friction():
    with pytest.raises(ParameterError, match="without sliding friction"):
        rolled(friction=0.0, torsion_m=0.001)
