"""Agreement of a motion with a physical law: constant acceleration, damped oscillation, limited friction.

The definitions are those of the paper's physical-consistency analysis (appendix). The paper applies them to world
models; here they apply to simulated trajectories. Every function takes one motion and no reference.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize

from gauge_envs.errors import ShapeError
from gauge_envs.evaluation.metrics.events import oscillation_period

FloatArray = NDArray[np.float64]

STANDARD_GRAVITY = 9.80665  # m/s^2, the value the paper takes for the friction limit


def fitted_acceleration(times_s: ArrayLike, displacement_m: ArrayLike) -> float:
    """Return the acceleration of a motion from rest, by least squares of s = b + a t^2 / 2 (paper).

    Args:
        times_s: Times since the release, shape [sample_count], s.
        displacement_m: Signed displacement along the direction of motion, shape [sample_count], m.

    Returns:
        The acceleration a, m/s^2.
    """
    times_s, displacement_m = _series(times_s, displacement_m, least=2)
    (_, slope), _ = _fit(np.vander(times_s**2, 2, increasing=True), displacement_m)
    return 2 * float(slope)


def quadratic_form_improvement(times_s: ArrayLike, displacement_m: ArrayLike) -> float:
    """Return the F statistic of adding a t^4 term to s = b + k t^2 (paper, QFI); small for constant acceleration.

    The statistic grows with the number of samples and with their precision. Compare only motions of equal length and
    noise: without noise the slightest systematic curvature gives a large value.

    Args:
        times_s: Times since the release, shape [sample_count], s.
        displacement_m: Signed displacement along the direction of motion, shape [sample_count], m.

    Returns:
        QFI, dimensionless; 0 if s = b + k t^2 fits to rounding.
    """
    times_s, displacement_m = _series(times_s, displacement_m, least=4)
    terms = np.vander((times_s / np.abs(times_s).max()) ** 2, 3, increasing=True)
    _, sse_linear = _fit(terms[:, :2], displacement_m)
    _, sse_quadratic = _fit(terms, displacement_m)
    # Below this, both residuals are rounding errors, and their ratio is noise or a division by zero.
    rounding = len(times_s) * (8 * np.finfo(float).eps * float(np.abs(displacement_m).max())) ** 2
    if sse_linear <= rounding:
        return 0.0
    return (sse_linear - sse_quadratic) / (max(sse_quadratic, rounding) / (len(times_s) - 3))


def coefficient_of_determination(times_s: ArrayLike, angle_rad: ArrayLike) -> float:
    """Return R^2 of the damped oscillation that fits an angle best (paper, pendulum).

    The model is equilibrium + exp(-beta t) (C cos(omega t) + D sin(omega t)). A negative beta is a growing oscillation.
    The search varies beta and omega, from no damping and the dominant frequency on. For each pair, least squares gives
    the three linear coefficients.

    Args:
        times_s: Evenly spaced times, shape [sample_count], s.
        angle_rad: Angle from the vertical, shape [sample_count], rad; any unit gives the same R^2.

    Returns:
        R^2, at most 1; NaN for a constant angle, which has no variance.
    """
    times_s, angle_rad = _series(times_s, angle_rad, least=6)
    steps = np.diff(times_s)
    if steps[0] <= 0 or not np.allclose(steps, steps[0], rtol=1e-3, atol=0):
        raise ShapeError("times_s: ascending, evenly spaced times are needed")
    centred = angle_rad - angle_rad.mean()
    if np.abs(centred).max() <= 1e-12 * np.abs(angle_rad).max():
        return math.nan
    elapsed_s = times_s - times_s[0]

    def residual_share(parameters: FloatArray) -> float:
        beta, omega = parameters
        decay = np.exp(np.clip(-beta * elapsed_s, -50.0, 50.0))
        terms = np.column_stack(
            (np.ones_like(decay), decay * np.cos(omega * elapsed_s), decay * np.sin(omega * elapsed_s))
        )
        _, sse = _fit(terms, centred)
        return sse / float(centred @ centred)

    omega = 2 * np.pi / oscillation_period(angle_rad, frame_rate_hz=1 / float(steps.mean()))
    # The first simplex spans one Fourier bin in omega and a decay by e over the record in beta.
    reach = np.array([1.0, np.pi]) / elapsed_s[-1]
    start = np.array([0.0, omega])
    simplex = start + np.array([[0.0, 0.0], [reach[0], 0.0], [0.0, reach[1]]])
    fit = minimize(
        residual_share, start, method="Nelder-Mead", options={"initial_simplex": simplex, "xatol": 1e-9, "fatol": 1e-15}
    )
    return 1.0 - float(fit.fun)


def dynamic_error(
    times_s: ArrayLike, positions_m: ArrayLike, *, mass_kg: float, friction: float, gravity: float = STANDARD_GRAVITY
) -> float:
    """Return the mean force by which a motion exceeds the limit of friction (paper, turntable, equation of DE).

    Args:
        times_s: Ascending times, even or uneven, shape [sample_count], s.
        positions_m: Horizontal positions, shape [sample_count, axis_count], m.
        mass_kg: Mass of the block, kg.
        friction: Friction coefficient between block and table.
        gravity: Gravitational acceleration, m/s^2.

    Returns:
        Mean of max(0, m |a| - mu m g) over the inner samples, N. Accelerations are from three neighbouring samples.
    """
    times_s, positions_m = _series(times_s, positions_m, least=3, dimension=2)
    steps = np.diff(times_s)
    if not (steps > 0).all():
        raise ShapeError("times_s: ascending times are needed")
    velocity = np.diff(positions_m, axis=0) / steps[:, None]
    acceleration = 2 * np.diff(velocity, axis=0) / (times_s[2:] - times_s[:-2])[:, None]
    force = mass_kg * np.linalg.norm(acceleration, axis=1)
    return float(np.maximum(force - friction * mass_kg * gravity, 0.0).mean())


def _series(times_s: ArrayLike, values: ArrayLike, *, least: int, dimension: int = 1) -> tuple[FloatArray, FloatArray]:
    times_s, values = np.asarray(times_s, dtype=np.float64), np.asarray(values, dtype=np.float64)
    if times_s.ndim != 1 or values.ndim != dimension or len(values) != len(times_s):
        raise ShapeError(
            f"times_s has shape {times_s.shape}, the values {values.shape}; one row for each time is needed"
        )
    if not (np.isfinite(times_s).all() and np.isfinite(values).all()):
        raise ShapeError("times and values must be finite; leave missing samples out, with their times")
    if len(np.unique(times_s)) < least:
        raise ShapeError(f"{len(np.unique(times_s))} different times; at least {least} are needed")
    return times_s, values


def _fit(terms: FloatArray, values: FloatArray) -> tuple[NDArray[np.floating], float]:
    """Return the least-squares coefficients and the sum of squared residuals."""
    coefficients = np.linalg.lstsq(terms, values, rcond=None)[0]
    residuals = values - terms @ coefficients
    return coefficients, float(residuals @ residuals)
