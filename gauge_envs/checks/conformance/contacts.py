"""Contacts: friction, rebound, momentum, which pairs collide, and energy that must not grow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.checks.conformance.kit import Measurement, Tolerance, check
from gauge_envs.checks.conformance.lab import Lab
from gauge_envs.checks.conformance.laws import box_inertia_kg_m2, world_inertia_kg_m2
from gauge_envs.checks.conformance.parts import ball, body, box, driver, ground, ramp
from gauge_envs.checks.rollout import Course
from gauge_envs.scene import GRAVITY_M_PER_S2, Box, Contact, ContactMode, Motion, Pose, Scene

__all__: list[str] = []

G = GRAVITY_M_PER_S2

# --- friction --------------------------------------------------------------------------------------------------------

CUBE_M = 0.05
BOARD_THICKNESS_M = 0.02


def _on_slope(slope_deg: float, frictions: dict[str, float], seconds: float, lab: Lab) -> Course:
    """Cubes side by side on a board that is tilted about y, each with its own friction; downhill is the board's x."""
    slope = Pose.from_euler_deg((0.0, 0.0, 1.0), (0.0, slope_deg, 0.0))
    height = 0.5 * (CUBE_M + BOARD_THICKNESS_M)
    cubes = []
    for index, name in enumerate(frictions):
        x, y, z = slope.to_world(np.array([-0.4, 0.1 * index, height]))
        cubes.append(
            body(
                name,
                Box(size_m=(CUBE_M,) * 3),
                Pose(position_m=(float(x), float(y), float(z)), quaternion=slope.quaternion),
            )
        )
    board = body("board", Box(size_m=(1.2, 0.6, BOARD_THICKNESS_M)), slope, mass_kg=1.0, motion=Motion.FIXED)
    contacts = tuple(
        Contact(first=(name,), second=("board",), friction=friction, restitution=0.0)
        for name, friction in frictions.items()
    )
    return lab.course(Scene(bodies=(*cubes, board), contacts=contacts, duration_s=seconds), seconds)


def _along_slope(course: Course, name: str) -> NDArray[np.float64]:
    """Positions relative to the start in the board's frame [m], shape [sample_count, 3]."""
    way = course.position(name) - course.position(name)[0]
    return np.asarray(course.scene.body("board").pose.rotation.apply(way, inverse=True))


def _slide(lab: Lab) -> Course:
    return _on_slope(30.0, {"smooth": 0.1, "rough": 0.3}, 0.5, lab)


def _hold(lab: Lab) -> Course:
    return _on_slope(10.0, {"cube": 0.25}, 0.3, lab)


def _slide_reading(lab: Lab, name: str, friction: float) -> Measurement:
    course = lab.once(_slide)
    sine, cosine = np.sin(np.radians(30.0)), np.cos(np.radians(30.0))
    measured = float(2.0 * np.polyfit(course.times_s, _along_slope(course, name)[:, 0], 2)[0])
    effective = (sine - measured / G) / cosine
    return Measurement(
        measured=measured,
        expected=G * (sine - friction * cosine),
        hint=f"it slides as if the friction were {effective:.3g} instead of {friction:.3g}",
    )


SLIDE_TOLERANCE = Tolerance(
    relative=0.01,
    rationale="real slides scatter by 1.4 to 3 % (wood to metal); an engine's own error must be well below",
)
SLIDE_DIAGNOSIS = (
    "look at how friction of two surfaces is combined (the contract's is the pair's), at the friction cone, and at "
    "regularized friction that lets go too early"
)


@check(
    "slide",
    title="slide on 30 degrees",
    measures="acceleration downhill of a cube with friction 0.3, quadratic fit over 0.5 s",
    law="a = g (sin 30 - mu cos 30)",
    source="Coulomb",
    unit="m/s^2",
    tolerance=SLIDE_TOLERANCE,
    diagnosis=SLIDE_DIAGNOSIS,
)
def _slide_rough(lab: Lab) -> Measurement:
    return _slide_reading(lab, "rough", 0.3)


