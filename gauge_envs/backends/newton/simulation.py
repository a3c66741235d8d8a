"""Running Newton models as simulations and worlds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.base import Simulation, World, Worlds
from gauge_envs.backends.newton.model import WorldLayout, build_model
from gauge_envs.backends.newton.settings import SettingsNewton
from gauge_envs.backends.newton.stepper import Stepper
from gauge_envs.scene import Motion, Pose, Scene

__all__ = [
    "SimulationNewton",
    "WorldsNewton",
]


class _WorldNewton(World):
    """One copy of a scene in a model."""

    def __init__(self, scene: Scene, copy: WorldLayout, loop: Stepper, settings: SettingsNewton) -> None:
        self.settings = settings.model_dump(mode="json")
        self._copy = copy
        self._loop = loop
        self._fixed = {
            body.name: np.array([*body.pose.position_m, *body.pose.quaternion, *np.zeros(6)])
            for body in scene.bodies
            if body.motion is Motion.FIXED
        }

    def drive(self, body: str, pose: Pose, velocity: NDArray[np.float64], acceleration: NDArray[np.float64]) -> None:
        """Prescribe a kinematic body; see `World.drive`."""
        x, y, z = (np.asarray(pose.position_m) - self._copy.origin_m).tolist()
        near = Pose(position_m=(x, y, z), quaternion=pose.quaternion)
        self._loop.drive(self._copy.rigid.bodies[body], near, velocity, acceleration)

    def apply_wrench(self, body: str, wrench: NDArray[np.float64]) -> None:
        """Force and torque on a dynamic body, where the solver takes them; see `World.apply_wrench`."""
        self._loop.apply_wrench(self._copy.rigid.bodies[body], wrench)

    def body_states(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Poses and velocities, shape [len(names), 13]; kept in single precision. See `World.body_states`."""
        states = np.empty((len(names), 13))
        moving = [(row, self._copy.rigid.bodies[name]) for row, name in enumerate(names) if name not in self._fixed]
        for row, name in enumerate(names):
            if name in self._fixed:
                states[row] = self._fixed[name]
        if moving:
            rows, bodies = map(list, zip(*moving, strict=True))
            states[rows] = self._loop.body_states(bodies)
            states[rows, :3] += self._copy.origin_m
        return states

    def nodes(self, name: str) -> NDArray[np.float64]:
        """Nodes of a deformable body now [m], shape [node_count, 3]."""
        return self._copy.nodes(name, self._loop.now)

    def track(self, name: str, points_m: NDArray[np.float64]) -> Callable[[], NDArray[np.float64]] | None:
        """Reader of material points, where the part has one; see `World.track`."""
        origin_m = self._copy.origin_m
        read = self._copy.parts[name].track(points_m - np.asarray(origin_m))
        return None if read is None else lambda: read(self._loop.now) + origin_m


class SimulationNewton(_WorldNewton, Simulation):
    """A scene in Newton."""

    def __init__(self, scene: Scene, settings: SettingsNewton) -> None:
        loop, copies = build_model([scene], settings)
        super().__init__(scene, copies[0], loop, settings)

    def reset(self, seed: int) -> None:
        """Return to the scene's start; nothing is random, so the seed changes nothing."""
        self._loop.reset()

    def advance(self, seconds: float) -> None:
        """Step the model."""
        self._loop.advance(seconds)

    def state(self) -> Any:
        """Every array that a step may change."""
        return self._loop.state()

    def restore(self, state: Any) -> None:
        """Go back to a state."""
        self._loop.restore(state)

    def close(self) -> None:
        """Nothing is held outside memory."""


class WorldsNewton(Worlds):
    """Copies of a scene as worlds of one Newton model."""

    def __init__(self, scenes: Sequence[Scene], settings: SettingsNewton) -> None:
        self._loop, copies = build_model(scenes, settings)
        self.worlds = [
            _WorldNewton(scene, copy, self._loop, settings) for scene, copy in zip(scenes, copies, strict=True)
        ]

    def reset(self, seed: int) -> None:
        """Return to the starts; nothing is random, so the seed changes nothing."""
        self._loop.reset()

    def advance(self, seconds: float) -> None:
        """Step all worlds."""
        self._loop.advance(seconds)

    def close(self) -> None:
        """Nothing is held outside memory."""
