"""Genesis simulations: driving, stepping and reading."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.base import Simulation
from gauge_envs.backends.genesis.model import Model, borrow_model, return_model
from gauge_envs.backends.genesis.parts import DeformablePart
from gauge_envs.backends.genesis.settings import SettingsGenesis
from gauge_envs.backends.genesis.stepper import Stepper
from gauge_envs.backends.shared.snapshot import Snapshot, StateOrigin
from gauge_envs.errors import BackendError
from gauge_envs.scene import Pose, Scene


class SimulationGenesis(Simulation):
    """A scene in Genesis.

    Args:
        scene: The scene.
        settings: Numerical settings.
    """

    def __init__(self, scene: Scene, settings: SettingsGenesis) -> None:
        self.settings = settings.model_dump(mode="json")
        self._model: Model | None = borrow_model(scene, settings)
        self._stepper = Stepper([scene], settings, self._model)
        self._parts = {name: part for part in self._model.parts for name in part.names}
        self._origin = StateOrigin(f"genesis {version('genesis-world')}", self.settings, scene)
        self.reset(0)

    def _open(self) -> Model:
        if self._model is None:
            raise BackendError("the Genesis simulation is closed: build another one")
        return self._model

    def _part(self, name: str) -> DeformablePart:
        self._open()
        return self._parts[name]

    def reset(self, seed: int) -> None:
        """Return to the scene's start. Genesis draws no random numbers here, so the seed has no effect."""
        self._open()
        self._stepper.reset()

    def drive(self, body: str, pose: Pose, velocity: NDArray[np.float64], acceleration: NDArray[np.float64]) -> None:
        """Prescribe the motion of a kinematic body; see `World.drive`."""
        self._open()
        self._stepper.drive(0, body, pose, velocity, acceleration)

    def apply_wrench(self, body: str, wrench: NDArray[np.float64]) -> None:
        """Apply a force and a torque to a dynamic body; see `World.apply_wrench`."""
        self._open()
        self._stepper.apply_wrench(0, body, wrench)

    def advance(self, seconds: float) -> None:
        """Step the scene."""
        self._open()
        self._stepper.advance(seconds)

    def body_states(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Return poses and velocities of bodies, shape [len(names), 13]; see `World.body_states`."""
        self._open()
        return self._stepper.body_states(0, names)

    def fault(self) -> str | None:
        """Return why Genesis gave up the state, or None."""
        return next((reason for part in self._open().parts if (reason := part.fault()) is not None), None)

    def nodes(self, name: str) -> NDArray[np.float64]:
        """Return the positions of a deformable body's nodes [m], shape [node_count, 3]."""
        return self._part(name).nodes(name)

    def track(self, name: str, points_m: NDArray[np.float64]) -> Callable[[], NDArray[np.float64]] | None:
        """Return a reader of material points; see `World.track`."""
        return self._part(name).track(name, points_m)

    def state(self) -> Snapshot:
        """Return every array that a step reads, with its origin."""
        model = self._open()
        return self._origin.state((self._stepper.state(), [part.state() for part in model.parts]))

    def restore(self, state: Snapshot) -> None:
        """Restore a state."""
        model = self._open()
        rigid, parts = self._origin.values(state)
        self._stepper.restore(rigid)
        for part, values in zip(model.parts, parts, strict=True):
            part.restore(values)

    def close(self) -> None:
        """Free the scene, or keep it for the next simulation of the same bodies."""
        if self._model is not None:
            return_model(self._model)
            self._model = None
            self._parts = {}
            del self._stepper
