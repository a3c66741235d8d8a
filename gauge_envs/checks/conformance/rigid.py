"""Motion of single rigid bodies: free fall, pendulum, string, torque-free spin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.checks.conformance.kit import Measurement, Tolerance, check
from gauge_envs.checks.conformance.lab import Lab
from gauge_envs.checks.conformance.laws import (
    box_inertia_kg_m2,
    pendulum_period_s,
    spin_from_orientations,
    torque_free_orientation,
    world_inertia_kg_m2,
)
from gauge_envs.checks.conformance.parts import ball, body, box, driver, ramp
from gauge_envs.checks.rollout import Course
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
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
)
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S

__all__: list[str] = []

G = GRAVITY_M_PER_S2

# --- free fall -------------------------------------------------------------------------------------------------------

FALL_S = 0.5


def _fall(lab: Lab, gravity: float) -> Course:
    brick = box("brick", (0.3, -0.2, 3.0), (0.1, 0.06, 0.03), euler_deg=(20.0, 30.0, 40.0))
    return lab.course(Scene(bodies=(brick,), duration_s=FALL_S, gravity_m_per_s2=gravity), FALL_S)


def _earth_fall(lab: Lab) -> Course:
    return _fall(lab, G)


def _fall_acceleration(course: Course) -> float:
    """Downward acceleration by a quadratic fit, which a semi-implicit step does not bias."""
    return float(-2.0 * np.polyfit(course.times_s, course.position("brick")[:, 2], 2)[0])


def _gravity_hint(measured: float, expected: float) -> str:
    ratio = measured / expected
    if abs(ratio + 1.0) < 0.01:
        return "the body falls upward: the sign of gravity, or the z axis, is reversed"
    if abs(ratio - 1e3) < 10.0:
        return "1000 times too much: positions are in mm"
    if abs(measured) < 1e-3 * expected:
        return "the body does not fall: gravity is off, it is not dynamic, or it was dropped from the scene"
    return ""


FALL_TOLERANCE = Tolerance(
    relative=1e-3,
    rationale="a fall has no model error; 0.1 % is 0.4 mm at the ball's first impact, its real scatter is 1 mm",
)


@check(
    "free-fall",
    title="free fall",
    measures="downward acceleration of a brick in no contact, quadratic fit over 0.5 s",
    law="a = g",
    source="Galilei",
    unit="m/s^2",
    tolerance=FALL_TOLERANCE,
    diagnosis="look at gravity's size and sign, at damping of free bodies, and at the length of advance()",
)
def _free_fall(lab: Lab) -> Measurement:
    measured = _fall_acceleration(lab.once(_earth_fall))
    return Measurement(measured=measured, expected=G, hint=_gravity_hint(measured, G))


@check(
    "gravity-of-scene",
    title="gravity is the scene's",
    measures="downward acceleration of the same brick where Scene.gravity_m_per_s2 is 1.62",
    law="a = Scene.gravity_m_per_s2",
    source="contract (scene.py)",
    unit="m/s^2",
    tolerance=FALL_TOLERANCE,
    diagnosis="the backend must take gravity from the scene instead of the engine's default",
)
def _gravity_of_scene(lab: Lab) -> Measurement:
    measured = _fall_acceleration(_fall(lab, 1.62))
    return Measurement(measured=measured, expected=1.62, hint=_gravity_hint(measured, 1.62))


@check(
    "free-fall-drift",
    title="free fall is straight",
    measures="largest sideways way of the falling brick within 0.5 s",
    law="x, y = const",
    source="Galilei",
    unit="mm",
    tolerance=Tolerance(
        absolute=0.01,
        rationale="nothing acts sideways; 10 um is the rounding of single precision over some hundred steps",
    ),
    diagnosis="gravity is tilted, world axes are swapped, or another body pushes it",
)
def _free_fall_drift(lab: Lab) -> Measurement:
    way = lab.once(_earth_fall).position("brick")
    return Measurement(measured=1e3 * float(np.abs(way[:, :2] - way[0, :2]).max()), expected=0.0)


@check(
    "free-fall-turn",
    title="free fall does not turn",
    measures="largest turn of the falling brick within 0.5 s",
    law="orientation = const",
    source="Euler's equations without torque",
    unit="deg",
    tolerance=Tolerance(
        absolute=0.01, rationale="nothing turns it; single precision keeps an orientation to about 1e-5 degrees a step"
    ),
    diagnosis="gravity does not act at the centre of mass, or the orientation is read or set in another convention",
)
def _free_fall_turn(lab: Lab) -> Measurement:
    states = lab.once(_earth_fall).states["brick"]
    turns = _rotations(states) * _rotations(states)[0].inv()
    return Measurement(measured=float(np.degrees(turns.magnitude().max())), expected=0.0)


WEDGE_M = tuple((x, y, z) for x, y, z in [(0, 0, 0), (0.1, 0, 0), (0, 0.06, 0), (0, 0, 0.04)])
KINDS: dict[str, Shape] = {
    "box": Box(size_m=(0.05, 0.04, 0.03)),
    "sphere": Sphere(radius_m=0.02),
    "cylinder": Cylinder(radius_m=0.02, length_m=0.05),
    "wedge": ConvexUnion(pieces_m=(WEDGE_M,)),
}


@check(
    "all-bodies-move",
    title="no body is left out",
    measures="how many of a box, a sphere, a cylinder and a convex solid fall by g t^2 / 2 within 0.3 s",
    law="z0 - z = g t^2 / 2",
    source="contract (scene.py)",
    unit="1",
    tolerance=Tolerance(absolute=0.0, rationale="a count"),
    diagnosis="a body that the backend cannot build must be declined by supports(), not dropped or frozen",
)
def _all_bodies_move(lab: Lab) -> Measurement:
    bodies = tuple(
        body(name, shape, Pose(position_m=(0.2 * index, 0.0, 2.0))) for index, (name, shape) in enumerate(KINDS.items())
    )
    course = lab.course(Scene(bodies=bodies, duration_s=0.3), 0.3)
    expected = 0.5 * G * 0.3**2
    fallen = {name: float(course.position(name)[0, 2] - course.position(name)[-1, 2]) for name in KINDS}
    wrong = [name for name, way in fallen.items() if not abs(way - expected) < 0.02 * expected]
    hint = "; ".join(f"the {name} fell {fallen[name]:.3g} m instead of {expected:.3g} m" for name in wrong)
    return Measurement(measured=len(KINDS) - len(wrong), expected=len(KINDS), hint=hint)


# --- pendulum --------------------------------------------------------------------------------------------------------

PENDULUM_M, BOB_M, AMPLITUDE_RAD = 0.2, 0.05, np.radians(60.0)
PIVOT_M = (0.1, 0.2, 1.0)
SWING_S = 3.0


def _pendulum(lab: Lab) -> Course:
    """A sphere that turns with a hinge about y, let go at 60 degrees."""
    x, z = PENDULUM_M * np.sin(AMPLITUDE_RAD), -PENDULUM_M * np.cos(AMPLITUDE_RAD)
    bob = ball("bob", (float(PIVOT_M[0] + x), PIVOT_M[1], float(PIVOT_M[2] + z)), radius_m=BOB_M)
    hinge = Hinge(body="bob", anchor_m=PIVOT_M, axis=(0.0, 1.0, 0.0))
    return lab.course(Scene(bodies=(bob,), joints=(hinge,), duration_s=SWING_S), SWING_S)


def _pendulum_angle(course: Course) -> NDArray[np.float64]:
    arm = course.position("bob") - np.asarray(PIVOT_M)
    return np.asarray(np.arctan2(arm[:, 0], -arm[:, 2]))


def _period_s(times_s: NDArray[np.float64], angle: NDArray[np.float64]) -> float:
    """Mean period from the upward zero crossings; NaN when there are fewer than two."""
    before = np.flatnonzero((angle[:-1] < 0.0) & (angle[1:] >= 0.0))
    share = angle[before] / (angle[before] - angle[before + 1])
    crossings = times_s[before] + share * np.diff(times_s)[before]
    return float(np.diff(crossings).mean()) if len(crossings) > 1 else float("nan")


@check(
    "pendulum-period",
    title="pendulum, period",
    measures="mean period of a sphere on a hinge let go at 60 degrees, over 3 s",
    law="T = 4 sqrt((l^2 + k^2) / (g l)) K(sin^2(theta / 2))",
    source="physical pendulum, complete elliptic integral",
    unit="s",
    tolerance=Tolerance(
        relative=2e-3, rationale="after the benchmark's 100 periods, 0.2 % is a fifth of a period out of step"
    ),
    diagnosis="look at the bob's own inertia (2/5 m r^2 is 2.5 % of it), the hinge's place, damping and armature",
)
def _pendulum_period(lab: Lab) -> Measurement:
    course = lab.once(_pendulum)
    gyration = float(np.sqrt(0.4) * BOB_M)
    expected = pendulum_period_s(
        length_m=PENDULUM_M, gyration_m=gyration, amplitude_rad=float(AMPLITUDE_RAD), gravity_m_per_s2=G
    )
    return Measurement(measured=_period_s(course.times_s, _pendulum_angle(course)), expected=expected)


@check(
    "pendulum-energy",
    title="pendulum, energy",
    measures="kinetic and potential energy lost (negative: gained) within 3 s, over m g times the height of the swing",
    law="T + V = const",
    source="frictionless hinge (scene.py)",
    unit="%",
    tolerance=Tolerance(
        absolute=1.0, rationale="EL, the benchmark's energy score, reads per cent over 100 s; 1 % in 3 s would swamp it"
    ),
    diagnosis="the hinge or the body is damped (joint damping, friction, angular damping), or the integrator is lossy",
)
def _pendulum_energy(lab: Lab) -> Measurement:
    course = lab.once(_pendulum)
    kinetic = 0.5 * (np.square(course.velocity("bob")) + 0.4 * BOB_M**2 * np.square(course.spin("bob"))).sum(axis=1)
    energy = kinetic + G * course.position("bob")[:, 2]
    lost = energy[0] - energy
    worst = float(lost[np.abs(lost).argmax()])
    return Measurement(measured=100.0 * worst / (G * PENDULUM_M * (1.0 - np.cos(AMPLITUDE_RAD))), expected=0.0)


@check(
    "hinge-radius",
    title="hinge holds",
    measures="largest change of the bob's distance from the hinge's axis, or along it, within 3 s",
    law="|r - anchor| = l",
    source="hinge (scene.py)",
    unit="mm",
    tolerance=Tolerance(absolute=0.2, rationale="0.1 % of the arm, 0.05 % of the period"),
    diagnosis="the joint is a soft constraint that gives way: stiffen it, or use reduced coordinates",
)
def _hinge_radius(lab: Lab) -> Measurement:
    arm = lab.once(_pendulum).position("bob") - np.asarray(PIVOT_M)
    miss = np.maximum(np.abs(np.hypot(arm[:, 0], arm[:, 2]) - PENDULUM_M), np.abs(arm[:, 1]))
    return Measurement(measured=1e3 * float(miss.max()), expected=0.0)


# --- string ----------------------------------------------------------------------------------------------------------

STRING_M, SLACK_M = 0.3, 0.1


def _tether(lab: Lab) -> Course:
    """A ball on a slack string: it falls until the string is taut."""
    bob = ball("bob", (0.0, 0.0, 1.0 - STRING_M + SLACK_M), radius_m=0.01)
    string = Tether(body="bob", anchor_m=(0.0, 0.0, 1.0), length_m=STRING_M)
    return lab.course(Scene(bodies=(bob,), joints=(string,), duration_s=1.0), 1.0)


@check(
    "tether-slack",
    title="slack string does nothing",
    measures="acceleration of a ball while its string is slack, over the first 0.13 s",
    law="a = g",
    source="tether (scene.py): it only pulls",
    unit="m/s^2",
    tolerance=Tolerance(relative=0.01, rationale="the fit is over 23 samples only"),
    diagnosis="the string pushes: a rod or a spring stands for it",
)
def _tether_slack(lab: Lab) -> Measurement:
    course = lab.once(_tether)
    falling = course.between(0.0, 0.13)
    fit = np.polyfit(course.times_s[falling], course.position("bob")[falling, 2], 2)
    return Measurement(measured=float(-2.0 * fit[0]), expected=G)


@check(
    "tether-length",
    title="taut string does not stretch",
    measures="largest distance of the ball from the string's anchor, the jerk included",
    law="|r - anchor| <= l",
    source="tether (scene.py): inextensible",
    unit="mm",
    tolerance=Tolerance(relative=0.01, rationale="1 % of the length is 0.5 % of a swing's period"),
    diagnosis="the string is too soft, or it is missing",
)
def _tether_length(lab: Lab) -> Measurement:
    distance = np.linalg.norm(lab.once(_tether).position("bob") - [0.0, 0.0, 1.0], axis=1)
    return Measurement(measured=1e3 * float(distance.max()), expected=1e3 * STRING_M)


# --- torque-free spin ------------------------------------------------------------------------------------------------
# The contract has no start velocities, so a driven ball hits a floating brick off its centre and draws back.

BRICK_M = (0.1, 0.06, 0.03)
BRICK_KG = 0.4
HIT_S, SPIN_END_S = 0.25, 0.75
HAMMER_RADIUS_M, GAP_M = 0.02, 0.03


def _struck(lab: Lab, brick: RigidBody, corner_m: tuple[float, float, float]) -> Course:
    """Course of a floating body that a driven ball hits at a point of its upper z face, along that face's normal."""
    inward = brick.pose.rotation.apply([0.0, 0.0, -1.0])
    x, y, z = brick.pose.to_world(np.asarray(corner_m)) - (HAMMER_RADIUS_M + GAP_M) * inward
    hammer = body(
        "hammer",
        Sphere(radius_m=HAMMER_RADIUS_M),
        Pose(position_m=(float(x), float(y), float(z))),
        mass_kg=1.0,
        motion=Motion.KINEMATIC,
    )
    stroke = ramp(0.05, start_s=0.0, duration_s=0.08, ramp_s=0.03)
    back = ramp(-0.35, start_s=0.08, duration_s=0.4, ramp_s=0.05)
    axis = (float(inward[0]), float(inward[1]), float(inward[2]))
    scene = Scene(
        bodies=(brick, hammer),
        contacts=(Contact(first=(brick.name,), second=("hammer",), friction=0.0, restitution=0.0),),
        drivers=(driver("hammer", "translate", axis, stroke, back),),
        duration_s=SPIN_END_S,
        gravity_m_per_s2=0.0,
    )
    return lab.course(scene, SPIN_END_S)


