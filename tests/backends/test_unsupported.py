"""Each unsupported scene or setting of an engine raises an error with its reason.

One row for each kind of limit: settings, presets for other scenes, contacts, shapes, joints and deformable bodies.
"""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.backends.base import scene_support
from gauge_envs.errors import GaugeError
from gauge_envs.fixtures.parts import ball, contact, fixed_box, ground
from gauge_envs.scene import (
    Attachment,
    Compound,
    ConvexUnion,
    Hinge,
    Motion,
    Part,
    Pose,
    Region,
    Rope,
    Scene,
    Sphere,
    Tether,
)

SLIDE = "SlopeSlider-2-wood"
CLOTH = "TextileBending-satin"
FOAM = "FoamStretching-soft"
ROPE = "RopeWinding-rubber"


def of(*bodies, **parts):
    """Return a scene of some bodies."""
    return Scene(bodies=bodies, duration_s=1.0, **parts)


def touching(*pairs, friction_step=0.0):
    """Return balls and a ground in contacts, whose friction differs by a step from pair to pair."""
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


def compound():
    part = Part(shape=Sphere(radius_m=0.02), pose=Pose(position_m=(0.0, 0.0, 0.02)))
    body = replace(ball("foot", (0.0, 0.0, 0.0)), shape=Compound(parts=(part,)))
    return of(body, ground())


STRING = Tether(body="ball-1", anchor_m=(0.0, 0.0, 1.0), length_m=0.3)
HINGE = Hinge(body="ball-1", anchor_m=(0.0, 0.0, 2.0), axis=(1.0, 0.0, 0.0))
BOB = ball("ball-1", (0.0, 0.0, 0.8))


def rope_between(motion, **parts):
    """Return a rope between a fixed body and another body."""
    rope = Rope(
        name="rope",
        pose=Pose(position_m=(0.0, 0.0, 1.0)),
        length_m=0.3,
        radius_m=0.002,
        mass_kg=0.01,
        young_modulus_pa=1e6,
    )
    motions = {"low": Motion.FIXED, "high": motion}
    bodies = (
        replace(fixed_box(side, (0.0, 0.0, 2.0), (0.1,) * 3), motion=motion)
        for side, motion in motions.items()
    )
    ends = tuple(
        Attachment(deformable="rope", region=Region(axis="x", side=side), to=side)
        for side in motions
    )
    return of(*bodies, deformables=(rope,), attachments=ends, **parts)


def attached(name, **region):
    """Return an experiment whose first attachment has another region."""
    scene = load_experiment(name).scene
    first, *rest = scene.attachments
    first = replace(first, region=replace(first.region, **region))
    return replace(scene, attachments=(first, *rest))


def released(name):
    """Return an experiment whose driven bodies move under forces."""
    scene = load_experiment(name).scene
    bodies = tuple(
        replace(part, motion=Motion.DYNAMIC)
        if part.motion is Motion.KINEMATIC
        else part
        for part in scene.bodies
    )
    return replace(scene, bodies=bodies, drivers=())


def two_cloths(*contacts):
    """Return the scene of a pulled tablecloth with a second cloth, and more contacts."""
    scene = load_experiment("TableclothPulling-metal").scene
    second = replace(scene.deformables[0], name="other")
    return replace(
        scene,
        deformables=(*scene.deformables, second),
        contacts=(*scene.contacts, *contacts),
    )


def dense_air():
    """Return a flung cloth in air as dense as water."""
    scene = load_experiment("TextileFlinging-satin", "air").scene
    return replace(scene, air=replace(scene.air, density_kg_per_m3=1000.0))


