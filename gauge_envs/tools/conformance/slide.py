"""Friction of free bodies on fixed ones and on each other: they hold, slide, spin and roll."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Box,
    Cylinder,
    Motion,
    Pose,
    RigidBody,
    Scene,
    Shape,
    Sphere,
    Vector,
)
from gauge_envs.scene.geometry import vector
from gauge_envs.scoring.estimators import acceleration_m_per_s2, slide_friction
from gauge_envs.tools.bench.drop import RADIUS_M
from gauge_envs.tools.bench.parts import body, contact, fixed_box, ground, thrown
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.bench.slope import (
    Slope,
    acceleration_downhill_m_per_s2,
    moved_m,
    slope_of,
)
from gauge_envs.tools.bench.turning import ROLL, SPIN, turning_arm_m, turning_scene
from gauge_envs.tools.conformance.drive import worst_friction
from gauge_envs.tools.conformance.lab import Lab, largest_mm, worst_ratio
from gauge_envs.tools.conformance.model import Measurement, Tolerance, check

FRICTION = Tolerance(
    "single real slides are 5 to 14 % from the published coefficient; an engine must be well below that",
    absolute=0.01,
)
CUBE_M: Vector = (0.05, 0.05, 0.05)


def _board(
    name: str, y_m: float, slope_deg: float, yaw_deg: float, size_m: Vector
) -> RigidBody:
    """Return a fixed board whose x axis is downhill, turned about the vertical."""
    turn = Rotation.from_euler("ZY", [yaw_deg, slope_deg], degrees=True)
    pose = Pose.from_rotation((0.0, y_m, 1.0), turn)
    return body(name, Box(size_m=size_m), pose, mass_kg=1.0, motion=Motion.FIXED)


def _on(
    board: RigidBody,
    name: str,
    size_m: Vector,
    x_m: float,
    y_m: float = 0.0,
    mass_kg: float = 0.1,
) -> RigidBody:
    """Return a box on a board, at a place on it."""
    assert isinstance(board.shape, Box), "boards are boxes"
    height_m = 0.5 * (size_m[2] + board.shape.size_m[2])
    pose = replace(
        board.pose,
        position_m=vector(board.pose.to_world(np.array([x_m, y_m, height_m]))),
    )
    return body(name, Box(size_m=size_m), pose, mass_kg=mass_kg)


def _falls(rollout: Recording, name: str, support: str) -> str:
    """Return what is wrong where a body does not stay on its support; empty where it does."""
    fallen_m = -moved_m(rollout, name, support)[-1, 2]
    if fallen_m < 0.001:
        return ""
    cosine = math.cos(slope_of(rollout, support).angle_rad)
    if fallen_m > 0.45 * G * cosine * rollout.times_s[-1] ** 2:
        return f"the {name} falls through the {support}: the pair has no contact"
    return f"the {name} leaves the {support}: one of them has another size, place or orientation"


# --- rest on slopes --------------------------------------------------------------------------------------------------

HOLD_S = 0.3
HELD = {
    # Friction, slope and direction of the board [deg], size [m] and mass [kg] of the box.
    "cube on 10 degrees": (0.25, 10.0, 0.0, CUBE_M, 0.1),
    "box of 1 kg on 10 degrees, turned": (0.25, 10.0, 35.0, (0.1, 0.06, 0.04), 1.0),
    "slab on 47.5 degrees": (1.2, 47.5, 0.0, (0.08, 0.08, 0.02), 0.1),
}


@check(
    "hold",
    title="friction holds",
    law="r = const if tan(slope) < mu",
    source="Coulomb",
    unit="mm",
    tolerance=Tolerance(
        "real cubes that hold scatter by 0.6 mm; creep must be small beside it",
        absolute=0.1,
    ),
    cause="static friction is regularized and creeps, or the box sinks in",
)
def hold(lab: Lab) -> Measurement:
    """Boxes on fixed boards: two with friction 0.25 on 10 degrees (tan = 0.18), one with 1.2 on 47.5 degrees (1.09).

    Largest displacement of a box within 0.3 s.
    """
    boards, boxes, contacts = [], [], []
    for number, (name, (friction, slope_deg, yaw_deg, size_m, mass_kg)) in enumerate(
        HELD.items()
    ):
        board = f"board {number}"
        boards.append(_board(board, 2.0 * number, slope_deg, yaw_deg, (0.6, 0.4, 0.02)))
        boxes.append(_on(boards[-1], name, size_m, -0.1, mass_kg=mass_kg))
        contacts.append(contact(name, board, friction=friction))
    rollout = lab.rollout(
        Scene(bodies=(*boxes, *boards), contacts=tuple(contacts), duration_s=HOLD_S)
    )
    moved_mm = {name: largest_mm(rollout.displacement(name)) for name in HELD}
    worst = max(moved_mm, key=lambda name: moved_mm[name])
    board = f"board {[*HELD].index(worst)}"
    downhill_m, _, off_m = moved_m(rollout, worst, board)[-1]
    rate = acceleration_downhill_m_per_s2(rollout, worst, board)
    hint = f"the {worst} moves by {moved_mm[worst]:.3g} mm"
    if rate * HOLD_S**2 > downhill_m > 1e-4:
        hint = f"the {worst} slides at {rate:.3g} m/s^2: its friction is less than that of the pair"
    elif downhill_m > 2.0 * abs(off_m):
        hint += f", creeps at {1e3 * downhill_m / HOLD_S:.3g} mm/s: too few iterations, or friction is regularized"
    hint = _falls(rollout, worst, board) or hint
    return Measurement(measured=moved_mm[worst], hint=hint)


# --- slides on a level slab ------------------------------------------------------------------------------------------

PUCK, BALL = Box(size_m=(0.1, 0.1, 0.02)), Sphere(radius_m=0.03)
PUCKS: dict[str, tuple[float, float, float, float, bool, Shape]] = {
    # Direction and yaw from the slab's x axis [deg], speed [m/s], friction, whether it is listed first, and shape.
    "2 m/s along x, moving body listed first": (0.0, 0.0, 2.0, 0.2, True, PUCK),
    "2 m/s along x, fixed body listed first": (0.0, 0.0, 2.0, 0.2, False, PUCK),
    "2 m/s at 45 degrees": (45.0, 0.0, 2.0, 0.2, True, PUCK),
    "2 m/s at 110 degrees, body turned by 65": (110.0, 65.0, 2.0, 0.3, False, PUCK),
    "2 m/s at 200 degrees, body turned by 170": (200.0, 170.0, 2.0, 0.3, True, PUCK),
    "6 m/s at 300 degrees": (300.0, 20.0, 6.0, 0.3, True, PUCK),
    "a ball without spin, 5 m/s at 250 degrees": (250.0, 0.0, 5.0, 0.25, False, BALL),
}
SLAB_YAW_DEG = 25.0


@check(
    "pucks-friction",
    title="friction in all directions, at all speeds, in both orders, of all shapes",
    law="a = mu g, in each direction and at each speed",
    source="Coulomb",
    tolerance=FRICTION,
    cause="friction depends on speed, direction, shape or on which body is listed first",
)
def pucks_friction(lab: Lab) -> Measurement:
    """Six flat boxes and a ball without spin that slide on a fixed, level slab, which is turned by 25 degrees.

    Deceleration over mu g, quadratic fit over 0.4 s, the worst of them; a ball slides until its speed is 5/7.
    """
    slab = fixed_box(
        "slab", (0.0, 0.0, -0.05), (12.0, 12.0, 0.1), euler_deg=(0.0, 0.0, SLAB_YAW_DEG)
    )
    bodies, contacts = [], []
    for name, (way_deg, yaw_deg, speed, friction, is_first, shape) in PUCKS.items():
        way_rad = math.radians(SLAB_YAW_DEG + way_deg)
        ahead = np.array([math.cos(way_rad), math.sin(way_rad), 0.0])
        place = (0.0, 0.0, float(shape.corners_m[:, 2].max()))
        pose = Pose.from_euler_deg(place, (0.0, 0.0, SLAB_YAW_DEG + yaw_deg))
        bodies.append(thrown(body(name, shape, pose, mass_kg=0.2), speed * ahead))
        pair = (name, "slab") if is_first else ("slab", name)
        contacts.append(contact(*pair, friction=friction))
    rollout = lab.rollout(
        Scene(bodies=(*bodies, slab), contacts=tuple(contacts), duration_s=0.4)
    )
    ratios = {}
    for name, (_, _, speed, friction, *_) in PUCKS.items():
        start = np.array(rollout.scene.body(name).linear_velocity_m_per_s)
        along = rollout.displacement(name) @ start / speed
        slows = -acceleration_m_per_s2(rollout.times_s, along)
        ratios[name] = slows / (friction * G)
    found = worst_friction(ratios, {name: row[3] for name, row in PUCKS.items()})
    # Boxes at one speed; the first two differ in order alone.
    boxes = list(ratios.values())[:5]
    turned = max(abs(one / boxes[0] - 1.0) for one in boxes[2:])
    hint = next(filter(None, (_falls(rollout, name, "slab") for name in PUCKS)), "")
    if abs(boxes[1] / boxes[0] - 1.0) < 0.01 and 0.03 < turned < 0.45:
        hint = f"{found.hint}: it depends on direction, as a pyramid in place of a cone does (sqrt 2 on its diagonals)"
    return replace(found, hint=hint or found.hint)


# --- slides on slopes ------------------------------------------------------------------------------------------------

SLOPE_DEG, END_M = 30.0, 0.6
"""Slope of the boards, and distance of their ends from their centres."""

FLUSH_M = 1e-7
SLIDERS = {
    # Friction, board, and place of the centre along it [m] and across.
    "smooth cube": (0.1, "board", -0.4, -0.2),
    "rough cube": (0.3, "board", -0.4, -0.1),
    "flush cube": (0.2, "board", -END_M + 0.025, 0.0),
    "cube that starts 0.1 um inside the end": (
        0.2,
        "board",
        -END_M + 0.025 + FLUSH_M,
        0.1,
    ),
    "cube that starts 0.1 um outside the end": (
        0.2,
        "board",
        -END_M + 0.025 - FLUSH_M,
        0.2,
    ),
    "cube on the turned board": (0.25, "turned board", -0.4, -0.1),
    "flush cube on the turned board": (0.15, "turned board", -END_M + 0.025, 0.1),
}


def _slides(lab: Lab) -> Recording:
    boards = {
        name: _board(name, y_m, SLOPE_DEG, yaw_deg, (2.0 * END_M, 0.6, 0.02))
        for name, y_m, yaw_deg in (("board", 0.0, 0.0), ("turned board", 3.0, 50.0))
    }
    cubes = [
        _on(boards[board], name, CUBE_M, x_m, y_m)
        for name, (_, board, x_m, y_m) in SLIDERS.items()
    ]
    # The first board follows its two cubes, as in a scene of three bodies.
    bodies = (*cubes[:2], boards["board"], *cubes[2:], boards["turned board"])
    contacts = tuple(
        contact(name, board, friction=friction)
        for name, (friction, board, _, _) in SLIDERS.items()
    )
    return lab.rollout(Scene(bodies=bodies, contacts=contacts, duration_s=0.5))


def _frictions(
    rollout: Recording, pairs: Mapping[str, tuple[float, str]]
) -> Measurement:
    """Measure the friction of slides over that of their pairs, the worst of some.

    Args:
        rollout: The slides.
        pairs: Friction and support of each body that slides.
    """
    ratios = {}
    for name, (friction, support) in pairs.items():
        rate = acceleration_downhill_m_per_s2(rollout, name, support)
        found = slide_friction(rate, math.radians(SLOPE_DEG), gravity_m_per_s2=G)
        ratios[name] = found / friction
    worst = worst_friction(ratios, {name: row[0] for name, row in pairs.items()})
    for name, (_, support) in pairs.items():
        hint = _falls(rollout, name, support)
        if moved_m(rollout, name, support)[-1, 0] < 1e-3:
            hint = f"the {name} does not slide"
        if hint:
            return replace(worst, hint=hint)
    return worst


@check(
    "slide",
    title="slides on 30 degrees",
    law="a = g (sin 30 - mu cos 30)",
    source="Coulomb; contract (Contact.friction is the pair's)",
    tolerance=FRICTION,
    cause="check how the friction of two surfaces is combined, the friction cone, and regularized friction",
)
def slide(lab: Lab) -> Measurement:
    """Cubes with frictions of 0.1 to 0.3 on two fixed boards of 30 degrees; four have their rear face at a board's end.

    Friction from the acceleration downhill over that of the pair, quadratic fit over 0.5 s; the worst of the cubes.
    """
    pairs = {name: row[:2] for name, row in SLIDERS.items()}
    return _frictions(lab.once(_slides), pairs)


@check(
    "slide-between",
    title="friction between two moving bodies",
    law="mu = (g sin 30 - a) / (g cos 30)",
    source="Coulomb",
    tolerance=FRICTION,
    cause="where slide passes: check the friction of a pair of two dynamic bodies",
)
def slide_between(lab: Lab) -> Measurement:
    """A cube with friction 0.1 on a slab of 1 kg, which slides with friction 0.3 down a fixed board of 30 degrees.

    Friction of the cube over that of the pair, from its acceleration downhill by a quadratic fit over 0.35 s.
    """
    board = _board("board", 0.0, SLOPE_DEG, 0.0, (1.2, 0.6, 0.02))
    slab = _on(board, "slab", (0.3, 0.2, 0.03), -0.4, mass_kg=1.0)
    cube = _on(slab, "cube", CUBE_M, -0.1)
    rollout = lab.rollout(
        Scene(
            bodies=(cube, slab, board),
            contacts=(
                contact("cube", "slab", friction=0.1),
                contact("slab", "board", friction=0.3),
            ),
            duration_s=0.35,
        )
    )
    return _frictions(rollout, {"cube": (0.1, "slab")})


# --- spins and rolls -------------------------------------------------------------------------------------------------

SPIN_RAD_PER_S = 20.0


@check(
    "spin-on-point",
    title="a point does not resist spin",
    law="omega = const: a point has no friction torque",
    source="Coulomb; contract (scene.Contact)",
    unit="rad/s",
    tolerance=Tolerance("as for a slide", absolute=0.2),
    cause="torsional friction or angular damping is not 0",
)
def spin_on_point(lab: Lab) -> Measurement:
    """A ball that spins about the vertical with 20 rad/s on a plane, with friction 0.5.

    Angular velocity about the vertical after 0.5 s.
    """
    rollout = lab.rollout(turning_scene(0.5, 0.0, (0.0, 0.0, SPIN_RAD_PER_S)))
    measured = float(rollout.angular_velocity("ball")[-1, 2])
    return Measurement(measured=measured, expected=SPIN_RAD_PER_S)


LEANING = Pose.from_euler_deg((0.2, -0.1, 1.0), (3.0, 2.0, 0.0))
ROLL_S, ROLL_RADIUS_M = 0.6, 0.03
ROLLERS: dict[str, tuple[Shape, float]] = {
    # Acceleration over g sin(slope): 1 / (1 + I / (m r^2)).
    "ball": (Sphere(radius_m=ROLL_RADIUS_M), 5.0 / 7.0),
    "cylinder": (Cylinder(radius_m=ROLL_RADIUS_M, length_m=0.06), 2.0 / 3.0),
}


@check(
    "roll-ball",
    title="ball and cylinder roll without rolling friction",
    law="a = 5/7 g sin(slope), 2/3 g sin(slope)",
    source="rolling without slip; contract (Contact.friction is no rolling friction)",
    tolerance=Tolerance(
        "as for a slide; a rolling friction of 0.01 takes 10 %", absolute=0.01
    ),
    cause="rolling friction is not 0, the inertia or the radius is wrong, or the body is damped",
)
def roll_ball(lab: Lab) -> Measurement:
    """A ball and a cylinder of 0.1 kg and radius 30 mm on a fixed plane that leans by 3.6 degrees about a diagonal.

    Acceleration downhill over that of the law, quadratic fit from 0.1 to 0.6 s; the worse of both.
    """
    slope = Slope.of(LEANING)
    downhill, across, normal = slope.axes
    # A cylinder lies across the slope.
    frame = Rotation.from_matrix(np.column_stack([downhill, normal, -across]))
    bodies, contacts = [replace(ground(), name="plane", pose=LEANING)], []
    for number, (name, (shape, _)) in enumerate(ROLLERS.items()):
        start = LEANING.position_m + ROLL_RADIUS_M * normal + 0.3 * number * across
        bodies.append(body(name, shape, Pose.from_rotation(vector(start), frame)))
        contacts.append(contact(name, "plane", friction=0.5))
    rollout = lab.rollout(
        Scene(bodies=tuple(bodies), contacts=tuple(contacts), duration_s=ROLL_S)
    )
    sliding = G * math.sin(slope.angle_rad)
    ratios = {
        name: acceleration_downhill_m_per_s2(rollout, name, "plane", start_s=0.1)
        / (share * sliding)
        for name, (_, share) in ROLLERS.items()
    }
    ratio, hint = worst_ratio(ratios, "the acceleration")
    if abs(ratio) < 0.02:
        hint += ": the leaning plane is level, or rolling friction holds"
    elif min(abs(ratio * share - 1.0) for _, share in ROLLERS.values()) < 0.02:
        hint += ": it slides and does not roll, so that friction has no effect"
    return Measurement(measured=ratio, expected=1.0, hint=hint)


ARM_M, ROLLS_M_PER_S = {"torsion_m": 2e-4, "rolling_m": 1e-3}, 0.3


@check(
    "torsion",
    title="torsional and rolling friction",
    law="2/5 m r^2 omega' = -m g torsion; 7/5 m r^2 omega' = -m g rolling",
    source="contract (Contact.torsion_m, Contact.rolling_m)",
    tolerance=Tolerance("as for a slide", absolute=0.01),
    cause="check the unit (a length, or a share of the friction), and that contacts resist spin and rolling",
    optional=True,
)
def torsion(lab: Lab) -> Measurement:
    """A ball that spins at 20 rad/s with a torsional friction of 0.2 mm; one that rolls at 0.3 m/s with 1 mm of it.

    Torque over the normal force from the loss of spin, linear fit over 0.5 s, over that length; the worse one.
    """
    starts = {
        "torsion_m": (SPIN, 0.0, (0.0, 0.0, SPIN_RAD_PER_S)),
        "rolling_m": (ROLL, ROLLS_M_PER_S, (0.0, ROLLS_M_PER_S / RADIUS_M, 0.0)),
    }
    ratios = {}
    for name, (axis, speed, spin) in starts.items():
        rollout = lab.rollout(turning_scene(0.5, speed, spin, **{name: ARM_M[name]}))
        ratios[name] = turning_arm_m(rollout, axis) / ARM_M[name]
    ratio, hint = worst_ratio(ratios, "the arm of the torque")
    return Measurement(measured=ratio, expected=1.0, hint=hint)
