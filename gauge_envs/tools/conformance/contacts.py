"""Contacts: friction, rebound, and energy that must not grow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import GRAVITY_M_PER_S2, Box, Contact, ContactMode, Motion, Pose, Scene
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.laws import box_inertia_kg_m2, world_inertia_kg_m2
from gauge_envs.tools.conformance.measurements import SLIDE_SLOPE_DEG, acceleration_m_per_s2, slide_acceleration
from gauge_envs.tools.conformance.model import Measurement, Tolerance
from gauge_envs.tools.conformance.registry import check
from gauge_envs.tools.conformance.scene_parts import ball, body, box, ground, vector

G = GRAVITY_M_PER_S2

# --- friction --------------------------------------------------------------------------------------------------------

CUBE_M = 0.05
BOARD_THICKNESS_M = 0.02


def _on_slope(slope_deg: float, frictions: dict[str, float], seconds: float, lab: Lab) -> Rollout:
    """Record cubes side by side on a board tilted about y, each with its own friction; the board's x is downhill."""
    slope = Pose.from_euler_deg((0.0, 0.0, 1.0), (0.0, slope_deg, 0.0))
    height = 0.5 * (CUBE_M + BOARD_THICKNESS_M)
    cubes = []
    for index, name in enumerate(frictions):
        place = slope.to_world(np.array([-0.4, 0.1 * index, height]))
        pose = Pose(position_m=vector(place), quaternion=slope.quaternion)
        cubes.append(body(name, Box(size_m=(CUBE_M,) * 3), pose))
    board = body("board", Box(size_m=(1.2, 0.6, BOARD_THICKNESS_M)), slope, mass_kg=1.0, motion=Motion.FIXED)
    contacts = tuple(
        Contact(first=(name,), second=("board",), friction=friction, restitution=0.0)
        for name, friction in frictions.items()
    )
    return lab.rollout(Scene(bodies=(*cubes, board), contacts=contacts, duration_s=seconds), seconds)


def _along_slope(rollout: Rollout, name: str) -> NDArray[np.float64]:
    """Return displacements from the start in the board's frame [m], shape [sample_count, 3]."""
    board = rollout.scene.body("board").pose.rotation
    return np.asarray(board.apply(rollout.displacement(name), inverse=True))


def _slide(lab: Lab) -> Rollout:
    return _on_slope(SLIDE_SLOPE_DEG, {"smooth": 0.1, "rough": 0.3}, 0.5, lab)


def _hold(lab: Lab) -> Rollout:
    return _on_slope(10.0, {"cube": 0.25}, 0.3, lab)


def _slide_measurement(lab: Lab, name: str, friction: float) -> Measurement:
    rollout = lab.once(_slide)
    along = _along_slope(rollout, name)
    found = slide_acceleration(acceleration_m_per_s2(rollout.times_s, along[:, 0]), friction)
    if along[-1, 2] < -0.1:
        return replace(found, hint="it falls through the board: the pair has no contact")
    return found


@check(
    "fixed-body-stays",
    title="fixed body stays",
    scene="two cubes with friction 0.1 and 0.3 on a fixed board that leans by 30 degrees",
    measures="largest displacement of the fixed board under the sliding cubes within 0.5 s",
    law="r = const",
    source="contract (scene.Motion)",
    unit="mm",
    tolerance=Tolerance(absolute=1e-3, rationale="a fixed body does not move; 1 um allows for rounding"),
    diagnosis="a fixed body must be static; gravity must not act on it",
)
def _fixed_body_stays(lab: Lab) -> Measurement:
    displacement = lab.once(_slide).displacement("board")
    return Measurement(measured=1e3 * float(np.linalg.norm(displacement, axis=1).max()), expected=0.0)


SLIDE_TOLERANCE = Tolerance(
    relative=0.01,
    rationale="real slides scatter by 1.4 to 3 % (wood to metal); the error of an engine must be well below that",
)
SLIDE_DIAGNOSIS = (
    "check how the friction of two surfaces is combined (the contract's is the pair's), the friction cone, and "
    "regularized friction"
)


@check(
    "slide",
    title="slide on 30 degrees",
    scene="two cubes with friction 0.1 and 0.3 on a fixed board that leans by 30 degrees",
    measures="acceleration downhill of a cube with friction 0.3, quadratic fit over 0.5 s",
    law="a = g (sin 30 - mu cos 30)",
    source="Coulomb",
    unit="m/s^2",
    tolerance=SLIDE_TOLERANCE,
    diagnosis=SLIDE_DIAGNOSIS,
)
def _slide_rough(lab: Lab) -> Measurement:
    return _slide_measurement(lab, "rough", 0.3)


