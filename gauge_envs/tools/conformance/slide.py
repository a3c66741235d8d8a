"""Friction of free bodies on fixed ones and on each other: they hold, slide, spin and roll."""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.fixtures.drop import RADIUS_M
from gauge_envs.fixtures.parts import body, contact, fixed_box, ground, thrown
from gauge_envs.fixtures.recording import Recording
from gauge_envs.fixtures.slope import (
    Slope,
    acceleration_downhill_m_per_s2,
    friction_of_slide,
)
from gauge_envs.fixtures.turning import ROLL, SPIN, turning_arm_m, turning_scene
from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Box,
    ConvexUnion,
    Cylinder,
    Pose,
    RigidBody,
    Shape,
    Sphere,
    mass_properties,
)
from gauge_envs.scene.geometry import vector
from gauge_envs.scoring.estimators import acceleration_m_per_s2
from gauge_envs.tools.conformance.drive import CUBE_M, unless_off, worst_friction
from gauge_envs.tools.conformance.lab import (
    Lab,
    Measurement,
    largest,
    largest_mm,
    ratio,
)
from gauge_envs.tools.conformance.model import Checks, Level, Tolerance

check = Checks(Level.CONTACT)


FRICTION = Tolerance(
    "single real slides are 5 to 14 % from the published coefficient; an engine must be well below that",
    absolute=0.01,
)

# --- slides on a level slab ------------------------------------------------------------------------------------------

PUCK, BALL = Box(size_m=(0.1, 0.1, 0.02)), Sphere(radius_m=0.03)
PUCKS: dict[str, tuple[float, float, float, float, Shape]] = {
    # Direction and yaw in the world [deg], speed [m/s], friction, and shape.
    "2 m/s along x": (25.0, 25.0, 2.0, 0.2, PUCK),
    "2 m/s along x, order of the pair reversed": (25.0, 25.0, 2.0, 0.2, PUCK),
    "2 m/s at 45 degrees": (70.0, 25.0, 2.0, 0.2, PUCK),
    "2 m/s at 110 degrees, body turned by 65": (135.0, 90.0, 2.0, 0.3, PUCK),
    "2 m/s at 200 degrees, body turned by 170": (225.0, 195.0, 2.0, 0.3, PUCK),
    "6 m/s at 300 degrees": (325.0, 45.0, 6.0, 0.3, PUCK),
    "a ball without spin, 5 m/s at 250 degrees": (275.0, 0.0, 5.0, 0.25, BALL),
}


@check(
    "pucks-friction",
    title="friction in all directions, at all speeds, in both orders, of all shapes",
    law="a = mu g, in each direction and at each speed",
    tolerance=FRICTION,
    cause="friction is not Contact.friction; where some directions are right, it is a pyramid in place of a cone (0.71 "
    "or 1.41 times), or depends on speed, shape or the order of the pair",
)
def pucks_friction(lab: Lab) -> Measurement:
    """Six flat boxes and a ball without spin that slide on a fixed, level slab, which is turned by 25 degrees.

    Deceleration over mu g, quadratic fit over 0.4 s, the worst of them; a ball slides until its speed is 5/7.

    Source: Coulomb.
    """
    bodies = [
        fixed_box(
            "slab", (0.0, 0.0, -0.05), (12.0, 12.0, 0.1), euler_deg=(0.0, 0.0, 25.0)
        )
    ]
    contacts = []
    for name, (direction_deg, yaw_deg, speed, friction, shape) in PUCKS.items():
        pair = (name, "slab") if len(bodies) % 2 else ("slab", name)
        contacts.append(contact(*pair, friction=friction))
        place = (0.0, 0.0, shape.corners_m[:, 2].max())
        puck = body(name, shape, Pose.from_euler_deg(place, (0.0, 0.0, yaw_deg)))
        direction = Rotation.from_euler("z", direction_deg, degrees=True)
        bodies.append(thrown(puck, direction.apply([speed, 0.0, 0.0])))
    frictions = {name: friction for name, (*_, friction, _) in PUCKS.items()}
    return _slowed(lab.run(bodies, contacts, 0.4), frictions, "slab")