def _spinning_brick(lab: Lab) -> Course:
    brick = box("brick", (0.2, 0.1, 1.0), BRICK_M, euler_deg=(50.0, -20.0, 70.0), mass_kg=BRICK_KG)
    return _struck(lab, brick, (0.035, 0.018, 0.015))


SOLID_ORIGIN_M = np.array([-0.05, -0.03, -0.015])
"""Body origin of the same brick as a convex solid, in the frame of the brick: one of its corners."""


def _spinning_solid(lab: Lab) -> Course:
    corners = tuple((float(x), float(y), float(z)) for x, y, z in Box(size_m=BRICK_M).corners_m - SOLID_ORIGIN_M)
    solid = body(
        "brick",
        ConvexUnion(pieces_m=(corners,)),
        Pose.from_euler_deg((0.2, 0.1, 1.0), (50.0, -20.0, 70.0)),
        mass_kg=BRICK_KG,
    )
    x, y, z = np.array([0.035, 0.018, 0.015]) - SOLID_ORIGIN_M
    return _struck(lab, solid, (float(x), float(y), float(z)))


def _rotations(states: NDArray[np.float64]) -> Rotation:
    return Rotation.from_quat(states[:, 3:7], scalar_first=True)


def _not_spinning(course: Course) -> Measurement | None:
    """A failed reading if the hit did not set the body spinning, since nothing can be measured then."""
    turn = _rotations(course.states["brick"][course.between(HIT_S, SPIN_END_S)])
    turned = float(np.degrees((turn[1:] * turn[:-1].inv()).magnitude().sum()))
    if turned > 60.0:
        return None
    hint = f"the driven ball did not set the body spinning: it turned by {turned:.2g} degrees within 0.5 s"
    return Measurement(measured=float("nan"), expected=0.0, hint=hint)


