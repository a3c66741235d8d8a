"""Compare whole episodes: motions of an experiment, and returns of a policy."""

from __future__ import annotations

import os
import sys
import sysconfig
from collections.abc import Sequence
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
from gauge_envs.tools.compare import coordinate_words
from gauge_envs.tools.versions.differences import MIN_LIMIT, NOISE_FACTOR
from gauge_envs.tools.versions.environments import (
    NUMPY_2_SINCE,
    WORKER,
    Bench,
    make_environment,
    run_process,
    version_key,
)
from gauge_envs.tools.versions.schema import (
    Estimate,
    MotionComparison,
    ReturnComparison,
    Side,
    Verdict,
)
from gauge_envs.tools.versions.sides import is_suite_id

if TYPE_CHECKING:
    from gauge_envs.runs.result import RecordedTrajectory, Result
    from gauge_envs.tools.compare import Comparison as ScoreComparison

PERTURBATION_M = 1e-9
"""Standard deviation of an initial position that nobody would call another one [m]."""


# --- motions of an experiment ----------------------------------------------------------------------------------------


def compare_motions(
    subject: str,
    before: Side,
    after: Side,
    *,
    seed: int,
) -> tuple[MotionComparison, ScoreComparison]:
    """Return where two motions of an experiment differ first, and the scores of both.

    Args:
        subject: Id of the experiment.
        before: First side: an engine with settings, a release of an engine, or a result file.
        after: Second side.
        seed: Seed of the runs.

    Raises:
        ParameterError: A result file belongs to another experiment, or has no trajectory.
        VersionsError: A release cannot run the experiment.
    """
    from gauge_envs.tools.compare import compare

    sides = (before, after)
    results, noises = [], []
    for side in sides:
        result, noise = _motion(subject, side, seed)
        results.append(result)
        noises.append(noise)
    distances = _distances(*results)
    count = min(map(len, (distances, *noises)))
    # Chaos that grew stays in what follows.
    noise = np.max([each[:count] for each in noises], axis=(0, 2))
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
        comparison = replace(
            comparison,
            verdict=Verdict.DIFFERENT,
            first_s=float(times_s[index]),
            coordinate=coordinate_words(trajectory.coordinates[coordinate]),
            difference=float(distances[index, coordinate]),
            noise=float(noise[index]),
            right=_closer(scores, results, sides),
        )
    return comparison, scores


def _motion(subject: str, side: Side, seed: int) -> tuple[Result, FloatArray]:
    """Return the motion of a side, and by how much each coordinate of a perturbed motion differs from it."""
    request = RunRequest(
        subject, backend=side.engine or "mujoco", settings=side.settings, seed=seed
    )
    stored = None
    if side.file is not None:
        stored = load_result(Path(side.file))
        if stored.id != request.calibrated_experiment().id:
            raise ParameterError(
                f"{side.file} is a result of {stored.id}, not {subject}"
            )
        request = replace(
            request,
            backend=stored.backend or "mujoco",
            settings=stored.settings_given,
            parameters=stored.parameters,
            seed=seed if stored.seed is None else stored.seed,
        )
    plain = _run(request, side)
    jitter = Jitter(position_m=PERTURBATION_M, angle_rad=0.0)
    perturbed = _run(replace(request, jitter=jitter), side)
    return stored or plain, _distances(plain, perturbed)


def _run(request: RunRequest, side: Side) -> Result:
    """Run an experiment; with a release of an engine, by `gauge run` in a process that imports it."""
    if not side.requirement:
        return run_episodes(request)[0]
    python = make_environment(side.requirement)
    experiment_id = request.calibrated_experiment().id
    with TemporaryDirectory(prefix="gauge-versions-") as folder:
        code = "from gauge_envs.cli.app import main; main()"
        command = [sys.executable, "-c", code, "run", experiment_id, "--out", folder]
        command += ["--backend", side.engine, "--seed", str(request.seed)]
        command += [f"--set={name}={value}" for name, value in side.settings.items()]
        if request.jitter is not None:
            command.append(f"--jitter={1e3 * PERTURBATION_M}mm")
        variables = {"PYTHONPATH": _packages_folder(python)}
        run_process(command, f"{side.title} cannot run {experiment_id}", variables)
        (file,) = Path(folder).rglob("*.json")
        return load_result(file)


def _packages_folder(python: Path) -> str:
    """Return the folder of the packages of a virtual environment."""
    base = str(python.parents[1])
    return sysconfig.get_path("platlib", "venv", {"base": base, "platbase": base})


def _trajectory(result: Result) -> RecordedTrajectory:
    """Return the trajectory of a result."""
    if result.trajectory is None:
        raise ParameterError(f"{result.backend} has no trajectory: {result.error}")
    return result.trajectory


