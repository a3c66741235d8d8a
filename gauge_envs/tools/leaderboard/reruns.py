"""Run a sample of a submission's episodes again, and compare their trajectories."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import combinations
from operator import itemgetter

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

REPEATS, REPEAT_FACTOR = 5, 3.0
"""Runs of an engine that does not repeat its bits, and the largest distance from the nearest of them, in multiples of
the largest between them. Of further runs that scatter normally in one coordinate, 0.2 % are farther away."""


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


def rerun_sample(
    results: Sequence[Result], count: int, *, content_sha256: str, salt: str = ""
) -> list[Result]:
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
    return _compared(result, again, request), again


def _compared(result: Result, again: Result, request: RunRequest) -> Rerun:
    """Return how a result compares with another run of its episode."""
    assert result.trajectory is not None and again.trajectory is not None
    unit = result.score.unit
    cause = _cause(result, again)
    different = Rerun(id=result.id, status=RerunStatus.DIFFERENT, unit=unit)
    stored = result.trajectory.arrays(later=True)[1]
    repeated = again.trajectory.arrays(later=True)[1]
    if again.outcome is not result.outcome or stored.shape != repeated.shape:
        in_file = f"{result.outcome.value} with {len(stored)} samples in the file"
        here = f"{again.outcome.value} with {len(repeated)} here"
        return replace(different, cause=f"{in_file}, {here}; {cause}")
    missing = object()
    names = sorted({**result.settings, **again.settings})
    changed = [
        name
        for name in names
        if result.settings.get(name, missing) != again.settings.get(name, missing)
    ]
    if changed and result.versions == again.versions:
        return replace(
            different, cause=f"settings in force differ: {', '.join(changed)}"
        )
    largest, rmse = _distance(stored, repeated)
    allowed = _allowed(result, np.nan_to_num(stored)[::SAMPLES_PER_FRAME])
    if rmse > allowed:
        # The engine may not repeat its bits: further runs show how far apart they are.
        alike = [repeated]
        for one in run_many([request] * (REPEATS - 1), isolate=None):
            if one.trajectory is not None:
                samples = one.trajectory.arrays(later=True)[1]
                alike += [samples] if samples.shape == stored.shape else []
        spread = max(
            (_distance(one, other)[1] for one, other in combinations(alike, 2)),
            default=0.0,
        )
        if 0.0 < spread < np.inf:
            largest, rmse = min(
                (_distance(stored, one) for one in alike), key=itemgetter(1)
            )
            allowed = max(allowed, REPEAT_FACTOR * spread)
            cause = f"runs of this engine differ by up to {spread:.3g} {unit} RMS here; {cause}"
    status = RerunStatus.CLOSE if rmse <= allowed else RerunStatus.DIFFERENT
    if largest == 0.0:
        status = RerunStatus.EQUAL
        cause = ""
    return replace(
        different,
        status=status,
        largest_difference=largest,
        rmse=rmse,
        allowed=allowed,
        cause=cause,
    )


def _distance(
    one: NDArray[np.float64], other: NDArray[np.float64]
) -> tuple[float, float]:
    """Return the largest difference of two trajectories, and the distance of the phase that is farthest."""
    both = np.isnan(one) & np.isnan(other)
    apart = np.where(both, 0.0, np.nan_to_num(np.abs(one - other), nan=np.inf))
    # A score reads one phase, so a difference must not be diluted by the samples that no score reads.
    squares = np.square(apart).sum(axis=1)
    phases = (
        squares[phase::SAMPLES_PER_FRAME].mean() for phase in range(SAMPLES_PER_FRAME)
    )
    return float(apart.max()), float(np.sqrt(max(phases)))


def _allowed(result: Result, frames: NDArray[np.float64]) -> float:
    """Return the largest distance of a repeated trajectory that counts as the same."""
    baseline = published_baselines(result.id.removeprefix("GAUGE/")).get("rmse")
    motion = trajectory_rmse(frames, np.broadcast_to(frames[0], frames.shape))
    return RERUN_SHARE * (
        baseline.mean if baseline is not None and baseline.mean else motion
    )


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
