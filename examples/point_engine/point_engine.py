"""A complete physics engine for gauge-envs, to copy from: balls that fly, bounce, slide and roll on planes.

A ball is a uniform solid sphere that may touch one plane, which is fixed or driven without turning; bodies of other
shapes only fall, or go where they are driven. Flight and the time of an impact are closed forms, so a rebound is exact
with any step. An impact is Coulomb's: the normal impulse reverses the approach by the restitution; the tangential one
stops the slip at the point of contact, or is friction times the normal one where that is less. A ball that stays on its
plane gets such an impulse, without restitution, once a step.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from math import ceil, inf, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.backends import Backend, Simulation, Support
from gauge_envs.backends.settings import SteppedSettings, resolve_settings
from gauge_envs.scene import Contact, ContactMode, Motion, Plane, Pose, RigidBody, Scene, Sphere

__all__ = ["BackendPoint", "SettingsPoint", "SimulationPoint"]

Array = NDArray[np.float64]

POSITION, QUATERNION, LINEAR, TWIST = slice(0, 3), slice(3, 7), slice(7, 10), slice(7, 13)
"""Where position, orientation, linear velocity, and linear with angular velocity stand in the state of a body."""

PLACE = [0, 1, 2, 7, 8, 9]
"""Position and linear velocity: what differs between the world and a frame that moves without turning."""

LARGEST_OVERLAP_M = 1e-6
"""More is declined, since nothing pushes overlapping bodies apart; rounding puts a ball 1e-17 m into its plane."""


# --- settings --------------------------------------------------------------------------------------------------------


class SettingsPoint(SteppedSettings):
    """Numerical settings: `preset`, and `timestep_s`, the longest step.

    Flight and impacts do not depend on the step. A ball whose next hop would be shorter than it stays on its plane.
    """


# Hops of 1/1800 s are 0.4 micrometres high.
PRESETS = {"default": SettingsPoint(preset="default", timestep_s=1 / 1800)}


# --- backend ---------------------------------------------------------------------------------------------------------


class BackendPoint(Backend):
    """Balls that fly, bounce, slide and roll on planes."""

    name = "point"

    def versions(self) -> dict[str, str]:
        """Version of this package, which is the engine."""
        return {"point-engine": version("point-engine")}

    def supports(self, scene: Scene) -> Support:
        """Spheres that may touch a plane each, and bodies of any shape that touch nothing."""
        subjects: dict[str, list[str]] = {}
        for subject, reason in _lacking(scene):
            subjects.setdefault(reason, []).append(subject)
        return Support(tuple(f"{_first_of(names)} {reason}" for reason, names in subjects.items()))

    def resolved_settings(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Settings that `build` would use; a sweep finds a wrong one with it before anything runs."""
        return resolve_settings("point", PRESETS, preset="default", changes=settings).model_dump(mode="json")

    def build(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> SimulationPoint:
        """Build a scene; settings are the fields of `SettingsPoint`."""
        return SimulationPoint(scene, resolve_settings("point", PRESETS, preset="default", changes=settings))


def _lacking(scene: Scene) -> Iterator[tuple[str, str]]:
    """What of a scene the engine cannot do: what it is about, and the reason."""
    for deformable in scene.deformables:
        yield repr(deformable.name), f"is a {type(deformable).__name__}, and only rigid bodies are simulated"
    for joint in scene.joints:
        yield repr(joint.body), f"hangs on a {type(joint).__name__}, and there are no joints"
    rigid = {body.name: body for body in scene.bodies}
    for body in scene.dynamic_bodies:
        if any(body.angular_velocity_rad_per_s) and not isinstance(body.shape, Sphere):
            yield (
                repr(body.name),
                f"starts with rotation and is a {type(body.shape).__name__}, and only spheres rotate freely",
            )
        touched = [rigid[name] for name in _touched(scene, body) if name in rigid]
        if touched and not isinstance(body.shape, Sphere):
            yield (
                repr(body.name),
                f"is a {type(body.shape).__name__}, and of moving bodies only spheres may touch others",
            )
            continue
        if len(touched) > 1:
            yield repr(body.name), "may touch more than one body"
        for other in touched:
            if reason := _untouchable(scene, body, other):
                yield " and ".join(sorted([repr(body.name), repr(other.name)])), reason


def _untouchable(scene: Scene, ball: RigidBody, other: RigidBody) -> str | None:
    """Why a ball cannot touch a body; None where it can."""
    if not isinstance(other.shape, Plane):
        return "may touch, and balls touch only planes"
    shifted = {d.body for d in scene.drivers if all(motion.kind == "translate" for motion in d.motions)}
    if other.motion is Motion.KINEMATIC and other.name not in shifted:
        return "may touch, and planes that balls touch can be shifted, not turned"
    overlap_m = _radius_m(ball) - float(other.pose.to_body(np.asarray(ball.pose.position_m))[2])
    return f"overlap by {1e3 * overlap_m:.3g} mm at the start" if overlap_m > LARGEST_OVERLAP_M else None


def _first_of(names: Sequence[str]) -> str:
    others = len(set(names)) - 1
    return f"{names[0]} (and {others} more)" if others else names[0]


def _touched(scene: Scene, ball: RigidBody) -> dict[str, Contact]:
    """Names of the bodies that a ball may touch, with the constants of the contact."""
    return {
        first if second == ball.name else second: contact
        for contact in scene.contacts
        for first, second in scene.colliding_pairs(contact)
        if ball.name in (first, second)
    }


def _radius_m(ball: RigidBody) -> float:
    assert isinstance(ball.shape, Sphere)
    return ball.shape.radius_m


# --- simulation ------------------------------------------------------------------------------------------------------


class SimulationPoint(Simulation):
    """A scene of balls and planes; its state is one row a body, laid out as `body_states` returns it."""

    def __init__(self, scene: Scene, settings: SettingsPoint) -> None:
        self.settings = settings.model_dump(mode="json")
        self._rows = {body.name: row for row, body in enumerate(scene.bodies)}
        self._start = np.zeros((len(scene.bodies), 13))
        for row, body in zip(self._start, scene.bodies, strict=True):
            row[:7] = *body.pose.position_m, *body.pose.quaternion
            row[TWIST] = *body.linear_velocity_m_per_s, *body.angular_velocity_rad_per_s
        self._gravity = np.array([0.0, 0.0, -scene.gravity_m_per_s2, 0.0, 0.0, 0.0])
        self._driven = [self._rows[body.name] for body in scene.bodies if body.motion is Motion.KINEMATIC]
        self._falling = [(self._rows[body.name], self._contact(scene, body)) for body in scene.dynamic_bodies]
        self.reset(seed=0)

    def _contact(self, scene: Scene, ball: RigidBody) -> _PlaneContact | None:
        touched = _touched(scene, ball)
        if not touched:
            return None
        ((name, contact),) = touched.items()
        return _PlaneContact(
            plane=self._rows[name],
            normal=scene.body(name).pose.rotation.apply([0.0, 0.0, 1.0]),
            radius_m=_radius_m(ball),
            friction=contact.friction,
            restitution=contact.restitution if contact.mode is ContactMode.IMPACT else 0.0,
            shortest_hop_s=self.settings["timestep_s"],
        )

    def reset(self, seed: int) -> None:
        """Return to the scene's start; nothing is random, so the seed changes nothing."""
        self._states = self._start.copy()
        self._accelerations = np.zeros((len(self._start), 6))

    def drive(self, body: str, pose: Pose, velocity: Array, acceleration: Array) -> None:
        """Put a driven body where its interval starts; `advance` accelerates it."""
        row = self._rows[body]
        self._states[row] = *pose.position_m, *pose.quaternion, *velocity
        self._accelerations[row] = acceleration

    def advance(self, seconds: float) -> None:
        """Simulate an interval in equal steps of at most `timestep_s`."""
        # A whole number of steps must not become one more by rounding.
        count = ceil(seconds / self.settings["timestep_s"] - 1e-9)
        for _ in range(count):
            self._step(seconds / count)

    def _step(self, seconds: float) -> None:
        before = self._states.copy()
        for row in self._driven:
            _move(self._states[row], self._accelerations[row], seconds)
        for row, contact in self._falling:
            state = self._states[row]
            if contact is None:
                _move(state, self._gravity, seconds)
                continue
            # In the frame of the plane the ball falls with gravity less the plane's acceleration.
            state[PLACE] -= before[contact.plane, PLACE]
            contact.move(state, self._gravity - self._accelerations[contact.plane], seconds)
            state[PLACE] += self._states[contact.plane, PLACE]

    def body_states(self, names: Sequence[str]) -> Array:
        """Poses and velocities of bodies, shape [len(names), 13]; see `Simulation.body_states`."""
        return self._states[[self._rows[name] for name in names]]

    def state(self) -> tuple[Array, Array]:
        """States of all bodies, shape [body_count, 13], and accelerations of the driven ones, [body_count, 6]."""
        return self._states.copy(), self._accelerations.copy()

    def restore(self, state: tuple[Array, Array]) -> None:
        """Go back to a state that `state` returned."""
        self._states, self._accelerations = (array.copy() for array in state)

    def close(self) -> None:
        """Nothing is held outside memory."""


# --- mechanics -------------------------------------------------------------------------------------------------------


def _move(state: Array, acceleration: Array, seconds: float) -> None:
    """Accelerate a body uniformly: exact, and about a fixed axis exact in orientation too."""
    travel = (state[TWIST] + 0.5 * acceleration * seconds) * seconds
    turned = Rotation.from_rotvec(travel[3:]) * Rotation.from_quat(state[QUATERNION], scalar_first=True)
    state[POSITION] += travel[:3]
    state[QUATERNION] = turned.as_quat(scalar_first=True)
    state[TWIST] += acceleration * seconds


def _time_to_touch(gap_m: float, speed: float, acceleration: float) -> float:
    """Time until a uniformly accelerated gap [m] closes [s]: 0 if it is closed and does not open, infinity if never."""
    root = sqrt(max(speed**2 - 2.0 * acceleration * gap_m, 0.0))
    if speed > 0.0:
        return (speed + root) / -acceleration if acceleration < 0.0 else inf
    if gap_m <= 0.0:
        return 0.0 if speed < 0.0 or acceleration < 0.0 else inf
    closes = speed**2 > 2.0 * acceleration * gap_m
    return 2.0 * gap_m / (root - speed) if closes else inf


@dataclass(frozen=True, kw_only=True)
class _PlaneContact:
    """What a ball does on and above its plane. All states are relative to the plane, which may move without turning.

    Attributes:
        plane: Row of the plane.
        normal: Its outward normal in the world, shape [3].
        radius_m: Radius of the ball.
        friction: Coulomb coefficient of the pair.
        restitution: Ratio of outgoing to incoming normal speed.
        shortest_hop_s: A rebound that would return sooner is no rebound.
    """

    plane: int
    normal: Array
    radius_m: float
    friction: float
    restitution: float
    shortest_hop_s: float

    def move(self, state: Array, pull: Array, seconds: float) -> None:
        """Move a ball for a step that is no longer than the shortest hop.

        Args:
            state: State of the ball, shape [13]; changed in place.
            pull: Linear [m/s^2] and angular acceleration of a ball that touches nothing, shape [6].
            seconds: Length of the step.
        """
        sinking = float(pull[:3] @ self.normal)
        gap_m = float(state[POSITION] @ self.normal) - self.radius_m
        flight_s = min(_time_to_touch(gap_m, float(state[LINEAR] @ self.normal), sinking), seconds)
        _move(state, pull, flight_s)
        left_s = seconds - flight_s
        if left_s <= 0.0:
            return
        rebound = -self.restitution * float(state[LINEAR] @ self.normal)
        if 2.0 * rebound > -sinking * self.shortest_hop_s:
            state[TWIST] = self._hit(state[TWIST], self.restitution)
            _move(state, pull, left_s)
            return
        state[TWIST] = self._hit(state[TWIST], 0.0)
        after = self._hit(state[TWIST] + pull * left_s, 0.0)
        _move(state, (after - state[TWIST]) / left_s, left_s)

    def _hit(self, twist: Array, restitution: float) -> Array:
        """Linear and angular velocity after an impulse at the point of contact, shape [6]."""
        arm = -self.radius_m * self.normal
        approach = -float(twist[:3] @ self.normal)
        slip = twist[:3] + approach * self.normal + np.cross(twist[3:], arm)
        # Impulses per mass. With the inertia 2/5 m r^2 an impulse J at the surface changes the slip by 7/2 J / m.
        push = (1.0 + restitution) * approach
        drag = -2.0 / 7.0 * slip
        drag *= min(1.0, self.friction * push / max(float(np.linalg.norm(drag)), 1e-300))
        return twist + np.concatenate([push * self.normal + drag, 2.5 / self.radius_m**2 * np.cross(arm, drag)])
