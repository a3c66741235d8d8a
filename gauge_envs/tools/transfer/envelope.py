"""Run an experiment or a control task at many points of its measured uncertainty, and sum up what it does."""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, qmc, rankdata

from gauge_envs.envs.vector import GaugeVectorEnv
from gauge_envs.errors import ParameterError
from gauge_envs.evaluation.reference import band_grade
from gauge_envs.experiments.experiment import TaskExperiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.uncertain import (
    UncertainParameter,
    overrides_at,
    uncertain_parameters,
)
from gauge_envs.references.grades import BandGrade
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.control import ControlWorlds, LimitReport, Policy
from gauge_envs.tools.transfer.policy_replays import (
    make_control_env,
    task_uncertainties,
)

LARGEST_SAMPLE_COUNT = 2**16


@dataclass(frozen=True, kw_only=True)
class LawPolicy:
    """The law's own policy.

    Attributes:
        fraction: Share of the law's limit that it uses.
        informed: Whether it knows the constants of each world. Otherwise it takes the actions that it takes with the
            calibrated constants.
    """

    fraction: float = 0.95
    informed: bool = False

    def __post_init__(self) -> None:
        # A comparison with NaN is false.
        if not 0.0 <= self.fraction < math.inf:
            raise ParameterError(
                f"fraction is {self.fraction:g}, expected a finite share of the limit from 0"
            )

    @property
    def title(self) -> str:
        """Description for reports."""
        knows = (
            "knows the constants"
            if self.informed
            else "with its actions for the calibrated constants"
        )
        return f"the law's policy at {self.fraction:g} of the limit, {knows}"


@dataclass(frozen=True, eq=False, kw_only=True)
class Envelope:
    """A quantity at points of the measured uncertainty.

    Attributes:
        id: Gymnasium id.
        backend: Name of the engine.
        quantity: Name of the quantity: `reward`, `normalized RMSE`, `RMSE`, `RMSE from the law` or `deviation`.
        unit: Its unit; `1` for a ratio.
        policy: What acted.
        parameters: The uncertain parameters.
        sigmas: Points, in standard uncertainties, shape [n, len(parameters)].
        values: The quantity at the points, shape [n]; NaN where an episode diverged.
        calibrated: The quantity at the calibrated values.
        endings: Ending of each episode of a control task; `complete` or `diverged` for an experiment.
        calibrated_ending: Ending at the calibrated values.
        ratios: What was reached over what the law allows at the point, shape [n]; None for an experiment.
    """

    id: str
    backend: str
    quantity: str
    unit: str
    policy: str
    parameters: tuple[UncertainParameter, ...]
    sigmas: FloatArray
    values: FloatArray
    calibrated: float
    endings: tuple[str, ...]
    calibrated_ending: str
    ratios: FloatArray | None = None


def sobol_sigmas(count: int, dimensions: int, *, seed: int = 0) -> FloatArray:
    """Return normally distributed points of a scrambled Sobol sequence, shape [count, dimensions].

    Args:
        count: Number of points, a power of 2.
        dimensions: Number of coordinates.
        seed: Seed of the scrambling.
    """
    if not 2 <= count <= LARGEST_SAMPLE_COUNT or count & (count - 1):
        raise ParameterError(
            f"{count} samples: a Sobol sequence needs a power of 2 from 2 to {LARGEST_SAMPLE_COUNT}"
        )
    uniform = qmc.Sobol(dimensions, scramble=True, rng=seed).random(count)
    # A scrambled point may lie on the border of the cube, where the normal distribution is infinite.
    return np.asarray(norm.ppf(np.clip(uniform, 0.5 / count, 1.0 - 0.5 / count)))


