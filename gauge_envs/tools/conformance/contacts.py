"""Contacts: friction, rebound, and energy that must not grow."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from gauge_envs.scene import GRAVITY_M_PER_S2 as G, Box, Contact, Pose, Scene, Vector
from gauge_envs.scene.geometry import vector
from gauge_envs.scoring.estimators import slide_friction
from gauge_envs.tools.bench.drop import (
    RADIUS_M,
    balls_above_ground,
    bounce_of,
    drop_scene,
    fall_s,
)
from gauge_envs.tools.bench.parts import ball, body, box, contact, fixed_box, ground
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.bench.slope import acceleration_downhill_m_per_s2, moved_m
from gauge_envs.tools.bench.turning import SPIN, turning_arm_m, turning_scene
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.laws import (
    SLIDE_SLOPE_DEG,
    inertia_kg_m2,
    largest_mm,
    slide_acceleration,
)
from gauge_envs.tools.conformance.model import (
    Check,
    Measurement,
    Tolerance,
    recorded,
    rollout_of,
)

# --- friction --------------------------------------------------------------------------------------------------------

CUBE_M = 0.05
BOARD_THICKNESS_M = 0.02


def _on_slope(slope_deg: float, frictions: dict[str, float], seconds: float) -> Scene:
    """Return cubes side by side on a board tilted about y, each with its own friction; the board's x is downhill."""
    board = fixed_box(
        "board",
        (0.0, 0.0, 1.0),
        (1.2, 0.6, BOARD_THICKNESS_M),
        euler_deg=(0.0, slope_deg, 0.0),
    )
    height = 0.5 * (CUBE_M + BOARD_THICKNESS_M)
    cubes = []
    for index, name in enumerate(frictions):
        place = board.pose.to_world(np.array([-0.4, 0.1 * index, height]))
        pose = Pose(position_m=vector(place), quaternion=board.pose.quaternion)
        cubes.append(body(name, Box(size_m=(CUBE_M,) * 3), pose))
    contacts = tuple(
        contact(name, "board", friction=friction)
        for name, friction in frictions.items()
    )
    return Scene(bodies=(*cubes, board), contacts=contacts, duration_s=seconds)


_slide = rollout_of(
    "two cubes with friction 0.1 and 0.3 on a fixed board that leans by 30 degrees",
    _on_slope(SLIDE_SLOPE_DEG, {"smooth": 0.1, "rough": 0.3}, 0.5),
)
_hold = rollout_of(
    "a cube with friction 0.25 on a fixed board that leans by 10 degrees",
    _on_slope(10.0, {"cube": 0.25}, 0.3),
)


@_slide.check("fixed-body-stays")
def _fixed_body_stays(rollout: Recording) -> Measurement:
    return Measurement(measured=largest_mm(rollout.displacement("board")))


def _slide_check(id: str, name: str, friction: float) -> None:
    @_slide.check(id)
    def measure(rollout: Recording) -> Measurement:
        found = slide_acceleration(
            acceleration_downhill_m_per_s2(rollout, name, "board"), friction
        )
        if moved_m(rollout, name, "board")[-1, 2] < -0.1:
            return replace(
                found, hint="it falls through the board: the pair has no contact"
            )
        return found


_slide_check("slide", "rough", 0.3)
_slide_check("slide-of-pair", "smooth", 0.1)


FRICTION_TOLERANCE = Tolerance(
    "single real slides are 5 to 14 % from the published coefficient; an engine must be well below that",
    relative=0.01,
)


@Check("slide-between", tolerance=FRICTION_TOLERANCE)
def _slide_between(lab: Lab) -> Measurement:
    scene = _on_slope(SLIDE_SLOPE_DEG, {"cube": 0.1}, 0.35)
    board, cube = scene.body("board"), scene.body("cube")
    size = (0.3, 0.2, 0.03)
    places = {"slab": (-0.4, 0.0, 0.5 * (size[2] + BOARD_THICKNESS_M))}
    places["cube"] = (-0.5, 0.0, size[2] + 0.5 * (CUBE_M + BOARD_THICKNESS_M))
    poses = {
        name: replace(cube.pose, position_m=vector(board.pose.to_world(np.array(at))))
        for name, at in places.items()
    }
    bodies = (
        replace(cube, pose=poses["cube"]),
        body("slab", Box(size_m=size), poses["slab"], mass_kg=1.0),
        board,
    )
    contacts = (
        contact("cube", "slab", friction=0.1),
        contact("slab", "board", friction=0.3),
    )
    rollout = lab.rollout(replace(scene, bodies=bodies, contacts=contacts))
    measured = acceleration_downhill_m_per_s2(rollout, "cube", "board")
    friction = slide_friction(
        measured, math.radians(SLIDE_SLOPE_DEG), gravity_m_per_s2=G
    )
    return Measurement(measured=friction, expected=0.1)


