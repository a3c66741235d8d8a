"""Rich scenes: many directions, speeds, orders and times at once; each is compared with one law or symmetry.

A law that holds for one body in one direction holds for all: the check reports the worst of them, and its hint says
what sets that one apart. So a scene sees faults that depend on direction, speed, time, or which body is listed first.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.evaluation.estimators import acceleration_m_per_s2
from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Box,
    Contact,
    ConvexUnion,
    Cylinder,
    Hinge,
    Motion,
    Pose,
    RigidBody,
    Scene,
    Shape,
    Sphere,
    Tether,
    body_mass_properties,
)
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.geometry import vector
from gauge_envs.tools.bench.parts import (
    ball,
    body,
    box,
    contact,
    driven_box,
    driver,
    fixed_box,
    ramp,
)
from gauge_envs.tools.conformance.laws import (
    largest_mm,
    spin_from_orientations,
    worst_ratio,
)
from gauge_envs.tools.conformance.model import Measurement, rollout_of

Array = NDArray[np.float64]


def _thrown(one: RigidBody, velocity: Any, spin: Any = (0.0, 0.0, 0.0)) -> RigidBody:
    """Return a body that starts with a velocity [m/s] and an angular velocity [rad/s]."""
    return replace(
        one,
        linear_velocity_m_per_s=vector(velocity),
        angular_velocity_rad_per_s=vector(spin),
    )


# --- free motion, fast, slow and late --------------------------------------------------------------------------------

GLIDE_S = 2.6
DIRECTION = np.array([0.6, -0.64, 0.48])
GLIDES = {
    "20 m/s": 20.0 * DIRECTION,
    "13 m/s": -13.0 * DIRECTION,
    "0.1 m/s": 0.1 * DIRECTION,
    "4 mm/s": -0.004 * DIRECTION,
}
RATES = {"+14 rad/s": 14.0, "-5 rad/s": -5.0, "+0.05 rad/s": 0.05}
AXIS = np.array([0.48, 0.6, 0.64])
SPIN_RAD_PER_S = 45.0
LEAST = {"velocity": 0.1, "angular velocity": 0.5}
"""Scales below which rates are not compared relatively [m/s, rad/s]."""


def _hinged(name: str, rate: float, place: Array) -> tuple[RigidBody, Hinge]:
    """Return a bar on a hinge through its centre, which starts with a rate [rad/s]."""
    pose = Pose.from_euler_deg(vector(place), (20.0, -35.0, 50.0))
    one = body(name, Box(size_m=(0.2, 0.03, 0.04)), pose)
    hinge = Hinge(body=name, anchor_m=vector(place), axis=vector(AXIS))
    return _thrown(one, np.zeros(3), rate * AXIS), hinge


def _glide_scene() -> Scene:
    # Near the origin single precision resolves the steps of the slowest ball.
    balls = [
        _thrown(ball(name, (0.0, 0.0, 0.0)), velocity)
        for name, velocity in GLIDES.items()
    ]
    spinning = _thrown(
        ball("spinning ball", (2.0, 0.0, 1.0)), np.zeros(3), SPIN_RAD_PER_S * AXIS
    )
    bars = [
        _hinged(name, rate, np.array([3.0, 0.5 * index, 1.0]))
        for index, (name, rate) in enumerate(RATES.items())
    ]
    return Scene(
        bodies=(*balls, spinning, *(bar for bar, _ in bars)),
        joints=tuple(hinge for _, hinge in bars),
        duration_s=GLIDE_S,
        gravity_m_per_s2=0.0,
    )


_glide = rollout_of(
    "balls thrown with 4 mm/s to 20 m/s, one that spins, and bars on hinges through their centres that turn both ways, "
    "without gravity and contacts, for 2.6 s",
    _glide_scene(),
)


@_glide.check("glide-speed")
def _glide_speed(rollout: Rollout) -> Measurement:
    ratios = {}
    for name, velocity in GLIDES.items():
        for start_s, end_s in ((0.0, 0.8), (0.8, 1.8), (2.1, GLIDE_S)):
            first, last = rollout.sample_at(start_s), rollout.sample_at(end_s)
            moved = rollout.position(name)[last] - rollout.position(name)[first]
            seconds = float(rollout.times_s[last] - rollout.times_s[first])
            law = seconds * velocity
            ratios[f"{name} from {start_s:g} to {end_s:g} s"] = float(
                moved @ law / (law @ law)
            )
    return worst_ratio(ratios, "the speed is")


@_glide.check("glide-turn")
def _glide_turn(rollout: Rollout) -> Measurement:
    rates = RATES | {"spinning ball": SPIN_RAD_PER_S}
    ratios = {}
    for name, rate in rates.items():
        rotations = rollout.rotation(name)
        steps = (rotations[1:] * rotations[:-1].inv()).as_rotvec() @ AXIS
        for start_s, end_s in ((0.0, 1.0), (2.1, GLIDE_S)):
            part = slice(rollout.sample_at(start_s), rollout.sample_at(end_s))
            ratios[f"{name} from {start_s:g} to {end_s:g} s"] = float(
                steps[part].mean() / rollout.interval_s / rate
            )
    found = worst_ratio(ratios, "the rate of rotation is")
    free, hinged = (
        max(
            abs(ratio - 1.0)
            for name, ratio in ratios.items()
            if ("ball" in name) is is_free
        )
        for is_free in (True, False)
    )
    where = ""
    if hinged > 10.0 * free:
        where = (
            "; bodies on hinges alone are slowed: dry or viscous friction of the joint"
        )
    elif free > 10.0 * hinged:
        where = "; free bodies alone are slowed: angular damping"
    return replace(found, hint=found.hint + where)


@_glide.check("glide-reports")
def _glide_reports(rollout: Rollout) -> Measurement:
    errors = {}
    for one in rollout.scene.bodies:
        turns = rollout.rotation(one.name)
        moved = {
            "velocity": np.gradient(
                rollout.position(one.name), rollout.times_s, axis=0
            ),
            "angular velocity": spin_from_orientations(turns, rollout.interval_s),
        }
        reported = {
            "velocity": rollout.velocity(one.name)[1:-1],
            "angular velocity": rollout.angular_velocity(one.name)[1:-1],
        }
        moved["velocity"] = moved["velocity"][1:-1]
        for kind, rate in moved.items():
            scale = max(float(np.linalg.norm(rate, axis=1).max()), LEAST[kind])
            off = np.linalg.norm(reported[kind] - rate, axis=1).max() / scale
            errors[f"{kind} of {one.name}"] = float(off)
    worst = max(errors, key=lambda one: np.nan_to_num(errors[one], nan=np.inf))
    hint = f"the reported {worst} is not the one with which it moves"
    return Measurement(measured=100.0 * errors[worst], hint=hint)


# --- rebounds in both orders of the pair, at all speeds, early and late ----------------------------------------------


@dataclass(frozen=True)
class _Shot:
    """A ball that hits a wall, or a resting ball.

    Attributes:
        speed_m_per_s: Its speed.
        restitution: Restitution of the pair.
        at_s: Time of the impact [s].
        is_first: Whether the contact lists it before what it hits.
        hits_ball: Whether it hits a resting ball of twice its mass instead of the wall.
    """

    speed_m_per_s: float
    restitution: float
    at_s: float
    is_first: bool
    hits_ball: bool = False


SHOTS = {
    "2 m/s, moving body listed first": _Shot(2.0, 0.6, 0.2, True),
    "2 m/s, fixed body listed first": _Shot(2.0, 0.6, 0.2, False),
    "2 m/s on a resting ball": _Shot(2.0, 0.7, 0.2, True, True),
    "2 m/s on a resting ball, which is listed first": _Shot(2.0, 0.7, 0.2, False, True),
    "7 m/s": _Shot(7.0, 0.5, 0.1, True),
    "11 m/s": _Shot(11.0, 0.5, 0.1, False),
    "16 m/s": _Shot(16.0, 0.8, 0.1, True),
    "0.5 m/s after 1.4 s": _Shot(0.5, 0.6, 1.4, True),
    "0.5 m/s after 2.3 s": _Shot(0.5, 0.6, 2.3, False),
}
SHOT_RADIUS_M, SHOT_MASS_KG, VOLLEY_S = 0.06, 0.1, 2.5


def _volley_scene() -> Scene:
    bodies: list[RigidBody] = []
    contacts = []
    for index, (name, shot) in enumerate(SHOTS.items()):
        y = 0.4 * index
        gap_m = shot.speed_m_per_s * shot.at_s + SHOT_RADIUS_M * (1 + shot.hits_ball)
        one = ball(name, (-gap_m, y, 1.0), radius_m=SHOT_RADIUS_M, mass_kg=SHOT_MASS_KG)
        bodies.append(_thrown(one, (shot.speed_m_per_s, 0.0, 0.0)))
        other = "wall"
        if shot.hits_ball:
            other = f"target of {name}"
            bodies.append(
                ball(
                    other,
                    (0.0, y, 1.0),
                    radius_m=SHOT_RADIUS_M,
                    mass_kg=2.0 * SHOT_MASS_KG,
                )
            )
        pair = (name, other) if shot.is_first else (other, name)
        contacts.append(contact(*pair, friction=0.3, restitution=shot.restitution))
    width = 0.4 * len(SHOTS) + 1.0
    wall = fixed_box("wall", (0.2, 0.5 * width - 0.7, 1.0), (0.4, width, 0.6))
    return Scene(
        bodies=(*bodies, wall),
        contacts=tuple(contacts),
        duration_s=VOLLEY_S,
        gravity_m_per_s2=0.0,
    )


_volley = rollout_of(
    "balls of 0.1 kg that hit a wall or a resting ball of 0.2 kg with 0.5 to 16 m/s, early and late, and listed first "
    "or second in their contact; no gravity",
    _volley_scene(),
)


def _restitution(rollout: Rollout, name: str) -> float:
    shot = SHOTS[name]
    other = f"target of {name}" if shot.hits_ball else "wall"
    apart = rollout.velocity(other)[:, 0] - rollout.velocity(name)[:, 0]
    after = rollout.sample_at(min(shot.at_s + 0.1, VOLLEY_S))
    return float(apart[after] / shot.speed_m_per_s)


def _volley_check(id: str, names: list[str]) -> None:
    @_volley.check(id)
    def measure(rollout: Rollout) -> Measurement:
        ratios = {
            name: _restitution(rollout, name) / SHOTS[name].restitution
            for name in names
        }
        return worst_ratio(ratios, "the rebound is")


_volley_check("volley-order", [name for name in SHOTS if name.startswith("2 ")])
_volley_check(
    "volley-fast",
    [name for name, shot in SHOTS.items() if shot.speed_m_per_s > 5.0],
)
_volley_check("volley-late", [name for name in SHOTS if name.startswith("0.5")])


@_volley.check("volley-momentum")
def _volley_momentum(rollout: Rollout) -> Measurement:
    ratios = {}
    for name, shot in SHOTS.items():
        if shot.hits_ball:
            ball_speed, target = (
                rollout.velocity(one)[-1, 0] for one in (name, f"target of {name}")
            )
            ratios[name] = float((ball_speed + 2.0 * target) / shot.speed_m_per_s)
    return worst_ratio(ratios, "the momentum is")


# --- edges that cross ------------------------------------------------------------------------------------------------

BAR_M, EDGE_SPEED_M_PER_S, EDGE_RESTITUTION = (0.3, 0.04, 0.04), 0.6, 0.5
CROSSING_DEG = 70.0


def _bar(name: str, place: Any, yaw_deg: float) -> RigidBody:
    """Return a bar that has an edge at its lowest and highest line."""
    turn = Rotation.from_euler("xz", [45.0, yaw_deg], degrees=True)
    return body(name, Box(size_m=BAR_M), Pose.from_rotation(vector(place), turn))


def _crossed_scene() -> Scene:
    apart = math.sqrt(2.0) * BAR_M[1] + 0.02
    bodies, contacts = [], []
    for index, motion in enumerate((Motion.FIXED, Motion.DYNAMIC)):
        x = 0.6 * index
        lower = replace(_bar(f"{motion.value} bar", (x, 0.0, 1.0), 15.0), motion=motion)
        upper = _bar(f"bar on the {lower.name}", (x, 0.0, 1.0 + apart), CROSSING_DEG)
        bodies += [lower, _thrown(upper, (0.0, 0.0, -EDGE_SPEED_M_PER_S))]
        pair = (upper.name, lower.name)[:: 1 - 2 * index]
        contacts.append(contact(*pair, friction=0.3, restitution=EDGE_RESTITUTION))
    return Scene(
        bodies=tuple(bodies),
        contacts=tuple(contacts),
        duration_s=0.2,
        gravity_m_per_s2=0.0,
    )


@rollout_of(
    "two bars, edge down, that meet the upper edge of a fixed and of a free bar across at 0.6 m/s; no gravity",
    _crossed_scene(),
).check("crossed-edges")
def _crossed_edges(rollout: Rollout) -> Measurement:
    ratios = {}
    for lower in ("fixed bar", "dynamic bar"):
        upper = f"bar on the {lower}"
        apart = rollout.velocity(upper)[-1, 2] - rollout.velocity(lower)[-1, 2]
        ratios[f"the {upper}"] = float(apart / EDGE_SPEED_M_PER_S / EDGE_RESTITUTION)
    found = worst_ratio(ratios, "the rebound is")
    if found.measured < -1.0:
        return replace(
            found, hint="the bars fall through each other: edges have no contact"
        )
    return found


# --- friction in all directions --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Puck:
    """A flat box that slides on a level slab.

    Attributes:
        direction_deg: Direction in which it slides, from the slab's x axis.
        yaw_deg: Direction of its own x axis.
        speed_m_per_s: Its speed at the start.
        friction: Friction of the pair.
        is_first: Whether the contact lists it before the slab.
    """

    direction_deg: float
    yaw_deg: float
    speed_m_per_s: float
    friction: float
    is_first: bool


PUCKS = {
    "2 m/s along x, moving body listed first": _Puck(0.0, 0.0, 2.0, 0.2, True),
    "2 m/s along x, fixed body listed first": _Puck(0.0, 0.0, 2.0, 0.2, False),
    "2 m/s at 45 degrees": _Puck(45.0, 0.0, 2.0, 0.2, True),
    "2 m/s at 110 degrees, body turned by 65": _Puck(110.0, 65.0, 2.0, 0.3, False),
    "2 m/s at 200 degrees, body turned by 170": _Puck(200.0, 170.0, 2.0, 0.3, True),
    "6 m/s at 300 degrees": _Puck(300.0, 20.0, 6.0, 0.3, True),
}
PUCK_M = (0.1, 0.1, 0.02)
SLAB_YAW_DEG = 25.0


def _pucks_scene() -> Scene:
    slab = fixed_box(
        "slab", (0.0, 0.0, -0.05), (12.0, 12.0, 0.1), euler_deg=(0.0, 0.0, SLAB_YAW_DEG)
    )
    bodies, contacts = [], []
    for name, puck in PUCKS.items():
        turn = SLAB_YAW_DEG + puck.direction_deg
        ahead = Rotation.from_euler("z", turn, degrees=True).apply([1.0, 0.0, 0.0])
        one = box(
            name,
            (0.0, 0.0, 0.5 * PUCK_M[2]),
            PUCK_M,
            euler_deg=(0.0, 0.0, SLAB_YAW_DEG + puck.yaw_deg),
        )
        bodies.append(_thrown(one, puck.speed_m_per_s * ahead))
        pair = (name, "slab") if puck.is_first else ("slab", name)
        contacts.append(contact(*pair, friction=puck.friction))
    return Scene(bodies=(*bodies, slab), contacts=tuple(contacts), duration_s=0.4)


_pucks = rollout_of(
    "six flat boxes that slide on a level slab in several directions, some turned, some listed second in their "
    "contact; 2 and 6 m/s",
    _pucks_scene(),
)


def _along(rollout: Rollout, name: str) -> Array:
    """Return the displacement along and across the start velocity [m], shape [T, 2]."""
    ahead = np.array(rollout.scene.body(name).linear_velocity_m_per_s)
    ahead = ahead / np.linalg.norm(ahead)
    side = np.cross([0.0, 0.0, 1.0], ahead)
    return np.asarray(rollout.displacement(name) @ np.column_stack([ahead, side]))


@_pucks.check("pucks-friction")
def _pucks_friction(rollout: Rollout) -> Measurement:
    ratios = {}
    for name, puck in PUCKS.items():
        slows = -acceleration_m_per_s2(rollout.times_s, _along(rollout, name)[:, 0])
        ratios[name] = slows / (puck.friction * G)
    return worst_ratio(ratios, "the friction is")


@_pucks.check("pucks-straight")
def _pucks_straight(rollout: Rollout) -> Measurement:
    sides = {name: np.abs(_along(rollout, name)[:, 1]).max() for name in PUCKS}
    worst = max(sides, key=lambda one: sides[one])
    return Measurement(
        measured=1e3 * float(sides[worst]),
        hint=f"furthest off its line: {worst}; friction acts across the velocity",
    )


LATE_S, LATE_FRICTION = 2.1, 0.1
_late = rollout_of(
    "a cube on a plate that stands still for 2.1 s and then accelerates by 2 m/s^2; friction 0.1, the plate listed "
    "first",
    Scene(
        bodies=(
            driven_box("plate", (0.0, 0.0, 0.5), (1.0, 0.4, 0.02)),
            box("cube", (0.0, 0.0, 0.535), (0.05, 0.05, 0.05)),
        ),
        contacts=(contact("plate", "cube", friction=LATE_FRICTION),),
        drivers=(
            driver(
                "plate",
                "translate",
                (0.8, 0.6, 0.0),
                ramp(0.32, start_s=LATE_S, duration_s=0.8, ramp_s=0.4),
            ),
        ),
        duration_s=2.4,
    ),
)


@_late.check("carry-late")
def _carry_late(rollout: Rollout) -> Measurement:
    later = rollout.between(LATE_S, 2.4)
    moved = rollout.displacement("cube")[later] @ [0.8, 0.6, 0.0]
    rate = acceleration_m_per_s2(rollout.times_s[later], moved)
    return Measurement(measured=rate / G, expected=LATE_FRICTION)


# --- a driven body turned away from its axes -------------------------------------------------------------------------

PLATE_M = (0.5, 0.3, 0.1)
BLOCKS = {
    "first block": ((-70.0, 35.0, 20.0), (0.6, 0.0, 0.8), (0.0, -0.6, 0.8), 1.5),
    "second block": ((25.0, -15.0, 80.0), (0.48, 0.64, -0.6), (0.8, 0.6, 0.0), -1.3),
    "third block": ((0.0, 50.0, -130.0), (0.0, -0.8, 0.6), (0.6, 0.0, -0.8), 1.1),
}
"""Orientation at the start [deg], axis and line of the motion, and angle [rad]."""


def _turned_scene() -> Scene:
    blocks, drivers = [], []
    for number, (name, (start_deg, axis, line, angle_rad)) in enumerate(BLOCKS.items()):
        place = np.array([0.3 + number, -0.2, 1.0])
        blocks.append(driven_box(name, vector(place), PLATE_M, euler_deg=start_deg))
        turn = DriverMotion(
            kind="rotate",
            axis=axis,
            point_m=vector(np.add(place, (-0.2, 0.3, -0.2))),
            profiles=(ramp(angle_rad, start_s=0.0, duration_s=0.4, ramp_s=0.05),),
        )
        move = DriverMotion(
            kind="translate",
            axis=line,
            profiles=(ramp(-0.4, start_s=0.1, duration_s=0.2, ramp_s=0.05),),
        )
        drivers.append(Driver(body=name, motions=(turn, move), provenance="nominal"))
    return Scene(bodies=tuple(blocks), drivers=tuple(drivers), duration_s=0.5)


_turned = rollout_of(
    "three driven blocks, turned away from their axes, that turn by up to 1.5 rad about leaning axes beside them and "
    "move; no contacts",
    _turned_scene(),
)


@_turned.check("driven-turned-path")
def _driven_turned_path(rollout: Rollout) -> Measurement:
    corners = Box(size_m=PLATE_M).corners_m
    errors, hints = {}, {}
    for motion in rollout.scene.drivers:
        name = motion.body
        start = rollout.scene.body(name).pose
        asked = [motion.pose(start, float(time)) for time in rollout.times_s]
        places = np.array([one.to_world(corners) for one in asked])
        found = np.array([turn.apply(corners) for turn in rollout.rotation(name)])
        found += rollout.position(name)[:, None]
        turns = Rotation.concatenate([one.rotation for one in asked])
        off_rad = (rollout.rotation(name) * turns.inv()).magnitude()
        centre_mm = largest_mm(found.mean(axis=1) - places.mean(axis=1))
        errors[name] = largest_mm(found - places)
        hints[name] = (
            f"the centre of the {name} is off by {centre_mm:.3g} mm, its orientation by "
            f"{np.degrees(off_rad.max()):.3g} degrees"
        )
    worst = max(errors, key=lambda one: errors[one])
    others = ", ".join(f"{one} {error:.3g} mm" for one, error in errors.items())
    return Measurement(measured=errors[worst], hint=f"{hints[worst]} ({others})")


@_turned.check("driven-turned-rate")
def _driven_turned_rate(rollout: Rollout) -> Measurement:
    errors, hints = {}, {}
    for motion in rollout.scene.drivers:
        name = motion.body
        start = rollout.scene.body(name).pose
        asked = np.array(
            [motion.state(start, float(time))[1] for time in rollout.times_s]
        )
        found = np.hstack([rollout.velocity(name), rollout.angular_velocity(name)])
        # At the start of the motion the reported rate may still be that of rest.
        largest = [np.abs(asked[:, :3]).max()] * 3 + [np.abs(asked[:, 3:]).max()] * 3
        error = np.abs(found - asked)[1:] / largest
        part = "linear" if error[:, :3].max() > error[:, 3:].max() else "angular"
        frame = rollout.rotation(name).apply(asked[:, 3:], inverse=True)
        from_body = np.abs(found[:, 3:] - frame)[1:].max()
        in_body = from_body < 0.1 * np.abs(found[:, 3:] - asked[:, 3:])[1:].max()
        errors[name] = 100.0 * float(error.max())
        hints[name] = f"the {part} velocity of the driven body is off for the {name}"
        hints[name] += ": it is in the body frame" if in_body else ""
    worst = max(errors, key=lambda one: errors[one])
    return Measurement(measured=errors[worst], hint=hints[worst])


# --- many shapes that collide: momentum and energy -------------------------------------------------------------------

TRIPOD = ConvexUnion(
    pieces_m=(
        tuple(
            vector((x, y, z))
            for x in (0.0, 0.08)
            for y in (0.0, 0.03)
            for z in (0.0, 0.03)
        ),
        tuple(
            vector((x, y, z))
            for x in (0.0, 0.03)
            for y in (0.03, 0.09)
            for z in (0.0, 0.03)
        ),
    )
)
SWARM_PLACES_M = {
    "box": (-0.16, 0.0, 0.0),
    "sphere": (0.16, 0.02, 0.01),
    "cylinder": (0.0, 0.17, 0.02),
    "solid": (-0.02, -0.19, -0.02),
    "heavy box": (0.02, -0.01, 0.2),
}
SWARM_SHAPES: dict[str, Shape] = {
    "box": Box(size_m=(0.1, 0.06, 0.08)),
    "sphere": Sphere(radius_m=0.04),
    "cylinder": Cylinder(radius_m=0.03, length_m=0.09),
    "solid": TRIPOD,
    "heavy box": Box(size_m=(0.07, 0.09, 0.05)),
}
SWARM_MASSES_KG = {
    "box": 0.2,
    "sphere": 0.15,
    "cylinder": 0.25,
    "solid": 0.1,
    "heavy box": 0.5,
}


SWARM_FRICTIONS = {
    "box": 0.5,
    "sphere": 0.7,
    "cylinder": 0.6,
    "solid": 0.9,
    "heavy box": 0.8,
}
"""The friction of a pair is the product of the values of its bodies, so that engines with this rule build the scene."""


def _swarm_scene() -> Scene:
    bodies = []
    for index, (name, place) in enumerate(SWARM_PLACES_M.items()):
        pose = Pose.from_euler_deg(place, (30.0 * index, -50.0 + 25.0 * index, 70.0))
        one = body(name, SWARM_SHAPES[name], pose, mass_kg=SWARM_MASSES_KG[name])
        bodies.append(_thrown(one, -4.0 * np.array(place), (2.0, -3.0 + index, 1.0)))
    names = list(SWARM_PLACES_M)
    contacts: list[Contact] = []
    for index, first in enumerate(names):
        for number, second in enumerate(names[:index]):
            pair = (first, second) if (index + number) % 2 else (second, first)
            friction = SWARM_FRICTIONS[first] * SWARM_FRICTIONS[second]
            contacts.append(contact(*pair, friction=friction, restitution=0.4))
    return Scene(
        bodies=tuple(bodies),
        contacts=tuple(contacts),
        duration_s=0.5,
        gravity_m_per_s2=0.0,
    )


_swarm = rollout_of(
    "a box, a sphere, a cylinder, a solid of two pieces and a heavy box that spin and meet in one place; no gravity",
    _swarm_scene(),
)


def _momenta(rollout: Rollout) -> tuple[Array, Array, Array]:
    """Return momentum [kg m/s] and angular momentum about the origin [kg m^2/s], shapes [T, 3], and energy [J], [T]."""
    count = len(rollout.times_s)
    linear, angular, energy = (
        np.zeros((count, 3)),
        np.zeros((count, 3)),
        np.zeros(count),
    )
    for one in rollout.scene.bodies:
        centre_m, inertia = body_mass_properties(one)
        arm = rollout.rotation(one.name).apply(centre_m)
        spin = rollout.angular_velocity(one.name)
        velocity = rollout.velocity(one.name) + np.cross(spin, arm)
        axes = rollout.rotation(one.name).as_matrix()
        own = np.einsum("tij,jk,tlk,tl->ti", axes, inertia, axes, spin)
        linear += one.mass_kg * velocity
        place = rollout.position(one.name) + arm
        angular += own + one.mass_kg * np.cross(place, velocity)
        energy += 0.5 * one.mass_kg * np.square(velocity).sum(axis=1)
        energy += 0.5 * (own * spin).sum(axis=1)
    return linear, angular, energy


@_swarm.check("swarm-momentum")
def _swarm_momentum(rollout: Rollout) -> Measurement:
    linear, _, _ = _momenta(rollout)
    scale = sum(
        one.mass_kg * float(np.linalg.norm(one.linear_velocity_m_per_s))
        for one in rollout.scene.bodies
    )
    change = np.linalg.norm(linear - linear[0], axis=1).max() / scale
    met = _momenta(rollout)[2][-1] < 0.9 * _momenta(rollout)[2][0]
    hint = "" if met else "the bodies did not meet: they pass through each other"
    return Measurement(measured=100.0 * float(change) if met else math.nan, hint=hint)


@_swarm.check("swarm-turn")
def _swarm_turn(rollout: Rollout) -> Measurement:
    _, angular, _ = _momenta(rollout)
    scale = sum(
        one.mass_kg
        * float(np.linalg.norm(one.linear_velocity_m_per_s))
        * float(np.linalg.norm(one.pose.position_m))
        for one in rollout.scene.bodies
    )
    return Measurement(
        measured=100.0
        * float(np.linalg.norm(angular - angular[0], axis=1).max())
        / scale
    )


@_swarm.check("swarm-energy")
def _swarm_energy(rollout: Rollout) -> Measurement:
    _, _, energy = _momenta(rollout)
    gains = np.diff(energy).max() / energy[0]
    return Measurement(measured=100.0 * max(float(gains), 0.0))


# --- a string at the body's origin -----------------------------------------------------------------------------------

STRING_M, STRING_TOP_M = 0.3, np.array([0.1, -0.2, 1.5])
OFF_CENTRE = ConvexUnion(
    pieces_m=(
        tuple(
            vector((x, y, z))
            for x in (0.0, 0.12)
            for y in (-0.02, 0.03)
            for z in (-0.02, 0.02)
        ),
    )
)
"""Block whose origin is on one of its faces, 60 mm from its centre of mass."""


@rollout_of(
    "a block that hangs on a string of 0.3 m at its origin, 60 mm beside its centre of mass, and falls from level",
    Scene(
        bodies=(
            body(
                "block",
                OFF_CENTRE,
                Pose(position_m=vector(STRING_TOP_M - [0.0, 0.0, STRING_M])),
            ),
        ),
        joints=(
            Tether(body="block", anchor_m=vector(STRING_TOP_M), length_m=STRING_M),
        ),
        duration_s=0.4,
    ),
).check("tether-origin")
def _tether_origin(rollout: Rollout) -> Measurement:
    distance = np.linalg.norm(rollout.position("block") - STRING_TOP_M, axis=1)
    worst = float(distance[np.abs(distance - STRING_M).argmax()])
    return Measurement(measured=1e3 * worst, expected=1e3 * STRING_M)
