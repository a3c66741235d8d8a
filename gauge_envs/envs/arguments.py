"""Arguments of environments: their declaration, checks, plain form for a spec, and the starts of episodes."""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, asdict, dataclass, fields, replace
from enum import Enum
from os import PathLike, fspath
from typing import Any, Literal, TypedDict

import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec

from gauge_envs.backends.registry import backend_names, is_bundled, support_of
from gauge_envs.errors import (
    ActionError,
    GaugeError,
    NoRewardWarning,
    ParameterError,
    UnsupportedSceneError,
    chosen,
    nearest,
)
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment, shots_of, with_trial
from gauge_envs.experiments.scene_builder import Parameters
from gauge_envs.experiments.variants import Variant, user_variants
from gauge_envs.observables.kinds import Observable
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.references.band import Band
from gauge_envs.references.user_data import DataSource, has_import
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.jitter import Jitter, scattered
from gauge_envs.scene.scene import Scene
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.reference import reference_band


@dataclass(frozen=True)
class EnvArguments:
    """Arguments of `gymnasium.make`: which experiment runs, on which engine, and what scores it.

    Attributes:
        variant: Variant, its name, or its Gymnasium id, as `SlopeSlider-2-wood`; or the path of a task file, as
            `crate.toml`.
        backend: Name of an installed physics engine.
        parameters: `calibrated`, another parameter set of the task file, or overrides such as
            `{"cube.friction": 0.3}`.
        settings: Numerical settings of the engine that replace those of the preset.
        marker_proxy: Marker proxy of deformable bodies. `material` tracks the marker's own material point between
            the nodes; `node` tracks the nearest node, as in the paper.
        drivers: `bundled` moves driven bodies as the task file states, `imported` as the imported trials show. With
            `action` they rest until actions move them, see `gauge_envs.experiments.resolve.moved_by_actions`.
        reference: `bundled` scores against the package's references, `imported` against the imported trials.
        asset: File that states the scene in place of the task file: a USD layer for any engine, an MJCF file for
            `mujoco`. It states constants and driven motion; observation and score stay the variant's.
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

    def band(self, experiment: Experiment) -> Band | None:
        """Return the band that an experiment is scored against, or None if it has no reference."""
        return reference_band(experiment)

    def unread(self, experiment: Experiment) -> dict[str, str]:
        """Return why arguments would change nothing, by their names; runs of many ids may have such.

        Args:
            experiment: The experiment that `experiment` returns.
        """
        reasons = {}
        observable = experiment.score.observable
        if self.proxy is MarkerProxy.NODE and observable is Observable.POSITION:
            reasons["marker_proxy"] = "only rigid bodies are observed"
        if self.drivers != experiment.drivers:
            reasons["drivers"] = (
                "it has no driven body"
                if self.drivers == DataSource.ACTION
                else "its imported trials show no driven body"
            )
        return reasons

    def check_read(self, experiment: Experiment) -> None:
        """Raise an error for an argument that would change nothing.

        Args:
            experiment: The experiment that `experiment` returns.
        """
        for name, reason in self.unread(experiment).items():
            raise ParameterError(
                f"{experiment.id}: {name}={getattr(self, name)!r} would change nothing: {reason}"
            )


class EnvKeywords(TypedDict, total=False):
    """Keywords of `EnvArguments` for the signatures of environments; editors and type checkers read them."""

    backend: str
    parameters: Parameters
    settings: Mapping[str, Any] | None
    marker_proxy: MarkerProxy | str
    drivers: DataSource | str
    reference: DataSource | str
    asset: str | PathLike[str] | None


def plain_spec(spec: EnvSpec | None) -> EnvSpec | None:
    """Return a copy of a spec whose arguments `EnvSpec.to_json` accepts."""
    if spec is None:
        return None
    return replace(
        spec, kwargs={name: _plain(name, value) for name, value in spec.kwargs.items()}
    )


def _plain(name: str, value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(f"{name}[{key!r}]", entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        entries = [_plain(name, entry) for entry in value]
        return tuple(entries) if isinstance(value, tuple) else entries
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, PathLike):
        return fspath(value)
    if isinstance(value, Jitter):
        return asdict(value)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise ParameterError(
        f"argument {name} = {value!r} cannot be stored in the spec of an environment. "
        "Give numbers, text, paths, or lists and mappings of them."
    )


def check_episode_steps(asked: int | None, steps: int) -> None:
    """Raise an error if worlds that step together are to end after other steps than their episode has.

    Args:
        asked: `max_episode_steps` of `gymnasium.make_vec`; None for those of the episode.
        steps: Steps of the episode.
    """
    if asked not in (None, steps):
        raise ParameterError(
            f"max_episode_steps is {asked!r}, and the episode has {steps} steps: worlds that step together end with "
            "it; vectorization_mode='sync' cuts episodes, which then have no score"
        )


NO_RATES = np.zeros(0)


def checked_action(action: Any, space: spaces.Space[Any]) -> FloatArray:
    """Return an action as numbers, shape [action_size], or raise an `ActionError`.

    Args:
        action: The action.
        space: A Box from -1 to 1, or `Discrete(1)`, whose only action has no numbers.
    """
    if isinstance(space, spaces.Discrete):
        is_zero = isinstance(action, int | np.integer) and action == 0
        if is_zero or (isinstance(action, np.ndarray) and space.contains(action)):
            return NO_RATES
        raise ActionError(
            f"action {action!r}: this experiment has no driven body, so the only action is 0"
        )
    try:
        numbers = np.asarray(action, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ActionError(f"action {action!r} is not an array of numbers") from error
    if numbers.shape != space.shape:
        raise ActionError(f"action has shape {numbers.shape}, expected {space.shape}")
    # A comparison with NaN is false.
    if not (np.abs(numbers) <= 1.0).all():
        raise ActionError(f"action {numbers.tolist()} must hold numbers from -1 to 1")
    return numbers


@dataclass(frozen=True)
class TrialStart:
    """Start of an imported trial.

    Attributes:
        trial: Number of the trial, from 0.
    """

    trial: int

    def to_dict(self) -> dict[str, float]:
        """Return the start for a result."""
        return {"trial": self.trial}


REAL = "real"
"""Scatter of starts as real hands place bodies: the recorded starts of single-shot trials, elsewhere `Jitter()`."""

Scatter = Jitter | bool | str | Mapping[str, float] | None
"""Scatter of starts: `real`, True or a `Jitter`, or its fields as a mapping; None or False for none."""

SEEDS = 2**31
"""Number of seeds that an environment draws from."""


def checked_scatter(
    experiment: Experiment,
    value: Any,
    name: str = "jitter",
    *,
    draw: Callable[..., Scene] = scattered,
) -> Jitter | Literal["real"] | None:
    """Return a scatter of starts that an experiment can have; `real` only for recorded starts.

    Args:
        experiment: The experiment.
        value: A `Scatter`.
        name: Name of the argument, for messages.
        draw: `scattered`, or `jittered` where driven bodies keep their places.
    """
    if value is None or value is False:
        return None
    if value == REAL and shots_of(experiment) is not None:
        return "real"
    if value is True or value == REAL:
        value = Jitter()
    if isinstance(value, Mapping):
        known = [one.name for one in fields(Jitter)]
        unknown = [key for key in value if key not in known]
        if unknown:
            raise ParameterError(f"{name} {unknown[0]!r}: {nearest(unknown[0], known)}")
        value = Jitter(**value)
    if not isinstance(value, Jitter):
        raise ParameterError(
            f"{name} is {value!r}, expected 'real', True, False or a gauge_envs.Jitter"
        )
    moved = draw(experiment.scene, value, seed=0)
    change = _starts_of(moved) - _starts_of(experiment.scene)
    if any(asdict(value).values()) and np.abs(change).max() < ROUNDING:
        raise ParameterError(
            f"{name} {value.to_dict()} would change nothing: it moves no body of {experiment.id}"
        )
    return value


ROUNDING = 1e-12
"""Largest change of a start that comes from rounding [m, 1, m/s and rad/s]."""


def _starts_of(scene: Scene) -> FloatArray:
    """Return positions, orientations and velocities of all bodies at the start, shape [N, 3].

    Among them are displacements and rotations of misplaced driven bodies.
    """
    nowhere = (0.0, 0.0, 0.0)
    starts: list[Any] = []
    for driver in scene.drivers:
        starts += [driver.shift_m or nowhere, driver.turn_rad or nowhere]
    for body in scene.bodies:
        starts += [body.linear_velocity_m_per_s, body.angular_velocity_rad_per_s]
    for one in (*scene.bodies, *scene.deformables):
        starts += [one.pose.position_m, *one.pose.matrix.tolist()]
    return np.array(starts)


class Starts:
    """How the episodes of an environment start: their scatter, and the seeds that draw it.

    The options of a reset hold for the next ones, which an autoreset calls without any, until a reset has a seed or
    options of its own.

    Args:
        experiment: The experiment, without scatter.
        scatter: Scatter of every start without an option.
        draw: As for `checked_scatter`.
    """

    def __init__(
        self,
        experiment: Experiment,
        scatter: Scatter,
        *,
        draw: Callable[..., Scene] = scattered,
    ) -> None:
        self._experiment = experiment
        self._draw = draw
        self._scatter = checked_scatter(experiment, scatter, draw=draw)
        self._options: Mapping[str, Any] = {}
        # The last option and what it is; trainings give the same one at each reset.
        self._checked: tuple[Any, Jitter | Literal["real"] | None] = (None, None)

    def of_reset(
        self, options: Mapping[str, Any] | None, *, seeded: bool
    ) -> Jitter | TrialStart | Literal["real"] | None:
        """Return what draws the start of the next episode; None for the start of the scene.

        Args:
            options: Options of the reset.
            seeded: Whether it has a seed.
        """
        if not isinstance(options, Mapping | None):
            raise ParameterError(
                f"options of reset are {options!r}, expected a mapping, as {{'jitter': True}}"
            )
        is_kept = options is None and not seeded
        stated = self._options if is_kept else dict(options or {})
        start = self._chosen(stated)
        self._options = stated
        return start

    def _chosen(
        self, options: Mapping[str, Any]
    ) -> Jitter | TrialStart | Literal["real"] | None:
        """Return the start that the options of a reset ask for, or that of `scatter` without any."""
        unknown = [repr(key) for key in options if key not in ("jitter", "trial")]
        if unknown:
            raise ParameterError(
                f"reset has only the options 'jitter' and 'trial', got {', '.join(unknown)}"
            )
        trial = options.get("trial")
        if trial is not None:
            if isinstance(trial, bool) or not isinstance(trial, int | np.integer):
                raise ParameterError(
                    f"option 'trial' is {trial!r}, expected the number of a trial, from 0"
                )
            if options.get("jitter"):
                raise ParameterError(
                    "options 'jitter' and 'trial' both state a start: give one of them"
                )
            return TrialStart(int(trial))
        if "jitter" not in options:
            return self._scatter
        value = options["jitter"]
        if isinstance(value, Mapping) or value is not self._checked[0]:
            found = checked_scatter(
                self._experiment, value, "option 'jitter'", draw=self._draw
            )
            self._checked = (value, found)
        return self._checked[1]


def drawn_seed(
    seed: int | None,
    scatter: Jitter | TrialStart | Literal["real"] | None,
    random: np.random.Generator,
) -> int:
    """Return the seed of an episode: the given one; without one a random one where the start scatters, and 0 elsewhere.

    Args:
        seed: Seed of the reset.
        scatter: What draws the start.
        random: Random numbers of the environment, which the last seed started.
    """
    if seed is not None:
        return int(seed)
    if scatter is None or isinstance(scatter, TrialStart):
        return 0
    return int(random.integers(SEEDS))


def jittered_experiment(
    experiment: Experiment,
    jitter: Jitter | TrialStart | None,
    *,
    seed: int,
) -> Experiment:
    """Return an experiment with a start that is moved at random, or with the start of an imported trial.

    Args:
        experiment: The experiment.
        jitter: Standard deviations of the start, or the imported or single-shot trial; None keeps the start.
        seed: Seed of the random numbers.
    """
    if jitter is None:
        return experiment
    if isinstance(jitter, TrialStart) and shots_of(experiment) is not None:
        return with_trial(experiment, jitter.trial)
    if isinstance(jitter, TrialStart):
        from gauge_envs.envs.trial_start import driven_trial, trial_scene

        return driven_trial(experiment, jitter.trial) or replace(
            experiment, scene=trial_scene(experiment, jitter.trial)
        )
    return replace(experiment, scene=scattered(experiment.scene, jitter, seed=seed))


def start_of(
    experiment: Experiment,
    jitter: Jitter | TrialStart | Literal["real"] | None,
    *,
    seed: int,
) -> Jitter | TrialStart | None:
    """Return the start of an episode: what was asked for, else for single-shot trials the one that the seed selects.

    Args:
        experiment: The experiment.
        jitter: Standard deviations or trial that were asked for; None, or `real` for a recorded start.
        seed: Seed of the episode; modulo their number it counts the trials that repeat no other one.
    """
    shots = shots_of(experiment)
    if isinstance(jitter, Jitter | TrialStart) or shots is None:
        assert jitter != REAL, "only single-shot trials have recorded starts"
        return None if isinstance(jitter, str) else jitter
    trials = shots.trials()
    return TrialStart(trials[seed % len(trials)])


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
            # An engine outside this package might crash here and take the run along.
            if (
                name != asked
                and is_bundled(name)
                and support_of(name, experiment.scene, experiment.model_file)
            ):
                able.append(name)
        except GaugeError:
            continue
    reasons = "; ".join(missing)
    others = (
        f"backend={able[0]!r} can" if able else "no other backend of this package can"
    )
    return f"{experiment.id}: backend {asked!r} cannot build it: {reasons}; {others}"


# --- environments without a reward ---

CALLER = 4
"""Frames from the warning to the caller of `gymnasium.make`: this module, the entry point, `make`, the caller."""

_warned: set[str] = set()


def warn_without_reward(experiment: Experiment, band: Band | None) -> None:
    """Warn, once for each id, that an environment has no reward, or none from some frame on.

    Args:
        experiment: The experiment of the environment.
        band: Band that its scores are relative to.
    """
    if experiment.id in _warned:
        return
    if band is None:
        message = _no_reward_message(experiment)
    else:
        known = np.flatnonzero(band.compared.known)
        last = int(known.max(initial=0))
        message = (
            f"{experiment.id}: its {band.kind} reference ends at {last / FRAME_RATE_HZ:.2f} of "
            f"{(experiment.frame_count - 1) / FRAME_RATE_HZ:.2f} s. Later rewards are 0."
        )
        if last >= experiment.frame_count - 1:
            return
    warnings.warn(message, NoRewardWarning, stacklevel=CALLER)
    _warned.add(experiment.id)


def _no_reward_message(experiment: Experiment) -> str:
    """Return what is missing and what to do."""
    missing = f"{experiment.id} has no reference in use, so every reward is 0."
    if experiment.variant in user_variants():
        return (
            f"{missing} Put {experiment.name}.band.toml and .npz beside its task file."
        )
    remedies = [
        "import its real trials with 'gauge data import', then pass reference='imported'"
    ]
    if has_import(experiment.name):
        remedies = ["pass reference='imported', as its real trials are imported"]
    remedies.append("choose an id that 'gauge list --scored' shows")
    return f"{missing} To get one, {'; or '.join(remedies)}."