@Check("spin-on-point")
def _spin_on_point(lab: Lab) -> Measurement:
    top = replace(
        ball("top", (0.0, 0.0, RADIUS_M)), angular_velocity_rad_per_s=(0.0, 0.0, 20.0)
    )
    touch = contact("top", "ground", friction=0.5)
    rollout = lab.rollout(
        Scene(bodies=(top, ground()), contacts=(touch,), duration_s=0.5)
    )
    return Measurement(
        measured=float(rollout.angular_velocity("top")[-1, 2]), expected=20.0
    )


TORSION_M, ROLLING_M, ROLLS_M_PER_S = 2e-4, 1e-3, 0.3


@Check("torsion")
def _torsion(lab: Lab) -> Measurement:
    rollout = lab.rollout(
        turning_scene(0.5, 0.0, (0.0, 0.0, 20.0), torsion_m=TORSION_M)
    )
    return Measurement(
        measured=1e3 * turning_arm_m(rollout, SPIN), expected=1e3 * TORSION_M
    )


@Check("rolling")
def _rolling(lab: Lab) -> Measurement:
    spin = (0.0, ROLLS_M_PER_S / RADIUS_M, 0.0)
    rollout = lab.rollout(turning_scene(1.6, ROLLS_M_PER_S, spin, rolling_m=ROLLING_M))
    expected = 0.7 * ROLLS_M_PER_S**2 * RADIUS_M / (G * ROLLING_M)
    return Measurement(
        measured=1e3 * float(rollout.displacement("ball")[-1, 0]),
        expected=1e3 * expected,
    )


@_hold.check("hold")
def _hold_check(rollout: Recording) -> Measurement:
    return Measurement(measured=largest_mm(rollout.displacement("cube")))


@Check("hold-steep")
def _hold_steep(lab: Lab) -> Measurement:
    scene = _on_slope(47.5, {"slab": 1.2}, 0.3)
    # A slab as thick as a cube is tall would tip.
    board, slab = scene.body("board"), scene.body("slab")
    place = board.pose.to_world(np.array([-0.4, 0.0, 0.5 * (0.02 + BOARD_THICKNESS_M)]))
    slab = replace(
        slab,
        shape=Box(size_m=(0.08, 0.08, 0.02)),
        pose=replace(slab.pose, position_m=vector(place)),
    )
    rollout = lab.rollout(replace(scene, bodies=(slab, board)))
    return Measurement(measured=largest_mm(rollout.displacement("slab")))


# --- rebound ---------------------------------------------------------------------------------------------------------

DROP_M, LOW_DROP_M = 0.4, 0.05
REBOUND_FALLS = 2.1
"""Recorded time over the time of the fall."""

LEAST_HOP = 0.01
"""Height of a hop over that of the drop below which a contact settles and does not rebound."""


def _dropped(
    restitutions: dict[str, float], *, drop_m: float = DROP_M, gravity: float = G
) -> Scene:
    """Return balls side by side that drop on a plane, each with its own restitution."""
    balls = balls_above_ground(dict.fromkeys(restitutions, drop_m), spacing_m=0.3)
    contacts = tuple(
        contact(name, "ground", friction=0.5, restitution=value)
        for name, value in restitutions.items()
    )
    return drop_scene(
        balls,
        contacts,
        seconds=REBOUND_FALLS * fall_s(drop_m, gravity),
        gravity=gravity,
    )


def _rebound_check(
    id: str, dropped: Scene, restitution: float, *, name: str = "ball"
) -> None:
    @Check(id)
    def measure(lab: Lab) -> Measurement:
        found = bounce_of(lab.rollout(dropped), name)
        if found is None:
            return Measurement(
                measured=math.nan, expected=restitution, hint="it does not fall"
            )
        if found.restitution**2 < LEAST_HOP:
            return Measurement(
                measured=0.0,
                expected=restitution,
                hint="it does not leave the ground again",
            )
        return Measurement(measured=found.restitution, expected=restitution)


for _restitution in (0.2, 0.5, 0.95):
    _rebound_check(
        f"rebound-{_restitution:g}", _dropped({"ball": _restitution}), _restitution
    )
_rebound_check(
    "rebound-of-pair", _dropped({"lively": 0.75, "dull": 0.2}), 0.2, name="dull"
)