@check(
    "spin-momentum",
    title="torque-free spin, angular momentum",
    measures="largest change of a spinning brick's angular momentum within 0.5 s, over its size",
    law="L = R I R' omega = const",
    source="Euler",
    unit="%",
    tolerance=Tolerance(
        absolute=1.0,
        rationale="a tumbling body falls for about 0.3 s before it lands; 1 % is 2 degrees of its turn by then",
    ),
    diagnosis="look at angular damping, the gyroscopic term, the inertia, and the frame of the angular velocity",
)
def _spin_momentum(lab: Lab) -> Measurement:
    course = lab.once(_spinning_brick)
    if failed := _not_spinning(course):
        return failed
    states = course.states["brick"][course.between(HIT_S, SPIN_END_S)]
    inertia = world_inertia_kg_m2(box_inertia_kg_m2(Box(size_m=BRICK_M), BRICK_KG), _rotations(states))
    momentum = np.einsum("tij,tj->ti", inertia, states[:, 10:])
    change = np.linalg.norm(momentum - momentum[0], axis=1).max() / np.linalg.norm(momentum[0])
    return Measurement(measured=100.0 * float(change), expected=0.0)


@check(
    "spin-orientation",
    title="torque-free spin, orientation",
    measures="angle between the spinning brick after 0.5 s and Euler's equations integrated from its start",
    law="I domega/dt + omega x I omega = 0",
    source="Euler, integrated by scipy's DOP853",
    unit="deg",
    tolerance=Tolerance(
        absolute=3.0, rationale="it has turned by several hundred degrees: 1 %, as for its angular momentum"
    ),
    diagnosis="the gyroscopic term, the inertia, or the sign or frame of the reported angular velocity is wrong",
)
def _spin_orientation(lab: Lab) -> Measurement:
    course = lab.once(_spinning_brick)
    if failed := _not_spinning(course):
        return failed
    states = course.states["brick"][course.between(HIT_S, SPIN_END_S)]
    turn = _rotations(states)
    expected = torque_free_orientation(
        start=turn[0],
        spin_rad_per_s=states[0, 10:],
        moments=box_inertia_kg_m2(Box(size_m=BRICK_M), BRICK_KG),
        seconds=SPIN_END_S - HIT_S,
    )
    miss = float(np.degrees((turn[-1] * expected.inv()).magnitude()))
    return Measurement(measured=miss, expected=0.0)