def experiment_envelope(
    variant: str,
    *,
    samples: int = 256,
    backend: str = "mujoco",
    settings: Mapping[str, Any] | None = None,
    seed: int = 0,
    batch: int = 256,
    notify: Callable[[int], None] = lambda _: None,
) -> Envelope:
    """Run an experiment at points of its uncertainty, in a vector environment whose worlds have the constants.

    The quantity is the normalized RMSE where the experiment has a band of reality, the RMSE from its law or from its
    first trial where each trial has a start of its own, and otherwise the root mean square distance of g(t) from that
    of the calibrated values.

    Args:
        variant: Variant or id.
        samples: Number of points, a power of 2.
        backend: Name of the engine.
        settings: Settings that replace those of the preset.
        seed: Seed of the points.
        batch: Number of worlds in one vector environment.
        notify: Function that gets the number of points that are done.
    """
    experiment = load_experiment(variant)
    parameters = uncertain_parameters(experiment)
    sigmas = _points(experiment.id, parameters, samples, seed)
    common: dict[str, Any] = {"backend": backend, "settings": settings}
    ((calibrated, path),) = _batch(experiment, [{}], **common)
    assert path is not None
    grade = band_grade(experiment.name)
    # The solution of the calibrated scene is no reference for other constants.
    is_scored = calibrated is not None and grade is not BandGrade.MODEL
    values: list[float] = []
    endings: list[str] = []
    for first in range(0, samples, _checked_batch(batch)):
        rows = sigmas[first : first + batch]
        for score, frames in _batch(
            experiment,
            [overrides_at(parameters, row.tolist()) for row in rows],
            **common,
        ):
            endings.append("diverged" if frames is None else "complete")
            if frames is None:
                values.append(np.nan)
            elif is_scored:
                values.append(np.nan if score is None else score)
            else:
                values.append(
                    float(np.sqrt(np.mean(np.sum((frames - path) ** 2, axis=1))))
                )
        notify(len(values))
    quantity, unit = "deviation", experiment.score.observable.unit
    if is_scored and grade is BandGrade.LAW:
        quantity = "RMSE from the law"
    elif is_scored and experiment.trial is None:
        quantity, unit = "normalized RMSE", "1"
    elif is_scored:
        quantity = "RMSE"
    return Envelope(
        id=experiment.id,
        backend=backend,
        quantity=quantity,
        unit=unit,
        policy="none",
        parameters=parameters,
        sigmas=sigmas,
        values=np.array(values),
        calibrated=calibrated if is_scored and calibrated is not None else 0.0,
        endings=tuple(endings),
        calibrated_ending="complete",
    )


def _batch(
    experiment: TaskExperiment,
    parameters: Sequence[Mapping[str, Any]],
    **arguments: Any,
) -> list[tuple[float | None, FloatArray | None]]:
    """Run an experiment with some parameters; return the score and the frames of each, None for what it lacks."""
    envs = GaugeVectorEnv(
        experiment.variant,
        num_envs=len(parameters),
        world_parameters=parameters,
        **arguments,
    )
    try:
        envs.reset(
            seed=0,
            options=None if experiment.trial is None else {"trial": experiment.trial},
        )
        actions = np.zeros(envs.action_space.shape or 0, dtype=envs.action_space.dtype)
        over = np.zeros(len(parameters), dtype=np.bool_)
        while not over.all():
            _, _, terminations, truncations, _ = envs.step(actions)
            over |= terminations | truncations
        found = []
        for score, episode in zip(envs.scores(), envs.episodes, strict=True):
            distance = None
            if score is not None:
                real = score.validation if experiment.trial is None else None
                distance = score.rmse if real is None else real.rmse_normalized
            found.append(
                (
                    distance,
                    None if episode.fault is not None else episode.trajectory().frames,
                )
            )
        return found
    finally:
        envs.close()