def _slowed(
    rollout: Recording, frictions: Mapping[str, float], support: str
) -> Measurement:
    """Measure the worst friction of bodies that slide on a level support, from their deceleration."""
    slides = {}
    for name, friction in frictions.items():
        path_m = np.linalg.norm(rollout.displacement(name), axis=1)
        slows = -acceleration_m_per_s2(rollout.times_s, path_m)
        slides[name] = (slows / G, friction, support)
    return worst_friction(rollout, slides)


CROWD, CROWD_M_PER_S, CROWD_FRICTION = 24, 1.5, 0.3


@check(
    "slide-crowd",
    title="friction in a scene of many bodies",
    law="a = mu g, in each direction",
    tolerance=FRICTION,
    cause="the engine, or its preset, solves scenes of many bodies otherwise, as with a pyramid of friction",
)
def slide_crowd(lab: Lab) -> Measurement:
    """Twenty-four pucks that slide at 1.5 m/s on a plane, each in another direction.

    Deceleration over mu g, quadratic fit over 0.3 s; the worst.

    Source: Coulomb.
    """
    pucks = []
    for at in range(CROWD):
        angle = 2.0 * np.pi * at / CROWD
        way = np.array((np.cos(angle), np.sin(angle), 0.0))
        place = vector(2.0 * way + (0.0, 0.0, 0.01))
        puck = body(
            f"puck at {360 // CROWD * at} degrees", PUCK, Pose(position_m=place)
        )
        pucks.append(thrown(puck, CROWD_M_PER_S * way))
    frictions = {puck.name: CROWD_FRICTION for puck in pucks}
    touch = contact((*frictions,), "ground", friction=CROWD_FRICTION)
    return _slowed(lab.run((*pucks, ground()), [touch], 0.3), frictions, "ground")


# --- boxes on slopes -------------------------------------------------------------------------------------------------

BOARDS = {
    # Euler angles [deg]: a slope, and a turn about the vertical.
    "board": (0.0, 30.0, 0.0),
    "turned board": (0.0, 30.0, 50.0),
    "board of 10 degrees": (0.0, 10.0, 0.0),
    "turned board of 10 degrees": (0.0, 10.0, 35.0),
    "board of 47.5 degrees": (0.0, 47.5, 0.0),
}
FLUSH_M, ALMOST_M = -0.575, 1e-7
"""Place along a board of a cube whose rear face is flush with its end, and a distance from it."""

HOLDING = {
    # Friction, support, and place of the centre along it and across [m].
    "cube that holds": (0.25, "board of 10 degrees", -0.1, 0.0),
    "block that holds": (0.25, "turned board of 10 degrees", -0.1, 0.0),
    "tile that holds": (1.2, "board of 47.5 degrees", -0.1, 0.0),
}
SLIDING = {
    "smooth cube": (0.1, "board", -0.4, -0.2),
    "rough cube": (0.3, "board", -0.4, -0.1),
    "cube flush with the end": (0.2, "board", FLUSH_M, 0.0),
    "cube 0.1 um inside the end": (0.2, "board", FLUSH_M + ALMOST_M, 0.1),
    "cube 0.1 um outside the end": (0.2, "board", FLUSH_M - ALMOST_M, 0.2),
    "cube on the turned board": (0.25, "turned board", -0.4, -0.1),
    "flush cube on the turned board": (0.15, "turned board", FLUSH_M, 0.1),
}
BETWEEN = {
    "slab": (0.3, "turned board", -0.4, 0.2),
    "cube on the slab": (0.1, "slab", -0.12, 0.0),
}
BOXES = HOLDING | SLIDING | BETWEEN
SIZES_M = {
    "block that holds": (0.1, 0.06, 0.04),
    "tile that holds": (0.08, 0.08, 0.02),
    "slab": (0.3, 0.1, 0.03),
}
"""Sizes of the boxes of 1 kg; all others are cubes of 0.1 kg."""