DERIVATIVE_TOLERANCE = Tolerance(
    absolute=2.0,
    rationale="central differences over 11 ms are 0.3 % off at this spin; a wrong frame or sign is 10 to 200 %",
)


@check(
    "angular-velocity",
    title="angular velocity is in the world frame",
    measures="largest distance of the reported angular velocity from the derivative of the orientation, over its size",
    law="dR/dt = [omega] R",
    source="contract (Simulation.body_states)",
    unit="%",
    tolerance=DERIVATIVE_TOLERANCE,
    diagnosis="columns 10 to 12 of body_states are the angular velocity in rad/s in the world frame",
)
def _angular_velocity(lab: Lab) -> Measurement:
    course = lab.once(_spinning_brick)
    if failed := _not_spinning(course):
        return failed
    states = course.states["brick"][course.between(HIT_S, SPIN_END_S)]
    turn = _rotations(states)
    actual = spin_from_orientations(turn, SAMPLE_INTERVAL_S)
    reported = states[1:-1, 10:]
    size = np.linalg.norm(actual, axis=1).mean()

    def miss(values: NDArray[np.float64]) -> float:
        return float(np.linalg.norm(values - actual, axis=1).max() / size)

    explanations = {
        "it has the wrong sign": -reported,
        "it is in the body frame": turn[1:-1].apply(reported),
        "it is in degrees": np.radians(reported),
    }
    hint = next((text for text, values in explanations.items() if miss(values) < 0.03), "")
    return Measurement(measured=100.0 * miss(reported), expected=0.0, hint=hint)


