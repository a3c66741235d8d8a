"""Exact motion of an experiment with its own constants: carried bodies, slides, rebounds and pendulums.

The form is chosen by what is in the scene, never by a name. A scene has one if a single rigid body is recorded, and its
motion follows from friction, restitution or gravity alone.
"""

from __future__ import annotations

import math

import numpy as np

from gauge_envs.errors import ShapeError
from gauge_envs.evaluation.laws import distance_to_contact_m, slide
from gauge_envs.evaluation.pendulum_laws import Pendulum
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.grades import BandGrade
from gauge_envs.scene import Hinge, Motion, Plane, RigidBody, Scene, Sphere
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ

LEAST_APEX_M = 1e-9
"""Height of a rebound below which the ball rests [m]."""


def closed_form(experiment: Experiment) -> FloatArray | None:
    """Return the exact g(t) of an experiment at its frames.

    - Where the package states a law in place of trials, as for a carried body, it is that law.
    - A body that starts on the face of a fixed one slides with g (sin - mu cos), until it tips over the edge.
    - A ball above a level plane falls, and each rebound has `e` times the speed of the impact, in no time.
    - A body on a hinge that touches nothing swings as a physical pendulum, for all frames.

    Args:
        experiment: The experiment; its constants are those of its parameters.

    Returns:
        Positions [mm], shape [frame_count, 3], NaN where the form has ended; None without a form.
    """
    scene = experiment.scene
    is_alone = len(scene.dynamic_bodies) == 1 and not scene.deformables
    if experiment.score.observable is not Observable.POSITION or len(experiment.recorded) != 1 or not is_alone:
        return None
    body = scene.body(experiment.recorded[0])
    if any(isinstance(joint, Hinge) for joint in scene.joints):
        return None if scene.contacts or scene.drivers else _swing(scene, body.name, experiment.frame_count)
    stated = _stated(experiment)
    if stated is not None:
        return stated
    if scene.drivers or body.motion is not Motion.DYNAMIC or not body.starts_at_rest:
        return None
    if isinstance(body.shape, Sphere):
        return _rebounds(scene, body, experiment.frame_count)
    return _slide(scene, body, experiment.frame_count)


def _stated(experiment: Experiment) -> FloatArray | None:
    """Return the law that the package states for an experiment, if it gives all three coordinates."""
    band = reference_band(experiment)
    if band is None or band.grade is not BandGrade.LAW or band.projection.shape != (3, 3):
        return None
    return np.asarray(band.mean @ np.linalg.inv(band.projection).T)


def _swing(scene: Scene, body: str, frame_count: int) -> FloatArray:
    pendulum = Pendulum.of(scene, body)
    return pendulum.positions_mm(pendulum.released_rad(np.arange(frame_count) / FRAME_RATE_HZ))


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
