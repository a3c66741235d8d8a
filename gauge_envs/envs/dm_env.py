"""The experiments as `dm_env` environments; needs the extra `dm`.

    from gauge_envs.envs.dm_env import load

    env = load("SlopeSlider-2-wood")

The interface is that of `dm_env`; the engine is a backend of this package.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs import registration
from numpy.typing import NDArray

from gauge_envs.envs.env import GaugeEnv
from gauge_envs.envs.wrappers import scored_env
from gauge_envs.experiments.variants import find_variant
from gauge_envs.optional import needs_extra
from gauge_envs.scoring.score import Score

with needs_extra("gauge_envs.envs.dm_env", "dm"):
    import dm_env
    from dm_env import specs


def load(
    name: str,
    *,
    seed: int = 0,
    options: Mapping[str, Any] | None = None,
    **arguments: Any,
) -> DmEnvironment:
    """Return an experiment or a control task as a `dm_env.Environment`.

    Args:
        name: Name of the experiment or control task, as `SlopeSlider-2-wood`; its Gymnasium id; or a task file.
        seed: Seed of the first episode; each next episode has one more.
        options: Options of every reset, as `{"jitter": True}`.
        **arguments: Keywords of `GaugeEnv` or of the control task: `backend`, `settings`, `parameters`, ...

    Raises:
        UnknownNameError: There is no such experiment or control task.

    Example:
        >>> from gauge_envs.envs.dm_env import load
        >>> env = load("SlopeSlider-2-wood")
        >>> step = env.reset()
        >>> while not step.last():
        ...     step = env.step(env.action_spec().generate_value())
        >>> step.discount, round(env.score.rmse_normalized, 2)
        (1.0, 0.41)
    """
    spec = registration.registry.get(f"GAUGE/{name.removeprefix('GAUGE/')}")
    env: gymnasium.Env[Any, Any]
    if spec is None or "variant" in spec.kwargs:
        env = scored_env(variant=find_variant(name), **arguments)
    else:
        # A control task registers without a variant.
        env = gymnasium.make(spec, disable_env_checker=True, **arguments)
    return DmEnvironment(env, seed=seed, options=options)


class DmEnvironment(dm_env.Environment):
    """An environment of this suite with the interface of dm_env.

    Observations, actions and rewards are those of `GaugeEnv`. The last frame has a discount of 1, because only the
    recording ends there. Divergence has a discount of 0.

    Args:
        env: Environment from `gymnasium.make`; its observation is an array or a dictionary of arrays.
        seed: Seed of the first episode; each next episode has one more.
        options: Options of every reset.

    Attributes:
        score: Score of the last completed episode; None before it, if a wrapper cut the episode short, and for control
            tasks, whose result is `info["limit"]`.
        info: Gymnasium's `info` of the last step.
    """

    def __init__(
        self,
        env: gymnasium.Env,
        *,
        seed: int = 0,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        self.score: Score | None = None
        self.info: Mapping[str, Any] = {}
        self._env = env
        self._next_seed = seed
        self._options = dict(options or {})
        self._is_over = True

    def reset(self) -> dm_env.TimeStep:
        """Start an episode."""
        observation, self.info = self._env.reset(
            seed=self._next_seed, options=self._options
        )
        self._next_seed += 1
        self._is_over = False
        return dm_env.restart(observation)

    def step(self, action: Any) -> dm_env.TimeStep:
        """Simulate one frame, 1/30 s; before the first episode and after an end, start an episode instead."""
        if self._is_over:
            return self.reset()
        observation, reward, terminated, truncated, self.info = self._env.step(action)
        self._is_over = terminated or truncated
        if not self._is_over:
            return dm_env.transition(reward, observation)
        inner = self._env.unwrapped
        if isinstance(inner, GaugeEnv):
            self.score = inner.score()
        end = dm_env.termination if terminated else dm_env.truncation
        return end(reward, observation)

    def observation_spec(self) -> specs.BoundedArray | dict[str, specs.BoundedArray]:
        """Return shape and bounds of each array of the observation."""
        space = self._env.observation_space
        if isinstance(space, spaces.Dict):
            return {name: _array(name, entry) for name, entry in space.items()}
        return _array("observation", space)

    def action_spec(self) -> specs.BoundedArray:
        """Return the spec of a velocity in [-1, 1] for each driven motion, or of the single action 0."""
        space = self._env.action_space
        return (
            specs.DiscreteArray(1, name="action")
            if isinstance(space, spaces.Discrete)
            else _array("action", space)
        )

    def reward_spec(self) -> specs.BoundedArray:
        """Return the spec of a number: at most 0 for an experiment, without bounds for a control task."""
        is_experiment = isinstance(self._env.unwrapped, GaugeEnv)
        largest = 0.0 if is_experiment else np.inf
        return specs.BoundedArray((), np.float64, -np.inf, largest, name="reward")

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture of the scene; see `GaugeEnv.render`."""
        return self._env.render()  # type: ignore[return-value]

    def close(self) -> None:
        """Free the simulation. A second call does nothing."""
        self._env.close()


def _array(name: str, space: spaces.Space[Any]) -> specs.BoundedArray:
    assert isinstance(space, spaces.Box)
    return specs.BoundedArray(
        space.shape, space.dtype, space.low, space.high, name=name
    )
