"""Run a sample of a submission's episodes again, and compare their trajectories."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import GaugeError
from gauge_envs.evaluation.metrics.trajectory import trajectory_rmse
from gauge_envs.references.published import published_baselines
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Result
from gauge_envs.scene.timing import SAMPLES_PER_FRAME

RERUN_SHARE = 0.01
"""Largest distance of a repeated trajectory, as a share of the distance of real trials from their mean: it moves a
normalized score by at most 0.01. Without a published baseline, the share of the motion."""


class RerunStatus(StrEnum):
    """How a repeated trajectory compares with that of the file."""

    EQUAL = "equal"
    """The same bits."""
    CLOSE = "close"
    """Other bits, within the tolerance."""
    DIFFERENT = "different"
    """Beyond the tolerance, or another outcome."""
    NOT_RUN = "not run"
    """The episode could not run here."""


@dataclass(frozen=True, kw_only=True)
class Rerun:
    """One episode that was run again.

    Attributes:
        id: Gymnasium id.
        status: How it compares.
        unit: Unit of the differences.
        largest_difference: Largest difference of a coordinate; None if the two have other lengths.
        rmse: Root-mean-square distance over the samples of one phase, as those of the frames, whichever phase is
            farthest; None if the two have other lengths.
        allowed: Largest distance that counts as the same.
        cause: What is known of the cause of a difference, or why the episode was not run; empty for the same bits.
    """

    id: str
    status: RerunStatus
    unit: str
    largest_difference: float | None = None
    rmse: float | None = None
    allowed: float | None = None
    cause: str = ""

    @property
    def is_fault(self) -> bool:
        """Whether the submission does not stand."""
        return self.status in (RerunStatus.DIFFERENT, RerunStatus.NOT_RUN)

    def __str__(self) -> str:
        if self.largest_difference is None or self.rmse is None:
            return f"{self.status.value}: {self.cause}"
        apart = (
            f"{self.largest_difference:.3g} {self.unit} at most, {self.rmse:.3g} {self.unit} RMS, "
            f"allowed {self.allowed:.3g} {self.unit}"
        )
        return f"{self.status.value}: {apart}{f'; {self.cause}' if self.cause else ''}"


def rerun_sample(results: Sequence[Result], count: int, *, content_sha256: str, salt: str = "") -> list[Result]:
    """Return a random sample of results, which nobody can choose without changing the submission.

    Args:
        results: The results of a submission, in the order of their files.
        count: Size of the sample; all if there are fewer.
        content_sha256: Hash of the submission's content, from which the seed follows.
        salt: Text that the submitter does not know, so that no content can be tried out until the sample suits.
    """
    seed = int(hashlib.sha256(f"{content_sha256} {salt}".encode()).hexdigest(), 16)
    chosen = np.random.default_rng(seed).permutation(len(results))[:count]
    return [results[number] for number in sorted(chosen)]


def rerun(result: Result) -> tuple[Rerun, Result | None]:
    """Run the episode of a result again and compare the trajectories, with all samples between and after the frames.

    Args:
        result: A result with a trajectory and without an asset.

    Returns:
        The comparison, and the result of this run where it has a trajectory.
    """
    blank = Rerun(id=result.id, status=RerunStatus.NOT_RUN, unit=result.score.unit)
    request = RunRequest(
        result.id,
        backend=result.backend or "",
        parameters=result.parameters,
        settings=result.settings_given or None,
        marker_proxy=result.marker_proxy,
        seed=result.seed or 0,
    )
    try:
        again = next(iter(run_many([request], isolate=None)))
    except GaugeError as error:
        return replace(blank, cause=str(error)), None
    if again.error is not None or again.trajectory is None or result.trajectory is None:
        return replace(blank, cause=again.error or "no trajectory"), None
    cause, different = _cause(result, again), replace(blank, status=RerunStatus.DIFFERENT)
    (_, stored), (_, repeated) = result.trajectory.arrays(later=True), again.trajectory.arrays(later=True)
    if again.outcome is not result.outcome or stored.shape != repeated.shape:
        lengths = (
            f"{result.outcome.value} with {len(stored)} samples in the file, "
            f"{again.outcome.value} with {len(repeated)} here"
        )
        return replace(different, cause=f"{lengths}; {cause}"), again
    missing = object()
    names = {**result.settings, **again.settings}
    changed = [name for name in names if result.settings.get(name, missing) != again.settings.get(name, missing)]
    if changed and result.versions == again.versions:
        return replace(different, cause=f"settings in force differ: {', '.join(sorted(changed))}"), again
    both = np.isnan(stored) & np.isnan(repeated)
    apart = np.where(both, 0.0, np.nan_to_num(np.abs(stored - repeated), nan=np.inf))
    largest = float(apart.max())
    # A score reads one phase, so a difference must not be diluted by the samples that no score reads.
    squares = np.square(apart).sum(axis=1)
    rmse = max(float(np.sqrt(squares[phase::SAMPLES_PER_FRAME].mean())) for phase in range(SAMPLES_PER_FRAME))
    allowed = _allowed(result, np.where(both, 0.0, stored)[::SAMPLES_PER_FRAME])
    status = RerunStatus.CLOSE if rmse <= allowed else RerunStatus.DIFFERENT
    if largest == 0.0:
        status, cause = RerunStatus.EQUAL, ""
    return replace(blank, status=status, largest_difference=largest, rmse=rmse, allowed=allowed, cause=cause), again


def _allowed(result: Result, frames: NDArray[np.float64]) -> float:
    """Return the largest distance of a repeated trajectory that counts as the same."""
    baseline = published_baselines(result.id.removeprefix("GAUGE/")).get("rmse")
    motion = trajectory_rmse(frames, np.broadcast_to(frames[0], frames.shape))
    return RERUN_SHARE * (baseline.mean if baseline is not None and baseline.mean else motion)


def _cause(result: Result, again: Result) -> str:
    """Return what is known of the cause of a difference."""
    names = sorted({*result.versions, *again.versions})
    changed = [
        f"{name} {result.versions.get(name, 'none')} in the file, {again.versions.get(name, 'none')} here"
        for name in names
        if result.versions.get(name) != again.versions.get(name)
    ]
    if changed:
        return f"versions differ: {'; '.join(changed)}"
    return "versions are equal, so the processor, its libraries, a source of chance in the engine or the file differ"
