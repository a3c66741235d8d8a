"""Arguments of environments, shared by `gymnasium.make`, `make_vec`, runs and the command line."""

import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass
from os import PathLike
from typing import Any

import numpy as np
from gymnasium import spaces

from gauge_envs.backends.registry import (
    backend_for,
    backend_names,
    is_bundled,
    support_of,
)
from gauge_envs.backends.shared.resampled import in_intervals
from gauge_envs.backends.simulation import LoopedSimulation, Simulation
from gauge_envs.envs.rollout import Rollout
from gauge_envs.errors import (
    ActionError,
    GaugeError,
    NoRewardWarning,
    ParameterError,
    UnsupportedSceneError,
)
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.scene_builder import Parameters
from gauge_envs.experiments.variants import Variant, user_variants
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.references.band import Band
from gauge_envs.references.user_data import DataSource, has_import
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.reference import refusal
from gauge_envs.validation import chosen


@dataclass(frozen=True)
class EnvArguments:
    """Arguments of `gymnasium.make`: the experiment, the engine and the reference.

    Attributes: as the arguments of `gauge_envs.GaugeEnv`.
    """

    variant: str | Variant
    _: KW_ONLY
    backend: str = "mujoco"
    parameters: Parameters = "published"
    settings: Mapping[str, Any] | None = None
    marker_proxy: MarkerProxy | str = MarkerProxy.MATERIAL
    drivers: DataSource | str = DataSource.BUNDLED
    reference: DataSource | str = DataSource.BUNDLED
    asset: str | PathLike[str] | None = None

    def __post_init__(self) -> None:
        chosen(MarkerProxy, self.marker_proxy, "marker_proxy")
        self._check_types()

    def _check_types(self) -> None:
        """Raise an error for an argument of a type that no run can use."""
        expected: dict[str, tuple[Any, str]] = {
            "variant": (
                str | Variant,
                "a Variant or its name, as 'SlopeSlider-2-wood'",
            ),
            "backend": (str, "the name of a backend, as 'mujoco'"),
            "settings": (Mapping | None, "a mapping, as {'timestep_s': 1 / 1800}"),
            "asset": (str | PathLike | None, "the path of a file"),
        }
        for name, (types, text) in expected.items():
            value = getattr(self, name)
            if not isinstance(value, types):
                raise ParameterError(f"{name} is {value!r}, expected {text}")
        for name in ("parameters", "settings"):
            value = getattr(self, name)
            if isinstance(value, Mapping) and not all(
                isinstance(key, str) for key in value
            ):
                raise ParameterError(f"{name} {value!r}: expected texts as keys")

    @property
    def proxy(self) -> MarkerProxy:
        """The marker proxy as an enum."""
        return MarkerProxy(self.marker_proxy)

    def experiment(self) -> Experiment:
        """Load the experiment."""
        return load_experiment(
            self.variant,
            self.parameters,
            drivers=self.drivers,
            reference=self.reference,
            asset=self.asset,
        )

    def rollout(
        self, experiments: Sequence[Experiment], *, restarts: bool = False
    ) -> Rollout:
        """Return the rollout of a new simulation.

        Args:
            experiments: The experiment of each world, which may differ in constants.
            restarts: Whether each world can be reset alone.

        Raises:
            UnsupportedSceneError: The backend cannot build a scene.
            ParameterError: A setting does not exist or has an invalid value.
        """
        return Rollout(
            experiments,
            self.simulation(experiments, restarts=restarts),
            marker_proxy=self.proxy,
        )

    def simulation(
        self, experiments: Sequence[Experiment], *, restarts: bool = False
    ) -> Simulation:
        """Build a world for each experiment, in one simulation; see `rollout`."""
        distinct = {id(experiment): experiment for experiment in experiments}
        for experiment in distinct.values():
            check_support(experiment, self.backend)
        engine = backend_for(self.backend, experiments[0].model_file)
        scenes = [experiment.scene for experiment in experiments]
        scene, count = scenes[0], len(scenes)
        is_batch = all(each is scene for each in scenes) and (
            count == 1 or engine.restarts_worlds or not restarts
        )
        if is_batch:
            batch = engine.build_worlds(scene, count, self.settings)
            simulation = in_intervals(batch, scene)
            if simulation is batch or count == 1 or not restarts:
                return simulation
            batch.close()
        worlds = [
            in_intervals(engine.build(each, self.settings), each) for each in scenes
        ]
        return LoopedSimulation(worlds)


