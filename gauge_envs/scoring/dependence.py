"""Trials that depend on each other: how much wider an interval is than that of independent ones."""

from __future__ import annotations

import math

import numpy as np

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scoring.numerics import student_quantile

LEVEL = 0.95
"""Coverage of an interval."""

LEAST_TRIALS = 3
"""Number of trials from which their scatter gives an interval."""

LAG_MARGIN = 0.6
"""Standard errors by which the correlation of consecutive trials may be larger than measured."""

GROUPS = 4
"""Number of groups of consecutive trials whose means are compared."""

GROUP_SHARE = 0.75
"""Factor on the width from these means. It is exact with 1; with the margin above, 0.8 holds in the tested worlds."""

WIDEST = 5.0
"""Widening from which on an interval is refused: the trials count as a twenty-fifth of their number."""


def widening(series: FloatArray) -> float:
    """Return by how much an interval is wider than that of independent trials, at least 1.

    It is the larger one of two numbers. The first is the root of (1 + r) / (1 - r), where r is the correlation of
    consecutive trials plus its bias and six tenths of its standard error. The second compares the scatter of the
    means of four consecutive groups with that of single trials. Both are above 1 for most independent trials.

    Args:
        series: Effect of each trial on the score, in recorded order, shape [trial_count].
    """
    count = len(series)
    centred = series - series.mean() if count else series
    square = float(centred @ centred)
    if count < LEAST_TRIALS or square <= 0.0:
        return 1.0
    lag = (
        float(centred[1:] @ centred[:-1]) / square
        + 1.0 / count
        + LAG_MARGIN / math.sqrt(count)
    )
    lag = min(max(lag, 0.0), 0.99)
    wider = math.sqrt((1.0 + lag) / (1.0 - lag))
    if count < 2 * GROUPS:
        return wider
    # The first groups have one trial more, as those of `numpy.array_split`.
    groups = np.arange(GROUPS + 1)
    ends = groups * (count // GROUPS) + np.minimum(groups, count % GROUPS)
    means = np.add.reduceat(centred, ends[:-1]) / np.diff(ends)
    tail = 0.5 * (1.0 + LEVEL)
    grouped = float(means.std(ddof=1)) / math.sqrt(GROUPS)
    grouped *= student_quantile(GROUPS - 1, tail)
    single = math.sqrt(square / (count * (count - 1)))
    single *= student_quantile(count - 1, tail)
    return max(wider, GROUP_SHARE * grouped / single)


def refusal(series: FloatArray) -> str | None:
    """Return why a score has no interval; None if it has one.

    Args:
        series: Effect of each trial on the score, in recorded order, shape [trial_count]; empty without single trials.
    """
    if 0 < len(series) < LEAST_TRIALS:
        return f"{len(series)} trials: an interval needs at least {LEAST_TRIALS}"
    if widening(series) > WIDEST:
        return "consecutive trials are alike: they are too few independent ones for an interval of this score"
    return None