@check(
    "slide-of-pair",
    title="friction is the pair's",
    scene="two cubes with friction 0.1 and 0.3 on a fixed board that leans by 30 degrees",
    measures="acceleration downhill of a second cube, with friction 0.1, on the same board",
    law="a = g (sin 30 - mu cos 30)",
    source="Coulomb; contract (scene.Contact)",
    unit="m/s^2",
    tolerance=SLIDE_TOLERANCE,
    diagnosis="each pair of bodies has its own friction; " + SLIDE_DIAGNOSIS,
)
def _slide_smooth(lab: Lab) -> Measurement:
    return _slide_measurement(lab, "smooth", 0.1)


@check(
    "slide-straight",
    title="slide is straight",
    scene="two cubes with friction 0.1 and 0.3 on a fixed board that leans by 30 degrees",
    measures="largest displacement of the sliding cube across the slope or normal to the board within 0.5 s",
    law="y, z in the board's frame = const",
    source="symmetry",
    unit="mm",
    tolerance=Tolerance(absolute=1.0, rationale="the real trials' scatter is about 1 mm"),
    diagnosis="the cube hops, sinks in or turns: check contact stiffness, contact points and friction anisotropy",
)
def _slide_straight(lab: Lab) -> Measurement:
    return Measurement(measured=1e3 * float(np.abs(_along_slope(lab.once(_slide), "rough")[:, 1:]).max()), expected=0.0)


@check(
    "hold",
    title="hold on 10 degrees",
    scene="a cube with friction 0.25 on a fixed board that leans by 10 degrees",
    measures="largest displacement of a cube with friction 0.25 (tan 10 = 0.18) within 0.3 s",
    law="r = const if tan(slope) < mu",
    source="Coulomb",
    unit="mm",
    tolerance=Tolerance(
        absolute=0.1, rationale="real cubes that hold scatter by 0.6 mm; creep must be small in comparison"
    ),
    diagnosis="static friction is regularized and creeps, or the cube sinks into the board",
)
def _hold_check(lab: Lab) -> Measurement:
    distance = np.linalg.norm(_along_slope(lab.once(_hold), "cube"), axis=1)
    return Measurement(measured=1e3 * float(distance.max()), expected=0.0)


# --- rebound ---------------------------------------------------------------------------------------------------------

DROP_M, RADIUS_M = 0.4, 0.03
REBOUND_FALLS = 2.1
"""Recorded time over the time of the fall."""


def _rebound(lab: Lab, restitution: float, *, drop_m: float = DROP_M, gravity: float = G) -> Measurement:
    """Measure a rebound; energy gives the outgoing speed at the height of contact, as samples are 5.6 ms apart."""
    fall_s = float(np.sqrt(2.0 * drop_m / gravity))
    seconds = REBOUND_FALLS * fall_s
    scene = Scene(
        bodies=(ball("ball", (0.0, 0.0, RADIUS_M + drop_m), radius_m=RADIUS_M), ground()),
        contacts=(
            Contact(
                first=("ball",), second=("ground",), friction=0.5, restitution=restitution, mode=ContactMode.IMPACT
            ),
        ),
        duration_s=seconds,
        gravity_m_per_s2=gravity,
    )
    return _ratio_of_speeds(lab.rollout(scene, seconds), "ball", restitution, drop_m=drop_m, gravity=gravity)


def _ratio_of_speeds(rollout: Rollout, name: str, restitution: float, *, drop_m: float, gravity: float) -> Measurement:
    """Measure the outgoing over the incoming speed of a ball that was dropped on a plane at height 0."""
    incoming = float(np.sqrt(2.0 * gravity * drop_m))
    height, speed = rollout.position(name)[:, 2] - RADIUS_M, rollout.velocity(name)[:, 2]
    falling = np.flatnonzero(speed < -0.36 * incoming)
    if not len(falling):
        return Measurement(measured=float("nan"), expected=restitution, hint="the ball does not fall")
    rising = np.flatnonzero((speed > 0.018 * incoming) & (height > 2.5e-3 * drop_m))
    rising = rising[rising > falling[0]]
    if not len(rising):
        return Measurement(measured=0.0, expected=restitution, hint="the ball does not leave the ground again")
    outgoing = speed[rising[0]] ** 2 + 2.0 * gravity * height[rising[0]]
    return Measurement(measured=float(np.sqrt(outgoing) / incoming), expected=restitution)


def _rebound_check(restitution: float) -> None:
    @check(
        f"rebound-{restitution:g}",
        title=f"rebound, e = {restitution:g}",
        scene=f"a ball of radius 30 mm dropped by {DROP_M:g} m on a plane",
        measures=f"outgoing over incoming speed of a ball dropped by {DROP_M:g} m on a plane",
        law="v' = -e v",
        source="Newton's law of restitution",
        unit="1",
        tolerance=Tolerance(
            absolute=0.005, rationale="the real ball's ratio scatters by 0.0022 over 22 trials; this is twice as much"
        ),
        diagnosis="check how restitution enters (coefficient, or damping of the contact), a threshold speed below "
        "which the engine does not rebound, and the step",
    )
    def measure(lab: Lab) -> Measurement:
        return _rebound(lab, restitution)


