"""Initial states of the episodes of an environment: nominal, with noise, or of a recorded trial."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal

import numpy as np

from gauge_envs.errors import ParameterError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import shots_of
from gauge_envs.names import nearest
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.jitter import Jitter, can_scatter, perturbed_states
from gauge_envs.scene.states import nominal_states, row_of

ROUNDING = 1e-12
"""Largest change of a state that is only rounding [m, 1, m/s, rad/s]."""

SEEDS = 2**31
"""Number of seeds that an environment draws from."""

Scatter = Jitter | bool | str | Mapping[str, float] | None
"""Initial-state noise: `real`, True, a `Jitter`, or its fields as a mapping; None or False for none."""

Draw = Jitter | int | Literal["real"] | None
"""Source of an initial state: noise, the number of a trial, `real` for random recorded trials, or None for nominal."""


@dataclass(frozen=True, eq=False)
class InitialState:
    """Initial state of one world.

    Attributes:
        states: Initial states, shape [body_count, 13]; see `gauge_envs.scene.states`.
        drivers: Drivers of the episode.
        trial: Number of the replayed trial, or None.
        noise: Standard deviations of the noise; empty without noise.
        is_scattered: Whether noise has moved a body.
    """

    states: FloatArray
    drivers: tuple[Driver, ...]
    trial: int | None = None
    noise: Mapping[str, float] = field(default_factory=dict)
    is_scattered: bool = False

    @property
    def record(self) -> dict[str, float]:
        """Entry `jitter` of a result."""
        return dict(self.noise) if self.trial is None else {"trial": self.trial}


class InitialStates:
    """Sampler of the initial states of an experiment.

    The options of a reset stay effective for later resets, such as an autoreset, until a reset has a seed or options.

    Args:
        experiment: The experiment.
        jitter: Noise of every reset without an option.
    """

    def __init__(self, experiment: Experiment, jitter: Scatter = None) -> None:
        self._experiment = experiment
        self._default = self._noise(jitter, "jitter")
        self._options: Mapping[str, Any] = {}
        self._nominal = InitialState(
            nominal_states(experiment.scene), experiment.scene.drivers
        )

    def of_reset(self, options: Mapping[str, Any] | None, *, seeded: bool) -> Draw:
        """Return the source of the next initial states.

        Args:
            options: Options of the reset.
            seeded: Whether it has a seed.

        Raises:
            ParameterError: There is no such option.
        """
        if not isinstance(options, Mapping | None):
            raise ParameterError(
                f"options of reset are {options!r}, expected a mapping, as {{'jitter': True}}"
            )
        is_kept = options is None and not seeded
        chosen = self._options if is_kept else dict(options or {})
        draw = self._chosen(chosen)
        self._options = chosen
        return draw

    def _chosen(self, options: Mapping[str, Any]) -> Draw:
        unknown = [repr(key) for key in options if key not in ("jitter", "trial")]
        if unknown:
            raise ParameterError(
                f"reset has only the options 'jitter' and 'trial', got {', '.join(unknown)}"
            )
        trial = options.get("trial")
        if trial is None:
            return self._noise(options.get("jitter", self._default), "option 'jitter'")
        if isinstance(trial, bool) or not isinstance(trial, int | np.integer):
            raise ParameterError(
                f"option 'trial' is {trial!r}, expected the number of a trial, from 0"
            )
        if options.get("jitter"):
            raise ParameterError(
                "options 'jitter' and 'trial' both set the start: give one of them"
            )
        return int(trial)

    def _noise(self, value: Any, name: str) -> Draw:
        """Return the noise that an argument or an option gives."""
        experiment = self._experiment
        if value is None or value is False:
            return None
        if value == "real" and shots_of(experiment) is not None:
            return "real"
        if value is True or value == "real":
            value = Jitter()
        if isinstance(value, Mapping):
            known = [field.name for field in fields(Jitter)]
            unknown = [key for key in value if key not in known]
            if unknown:
                raise ParameterError(
                    f"{name} {unknown[0]!r}: {nearest(unknown[0], known)}"
                )
            value = Jitter(**value)
        if not isinstance(value, Jitter):
            raise ParameterError(
                f"{name} is {value!r}, expected 'real', True, False or a gauge_envs.Jitter"
            )
        if not can_scatter(experiment.scene):
            raise ParameterError(
                f"{experiment.id}: {name} moves no body, because each one is fixed, driven, or attached to such a body"
            )
        return value

    def seed_of(self, seed: int | None, draw: Draw, random: np.random.Generator) -> int:
        """Return the seed of an episode: the given seed, else a random one with noise, else 0."""
        if seed is not None:
            return int(seed)
        if draw is None or isinstance(draw, int):
            return 0
        return int(random.integers(SEEDS))

    def sample(self, draw: Draw, seed: int) -> InitialState:
        """Return an initial state.

        Args:
            draw: Its source.
            seed: Seed of the episode; modulo their number, it selects one of the independent single-trial recordings.

        Raises:
            ParameterError: There is no such trial, or the experiment cannot start from trials.
        """
        experiment = self._experiment
        shots = shots_of(experiment)
        if draw is None and shots is None:
            return self._nominal
        if isinstance(draw, Jitter):
            states = perturbed_states(experiment.scene, draw, seed=seed)
            largest_change = np.abs(states - self._nominal.states).max()
            return InitialState(
                states,
                experiment.scene.drivers,
                noise=draw.to_dict(),
                is_scattered=bool(largest_change > ROUNDING),
            )
        if shots is not None:
            trials = shots.trials()
            trial = draw if isinstance(draw, int) else trials[seed % len(trials)]
            shot = shots.shot(trial)
            states = self._nominal.states.copy()
            states[row_of(experiment.scene, shot.body)] = shot.start
            return InitialState(states, experiment.scene.drivers, trial=trial)
        assert isinstance(draw, int), "`real` draws only single-trial recordings"
        # This module imports rotations of SciPy.
        from gauge_envs.envs.trial_start import driven_trial, trial_states

        driven = driven_trial(experiment, draw)
        if driven is not None:
            return InitialState(driven.states, driven.drivers, trial=draw)
        states = trial_states(experiment, draw)
        return InitialState(states, experiment.scene.drivers, trial=draw)
