"""Distance between the trajectories of two configurations."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from gauge_envs.pages.text import quantity_text
from gauge_envs.references.published import Baseline
from gauge_envs.runs.result import Result
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.metrics import trajectory_rmse
from gauge_envs.tools.compare.difference import ScoreSpread

MOTION_SHARE = 0.05
"""Threshold of a distance, as a share of the motion, for experiments without a published scatter of real trials."""


@dataclass(frozen=True, kw_only=True)
class Distance:
    """Distance between the trajectories of two configurations, at the 30 Hz frames that both have.

    The distance at a frame is Euclidean over all coordinates, as in E_RMSE. Repeats are compared seed by seed, or each
    with each if the two configurations have no seed in common.

    Attributes:
        first: Index of the first configuration.
        second: Index of the second configuration.
        unit: Unit of the lengths.
        rms: Root-mean-square distance over the common frames, mean and scatter over the pairs of repeats.
        motion_rms: Root-mean-square displacement of both from their starts, over the same frames and pairs.
        threshold: Distance from which trajectories count as apart.
        threshold_is_scatter: Whether the threshold is the published mean RMSE of real trials; else it is `MOTION_SHARE`
            of `motion_rms`.
        apart_at_s: Time of the first frame at which any pair is apart [s]; None if there is no such frame.
        frames: Number of common frames of the shortest pair.
        diverged: Whether one of the trajectories ended because it diverged.
    """

    first: int
    second: int
    unit: str
    rms: ScoreSpread
    motion_rms: float
    threshold: float
    threshold_is_scatter: bool
    apart_at_s: float | None
    frames: int
    diverged: bool

    def text(self, length: float) -> str:
        """Return a length with its unit."""
        return f"{quantity_text(length)} {self.unit}"

    @property
    def apart_text(self) -> str:
        """When the trajectories are first apart."""
        return "never" if self.apart_at_s is None else f"{self.apart_at_s:.2f} s"


def trajectory_distance(
    configurations: tuple[int, int],
    some: Sequence[Result],
    others: Sequence[Result],
    baseline: Baseline | None,
) -> Distance | None:
    """Return the distance of two configurations in one experiment, or None if they share no frame.

    Args:
        configurations: Indices of the two configurations.
        some: Results of the first.
        others: Results of the second.
        baseline: Published RMSE of real trials; None if there is none.
    """
    pairs = _paired(some, others)
    common = _all_common_frames(pairs)
    rms = ScoreSpread.of([trajectory_rmse(a, b) for _, a, b in common])
    if rms is None:
        return None
    motions = []
    crossings_s = []
    for _, a, b in common:
        moved = np.vstack((a - a[0], b - b[0]))
        motions.append(trajectory_rmse(moved, np.zeros_like(moved)))
    motion_rms = float(np.mean(motions))
    threshold = MOTION_SHARE * motion_rms if baseline is None else baseline.mean
    for times_s, distance in _over_time(common):
        beyond = distance > threshold
        if beyond.any():
            crossings_s.append(float(times_s[beyond.argmax()]))
    return Distance(
        first=configurations[0],
        second=configurations[1],
        unit=pairs[0][0].score.unit,
        rms=rms,
        motion_rms=motion_rms,
        threshold=threshold,
        threshold_is_scatter=baseline is not None,
        apart_at_s=min(crossings_s, default=None),
        frames=min(len(frames) for frames, _, _ in common),
        diverged=any(result.diverged for pair in pairs for result in pair),
    )


def distances_over_time(
    some: Sequence[Result], others: Sequence[Result]
) -> list[tuple[FloatArray, FloatArray]]:
    """Return the distance between results of two configurations at each common frame, paired as for `Distance`.

    Returns:
        For each pair of repeats the times [s] and the distances in the observable's unit, both of shape [frame_count].
    """
    return _over_time(_all_common_frames(_paired(some, others)))


CommonFrames = tuple[NDArray[np.int64], FloatArray, FloatArray]
"""Frame numbers that two results have, and g(t) of both there, [frame_count, coordinate_count] each."""


def _over_time(
    common: Sequence[CommonFrames],
) -> list[tuple[FloatArray, FloatArray]]:
    """Return times [s] and distances of each pair of results."""
    return [
        (frames / FRAME_RATE_HZ, np.linalg.norm(a - b, axis=1))
        for frames, a, b in common
    ]


def _all_common_frames(pairs: Sequence[tuple[Result, Result]]) -> list[CommonFrames]:
    """Return the common frames of each pair that has some."""
    found = [_common_frames(one, other) for one, other in pairs]
    return [frames for frames in found if frames is not None]


def _paired(
    some: Sequence[Result], others: Sequence[Result]
) -> list[tuple[Result, Result]]:
    first, second = (
        [one for one in results if one.trajectory is not None]
        for results in (some, others)
    )
    # Results of the same seed have the same jittered start, so only the configuration differs.
    by_seed = {one.seed: one for one in second}
    same_seed = [(one, by_seed[one.seed]) for one in first if one.seed in by_seed]
    return same_seed or [*product(first, second)]


def _common_frames(one: Result, other: Result) -> CommonFrames | None:
    """Return the common frames of two results; None without any."""
    if one.trajectory is None or other.trajectory is None:
        return None
    if one.trajectory.coordinates != other.trajectory.coordinates:
        return None
    frames_a, a = one.trajectory.frames
    frames_b, b = other.trajectory.frames
    common, index_a, index_b = np.intersect1d(frames_a, frames_b, return_indices=True)
    return (common, a[index_a], b[index_b]) if len(common) else None