def control_envelope(
    task: str,
    *,
    policy: Policy | LawPolicy | None = None,
    samples: int = 256,
    backend: str = "mujoco",
    settings: Mapping[str, Any] | None = None,
    seed: int = 0,
    batch: int = 256,
    notify: Callable[[int], None] = lambda _: None,
) -> Envelope:
    """Run a control task at points of its uncertainty, many worlds at a time; the quantity is an episode's reward.

    All episodes have the seed 0, and so the same goal.

    Args:
        task: Name or id of the task.
        policy: Policy, checked with the task, or the law's; None for `LawPolicy()`.
        samples: Number of points, a power of 2.
        backend: Name of the engine.
        settings: Settings that replace those of the preset.
        seed: Seed of the points.
        batch: Number of worlds at a time, which bounds the memory.
        notify: Function that gets the number of points that are done.
    """
    policy = policy or LawPolicy()

    with closing(make_control_env(task, backend=backend, settings=settings)) as env:
        parameters = task_uncertainties(env)
    sigmas = _points(f"GAUGE/{task.removeprefix('GAUGE/')}", parameters, samples, seed)
    with closing(
        ControlWorlds(task, [{}], backend=backend, settings=settings)
    ) as worlds:
        (calibrated,) = _episodes(worlds, _acting(worlds, policy))
    found: list[_Played] = []
    for first in range(0, samples, _checked_batch(batch)):
        constants = [
            overrides_at(parameters, row.tolist())
            for row in sigmas[first : first + batch]
        ]
        with closing(
            ControlWorlds(task, constants, backend=backend, settings=settings)
        ) as worlds:
            is_blind = isinstance(policy, LawPolicy) and not policy.informed
            found += _episodes(
                worlds,
                _repeating(calibrated.actions) if is_blind else _acting(worlds, policy),
            )
        notify(len(found))
    return Envelope(
        id=f"GAUGE/{task.removeprefix('GAUGE/')}",
        backend=backend,
        quantity="reward",
        unit="1",
        policy=policy.title if isinstance(policy, LawPolicy) else "given policy",
        parameters=parameters,
        sigmas=sigmas,
        values=np.array([one.reward for one in found]),
        calibrated=calibrated.reward,
        endings=tuple(one.report.ending.value for one in found),
        calibrated_ending=calibrated.report.ending.value,
        ratios=np.array([one.report.ratio for one in found]),
    )


def _points(
    name: str, parameters: Sequence[UncertainParameter], samples: int, seed: int
) -> FloatArray:
    if not parameters:
        raise ParameterError(
            f"{name} has no uncertain parameter with a stated uncertainty"
        )
    return sobol_sigmas(samples, len(parameters), seed=seed)


def _checked_batch(batch: int) -> int:
    if batch < 1:
        raise ParameterError(f"{batch} worlds in a batch: give 1 or more")
    return batch


Act = Callable[[int, int, FloatArray], NDArray[np.floating]]
"""Action of a world, by its number, for the number of a frame and the observation."""


@dataclass(frozen=True)
class _Played:
    """An episode: the sum of its rewards, its report, and its actions."""

    reward: float
    report: LimitReport
    actions: Sequence[NDArray[np.floating]]


def _episodes(worlds: ControlWorlds, act: Act) -> list[_Played]:
    """Run an episode in each world."""
    count = len(worlds.envs)
    begun = worlds.begin(dict.fromkeys(range(count), 0))
    observations = {number: observation for number, (observation, _) in begun.items()}
    rewards = [0.0] * count
    actions: list[list[NDArray[np.floating]]] = [[] for _ in range(count)]
    while observations:
        for number, observation in observations.items():
            actions[number].append(act(number, len(actions[number]), observation))
        steps = worlds.step({number: actions[number][-1] for number in observations})
        observations = {}
        for number, (observation, reward, terminated, truncated, _) in steps.items():
            rewards[number] += reward
            if not (terminated or truncated):
                observations[number] = observation
    return [
        _Played(rewards[number], env.report(), actions[number])
        for number, env in enumerate(worlds.envs)
    ]


def _acting(worlds: ControlWorlds, policy: Policy | LawPolicy) -> Act:
    """Return a policy, or that of the law with the constants of each world."""
    if isinstance(policy, LawPolicy):
        return lambda number, _, __: worlds.envs[number].law_action(policy.fraction)
    return lambda _, __, observation: policy(observation)


