"""Bases of the environments: engine, spec, renderer, and worlds in lockstep."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.core import ActType, ObsType
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from gauge_envs.backends.base import Backend
from gauge_envs.backends.registry import backend_for, versions_of
from gauge_envs.backends.shared.resampled import in_intervals
from gauge_envs.backends.world import Simulation
from gauge_envs.envs.arguments import check_support, plain_spec
from gauge_envs.envs.pictures import (
    RENDER_MODES,
    WORLDS_RENDER_MODES,
    Pictures,
    Rendered,
)
from gauge_envs.errors import EpisodeError, ParameterError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.scene.timing import FRAME_RATE_HZ

WORLD_LIMIT = 100_000
"""Largest number of worlds; as many SlopeSlider worlds take 63 GB on MuJoCo."""


class EngineEnvironment:
    """An environment of one experiment on one engine.

    A subclass names it before Gymnasium's `Env` or `VectorEnv`, so that its `spec` and `metadata` apply.

    Args:
        experiment: The experiment.
        pictures: Renderer of the environment.
        backend: Name of an installed physics engine.
        settings: Numerical settings of the engine that replace those of the preset.

    Attributes:
        experiment: The experiment, without jitter.
        backend_name: Name of the engine.
        versions: Versions of the engine's packages.
        render_mode: None or one of `metadata["render_modes"]`.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "render_modes": [*RENDER_MODES],
        "render_fps": int(FRAME_RATE_HZ),
    }
    _spec: EnvSpec | None = None

    def __init__(
        self,
        experiment: Experiment,
        pictures: Pictures,
        *,
        backend: str,
        settings: Mapping[str, Any] | None,
    ) -> None:
        check_support(experiment, backend)
        self.experiment = experiment
        self.backend_name = backend
        self.render_mode = pictures.render_mode
        self._pictures = pictures
        self._settings = settings
        self._is_closed = False
        self.versions = versions_of(backend)

    @property
    def _engine(self) -> Backend:
        return backend_for(self.backend_name, self.experiment.model_file)

    @property
    def spec(self) -> EnvSpec | None:
        """How Gymnasium makes this environment again; `EnvSpec.to_json` accepts its arguments.

        Raises:
            ParameterError: Arguments name another experiment than the id, whose steps Gymnasium would count.
        """
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = plain_spec(spec)
        if spec is None or not spec.id.startswith("GAUGE/"):
            return
        for name in ("variant", "task"):
            stated = spec.kwargs.get(name)
            if stated is not None and f"GAUGE/{stated}" != spec.id:
                raise ParameterError(
                    f"{name} {str(stated)!r} with {spec.id}: the id names the experiment; make 'GAUGE/{stated}'"
                )

    @property
    def _label(self) -> str:
        """Name of the environment in error messages."""
        return self.experiment.id

    def __getstate__(self) -> None:
        """Raise an error: the models of most engines can be neither copied nor pickled."""
        raise EpisodeError(
            f"{self._label}: a running environment cannot be copied or pickled; make another one from its spec"
        )

    def _check_open(self, call: str) -> None:
        """Raise an error if a method is called after `close`."""
        if self._is_closed:
            raise EpisodeError(
                f"{self._label}: {call} after close; make the environment again"
            )

    def _check_started(self, call: str, *, started: bool) -> None:
        """Raise an error if a method is called before the first reset, or after `close`.

        Args:
            call: Name of the method.
            started: Whether `reset` was called.
        """
        self._check_open(call)
        if not started:
            raise EpisodeError(f"{self._label}: call reset before {call}")


