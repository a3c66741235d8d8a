"""Compare whole motions of an experiment: of two engines, presets or settings, or of result files of two machines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gauge_envs.errors import ParameterError
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.episodes import run_episodes
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import load_result
from gauge_envs.scene.jitter import Jitter
from gauge_envs.tools.compare import coordinate_words
from gauge_envs.tools.versions.gap import LEAST_LIMIT, NOISE_FACTOR
from gauge_envs.tools.versions.model import MotionComparison, Side, Verdict

if TYPE_CHECKING:
    from gauge_envs.runs.result import Result
    from gauge_envs.scene.geometry import FloatArray
    from gauge_envs.tools.compare import Comparison

PERTURBATION_M = 1e-9
"""Standard deviation of a start that nobody would call another one [m]."""


def compare_motions(
    subject: str, before: Side, after: Side, *, seed: int
) -> tuple[MotionComparison, Comparison]:
    """Return where two motions of an experiment part, and their scores beside each other.

    Args:
        subject: Id of the experiment.
        before: First side: an engine with settings, or a result file.
        after: Second side.
        seed: Seed of the runs.

    Raises:
        ParameterError: A result file is of another experiment, or has no trajectory.
    """
    from gauge_envs.tools.compare import compare

    sides = (before, after)
    results, noises = [], []
    for side in sides:
        plain, perturbed = _runs(subject, side, seed)
        results.append(plain[0])
        noises.append(_apart(plain[-1], perturbed)[1])
    times_s, gap = _apart(*results)
    count = min(len(gap), *map(len, noises))
    noise = np.max([one[:count] for one in noises], axis=(0, 2))
    # What chaos has made of a difference stays in what follows.
    noise = np.maximum.accumulate(noise)
    moved = _samples(results[0])[1]
    floor = LEAST_LIMIT * float(np.nanmax(np.abs(moved - moved[0]), initial=0.0))
    largest = np.max(gap[:count], axis=1)
    beyond = np.flatnonzero(largest > np.maximum(NOISE_FACTOR * noise, floor))
    at = int(beyond[0]) if len(beyond) else None
    verdict = Verdict.SAME if np.any(gap) else Verdict.IDENTICAL
    found = compare(results)
    trajectory = results[0].trajectory
    assert trajectory is not None
    names = trajectory.coordinates
    return MotionComparison(
        subject=subject,
        before=before.title,
        after=after.title,
        verdict=verdict if at is None else Verdict.DIFFERENT,
        unit=trajectory.unit,
        first_s=None if at is None else float(times_s[at]),
        coordinate=""
        if at is None
        else coordinate_words(names[int(np.argmax(gap[at]))]),
        difference=0.0 if at is None else float(largest[at]),
        largest=float(np.max(gap)),
        noise=float(noise[-1 if at is None else at]),
        right="" if at is None else _closer(found, results, sides),
    ), found


def _runs(subject: str, side: Side, seed: int) -> tuple[list[Result], Result]:
    """Return the motion of a side, behind it the same motion of this machine, and one of a start 1e-9 m apart."""
    plain = []
    request = RunRequest(
        subject, backend=side.engine or "mujoco", settings=side.settings, seed=seed
    )
    if side.file is not None:
        one = load_result(Path(side.file))
        if one.id != request.calibrated_experiment().id:
            raise ParameterError(f"{side.file} is a result of {one.id}, not {subject}")
        if one.trajectory is None or one.backend is None:
            raise ParameterError(f"{side.file} is no result of a run with a trajectory")
        plain.append(one)
        request = replace(
            request,
            backend=one.backend,
            settings=one.settings_given,
            parameters=one.parameters,
            seed=seed if one.seed is None else one.seed,
        )
    plain += run_episodes(request)
    (perturbed,) = run_episodes(
        replace(request, jitter=Jitter(position_m=PERTURBATION_M, angle_rad=0.0))
    )
    return plain, perturbed


def _samples(result: Result) -> tuple[FloatArray, FloatArray]:
    if result.trajectory is None:
        raise ParameterError(f"{result.backend} has no trajectory: {result.error}")
    return result.trajectory.arrays()


def _apart(one: Result, other: Result) -> tuple[FloatArray, FloatArray]:
    """Return the times that two motions have [s], and the distance of each coordinate there."""
    (times_s, first), (_, second) = _samples(one), _samples(other)
    count = min(len(first), len(second))
    # What is no number on one side is as far as can be.
    gap = np.nan_to_num(np.abs(first[:count] - second[:count]), nan=np.inf)
    return times_s[:count], gap


def _closer(found: Comparison, results: Sequence[Result], sides: Sequence[Side]) -> str:
    """Return the title of the side that is closer to the reference, if the scores are resolved; empty without one."""
    of_sides = [RunConfiguration.of(result) for result in results]
    for kind in found.kinds:
        for experiment in kind.experiments:
            for index, rank in experiment.ranks.items():
                if len(experiment.ranks) > 1 and rank.interval_95[1] == 1.0:
                    return sides[of_sides.index(found.configurations[index])].title
    return ""
