"""95 % intervals of the distance between a simulation and the mean of infinitely many real trials.

The observed deviation is the true deviation plus the error e of the mean of N trials. S is the covariance of e. On
average, the square of the observed distance d exceeds the square of the true distance D by tr(S). Its variance is
4 D^2 h'Sh + 2 tr(S^2) with the unit deviation h. The interval holds each D whose square is less than t standard
deviations from d^2 - tr(S) (Wilson's interval). Student's t has N - 1 degrees of freedom or fewer. At D = 0,
(t^2 - 1)^2 tr(S^2) replaces 2 t^2 tr(S^2). So an error with one direction excludes D = 0 as Student's test does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gauge_envs.scene.geometry import FloatArray, length_of

COVERAGE_FACTOR = 1.96
"""Half width of a 95 % interval over the standard uncertainty."""

MIN_PREDICTING_TRIALS = 5
"""Smallest number of real trials whose scatter predicts the distance of one more."""


def student_t(freedom: float, coverage: float = 0.95) -> float:
    """Return the distance from 0 within which Student's t is with a probability.

    Args:
        freedom: Degrees of freedom.
        coverage: The probability.
    """
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.5 + 0.5 * coverage))


SKEWNESS_FACTOR = 1.5
"""Skewness of an exponential population, divided by the mean skewness of its samples of 20 values.

A half-normal population has 1.3, and a lognormal one 2.4."""

ONE_SIDED = 0.9
"""Coverage of an interval on both sides with 5 % of the values above it, where none count as too small."""


def student_limit(count: int, coverage: float = 0.95) -> float:
    """Return the limit of one more value, in standard deviations of `count` values from their mean.

    Args:
        count: Number of values, at least two.
        coverage: Probability of a value within the limit on both sides.
    """
    return student_t(count - 1, coverage) * math.sqrt(1.0 + 1.0 / count)


def distance_interval(distance: float, uncertainty: float) -> tuple[float, float]:
    """Return the interval of a distance from a reference with a standard uncertainty, all in one unit."""
    half = COVERAGE_FACTOR * uncertainty
    return max(distance - half, 0.0), distance + half


def ratio_interval(
    ratio: float,
    relative: FloatArray,
    half_widths: tuple[float, float],
    correlation: float = 0.0,
) -> tuple[float, float]:
    """Return the 95 % interval of a distance over the mean distance of real trials.

    Errors of the logarithms of both add. A correlation widens the interval if it is negative: an outlier among the
    trials makes their mean distance larger, and moves their mean.

    Args:
        ratio: The distance over the mean distance.
        relative: 95 % interval of the distance, over the distance.
        half_widths: The 95 % interval of the logarithm of the mean distance, below and above its value.
        correlation: Correlation between the errors of both logarithms.
    """

    def half_with(of_distance: float, of_mean: float) -> float:
        product = 2.0 * correlation * of_distance * of_mean
        return math.sqrt(max(of_distance**2 + of_mean**2 - product, 0.0))

    low, high = map(float, relative)
    below, above = half_widths
    largest = ratio * math.exp(half_with(math.log(high), below))
    if low <= 0.0:
        return 0.0, largest
    return ratio / math.exp(half_with(-math.log(low), above)), largest


def jackknife_interval(
    ratio: float, relative: FloatArray, *, baselines: FloatArray, distances: FloatArray
) -> tuple[float, float]:
    """Return `ratio_interval` of a distance and a mean distance from the same trials, by the jackknife.

    Args:
        ratio: The distance over the mean distance.
        relative: 95 % interval of the distance, over the distance.
        baselines: Mean distance of the trials without each of them, shape [N].
        distances: The distance without each trial, shape [N].
    """
    count = len(baselines)
    # Without a trial, a mean is smaller by the error that the trial adds.
    errors = -np.log([distances, baselines])
    of_distance, of_mean = errors - errors.mean(axis=1, keepdims=True)
    total = max(float(of_mean @ of_mean), 1e-30)
    uncertainty = math.sqrt((count - 1) / count * total)
    below, above = (uncertainty * t for t in skewed_t(of_mean))
    spread = math.sqrt(total * max(float(of_distance @ of_distance), 1e-30))
    correlation = float(of_distance @ of_mean) / spread
    return ratio_interval(ratio, relative, (below, above), correlation)


def skewed_t(sample: FloatArray) -> tuple[float, float]:
    """Return Student's t of a 95 % interval, below and above the mean of a sample.

    Heavy tails make the variance uncertain. Its variance, sigma^4 (2 / (N - 1) + k / N) with the excess kurtosis k,
    gives the degrees of freedom (Satterthwaite). A sample from a skewed population has a small mean and a small scatter
    together, so the interval is longer on the side of the tail (Johnson 1978).

    Args:
        sample: The sample, shape [N].
    """
    count = len(sample)
    deviations = sample - sample.mean()
    scatter = float(deviations.std())
    if count < 3 or scatter == 0.0:
        t = student_t(count - 1)
        return t, t
    third, fourth = (
        float(np.mean((deviations / scatter) ** power)) for power in (3, 4)
    )
    freedom = 2.0 / (2.0 / (count - 1) + max(fourth - 3.0, 0.0) / count)
    t = student_t(freedom)
    bias = math.sqrt(count * (count - 1)) / (count - 2)
    skewness = SKEWNESS_FACTOR * bias * third
    longer = skewness * (1.0 + 2.0 * t**2) / (6.0 * math.sqrt(count))
    return t + max(-longer, 0.0), t + max(longer, 0.0)


def order_widening(series: FloatArray) -> float:
    """Return by how much the error of a mean grows if consecutive trials are correlated.

    The trials count as fewer: AR(1), with the bias 1/N of its correlation.

    Args:
        series: Deviations of the trials from their mean in recorded order, shape [N].
    """
    count = len(series)
    square = max(float(series @ series), 1e-300)
    lag = float(series[1:] @ series[:-1]) / square + 1.0 / count
    lag = min(max(lag, 0.0), 1.0 - 1.0 / count)
    return math.sqrt((1.0 + lag) / (1.0 - lag))


def distances_without(deviation: FloatArray, trials: FloatArray) -> FloatArray:
    """Return the distance of a motion from the mean of the other trials, without each trial, shape [N].

    Args:
        deviation: Motion minus the mean of all trials, shape [T, C]; NaN is unknown.
        trials: The trials, shape [N, T, C]; NaN is unknown.
    """
    seen = np.isfinite(trials)
    counts = seen.sum(axis=0)
    mean = np.nansum(trials, axis=0) / np.maximum(counts, 1)
    moved = np.where(seen, trials - mean, 0.0) / np.maximum(counts - 1, 1)
    squares = np.nansum(np.square(deviation + moved), axis=2)
    is_known = np.isfinite(deviation).any(axis=1)
    return np.asarray(np.sqrt(squares[:, is_known].mean(axis=1)))


def mean_half_width(values: Sequence[float] | FloatArray) -> float:
    """Return half of Student's 95 % interval of a mean; 0 for a single value."""
    count = len(values)
    if count < 2:
        return 0.0
    return student_t(count - 1) * float(np.std(values, ddof=1)) / math.sqrt(count)


