"""Distance between the trajectories of two configurations."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from gauge_envs.references.published import Baseline
from gauge_envs.runs.result import Result
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.compare.statistics import ScoreSpread

MOTION_SHARE = 0.05
"""Threshold of a distance, as a share of the motion, for experiments without a published scatter of real trials."""


@dataclass(frozen=True, kw_only=True)
class Distance:
    """Distance between the trajectories of two configurations, at the 30 Hz frames that both have.

    The distance at a frame is Euclidean over all coordinates, as in E_RMSE. For cloth and foam it is the root mean
    square over their markers. Repeats with the same seed are compared; without a common seed, all pairs of repeats.

    Attributes:
        first: Index of the first configuration.
        second: Index of the second configuration.
        unit: Unit of the lengths.
        rms: Root-mean-square distance over the common frames, mean and scatter over the pairs of repeats.
        motion_rms: Root-mean-square displacement of both from their initial states, over the same frames and pairs.
        threshold: Distance above which trajectories count as apart.
        threshold_is_scatter: Whether the threshold is the published mean RMSE of real trials. Otherwise it is
            `MOTION_SHARE` times `motion_rms`.
        apart_at_s: Time of the first frame at which a pair is apart [s]; None if no pair is apart.
        frames: Number of common frames of the shortest pair.
        diverged: Whether one of the trajectories diverged.
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

    @property
    def share_text(self) -> str:
        """`rms` over `motion_rms`, as `53 %`; empty if nothing moves."""
        if not self.motion_rms:
            return ""
        return f"{100.0 * self.rms.mean / self.motion_rms:.3g} %"


@dataclass(frozen=True, eq=False)
class TrajectoryGap:
    """Two trajectories at their common frames.

    Attributes:
        times_s: Times of the common frames [s], shape [frame_count].
        distances: Distance at each frame, shape [frame_count].
        motion_rms: Root-mean-square displacement of both from their initial states.
    """

    times_s: FloatArray
    distances: FloatArray
    motion_rms: float


def trajectory_distance(
    configurations: tuple[int, int],
    first_results: Sequence[Result],
    second_results: Sequence[Result],
    baseline: Baseline | None,
) -> Distance | None:
    """Return the distance between two configurations in one experiment; None without a common frame.

    Args:
        configurations: Indices of the two configurations.
        first_results: Results of the first configuration.
        second_results: Results of the second configuration.
        baseline: Published RMSE of real trials, if any.
    """
    gaps = trajectory_gaps(first_results, second_results)
    rms = ScoreSpread.of(_root_mean_square(gap.distances) for gap in gaps)
    if rms is None:
        return None
    motion_rms = float(np.mean([gap.motion_rms for gap in gaps]))
    threshold = MOTION_SHARE * motion_rms
    pairs = list(_pairs(first_results, second_results))
    shown = pairs[0][0].trajectory
    assert shown is not None, "pairs have trajectories"
    if shown.markers_mm.size:
        # The published distances of cloth and foam are of curvatures and areas.
        baseline = None
    if baseline is not None:
        threshold = baseline.mean
    apart_s = []
    for gap in gaps:
        times_s = gap.times_s[gap.distances > threshold]
        apart_s += times_s[:1].tolist()
    return Distance(
        first=configurations[0],
        second=configurations[1],
        unit=shown.compared.unit,
        rms=rms,
        motion_rms=motion_rms,
        threshold=threshold,
        threshold_is_scatter=baseline is not None,
        apart_at_s=min(apart_s, default=None),
        frames=min(len(gap.times_s) for gap in gaps),
        diverged=any(first.diverged or second.diverged for first, second in pairs),
    )


def trajectory_gaps(
    first_results: Sequence[Result], second_results: Sequence[Result]
) -> list[TrajectoryGap]:
    """Return the distance over time of each pair of repeats with common frames."""
    gaps = []
    for result, other_result in _pairs(first_results, second_results):
        assert result.trajectory is not None and other_result.trajectory is not None
        trajectory = result.trajectory.compared
        other_trajectory = other_result.trajectory.compared
        if trajectory.coordinates != other_trajectory.coordinates:
            continue
        frames, values = trajectory.frames
        other_frames, other_values = other_trajectory.frames
        common, rows, other_rows = np.intersect1d(
            frames, other_frames, assume_unique=True, return_indices=True
        )
        if len(common):
            first, second = values[rows], other_values[other_rows]
            moved = np.concatenate((first - first[0], second - second[0]))
            scale = trajectory.marker_count**-0.5
            motion_rms = scale * _root_mean_square(np.linalg.norm(moved, axis=1))
            apart = scale * np.linalg.norm(first - second, axis=1)
            gaps.append(TrajectoryGap(common / FRAME_RATE_HZ, apart, motion_rms))
    return gaps


def _root_mean_square(lengths: FloatArray) -> float:
    return float(np.sqrt(lengths @ lengths / len(lengths)))


def _pairs(
    first_results: Sequence[Result], second_results: Sequence[Result]
) -> Iterator[tuple[Result, Result]]:
    """Yield pairs of results with trajectories: those with the same seed, or all pairs without a common seed."""
    first, second = _by_seed(first_results), _by_seed(second_results)
    # Results with the same seed have the same initial-state noise, so only the configuration differs.
    common = first.keys() & second.keys()
    if common:
        yield from ((first[seed], second[seed]) for seed in first if seed in common)
    else:
        yield from product(first.values(), second.values())


def _by_seed(results: Sequence[Result]) -> dict[int | None, Result]:
    """Return the results with a trajectory, by seed."""
    return {result.seed: result for result in results if result.trajectory is not None}