def _boxes(lab: Lab) -> Recording:
    """Record boxes on fixed boards whose x axes are downhill."""
    bodies: dict[str, RigidBody] = {}
    contacts = []
    for name, euler_deg in BOARDS.items():
        place = (0.0, 3.0 * len(bodies), 1.0)
        bodies[name] = fixed_box(name, place, (1.2, 0.6, 0.02), euler_deg=euler_deg)
    for name, (friction, support, x_m, y_m) in BOXES.items():
        shape, under = Box(size_m=SIZES_M.get(name, CUBE_M)), bodies[support]
        height_m = shape.corners_m[:, 2].max() + under.shape.corners_m[:, 2].max()
        place = vector(under.pose.to_world(np.array([x_m, y_m, height_m])))
        pose = replace(under.pose, position_m=place)
        mass_kg = 1.0 if name in SIZES_M else 0.1
        bodies[name] = body(name, shape, pose, mass_kg=mass_kg)
        contacts.append(contact(name, support, friction=friction))
    # Supports come last.
    return lab.run([*bodies.values()][::-1], contacts, 0.5)


@check(
    "hold",
    title="friction holds",
    law="r = const if tan(slope) < mu",
    unit="mm",
    tolerance=Tolerance(
        "real cubes that hold scatter by 0.6 mm; creep must be small beside it",
        absolute=0.1,
    ),
    cause="it creeps since iterations are too few or friction is regularized, or the box sinks in",
)
def hold(lab: Lab) -> Measurement:
    """Boxes on fixed boards: two with friction 0.25 on 10 degrees (tan = 0.18), one with 1.2 on 47.5 degrees (1.09).

    Largest displacement of a box within 0.3 s.

    Source: Coulomb.
    """
    rollout = lab.once(_boxes).cut(0.0, 0.3)
    moved_mm = {name: largest_mm(rollout.displacement(name)) for name in HOLDING}
    worst = max(moved_mm, key=moved_mm.__getitem__)
    return unless_off(largest(moved_mm, "mm"), rollout, {worst: HOLDING[worst][1]})


def _frictions(rollout: Recording, names: Iterable[str]) -> Measurement:
    slides = {}
    for name in names:
        friction, support, *_ = BOXES[name]
        seen = friction_of_slide(rollout, name, support, start_s=0.0)
        slides[name] = (seen, friction, support)
    return worst_friction(rollout, slides)


@check(
    "slide",
    title="slides on 30 degrees",
    law="a = g (sin 30 - mu cos 30)",
    tolerance=FRICTION,
    cause="check how the friction of two surfaces is combined, the friction cone, and regularized friction",
)
def slide(lab: Lab) -> Measurement:
    """Cubes with frictions of 0.1 to 0.3 on two fixed boards of 30 degrees; four have their rear face at a board's end.

    Friction from the acceleration downhill over that of the pair, quadratic fit over 0.5 s; the worst of the cubes. The
    scene also has the moving slab of `slide-between`.

    Source: Coulomb; contract (Contact.friction is the pair's).
    """
    return _frictions(lab.once(_boxes), SLIDING)


@check(
    "slide-between",
    title="friction between two moving bodies",
    law="mu = (g sin 30 - a) / (g cos 30)",
    tolerance=FRICTION,
    cause="where slide passes: check the friction of a pair of two dynamic bodies",
)
def slide_between(lab: Lab) -> Measurement:
    """A cube with friction 0.1 on a slab of 1 kg, which slides with friction 0.3 down a fixed board of 30 degrees.

    Friction of the cube over that of the pair, from its acceleration downhill by a quadratic fit over 0.5 s.

    Source: Coulomb.
    """
    return _frictions(lab.once(_boxes), ["cube on the slab"])


