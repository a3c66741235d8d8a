"""Arguments of environments, shared by `gymnasium.make`, `make_vec`, runs and the command line."""

import warnings
from collections.abc import Mapping, Sequence
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

    Attributes:
        variant: Variant, its name, or its Gymnasium id, as `SlopeSlider-2-wood`; or the path of a task file, as
            `crate.toml`.
        backend: Name of an installed physics engine.
        parameters: `calibrated`, another parameter set of the task file, or overrides such as
            `{"cube.friction": 0.3}`.
        settings: Numerical settings of the engine that replace those of the preset.
        marker_proxy: Marker proxy of deformable bodies. `material` tracks the material point of the marker between
            nodes; `node` tracks the nearest node, as in the paper.
        drivers: `bundled` moves driven bodies as in the task file, `imported` as in the imported trials. With `action`
            they rest until actions move them, see `gauge_envs.experiments.resolve.moved_by_actions`.
        reference: `bundled` scores against the package's references, `imported` against the imported trials.
        asset: File with the scene in place of the task file: a USD layer for any engine, an MJCF file for `mujoco`. It
            has constants and driven motion; observation and score stay those of the variant.
    """

    variant: str | Variant
    _: KW_ONLY
    backend: str = "mujoco"
    parameters: Parameters = "calibrated"
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
        expected: tuple[tuple[str, type | tuple[type, ...], str], ...] = (
            (
                "variant",
                (str, Variant),
                "a Variant or its name, as 'SlopeSlider-2-wood'",
            ),
            ("backend", str, "the name of a backend, as 'mujoco'"),
            (
                "settings",
                (Mapping, type(None)),
                "a mapping, as {'timestep_s': 1 / 1800}",
            ),
            ("asset", (str, PathLike, type(None)), "the path of a file"),
        )
        for name, types, text in expected:
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

    def rollout(self, experiments: Sequence[Experiment]) -> Rollout:
        """Return the rollout of a new simulation.

        Args:
            experiments: The experiment of each world, which may differ in constants.

        Raises:
            UnsupportedSceneError: The backend cannot build a scene.
            ParameterError: A setting does not exist or has an invalid value.
        """
        return Rollout(
            experiments,
            self.simulation(experiments),
            marker_proxy=self.proxy,
        )

    def simulation(self, experiments: Sequence[Experiment]) -> Simulation:
        """Build a world for each experiment, in one simulation; see `rollout`."""
        distinct = {id(experiment): experiment for experiment in experiments}
        for experiment in distinct.values():
            check_support(experiment, self.backend)
        engine = backend_for(self.backend, experiments[0].model_file)
        scene = experiments[0].scene
        simulation: Simulation
        if all(experiment.scene is scene for experiment in experiments):
            simulation = engine.build_worlds(scene, len(experiments), self.settings)
        else:
            scenes = [experiment.scene for experiment in experiments]
            simulation = LoopedSimulation(
                [engine.build(scene, self.settings) for scene in scenes]
            )
        return in_intervals(simulation, scene)


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
    if not np.abs(numbers).max() <= 1.0:
        raise ActionError(
            f"{name}: action {numbers.tolist()} is out of range: give numbers from -1 to 1"
        )
    return numbers


def check_support(experiment: Experiment, backend: str) -> None:
    """Raise an error if a backend cannot build an experiment."""
    support = support_of(backend, experiment.scene, experiment.model_file)
    if not support:
        raise UnsupportedSceneError(
            _unsupported_message(experiment, backend, support.missing)
        )


def _unsupported_message(
    experiment: Experiment, asked: str, missing: tuple[str, ...]
) -> str:
    able = []
    for name in backend_names():
        try:
            # An engine of another package might crash here and end the run.
            if (
                name != asked
                and is_bundled(name)
                and support_of(name, experiment.scene, experiment.model_file)
            ):
                able.append(name)
        except GaugeError:
            continue
    reasons = "; ".join(missing)
    alternative = (
        f"backend={able[0]!r} can" if able else "no other backend of this package can"
    )
    return (
        f"{experiment.id}: backend {asked!r} cannot build it: {reasons}; {alternative}"
    )


# --- environments without a reward ---

CALLER = 4
"""Frames from the warning to the caller of `gymnasium.make`: this module, the entry point, `make`, the caller."""

_warned: set[str] = set()


def warn_without_reward(experiment: Experiment, band: Band | None) -> None:
    """Warn, once for each id, that an environment has no reward, none after some frame, or no score.

    Args:
        experiment: The experiment of the environment.
        band: Its reference.
    """
    if experiment.id in _warned:
        return
    message = _missing_reward(experiment, band)
    if message:
        warnings.warn(message, NoRewardWarning, stacklevel=CALLER)
        _warned.add(experiment.id)


def warn_without_effect(experiment: Experiment) -> None:
    """Warn, once for each text, that a restitution of the user has no effect."""
    text = experiment.unused_restitution
    if text and text not in _warned:
        warnings.warn(text, stacklevel=CALLER)
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