_flat = box("box", (0.0, 0.0, RADIUS_M + DROP_M), (0.1, 0.08, 2.0 * RADIUS_M))
_flat_contact = contact("box", "ground", friction=0.5, restitution=0.5)
_rebound_check(
    "rebound-flat",
    drop_scene([_flat], (_flat_contact,), seconds=0.6, gravity=G),
    0.5,
    name="box",
)

_low = balls_above_ground({"ball": LOW_DROP_M}, spacing_m=0.0)
_sustained = Contact(first=("ball",), second=("ground",), friction=0.5, restitution=0.8)
_rebound_check(
    "rebound-sustained", drop_scene(_low, (_sustained,), seconds=0.3, gravity=G), 0.0
)

_rebound_check(
    "rebound-slow", _dropped({"ball": 0.5}, drop_m=LOW_DROP_M, gravity=0.1), 0.5
)


# --- energy ----------------------------------------------------------------------------------------------------------


@recorded("a box dropped by 0.35 m on a corner, on a plane")
def _tumble(lab: Lab) -> Recording:
    brick = box(
        "brick",
        (0.0, 0.0, 0.35),
        (0.1, 0.06, 0.03),
        euler_deg=(25.0, 35.0, 10.0),
        mass_kg=0.4,
    )
    bounce = contact("brick", "ground", friction=0.4, restitution=0.5)
    return lab.rollout(
        Scene(bodies=(brick, ground()), contacts=(bounce,), duration_s=1.0)
    )


PILE_BOX_M = (0.1, 0.1, 0.05)


def _boxes_at(places_m: Iterable[Vector]) -> Scene:
    """Return a second of boxes over a plane, which touch it and each other."""
    boxes = tuple(
        box(f"box-{index}", place, PILE_BOX_M, mass_kg=0.3)
        for index, place in enumerate(places_m)
    )
    names = tuple(one.name for one in boxes)
    contacts = tuple(contact(names, other, friction=0.4) for other in (names, "ground"))
    return Scene(bodies=(*boxes, ground()), contacts=contacts, duration_s=1.0)


_pile = rollout_of(
    "a slanting stack of six boxes on a plane, which falls over",
    _boxes_at((0.025 * i, 0.01 * (i % 2), 0.03 + 0.055 * i) for i in range(6)),
)
_tower = rollout_of(
    "a tower of twenty boxes on a plane, as wide as two of them are high",
    _boxes_at((0.0, 0.0, PILE_BOX_M[2] * (i + 0.5)) for i in range(20)),
)


@_tumble.check("drop-energy")
def _largest_gain(rollout: Recording) -> Measurement:
    """Measure the gain of kinetic and potential energy of the dynamic boxes above z = 0, over the initial one [%]."""
    energy = np.zeros(len(rollout.times_s))
    for one in rollout.scene.dynamic_bodies:
        states, spin = rollout.states[one.name], rollout.angular_velocity(one.name)
        energy += 0.5 * np.einsum(
            "ti,tij,tj->t", spin, inertia_kg_m2(rollout, one.name), spin
        )
        energy += one.mass_kg * (
            0.5 * np.square(states[:, 7:10]).sum(axis=1) + G * states[:, 2]
        )
    gain = 100.0 * float((energy - energy[0]).max() / energy[0])
    at = float(rollout.times_s[int(energy.argmax())])
    return Measurement(measured=gain, hint=f"the energy is highest at {at:.3g} s")


@_pile.check("pile-sinks")
def _pile_sinks(rollout: Recording) -> Measurement:
    corners = Box(size_m=PILE_BOX_M).corners_m
    deepest = 0.0
    for one in rollout.scene.dynamic_bodies:
        landed = rollout.between(0.8, 1.0)
        rotations = rollout.rotation(one.name)[landed].as_matrix()
        heights = (
            rollout.position(one.name)[landed, 2, None] + rotations[:, 2] @ corners.T
        )
        deepest = max(deepest, -float(heights.min()))
    return Measurement(measured=1e3 * deepest)


@_tower.check("tower-stands")
def _tower_stands(rollout: Recording) -> Measurement:
    top = rollout.scene.dynamic_bodies[-1].name
    moved_mm = 1e3 * rollout.displacement(top)[rollout.between(0.8, 1.0)]
    aside_mm = np.linalg.norm(moved_mm[:, :2], axis=1)
    return Measurement(
        measured=float(np.linalg.norm(moved_mm, axis=1).max()),
        hint=f"its top is {-moved_mm[-1, 2]:.3g} mm lower and up to {aside_mm.max():.3g} mm aside",
    )