@check(
    "slide-straight",
    title="a cube that slides does not turn about the normal",
    law="R = const about the normal",
    unit="mm",
    tolerance=Tolerance("half the scatter of the real trials", absolute=0.5),
    cause="friction acts unevenly on the contact points of a face: some come first, or iterations are few",
)
def slide_straight(lab: Lab) -> Measurement:
    """The cubes of `slide`, whose faces are square to their way.

    Largest displacement of a point 50 mm from the middle of a cube by its turn about the normal within 0.5 s.

    Source: Coulomb; the motion is symmetric.
    """
    rollout = lab.once(_boxes)
    turned_mm = {}
    for name in SLIDING:
        turns = rollout.rotation(name)
        turned = (turns[0].inv() * turns).as_rotvec()[:, 2]
        turned_mm[name] = 50.0 * float(np.abs(turned).max())
    return largest(turned_mm, "mm")


# --- spins and rolls -------------------------------------------------------------------------------------------------

SPIN_RAD_PER_S = 20.0


@check(
    "spin-on-point",
    title="a point does not resist spin",
    law="omega = const: a point has no friction torque",
    unit="rad/s",
    tolerance=Tolerance("as for a slide", absolute=0.2),
    cause="torsional friction or angular damping is not 0",
)
def spin_on_point(lab: Lab) -> Measurement:
    """A ball that spins about the vertical with 20 rad/s on a plane, with friction 0.5.

    Angular velocity about the vertical after 0.5 s.

    Source: Coulomb; contract (scene.Contact).
    """
    rollout = lab.rollout(turning_scene(0.5, 0.0, (0.0, 0.0, SPIN_RAD_PER_S)))
    measured = float(rollout.angular_velocity("ball")[-1, 2])
    return Measurement(measured=measured, expected=SPIN_RAD_PER_S)


STEM_M, TOP_KG = 0.05, 0.2
RIM_M = [
    (0.04 * np.cos(angle), 0.04 * np.sin(angle))
    for angle in np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
]
DISC = tuple((x, y, z) for x, y in RIM_M for z in (-0.01, 0.01))
CONE = ((0.0, 0.0, -STEM_M), *((0.2 * x, 0.2 * y, -0.01) for x, y in RIM_M[::4]))
TOP = ConvexUnion(pieces_m=(DISC, CONE))
TOP_RAD_PER_S, TOP_DEG, TOP_S = 120.0, 20.0, 0.6


@check(
    "spinning-top",
    title="a spinning top precesses",
    law="C s Omega - (A - C) Omega^2 cos(tilt) = m g l, tilt = const",
    tolerance=Tolerance("the turn of a tumbling body within 1 %", absolute=0.01),
    cause="the gyroscopic term is missing or of first order in the step, or the tip is not where the solid has it",
)
def spinning_top(lab: Lab) -> Measurement:
    """A disc on a pointed cone that spins with 120 rad/s, tilted by 20 degrees, on a plane without friction.

    Its centre of mass rests, and it starts in steady precession.

    Angle of precession within 0.6 s over that of the law; and the tilt at the end over that at the start.

    Source: Routh, Advanced Rigid Dynamics; without friction the centre of mass stays on a vertical.
    """
    centre, inertia = mass_properties(TOP, TOP_KG)
    moment, about = inertia[0, 0], inertia[2, 2]
    tilt = np.radians(TOP_DEG)
    arm_m = centre[2] + STEM_M
    # The smaller root is the slow precession.
    factors = (
        (moment - about) * np.cos(tilt),
        -about * TOP_RAD_PER_S,
        TOP_KG * G * arm_m,
    )
    rate = float(min(np.roots(factors).real, key=abs))
    frame = Pose.from_euler_deg((0.0, 0.0, 0.0), (TOP_DEG, 0.0, 0.0))
    axis = frame.matrix[:, 2]
    place = STEM_M * axis
    spin = TOP_RAD_PER_S * axis + rate * np.array((0.0, 0.0, 1.0))
    # The centre of mass rests, the origin beside it moves.
    velocity = -np.cross(spin, centre[2] * axis)
    start = replace(frame, position_m=vector(place))
    top = thrown(body("top", TOP, start, mass_kg=TOP_KG), velocity, spin)
    touch = contact("top", "ground", friction=0.0)
    rollout = lab.run((top, ground()), [touch], TOP_S)
    axes = rollout.rotation("top").apply((0.0, 0.0, 1.0))
    angles = np.unwrap(np.arctan2(axes[:, 1], axes[:, 0]))
    leans = np.arccos(np.clip(axes[:, 2], -1.0, 1.0))
    ratios = {
        "the precession": float(angles[-1] - angles[0]) / (rate * TOP_S),
        "the tilt": float(leans[-1] / leans[0]),
    }
    return ratio(ratios, "the motion of the top")