@check(
    "slide-of-pair",
    title="friction is the pair's",
    measures="acceleration downhill of a cube with friction 0.1 on the same board beside the other",
    law="a = g (sin 30 - mu cos 30)",
    source="Coulomb; contract (scene.Contact)",
    unit="m/s^2",
    tolerance=SLIDE_TOLERANCE,
    diagnosis="each pair of bodies has its own friction; " + SLIDE_DIAGNOSIS,
)
def _slide_smooth(lab: Lab) -> Measurement:
    return _slide_reading(lab, "smooth", 0.1)


@check(
    "slide-straight",
    title="slide is straight",
    measures="largest way of the sliding cube across the slope or off the board within 0.5 s",
    law="y, z of the board's frame = const",
    source="symmetry",
    unit="mm",
    tolerance=Tolerance(absolute=1.0, rationale="the real trials' scatter is about 1 mm"),
    diagnosis="the cube hops, sinks in or turns: contact stiffness, contact points, friction anisotropy",
)
def _slide_straight(lab: Lab) -> Measurement:
    return Measurement(measured=1e3 * float(np.abs(_along_slope(lab.once(_slide), "rough")[:, 1:]).max()), expected=0.0)


@check(
    "hold",
    title="hold on 10 degrees",
    measures="largest way of a cube with friction 0.25 (tan 10 = 0.18) within 0.3 s",
    law="r = const while tan(slope) < mu",
    source="Coulomb",
    unit="mm",
    tolerance=Tolerance(
        absolute=0.1, rationale="a real cube that holds scatters by 0.6 mm; creep must not be seen beside it"
    ),
    diagnosis="static friction creeps: it is regularized, or the contact settles into the board",
)
def _hold_check(lab: Lab) -> Measurement:
    way = np.linalg.norm(_along_slope(lab.once(_hold), "cube"), axis=1)
    return Measurement(measured=1e3 * float(way.max()), expected=0.0)


@check(
    "fixed-body-stays",
    title="fixed body stays",
    measures="largest way of the fixed board under the sliding cubes within 0.5 s",
    law="r = const",
    source="contract (scene.Motion)",
    unit="mm",
    tolerance=Tolerance(absolute=1e-3, rationale="it does not move; 1 um is rounding"),
    diagnosis="a fixed body must be static, without gravity",
)
def _fixed_body_stays(lab: Lab) -> Measurement:
    way = lab.once(_slide).position("board")
    return Measurement(measured=1e3 * float(np.linalg.norm(way - way[0], axis=1).max()), expected=0.0)


# --- rebound ---------------------------------------------------------------------------------------------------------

DROP_M, RADIUS_M = 0.4, 0.03


def _rebound(lab: Lab, restitution: float) -> Measurement:
    """The outgoing speed is carried back to the height of contact by energy, since samples lie 5.6 ms apart."""
    scene = Scene(
        bodies=(ball("ball", (0.0, 0.0, RADIUS_M + DROP_M), radius_m=RADIUS_M), ground()),
        contacts=(
            Contact(
                first=("ball",), second=("ground",), friction=0.5, restitution=restitution, mode=ContactMode.IMPACT
            ),
        ),
        duration_s=0.6,
    )
    course = lab.course(scene, 0.6)
    height, speed = course.position("ball")[:, 2] - RADIUS_M, course.velocity("ball")[:, 2]
    falling = np.flatnonzero(speed < -1.0)
    if not len(falling):
        return Measurement(measured=float("nan"), expected=restitution, hint="the ball does not fall")
    rising = np.flatnonzero((speed > 0.05) & (height > 1e-3))
    rising = rising[rising > falling[0]]
    if not len(rising):
        return Measurement(measured=0.0, expected=restitution, hint="the ball does not leave the ground again")
    outgoing = speed[rising[0]] ** 2 + 2.0 * G * height[rising[0]]
    return Measurement(measured=float(np.sqrt(outgoing / (2.0 * G * DROP_M))), expected=restitution)


def _rebound_check(restitution: float) -> None:
    @check(
        f"rebound-{restitution:g}",
        title=f"rebound, e = {restitution:g}",
        measures=f"outgoing over incoming speed of a ball dropped by {DROP_M:g} m on a plane",
        law="v' = -e v",
        source="Newton's law of restitution",
        unit="1",
        tolerance=Tolerance(
            absolute=0.005, rationale="the real ball's ratio scatters by 0.0022 over 22 trials: two of these"
        ),
        diagnosis="look at how restitution enters (coefficient, or damping of the contact), at a threshold speed below "
        "which the engine does not rebound, and at the step",
    )
    def measure(lab: Lab) -> Measurement:
        return _rebound(lab, restitution)


