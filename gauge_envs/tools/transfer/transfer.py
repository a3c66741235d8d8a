"""Reward that policies were promised in training, against the reward that they keep in other worlds."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gauge_envs.errors import ParameterError
from gauge_envs.evaluation.dependence import LEVEL
from gauge_envs.evaluation.numerics import share_interval, student_quantile
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.transfer.estimates import Estimate
from gauge_envs.tools.transfer.policy_replays import (
    Replay,
    Replays,
    ReplayWorld,
    WorldKind,
)

FALL_SHARE = 0.9
"""A policy falls where it keeps less than this share of its promise, as far as the law allows that there."""


@dataclass(frozen=True, kw_only=True)
class WorldTransfer:
    """What policies keep in one world.

    Attributes:
        world: The world.
        reward: Mean reward of an episode.
        kept: Reward over the reward that was promised, both means over policies and starts.
        ratio: Mean of what was reached over what the law allows there; above 1 the engine pays too much.
        largest_ratio: Largest such ratio of an episode.
        z: Mean distance from the law's limit, in standard uncertainties of the limit.
        endings: Number of episodes by their ending.
        allowed: The largest reward that the law allows here, over that in the training. It is 1 for a task whose reward
            is a share of the limit.
        falls: Whether less than `FALL_SHARE` of the promise is kept, with the whole interval. The promise is first
            reduced to what the law allows where that is less.
    """

    world: ReplayWorld
    reward: Estimate
    kept: Estimate
    ratio: float
    largest_ratio: float
    z: float
    endings: Mapping[str, int]
    allowed: float
    falls: bool


@dataclass(frozen=True, kw_only=True)
class TransferReport:
    """Promise and what is kept of it.

    Attributes:
        task: Id of the task.
        policies: Names of the policies.
        starts: Number of starts.
        training: The training's world, where `kept` is 1.
        others: The other worlds, in the order of their replays.
        kept: Mean of `kept` over the other worlds; those that repeat another one count once.
        first_fall: The first world in which the policies fall: configurations before constants, small changes before
            large ones, and the worst of them; None if they fall nowhere.
        left_out: Reason for each world that could not be run, by its name.
        repeats: First other world with the same rewards to the last digit, by the name of each later one: what the two
            change does nothing to these policies, or the same.
    """

    task: str
    policies: tuple[str, ...]
    starts: int
    training: WorldTransfer
    others: tuple[WorldTransfer, ...]
    kept: Estimate
    first_fall: WorldTransfer | None
    left_out: Mapping[str, str]
    repeats: Mapping[str, str]

    @property
    def distinct(self) -> tuple[WorldTransfer, ...]:
        """The other worlds without those that repeat one before."""
        return tuple(row for row in self.others if row.world.name not in self.repeats)


def transfer_report(replays: Replays) -> TransferReport:
    """Return what policies keep of the reward that their training promised.

    Policies and starts are two crossed samples, because every policy runs from every start. The worlds are a fixed
    list. With one policy, an interval covers starts only.

    Args:
        replays: The episodes.
    """
    if len(replays.worlds) < 2:
        reasons = "; ".join(
            f"{name}: {reason}" for name, reason in replays.left_out.items()
        )
        raise ParameterError(
            f"{replays.task}: no world could be run besides the training. {reasons}".rstrip()
        )
    places = {world.name: number for number, world in enumerate(replays.worlds)}
    rewards = np.full((len(places), len(replays.policies), replays.starts), np.nan)
    for one in replays.episodes:
        rewards[places[one.world], replays.policies.index(one.policy), one.start] = (
            one.reward
        )
    promised = float(rewards[0].mean())
    if not promised > 0.0:
        raise ParameterError(
            f"{replays.task}: the policies earn {promised:.3g} in {replays.worlds[0].name}, where they were trained. "
            "Without a positive promise no share of it can be kept; state the training's engine and settings"
        )
    shares = rewards.mean(axis=(1, 2)) / promised
    # A share is a ratio of means: to first order its error is the mean of these deviations.
    deviations = (rewards - shares[:, None, None] * rewards[0]) / promised
    # Each episode of a world states the same.
    largest = {one.world: one.largest_reward for one in replays.episodes}
    rows = [
        _world(
            world,
            [one for one in replays.episodes if one.world == world.name],
            reward=estimate(float(rewards[number].mean()), rewards[number]),
            kept=Estimate(value=1.0)
            if number == 0
            else estimate(float(shares[number]), deviations[number]),
            allowed=largest[world.name] / largest[replays.worlds[0].name],
        )
        for number, world in enumerate(replays.worlds)
    ]
    others = tuple(rows[1:])
    repeats = {
        world.name: replays.worlds[first].name
        for number, world in enumerate(replays.worlds)
        if number > 0 and (first := _first_equal(rewards, number)) < number
    }
    counted = [
        number
        for number, row in enumerate(rows)
        if number > 0 and row.world.name not in repeats
    ]
    return TransferReport(
        task=replays.task,
        policies=replays.policies,
        starts=replays.starts,
        training=rows[0],
        others=others,
        kept=estimate(float(shares[counted].mean()), deviations[counted].mean(axis=0)),
        first_fall=min((row for row in others if row.falls), key=_order, default=None),
        left_out=replays.left_out,
        repeats=repeats,
    )


def _first_equal(rewards: FloatArray, number: int) -> int:
    """Return the first world besides the training whose rewards are bit for bit those of a world.

    Args:
        rewards: Rewards, the training first, shape [worlds, policies, starts].
        number: Number of the world, 1 or more.
    """
    return next(
        first
        for first in range(1, number + 1)
        if np.array_equal(rewards[first], rewards[number])
    )


def estimate(value: float, table: FloatArray) -> Estimate:
    """Return a mean with its interval, from what scatters about it or about zero, shape [policies, starts]."""
    means = [table.mean(axis=1 - axis) for axis in (0, 1) if table.shape[axis] > 1]
    if not means:
        return Estimate(value=value)
    half = _half_width(means)
    return Estimate(value=value, low=value - half, high=value + half)


def success_share(values: FloatArray) -> Estimate | None:
    """Return the share of successes with the exact interval of Clopper and Pearson."""
    if np.isnan(values).any():
        return None
    low, high = share_interval(float(values.sum()), len(values), LEVEL)
    return Estimate(value=float(values.mean()), low=low, high=high)


def _half_width(means: Sequence[FloatArray]) -> float:
    """Return half of the interval of a mean, from its means over policies and over starts.

    The mean squares of policies and of starts add up, with the degrees of freedom of Welch and Satterthwaite for
    Student's t. Both contain the scatter of single episodes, so this scatter counts twice: with few starts, a
    difference of three mean squares is often too small. Source: the variance of a two-way layout with random effects;
    GUM (JCGM 100:2008), annex G.4.
    """
    # Each variance of means over their number estimates a part of the variance of the mean.
    parts = [float(one.var(ddof=1)) / len(one) for one in means]
    variance = sum(parts)
    if variance <= 0.0:
        return 0.0
    freedom = variance**2 / sum(
        part**2 / (len(one) - 1) for part, one in zip(parts, means, strict=True)
    )
    return student_quantile(freedom, 0.5 * (1.0 + LEVEL)) * math.sqrt(variance)


def _world(
    world: ReplayWorld,
    episodes: Sequence[Replay],
    *,
    reward: Estimate,
    kept: Estimate,
    allowed: float,
) -> WorldTransfer:
    ratios = [one.report.ratio for one in episodes]
    highest = kept.value if kept.high is None else kept.high
    return WorldTransfer(
        world=world,
        reward=reward,
        kept=kept,
        ratio=float(np.mean(ratios)),
        largest_ratio=max(ratios),
        z=float(np.mean([one.report.z for one in episodes])),
        endings=dict(Counter(one.report.ending.value for one in episodes)),
        allowed=allowed,
        falls=world.kind is not WorldKind.TRAINING
        and highest < FALL_SHARE * min(1.0, allowed),
    )


def _order(row: WorldTransfer) -> tuple[bool, float, float]:
    return (row.world.kind is WorldKind.CONSTANT, abs(row.world.sigmas), row.kept.value)