def _distances(first: Result, second: Result) -> FloatArray:
    """Return the distance of each coordinate of two motions at their common times."""
    motions = [_trajectory(result).arrays()[1] for result in (first, second)]
    count = min(map(len, motions))
    # Where one side is not a number, the distance is infinite.
    return np.nan_to_num(np.abs(motions[0][:count] - motions[1][:count]), nan=np.inf)


def _closer(
    scores: ScoreComparison, results: Sequence[Result], sides: Sequence[Side]
) -> str:
    """Return the title of the side that is closer to the reference, if the scores are resolved; empty without one."""
    configurations = [RunConfiguration.of(result) for result in results]
    experiments = [each for kind in scores.kinds for each in kind.experiments]
    for experiment in experiments:
        for index, rank in experiment.ranks.items():
            if len(experiment.ranks) > 1 and rank.interval_95[1] == 1.0:
                configuration = scores.configurations[index]
                return sides[configurations.index(configuration)].title
    return ""


# --- returns of a policy ---------------------------------------------------------------------------------------------


class PolicyBench(Bench):
    """A bench whose worker runs in the user's Python, where the environment and the policy are."""

    def execute(self, side: Side, file: Path) -> None:
        """Run the worker with MuJoCo of the release, and all else from where the user has it."""
        variables = {}
        if side.requirement:
            links = file.with_suffix(".packages")
            _link_release(side.requirement, links)
            paths = os.environ.get("PYTHONPATH", "")
            variables["PYTHONPATH"] = f"{links}{os.pathsep}{paths}"
        command = [side.python or sys.executable, "-B", str(WORKER), str(file)]
        run_process(command, f"{side.title} cannot run {self.title}", variables)


def _link_release(requirement: str, folder: Path) -> None:
    """Link MuJoCo of a release into a folder, and NumPy if the release needs an older one."""
    folder.mkdir()
    packages = Path(_packages_folder(make_environment(requirement)))
    names = ["mujoco"]
    if version_key(requirement.partition("==")[2]) < NUMPY_2_SINCE:
        names += ["numpy", "numpy.libs"]
    for name in names:
        (folder / name).symlink_to(packages / name)


def compare_returns(
    subject: str,
    before: Side,
    after: Side,
    *,
    policy: str,
    seeds: int,
    seed: int,
) -> ReturnComparison:
    """Return what a policy reaches on two sides, from the same seeds.

    Args:
        subject: Id of Gymnasium or of this suite, or `module:function` that makes an environment.
        before: First side.
        after: Second side.
        policy: `module:function` that returns a policy, or a file .npy of actions, a row each.
        seeds: Number of episodes.
        seed: Seed of the first.

    Raises:
        ParameterError: The policy is neither.
        VersionsError: A side cannot play the episodes.
    """
    for side in (before, after):
        if side.file or side.engine not in ("", "mujoco"):
            raise ParameterError(
                f"{side.title}: --policy compares releases of MuJoCo and its options"
            )
    if not Path(policy).is_file() if policy.endswith(".npy") else ":" not in policy:
        raise ParameterError(
            f"--policy {policy}: expected module:function that returns a policy, or an existing file .npy of actions"
        )
    env_id = (
        f"gauge_envs:{find_variant(subject).id}" if is_suite_id(subject) else subject
    )
    job = {"subject": env_id, "policy": policy, "episodes": seeds, "seed": seed}
    bench = PolicyBench(title=subject, job=job)
    outputs = bench.work("play", (before, after))
    first, second = (output.arrays["returns"] for output in outputs)
    change = _mean(second - first)
    success: tuple[Estimate | None, Estimate | None] = (None, None)
    success_change = None
    successes, others = (output.arrays["successes"] for output in outputs)
    if not np.isnan([successes, others]).any():
        success = (_share(successes), _share(others))
        success_change = _mean(others - successes)
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
    """Return the mean over seeds with the interval of Student's t; a single value has no interval."""
    mean, count = float(np.mean(values)), len(values)
    if count < 2:
        return Estimate(value=mean)
    half = float(stdtrit(count - 1, 0.975) * np.std(values, ddof=1)) / count**0.5
    return Estimate(value=mean, low=mean - half, high=mean + half)


def _share(values: FloatArray) -> Estimate:
    """Return the share of successes with the exact interval of Clopper and Pearson."""
    interval = binomtest(int(np.sum(values)), len(values)).proportion_ci()
    mean = float(np.mean(values))
    return Estimate(value=mean, low=float(interval.low), high=float(interval.high))


def _excludes_zero(change: Estimate | None) -> bool:
    """Return whether an interval is without 0."""
    if change is None or change.low is None or change.high is None:
        return False
    return change.low * change.high > 0.0
