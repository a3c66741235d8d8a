"""Replay policies of a control task where they were trained, and in other engines, settings and constants."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import gymnasium
import numpy as np

from gauge_envs.backends.registry import backend
from gauge_envs.errors import GaugeError, ParameterError, PolicyError
from gauge_envs.experiments.experiment import TaskExperiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.scene_builder import Parameters
from gauge_envs.experiments.uncertain import (
    UncertainParameter,
    overrides_at,
    uncertain_parameters,
)
from gauge_envs.tools.control import (
    ControlEnv,
    LimitReport,
    Policy,
    find_control_task,
    play_paid,
)

MOST_SIGMAS = 10.0
"""Largest change of a constant, in standard uncertainties: beyond, no measurement says what a distribution is."""


class WorldKind(StrEnum):
    """What a world changes, compared with the training."""

    TRAINING = "training"
    """Nothing: engine, settings and constants of the training."""
    CONFIGURATION = "configuration"
    """Engine or settings, with the calibrated constants."""
    CONSTANT = "constant"
    """A constant, by a number of its standard uncertainties, and engine or settings."""


@dataclass(frozen=True, kw_only=True)
class ReplayWorld:
    """One configuration in which policies are replayed.

    Attributes:
        name: Name for tables, as `newton` or `newton, cube.friction - 1 sigma`.
        kind: What it changes.
        backend: Name of the engine.
        settings: Settings that replace those of the engine's preset.
        parameters: Parameter set or overrides of constants.
        changed: Name of the constant that it changes; empty for none.
        sigmas: Number of standard uncertainties of that constant.
        source: Origin of the standard uncertainty.
    """

    name: str
    kind: WorldKind
    backend: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    parameters: Parameters = "calibrated"
    changed: str = ""
    sigmas: float = 0.0
    source: str = ""


@dataclass(frozen=True, kw_only=True)
class Replay:
    """One episode of a policy.

    Attributes:
        policy: Name of the policy.
        world: Name of the world.
        start: Number of the start; 0 is the calibrated one.
        reward: Sum of the rewards.
        largest_reward: Largest sum of rewards that the law allows there.
        report: What the policy reached, and what the law allows there.
    """

    policy: str
    world: str
    start: int
    reward: float
    largest_reward: float
    report: LimitReport


@dataclass(frozen=True, kw_only=True)
class Replays:
    """Episodes of all policies in all worlds from all starts.

    Attributes:
        task: Id of the task.
        policies: Names of the policies.
        worlds: The worlds that could be built; the training comes first.
        starts: Number of starts.
        episodes: The episodes.
        left_out: Reason for each world that could not be built or run, by its name.
    """

    task: str
    policies: tuple[str, ...]
    worlds: tuple[ReplayWorld, ...]
    starts: int
    episodes: tuple[Replay, ...]
    left_out: Mapping[str, str]


def make_control_env(task: str, **arguments: Any) -> ControlEnv:
    """Return the environment of a control task without wrappers.

    Args:
        task: Name or Gymnasium id.
        **arguments: Keywords of `ControlEnv`.
    """
    env = gymnasium.make(find_control_task(task).id, **arguments).unwrapped
    assert isinstance(env, ControlEnv)
    return env


def task_uncertainties(env: ControlEnv) -> tuple[UncertainParameter, ...]:
    """Return the uncertain inputs of a control task around its calibrated values.

    Args:
        env: The task, without wrappers.
    """
    assert isinstance(env.experiment, TaskExperiment)
    return uncertain_parameters(load_experiment(env.experiment.variant))


def training_world(
    engine: str = "mujoco",
    settings: Mapping[str, Any] | None = None,
    parameters: Parameters = "calibrated",
) -> ReplayWorld:
    """Return the world of the training."""
    return ReplayWorld(
        name=f"training: {_titled(engine, settings or {})}",
        kind=WorldKind.TRAINING,
        backend=engine,
        settings=settings or {},
        parameters=parameters,
    )


def other_worlds(
    task: str,
    training: ReplayWorld,
    *,
    engines: Sequence[tuple[str, Mapping[str, Any]]],
    sigmas: Sequence[float],
) -> Iterator[ReplayWorld]:
    """Yield worlds that differ from the training: its time step halved, other configurations, other constants.

    Args:
        task: Name or id of the task.
        training: The world of the training.
        engines: Engines with settings that replace those of their presets; each is run with calibrated constants.
        sigmas: Numbers of standard uncertainties, positive; each constant is moved by them in both directions, in each
            of `engines`.
    """
    if any(not 0.0 < number <= MOST_SIGMAS for number in sigmas):
        raise ParameterError(
            f"sigmas are numbers above 0, at most {MOST_SIGMAS:g}; both directions are run for each"
        )
    env = make_control_env(
        task,
        backend=training.backend,
        settings=training.settings or None,
        parameters=training.parameters,
    )
    with closing(env):
        uncertain = [one for one in task_uncertainties(env) if one.direction is None]
        step = env.simulation.settings.get("timestep_s")
    if isinstance(step, float):
        halved = {**training.settings, "timestep_s": 0.5 * step}
        yield ReplayWorld(
            name="training, half the step",
            kind=WorldKind.CONFIGURATION,
            backend=training.backend,
            settings=halved,
            parameters=training.parameters,
        )
    for engine, settings in engines:
        if (engine, dict(settings), "calibrated") != (
            training.backend,
            dict(training.settings),
            training.parameters,
        ):
            yield ReplayWorld(
                name=_titled(engine, settings),
                kind=WorldKind.CONFIGURATION,
                backend=engine,
                settings=settings,
            )
        for number in sigmas:
            for one in uncertain:
                for sign in (-1.0, 1.0):
                    yield ReplayWorld(
                        name=f"{_titled(engine, settings)}, {one.name} {'+' if sign > 0 else '-'} {number:g} sigma",
                        kind=WorldKind.CONSTANT,
                        backend=engine,
                        settings=settings,
                        parameters=overrides_at([one], [sign * number]),
                        changed=one.name,
                        sigmas=sign * number,
                        source=one.source,
                    )


def _titled(engine: str, settings: Mapping[str, Any]) -> str:
    stated = " ".join(f"{key}={value:.4g}" if isinstance(value, float) else f"{key}={value}" for key, value in
                      settings.items())  # fmt: skip
    return f"{engine} {stated}".strip()


def start_overrides(
    env: ControlEnv, count: int, *, seed: int = 0
) -> list[dict[str, Any]]:
    """Return overrides of starts: first the calibrated one, then random ones within the uncertainty of the start.

    Args:
        env: The task, without wrappers.
        count: Number of starts, 1 or more. A task whose start has no stated uncertainty has one start.
        seed: Seed of the random numbers.
    """
    if count < 1:
        raise ParameterError(f"{count} starts: give 1 or more")
    movable = [one for one in task_uncertainties(env) if one.direction is not None]
    if not movable:
        return [{}]
    random = np.random.default_rng(seed)
    return [
        {},
        *(
            overrides_at(movable, random.standard_normal(len(movable)).tolist())
            for _ in range(count - 1)
        ),
    ]


def replay(
    task: str,
    policies: Mapping[str, Policy],
    training: ReplayWorld,
    others: Sequence[ReplayWorld],
    *,
    starts: int = 3,
    seed: int = 0,
    notify: Callable[[str], None] = lambda _: None,
) -> Replays:
    """Replay policies in the world of their training and in others.

    Args:
        task: Name or id of the task.
        policies: Policies by name, checked with the task.
        training: The world of the training.
        others: Other worlds. One that cannot be built or run is left out, with its reason.
        starts: Number of starts in each world; the first is the calibrated one.
        seed: Seed of the other starts.
        notify: Function that gets the name of each world before it runs.
    """
    names = Counter(world.name for world in (training, *others))
    if twice := [name for name, count in names.items() if count > 1]:
        raise ParameterError(
            f"two worlds have the name {twice[0]!r}: state each engine, setting and number of sigmas once"
        )
    for world in others:
        backend(world.backend)
    with closing(_built(task, training, {})) as env:
        placed = start_overrides(env, starts, seed=seed)
    episodes: list[Replay] = []
    ran: list[ReplayWorld] = []
    left_out: dict[str, str] = {}
    for world in (training, *others):
        notify(world.name)
        try:
            episodes += _episodes(task, policies, world, placed)
        except PolicyError:
            raise
        except GaugeError as error:
            if world is training:
                raise
            left_out[world.name] = str(error)
            continue
        ran.append(world)
    return Replays(
        task=find_control_task(task).id,
        policies=tuple(policies),
        worlds=tuple(ran),
        starts=len(placed),
        episodes=tuple(episodes),
        left_out=left_out,
    )


def _episodes(
    task: str,
    policies: Mapping[str, Policy],
    world: ReplayWorld,
    starts: Sequence[Mapping[str, Any]],
) -> list[Replay]:
    found = []
    for number, start in enumerate(starts):
        with closing(_built(task, world, start)) as env:
            for name, policy in policies.items():
                paid, report = play_paid(env, policy, seed=number)
                found.append(
                    Replay(
                        policy=name,
                        world=world.name,
                        start=number,
                        reward=paid,
                        largest_reward=env.largest_reward,
                        report=report,
                    )
                )
    return found


def _built(task: str, world: ReplayWorld, start: Mapping[str, Any]) -> ControlEnv:
    parameters = world.parameters
    if start:
        # A parameter set has a name; its overrides are those of its experiment.
        if isinstance(parameters, str):
            with closing(make_control_env(task, parameters=parameters)) as env:
                parameters = env.experiment.overrides
        parameters = {**parameters, **start}
    return make_control_env(
        task,
        backend=world.backend,
        settings=world.settings or None,
        parameters=parameters,
    )
