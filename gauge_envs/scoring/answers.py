"""Answers to the two questions of a score: does the motion solve the scene, and is it like reality? If not, why?"""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.references.published import PUBLISHED_TRIALS, Baseline
from gauge_envs.scoring.interval import (
    COVERAGE_FACTOR,
    ONE_SIDED,
    prediction_limit,
    student_limit,
)

MATTERING_SHARE = 0.02
"""Smallest distance from a solution that matters, over the size of the motion.

An engine that is closer changes a constant that is fitted to the motion by about 2 %, which is what the friction of the
slides and the restitution of the ball are known to. A constant that is wrong by 20 % moves a body ten times as far.
"""

MATTERING_TRIAL_SHARE = 0.5
"""Smallest distance from an exact motion that matters, over the mean distance of a real trial.

By the triangle inequality, a closer engine changes the normalized distance from real trials by at most 0.5."""

INVISIBLE_MM = 0.1
"""Distance that never matters [mm]: a tenth of the millimetre that the paper states for its motion capture."""

TELLING_SHARE = 0.2
"""Largest limit that can tell a motion from one with an error of 20 %, over the size of the motion."""


class Answer(StrEnum):
    """Answer to a question about a motion."""

    YES = "yes"
    NO = "no"
    CANNOT_TELL = "cannot tell"
    """The reference is too uncertain."""


def within(distance: float, limit: float, uncertainty: float = 0.0) -> Answer:
    """Return whether a distance is at most a limit, with the guard bands of JCGM 106: 1.96 u on both sides."""
    half_width = COVERAGE_FACTOR * uncertainty
    if distance + half_width <= limit:
        return Answer.YES
    return Answer.NO if distance - half_width > limit else Answer.CANNOT_TELL


def mattering_distance(
    motion: float, unit: str, of_trials: float | None = None
) -> float:
    """Return the smallest distance from the exact motion or a solution that matters.

    Args:
        motion: Root mean square displacement of the solution, in the unit.
        unit: Unit of the distance.
        of_trials: Mean distance of a real trial, in the unit; None without trials.
    """
    distance = MATTERING_SHARE * motion
    if of_trials is not None:
        distance = min(distance, MATTERING_TRIAL_SHARE * of_trials)
    return max(distance, INVISIBLE_MM) if unit == "mm" else distance


def solves(band: Band, distance: float) -> Answer:
    """Return whether a motion at a distance from a solution solves its scene."""
    limit = mattering_distance(band.zero_motion_distance, band.compared.unit)
    return within(distance, limit, band.standard_uncertainty)


def real_limit(experiment: Experiment, band: Band, *, is_aligned: bool) -> float:
    """Return the distance within which one more real trial lies with a probability of 95 %.

    Five or more single trials, or the published distances of 20, predict it by their distances. Fewer trials predict it
    by their scatter, and a recording of one trial by its u, which includes the published scatter.
    """
    of_trials = band.trial_rmse_aligned if is_aligned else band.trial_rmse
    limit = None if of_trials is None else prediction_limit(of_trials)
    if limit is not None:
        return limit
    published = normalizing_baselines(experiment, band).get("rmse")
    if band.kind is Kind.PUBLISHED and published is not None:
        half_width = student_limit(PUBLISHED_TRIALS, ONE_SIDED)
        return published.mean + half_width * (published.std or 0.0)
    count = band.trial_count
    if band.kind is Kind.TRIALS and count is not None and count > 1:
        return student_limit(count) * band.compared.length(band.compared.sigma)
    return COVERAGE_FACTOR * band.standard_uncertainty


def is_like_trials(band: Band, distance: float, limit: float) -> Answer:
    """Return whether a motion is as close to real trials as one more trial would be, see `real_limit`.

    A limit above 20 % of the motion cannot tell. The mean of published numbers has an uncertainty of its own.
    """
    uncertainty = band.standard_uncertainty if band.kind is Kind.PUBLISHED else 0.0
    answer = within(distance, limit, uncertainty)
    is_telling = limit <= TELLING_SHARE * band.zero_motion_distance
    return answer if is_telling or answer is Answer.NO else Answer.CANNOT_TELL


def united(answers: Iterable[Answer | None]) -> Answer | None:
    """Return `no` if one answer is no, `yes` if all are yes; None without answers."""
    known = {answer for answer in answers if answer is not None}
    order = (Answer.NO, Answer.CANNOT_TELL, Answer.YES)
    return min(known, key=order.index, default=None)


def normalizing_baselines(experiment: Experiment, band: Band) -> dict[str, Baseline]:
    """Return the published distances of real trials that normalize scores, by metric; empty if there are none."""
    is_normalized = band.normalized and not band.kind.is_solution
    if not is_normalized:
        return {}
    return {
        metric: row
        for metric, row in experiment.baselines.items()
        if row.mean and not row.disputed
    }


def baseline_means(experiment: Experiment, band: Band) -> dict[str, float]:
    """Return the mean distances of real trials by which `rmse`, `dtw` and `rmse_aligned` are divided, where known."""
    published = normalizing_baselines(experiment, band)
    means = {metric: row.mean for metric, row in published.items()}
    if band.trial_rmse_aligned is not None and band.trial_rmse_aligned.any():
        means["rmse_aligned"] = float(band.trial_rmse_aligned.mean())
    return means


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