@check(
    "velocity-of-origin",
    title="velocity is that of the body's origin",
    measures="largest distance of the reported velocity from the derivative of the position, over its size, of a "
    "spinning solid whose origin is one of its corners",
    law="v = dr/dt",
    source="contract (Simulation.body_states)",
    unit="%",
    tolerance=DERIVATIVE_TOLERANCE,
    diagnosis="columns 7 to 9 of body_states are the velocity of the body's origin in m/s in the world frame",
)
def _velocity_of_origin(lab: Lab) -> Measurement:
    course = lab.once(_spinning_solid)
    if failed := _not_spinning(course):
        return failed
    states = course.states["brick"][course.between(HIT_S, SPIN_END_S)]
    actual = (states[2:, :3] - states[:-2, :3]) / (2.0 * SAMPLE_INTERVAL_S)
    reported = states[1:-1, 7:10]
    size = np.linalg.norm(actual, axis=1).mean()
    turn = _rotations(states)[1:-1]
    arm = turn.apply(-SOLID_ORIGIN_M)

    def miss(values: NDArray[np.float64]) -> float:
        return float(np.linalg.norm(values - actual, axis=1).max() / size)

    explanations = {
        "it is the velocity of the centre of mass": reported - np.cross(states[1:-1, 10:], arm),
        "it is in the body frame": turn.apply(reported),
        "it has the wrong sign": -reported,
        "it is in mm/s": 1e-3 * reported,
    }
    hint = next((text for text, values in explanations.items() if miss(values) < 0.03), "")
    return Measurement(measured=100.0 * miss(reported), expected=0.0, hint=hint)


@check(
    "solid-spin-centre",
    title="convex solid turns about its centre of mass",
    measures="largest distance of the free solid's centre of mass from a straight line within 0.5 s",
    law="centre of mass moves uniformly",
    source="Newton; uniform density (scene.py)",
    unit="mm",
    tolerance=Tolerance(absolute=0.5, rationale="the real trials' scatter is about 1 mm"),
    diagnosis="the centre of mass is not that of the solid's volume: the origin of its frame was taken for it",
)
def _solid_spin_centre(lab: Lab) -> Measurement:
    course = lab.once(_spinning_solid)
    if failed := _not_spinning(course):
        return failed
    window = course.between(HIT_S, SPIN_END_S)
    states, times = course.states["brick"][window], course.times_s[window]
    centre = states[:, :3] + _rotations(states).apply(-SOLID_ORIGIN_M)
    line = np.polynomial.polynomial.polyfit(times, centre, 1)
    miss = np.linalg.norm(centre - (line[0] + np.outer(times, line[1])), axis=1).max()
    return Measurement(measured=1e3 * float(miss), expected=0.0)