for _restitution in (0.2, 0.5, 0.75, 0.95):
    _rebound_check(_restitution)

# --- two bodies ------------------------------------------------------------------------------------------------------
# The contract has no start velocities, so a driven plate pushes the first ball up to speed and stays behind.

LEFT_KG, RIGHT_KG, RESTITUTION = 0.1, 0.2, 0.6
PUSH_M_PER_S = 0.5
BEFORE_S, AFTER_S = 0.42, 0.75


def _collision(lab: Lab) -> Course:
    plate = body(
        "plate", Box(size_m=(0.02, 0.1, 0.1)), Pose(position_m=(-0.03, 0.0, 1.0)), mass_kg=1.0, motion=Motion.KINEMATIC
    )
    scene = Scene(
        bodies=(
            ball("left", (0.0, 0.0, 1.0), radius_m=0.02, mass_kg=LEFT_KG),
            ball("right", (0.25, 0.0, 1.0), radius_m=0.02, mass_kg=RIGHT_KG),
            plate,
        ),
        contacts=(
            Contact(first=("left",), second=("plate",), friction=0.0, restitution=0.0),
            Contact(first=("left",), second=("right",), friction=0.0, restitution=RESTITUTION, mode=ContactMode.IMPACT),
        ),
        drivers=(driver("plate", "translate", (1.0, 0.0, 0.0), ramp(0.1, start_s=0.0, duration_s=0.3, ramp_s=0.1)),),
        duration_s=1.0,
        gravity_m_per_s2=0.0,
    )
    return lab.course(scene, 1.0)


def _speeds(course: Course, time_s: float) -> tuple[float, float]:
    sample = course.between(time_s, time_s).start
    return float(course.velocity("left")[sample, 0]), float(course.velocity("right")[sample, 0])


def _not_pushed(left: float, right: float) -> str:
    """Why the two balls cannot be judged: before they meet, the first one should move and the second stand."""
    if abs(left) > 0.2 * PUSH_M_PER_S and abs(right) < 0.01 * PUSH_M_PER_S:
        return ""
    return f"before they meet, the balls move with {left:.3g} and {right:.3g} m/s instead of {PUSH_M_PER_S:g} and 0"


@check(
    "pushed-ball",
    title="driven plate pushes",
    measures="speed of a ball that a driven plate has pushed and left behind by braking",
    law="v = the plate's largest speed",
    source="no restitution, no friction",
    unit="m/s",
    tolerance=Tolerance(relative=0.02, rationale="a stiff contact may release a little of its spring; 2 % is 1 cm/s"),
    diagnosis="the driven body moves without velocity, or the contact sticks or springs back",
)
def _pushed_ball(lab: Lab) -> Measurement:
    return Measurement(measured=_speeds(lab.once(_collision), BEFORE_S)[0], expected=PUSH_M_PER_S)


@check(
    "collision-momentum",
    title="two balls, momentum",
    measures="momentum of two unlike floating balls after their collision, over that before",
    law="m1 v1 + m2 v2 = const",
    source="Newton",
    unit="1",
    tolerance=Tolerance(absolute=1e-3, rationale="nothing but rounding and damping can change it"),
    diagnosis="the masses are not the scene's, or the bodies are damped, or one of them feels the contact alone",
)
def _collision_momentum(lab: Lab) -> Measurement:
    course = lab.once(_collision)
    (before, still), (left, right) = _speeds(course, BEFORE_S), _speeds(course, AFTER_S)
    if hint := _not_pushed(before, still):
        return Measurement(measured=float("nan"), expected=1.0, hint=hint)
    return Measurement(measured=(LEFT_KG * left + RIGHT_KG * right) / (LEFT_KG * before), expected=1.0)


