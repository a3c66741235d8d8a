"""What the measured uncertainty of constants does to a reward or a score."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from gauge_envs.errors import ParameterError
from gauge_envs.experiments.uncertain import UncertainParameter
from gauge_envs.tools.transfer.envelope import Envelope

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
        raise ParameterError(f"{envelope.id}: {len(values)} of {len(known)} episodes have a value")
    low, median, high = np.quantile(values, QUANTILES).tolist()
    design = np.column_stack([np.ones(len(values)), sigmas])
    slopes = np.linalg.lstsq(design, values, rcond=None)[0][1:]
    effects = [
        ParameterEffect(parameter=parameter, rank_correlation=_spearman(column, values), per_sigma=float(slope))
        for parameter, column, slope in zip(envelope.parameters, sigmas.T, slopes, strict=True)
    ]
    same = sum(ending == envelope.calibrated_ending for ending in envelope.endings)
    return EnvelopeReport(
        id=envelope.id,
        backend=envelope.backend,
        quantity=envelope.quantity,
        unit=envelope.unit,
        policy=envelope.policy,
        samples=len(envelope.values),
        calibrated=envelope.calibrated,
        low=low,
        median=median,
        high=high,
        endings=dict(Counter(envelope.endings)),
        as_calibrated=same / len(envelope.endings),
        largest_ratio=None if envelope.ratios is None else float(envelope.ratios.max()),
        effects=tuple(sorted(effects, key=lambda one: -abs(one.rank_correlation))),
    )


def is_constant(values: NDArray[np.float64]) -> bool:
    """Return whether values differ by rounding alone."""
    return float(np.ptp(values)) <= ROUNDING * float(np.abs(values).max())


def _spearman(column: NDArray[np.float64], values: NDArray[np.float64]) -> float:
    """Return the rank correlation; 0 for a quantity that is the same everywhere."""
    if is_constant(values):
        return 0.0
    return float(np.corrcoef(rankdata(column), rankdata(values))[0, 1])
