"""A complete physics engine for gauge-envs, to copy from: balls that fly, bounce, slide and roll on planes.

A ball is a uniform solid sphere that may touch one plane, which is fixed or driven without turning. Bodies of other
shapes only fall, or go where they are driven. Flight and the time of an impact are closed forms, so a rebound is exact
with any step. An impact is Coulomb's: the normal impulse reverses the approach by the restitution; the tangential one
stops the slip at the point of contact, or is friction times the normal one where that is less. A ball that stays on its
plane gets such an impulse, without restitution, once a step.

All worlds are arrays, whose first axis is the world and whose second axis is the body.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.backends import Backend, Simulation, Support
from gauge_envs.backends.settings import SteppedSettings, resolve_settings
from gauge_envs.scene import Contact, ContactMode, Motion, Plane, RigidBody, Scene, Sphere
from gauge_envs.scene.states import nominal_states

__all__ = ["BackendPoint", "SimulationPoint"]

Array = NDArray[np.float64]

POSITION, QUATERNION, LINEAR, TWIST = slice(0, 3), slice(3, 7), slice(7, 10), slice(7, 13)
"""Columns of position, orientation, linear velocity, and linear with angular velocity in the state of a body."""

LARGEST_OVERLAP_M = 1e-6
"""Larger overlaps are unsupported, since nothing pushes bodies apart; rounding puts a ball 1e-17 m into its plane."""

# Flight and impacts do not depend on the step. A ball whose next hop would be shorter than it stays on its plane; hops
# of 1/1800 s are 0.4 micrometres high.
PRESETS = {"default": SteppedSettings(preset="default", timestep_s=1 / 1800)}


# --- backend ---------------------------------------------------------------------------------------------------------


class BackendPoint(Backend):
    """Balls that fly, bounce, slide and roll on planes."""

    name = "point"

    def versions(self) -> dict[str, str]:
        """Return the version of this package, which is the engine."""
        return {"point-engine": version("point-engine")}

    def supports(self, scene: Scene) -> Support:
        """Accept spheres that may touch a plane each, and bodies of any shape that touch nothing."""
        subjects: dict[str, list[str]] = {}
        for subject, reason in _lacking(scene):
            subjects.setdefault(reason, []).append(subject)
        return Support(tuple(f"{_first_of(names)} {reason}" for reason, names in subjects.items()))

    def resolved_settings(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return the settings that `build` would use; a sweep finds a wrong one with it before anything runs."""
        return _settings(settings).model_dump(mode="json")

    def build(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> SimulationPoint:
        """Build a scene in one world."""
        return self.build_worlds(scene, 1, settings)

    def build_worlds(
        self, scene: Scene, world_count: int, settings: Mapping[str, Any] | None = None
    ) -> SimulationPoint:
        """Build a scene in N worlds."""
        return SimulationPoint(scene, world_count, _settings(settings))


def _settings(changes: Mapping[str, Any] | None) -> SteppedSettings:
    return resolve_settings("point", PRESETS, preset="default", changes=changes)


def _lacking(scene: Scene) -> Iterator[tuple[str, str]]:
    """Yield the unsupported parts of a scene: the subject and the reason."""
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
        for partner in touched:
            if reason := _untouchable(scene, body, partner):
                yield " and ".join(sorted([repr(body.name), repr(partner.name)])), reason


def _untouchable(scene: Scene, ball: RigidBody, partner: RigidBody) -> str | None:
    """Return why a ball cannot touch a body; None where it can."""
    if not isinstance(partner.shape, Plane):
        return "may touch, and balls touch only planes"
    shifted = {d.body for d in scene.drivers if all(motion.kind == "translate" for motion in d.motions)}
    if partner.motion is Motion.KINEMATIC and partner.name not in shifted:
        return "may touch, and planes that balls touch can be shifted, not turned"
    overlap_m = _radius_m(ball) - float(partner.pose.to_body(np.asarray(ball.pose.position_m))[2])
    return f"overlap by {1e3 * overlap_m:.3g} mm at the start" if overlap_m > LARGEST_OVERLAP_M else None


def _first_of(names: Sequence[str]) -> str:
    rest = len(set(names)) - 1
    return f"{names[0]} (and {rest} more)" if rest else names[0]


def _touched(scene: Scene, ball: RigidBody) -> dict[str, Contact]:
    """Return the names of the bodies that a ball may touch, with the constants of the contact."""
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
    """Balls and planes in N worlds. Every array of constants has a row for each body of the scene."""

    def __init__(self, scene: Scene, world_count: int, settings: SteppedSettings) -> None:
        self.settings = settings.model_dump(mode="json")
        self.world_count = world_count
        self._step_s = settings.timestep_s
        self._rows = {body.name: row for row, body in enumerate(scene.bodies)}
        self._nominal = np.tile(nominal_states(scene)[: len(scene.bodies)], (world_count, 1, 1))
        self._gravity = np.zeros((len(scene.bodies), 6))
        # A body without a contact has a plane without a normal, which it never reaches; the plane is the body itself.
        self._planes = np.arange(len(scene.bodies))
        self._normals = np.zeros((len(scene.bodies), 3))
        self._radii_m = np.ones(len(scene.bodies))
        self._frictions = np.zeros(len(scene.bodies))
        self._restitutions = np.zeros(len(scene.bodies))
        for body in scene.dynamic_bodies:
            row = self._rows[body.name]
            self._gravity[row, 2] = -scene.gravity_m_per_s2
            for plane, contact in _touched(scene, body).items():
                self._planes[row] = self._rows[plane]
                self._normals[row] = scene.body(plane).pose.rotation.apply([0.0, 0.0, 1.0])
                self._radii_m[row] = _radius_m(body)
                self._frictions[row] = contact.friction
                if contact.mode is ContactMode.IMPACT:
                    self._restitutions[row] = contact.restitution
        self._touches = self._normals.any(axis=1)
        self.reset()

    def reset(self, starts: Array | None = None, seed: int = 0) -> None:
        """Start all worlds; nothing is random, so the seed has no effect."""
        self._states = (self._nominal if starts is None else starts).copy()
        self._accelerations = np.tile(self._gravity, (self.world_count, 1, 1))

    def drive(self, body: str, targets: Array) -> None:
        """Move a driven body to the start of its interval; `advance` accelerates it."""
        row = self._rows[body]
        self._states[:, row] = targets[:, :13]
        self._accelerations[:, row] = targets[:, 13:]

    def advance(self, seconds: float) -> None:
        """Simulate an interval in equal steps of at most `timestep_s`."""
        # A whole number of steps must not become one more by rounding.
        count = ceil(seconds / self._step_s - 1e-9)
        for _ in range(count):
            self._step(seconds / count)

    def _step(self, seconds: float) -> None:
        """Simulate a step: all bodies move freely, then those that touch a plane again, in the frame of their plane."""
        free = np.full(self._states.shape[:2], seconds)
        before = self._states
        self._states = _moved(before, self._accelerations, free)
        balls, planes = self._touches, self._planes[self._touches]
        relative = before[:, balls]
        pulls = self._accelerations[:, balls] - self._accelerations[:, planes]
        for columns in (POSITION, LINEAR):
            relative[..., columns] -= before[:, planes, columns]
        moved = self._bounced(relative, pulls, seconds)
        for columns in (POSITION, LINEAR):
            moved[..., columns] += self._states[:, planes, columns]
        self._states[:, balls] = moved

    def _bounced(self, states: Array, pulls: Array, seconds: float) -> Array:
        """Return the states of balls after a step, in the frame of their planes.

        Args:
            states: States of the balls, shape [N, ball_count, 13].
            pulls: Linear [m/s^2] and angular acceleration of a ball in flight, shape [N, ball_count, 6].
            seconds: Length of the step.
        """
        normals, restitutions = self._normals[self._touches], self._restitutions[self._touches]
        gaps_m = _along(states[..., POSITION], normals) - self._radii_m[self._touches]
        sinking = _along(pulls[..., :3], normals)
        flight_s = np.minimum(_times_to_touch(gaps_m, _along(states[..., LINEAR], normals), sinking), seconds)
        states = _moved(states, pulls, flight_s)
        left_s = seconds - flight_s
        # A ball whose hop would be shorter than a step stays, and its weight presses on the plane.
        rebounds = -restitutions * _along(states[..., LINEAR], normals)
        hops = 2.0 * rebounds > -sinking * seconds
        hit = self._hit(states[..., TWIST], restitutions * hops)
        pressed = self._hit(hit + pulls * left_s[..., None], np.zeros_like(left_s))
        has_landed = left_s > 0.0
        mean = (pressed - hit) / np.where(has_landed, left_s, 1.0)[..., None]
        states[..., TWIST] = np.where(has_landed[..., None], hit, states[..., TWIST])
        return _moved(states, np.where(hops[..., None], pulls, mean), left_s)

    def _hit(self, twists: Array, restitutions: Array) -> Array:
        """Return linear and angular velocities after impulses at the points of contact, shape [N, ball_count, 6]."""
        normals, radii_m = self._normals[self._touches], self._radii_m[self._touches]
        arms = -radii_m[:, None] * normals
        approach = -_along(twists[..., :3], normals)[..., None]
        slip = twists[..., :3] + approach * normals + np.cross(twists[..., 3:], arms)
        # Impulses per mass. With the inertia 2/5 m r^2 an impulse J at the surface changes the slip by 7/2 J / m.
        push = (1.0 + restitutions[..., None]) * approach
        drag = -2.0 / 7.0 * slip
        size = np.maximum(np.linalg.norm(drag, axis=-1, keepdims=True), 1e-300)
        drag *= np.minimum(1.0, self._frictions[self._touches, None] * push / size)
        spin = 2.5 / radii_m[:, None] ** 2 * np.cross(arms, drag)
        return twists + np.concatenate([push * normals + drag, spin], axis=-1)

    def body_states(self, names: Sequence[str]) -> Array:
        """Return poses and velocities of bodies, shape [N, len(names), 13]; see `Simulation.body_states`."""
        return self._states[:, [self._rows[name] for name in names]]

    def close(self) -> None:
        """Hold nothing outside memory."""


# --- mechanics -------------------------------------------------------------------------------------------------------


def _along(vectors: Array, normals: Array) -> Array:
    """Return the components of vectors along normals."""
    return np.asarray((vectors * normals).sum(axis=-1))


def _moved(states: Array, accelerations: Array, seconds: Array) -> Array:
    """Return uniformly accelerated bodies: exact, and about a fixed axis exact in orientation too.

    Args:
        states: Shape [N, body_count, 13].
        accelerations: Linear [m/s^2] and angular [rad/s^2], shape [N, body_count, 6].
        seconds: Time of each body [s], shape [N, body_count].
    """
    times_s = seconds[..., None]
    travel = (states[..., TWIST] + 0.5 * accelerations * times_s) * times_s
    turned = Rotation.from_rotvec(travel[..., 3:].reshape(-1, 3))
    turned *= Rotation.from_quat(states[..., QUATERNION].reshape(-1, 4), scalar_first=True)
    moved = states.copy()
    moved[..., POSITION] += travel[..., :3]
    moved[..., QUATERNION] = turned.as_quat(scalar_first=True).reshape(*seconds.shape, 4)
    moved[..., TWIST] += accelerations * times_s
    return moved


def _times_to_touch(gaps_m: Array, speeds: Array, accelerations: Array) -> Array:
    """Return times until uniformly accelerated gaps close [s]: 0 for one that is closed and does not open.

    The time is infinite for a gap that never closes.
    """
    gaps_m = np.maximum(gaps_m, 0.0)
    squares = speeds**2 - 2.0 * accelerations * gaps_m
    roots = np.sqrt(np.maximum(squares, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        falling = np.where(squares >= 0.0, 2.0 * gaps_m / (roots - speeds), np.inf)
        rising = np.where(accelerations < 0.0, (speeds + roots) / -accelerations, np.inf)
    return np.where(speeds < 0.0, falling, rising)
