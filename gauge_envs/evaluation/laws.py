"""Exact motions of rigid bodies: laws until an event, and the closed form of an experiment with its own constants.

The laws are free flight until the first contact, and a slide until the body tips over. The closed form of an experiment
is chosen by what is in the scene, never by a name. A scene has one if a single rigid body is recorded, and its motion
follows from friction, restitution or gravity alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import linprog
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from gauge_envs.errors import ShapeError
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.bands import BandGrade
from gauge_envs.scene import Hinge, Motion, Plane, RigidBody, Scene, Sphere
from gauge_envs.scene.contact_faces import TOUCHING_M
from gauge_envs.scene.meshes import body_mass_properties
from gauge_envs.scene.timing import FRAME_RATE_HZ

FloatArray = NDArray[np.float64]

LEAST_APEX_M = 1e-9
"""Height of a rebound below which the ball rests [m]."""


@dataclass(frozen=True)
class Straight:
    """Motion from rest along a line with constant acceleration.

    Attributes:
        start_m: Position at frame 0 [m], shape [3].
        direction: Unit vector of the motion, shape [3].
        acceleration_m_per_s2: Acceleration [m/s^2].
        distance_m: Distance at which the motion ends [m]; infinity if nothing ends it.
    """

    start_m: FloatArray
    direction: FloatArray
    acceleration_m_per_s2: float
    distance_m: float

    @property
    def end_s(self) -> float:
        """Time at which the motion ends [s]."""
        return math.sqrt(2.0 * self.distance_m / self.acceleration_m_per_s2)

    def positions_mm(self, frame_count: int) -> FloatArray:
        """Return the positions at 30 Hz [mm], shape [frame_count, 3], NaN from the end of the motion on."""
        times_s = np.arange(frame_count) / FRAME_RATE_HZ
        travel_m = 0.5 * self.acceleration_m_per_s2 * np.square(times_s)
        positions = 1e3 * (self.start_m + travel_m[:, None] * self.direction)
        positions[times_s >= self.end_s] = np.nan
        return positions


def free_flight(scene: Scene, body: str) -> Straight:
    """Return the free fall of a body from rest until it first touches another one.

    It falls without rotation, because nothing acts on it but gravity.

    Args:
        scene: The scene.
        body: Name of the body.
    """
    falling = scene.body(body)
    down = np.array([0.0, 0.0, -1.0])
    others = [other for other in scene.bodies if other.name != body]
    distance = min(distance_to_contact_m(falling, other, down) for other in others)
    if distance <= TOUCHING_M:
        raise ShapeError(f"{body} touches another body at the start: free flight has no frame. Use another law.")
    return Straight(np.array(falling.pose.position_m), down, scene.gravity_m_per_s2, distance)


def slide(scene: Scene, body: str, support: str) -> Straight:
    """Return the Coulomb slide of a body from rest, down the face of a fixed one, until it tips over the face's edge.

    The contact force acts where its line passes through the centroid. Friction shifts that point down the slope by mu
    times the height of the centroid above the face. The body tips when the point leaves the face.

    Args:
        scene: The scene; both bodies are convex, and the origin of the sliding one is its centroid.
        body: Name of the sliding body.
        support: Name of the body on which it slides.
    """
    sliding, fixed = scene.body(body), scene.body(support)
    facets = np.unique(ConvexHull(_corners_m(fixed)).equations.round(9), axis=0)
    gaps = (_corners_m(sliding) @ facets[:, :3].T + facets[:, 3]).min(axis=0)
    face = int(np.argmax(gaps))
    if abs(gaps[face]) > TOUCHING_M:
        raise ShapeError(f"{body} is {1e3 * gaps[face]:.3f} mm away from {support}: it does not slide on it")
    normal = facets[face, :3]
    downhill = np.array([0.0, 0.0, -1.0]) + normal[2] * normal
    sine = float(np.linalg.norm(downhill))
    friction = _friction(scene, body, support)
    acceleration = scene.gravity_m_per_s2 * (sine - friction * float(normal[2]))
    if sine == 0.0 or acceleration <= 0.0:
        raise ShapeError(f"friction {friction:.4g} holds {body} on {support}: it does not slide")
    direction = downhill / sine
    start = np.array(sliding.pose.position_m)
    height = float(start @ normal + facets[face, 3])
    pressure = start - height * normal + friction * height * direction
    # Distance to each plane that bounds the support, along the slope.
    rates = facets[:, :3] @ direction
    ahead = rates > 1e-6
    to_edge = -(facets[ahead, :3] @ pressure + facets[ahead, 3]) / rates[ahead]
    if to_edge.min() <= 0.0:
        raise ShapeError(f"the force on {body} does not pass through {support}: it tips at once")
    others = [other for other in scene.bodies if other.name not in (body, support)]
    free = [distance_to_contact_m(sliding, other, direction) for other in others]
    return Straight(start, direction, acceleration, float(min(*to_edge, *free)))


def distance_to_contact_m(moving: RigidBody, other: RigidBody, direction: FloatArray) -> float:
    """Return how far a body can move along a direction before it touches another one [m]; infinity if it never does.

    The bodies are unions of convex pieces. For each pair of pieces a linear program finds the shortest distance after
    which they share a point.

    Args:
        moving: The body that moves.
        other: The body that does not, a plane among others.
        direction: Unit vector, shape [3].
    """
    if isinstance(other.shape, Plane):
        normal = other.pose.rotation.apply([0.0, 0.0, 1.0])
        rate = -float(normal @ direction)
        lowest = float(((_corners_m(moving) - np.array(other.pose.position_m)) @ normal).min())
        return lowest / rate if rate > 0.0 else math.inf
    return min(
        _piece_distance_m(piece, against, direction) for piece in _pieces_m(moving) for against in _pieces_m(other)
    )


def _piece_distance_m(piece: FloatArray, against: FloatArray, direction: FloatArray) -> float:
    """Return the least d >= 0 for which a point of one hull, moved by d, is a point of the other; infinity without."""
    count, other_count = len(piece), len(against)
    points = np.concatenate([piece.T, -against.T, direction[:, None]], axis=1)
    sums = np.zeros((2, count + other_count + 1))
    sums[0, :count] = sums[1, count:-1] = 1.0
    cost = np.zeros(count + other_count + 1)
    cost[-1] = 1.0
    found = linprog(cost, A_eq=np.concatenate([points, sums]), b_eq=[0.0, 0.0, 0.0, 1.0, 1.0])
    return float(found.x[-1]) if found.success else math.inf


def _pieces_m(body: RigidBody) -> list[FloatArray]:
    """Return the corners of each convex piece in the world [m]."""
    pieces = getattr(body.shape, "pieces_m", None)
    corners = [np.asarray(piece) for piece in pieces] if pieces else [body.shape.corners_m]
    return [body.pose.to_world(piece) for piece in corners]


def _corners_m(body: RigidBody) -> FloatArray:
    return body.pose.to_world(body.shape.corners_m)


def _friction(scene: Scene, body: str, support: str) -> float:
    """Return the coefficient of friction of the contact of two bodies."""
    return next(
        contact.friction
        for contact in scene.contacts
        if {body, support} in [set(pair) for pair in scene.colliding_pairs(contact)]
    )


# --- experiments ---


def closed_form(experiment: Experiment) -> FloatArray | None:
    """Return the exact g(t) of an experiment at its frames.

    - Where the package states a law in place of trials, as for a carried body, it is that law.
    - A body that starts on the face of a fixed one slides with g (sin - mu cos), until it tips over the edge.
    - A ball above a level plane falls, and each rebound has `e` times the speed of the impact, in no time.
    - A body on a hinge that touches nothing swings as a physical pendulum, integrated to 1e-11.

    Args:
        experiment: The experiment; its constants are those of its parameters.

    Returns:
        Positions [mm], shape [frame_count, 3], NaN where the form has ended; None without a form.
    """
    if experiment.score.observable is not Observable.POSITION or len(experiment.recorded) != 1:
        return None
    stated = _stated(experiment)
    if stated is not None:
        return stated
    scene, body = experiment.scene, experiment.scene.body(experiment.recorded[0])
    is_alone = len(scene.dynamic_bodies) == 1 and not scene.drivers and not scene.deformables
    if not is_alone or body.motion is not Motion.DYNAMIC or not body.starts_at_rest:
        return None
    hinges = [joint for joint in scene.joints if isinstance(joint, Hinge)]
    if hinges:
        return None if scene.contacts else _swing(scene, body, hinges[0], experiment.frame_count)
    if isinstance(body.shape, Sphere):
        return _rebounds(scene, body, experiment.frame_count)
    return _slide(scene, body, experiment.frame_count)


def _stated(experiment: Experiment) -> FloatArray | None:
    """Return the law that the package states for an experiment, if it gives all three coordinates."""
    band = reference_band(experiment)
    if band is None or band.grade is not BandGrade.LAW or band.projection.shape != (3, 3):
        return None
    return np.asarray(band.mean @ np.linalg.inv(band.projection).T)


def _slide(scene: Scene, body: RigidBody, frame_count: int) -> FloatArray | None:
    for support in scene.bodies:
        if support.motion is Motion.FIXED and not isinstance(support.shape, Plane):
            try:
                return slide(scene, body.name, support.name).positions_mm(frame_count)
            except ShapeError:
                continue
    return None


def _rebounds(scene: Scene, ball: RigidBody, frame_count: int) -> FloatArray | None:
    """Return the motion of a ball that falls on a level plane and rebounds."""
    planes = [other for other in scene.bodies if other.name != ball.name]
    if len(planes) != 1 or not isinstance(planes[0].shape, Plane):
        return None
    pair = {ball.name, planes[0].name}
    contact = next((one for one in scene.contacts if pair in map(set, scene.colliding_pairs(one))), None)
    normal = planes[0].pose.rotation.apply([0.0, 0.0, 1.0])
    if contact is None or normal[2] < 1.0 - 1e-9:
        return None
    gravity, restitution = scene.gravity_m_per_s2, contact.restitution
    drop_m = distance_to_contact_m(ball, planes[0], np.array([0.0, 0.0, -1.0]))
    start = np.array(ball.pose.position_m)
    times_s = np.arange(frame_count) / FRAME_RATE_HZ
    heights_m = np.maximum(drop_m - 0.5 * gravity * times_s**2, 0.0)
    speed, begin_s = restitution * math.sqrt(2.0 * gravity * drop_m), math.sqrt(2.0 * drop_m / gravity)
    while begin_s < times_s[-1] and speed**2 / (2.0 * gravity) > LEAST_APEX_M:
        since_s = times_s - begin_s
        inside = (since_s >= 0.0) & (since_s <= 2.0 * speed / gravity)
        heights_m[inside] = (speed * since_s - 0.5 * gravity * since_s**2)[inside]
        begin_s += 2.0 * speed / gravity
        speed *= restitution
    return 1e3 * (start + np.outer(heights_m - drop_m, [0.0, 0.0, 1.0]))


def _swing(scene: Scene, body: RigidBody, hinge: Hinge, frame_count: int) -> FloatArray:
    """Return the motion of a body on a hinge, by the equation of the physical pendulum."""
    axis, anchor = np.asarray(hinge.axis) / np.linalg.norm(hinge.axis), np.asarray(hinge.anchor_m)
    centre, inertia = body_mass_properties(body)
    arm = body.pose.to_world(centre) - anchor
    own_axis = body.pose.rotation.inv().apply(axis)
    across = arm - (arm @ axis) * axis
    moment = float(own_axis @ inertia @ own_axis) + body.mass_kg * float(across @ across)
    weight = np.array([0.0, 0.0, -scene.gravity_m_per_s2 * body.mass_kg])

    def rate(_: float, state: FloatArray) -> list[float]:
        torque = np.cross(Rotation.from_rotvec(state[0] * axis).apply(arm), weight)
        return [state[1], float(torque @ axis) / moment]

    times_s = np.arange(frame_count) / FRAME_RATE_HZ
    found = solve_ivp(rate, (0.0, times_s[-1]), [0.0, 0.0], "DOP853", times_s, rtol=1e-11, atol=1e-12)
    turns = Rotation.from_rotvec(found.y[0][:, None] * axis)
    return np.asarray(1e3 * (anchor + turns.apply(np.asarray(body.pose.position_m) - anchor)))