def check_episode_steps(asked: int | None, steps: int) -> None:
    """Raise an error if synchronous worlds get another number of steps than their episode has.

    Args:
        asked: `max_episode_steps` of `gymnasium.make_vec`; None for the steps of the episode.
        steps: Steps of the episode.
    """
    if asked not in (None, steps):
        raise ParameterError(
            f"max_episode_steps is {asked!r}, and the episode has {steps} steps: leave it out, or pass "
            "vectorization_mode='sync', which cuts episodes; these have no score"
        )


def checked_action(action: Any, space: spaces.Space[Any], name: str) -> FloatArray:
    """Return an action as numbers, shape [motion_count], or raise an `ActionError`.

    Args:
        action: The action.
        space: A Box from -1 to 1, or `Discrete(1)`, whose only action has no numbers.
        name: Id of the environment, for the error.
    """
    if isinstance(space, spaces.Discrete):
        is_number = isinstance(action, int | np.integer | np.ndarray)
        if is_number and np.ndim(action) == 0 and action == 0:
            return np.zeros(0)
        raise ActionError(
            f"{name}: action {action!r}: the experiment has no driven body, so the only action is 0"
        )
    try:
        numbers = np.asarray(action, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ActionError(
            f"{name}: action {action!r} is not an array of numbers"
        ) from error
    shape = space.shape or ()
    if numbers.shape != shape:
        raise ActionError(
            f"{name}: action has shape {numbers.shape}, expected {shape}, as {np.zeros(shape).tolist()}"
        )
    # A comparison with NaN is false.
    if not all(-1.0 <= number <= 1.0 for number in numbers.ravel().tolist()):
        raise ActionError(
            f"{name}: action {numbers.tolist()} is out of range: give numbers from -1 to 1"
        )
    return numbers


def check_support(experiment: Experiment, backend: str) -> None:
    """Raise an error if a backend cannot build an experiment."""
    support = support_of(backend, experiment.scene, experiment.model_file)
    if support:
        return
    alternative = "no other backend of this package can"
    able = _first_able(experiment, backend)
    if able is not None:
        alternative = f"backend={able!r} can"
    raise UnsupportedSceneError(
        f"{experiment.id}: backend {backend!r} cannot build it: {'; '.join(support.missing)}; {alternative}"
    )


def _first_able(experiment: Experiment, backend: str) -> str | None:
    """Return the first other backend of this package that can build an experiment, or None."""
    for name in backend_names():
        # An engine of another package might crash here and end the run.
        if name == backend or not is_bundled(name):
            continue
        # Its extra may be missing.
        with suppress(GaugeError):
            if support_of(name, experiment.scene, experiment.model_file):
                return name
    return None


# --- environments without a reward ---

CALLER = 4
"""Frames from the warning to the caller of `gymnasium.make`: this module, the entry point, `make`, the caller."""

_warned: set[str] = set()


def warn_before_use(experiment: Experiment, band: Band | None) -> None:
    """Warn, once for each text, that rewards or scores are missing, or that a restitution of the user has no effect.

    Args:
        experiment: The experiment of the environment.
        band: Its reference.
    """
    texts = {
        NoRewardWarning: _missing_reward(experiment, band),
        UserWarning: experiment.unused_restitution,
    }
    for category, text in texts.items():
        if text and text not in _warned:
            warnings.warn(text, category, stacklevel=CALLER)
            _warned.add(text)


def _missing_reward(experiment: Experiment, band: Band | None) -> str:
    """Return which rewards and scores are missing, and why; empty if none is."""
    if band is None:
        return _no_reward_message(experiment)
    limits = []
    last = int(np.flatnonzero(band.compared.known).max(initial=0))
    if last < experiment.frame_count - 1:
        limits.append(
            f"its {band.kind} reference ends at {last / FRAME_RATE_HZ:.2f} of "
            f"{(experiment.frame_count - 1) / FRAME_RATE_HZ:.2f} s: later rewards are 0"
        )
    reason = refusal(experiment, band)
    if reason is not None:
        cause = ", ".join(experiment.overrides) or "the edited scene"
        limits.append(
            f"{reason}; the cause is {cause}, and rewards still compare with the reference"
        )
    return f"{experiment.id}: {'; '.join(limits)}" if limits else ""


def _no_reward_message(experiment: Experiment) -> str:
    """Return what is missing and how to get it."""
    missing = f"{experiment.id} has no reference in use, so every reward is 0."
    if experiment.variant in user_variants():
        return (
            f"{missing} Put {experiment.name}.band.toml and .npz next to its task file."
        )
    fix = "import its real trials with 'gauge data import', then pass reference='imported'"
    if has_import(experiment.name):
        fix = "pass reference='imported', because its real trials are imported"
    return f"{missing} To get one, {fix}; or choose an id that 'gauge list --scored' shows."
