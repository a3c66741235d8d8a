"""Friction of free bodies on fixed ones and on each other: they hold, slide, spin and roll."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Box,
    Cylinder,
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
from gauge_envs.tools.bench.parts import ball, body, contact, fixed_box, ground, thrown
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.bench.slope import (
    Slope,
    acceleration_downhill_m_per_s2,
    creep_m_per_s,
    moved_m,
    slope_of,
)
from gauge_envs.tools.bench.turning import ROLL, SPIN, turning_arm_m, turning_scene
from gauge_envs.tools.conformance.lab import Lab, largest_mm, worst_ratio
from gauge_envs.tools.conformance.model import Measurement, Tolerance, check

FRICTION = Tolerance(
    "single real slides are 5 to 14 % from the published coefficient; an engine must be well below that",
    absolute=0.01,
)
CUBE_M: Vector = (0.05, 0.05, 0.05)
FALLEN_M = 0.05
"""Distance below its support from which on a body has fallen through."""


def _board(
    name: str, y_m: float, slope_deg: float, yaw_deg: float, size_m: Vector
) -> RigidBody:
    """Return a fixed board whose x axis is downhill, turned about the vertical."""
    turn = Rotation.from_euler("ZY", [yaw_deg, slope_deg], degrees=True)
    board = fixed_box(name, (0.0, 0.0, 0.0), size_m)
    return replace(board, pose=Pose.from_rotation((0.0, y_m, 1.0), turn))


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


# --- slides ---------------------------------------------------------------------------------------------------------

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
) -> tuple[float, str]:
    """Return the friction of a slide over that of its pair, the worst of some, and what it shows.

    Args:
        rollout: The slides.
        pairs: Friction and support of each body that slides.
    """
    ratios = {}
    for name, (friction, support) in pairs.items():
        found = slide_friction(
            acceleration_downhill_m_per_s2(rollout, name, support),
            slope_of(rollout, support).angle_rad,
            gravity_m_per_s2=G,
        )
        ratios[name] = found / friction
    ratio, hint = worst_ratio(ratios, "the friction")
    for name, (friction, support) in pairs.items():
        if abs(ratios[name] - 1.0) < 0.01:
            continue
        moved = moved_m(rollout, name, support)[-1]
        if largest_mm(rollout.displacement(support)) > 1.0:
            return ratio, f"the fixed {support} moves"
        if moved[2] < -FALLEN_M:
            return (
                ratio,
                f"the {name} falls through the {support}: the pair has no contact",
            )
        if abs(moved[0]) < 1e-3:
            hint = f"the {name} does not slide"
        elif abs(ratios[name] / friction - 1.0) < 0.02:
            hint += ": the engine multiplies the values of two bodies, and friction is the pair's"
    return ratio, hint


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
    ratio, hint = _frictions(lab.once(_slides), pairs)
    return Measurement(measured=ratio, expected=1.0, hint=hint)


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
    ratio, hint = _frictions(rollout, {"cube": (0.1, "board")})
    if moved_m(rollout, "cube", "board")[-1, 2] < -0.5 * CUBE_M[2]:
        hint = (
            "the cube falls into the slab: a pair of two dynamic bodies has no contact"
        )
    return Measurement(measured=ratio, expected=1.0, hint=hint)


PUCK = Box(size_m=(0.1, 0.1, 0.02))


@dataclass(frozen=True)
class _Puck:
    """A body that slides on a level slab.

    Attributes:
        direction_deg: Direction in which it slides, from the slab's x axis.
        yaw_deg: Direction of its x axis.
        speed_m_per_s: Its speed at the start.
        friction: Friction of the pair.
        is_first: Whether the contact lists it before the slab.
        shape: Its shape.
    """

    direction_deg: float
    yaw_deg: float
    speed_m_per_s: float
    friction: float
    is_first: bool = True
    shape: Shape = PUCK


PUCKS = {
    "2 m/s along x, moving body listed first": _Puck(0.0, 0.0, 2.0, 0.2),
    "2 m/s along x, fixed body listed first": _Puck(0.0, 0.0, 2.0, 0.2, False),
    "2 m/s at 45 degrees": _Puck(45.0, 0.0, 2.0, 0.2),
    "2 m/s at 110 degrees, body turned by 65": _Puck(110.0, 65.0, 2.0, 0.3, False),
    "2 m/s at 200 degrees, body turned by 170": _Puck(200.0, 170.0, 2.0, 0.3),
    "6 m/s at 300 degrees": _Puck(300.0, 20.0, 6.0, 0.3),
    "a ball that does not roll yet, 5 m/s at 250 degrees": _Puck(
        250.0, 0.0, 5.0, 0.25, False, Sphere(radius_m=0.03)
    ),
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
    for name, puck in PUCKS.items():
        turn_rad = math.radians(SLAB_YAW_DEG + puck.direction_deg)
        ahead = np.array([math.cos(turn_rad), math.sin(turn_rad), 0.0])
        height_m = float(puck.shape.corners_m[:, 2].max())
        pose = Pose.from_euler_deg(
            (0.0, 0.0, height_m), (0.0, 0.0, SLAB_YAW_DEG + puck.yaw_deg)
        )
        one = body(name, puck.shape, pose, mass_kg=0.2)
        bodies.append(thrown(one, puck.speed_m_per_s * ahead))
        pair = (name, "slab") if puck.is_first else ("slab", name)
        contacts.append(contact(*pair, friction=puck.friction))
    rollout = lab.rollout(
        Scene(bodies=(*bodies, slab), contacts=tuple(contacts), duration_s=0.4)
    )
    ratios = {}
    for name, puck in PUCKS.items():
        start = np.array(rollout.scene.body(name).linear_velocity_m_per_s)
        along = rollout.displacement(name) @ start / puck.speed_m_per_s
        slows = -acceleration_m_per_s2(rollout.times_s, along)
        ratios[name] = slows / (puck.friction * G)
    measured, hint = worst_ratio(ratios, "the friction")
    # Boxes at one speed; the first two differ in order alone.
    boxes = list(ratios.values())[:5]
    turned = max(abs(one / boxes[0] - 1.0) for one in boxes[2:])
    if abs(boxes[1] / boxes[0] - 1.0) < 0.01 and 0.03 < turned < 0.45:
        hint += "; it depends on direction: a pyramid in place of a cone, up to sqrt 2 on its diagonals"
    return Measurement(measured=measured, expected=1.0, hint=hint)


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
    last = 1e3 * moved_m(rollout, worst, board)[-1]
    early, late = (
        1e3 * creep_m_per_s(part, worst, board, start_s=0.0)
        for part in (rollout.cut(0.05, 0.15), rollout.cut(0.2, HOLD_S))
    )
    hint = f"the {worst} moves by {moved_mm[worst]:.3g} mm"
    if last[2] < -1e3 * FALLEN_M:
        hint = f"the {worst} falls through its board: the pair has no contact"
    elif late > 1.5 * early > 1.0:
        hint = f"the {worst} slides, faster and faster: its friction is lower than that of the pair"
    elif last[0] > 2.0 * abs(last[2]):
        hint = f"the {worst} creeps at {late:.3g} mm/s: friction is regularized, or the solver has too few iterations"
    return Measurement(measured=moved_mm[worst], hint=hint)


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
    top = thrown(
        ball("top", (0.0, 0.0, RADIUS_M)), (0.0, 0.0, 0.0), (0.0, 0.0, SPIN_RAD_PER_S)
    )
    rollout = lab.rollout(
        Scene(
            bodies=(top, ground()),
            contacts=(contact("top", "ground", friction=0.5),),
            duration_s=0.5,
        )
    )
    measured = float(rollout.angular_velocity("top")[-1, 2])
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
    slides_m_per_s2 = G * math.sin(slope.angle_rad)
    shares = {
        name: acceleration_downhill_m_per_s2(rollout, name, "plane", start_s=0.1)
        / slides_m_per_s2
        for name in ROLLERS
    }
    ratio, hint = worst_ratio(
        {name: shares[name] / ROLLERS[name][1] for name in ROLLERS}, "the acceleration"
    )
    worst = max(ROLLERS, key=lambda name: abs(shares[name] / ROLLERS[name][1] - 1.0))
    if moved_m(rollout, worst, "plane")[-1, 2] < -FALLEN_M:
        hint = f"the {worst} falls through the plane: the pair has no contact"
    elif abs(shares[worst]) < 0.02:
        hint = f"the {worst} does not roll: the leaning plane is level, or rolling friction holds it"
    elif abs(shares[worst] - 1.0) < 0.02:
        hint = f"the {worst} slides and does not roll: friction has no effect"
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