@check(
    "collision-rebound",
    title="two balls, relative speed",
    measures="relative speed of the two balls after their collision, over that before",
    law="v2' - v1' = e (v1 - v2)",
    source="Newton's law of restitution",
    unit="1",
    tolerance=Tolerance(absolute=0.01, rationale="it is (1 + e) / 2 that a cradle's balls hand on: 0.5 % a collision"),
    diagnosis="restitution is not that of the pair, or depends on the bodies' masses, as a damped contact's may",
)
def _collision_rebound(lab: Lab) -> Measurement:
    course = lab.once(_collision)
    (before, still), (left, right) = _speeds(course, BEFORE_S), _speeds(course, AFTER_S)
    if hint := _not_pushed(before, still):
        return Measurement(measured=float("nan"), expected=RESTITUTION, hint=hint)
    return Measurement(measured=(right - left) / before, expected=RESTITUTION)


# --- which pairs collide ---------------------------------------------------------------------------------------------


def _pairs(lab: Lab) -> Course:
    """Three balls over a plane: one rests on it, one beside it and one above it are in no contact."""
    scene = Scene(
        bodies=(
            ball("listed", (-0.1, 0.0, 0.03)),
            ball("unlisted", (0.1, 0.0, 0.03)),
            ball("upper", (-0.1, 0.0, 0.2)),
            ground(),
        ),
        contacts=(Contact(first=("listed",), second=("ground",), friction=0.5, restitution=0.0),),
        duration_s=0.5,
    )
    return lab.course(scene, 0.5)


@check(
    "contact-unlisted",
    title="bodies in no contact pass through each other",
    measures="fall within 0.5 s of two balls through bodies that no contact pairs them with: the lesser of the two",
    law="g t^2 / 2",
    source="contract (scene.Contact)",
    unit="m",
    tolerance=Tolerance(relative=0.01, rationale="it is a fall; any touch shows"),
    diagnosis="the engine's own collision filter lets bodies collide that no contact of the scene pairs",
)
def _contact_unlisted(lab: Lab) -> Measurement:
    course = lab.once(_pairs)
    fallen = {name: float(course.position(name)[0, 2] - course.position(name)[-1, 2]) for name in ("unlisted", "upper")}
    slow = min(fallen, key=lambda name: fallen[name])
    what = {"unlisted": "the plane", "upper": "the plane or the other ball"}[slow]
    return Measurement(measured=fallen[slow], expected=0.5 * G * 0.5**2, hint=f"ball {slow!r} is held by {what}")


@check(
    "contact-listed",
    title="bodies in contact hold each other",
    measures="height of a ball's lowest point above the plane that it was put on 0.5 s before",
    law="height = 0",
    source="contract (scene.Contact)",
    unit="mm",
    tolerance=Tolerance(absolute=0.5, rationale="the real trials' scatter is about 1 mm"),
    diagnosis="the pair does not collide, or its contact is so soft that a body of 0.1 kg sinks in",
)
def _contact_listed(lab: Lab) -> Measurement:
    height = lab.once(_pairs).position("listed")[-1, 2] - 0.03
    return Measurement(measured=1e3 * float(height), expected=0.0)


# --- energy ----------------------------------------------------------------------------------------------------------


def _energy_j(course: Course) -> NDArray[np.float64]:
    """Kinetic and potential energy of the dynamic boxes above z = 0 [J], shape [sample_count]."""
    total = np.zeros(len(course.times_s))
    for one in course.scene.dynamic_bodies:
        assert isinstance(one.shape, Box)
        states = course.states[one.name]
        turn = Rotation.from_quat(states[:, 3:7], scalar_first=True)
        inertia = world_inertia_kg_m2(box_inertia_kg_m2(one.shape, one.mass_kg), turn)
        total += 0.5 * np.einsum("ti,tij,tj->t", states[:, 10:], inertia, states[:, 10:])
        total += one.mass_kg * (0.5 * np.square(states[:, 7:10]).sum(axis=1) + G * states[:, 2])
    return total


def _largest_gain(course: Course) -> Measurement:
    energy = _energy_j(course)
    gain = 100.0 * float((energy - energy[0]).max() / energy[0])
    at = float(course.times_s[int(energy.argmax())])
    return Measurement(measured=gain, expected=0.0, hint=f"the energy is highest at {at:.3g} s")


ENERGY_TOLERANCE = Tolerance(
    absolute=1.0,
    rationale="contacts only take energy; 1 % is 3 mm of the height of fall, for what a stiff contact stores",
)
ENERGY_DIAGNOSIS = (
    "the engine makes energy: contacts too stiff for the step, a capped solver, or penetration that is pushed out with "
    "speed. It may be finite all the time"
)


