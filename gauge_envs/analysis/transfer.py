"""Reward that policies were promised in training, against the reward that they keep in other worlds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import ParameterError
from gauge_envs.runs.policy_replays import Replay, Replays, ReplayWorld, WorldKind

__all__ = ["FALL_SHARE", "Estimate", "TransferReport", "WorldTransfer", "transfer_report"]

FALL_SHARE = 0.9
"""A policy falls where it keeps less than this share of its promise, as far as the law allows that there."""

DRAWS = 2000
"""Number of bootstrap draws; their noise is about a hundredth of the width of an interval."""

PERCENTILES = (2.5, 97.5)


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A mean with its 95 % bootstrap interval.

    Attributes:
        value: The mean.
        low: Lower end; None with a single episode, which has no interval.
        high: Upper end; None with a single episode.
    """

    value: float
    low: float | None = None
    high: float | None = None


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
        kept: Mean of `kept` over the other worlds, which count equally.
        first_fall: The first world in which the policies fall: configurations before constants, small changes before
            large ones, and the worst of them; None if they fall nowhere.
        left_out: Reason for each world that could not be run, by its name.
    """

    task: str
    policies: tuple[str, ...]
    starts: int
    training: WorldTransfer
    others: tuple[WorldTransfer, ...]
    kept: Estimate
    first_fall: WorldTransfer | None
    left_out: Mapping[str, str]


def transfer_report(replays: Replays, *, seed: int = 0) -> TransferReport:
    """Return what policies keep of the reward that their training promised.

    Policies and starts are drawn with replacement, each on its own, because every policy runs from every start. The
    worlds are a fixed list and are not drawn. With one policy, an interval covers starts only.

    Args:
        replays: The episodes.
        seed: Seed of the draws.

    Raises:
        ParameterError: There is no world but the training, or the reward that was promised is not positive.
    """
    if len(replays.worlds) < 2:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in replays.left_out.items())
        raise ParameterError(f"{replays.task}: no world could be run besides the training. {reasons}".rstrip())
    rewards = _rewards(replays)
    promised = float(rewards[0].mean())
    if not promised > 0.0:
        raise ParameterError(
            f"{replays.task}: the policies earn {promised:.3g} in {replays.worlds[0].name}, where they were trained. "
            "Without a positive promise no share of it can be kept; state the training's engine and settings"
        )
    drawn = _drawn_means(rewards, seed)
    shares = None if drawn is None else drawn[:, 1:] / drawn[:, :1]
    largest = [_largest_reward(replays, world.name) for world in replays.worlds]
    rows = [
        _world(
            world,
            [one for one in replays.episodes if one.world == world.name],
            reward=_estimate(rewards[number], None if drawn is None else drawn[:, number]),
            kept=Estimate(value=1.0)
            if number == 0
            else _share(rewards[number], promised, None if shares is None else shares[:, number - 1]),
            allowed=largest[number] / largest[0],
        )
        for number, world in enumerate(replays.worlds)
    ]
    others = tuple(rows[1:])
    overall = float(np.mean([row.kept.value for row in others]))
    return TransferReport(
        task=replays.task,
        policies=replays.policies,
        starts=replays.starts,
        training=rows[0],
        others=others,
        kept=_with_ends(overall, None if shares is None else shares.mean(axis=1)),
        first_fall=min((row for row in others if row.falls), key=_order, default=None),
        left_out=replays.left_out,
    )


def _rewards(replays: Replays) -> NDArray[np.float64]:
    """Return the rewards, shape [worlds, policies, starts]."""
    places = {world.name: number for number, world in enumerate(replays.worlds)}
    rewards = np.full((len(places), len(replays.policies), replays.starts), np.nan)
    for one in replays.episodes:
        rewards[places[one.world], replays.policies.index(one.policy), one.start] = one.reward
    return rewards


def _drawn_means(rewards: NDArray[np.float64], seed: int) -> NDArray[np.float64] | None:
    """Return means of drawn policies and starts, shape [DRAWS, worlds]; None with a single episode in each world."""
    _, policies, starts = rewards.shape
    if policies * starts == 1:
        return None
    random = np.random.default_rng(seed)
    means = np.empty((DRAWS, len(rewards)))
    for row in means:
        chosen = np.ix_(random.integers(policies, size=policies), random.integers(starts, size=starts))
        row[:] = [world[chosen].mean() for world in rewards]
    return means


def _with_ends(value: float, drawn: NDArray[np.float64] | None) -> Estimate:
    if drawn is None:
        return Estimate(value=value)
    low, high = np.percentile(drawn, PERCENTILES)
    return Estimate(value=value, low=float(low), high=float(high))


def _estimate(rewards: NDArray[np.float64], drawn: NDArray[np.float64] | None) -> Estimate:
    return _with_ends(float(rewards.mean()), drawn)


def _share(rewards: NDArray[np.float64], promised: float, drawn: NDArray[np.float64] | None) -> Estimate:
    return _with_ends(float(rewards.mean()) / promised, drawn)


def _largest_reward(replays: Replays, world: str) -> float:
    return next(one.largest_reward for one in replays.episodes if one.world == world)


def _world(
    world: ReplayWorld, episodes: Sequence[Replay], *, reward: Estimate, kept: Estimate, allowed: float
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
        falls=world.kind is not WorldKind.TRAINING and highest < FALL_SHARE * min(1.0, allowed),
    )


def _order(row: WorldTransfer) -> tuple[bool, float, float]:
    return (row.world.kind is WorldKind.CONSTANT, abs(row.world.sigmas), row.kept.value)