def _repeating(actions: Sequence[NDArray[np.floating]]) -> Act:
    """Return the actions of another episode, and zero after its end."""
    none = np.zeros_like(actions[-1])
    return lambda _, frame, __: actions[frame] if frame < len(actions) else none


# --- statistics ------------------------------------------------------------------------------------------------------

ROUNDING = 1e-9
"""Relative differences below it are rounding."""

QUANTILES = (0.025, 0.5, 0.975)


@dataclass(frozen=True, kw_only=True)
class ParameterEffect:
    """What one parameter does.

    Attributes:
        parameter: The parameter.
        rank_correlation: Spearman's correlation of parameter and quantity, -1 to 1.
        per_sigma: Slope of the quantity in a linear fit of all parameters, for one standard uncertainty.
    """

    parameter: UncertainParameter
    rank_correlation: float
    per_sigma: float


@dataclass(frozen=True, kw_only=True)
class EnvelopeReport:
    """Distribution of a quantity over the measured uncertainty.

    Attributes:
        id: Gymnasium id.
        backend: Name of the engine.
        quantity: Name of the quantity.
        unit: Its unit.
        policy: What acted.
        samples: Number of points.
        calibrated: The quantity at the calibrated values.
        low: Its 2.5 % quantile.
        median: Its median.
        high: Its 97.5 % quantile.
        endings: Number of episodes by their ending.
        as_calibrated: Share of the episodes that end as the one with the calibrated values.
        largest_ratio: Largest ratio of what was reached to what the law allows; None for an experiment.
        effects: The parameters, the most important first.
    """

    id: str
    backend: str
    quantity: str
    unit: str
    policy: str
    samples: int
    calibrated: float
    low: float
    median: float
    high: float
    endings: Mapping[str, int]
    as_calibrated: float
    largest_ratio: float | None
    effects: tuple[ParameterEffect, ...]


def envelope_report(envelope: Envelope) -> EnvelopeReport:
    """Return the distribution of the quantity and the effect of each parameter.

    Points where an episode diverged count among the endings alone.
    """
    known = np.isfinite(envelope.values)
    values, sigmas = envelope.values[known], envelope.sigmas[known]
    if len(values) < 2:
        raise ParameterError(
            f"{envelope.id}: {len(values)} of {len(known)} episodes have a value"
        )
    low, median, high = np.quantile(values, QUANTILES).tolist()
    design = np.column_stack([np.ones(len(values)), sigmas])
    slopes = np.linalg.lstsq(design, values, rcond=None)[0][1:]
    effects = [
        ParameterEffect(
            parameter=parameter,
            rank_correlation=_spearman(column, values),
            per_sigma=float(slope),
        )
        for parameter, column, slope in zip(
            envelope.parameters, sigmas.T, slopes, strict=True
        )
    ]
    same = sum(ending == envelope.calibrated_ending for ending in envelope.endings)
    shared = ("id", "backend", "quantity", "unit", "policy", "calibrated")
    return EnvelopeReport(
        **{name: getattr(envelope, name) for name in shared},
        samples=len(envelope.values),
        low=low,
        median=median,
        high=high,
        endings=dict(Counter(envelope.endings)),
        as_calibrated=same / len(envelope.endings),
        largest_ratio=None if envelope.ratios is None else float(envelope.ratios.max()),
        effects=tuple(sorted(effects, key=lambda one: -abs(one.rank_correlation))),
    )


def is_constant(values: FloatArray) -> bool:
    """Return whether values differ by rounding alone."""
    return float(np.ptp(values)) <= ROUNDING * float(np.abs(values).max())


def _spearman(column: FloatArray, values: FloatArray) -> float:
    """Return the rank correlation; 0 for a quantity that is the same everywhere."""
    if is_constant(values):
        return 0.0
    return float(np.corrcoef(rankdata(column), rankdata(values))[0, 1])
