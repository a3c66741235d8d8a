"""Compare whole episodes: motions of an experiment, and returns of a policy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import stdtrit
from scipy.stats import binomtest

from gauge_envs.errors import ParameterError
from gauge_envs.experiments.variants import find_variant
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.episodes import run_episodes
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import load_result
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.jitter import Jitter
from gauge_envs.tools.compare import compare, coordinate_words
from gauge_envs.tools.versions.comparison import MIN_LIMIT, NOISE_FACTOR
from gauge_envs.tools.versions.environments import Bench, run_python
from gauge_envs.tools.versions.schema import (
    Estimate,
    MotionComparison,
    ReturnComparison,
    Side,
    Verdict,
)
from gauge_envs.tools.versions.subject import is_suite_id

if TYPE_CHECKING:
    from gauge_envs.runs.result import RecordedTrajectory, Result
    from gauge_envs.tools.compare import Comparison as ScoreComparison

JITTER = Jitter(position_m=1e-9, angle_rad=0.0)
"""Negligible change of the initial position."""


# --- motions of an experiment ----------------------------------------------------------------------------------------


def compare_motions(
    subject: str,
    before: Side,
    after: Side,
    *,
    seed: int,
) -> tuple[MotionComparison, ScoreComparison]:
    """Return the first difference of two motions of an experiment, and the scores of both.

    Args:
        subject: Id of the experiment.
        before: First side: an engine with settings or a release of an engine.
        after: Second side.
        seed: Seed of the runs.

    Raises:
        ParameterError: A side has no trajectory.
        VersionsError: A release cannot run the experiment.
    """
    sides = (before, after)
    results, noises = [], []
    for side in sides:
        plain = _run(subject, side, seed, None)
        noises.append(_distances(plain, _run(subject, side, seed, JITTER)))
        results.append(plain)
    distances = _distances(*results)
    count = min(map(len, (distances, *noises)))
    # Chaotic growth persists, so the noise never decreases.
    noise = np.max([changes[:count] for changes in noises], axis=(0, 2))
    noise = np.maximum.accumulate(noise)
    trajectory = _trajectory(results[0])
    times_s, positions = trajectory.arrays()
    moved = float(np.nanmax(np.abs(positions - positions[0]), initial=0.0))
    limit = np.maximum(NOISE_FACTOR * noise, MIN_LIMIT * moved)
    parted = np.flatnonzero(np.max(distances[:count], axis=1) > limit)
    scores = compare(results)
    comparison = MotionComparison(
        subject=subject,
        before=before.title,
        after=after.title,
        verdict=Verdict.SAME if np.any(distances) else Verdict.IDENTICAL,
        unit=trajectory.unit,
        largest=float(np.max(distances)),
        noise=float(noise[-1]),
    )
    for index in parted[:1]:
        coordinate = int(np.argmax(distances[index]))
        titles = [
            side.title
            for side, result in zip(sides, results, strict=True)
            if _is_closest(result, scores)
        ]
        comparison = replace(
            comparison,
            verdict=Verdict.DIFFERENT,
            first_s=float(times_s[index]),
            coordinate=coordinate_words(trajectory.coordinates[coordinate]),
            difference=float(distances[index, coordinate]),
            noise=float(noise[index]),
            right="".join(titles),
        )
    return comparison, scores


def _run(subject: str, side: Side, seed: int, jitter: Jitter | None) -> Result:
    """Run an experiment; a release of an engine runs by `gauge run` in a process that imports it."""
    request = RunRequest(
        subject, backend=side.engine, settings=side.settings, seed=seed, jitter=jitter
    )
    if not side.requirement:
        return run_episodes(request)[0]
    with TemporaryDirectory(prefix="gauge-versions-") as folder:
        code = "from gauge_envs.cli.app import main; main()"
        command = ["-c", code, "run", subject, "--out", folder]
        command += ["--backend", side.engine, "--seed", str(seed)]
        command += [f"--set={name}={value}" for name, value in side.settings.items()]
        if jitter is not None:
            command.append(f"--jitter={1e3 * jitter.position_m}mm")
        run_python(side, command, subject)
        (file,) = Path(folder).rglob("*.json")
        return load_result(file)


def _trajectory(result: Result) -> RecordedTrajectory:
    """Return the trajectory of a result."""
    if result.trajectory is None:
        raise ParameterError(f"{result.backend} has no trajectory: {result.error}")
    return result.trajectory


def _distances(first: Result, second: Result) -> FloatArray:
    """Return the distance of each coordinate of two motions at their common times."""
    motions = [_trajectory(result).arrays()[1] for result in (first, second)]
    count = min(map(len, motions))
    # If one side is NaN, the distance is infinite.
    return np.nan_to_num(np.abs(motions[0][:count] - motions[1][:count]), nan=np.inf)


def _is_closest(result: Result, scores: ScoreComparison) -> bool:
    """Return whether a result is closer to the reference than the other result, beyond the uncertainty."""
    index = scores.configurations.index(RunConfiguration.of(result))
    ranks = [rank for kind in scores.kinds for rank in kind.ranks.values()]
    return any(
        len(rank) > 1 and index in rank and rank[index].interval_95[1] == 1.0
        for rank in ranks
    )


# --- returns of a policy ---------------------------------------------------------------------------------------------


def compare_returns(
    subject: str,
    before: Side,
    after: Side,
    *,
    policy: str,
    seeds: int,
    seed: int,
) -> ReturnComparison:
    """Return the returns and successes of a policy on two sides, from the same seeds.

    Args:
        subject: Id of Gymnasium or of this suite, or `module:function` that returns an environment.
        before: First side.
        after: Second side.
        policy: `module:function` that returns a policy, or a file .npy with a row for each action.
        seeds: Number of episodes.
        seed: Seed of the first episode.

    Raises:
        ParameterError: The policy is invalid.
        VersionsError: A side cannot run the episodes.
    """
    sides = (before, after)
    for side in sides:
        if side.engine not in ("", "mujoco"):
            raise ParameterError(
                f"{side.title}: --policy compares releases of MuJoCo and its options"
            )
    if not Path(policy).is_file() if policy.endswith(".npy") else ":" not in policy:
        raise ParameterError(
            f"--policy {policy}: expected module:function that returns a policy, or an existing file .npy of actions"
        )
    is_suite = is_suite_id(subject)
    env_id = f"gauge_envs:{find_variant(subject).id}" if is_suite else subject
    job = {"subject": env_id, "policy": policy, "episodes": seeds, "seed": seed}
    outputs = Bench(title=subject, job=job).work("play", sides)
    first, second = (output.arrays["returns"] for output in outputs)
    change = _mean(second - first)
    success: tuple[Estimate | None, Estimate | None] = (None, None)
    success_change = None
    first_successes, second_successes = (
        output.arrays["successes"] for output in outputs
    )
    if not np.isnan([first_successes, second_successes]).any():
        success = (_share(first_successes), _share(second_successes))
        success_change = _mean(second_successes - first_successes)
    verdict = Verdict.SAME
    if np.array_equal(first, second):
        verdict = Verdict.IDENTICAL
    elif _excludes_zero(change) or _excludes_zero(success_change):
        verdict = Verdict.DIFFERENT
    return ReturnComparison(
        subject=subject,
        before=before.title,
        after=after.title,
        verdict=verdict,
        versions=(outputs[0].description["version"], outputs[1].description["version"]),
        seeds=seeds,
        returns=(_mean(first), _mean(second)),
        change=change,
        success=success,
        success_change=success_change,
    )


def _mean(values: FloatArray) -> Estimate:
    """Return the mean over seeds with Student's interval; a single value has no interval."""
    mean, count = float(np.mean(values)), len(values)
    if count < 2:
        return Estimate(value=mean)
    half = float(stdtrit(count - 1, 0.975) * np.std(values, ddof=1)) / count**0.5
    return Estimate(value=mean, low=mean - half, high=mean + half)


def _share(values: FloatArray) -> Estimate:
    """Return the share of successes with its exact interval (Clopper and Pearson)."""
    share = binomtest(int(np.sum(values)), len(values))
    interval = share.proportion_ci()
    return Estimate(
        value=share.statistic, low=float(interval.low), high=float(interval.high)
    )


def _excludes_zero(change: Estimate | None) -> bool:
    """Return whether an interval excludes 0."""
    if change is None or change.low is None or change.high is None:
        return False
    return change.low * change.high > 0.0
