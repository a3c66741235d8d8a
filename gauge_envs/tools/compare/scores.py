"""The metrics that comparisons show, and their mean and scatter over repeats."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from gauge_envs.errors import UnknownNameError
from gauge_envs.evaluation.uncertainty import LEVEL
from gauge_envs.references.metrics import METRICS


@dataclass(frozen=True, kw_only=True)
class ComparedMetric:
    """A column of a comparison: a metric of the benchmark, or the aligned RMSE.

    Attributes:
        raw: Attribute of `Score` with the value in its unit.
        normalized: Attribute of `Score` with the value over the mean of the real trials; None if it has none.
        published: Key of `published_baselines`; None if it was not published.
        unit: Unit; None is that of the observable.
        interval: Attribute of `Score` with the 95 % interval of the normalized value; None if it has none.
        percentile: Attribute of `Score` with the percentage of real trials that are closer; None if it has none.
        is_event: Whether it measures an event, without the mean trajectory of a reference.
    """

    raw: str
    normalized: str | None
    published: str | None
    unit: str | None = None
    interval: str | None = None
    percentile: str | None = None
    is_event: bool = False


def _compared_metrics() -> dict[str, ComparedMetric]:
    columns: dict[str, ComparedMetric] = {}
    for key, metric in METRICS.items():
        if metric.is_event and "rmse_aligned" not in columns:
            columns["rmse_aligned"] = ComparedMetric(
                raw="rmse_aligned",
                normalized="rmse_aligned_normalized",
                published=None,
                interval="rmse_aligned_normalized_95",
                percentile="percentile_aligned",
            )
        columns[key] = ComparedMetric(
            raw=metric.score_field,
            normalized=metric.normalized_field,
            published=key,
            unit=metric.unit,
            interval=f"{metric.normalized_field}_95" if metric.is_normalized else None,
            percentile="percentile" if key == "rmse" else None,
            is_event=metric.is_event,
        )
    return columns


COMPARED_METRICS: Mapping[str, ComparedMetric] = _compared_metrics()
"""Compared metrics by name, in the order of tables: the aligned RMSE follows the metrics that need a band."""


def check_metrics(names: Iterable[str]) -> tuple[str, ...]:
    """Return names of metrics without repetition, or all metrics if none is given."""
    chosen = tuple(dict.fromkeys(names))
    for name in chosen:
        if name not in COMPARED_METRICS:
            raise UnknownNameError("metric", name, COMPARED_METRICS)
    return chosen or tuple(COMPARED_METRICS)


@dataclass(frozen=True, kw_only=True)
class ScoreSpread:
    """Mean and scatter of repeats.

    Attributes:
        mean: Mean.
        std: Sample standard deviation (n - 1); None for a single value.
        count: Number of values.
    """

    mean: float
    std: float | None
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> ScoreSpread | None:
        """Return the spread of values, or None if there are none."""
        if not values:
            return None
        std = float(np.std(values, ddof=1)) if len(values) > 1 else None
        return cls(mean=float(np.mean(values)), std=std, count=len(values))


def repeats_interval(values: Sequence[float], intervals: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return the 95 % interval of the mean of normalized scores over repeats.

    Two things are random. The repeats share the sample of real trials and the uncertain inputs, so the mean of their
    intervals is that of their mean. Each repeat has a start of its own, so the mean of a few has a standard error,
    which Student's t makes an interval. The two are independent, and their widths add in quadrature on each side.

    Args:
        values: Score of each repeat, at least one.
        intervals: 95 % interval of each score.
    """
    spread = ScoreSpread.of(values)
    assert spread is not None
    low, high = np.mean(intervals, axis=0)
    half = 0.0
    if spread.std:
        half = float(student.ppf(0.5 * (1.0 + LEVEL), spread.count - 1)) * spread.std / math.sqrt(spread.count)
    below, above = math.hypot(spread.mean - low, half), math.hypot(high - spread.mean, half)
    return max(spread.mean - below, 0.0), spread.mean + above