class SimulationEnvironment(EngineEnvironment, gymnasium.Env[ObsType, ActType]):
    """An environment that holds one simulation.

    Attributes:
        simulation: The running simulation.
    """

    def _build(self, experiment: Experiment) -> bool:
        """Build the simulation, unless there is one that takes the start, and return whether there was.

        Args:
            experiment: The experiment with the start that applies now.
        """
        scene = experiment.scene
        if "simulation" in vars(self):
            if self.simulation.start_at(scene):
                self._pictures.free()
                return True
            check_support(experiment, self.backend_name)
            self._free()
        built = self._engine.build(scene, self._settings)
        self.simulation: Simulation = in_intervals(built, scene)
        return False

    def _check_running(self, *, started: bool, is_over: bool) -> None:
        """Raise an error if no step may follow."""
        self._check_started("step", started=started)
        if is_over:
            raise EpisodeError(f"{self._label}: the episode is over, call reset")

    def close(self) -> None:
        """Free the simulation and the renderer. A second call does nothing."""
        if not self._is_closed:
            self._is_closed = True
            self._free()
            self._pictures.close()

    def _free(self) -> None:
        self._pictures.free()
        self.simulation.close()

    def _show(self) -> None:
        """Draw what a reset or a step has reached, in the window if there is one."""
        if self.render_mode == "human":
            self.render()


class WorldsEnvironment(EngineEnvironment, VectorEnv[ObsType, Any, NDArray[Any]]):
    """An environment of many worlds on one engine."""

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]  # gymnasium declares it without ClassVar
        **EngineEnvironment.metadata,
        "render_modes": [*WORLDS_RENDER_MODES],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    _is_reset = False

    def _set_spaces(self, world_count: int, first: Any) -> None:
        """Set the spaces of a number of worlds that are like the first."""
        self.num_envs = world_count
        self.single_action_space: spaces.Space[Any] = first.action_space
        self.single_observation_space: spaces.Space[ObsType] = first.observation_space
        self.action_space = batch_space(self.single_action_space, world_count)
        self.observation_space = batch_space(self.single_observation_space, world_count)

    def _seeds(self, seed: int | Sequence[int | None]) -> list[int | None]:
        """Return the seed of each world; each next one has one more than a single seed."""
        if isinstance(seed, int | np.integer):
            return list(range(int(seed), int(seed) + self.num_envs))
        if isinstance(seed, str) or not isinstance(seed, Sequence | np.ndarray):
            raise ParameterError(
                f"seed {seed!r}: expected a number of 0 or more, or one for each world"
            )
        if len(seed) != self.num_envs:
            raise ParameterError(
                f"{len(seed)} seeds for {self.num_envs} worlds: give one for each world, or a single number"
            )
        return list(seed)

    def render(self) -> tuple[Any, ...] | None:
        """Return a picture of each world in the form of the render mode, or None without one."""
        if self.render_mode is None:
            return None
        self._check_started("render", started=self._is_reset)
        return tuple(self._picture(number) for number in range(self.num_envs))

    @abstractmethod
    def _picture(self, number: int) -> Rendered | None:
        """Return the picture of a world."""

    def close_extras(self, **_: Any) -> None:
        """Free the worlds and the renderer."""
        self._is_closed = True
        self._free()

    def _free(self) -> None:
        self._pictures.close()


def world_constants(
    num_envs: int, world_parameters: Sequence[Mapping[str, Any]] | None
) -> list[Mapping[str, Any]]:
    """Return the constants of each world, or raise an error for an impossible number of worlds or of constants.

    Args:
        num_envs: Number of worlds.
        world_parameters: Overrides for each world, or None.
    """
    if (
        not isinstance(num_envs, int | np.integer)
        or isinstance(num_envs, bool)
        or not 1 <= num_envs <= WORLD_LIMIT
    ):
        raise ParameterError(
            f"num_envs is {num_envs!r}, expected a whole number from 1 to {WORLD_LIMIT}"
        )
    if world_parameters is not None and len(world_parameters) != num_envs:
        raise ParameterError(
            f"world_parameters has {len(world_parameters)} entries for {num_envs} worlds: give one for each"
        )
    constants = [*(world_parameters or ({},) * num_envs)]
    for one in constants:
        if not isinstance(one, Mapping):
            raise ParameterError(
                f"world_parameters has {one!r}: give overrides for each world, as {{'cube.friction': 0.3}}"
            )
    return constants
