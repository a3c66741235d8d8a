"""What values of single files say about the next file, and what a residual looks like."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import stdtrit

from gauge_envs.scene.geometry import FloatArray

NORMAL_95 = 1.96
"""Half of the 95 % interval of a normal distribution, over its standard deviation."""
NAMED_SHARE = 0.25
"""Share of a residual's squares from which its pattern has a name."""


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Random effects of one number over files.

    Attributes:
        mean: Weighted mean of the files.
        between: Standard deviation between files, beyond what the uncertainty of each explains.
        low, high: 95 % prediction interval of the value of the next file.
    """

    mean: float
    between: float
    low: float
    high: float


def spread_of(
    values: FloatArray,
    stds: FloatArray,
    common_error: float = 0.0,
    least: float = 0.0,
) -> Spread:
    """Return the spread between files, and the interval for the value of another one.

    Each file's value is the mean, a deviation of the file, and an error of known size. The deviation's variance has the
    largest restricted likelihood (REML). The prediction interval has Student's quantile with one degree of freedom less
    than files (Veroniki et al., Research Synthesis Methods 10, 2019), and contains an error of the mean size besides,
    as the value of the next file is estimated too.

    Args:
        values: Value of each file, shape [K], two or more.
        stds: Standard error of each [same unit], shape [K].
        common_error: Standard uncertainty that all files share, over the value, as of a load that all were fitted with;
            no scatter between files shows it.
        least: Least value that is possible.
    """
    scale = float(max(np.ptp(values), stds.max(), 1e-300))
    scaled, errors = values / scale, stds / scale

    def misfit(between: float) -> float:
        """Return twice the negative logarithm of the restricted likelihood."""
        weights = 1.0 / (between**2 + errors**2 + 1e-12)
        mean = weights @ scaled / weights.sum()
        squares = weights @ (scaled - mean) ** 2
        return float(squares - np.log(weights).sum() + np.log(weights.sum()))

    found = minimize_scalar(misfit, bounds=(0.0, 3.0), method="bounded")
    between = float(found.x) if found.fun < misfit(0.0) else 0.0
    weights = 1.0 / (between**2 + errors**2 + 1e-12)
    mean = float(weights @ scaled / weights.sum())
    variance = between**2 + 1.0 / weights.sum() + float(np.median(errors**2))
    scattered = float(stdtrit(len(values) - 1, 0.975) * np.sqrt(variance))
    half = float(np.hypot(scattered, NORMAL_95 * common_error * mean))
    return Spread(
        mean=scale * mean,
        between=scale * between,
        low=max(scale * (mean - half), least),
        high=scale * (mean + half),
    )


def sensor_noise_rad(residual_rad: FloatArray) -> float:
    """Return the white noise of a sensor from what a model leaves [rad]: third differences pass no slow motion.

    Args:
        residual_rad: Simulated less measured angles, evenly sampled [rad], shape [N].
    """
    # The coefficients 1 -3 3 -1 make of white noise one of twenty times the variance.
    return float(np.sqrt((np.diff(residual_rad, 3) ** 2).mean() / 20.0))


def pattern(
    times_s: FloatArray, angles_rad: FloatArray, residual_rad: FloatArray
) -> str:
    """Return what a residual looks like: an offset, a lag, a drag, or ""; with the share of its squares in percent.

    A wrong delay or period leaves the rate of the motion, constant or growing with time; a wrong friction or amplitude
    leaves the motion about its mean in the same way.

    Args:
        times_s: Times [s], shape [N].
        angles_rad: Simulated angles [rad], shape [N].
        residual_rad: Simulated less measured angles [rad], shape [N].
    """
    growing = (times_s - times_s.mean()) / max(np.ptp(times_s), 1e-300)
    about_rad = angles_rad - angles_rad.mean()
    rate = np.gradient(angles_rad, times_s)
    shapes: Mapping[str, list[FloatArray]] = {
        "offset": [np.ones_like(times_s)],
        "lag": [rate, growing * rate],
        "drag": [about_rad, growing * about_rad],
    }
    total = float((residual_rad**2).sum())
    shares = {}
    for name, columns in shapes.items():
        table = np.stack(columns, axis=1)
        answer = np.linalg.lstsq(table, residual_rad, rcond=None)[0]
        left = residual_rad - table @ answer
        shares[name] = 1.0 - float((left**2).sum()) / max(total, 1e-300)
    name = max(shares, key=lambda one: shares[one])
    return f"{name} {100.0 * shares[name]:.0f} %" if shares[name] > NAMED_SHARE else ""