# --- oblique impacts -------------------------------------------------------------------------------------------------

OBLIQUE_E, OBLIQUE_DOWN_M_PER_S, OBLIQUE_END_S = 0.6, 2.0, 0.2
OBLIQUE: dict[str, tuple[float, float]] = {"grip": (0.6, 1.0), "slip": (0.1, 3.0)}
"""Friction, and speed along the plane [m/s], of balls that strike it."""


def _oblique_scene() -> Scene:
    balls = []
    for index, (name, (_, along)) in enumerate(OBLIQUE.items()):
        thrown = ball(
            name,
            (0.0, 0.5 * index, RADIUS_M + 0.1 * OBLIQUE_DOWN_M_PER_S),
            radius_m=RADIUS_M,
        )
        balls.append(
            replace(thrown, linear_velocity_m_per_s=(along, 0.0, -OBLIQUE_DOWN_M_PER_S))
        )
    contacts = (
        contact(name, "ground", friction=mu, restitution=OBLIQUE_E)
        for name, (mu, _) in OBLIQUE.items()
    )
    return Scene(
        bodies=(*balls, ground()),
        contacts=tuple(contacts),
        duration_s=OBLIQUE_END_S,
        gravity_m_per_s2=0.0,
    )


_oblique = rollout_of(
    "two balls of radius 30 mm thrown at a plane with 2 m/s down and 1 or 3 m/s along, with friction 0.6 or 0.1 and "
    "restitution 0.6; no gravity",
    _oblique_scene(),
)


OBLIQUE_TEXTS: dict[str, Any] = {
    "source": "Routh, Rigid Dynamics; Brach, J. Appl. Mech. 51 (1984)",
    "tolerance": Tolerance(
        "as for a slide: the error must be well below the scatter of friction",
        relative=0.01,
    ),
    "diagnosis": "check that friction acts in pairs of the mode IMPACT and on the whole impulse, its direction, and "
    "its moment about the centre",
}


def _after(rollout: Recording, name: str) -> tuple[float, float, float, str]:
    """Return speed along the plane, speed up, spin about y of a ball after its impact, and what is plainly wrong."""
    velocity, along = rollout.velocity(name)[-1], OBLIQUE[name][1]
    spin = float(rollout.angular_velocity(name)[-1, 1])
    hint = ""
    if velocity[2] < 0.1 * OBLIQUE_DOWN_M_PER_S:
        hint = "the ball does not rebound"
    elif abs(velocity[0] - along) < 0.02:
        hint = "the impact has no friction"
    elif spin < 0.0:
        hint = "friction, or its moment, acts in the wrong direction"
    return float(velocity[0]), float(velocity[2]), spin, hint


@_oblique.check("oblique-grip-speed", **OBLIQUE_TEXTS)
def _grip_speed(rollout: Recording) -> Measurement:
    along, _, _, hint = _after(rollout, "grip")
    return Measurement(
        measured=along, expected=5.0 / 7.0 * OBLIQUE["grip"][1], hint=hint
    )


@_oblique.check("oblique-grip-spin", **OBLIQUE_TEXTS)
def _grip_spin(rollout: Recording) -> Measurement:
    _, _, spin, hint = _after(rollout, "grip")
    return Measurement(
        measured=spin, expected=5.0 / 7.0 * OBLIQUE["grip"][1] / RADIUS_M, hint=hint
    )


@_oblique.check("oblique-slip-friction", **OBLIQUE_TEXTS)
def _slip_friction(rollout: Recording) -> Measurement:
    friction, before = OBLIQUE["slip"]
    along, up, _, hint = _after(rollout, "slip")
    measured = (before - along) / (up + OBLIQUE_DOWN_M_PER_S)
    if abs(measured * (1.0 + OBLIQUE_E) / friction - 1.0) < 0.02:
        hint = "friction acts on the impulse without rebound: the engine adds the restitution after friction"
    return Measurement(measured=measured, expected=friction, hint=hint)


@_oblique.check(
    "oblique-slip-rebound",
    **OBLIQUE_TEXTS
    | {
        "diagnosis": "where rebound-0.5 passes, slip adds to the rebound: a convex contact model dilates as it slips"
    },
)
def _slip_rebound(rollout: Recording) -> Measurement:
    _, up, _, hint = _after(rollout, "slip")
    return Measurement(
        measured=up / OBLIQUE_DOWN_M_PER_S, expected=OBLIQUE_E, hint=hint
    )