for _restitution in (0.2, 0.5, 0.75, 0.95):
    _rebound_check(_restitution)


def _two_balls(lab: Lab) -> Rollout:
    """Record two balls of different restitution that drop on one plane."""
    seconds = REBOUND_FALLS * float(np.sqrt(2.0 * DROP_M / G))
    values = {"lively": 0.75, "dull": 0.2}
    bodies = tuple(
        ball(name, (0.3 * index, 0.0, RADIUS_M + DROP_M), radius_m=RADIUS_M) for index, name in enumerate(values)
    )
    contacts = tuple(
        Contact(first=(name,), second=("ground",), friction=0.5, restitution=value, mode=ContactMode.IMPACT)
        for name, value in values.items()
    )
    return lab.rollout(Scene(bodies=(*bodies, ground()), contacts=contacts, duration_s=seconds), seconds)


@check(
    "rebound-of-pair",
    title="restitution is the pair's",
    scene="two balls dropped by 0.4 m on one plane, with restitutions 0.75 and 0.2",
    measures="outgoing over incoming speed of the ball with restitution 0.2",
    law="v' = -e v",
    source="Newton's law of restitution; contract (scene.Contact)",
    unit="1",
    tolerance=Tolerance(absolute=0.005, rationale="as for one ball"),
    diagnosis="each pair of bodies has its own restitution: check how the engine combines the values of two bodies",
)
def _rebound_of_pair(lab: Lab) -> Measurement:
    return _ratio_of_speeds(lab.once(_two_balls), "dull", 0.2, drop_m=DROP_M, gravity=G)


@check(
    "rebound-sustained",
    title="sustained pair does not rebound",
    scene="a ball dropped by 50 mm on a plane, with restitution 0.8 and the mode of sustained contacts",
    measures="outgoing over incoming speed of the ball",
    law="v' = 0: a sustained pair has no restitution",
    source="contract (scene.ContactMode)",
    unit="1",
    tolerance=Tolerance(absolute=0.05, rationale="the ball then rises by at most 0.25 % of the drop, 0.13 mm"),
    diagnosis="restitution has no effect on a pair of the mode SUSTAINED: give the engine the value 0",
)
def _rebound_sustained(lab: Lab) -> Measurement:
    scene = Scene(
        bodies=(ball("ball", (0.0, 0.0, RADIUS_M + SUSTAINED_DROP_M), radius_m=RADIUS_M), ground()),
        contacts=(Contact(first=("ball",), second=("ground",), friction=0.5, restitution=0.8),),
        duration_s=0.3,
    )
    return _ratio_of_speeds(lab.rollout(scene, 0.3), "ball", 0.0, drop_m=SUSTAINED_DROP_M, gravity=G)


SUSTAINED_DROP_M = 0.05
SLOW_DROP_M, SLOW_GRAVITY = 0.05, 0.1


@check(
    "rebound-slow",
    title="slow rebound",
    scene="a ball dropped by 50 mm on a plane at a gravity of 0.1 m/s^2, so that it lands with 0.1 m/s",
    measures="outgoing over incoming speed of the ball, at a restitution of 0.5",
    law="v' = -e v at any speed",
    source="Newton's law of restitution",
    unit="1",
    tolerance=Tolerance(absolute=0.01, rationale="twice that of a fast rebound, of which a slow one is the tail"),
    diagnosis="where a fast ball rebounds (rebound-0.5), the engine has a threshold speed below which it does not: set "
    "it to 0, or decline restitution",
)
def _rebound_slow(lab: Lab) -> Measurement:
    return _rebound(lab, 0.5, drop_m=SLOW_DROP_M, gravity=SLOW_GRAVITY)


# --- energy ----------------------------------------------------------------------------------------------------------


def _energy_j(rollout: Rollout) -> NDArray[np.float64]:
    """Return the kinetic and potential energy of the dynamic boxes above z = 0 [J], shape [sample_count]."""
    total = np.zeros(len(rollout.times_s))
    for one in rollout.scene.dynamic_bodies:
        assert isinstance(one.shape, Box)
        states = rollout.states[one.name]
        inertia = world_inertia_kg_m2(box_inertia_kg_m2(one.shape, one.mass_kg), rollout.rotation(one.name))
        total += 0.5 * np.einsum("ti,tij,tj->t", states[:, 10:], inertia, states[:, 10:])
        total += one.mass_kg * (0.5 * np.square(states[:, 7:10]).sum(axis=1) + G * states[:, 2])
    return total


