"""Many worlds of one control task, which advance together and start and end their episodes one by one."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.envs.registration import load_env_creator
from numpy.typing import NDArray

from gauge_envs.backends.base import Simulation, World, Worlds, worlds_of
from gauge_envs.backends.registry import backend_for
from gauge_envs.backends.settings import check_drive_interval
from gauge_envs.envs.control.env import ControlEnv, Step
from gauge_envs.envs.control.tasks import find_control_task
from gauge_envs.experiments.scene_builder import Parameters
from gauge_envs.scene import Pose
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S

FloatArray = NDArray[np.float64]


class ControlWorlds:
    """Worlds of a control task on one engine, which may advance them in one call.

    Each world is the single environment with its constants, to the bit. Engines whose worlds share a model and can
    restart alone, such as Newton, get one model; the worlds of others are simulations of their own.

    Args:
        task: Name or id of the task.
        constants: Overrides of each world, such as `{"cube.friction": 0.3}`, on top of `parameters`.
        parameters: `calibrated`, another parameter set of the task file, or overrides.
        backend: Name of the engine.
        settings: Numerical settings of the engine that replace those of the preset.

    Attributes:
        envs: The environment of each world; their `reset` and `step` are not for use.
    """

    def __init__(
        self,
        task: str,
        constants: Sequence[Mapping[str, Any]],
        *,
        parameters: Parameters = "calibrated",
        backend: str = "mujoco",
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        found = find_control_task(task)
        make = load_env_creator(found.entry_point)

        def world(chosen: Parameters) -> ControlEnv:
            env = make(material=found.material, parameters=chosen, backend=backend, settings=settings, is_world=True)
            assert isinstance(env, ControlEnv)
            return env

        first = world(parameters)
        common = dict(first.experiment.overrides)
        self.envs = [world(common | dict(one)) if one else world(parameters) for one in constants]
        scenes = [env.experiment.scene for env in self.envs]
        engine = backend_for(backend, first.experiment.model_file)
        self._worlds = worlds_of(engine, scenes, settings, restart_alone=True)
        self._readings: _Readings | None = None
        worlds = list(self._worlds.worlds)
        if not all(isinstance(one, Simulation) for one in worlds):
            moving = [body.name for body in scenes[0].dynamic_bodies] + [one.body for one in scenes[0].drivers]
            self._readings = _Readings(self._worlds, moving)
            worlds = [_ReadWorld(one, self._readings, number) for number, one in enumerate(worlds)]
        for env, one in zip(self.envs, worlds, strict=True):
            check_drive_interval(one.settings)
            env.world = one

    def __len__(self) -> int:
        """Return the number of worlds."""
        return len(self.envs)

    def begin(self, seeds: Mapping[int, int | None]) -> dict[int, tuple[FloatArray, dict[str, Any]]]:
        """Start a new episode in some worlds, as `ControlEnv.reset` does.

        Args:
            seeds: Seed for the number of each world; None continues its random numbers.
        """
        for number in seeds:
            self._worlds.restart(number)
        self._forget()
        return {number: self.envs[number].begin(seed) for number, seed in seeds.items()}

    def step(self, actions: Mapping[int, Any]) -> dict[int, Step]:
        """Simulate one frame in some worlds, with `limit` in `info` where an episode ends.

        Args:
            actions: Action for the number of each world whose episode is running.
        """
        frames = {number: self.envs[number].frame(action) for number, action in actions.items()}
        steps: dict[int, Step] = {}
        while frames:
            for number, frame in list(frames.items()):
                self._continue(number, frame, frames, steps)
            self._advance(frames)
        return {number: steps[number] for number in actions}

    def _continue(
        self,
        number: int,
        frame: Generator[None, None, Step],
        frames: dict[int, Generator[None, None, Step]],
        steps: dict[int, Step],
    ) -> None:
        try:
            next(frame)
        except StopIteration as end:
            step: Step = end.value
            if step[2] or step[3]:
                step[4]["limit"] = self.envs[number].report()
            steps[number] = step
            del frames[number]

    def _advance(self, numbers: Iterable[int]) -> None:
        if self._readings is None:
            for number in numbers:
                simulation = self._worlds.worlds[number]
                assert isinstance(simulation, Simulation)
                simulation.advance(SAMPLE_INTERVAL_S)
        elif numbers:
            self._worlds.advance(SAMPLE_INTERVAL_S)
            self._forget()

    def _forget(self) -> None:
        if self._readings is not None:
            self._readings.states = None

    def close(self) -> None:
        """Free the worlds."""
        self._worlds.close()


class _Readings:
    """States of all worlds of a model, read once after each advance."""

    def __init__(self, worlds: Worlds, names: Sequence[str]) -> None:
        self._worlds = worlds
        self._names = tuple(dict.fromkeys(names))
        self.rows = {name: row for row, name in enumerate(self._names)}
        self.states: FloatArray | None = None

    def of(self, number: int, names: Sequence[str]) -> FloatArray:
        if self.states is None:
            self.states = self._worlds.body_states(self._names)
        return self.states[number, [self.rows[name] for name in names]]


class _ReadWorld(World):
    """A world whose states are read together with those of all others."""

    def __init__(self, world: World, readings: _Readings, number: int) -> None:
        self.settings = world.settings
        self._world, self._readings, self._number = world, readings, number

    def drive(self, body: str, pose: Pose, velocity: FloatArray, acceleration: FloatArray) -> None:
        """Drive a body of the world itself; see `World.drive`."""
        self._world.drive(body, pose, velocity, acceleration)

    def apply_wrench(self, body: str, wrench: FloatArray) -> None:
        """Apply a force and a torque in the world itself; see `World.apply_wrench`."""
        self._world.apply_wrench(body, wrench)

    def fault(self) -> str | None:
        """Return why the engine gave up the state, or None; see `World.fault`."""
        return self._world.fault()

    def body_states(self, names: Sequence[str]) -> FloatArray:
        """Return the states of the bodies from the reading of all worlds; see `World.body_states`."""
        return self._readings.of(self._number, names)
