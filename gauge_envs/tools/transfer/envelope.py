"""Run an experiment at many points of its measured uncertainty, and sum up what it does."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
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

LARGEST_SAMPLE_COUNT = 2**16


@dataclass(frozen=True, eq=False, kw_only=True)
class Envelope:
    """A quantity at points of the measured uncertainty.

    Attributes:
        id: Gymnasium id.
        backend: Name of the engine.
        quantity: Name of the quantity: `normalized RMSE`, `RMSE`, `RMSE from the law` or `deviation`.
        unit: Its unit; `1` for a ratio.
        parameters: The uncertain parameters.
        sigmas: Points, in standard uncertainties, shape [n, len(parameters)].
        values: The quantity at the points, shape [n]; NaN where an episode diverged.
        calibrated: The quantity at the calibrated values.
    """

    id: str
    backend: str
    quantity: str
    unit: str
    parameters: tuple[UncertainParameter, ...]
    sigmas: FloatArray
    values: FloatArray
    calibrated: float


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
    for first in range(0, samples, _checked_batch(batch)):
        rows = sigmas[first : first + batch]
        for score, frames in _batch(
            experiment,
            [overrides_at(parameters, row.tolist()) for row in rows],
            **common,
        ):
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
        parameters=parameters,
        sigmas=sigmas,
        values=np.array(values),
        calibrated=calibrated if is_scored and calibrated is not None else 0.0,
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
        samples: Number of points.
        calibrated: The quantity at the calibrated values.
        low: Its 2.5 % quantile.
        median: Its median.
        high: Its 97.5 % quantile.
        diverged: Number of points at which the engine diverged.
        effects: The parameters, the most important first.
    """

    id: str
    backend: str
    quantity: str
    unit: str
    samples: int
    calibrated: float
    low: float
    median: float
    high: float
    diverged: int
    effects: tuple[ParameterEffect, ...]


def envelope_report(envelope: Envelope) -> EnvelopeReport:
    """Return the distribution of the quantity and the effect of each parameter.

    Points where an episode diverged have no value.
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
    shared = ("id", "backend", "quantity", "unit", "calibrated")
    return EnvelopeReport(
        **{name: getattr(envelope, name) for name in shared},
        samples=len(envelope.values),
        low=low,
        median=median,
        high=high,
        diverged=int((~known).sum()),
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
