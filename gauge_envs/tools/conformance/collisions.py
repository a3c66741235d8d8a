"""Rich scenes of contacts: many directions, speeds, orders and times at once, as in `rich`."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Box,
    Motion,
    Pose,
    RigidBody,
    Scene,
)
from gauge_envs.scene.geometry import vector
from gauge_envs.scoring.estimators import acceleration_m_per_s2
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
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance.laws import worst_ratio
from gauge_envs.tools.conformance.model import Measurement, rollout_of
from gauge_envs.tools.conformance.rich import thrown

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
        bodies.append(thrown(one, (shot.speed_m_per_s, 0.0, 0.0)))
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


def _restitution(rollout: Recording, name: str) -> float:
    shot = SHOTS[name]
    other = f"target of {name}" if shot.hits_ball else "wall"
    apart = rollout.velocity(other)[:, 0] - rollout.velocity(name)[:, 0]
    after = rollout.sample_at(min(shot.at_s + 0.1, VOLLEY_S))
    return float(apart[after] / shot.speed_m_per_s)


def _volley_check(id: str, names: list[str]) -> None:
    @_volley.check(id)
    def measure(rollout: Recording) -> Measurement:
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
def _volley_momentum(rollout: Recording) -> Measurement:
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
        bodies += [lower, thrown(upper, (0.0, 0.0, -EDGE_SPEED_M_PER_S))]
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
def _crossed_edges(rollout: Recording) -> Measurement:
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
        bodies.append(thrown(one, puck.speed_m_per_s * ahead))
        pair = (name, "slab") if puck.is_first else ("slab", name)
        contacts.append(contact(*pair, friction=puck.friction))
    return Scene(bodies=(*bodies, slab), contacts=tuple(contacts), duration_s=0.4)


_pucks = rollout_of(
    "six flat boxes that slide on a level slab in several directions, some turned, some listed second in their "
    "contact; 2 and 6 m/s",
    _pucks_scene(),
)


@_pucks.check("pucks-friction")
def _pucks_friction(rollout: Recording) -> Measurement:
    ratios = {}
    for name, puck in PUCKS.items():
        start = np.array(rollout.scene.body(name).linear_velocity_m_per_s)
        along = rollout.displacement(name) @ start / puck.speed_m_per_s
        slows = -acceleration_m_per_s2(rollout.times_s, along)
        ratios[name] = slows / (puck.friction * G)
    return worst_ratio(ratios, "the friction is")


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
def _carry_late(rollout: Recording) -> Measurement:
    later = rollout.between(LATE_S, 2.4)
    moved = rollout.displacement("cube")[later] @ [0.8, 0.6, 0.0]
    rate = acceleration_m_per_s2(rollout.times_s[later], moved)
    return Measurement(measured=rate / G, expected=LATE_FRICTION)
