"""Episodes of many worlds in shared arrays: they are observed, judged and rewarded at once.

A loop over worlds in Python costs more than an engine that steps thousands of them on one device. So the records of all
episodes are parts of two arrays, and each sample is one reading of all worlds. Every number is that of `Episode`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.base import Simulation, World, Worlds
from gauge_envs.envs.divergence import RigidBoundsOfWorlds
from gauge_envs.envs.episode import Episode, Observation, reward_terms
from gauge_envs.envs.rollout import RecordedEpisodes
from gauge_envs.observables.kinds import Observable
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S, SAMPLES_PER_FRAME

FloatArray = NDArray[np.float64]
Numbers = NDArray[np.intp]


class EpisodesAtOnce:
    """Episodes of one experiment on worlds of an engine that advances all of them in one call.

    Args:
        episodes: The episode of each world; `fits` is true for them.
        worlds: The worlds.

    Attributes:
        frame: Number of the current frame.
        running: Numbers of the worlds whose episodes ran in the last step.
        diverged: Whether the episode of each world has diverged, shape [world_count].
    """

    def __init__(self, episodes: Sequence[Episode], worlds: Worlds) -> None:
        first = episodes[0]
        scene = first.experiment.scene
        count = len(episodes)
        self._episodes = episodes
        self._worlds = worlds
        self._recorded = first.experiment.recorded
        self._dynamic = tuple(body.name for body in scene.dynamic_bodies)
        self._rows = [self._dynamic.index(name) for name in self._recorded]
        self._bounds = RigidBoundsOfWorlds([episode.experiment.scene for episode in episodes])
        self._has_faults = any(type(world).fault is not World.fault for world in worlds.worlds)
        # Time comes first, so that a sample of all worlds is one block of memory.
        sample_count, width = first.sample_shape
        self._samples = np.full((sample_count, count, width), np.nan)
        self._bodies = np.full((first.experiment.frame_count, count, len(self._recorded), 13), np.nan)
        for number, episode in enumerate(episodes):
            episode.record_in(self._samples[:, number], self._bodies[:, number])
        self._shown = np.zeros(count, dtype=np.intp)
        self._reward_terms = reward_terms(first.band)
        self.frame = 0
        self.running = np.arange(count)
        self.diverged = np.zeros(count, dtype=np.bool_)

    @property
    def can_roll_out(self) -> bool:
        """Whether the engine records the worlds on its device."""
        return self._worlds.can_record and not self._has_faults

    @staticmethod
    def fits(episodes: Sequence[Episode], worlds: Worlds) -> bool:
        """Return whether episodes can run at once: rigid bodies without drivers, on worlds that advance together."""
        experiment = episodes[0].experiment
        return (
            experiment.score.observable is Observable.POSITION
            and not experiment.scene.drivers
            and not experiment.scene.deformables
            and experiment.trial is None
            and not any(isinstance(world, Simulation) for world in worlds.worlds)
        )

    def roll_out(self) -> RecordedEpisodes:
        """Advance all worlds from frame 0 to the end; the engine records them, and nothing is written here.

        The episodes stay at frame 0 until `keep` takes the record, or `begin` starts the next ones.
        """
        return RecordedEpisodes(self._episodes, self._worlds, self._bounds)

    def keep(self, recorded: RecordedEpisodes) -> None:
        """Copy the record of episodes to the host, after which they are as if they had been stepped."""
        positions, states = recorded.host_arrays()
        self._samples[:] = 1e3 * positions[:, :, self._rows].reshape(self._samples.shape)
        self._bodies[:] = states[: len(self._bodies), :, self._rows]
        self.frame = int(recorded.frames.max())
        self.running = self.running[:0]
        self._shown[:] = recorded.frames
        for number, episode in enumerate(self._episodes):
            episode.frame, episode.fault = int(recorded.frames[number]), recorded.faults.get(number)
            self.diverged[number] = episode.fault is not None
            last = states[min(episode.frame, len(self._bodies) - 1), number]
            if episode.runs_on:
                episode.begin_later_frame((dict(zip(self._dynamic, last[:, :7], strict=True)), {}))
                episode.count_later_frames(int(recorded.later[number]))

    def begin(self) -> None:
        """Record frame 0 of all worlds; they are at their starts."""
        states = self._worlds.body_states(self._dynamic)
        self.frame = 0
        self.running = np.arange(len(self._episodes))
        self.diverged = np.zeros(len(self._episodes), dtype=np.bool_)
        self._shown[:] = 0
        self._bodies[0] = states[:, self._rows]
        self._samples[0] = 1e3 * self._bodies[0, :, :, :3].reshape(len(states), -1)
        for episode in self._episodes:
            episode.restart()

    def step(self) -> None:
        """Advance all worlds by a frame, and record and judge it in those that ran until then."""
        running = self.running
        self._advance(running, self.frame)
        self.frame += 1
        states = self._worlds.body_states(self._dynamic)
        self._bodies[self.frame, running] = states[running][:, self._rows]
        self._shown[running] = self.frame
        for number in running.tolist():
            self._episodes[number].frame = self.frame
        for number in self._suspects(states, running):
            fault = self._episodes[number].fault_of(states[number])
            self._episodes[number].fault = fault
            self.diverged[number] = fault is not None

    def end_step(self) -> None:
        """Leave out the worlds whose episodes are over."""
        self.running = self.running[~self.diverged[self.running]]
        if self.is_complete:
            self.running = self.running[:0]

    @property
    def is_complete(self) -> bool:
        """Whether this is the last frame."""
        return self.frame == len(self._bodies) - 1

    def run_on(self) -> None:
        """Simulate on past the last frame, as `Episode.run_on` does for one world."""
        running = np.flatnonzero([episode.runs_on for episode in self._episodes])
        if not len(running):
            return
        states = self._worlds.body_states(self._dynamic)
        for number in running.tolist():
            poses = dict(zip(self._dynamic, states[number, :, :7], strict=True))
            self._episodes[number].begin_later_frame((poses, {}))
        limit = self._episodes[running[0]].later_limit
        started, counts = running, np.zeros(len(self._episodes), dtype=np.intp)
        for later in range(limit):
            frame = self.frame + later
            self._advance(running, frame)
            now = self._worlds.body_states(self._dynamic)
            rows = self._samples[frame * SAMPLES_PER_FRAME + 1 : (frame + 1) * SAMPLES_PER_FRAME + 1]
            ended = ~np.isfinite(rows).all(axis=(0, 2))
            for number in self._suspects(now, running):
                ended[number] |= self._episodes[number].fault_of(now[number]) is not None
            running = running[~ended[running]]
            counts[running] = later + 1
            if not len(running):
                break
        for number in started.tolist():
            self._episodes[number].count_later_frames(int(counts[number]))

    def observations(self) -> Observation:
        """Return the observations of all worlds in new arrays; a world whose episode is over keeps its last one."""
        every = np.arange(len(self._episodes))
        return {
            "bodies": self._bodies[self._shown, every],
            "observable": self._samples[self._shown * SAMPLES_PER_FRAME, every],
            "time": (self._shown / FRAME_RATE_HZ)[:, None],
        }

    def rewards(self) -> FloatArray:
        """Return the reward of each world in this frame, shape [world_count]; 0 for one that did not run."""
        rewards = np.zeros(len(self._episodes))
        if self._reward_terms is not None:
            projection, mean, weight = self._reward_terms
            g = self._samples[self.frame * SAMPLES_PER_FRAME, self.running]
            # A stack of matrix-vector products gives the bits of `Episode.reward`; one matrix product would not.
            deviations = np.abs(np.matmul(projection, g[:, :, None])[:, :, 0] - mean[self.frame])
            rewards[self.running] = -np.matmul(deviations[:, None, :], weight[self.frame][:, None])[:, 0, 0]
        return rewards

    def flags(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return terminations and truncations, shape [world_count] each."""
        return self.diverged.copy(), ~self.diverged & self.is_complete

    def trajectories(self) -> tuple[FloatArray, FloatArray]:
        """Return times [s], shape [sample_count], and g(t) of all worlds, shape [world_count, sample_count, width].

        Samples that a world did not reach are NaN.
        """
        numbers = np.arange(len(self._samples))
        counts = np.array([episode.sample_count for episode in self._episodes])
        samples = np.where((numbers[:, None] < counts)[:, :, None], self._samples, np.nan)
        return SAMPLE_INTERVAL_S * numbers.astype(np.float64), samples.transpose(1, 0, 2)

    def _advance(self, running: Numbers, frame: int) -> None:
        """Advance all worlds from a frame to the next, and record g(t) of some."""
        for sample in range(frame * SAMPLES_PER_FRAME + 1, (frame + 1) * SAMPLES_PER_FRAME + 1):
            self._worlds.advance(SAMPLE_INTERVAL_S)
            positions_mm = 1e3 * self._worlds.body_positions(self._recorded)
            if len(running) == len(positions_mm):
                self._samples[sample] = positions_mm.reshape(len(running), -1)
            else:
                self._samples[sample, running] = positions_mm[running].reshape(len(running), -1)

    def _suspects(self, states: FloatArray, running: Numbers) -> list[int]:
        """Return the numbers of running worlds that may have diverged."""
        if self._has_faults:
            return running.tolist()
        return running[self._bounds.suspects(states)[running]].tolist()