def _largest_gain(rollout: Rollout) -> Measurement:
    energy = _energy_j(rollout)
    gain = 100.0 * float((energy - energy[0]).max() / energy[0])
    at = float(rollout.times_s[int(energy.argmax())])
    return Measurement(measured=gain, expected=0.0, hint=f"the energy is highest at {at:.3g} s")


ENERGY_TOLERANCE = Tolerance(
    absolute=1.0,
    rationale="contacts only dissipate energy; a stiff contact may store 1 %, which is 3 mm of the height of fall",
)
ENERGY_DIAGNOSIS = (
    "the engine makes energy: contacts too stiff for the step, too few solver iterations, or penetration corrections "
    "that add speed. All states may be finite all the time"
)


def _tumble(lab: Lab) -> Rollout:
    brick = box("brick", (0.0, 0.0, 0.35), (0.1, 0.06, 0.03), euler_deg=(25.0, 35.0, 10.0), mass_kg=0.4)
    contact = Contact(first=("brick",), second=("ground",), friction=0.4, restitution=0.5, mode=ContactMode.IMPACT)
    return lab.rollout(Scene(bodies=(brick, ground()), contacts=(contact,), duration_s=1.0), 1.0)


@check(
    "drop-energy",
    title="tumbling box gains no energy",
    scene="a box dropped by 0.35 m on a corner, on a plane",
    measures="largest gain of kinetic and potential energy of a box dropped on a corner, within 1 s, over the initial "
    "one",
    law="T + V <= initial T + V",
    source="contacts are passive",
    unit="%",
    tolerance=ENERGY_TOLERANCE,
    diagnosis=ENERGY_DIAGNOSIS,
)
def _drop_energy(lab: Lab) -> Measurement:
    return _largest_gain(lab.once(_tumble))


PILE = 6
PILE_BOX_M = (0.1, 0.1, 0.05)


def _pile(lab: Lab) -> Rollout:
    """Record boxes in a slanting stack that falls over."""
    boxes = tuple(
        box(f"box-{index}", (0.025 * index, 0.01 * (index % 2), 0.03 + 0.055 * index), PILE_BOX_M, mass_kg=0.3)
        for index in range(PILE)
    )
    names = tuple(one.name for one in boxes)
    contacts = (
        Contact(first=names, second=names, friction=0.4, restitution=0.0),
        Contact(first=names, second=("ground",), friction=0.4, restitution=0.0),
    )
    return lab.rollout(Scene(bodies=(*boxes, ground()), contacts=contacts, duration_s=1.0), 1.0)


@check(
    "pile-energy",
    title="falling pile gains no energy",
    scene="a slanting stack of six boxes on a plane, which falls over",
    measures="largest gain of kinetic and potential energy of six boxes that fall over, within 1 s, over the initial "
    "one",
    law="T + V <= initial T + V",
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
    scene="a slanting stack of six boxes on a plane, which falls over",
    measures="highest speed of a box of the pile, over the speed limit of the scene (Scene.speed_limit_m_per_s)",
    law="v <= 3 sqrt(2 g h)",
    source="energy; beyond this bound an episode counts as diverged",
    unit="1",
    tolerance=Tolerance(absolute=1.0, rationale="an environment ends an episode as diverged at higher speeds"),
    diagnosis=ENERGY_DIAGNOSIS,
)
def _pile_bounds(lab: Lab) -> Measurement:
    rollout = lab.once(_pile)
    speeds = [np.linalg.norm(rollout.velocity(one.name), axis=1).max() for one in rollout.scene.dynamic_bodies]
    return Measurement(measured=float(max(speeds)) / rollout.scene.speed_limit_m_per_s, expected=0.0)


@check(
    "pile-sinks",
    title="pile does not sink in",
    scene="a slanting stack of six boxes on a plane, which falls over",
    measures="deepest corner of a box of the pile below the ground, 0.8 to 1 s after the start",
    law="height >= 0",
    source="bodies are rigid",
    unit="mm",
    tolerance=Tolerance(
        absolute=0.5,
        rationale="the real trials' scatter is about 1 mm. The time of landing is ignored: a soft contact then yields "
        "by speed times its time constant, and recovers",
    ),
    diagnosis="contacts are too soft, or boxes tunnel through the plane",
)
def _pile_sinks(lab: Lab) -> Measurement:
    rollout = lab.once(_pile)
    corners = Box(size_m=PILE_BOX_M).corners_m
    deepest = 0.0
    for one in rollout.scene.dynamic_bodies:
        landed = rollout.between(0.8, 1.0)
        rotations = rollout.rotation(one.name)[landed].as_matrix()
        heights = rollout.position(one.name)[landed, 2, None] + rotations[:, 2] @ corners.T
        deepest = max(deepest, -float(heights.min()))
    return Measurement(measured=1e3 * deepest, expected=0.0)
