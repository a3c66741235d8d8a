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
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.band import ExactLaw
from gauge_envs.scene import Box, Contact, Motion, Plane, RigidBody, Scene, Sphere
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scoring.reference import reference_band

CONTACT_TOLERANCE_M = 1e-4
"""Largest gap or overlap of two bodies that touch at the start [m]; published places have 6 digits."""

FLAT_TOLERANCE = 1e-6
"""Largest deviation from 1 of the cosine between two parallel axes."""

REST_SPEED_M_PER_S = 1e-6
"""Speed below which a ball no longer rebounds [m/s]: it would rise by less than 1e-13 m."""

MotionOfTime = Callable[[FloatArray], FloatArray]
"""Positions [m], shape [S, 3], at times since the release [s], shape [S], not negative."""

Law = Callable[[Scene, RigidBody], MotionOfTime | None]


def exact_motion(experiment: Experiment, times_s: FloatArray) -> FloatArray | None:
    """Return g(t) of the exact solution of a scene, shape [S, D]; None without a closed form.

    Args:
        experiment: Experiment with any constants and start; see `exact_solution`.
        times_s: Any times since the release [s], shape [S]. Before 0 the body rests.
    """
    solution = exact_solution(experiment)
    return None if solution is None else solution(times_s)


def exact_solution(experiment: Experiment) -> MotionOfTime | None:
    """Return `exact_motion` of an experiment as a function of the times; None without a closed form.

    A scene outside the limits of its law has none: another body, a start velocity, or a start without the contact that
    the law needs. Neither has a scene that a model file of an engine replaces and changes.
    """
    band = reference_band(experiment)
    if band is None or band.exact_law is None:
        return None
    is_replaced = experiment.edited and experiment.model_file is not None
    is_position = experiment.score.observable is Observable.POSITION
    if is_replaced or not is_position or len(experiment.recorded) != 1:
        return None
    body = experiment.scene.body(experiment.recorded[0])
    if not body.starts_at_rest:
        return None
    positions_m = LAWS[band.exact_law](experiment.scene, body)
    if positions_m is None:
        return None
    return lambda times_s: 1e3 * positions_m(np.maximum(times_s, 0.0))


def coulomb_slide(scene: Scene, body: RigidBody) -> MotionOfTime | None:
    """Return the motion of a box that slides down a fixed box from rest.

    The board at the angle theta carries m g cos(theta), so friction pulls with up to mu m g cos(theta) against the
    m g sin(theta) of the weight: the box slides by g (sin(theta) - mu cos(theta)) t^2 / 2 along the steepest descent.

    The box sticks if mu >= tan(theta). It must lie flat on a face of the board with its centre over it, else the answer
    is None. It does not tip, and the board has no end.
    """
    for board, contact in _supports(scene, body, Box):
        normal = _normal_of_rest(board, body)
        if normal is None:
            continue
        weight = np.array([0.0, 0.0, -scene.gravity_m_per_s2])
        load = -float(weight @ normal)
        if load <= 0.0:
            continue
        along = weight + load * normal
        pull = float(np.linalg.norm(along))
        acceleration = pull - contact.friction * load
        direction = along / max(pull, np.finfo(float).tiny)
        return partial(
            _slide,
            start_m=np.array(body.pose.position_m),
            acceleration_m_per_s2=max(acceleration, 0.0) * direction,
        )
    return None


def _slide(
    times_s: FloatArray, *, start_m: FloatArray, acceleration_m_per_s2: FloatArray
) -> FloatArray:
    """Return the positions [m], shape [S, 3], of a body that accelerates uniformly from rest."""
    return start_m + 0.5 * np.outer(times_s**2, acceleration_m_per_s2)


def ideal_rebounds(scene: Scene, ball: RigidBody) -> MotionOfTime | None:
    """Return the motion of a ball that falls on a level plane from rest.

    From the height h over the plane, the fall lasts sqrt(2 h / g) and ends at v = sqrt(2 g h). Rebound n starts with
    e^n v and lasts 2 e^n v / g, so the height between impacts is e^n v t - g t^2 / 2.

    An impact takes no time. After the last rebound the ball rests. The plane must be level and below the ball, else the
    answer is None.
    """
    if not isinstance(ball.shape, Sphere):
        return None
    start_m = np.array(ball.pose.position_m)
    for plane, contact in _supports(scene, ball, Plane):
        drop_m = float(start_m[2]) - ball.shape.radius_m - plane.pose.position_m[2]
        is_level = plane.pose.matrix[2, 2] >= 1.0 - FLAT_TOLERANCE
        if not is_level or drop_m < -CONTACT_TOLERANCE_M:
            continue
        return partial(
            _bounces,
            start_m=start_m,
            drop_m=max(drop_m, 0.0),
            restitution=contact.restitution,
            gravity_m_per_s2=scene.gravity_m_per_s2,
        )
    return None


def _bounces(
    times_s: FloatArray,
    *,
    start_m: FloatArray,
    drop_m: float,
    restitution: float,
    gravity_m_per_s2: float,
) -> FloatArray:
    """Return the positions [m], shape [S, 3], of a body that falls by a drop from rest and rebounds."""
    impact_s = math.sqrt(2.0 * drop_m / gravity_m_per_s2)
    speed = gravity_m_per_s2 * impact_s
    heights_m = drop_m - 0.5 * gravity_m_per_s2 * times_s**2
    while impact_s < times_s.max() and speed > REST_SPEED_M_PER_S:
        speed *= restitution
        since_s = times_s - impact_s
        rebound_m = speed * since_s - 0.5 * gravity_m_per_s2 * since_s**2
        heights_m = np.where(since_s > 0.0, rebound_m, heights_m)
        impact_s += 2.0 * speed / gravity_m_per_s2
    displacements_m = np.maximum(heights_m, 0.0) - drop_m
    return start_m + np.outer(displacements_m, [0.0, 0.0, 1.0])


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
            other = scene.body(pair[1] if pair[0] == body.name else pair[0])
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
    is_over = (np.delete(outside_m, axis) <= 0.0).all()
    is_flat = cosines.max() >= 1.0 - FLAT_TOLERANCE
    is_touching = abs(gap_m) <= CONTACT_TOLERANCE_M
    return normal if is_over and is_flat and is_touching else None
