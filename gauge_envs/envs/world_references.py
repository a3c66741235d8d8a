"""The references of N worlds, which give the reward of each frame and the score of each episode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from gauge_envs.envs.reward import Reward, is_reward_bounded
from gauge_envs.envs.rollout import Rollout
from gauge_envs.errors import EpisodeError
from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.scoring.reference import reference_band, refusal

if TYPE_CHECKING:
    # Only the end of an episode needs scores.
    from gauge_envs.scoring.score import Score


class WorldReferences:
    """References of the worlds of a rollout.

    Args:
        rollout: The episodes.

    Attributes:
        bands: Reference of the episode of each world, or None; if the episode replays a trial, this trial.
    """

    def __init__(self, rollout: Rollout) -> None:
        self._rollout = rollout
        self._trials: list[int | None] = []
        self.bands: Sequence[Band | None] = ()
        self.start()

    def start(self) -> None:
        """Choose the reference of each world; call it after each reset of the rollout."""
        rollout = self._rollout
        trials = [rollout.trial_of(world) for world in range(rollout.world_count)]
        if trials == self._trials:
            return
        self._trials = trials
        bands = {
            trial: reference_band(replace(rollout.experiment, trial=trial))
            for trial in set(trials)
        }
        self.bands = [bands[trial] for trial in trials]
        is_bounded = is_reward_bounded(rollout.experiment)
        self._rewards: list[tuple[Reward, slice | BoolArray]] = []
        for trial, band in bands.items():
            if band is not None:
                worlds = np.array([world_trial == trial for world_trial in trials])
                # A slice of all worlds needs no copy.
                chosen = slice(None) if worlds.all() else worlds
                self._rewards.append((Reward(band, is_bounded), chosen))

    def kind(self, world: int) -> str:
        """Return the kind of the reference of a world; `none` without one."""
        band = self.bands[world]
        return (Kind.NONE if band is None else band.kind).value

    def rewards(self) -> FloatArray:
        """Return the reward of each world in the current frame, shape [N].

        It is 0 if the world ended before this frame, or if a number of the frame is not finite.
        """
        rollout = self._rollout
        frames = rollout.frames
        g, markers_m = rollout.recording.compared()
        rewards = np.zeros(rollout.world_count)
        for reward, worlds in self._rewards:
            rewards[worlds] = reward.of(frames[worlds], g[worlds], markers_m[worlds])
        return np.where(rollout.is_running & np.isfinite(rewards), rewards, 0.0)

    def score(self, world: int = 0) -> Score:
        """Return the score of a world whose episode is over; if the world diverged, the score has no numbers.

        Raises:
            EpisodeError: The episode is not over.
        """
        from gauge_envs.scoring.score import Score
        from gauge_envs.scoring.trajectory import score_trajectory

        rollout = self._rollout
        experiment = rollout.experiment_of(world)
        if not rollout.is_over[world]:
            raise EpisodeError(f"{experiment.id}: no score before the episode is over")
        if world in rollout.diverged:
            return Score(kind=self.kind(world), unit=experiment.score.observable.unit)
        trajectory = rollout.recording.trajectory(world)
        return score_trajectory(
            experiment,
            self.bands[world],
            times_s=trajectory.times_s,
            values=trajectory.samples,
            markers_m=trajectory.markers_m,
            is_checked=True,
            is_moved=self._is_moved(world),
        )

    def score_arrays(self) -> dict[str, FloatArray]:
        """Return the scores of all worlds, see `GaugeVectorEnv.score_arrays`."""
        from gauge_envs.scoring.trajectory import score_worlds

        rollout = self._rollout
        times_s, samples = rollout.recording.trajectories()
        scores: dict[str, FloatArray] = {}
        # Worlds may replay different trials; each reference scores its worlds in one pass.
        for band in {id(band): band for band in self.bands if band}.values():
            rows = [
                world
                for world in range(rollout.world_count)
                if self.bands[world] is band and self._is_comparable(world)
            ]
            band_scores = score_worlds(
                rollout.experiment, band, times_s=times_s, values=samples[rows]
            )
            for key, values in band_scores.items():
                nothing = np.full(rollout.world_count, np.nan)
                scores.setdefault(key, nothing)[rows] = values
        return scores

    def _is_comparable(self, world: int) -> bool:
        """Return whether the episode of a world is over, and its reference can score it."""
        rollout = self._rollout
        if not rollout.is_over[world] or world in rollout.diverged:
            return False
        reason = refusal(
            rollout.experiment_of(world),
            self.bands[world],
            is_moved=self._is_moved(world),
        )
        return reason is None

    def _is_moved(self, world: int) -> bool:
        """Return whether noise moved the initial state of a world."""
        states = self._rollout.initial_states
        return bool(states) and states[world].is_scattered
