"""The exact motion of a scene: a closed form with the constants, the start and the gravity of the scene.

The TOML file of a reference names its law, `exact_law`. Driven scenes have no closed form, and a solution is its own
exact motion.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.band import Band, ExactLaw
from gauge_envs.scene import Box, Contact, Motion, Plane, RigidBody, Scene, Sphere
from gauge_envs.scene.geometry import BoolArray, FloatArray, length_of
from gauge_envs.scoring.reference import reference_band

CONTACT_TOLERANCE_M = 1e-4
"""Largest gap or overlap of two bodies that touch at the start [m]; published places have 6 digits."""

FLAT_TOLERANCE = 1e-6
"""Largest deviation from 1 of the cosine between two parallel axes."""

REST_SPEED_M_PER_S = 1e-6
"""Speed below which a ball no longer rebounds [m/s]: it would rise by less than 1e-13 m."""

Path = Callable[[FloatArray], FloatArray]
"""Positions of a body, shape [S, 3], at times since the release [s], shape [S]."""

Law = Callable[[Scene, RigidBody], Path | None]
"""Path of a body [m] at times that are not negative, or None without one."""

TINY = np.finfo(float).tiny


def exact_motion(experiment: Experiment, times_s: FloatArray) -> FloatArray | None:
    """Return g(t) of the exact solution of a scene, shape [S, D]; None without a closed form, see `exact_path`.

    Args:
        experiment: Experiment with any constants and start.
        times_s: Any times since the release [s], shape [S]. Before 0 the body rests.
    """
    path = exact_path(experiment, reference_band(experiment))
    return None if path is None else path(times_s)


def exact_path(experiment: Experiment, band: Band | None) -> Path | None:
    """Return the exact path of a scene [mm]; None without a closed form.

    A scene outside the limits of its law has none: another body, a sliding body with a start velocity, or a start
    without the contact that the law needs. Neither has a scene that a model file of an engine replaces and changes.

    Args:
        experiment: Experiment with any constants and start.
        band: Reference of the experiment, which names the law; None without one.
    """
    is_replaced = experiment.edited and experiment.model_file is not None
    if band is None or band.exact_law is None or is_replaced:
        return None
    scene = experiment.scene
    path_m = LAWS[band.exact_law](scene, scene.body(experiment.recorded[0]))
    return None if path_m is None else partial(_places_mm, path_m)


def _places_mm(path_m: Path, times_s: FloatArray) -> FloatArray:
    return 1e3 * path_m(np.maximum(times_s, 0.0))


def law_holds(experiment: Experiment, places_mm: FloatArray, band: Band) -> BoolArray:
    """Return where a closed form holds on its path [mm], shape [S]: a slide ends as the box leaves its board."""
    scene = experiment.scene
    body = scene.body(experiment.recorded[0])
    holds = np.ones(len(places_mm), dtype=np.bool_)
    if band.exact_law is ExactLaw.COULOMB_SLIDE and isinstance(body.shape, Box):
        reach_m = 0.5 * max(body.shape.size_m) + CONTACT_TOLERANCE_M
        for board, _ in _supports(scene, body, Box):
            is_on = _normal_of_rest(board, body) is not None
            if isinstance(board.shape, Box) and is_on:
                centres_m = np.abs(board.pose.to_body(1e-3 * places_mm))
                outside_m = centres_m - 0.5 * np.array(board.shape.size_m)
                holds &= (outside_m <= reach_m).all(axis=1)
    return holds


def coulomb_slide(scene: Scene, body: RigidBody) -> Path | None:
    """Return the path of a box that slides down a fixed box from rest, see `Law`.

    The board at the angle theta carries m g cos(theta), so friction pulls with up to mu m g cos(theta) against the
    m g sin(theta) of the weight: the box slides by g (sin(theta) - mu cos(theta)) t^2 / 2 along the steepest descent.

    The box sticks if mu >= tan(theta). It must lie flat on a face of the board with its centre over it, else the answer
    is None. It does not tip, and the board has no end: see `law_holds`.
    """
    if not body.starts_at_rest:
        return None
    for board, contact in _supports(scene, body, Box):
        normal = _normal_of_rest(board, body)
        if normal is None or normal[2] <= 0.0:
            continue
        weight = np.array([0.0, 0.0, -scene.gravity_m_per_s2])
        load = -float(weight @ normal)
        along = weight + load * normal
        pull = length_of(along)
        acceleration = max(pull - contact.friction * load, 0.0)
        change = 0.5 * acceleration * (along / max(pull, TINY))
        start_m = np.array(body.pose.position_m)
        return lambda times_s: start_m + np.outer(times_s**2, change)
    return None


def ideal_rebounds(scene: Scene, ball: RigidBody) -> Path | None:
    """Return the path of a ball that flies, with any velocity and spin, and rebounds from a plane, see `Law`.

    The flight is a parabola. An impact takes no time; see `_rebound`. After the last rebound the ball rests on the
    plane and keeps its horizontal velocity: it rolls, if it no longer slips.

    The plane must be level and below the ball, else the answer is None.
    """
    if not isinstance(ball.shape, Sphere):
        return None
    for plane, contact in _supports(scene, ball, Plane):
        rest_m = plane.pose.position_m[2] + ball.shape.radius_m
        is_level = plane.pose.matrix[2, 2] >= 1.0 - FLAT_TOLERANCE
        if is_level and ball.pose.position_m[2] >= rest_m - CONTACT_TOLERANCE_M:
            gravity = scene.gravity_m_per_s2
            return partial(_bounces, ball, rest_m, contact, gravity)
    return None


def _bounces(
    ball: RigidBody,
    rest_m: float,
    contact: Contact,
    gravity_m_per_s2: float,
    times_s: FloatArray,
) -> FloatArray:
    """Return the positions [m], shape [S, 3], of a ball that rebounds when its centre is at a height [m]."""
    place_m = np.array(ball.pose.position_m)
    velocity = np.array(ball.linear_velocity_m_per_s)
    spin = np.array(ball.angular_velocity_rad_per_s)
    weight, start_s = gravity_m_per_s2, 0.0
    positions_m = np.tile(place_m, (len(times_s), 1))
    while start_s <= times_s.max():
        since_s = times_s - start_s
        path_m = place_m + np.outer(since_s, velocity)
        path_m[:, 2] -= 0.5 * weight * since_s**2
        positions_m = np.where(since_s[:, None] >= 0.0, path_m, positions_m)
        if not weight:
            break
        drop_m = max(place_m[2] - rest_m, 0.0)
        speed = math.sqrt(velocity[2] ** 2 + 2.0 * weight * drop_m)
        fall_s = (velocity[2] + speed) / weight
        start_s += fall_s
        place_m = np.array([*(place_m + fall_s * velocity)[:2], rest_m])
        velocity[2] = -speed
        velocity, spin = _rebound(ball, velocity, spin, contact)
        if velocity[2] <= REST_SPEED_M_PER_S:
            velocity[2] = weight = 0.0
    return positions_m


def _rebound(
    ball: RigidBody, velocity: FloatArray, spin: FloatArray, contact: Contact
) -> tuple[FloatArray, FloatArray]:
    """Return velocity [m/s] and spin [rad/s] of a rigid ball after an impact on a level plane.

    The normal speed u becomes e u. The slip s at the contact loses at most mu (1 + e) u of velocity, as friction of
    Coulomb during the impact, and at most s / (1 + k): then the ball grips and rolls. k = m r^2 / I is 2.5 for a
    uniform ball and 1.5 for a thin shell.

    Args:
        ball: The ball.
        velocity: Velocity before it, downwards.
        spin: Angular velocity before it.
        contact: Friction and restitution of the pair.
    """
    assert isinstance(ball.shape, Sphere), "a law of a ball"
    radius_m = ball.shape.radius_m
    inertia = ball.inertia_kg_m2 or 0.4 * ball.mass_kg * radius_m**2
    compliance = ball.mass_kg * radius_m**2 / inertia
    normal = -(1.0 + contact.restitution) * velocity[2]
    slip = np.array(
        [velocity[0] - radius_m * spin[1], velocity[1] + radius_m * spin[0], 0.0]
    )
    slip_speed = length_of(slip)
    loss = min(contact.friction * normal, slip_speed / (1.0 + compliance))
    change = -loss * slip / max(slip_speed, TINY)
    torque = np.array([change[1], -change[0], 0.0])
    rebound = velocity + change
    rebound[2] += normal
    return rebound, spin + compliance / radius_m * torque


LAWS: dict[ExactLaw, Law] = {
    ExactLaw.COULOMB_SLIDE: coulomb_slide,
    ExactLaw.IDEAL_REBOUNDS: ideal_rebounds,
}


def _supports(
    scene: Scene, body: RigidBody, shape: type[Box] | type[Plane]
) -> Iterator[tuple[RigidBody, Contact]]:
    """Yield the fixed bodies of a shape that a body can touch, each with the constants of the pair."""
    for contact in scene.contacts:
        for pair in scene.colliding_pairs(contact):
            if body.name not in pair:
                continue
            other = scene.body(pair[pair[0] == body.name])
            if other.motion is Motion.FIXED and isinstance(other.shape, shape):
                yield other, contact


def _normal_of_rest(board: RigidBody, body: RigidBody) -> FloatArray | None:
    """Return the outward normal of the face of a box on which another box lies flat, shape [3]; None if it does not."""
    if not isinstance(board.shape, Box) or not isinstance(body.shape, Box):
        return None
    centre_m = board.pose.to_body(np.array(body.pose.position_m))
    outside_m = np.abs(centre_m) - 0.5 * np.array(board.shape.size_m)
    axis = int(outside_m.argmax())
    normal = math.copysign(1.0, centre_m[axis]) * board.pose.matrix[:, axis]
    cosines = np.abs(body.pose.matrix.T @ normal)
    thickness_m = float(cosines @ np.array(body.shape.size_m))
    gap_m = outside_m[axis] - 0.5 * thickness_m
    is_over = np.count_nonzero(outside_m > 0.0) <= 1
    is_flat = cosines.max() >= 1.0 - FLAT_TOLERANCE
    is_touching = abs(gap_m) <= CONTACT_TOLERANCE_M
    return normal if is_over and is_flat and is_touching else None
