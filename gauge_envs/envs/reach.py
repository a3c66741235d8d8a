"""Bounds of observed places and motions: how far from what holds them bodies can be, for observation spaces alone.

A body that hangs on a hinge, a string or a holder cannot leave the reach of it. A body that nothing holds is bounded by
the distance limit of the scene, as for divergence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gauge_envs.envs.divergence import DeformableBounds
from gauge_envs.observables.kinds import Observable
from gauge_envs.scene import Hinge, Motion, Scene
from gauge_envs.scene.bodies import Deformable
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scene.meshes import outline_m
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME

GIVE = 1.1
"""Length of a string, or distance from a hinge, over that stated: joints of engines give way by a few percent."""

START_M = 0.1
"""Room for starts that scatter, and for the thickness of bodies [m]."""


@dataclass(frozen=True)
class Ball:
    """A ball that a point of a body never leaves.

    Attributes:
        centre_m: Its centre [m], shape [3].
        radius_m: Its radius [m]; infinite if nothing holds the body.
    """

    centre_m: FloatArray
    radius_m: float

    def around(self, more_m: float) -> Ball:
        """Return the ball of what is no farther than a distance from a point of this one."""
        return Ball(self.centre_m, self.radius_m + more_m)


def driver_radius_m(driver: Driver, start_m: FloatArray, duration_s: float) -> float:
    """Return the largest distance of a driven body's origin from its start [m], with any actions.

    Args:
        driver: Its driver.
        start_m: Its origin at the start [m], shape [3].
        duration_s: Length of the episode [s].
    """
    count = round(duration_s * FRAME_RATE_HZ) * SAMPLES_PER_FRAME + 1
    times_s = np.linspace(0.0, duration_s, count)
    radius_m = 0.0
    for motion in driver.motions:
        if motion.kind == "rotate":
            arm = np.cross(start_m - np.asarray(motion.point_m), motion.axis)
            # The chord of any angle is at most the diameter; both ends lie within the radius so far.
            radius_m += 2.0 * (length_of(arm) + radius_m)
        else:
            profiles = sum(
                np.abs(profile.values_at(times_s)).max() for profile in motion.profiles
            )
            radius_m += float(profiles) + motion.residual_rate * duration_s
    return radius_m


class Reach:
    """Where the bodies of a scene can be.

    Args:
        scene: The scene.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._spans_m = {
            body.name: DeformableBounds.STRETCH
            * length_of(np.ptp(outline_m(body), axis=0))
            for body in scene.deformables
        }
        self._balls = self._held_rigid()
        self._hold_deformables()

    def _held_rigid(self) -> dict[str, Ball]:
        """Return the balls of fixed, driven, hinged and tethered bodies."""
        scene = self._scene
        balls = {}
        for body in scene.bodies:
            if body.motion is Motion.FIXED:
                balls[body.name] = Ball(np.asarray(body.pose.position_m), 0.0)
        for driver in scene.drivers:
            start_m = np.asarray(scene.body(driver.body).pose.position_m)
            radius_m = driver_radius_m(driver, start_m, scene.duration_s)
            balls[driver.body] = Ball(start_m, radius_m)
        for joint in scene.joints:
            anchor_m = np.asarray(joint.anchor_m)
            length_m = (
                self._distance_m(joint.body, anchor_m)
                if isinstance(joint, Hinge)
                else joint.length_m
            )
            ball = Ball(anchor_m, GIVE * length_m)
            known = balls.get(joint.body)
            if known is None or ball.radius_m < known.radius_m:
                balls[joint.body] = ball
        return balls

    def _hold_deformables(self) -> None:
        """Add deformable bodies that are attached to held ones, and rigid bodies attached to those.

        All nodes are within the extent at which a body counts as diverged of each of its nodes, and the attached ones
        keep their distance from the holder's origin.
        """
        shapes = {body.name: body for body in self._scene.deformables}
        left = list(self._scene.attachments)
        while ready := [
            one
            for one in left
            if (one.deformable in self._balls) != (one.to in self._balls)
        ]:
            for attachment in ready:
                left.remove(attachment)
                body, to = attachment.deformable, attachment.to
                # Attached nodes of two deformable bodies are at one place.
                away_m = 0.0 if to in shapes else self._farthest_m(shapes[body], to)
                placed, other = (to, body) if to in self._balls else (body, to)
                span_m = self._spans_m.get(other, 0.0)
                self._balls.setdefault(
                    other, self._balls[placed].around(away_m + span_m)
                )

    def _distance_m(self, name: str, point_m: FloatArray) -> float:
        return length_of(self._scene.body(name).pose.position_m - point_m)

    def _farthest_m(self, deformable: Deformable, name: str) -> float:
        """Return the largest distance of a deformable body from a rigid body's origin at the start [m]."""
        place_m = np.asarray(self._scene.body(name).pose.position_m)
        return float(np.linalg.norm(outline_m(deformable) - place_m, axis=1).max())

    def box_m(self, *names: str) -> tuple[FloatArray, FloatArray]:
        """Return the lowest and highest coordinates of the origins or nodes of bodies [m], shape [3] each."""
        limit_m = np.full(3, self._scene.distance_limit_m)
        if not all(name in self._balls for name in names):
            return -limit_m, limit_m
        balls = [self._balls[name].around(START_M) for name in names]
        low_m = np.min([ball.centre_m - ball.radius_m for ball in balls], axis=0)
        high_m = np.max([ball.centre_m + ball.radius_m for ball in balls], axis=0)
        return np.maximum(low_m, -limit_m), np.minimum(high_m, limit_m)

    def observable(
        self, observable: Observable, recorded: tuple[str, ...], count: int
    ) -> tuple[FloatArray, FloatArray]:
        """Return the bounds of g(t), in its unit, shape [coordinate_count] each.

        Args:
            observable: Kind of generalized trajectory.
            recorded: Bodies whose positions are observed.
            count: Number of coordinates.
        """
        if observable is Observable.POSITION:
            boxes_m = [self.box_m(name) for name in recorded]
            lows_m = np.concatenate([low for low, _ in boxes_m])
            highs_m = np.concatenate([high for _, high in boxes_m])
            return 1e3 * lows_m, 1e3 * highs_m
        markers = self._scene.markers
        bodies = () if markers is None else markers.bodies
        if observable is Observable.MARKER_POSITION:
            low_m, high_m = self.box_m(*bodies)
            return np.tile(1e3 * low_m, count // 3), np.tile(1e3 * high_m, count // 3)
        if observable is Observable.LINE_CURVATURE:
            return np.zeros(count), np.full(count, np.pi)
        if observable is Observable.CURVATURE:
            # The full angle of a flat sheet is at most 2 pi, and each face takes at most pi.
            faces = np.array(() if markers is None else markers.faces, dtype=int)
            faces_at = np.bincount(faces.ravel(), minlength=count).astype(np.float64)
            return -np.pi * faces_at, np.full(count, 2.0 * np.pi)
        # Two sides of a triangle are no longer than the body whose nodes its corners are.
        longest_mm = 1e3 * max(self._spans_m.values(), default=0.0)
        return np.zeros(count), np.full(count, 0.5 * longest_mm**2)