def prediction_limit(distances: FloatArray) -> float | None:
    """Return the distance within which one more real trial lies with a probability of 95 %; None below five trials.

    Of N + 1 equal trials, the new one is the k-th smallest or less with probability k / (N + 1), for any distribution.
    With fewer than 19 trials, k would exceed N. Then the limit is that of Student's t for the logarithms of distances.

    Args:
        distances: Distance of each real trial from the mean of the others, shape [N].
    """
    count = len(distances)
    if count < MIN_PREDICTING_TRIALS:
        return None
    rank = math.ceil(0.95 * (count + 1))
    if rank <= count:
        return float(np.sort(distances)[rank - 1])
    logarithms = np.log(distances)
    spread = float(np.std(logarithms, ddof=1))
    above = student_limit(count, ONE_SIDED) * spread
    return math.exp(float(logarithms.mean()) + above)


def errors_of_mean(trials: FloatArray) -> FloatArray:
    """Return (trial - mean) / sqrt(N (N - 1)) for trials of shape [N, T, C]; 0 where a trial is unknown."""
    seen = np.isfinite(trials)
    count = np.maximum(seen.sum(axis=0), 1)
    residuals = np.where(seen, trials - np.nansum(trials, axis=0) / count, 0.0)
    return residuals / np.sqrt(np.maximum(count * (count - 1), 1))


def shared_errors(uncertainty: FloatArray) -> FloatArray:
    """Return a standard uncertainty that all trials share, [T, C], as an error of each coordinate, [C, T, C]."""
    return np.nan_to_num(uncertainty) * np.eye(uncertainty.shape[1])[:, None]


def trials_interval(
    deviation: FloatArray,
    trials: FloatArray,
    *,
    velocity: FloatArray | None = None,
    uncertainty: FloatArray | None = None,
) -> tuple[float, float]:
    """Return the interval of the root mean square over frames of the deviation from the mean of trials.

    Args:
        deviation: Simulation minus mean, shape [T, C]; NaN is unknown.
        trials: At least two trials in recorded order, shape [N, T, C]; NaN is unknown.
        velocity: Velocity of the simulation after the best time shift, shape [T, C]. None without alignment, or if the
            shift is at its bound.
        uncertainty: Standard uncertainty that all trials share, shape [T, C]; NaN counts as 0.
    """
    count = len(trials)
    errors = errors_of_mean(trials)
    if uncertainty is not None:
        errors = np.concatenate([errors, shared_errors(uncertainty)])

    known = np.isfinite(deviation)
    root = math.sqrt(int(known.any(axis=1).sum()))
    vector = deviation[known] / root
    rows = errors[:, known] / root
    if velocity is not None:
        direction = velocity[known] / max(length_of(velocity[known]), 1e-300)
        rows -= np.outer(rows @ direction, direction)

    distance = length_of(vector)
    along = rows @ vector / max(distance, 1e-300)
    series = along[:count].copy()
    widening = order_widening(series)
    rows[:count] *= widening
    along[:count] *= widening

    products = rows @ rows.T
    variance = float(np.trace(products))

    def end(t: float, side: float) -> float:
        excess = distance**2 - variance
        centre = excess + 2.0 * t**2 * float(along @ along)
        at_zero = (t**2 - 1.0) ** 2 * float(np.square(products).sum())
        half = math.sqrt(max(centre**2 - excess**2 + at_zero, 0.0))
        return math.sqrt(max(centre + side * half, 0.0))

    # A mean that is larger by the error of the trials is nearer to the motion.
    above, below = skewed_t(series)
    # The error of a distance is at most the length of the error vector.
    longest = distance + above * math.sqrt(variance)
    low, high = end(below, -1.0), end(above, 1.0)
    return min(low, distance), min(max(high, distance), longest)