BOTH = ("mujoco", "newton")
DEFORMABLE = (
    (CLOTH, {"cell_m": 1e-4}, "'cell_m'.*given: 0.0001"),
    (CLOTH, {"cell_m": 0.5}, "500 mm, more than the 400 mm that 'textile' allows"),
    (FOAM, {"cell_m": 0.001}, "gives 'foam' about [0-9]+ nodes, more than"),
    (attached(CLOTH, axis="z"), {}, "by its face"),
    (attached(FOAM, axis="x"), {}, "elsewhere"),
    (attached(ROPE, depth_m=0.1), {}, "over a length"),
    (released(CLOTH), {}, "moves under forces"),
)
ROWS = (
    *((name, *row) for row in DEFORMABLE for name in BOTH),
    ("mujoco", SLIDE, {"integrator": "magic"}, "'integrator'"),
    ("mujoco", SLIDE, {"sustained_solref": (math.nan, 1.0)}, "solref.0'.*given: nan"),
    ("mujoco", SLIDE, {"iterations": 10**21}, "'iterations'.*at most 2147483647"),
    ("mujoco", CLOTH, {"integrator": "implicitfast"}, "these settings: .*discrete"),
    ("mujoco", CLOTH, {"cloth_softness_m2_per_kg": 0.01}, "this or cloth_solimp"),
    ("mujoco", dense_air(), {}, r"steps of 0\.00111 s are stable up to .* reduce"),
    (
        "mujoco",
        two_cloths(contact("other", "table", friction=0.5)),
        {},
        "'table' touches deformable bodies with several frictions",
    ),
    ("rapier", SLIDE, {"contact_frequency_hz": -1.0}, "'contact_frequency_hz'"),
    (
        "rapier",
        touching(*((f"b{k:02}", "ground") for k in range(17)), friction_step=0.01),
        {},
        "17 kinds of contact",
    ),
    ("rapier", of(BOB, joints=(HINGE, STRING)), {}, "'ball-1' has 2 joints"),
    (
        "physx",
        SLIDE,
        {"contact_offset_m": 0.001, "rest_offset_m": 0.002},
        "contact_offset_m must be larger than rest_offset_m",
    ),
    (
        "physx",
        touching(*(("a", f"b{k:02}") for k in range(33))),
        {},
        "33 contacts have the same friction and restitution.*32",
    ),
    ("physx", CLOTH, {}, "is deformable.*GPU"),
    ("physx", hull(300), {}, "piece 0 of 'a' has 300 vertices.*more than 128"),
    (
        "pybullet",
        SLIDE,
        {"contact_stiffness_n_per_m": 1e4, "split_impulse": "none"},
        "must be given together",
    ),
    ("pybullet", ROPE, {}, "'rope' touches other bodies or itself"),
    ("pybullet", rope_between(Motion.FIXED), {}, "attached at both ends"),
    (
        "pybullet",
        of(replace(BOB, linear_velocity_m_per_s=(1.0, 0.0, 0.0)), joints=(STRING,)),
        {},
        "initial velocity",
    ),
    ("pybullet", "CantileverBeam-soft", {}, "'cube-2' is attached to 'cube-1'.*bonds"),
    ("newton", SLIDE, {"tolerance": 1e-8}, "'tolerance'.*given: 1e-08"),
    ("newton", FOAM, {"preset": "mpm", "cell_m": 0.002}, "nodes, more than 200000"),
    ("newton", FOAM, {"preset": "rigid"}, "'rigid'"),
    ("newton", SLIDE, {"preset": "cloth"}, "'cloth'"),
    ("newton", released("FoamBending-soft"), {"preset": "mpm"}, "'cube' moves freely"),
    (
        "newton",
        rope_between(
            Motion.FIXED,
            contacts=(contact("rope", "low", friction=0.3, restitution=0.5),),
        ),
        {},
        "'rope' rebounds from 'low'.*no restitution",
    ),
    ("newton", two_cloths(), {}, "other would touch table as well"),
    ("drake", SLIDE, {"approximation": "pgs"}, "'approximation'"),
    ("drake", "FoamTwisting-soft", {}, "5.43 mm.*5.89 mm"),
    *(
        (name, compound(), {}, "compound of solids")
        for name in ("drake", "pybullet", "rapier")
    ),
    ("genesis", SLIDE, {"friction_cone": "pyramidal"}, "friction_cone"),
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
    ("engine", "scene", "settings", "reason"), ROWS, indirect=["engine"]
)
def test_an_unsupported_scene_or_setting_has_its_reason(
    engine, scene, settings, reason
):
    assert re.search(reason, refusal(engine, scene, settings))


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"preset": "nope"}, "nope"),
        ({"tau": 1.0}, "'tau'.*unknown setting; known: "),
        ({"timestep_s": 1e-320}, "'timestep_s'.*given: 1e-320"),
        ({"timestep_s": 0.001}, "not a whole number"),
        ({"drive_interval_s": math.inf}, "'drive_interval_s'"),
        ([1], "expected a mapping"),
    ],
)
def test_impossible_settings_are_named(engine, settings, reason):
    assert re.search(reason, refusal(engine, SLIDE, settings))


@pytest.mark.parametrize("engine", ["rapier"], indirect=True)
def test_rolling_friction_is_unsupported_by_an_engine_without_it(engine):
    touch = replace(contact("ball", "ground", friction=0.5), rolling_m=0.001)
    scene = of(ball("ball", (0.0, 0.0, 0.03)), ground(), contacts=(touch,))
    (reason,) = scene_support(engine, scene).missing
    assert reason.startswith("'ball' and 'ground' touch with rolling friction, which")
    assert scene_support(backend("mujoco"), scene)
