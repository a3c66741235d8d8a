"""Reward of a frame: the distance of the motion from the mean of its reference, negated."""

from __future__ import annotations

import numpy as np

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.band import MARKER_SIGMA_MM, Band
from gauge_envs.scene.geometry import FloatArray, IntArray


def is_reward_bounded(experiment: Experiment) -> bool:
    """Return whether the reward of a frame is between -1 and 0, which is so with deformable bodies.

    Their solutions have an uncertainty of a millimetre, and an action moves them by a metre. Without a bound, one frame
    with a large distance would outweigh all others.
    """
    return bool(experiment.scene.deformables)


class Reward:
    """Rewards of worlds against one reference.

    Args:
        band: The band.
        is_bounded: Whether rewards are bounded, see `is_reward_bounded`.
    """

    def __init__(self, band: Band, is_bounded: bool) -> None:
        self._is_bounded = is_bounded
        self._has_points = band.points is not None
        terms = reward_terms(band, is_bounded=is_bounded)
        self._projection, self._mean, self._weight = terms
        width = len(self._projection)
        self._is_projected = not np.array_equal(self._projection, np.eye(width))

    def of(self, frames: IntArray, g: FloatArray, markers_m: FloatArray) -> FloatArray:
        """Return minus the mean of |z| over the band's coordinates at frames, shape [N]; 0 at unknown frames.

        A band with `points` compares positions of markers. A bounded reward is -z / (1 + z).

        Args:
            frames: Number of the frame of each world, shape [N].
            g: g(t) of each world, shape [N, coordinate_count].
            markers_m: Markers of each world [m], shape [N, marker_count, 3].
        """
        if self._has_points:
            g = 1e3 * markers_m.reshape(len(g), -1)
        if self._is_projected:
            g = g @ self._projection.T
        deviation = np.abs(g - self._mean[frames])
        distance = (deviation * self._weight[frames]).sum(axis=1)
        if self._is_bounded:
            return 1.0 / (1.0 + distance) - 1.0
        return -distance


def reward_terms(
    band: Band, *, is_bounded: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return projection, mean and weights of `Band.compared`.

    |deviation| @ weight is the mean of |z| over known coordinates. z is the deviation over the larger of sigma and the
    uncertainty of the mean. For a bounded reward, the divisor is at least the size of the motion. Actions move a cloth
    by its whole motion, and a smaller divisor would give a distant policy no gradient.
    """
    band = band.compared
    scale = band.sigma
    if band.uncertainty is not None:
        scale = np.fmax(scale, band.uncertainty)
    if is_bounded:
        scale = np.fmax(scale, motion_size(band))
    usable = band.measured[:, None] & (scale > 0.0) & np.isfinite(band.mean)
    count = np.maximum(usable.sum(axis=1, keepdims=True), 1)
    weight = np.where(usable, 1.0, 0.0) / np.where(usable, scale, 1.0) / count
    return band.projection, np.nan_to_num(band.mean), weight


def motion_size(band: Band) -> float:
    """Return the root mean square of the mean motion about its first known value, in the band's unit."""
    known = np.isfinite(band.mean).all(axis=1)
    if not known.any():
        return 0.0
    mean = band.mean[known]
    return float(np.sqrt(np.square(mean - mean[0]).mean()))


def reward_text(band: Band | None, *, is_bounded: bool = False) -> str:
    """Return how the reward of an environment is computed, one sentence.

    Args:
        band: Reference of the rewards, or None.
        is_bounded: Whether the reward is bounded, see `is_reward_bounded`.
    """
    if band is None:
        return "0 at every frame: there is no reference in use"
    _, _, weight = reward_terms(band, is_bounded=is_bounded)
    known = np.flatnonzero(weight.any(axis=1))
    if not len(known):
        return "0 at every frame: the reference has no scatter"
    span = (
        f"frames {known[0]} to {known[-1]}" if len(known) > 1 else f"frame {known[0]}"
    )
    if known[-1] - known[0] + 1 != len(known):
        span = f"{len(known)} of the {span}"
    elsewhere = "" if len(known) == len(band.mean) else "; else 0"
    compared = band.compared
    names = compared.coordinates
    if len(names) > 3:
        names = (f"{len(names)} coordinates",)
    scale = "sigma"
    sign = "-z / (1 + z) with z =" if is_bounded else "minus"
    if band.points is not None:
        names = (f"x, y, z of {len(compared.coordinates) // 3} markers",)
        scale = f"{MARKER_SIGMA_MM:g} mm, or over the uncertainty of the mean where it is larger"
    if is_bounded and motion_size(compared) > 0.0:
        scale = f"{motion_size(compared):.3g} {compared.unit}, the size of the motion"
    return (
        f"{sign} the mean over {', '.join(names)} of |deviation from the reference's mean| / {scale}, "
        f"at {span} of {len(band.mean)}{elsewhere}"
    )
