"""Scenes that differ in their starts, as environments of one Genesis scene."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.base import World, Worlds
from gauge_envs.backends.genesis.model import Model, borrow_model, model_key, return_model
from gauge_envs.backends.genesis.settings import SettingsGenesis
from gauge_envs.backends.genesis.stepper import Stepper
from gauge_envs.errors import BackendError
from gauge_envs.scene import Pose, Scene


def can_share(scenes: Sequence[Scene], settings: SettingsGenesis) -> bool:
    """Return whether scenes differ only in where their free bodies start, so that one Genesis scene holds them."""
    if any(scene.deformables for scene in scenes):
        return False
    return len({model_key(scene, settings) for scene in scenes}) == 1


def new_worlds(scenes: Sequence[Scene], settings: SettingsGenesis) -> Worlds:
    """Return scenes as environments of one Genesis scene."""
    return WorldsGenesis(scenes, settings)


class _World(World):
    """One environment of a Genesis scene."""

    def __init__(self, worlds: WorldsGenesis, index: int) -> None:
        self.settings = worlds.settings
        self._worlds = worlds
        self._index = index

    def drive(self, body: str, pose: Pose, velocity: NDArray[np.float64], acceleration: NDArray[np.float64]) -> None:
        """Prescribe the motion of a kinematic body; see `World.drive`."""
        self._worlds.stepper().drive(self._index, body, pose, velocity, acceleration)

    def apply_wrench(self, body: str, wrench: NDArray[np.float64]) -> None:
        """Apply a force and a torque to a dynamic body; see `World.apply_wrench`."""
        self._worlds.stepper().apply_wrench(self._index, body, wrench)

    def body_states(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Return poses and velocities of bodies, shape [len(names), 13]; see `World.body_states`."""
        return self._worlds.stepper().body_states(self._index, names)


class WorldsGenesis(Worlds):
    """Instances of a rigid scene as environments of one Genesis scene.

    Args:
        scenes: The instances.
        settings: Numerical settings.
    """

    def __init__(self, scenes: Sequence[Scene], settings: SettingsGenesis) -> None:
        self.settings = settings.model_dump(mode="json")
        self._model: Model | None = borrow_model(scenes[0], settings, len(scenes))
        self._stepper = Stepper(scenes, settings, self._model)
        self.worlds = [_World(self, index) for index in range(len(scenes))]
        self.reset(0)

    def stepper(self) -> Stepper:
        """Return what advances the environments."""
        if self._model is None:
            raise BackendError("the Genesis worlds are closed: build them again")
        return self._stepper

    def reset(self, seed: int) -> None:
        """Return all environments to their starts. Genesis draws no random numbers here, so the seed has no effect."""
        self.stepper().reset()

    def advance(self, seconds: float) -> None:
        """Step the Genesis scene, which contains all environments."""
        self.stepper().advance(seconds)

    def close(self) -> None:
        """Free the scene, or keep it for the next worlds of the same bodies."""
        if self._model is not None:
            return_model(self._model)
            self._model = None
            del self._stepper