def _tumble(lab: Lab) -> Course:
    brick = box("brick", (0.0, 0.0, 0.35), (0.1, 0.06, 0.03), euler_deg=(25.0, 35.0, 10.0), mass_kg=0.4)
    contact = Contact(first=("brick",), second=("ground",), friction=0.4, restitution=0.5, mode=ContactMode.IMPACT)
    return lab.course(Scene(bodies=(brick, ground()), contacts=(contact,), duration_s=1.0), 1.0)


@check(
    "drop-energy",
    title="tumbling box gains no energy",
    measures="largest gain of kinetic and potential energy of a box dropped on a corner, within 1 s, over the start's",
    law="T + V <= its start",
    source="contacts are passive",
    unit="%",
    tolerance=ENERGY_TOLERANCE,
    diagnosis=ENERGY_DIAGNOSIS,
)
def _drop_energy(lab: Lab) -> Measurement:
    return _largest_gain(lab.once(_tumble))


PILE = 6
PILE_BOX_M = (0.1, 0.1, 0.05)


def _pile(lab: Lab) -> Course:
    """Boxes in a slanting stack that falls over."""
    boxes = tuple(
        box(f"box-{index}", (0.025 * index, 0.01 * (index % 2), 0.03 + 0.055 * index), PILE_BOX_M, mass_kg=0.3)
        for index in range(PILE)
    )
    names = tuple(one.name for one in boxes)
    contacts = (
        Contact(first=names, second=names, friction=0.4, restitution=0.0),
        Contact(first=names, second=("ground",), friction=0.4, restitution=0.0),
    )
    return lab.course(Scene(bodies=(*boxes, ground()), contacts=contacts, duration_s=1.0), 1.0)


@check(
    "pile-energy",
    title="falling pile gains no energy",
    measures="largest gain of kinetic and potential energy of six boxes that fall over, within 1 s, over the start's",
    law="T + V <= its start",
    source="contacts are passive",
    unit="%",
    tolerance=ENERGY_TOLERANCE,
    diagnosis=ENERGY_DIAGNOSIS,
)
def _pile_energy(lab: Lab) -> Measurement:
    return _largest_gain(lab.once(_pile))


@check(
    "pile-bounds",
    title="falling pile stays in bounds",
    measures="highest speed of a box of the pile, over what the scene can give (Scene.speed_limit_m_per_s)",
    law="v <= 3 sqrt(2 g h)",
    source="energy; the bound by which an episode counts as diverged",
    unit="1",
    tolerance=Tolerance(absolute=1.0, rationale="beyond it, an environment ends the episode as diverged"),
    diagnosis=ENERGY_DIAGNOSIS,
)
def _pile_bounds(lab: Lab) -> Measurement:
    course = lab.once(_pile)
    speeds = [np.linalg.norm(course.velocity(one.name), axis=1).max() for one in course.scene.dynamic_bodies]
    return Measurement(measured=float(max(speeds)) / course.scene.speed_limit_m_per_s, expected=0.0)


@check(
    "pile-sinks",
    title="pile does not sink in",
    measures="deepest corner of a box of the pile below the ground, 0.8 to 1 s after the start",
    law="height >= 0",
    source="bodies are rigid",
    unit="mm",
    tolerance=Tolerance(
        absolute=0.5,
        rationale="the real trials' scatter is about 1 mm. The moment of landing is left out: there a soft contact "
        "gives way by speed times its time constant, and comes back",
    ),
    diagnosis="contacts are too soft, or boxes tunnel through the plane",
)
def _pile_sinks(lab: Lab) -> Measurement:
    course = lab.once(_pile)
    corners = Box(size_m=PILE_BOX_M).corners_m
    deepest = 0.0
    for one in course.scene.dynamic_bodies:
        states = course.states[one.name][course.between(0.8, 1.0)]
        turn = Rotation.from_quat(states[:, 3:7], scalar_first=True).as_matrix()
        heights = states[:, 2, None] + turn[:, 2] @ corners.T
        deepest = max(deepest, -float(heights.min()))
    return Measurement(measured=1e3 * deepest, expected=0.0)
