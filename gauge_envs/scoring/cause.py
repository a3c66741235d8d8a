"""The cause of a distance from real trials: the engine, the constants, or both.

Three motions answer: that of the engine, the exact motion with the same constants, and the real trials.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.band import Band
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.exact import exact_motion
from gauge_envs.scoring.metrics import best_offset, rms_deviation


class DistanceCause(StrEnum):
    """What causes the distance of a motion from real trials."""

    NONE = "none"
    """The motion is as close as real trials."""
    CONSTANTS = "constants"
    """The motion is near the exact one, which is far from the trials."""
    ENGINE = "engine"
    """The motion is far from the trials, and the exact one is near them."""
    BOTH = "both"
    """The motion is far from the exact one, and both are far from the trials."""


def cause_of(
    *, is_real: bool, is_exact_real: bool, is_near_exact: bool
) -> DistanceCause:
    """Return the cause of the distance of a motion from real trials.

    Args:
        is_real: Whether the motion is as close to the trials as one more trial would be.
        is_exact_real: Whether the exact motion is.
        is_near_exact: Whether the distance between the motion and the exact one does not matter.
    """
    if is_real:
        return DistanceCause.NONE
    if is_exact_real:
        return DistanceCause.ENGINE
    return DistanceCause.CONSTANTS if is_near_exact else DistanceCause.BOTH


def distance_from_exact(
    experiment: Experiment, band: Band, frames: FloatArray, time_offset_s: float
) -> float:
    """Return the RMSE of a motion to the exact motion after the best time shift, in the unit of the reference.

    The exact motion is shifted, not the other one: its law holds at any time, so nothing is interpolated.

    Args:
        experiment: Experiment with an exact motion.
        band: The reference.
        frames: The motion at the 30 Hz frames in the coordinates of the reference, shape [T, C].
        time_offset_s: Time shift of the motion to the trials [s]. Frames that this shift moves beyond the end of the
            trials do not count, as in the score.
    """
    times_s = np.arange(len(frames)) / FRAME_RATE_HZ
    is_compared = times_s <= times_s[-1] - max(time_offset_s, 0.0)

    def shifted_rmse(offset_s: FloatArray) -> FloatArray:
        queries_s = times_s[is_compared] - offset_s[..., None]
        exact = exact_motion(experiment, queries_s.ravel())
        assert exact is not None, "the experiment has an exact motion"
        projected = band.project(exact).reshape(*queries_s.shape, -1)
        return rms_deviation(projected - frames[is_compared])

    return best_offset(shifted_rmse)[1]