LEANING = Pose.from_euler_deg((0.2, -0.1, 1.0), (3.0, 2.0, 0.0))
ROLLERS: dict[str, tuple[Shape, float]] = {
    # Acceleration over g sin(slope): 1 / (1 + I / (m r^2)).
    "ball": (Sphere(radius_m=0.03), 5.0 / 7.0),
    "cylinder": (Cylinder(radius_m=0.03, length_m=0.06), 2.0 / 3.0),
}


@check(
    "roll-ball",
    title="ball and cylinder roll without rolling friction",
    law="a = 5/7 g sin(slope), 2/3 g sin(slope)",
    tolerance=Tolerance(
        "as for a slide; a rolling friction of 0.01 takes 10 %", absolute=0.01
    ),
    cause="rolling friction is not 0, the inertia is wrong, or the body slides or is damped",
)
def roll_ball(lab: Lab) -> Measurement:
    """A ball and a cylinder of 0.1 kg and radius 30 mm on a fixed plane that leans by 3.6 degrees about a diagonal.

    Acceleration downhill over that of the law, quadratic fit from 0.1 to 0.6 s; the worse of both.

    Source: rolling without slip; contract (Contact.friction is no rolling friction).
    """
    slope = Slope.of(LEANING)
    # A cylinder lies across the slope.
    frame = Rotation.from_matrix(slope.axes[[2, 0, 1]].T)
    bodies, contacts = [replace(ground(), pose=LEANING)], []
    for name, (shape, _) in ROLLERS.items():
        start = vector(LEANING.to_world(np.array([0.0, 0.3 * len(bodies), 0.03])))
        bodies.append(body(name, shape, Pose.from_rotation(start, frame)))
        contacts.append(contact(name, "ground", friction=0.5))
    rollout = lab.run(bodies, contacts, 0.6)
    shares = {}
    for name, (_, share) in ROLLERS.items():
        rate = acceleration_downhill_m_per_s2(rollout, name, "ground", start_s=0.1)
        shares[name] = rate / (share * G * np.sin(slope.angle_rad))
    worst = ratio(shares, "the acceleration")
    is_level = np.abs([*shares.values()]).max() < 0.01
    return replace(worst, cause="the plane is level" if is_level else "")


@check(
    "torsion",
    title="torsional and rolling friction",
    law="2/5 m r^2 omega' = -m g torsion; 7/5 m r^2 omega' = -m g rolling",
    tolerance=Tolerance("as for a slide", absolute=0.01),
    cause="torsional (torsion_m) or rolling friction (rolling_m) is ignored, or has another unit: it is a length",
    optional=True,
)
def torsion(lab: Lab) -> Measurement:
    """A ball that spins at 20 rad/s with a torsional friction of 0.2 mm; one that rolls at 0.3 m/s with 1 mm of it.

    Torque over the normal force from the loss of spin, linear fit over 0.5 s, over that length; the worse one.

    Source: contract (Contact.torsion_m, Contact.rolling_m).
    """
    cases = {
        "torsion_m": (2e-4, SPIN, 0.0, (0.0, 0.0, SPIN_RAD_PER_S)),
        "rolling_m": (1e-3, ROLL, 0.3, (0.0, 0.3 / RADIUS_M, 0.0)),
    }
    shares = {}
    for name, (arm_m, axis, speed, spin) in cases.items():
        rollout = lab.rollout(turning_scene(0.5, speed, spin, **{name: arm_m}))
        shares[name] = turning_arm_m(rollout, axis) / arm_m
    return ratio(shares, "the arm of the torque")
