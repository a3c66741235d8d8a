"""Frequency, decay rate and droop of a soft body that is let go level and swings about the place where it hangs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

FloatArray = NDArray[np.float64]

LEAST_SAMPLES = 12
"""Smallest number of samples that determine the five constants of the law with their uncertainty."""

HIGHER_MODES_S = 0.15
"""Time after the release that is left out [s]: about the first swing of the recorded beam, which holds the most of
higher bending modes."""

PADDING = 8
"""Length of the spectrum that starts the fit, over that of the signal."""


@dataclass(frozen=True, kw_only=True)
class Ringing:
    """Constants of z(t) = level - droop + A exp(-decay t) cos(2 pi f t + phase), each with its standard uncertainty.

    Attributes:
        frequency_hz: Frequency of the damped swing, and its uncertainty [Hz].
        decay_rate_per_s: Decay rate of the amplitude, and its uncertainty [1/s].
        droop_mm: How far the end hangs below its height in the level body, and its uncertainty [mm].
        residual_mm: Root mean square of what the law leaves [mm].
    """

    frequency_hz: tuple[float, float]
    decay_rate_per_s: tuple[float, float]
    droop_mm: tuple[float, float]
    residual_mm: float

    @property
    def constants(self) -> dict[str, tuple[float, float]]:
        """The constants with their uncertainties, by the name of the implied parameter."""
        return {"frequency": self.frequency_hz, "decay_rate": self.decay_rate_per_s, "droop": self.droop_mm}

    @property
    def damping_ratio(self) -> float:
        """Decay rate over the angular frequency of the same swing without damping."""
        angular = 2.0 * math.pi * self.frequency_hz[0]
        return self.decay_rate_per_s[0] / math.hypot(angular, self.decay_rate_per_s[0])


def fit_ringing(times_s: FloatArray, heights_mm: FloatArray, *, level_mm: float) -> Ringing | None:
    """Fit one damped swing to heights after a release.

    The first 0.15 s are left out: one sinusoid does not describe higher bending modes.

    Args:
        times_s: Times after the release, evenly spaced [s], shape [sample_count].
        heights_mm: Heights at those times [mm], shape [sample_count].
        level_mm: Height from which the droop counts, that of the level body [mm].

    Returns:
        The constants; None for heights that are not finite, do not swing, or have too few samples.
    """
    later = times_s >= HIGHER_MODES_S
    times, signal = times_s[later], heights_mm[later]
    if len(times) < LEAST_SAMPLES or not np.isfinite(signal).all() or np.ptp(signal) == 0.0:
        return None
    step_s, mean = float(times[1] - times[0]), float(signal.mean())
    spectrum = np.fft.rfft((signal - mean) * np.exp(-(times - times[0])), PADDING * len(signal))
    strongest = 1 + int(np.abs(spectrum[1:]).argmax())
    start_hz = strongest / (PADDING * len(signal) * step_s)

    def misfit(constants: FloatArray) -> FloatArray:
        hang, cosine, sine, decay, frequency = constants
        angle = 2.0 * math.pi * frequency * (times - times[0])
        swing = np.exp(-decay * (times - times[0])) * (cosine * np.cos(angle) + sine * np.sin(angle))
        return np.asarray(hang + swing - signal)

    # The spectrum leaves the phase open. Two starts a quarter of a swing apart reach the same least sum.
    half = 0.5 * float(np.ptp(signal))
    starts = ((half, 0.0), (0.0, half))
    fits = [least_squares(misfit, [mean, *size, 1.0, start_hz], x_scale=[1.0, 1.0, 1.0, 1.0, 0.1]) for size in starts]
    best = min(fits, key=lambda fit: fit.cost)
    count = len(times) - 5
    # A law that fits exactly, as in a test, has a covariance of 0.
    covariance = np.linalg.pinv(best.jac.T @ best.jac) * (2.0 * best.cost / count)
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    hang, _, _, decay, frequency = (float(value) for value in best.x)
    return Ringing(
        frequency_hz=(abs(frequency), float(errors[4])),
        decay_rate_per_s=(decay, float(errors[3])),
        droop_mm=(level_mm - hang, float(errors[0])),
        residual_mm=math.sqrt(2.0 * best.cost / len(times)),
    )
