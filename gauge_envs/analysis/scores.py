"""The metrics that comparisons show, and their mean and scatter over repeats."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gauge_envs.errors import UnknownNameError

__all__ = [
    "METRICS",
    "Metric",
    "ScoreSpread",
    "check_metrics",
]


@dataclass(frozen=True, kw_only=True)
class Metric:
    """A metric of `Score`.

    Attributes:
        raw: Attribute of the value in its unit.
        normalized: Attribute of the value over the mean of the real trials; None if the metric has none.
        published: Key of `published_baselines`; None if it was not published.
        unit: Unit; None is that of the observable.
    """

    raw: str
    normalized: str | None
    published: str | None
    unit: str | None = None


METRICS: Mapping[str, Metric] = {
    "rmse": Metric(raw="rmse", normalized="rmse_normalized", published="rmse"),
    "dtw": Metric(raw="dtw", normalized="dtw_normalized", published="dtw"),
    "rmse_aligned": Metric(raw="rmse_aligned", normalized="rmse_aligned_normalized", published=None),
    "lsd": Metric(raw="lsd_s", normalized="lsd_normalized", published="lsd", unit="s"),
    "mte": Metric(raw="mte", normalized="mte_normalized", published="mte", unit="1"),
    "pd": Metric(raw="pd_s", normalized="pd_normalized", published="pd", unit="s"),
    "el": Metric(raw="el", normalized=None, published="el", unit="1"),
}
"""Metrics by name, in the order of tables. `el` has no normalized value: its ideal is 0."""


def check_metrics(names: Iterable[str]) -> tuple[str, ...]:
    """Return names of metrics without repetition, or all metrics if none is given.

    Raises:
        UnknownNameError: A name is not that of a metric.
    """
    chosen = tuple(dict.fromkeys(names))
    for name in chosen:
        if name not in METRICS:
            raise UnknownNameError("metric", name, METRICS)
    return chosen or tuple(METRICS)


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
