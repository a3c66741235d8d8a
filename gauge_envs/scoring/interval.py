"""95 % intervals of the distance between a simulation and the mean of infinitely many real trials.

The observed deviation is the true deviation plus the error e of the mean of N trials. S is the covariance of e. On
average, the square of the observed distance d exceeds the square of the true distance D by tr(S). Its variance is
4 D^2 h'Sh + 2 tr(S^2) with the unit deviation h. The interval holds each D whose square is less than t standard
deviations from d^2 - tr(S) (Wilson's interval). Student's t has N - 1 degrees of freedom. At D = 0,
(t^2 - 1)^2 tr(S^2) replaces 2 t^2 tr(S^2). So an error with one direction excludes D = 0 as Student's test does.
"""

from __future__ import annotations

import math

import numpy as np

from gauge_envs.scene.geometry import FloatArray, length_of


def student_t(freedom: int, coverage: float = 0.95) -> float:
    """Return the distance from 0 within which Student's t is with a probability.

    Args:
        freedom: Degrees of freedom.
        coverage: The probability.
    """
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.5 + 0.5 * coverage))


def distance_interval(distance: float, uncertainty: float) -> tuple[float, float]:
    """Return the interval of a distance from a reference with a standard uncertainty, all in one unit."""
    half = 1.96 * uncertainty
    return max(distance - half, 0.0), distance + half


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
    seen = np.isfinite(trials)
    seen_count = seen.sum(axis=0)
    mean = np.nansum(trials, axis=0) / np.maximum(seen_count, 1)
    residuals = np.where(seen, trials - mean, 0.0)
    errors = residuals / np.sqrt(np.maximum(seen_count * (seen_count - 1), 1))
    if uncertainty is not None:
        shared = np.nan_to_num(uncertainty) * np.eye(uncertainty.shape[1])[:, None]
        errors = np.concatenate([errors, shared])

    known = np.isfinite(deviation)
    root = math.sqrt(int(known.any(axis=1).sum()))
    vector = deviation[known] / root
    rows = errors[:, known] / root
    if velocity is not None:
        direction = velocity[known] / max(length_of(velocity[known]), 1e-300)
        rows -= np.outer(rows @ direction, direction)

    distance = length_of(vector)
    along = rows @ vector / max(distance, 1e-300)
    # Correlated consecutive trials count as fewer: AR(1), with the bias 1/N of its correlation.
    series = along[:count]
    square = max(float(series @ series), 1e-300)
    lag = float(series[1:] @ series[:-1]) / square + 1.0 / count
    lag = min(max(lag, 0.0), 1.0 - 1.0 / count)
    widening = np.ones(len(rows))
    widening[:count] = math.sqrt((1.0 + lag) / (1.0 - lag))
    rows *= widening[:, None]
    along *= widening

    products = rows @ rows.T
    variance = float(np.trace(products))
    student_square = student_t(count - 1) ** 2
    excess = distance**2 - variance
    centre = excess + 2.0 * student_square * float(along @ along)
    at_zero = (student_square - 1.0) ** 2 * float(np.square(products).sum())
    half = math.sqrt(max(centre**2 - excess**2 + at_zero, 0.0))
    low = math.sqrt(max(centre - half, 0.0))
    high = math.sqrt(max(centre + half, 0.0))
    # The error of a distance is at most the length of the error vector.
    longest = distance + math.sqrt(student_square * variance)
    return min(low, distance), min(max(high, distance), longest)
