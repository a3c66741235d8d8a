"""Compare whole episodes: motions of an experiment, and returns of a policy."""

from collections.abc import Iterable, Sequence

import numpy as np

from gauge_envs.errors import ParameterError, ResultFileError
from gauge_envs.experiments.variants import find_variant
from gauge_envs.reading import faults_of
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.result import RecordedTrajectory, Result
from gauge_envs.runs.result_file import parse_result
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scoring.interval import mean_half_width
from gauge_envs.tools.compare import ScoreComparison, compare
from gauge_envs.tools.versions.comparison import MIN_LIMIT, NOISE_FACTOR
from gauge_envs.tools.versions.environments import Arrays, work
from gauge_envs.tools.versions.schema import (
    Estimate,
    MotionComparison,
    ReturnComparison,
    Side,
    VersionsVerdict,
)
from gauge_envs.tools.versions.subject import is_suite_id


def compare_motions(
    subject: str, before: Side, after: Side, *, seed: int
) -> tuple[MotionComparison, ScoreComparison]:
    """Return the first and the largest difference of two motions of an experiment, and the scores of both.

    Args:
        subject: Id of the experiment.
        before: First side: an engine with settings or a release of an engine.
        after: Second side.
        seed: Seed of the runs.

    Raises:
        ParameterError: A side has no trajectory.
        VersionsError: A side cannot run the experiment.
    """
    job = {"title": subject, "subject": subject, "seed": seed}
    outputs = work("simulate", job, [before, after])
    results, shifted = (_results(outputs, index, subject) for index in range(2))
    trajectories = [_trajectory(result) for result in (*results, *shifted)]
    times_s, _ = trajectories[0].arrays()
    motions = [trajectory.arrays()[1] for trajectory in trajectories]
    count = min(map(len, motions))
    # Shape [runs, times, coordinates].
    positions = np.array([motion[:count] for motion in motions])
    distances = _distances(positions[0], positions[1])
    # Chaotic growth persists, so the noise never decreases.
    changes = _distances(positions[:2], positions[2:]).max(axis=0)
    noise = np.maximum.accumulate(changes)
    moved = float(np.nanmax(np.abs(positions - positions[:, :1]), initial=0.0))
    limit = np.maximum(NOISE_FACTOR * noise, MIN_LIMIT * moved)
    scores = compare(results)
    differing = np.flatnonzero(distances > limit).tolist()
    verdict, first_s, right = VersionsVerdict.SAME, None, ""
    if differing:
        verdict = VersionsVerdict.DIFFERENT
        first_s = float(times_s[differing[0]])
        noise = noise[: differing[0] + 1]
        sides = zip((before, after), results, strict=True)
        right = _closer_side(scores, sides)
    comparison = MotionComparison(
        subject=subject,
        before=before.title,
        after=after.title,
        verdict=verdict,
        unit=trajectories[0].unit,
        first_s=first_s,
        largest=float(np.max(distances)),
        largest_s=float(times_s[np.argmax(distances)]),
        noise=float(noise[-1]),
        right=right,
    )
    return comparison, scores


def _results(outputs: Sequence[Arrays], index: int, subject: str) -> list[Result]:
    """Return a result of each side: 0 is the run, 1 the run from a shifted position."""
    texts = [str(output["results"][index]) for output in outputs]
    with faults_of(subject, ResultFileError, "a result"):
        return [parse_result(text.encode()) for text in texts]


def _closer_side(scores: ScoreComparison, sides: Iterable[tuple[Side, Result]]) -> str:
    """Return the title of the side that surely ranks first; empty without one.

    It is closer to the reference, beyond the uncertainty.
    """
    first = [
        scores.configurations[index]
        for kind in scores.kinds
        for ranks in kind.ranks.values()
        for index, rank in ranks.items()
        if len(ranks) > 1 and rank.interval_95[1] == 1.0
    ]
    for side, result in sides:
        if RunConfiguration.of(result) in first:
            return side.title
    return ""


def _trajectory(result: Result) -> RecordedTrajectory:
    """Return the trajectory of a result."""
    if result.trajectory is None:
        raise ParameterError(f"{result.backend} has no trajectory: {result.error}")
    return result.trajectory


def _distances(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the largest difference of a coordinate at each time; infinite if one side is NaN."""
    return np.nan_to_num(np.abs(first - second), nan=np.inf).max(axis=-1)


def compare_returns(
    subject: str,
    before: Side,
    after: Side,
    *,
    policy: str,
    seeds: int,
    seed: int,
) -> ReturnComparison:
    """Return the returns of a policy on two sides, from the same seeds.

    Args:
        subject: Id of Gymnasium or of this suite, or `module:function` that returns an environment.
        before: First side.
        after: Second side.
        policy: `module:function` that returns a policy, or a file .npy with a row for each action.
        seeds: Number of episodes.
        seed: Seed of the first episode.

    Raises:
        ParameterError: A side is another engine, or the policy is invalid.
        VersionsError: A side cannot run the episodes.
    """
    for side in (before, after):
        if side.engine not in ("", "mujoco"):
            raise ParameterError(
                f"{side.title}: --policy compares releases of MuJoCo and its options"
            )
    if ":" not in policy and not policy.endswith(".npy"):
        raise ParameterError(
            f"--policy {policy}: expected module:function that returns a policy, or a file .npy of actions"
        )
    is_suite = is_suite_id(subject)
    job = {
        "title": subject,
        "subject": f"gauge_envs:{find_variant(subject).id}" if is_suite else subject,
        "policy": policy,
        "episodes": seeds,
        "seed": seed,
    }
    first, second = work("play", job, [before, after])
    changes = second["returns"] - first["returns"]
    change = float(np.mean(changes))
    half = mean_half_width(changes) if seeds > 1 else np.nan
    return ReturnComparison(
        subject=subject,
        before=before.title,
        after=after.title,
        verdict=VersionsVerdict.DIFFERENT
        if abs(change) > half
        else VersionsVerdict.SAME,
        versions=(str(first["version"]), str(second["version"])),
        seeds=seeds,
        returns=(float(np.mean(first["returns"])), float(np.mean(second["returns"]))),
        change=Estimate(value=change, low=change - half, high=change + half),
    )
