"""An engine without physics: bodies follow their drivers or wobble about their start, as closed forms of the time."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends import Backend, Feature, Simulation, Support
from gauge_envs.scene import (
    Box,
    Cloth,
    Deformable,
    Motion,
    RigidBody,
    Scene,
    SoftBody,
)
from gauge_envs.scene.states import scene_at

Array = NDArray[np.float64]

WAY_M, RATES_PER_S = np.array([0.05, 0.03, 0.3]), np.array([7.0, 11.0, 5.0])
TURN_RAD, AXIS = 2.5, np.array([0.36, 0.48, 0.8])
STRAINS = np.array([0.1, 0.05, 0.02])
"""A body swings along x and y, bounces along z, and swings about an axis; nodes stretch with it."""


class Wobbling(Simulation):
    """One world of a scene as a function of the time, with a scale of all motions."""

    def __init__(self, scene: Scene, scale: float) -> None:
        self.scene, self.scale = scene, scale
        self.settings: dict[str, Any] = {}
        self.time_s = 0.0
        self.driven: dict[str, Array] = {}
        self.rest: dict[str, tuple[Array, Array]] = {}
        self.turned: dict[str, Array] = {}

    def reset(self, starts: Array | None = None, seed: int = 0) -> None:
        """Go back to the start."""
        self.time_s, self.driven = 0.0, {}
        if starts is not None:
            self.scene = scene_at(self.scene, starts[0])
            self.rest, self.turned = {}, {}

    def drive(self, body: str, targets: Array) -> None:
        """Put a body where its driver has it."""
        self.driven[body] = np.array(targets[0, :13])

    def apply_wrench(self, body: str, wrenches: Array) -> None:
        """Accept it; nothing follows."""

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        self.time_s += seconds

    def body_states(self, names: Sequence[str]) -> Array:
        """Return the states of bodies."""
        return np.array([self._state(name) for name in names]).reshape(1, -1, 13)

    def _state(self, name: str) -> Array:
        body = self.scene.body(name)
        start = [*body.pose.position_m, *body.pose.quaternion]
        if name in self.driven:
            return self.driven[name]
        if body.motion is not Motion.DYNAMIC:
            return np.array([*start, *np.zeros(6)])
        way_m, speed_m_per_s, angle, rate = self._way(name)
        half_rad = 0.5 * self.scale * TURN_RAD * np.sin(angle)
        # The product of the quaternions of the turn and of the start.
        quaternion = np.cos(half_rad) * np.array(body.pose.quaternion)
        quaternion += np.sin(half_rad) * self._half_turned(body)
        start_speed = np.asarray(body.linear_velocity_m_per_s)
        return np.concatenate(
            [
                body.pose.position_m + way_m + start_speed * self.time_s,
                quaternion,
                speed_m_per_s + start_speed,
                self.scale * TURN_RAD * rate * np.cos(angle) * AXIS,
            ]
        )

    def _half_turned(self, body: RigidBody) -> Array:
        """Return the quaternion of the start after half a turn about the axis."""
        if body.name not in self.turned:
            scalar, axis = body.pose.quaternion[0], body.pose.quaternion[1:]
            self.turned[body.name] = np.array(
                [-AXIS @ axis, *(scalar * AXIS + np.cross(AXIS, axis))]
            )
        return self.turned[body.name]

    def _way(self, name: str) -> tuple[Array, Array, float, float]:
        """Return the way from the start and its speed, and angle and rate of the first swing; names differ a little."""
        rates = RATES_PER_S * (1.0 + 0.01 * len(name))
        angles = rates * self.time_s
        way = np.array([*np.sin(angles[:2]), np.abs(np.cos(angles[2])) - 1.0])
        fall = -np.sin(angles[2]) * np.sign(np.cos(angles[2]))
        speed = rates * np.array([*np.cos(angles[:2]), fall])
        size_m = self.scale * WAY_M
        return size_m * way, size_m * speed, float(angles[0]), float(rates[0])

    def nodes(self, name: str) -> Array:
        """Return the nodes of a deformable body."""
        if name not in self.rest:
            body = next(one for one in self.scene.deformables if one.name == name)
            self.rest[name] = rest_and_strain_m(body)
        rest_m, strain_m = self.rest[name]
        way_m, _, angle, _ = self._way(name)
        # More with gravity: stiffness is a difference of two scenes.
        size = self.scale * (1.0 + 0.1 * self.scene.gravity_m_per_s2) * np.sin(angle)
        return (rest_m + size * strain_m + way_m)[None]

    def close(self) -> None:
        """Nothing is open."""


def grid_of(body: Deformable) -> Array:
    """Return evenly spaced nodes of a body at rest in its frame [m]."""
    if isinstance(body, Cloth):
        size, counts = (*body.size_m, 0.0), (9, 9, 1)
    elif isinstance(body, SoftBody):
        size, counts = body.shape.size_m, (3, 3, 9)
    else:
        is_rope = type(body).__name__ == "Rope"
        size = (body.length_m, 0.0, 0.0) if is_rope else (0.0, 0.0, body.length_m)
        counts = (9, 1, 1) if is_rope else (1, 1, 9)
    axes = [
        np.linspace(-0.5, 0.5, count) * edge if count > 1 else np.zeros(1)
        for edge, count in zip(size, counts, strict=True)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def rest_and_strain_m(body: Deformable) -> tuple[Array, Array]:
    """Return the places of nodes at rest, and a displacement of each, which is curved, in the world [m]."""
    grid_m = grid_of(body)
    sheared_m = np.roll(grid_m, 1, axis=1) + np.roll(grid_m, 2, axis=1)
    strain_m = STRAINS * (grid_m + sheared_m - 2.0 * (grid_m + sheared_m) ** 2)
    return body.pose.to_world(grid_m), body.pose.rotation.apply(strain_m)


class WobblingBackend(Backend):
    """It builds every scene, and keeps all that it was asked for."""

    name = "wobbling"
    features = frozenset(Feature)

    def __init__(self, scale: float = 1.0) -> None:
        self.scenes: list[Scene] = []
        self.scale = scale

    def versions(self) -> dict[str, str]:
        """Return no version."""
        return {"wobbling": "1"}

    def supports(self, scene: Scene) -> Support:
        """Accept any scene."""
        return Support()

    def build(
        self, scene: Scene, settings: Mapping[str, Any] | None = None
    ) -> Simulation:
        """Return a scene that wobbles."""
        self.scenes.append(scene)
        return Wobbling(scene, self.scale)


def told(value: Any) -> str:
    """Return an object by its fields that differ from their defaults, numbers with five digits."""
    if isinstance(value, Box):
        return f"Box{told(value.size_m)}"
    if is_dataclass(value):
        parts = [
            f"{one.name}={told(getattr(value, one.name))}"
            for one in fields(value)
            if one.init
            and (one.default is MISSING or getattr(value, one.name) != one.default)
        ]
        return f"{type(value).__name__}({', '.join(parts)})"
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, Mapping):
        parts = [f"{name}: {told(one)}" for name, one in value.items()]
        return f"{{{', '.join(parts)}}}"
    if isinstance(value, tuple | list | np.ndarray):
        text = f"[{' '.join(map(told, value))}]"
        numbers = re.findall(r"[-+]?\d[-+.e\d]*", text)
        if len(numbers) < 13 or re.search("[=a-df-z]", text):
            return text
        # Corners of a solid.
        moment = sum(place * float(one) for place, one in enumerate(numbers))
        return f"[{len(numbers)} numbers, {moment:.5g}]"
    if isinstance(value, float):
        # Rounding alone gives less than the one and, where it is divided by, more than the other.
        size = abs(value)
        return (
            "0" if size < 1e-9 else "huge" if size > 1e9 else f"{round(value, 9):.5g}"
        )
    return str(value)
