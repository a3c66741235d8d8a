"""Mean and scatter of scores over repeats."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from gauge_envs.evaluation.uncertainty import LEVEL


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
