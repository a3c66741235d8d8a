"""Whole episodes of many worlds that are recorded, judged and scored on the engine's device.

Between the start and the end nothing is copied to the host. A kernel finds worlds that may have diverged. Their states
alone are then copied, and judged by the code that judges single episodes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.base import Recording, Worlds
from gauge_envs.envs.divergence import RigidBoundsOfWorlds
from gauge_envs.envs.episode import Episode
from gauge_envs.evaluation.device_scores import device_array, score_recording
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S, SAMPLES_PER_FRAME

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Rollout:
    """Result of one episode of all worlds.

    Attributes:
        scores: Arrays of `GaugeVectorEnv.score_arrays`, shape [world_count] each; NaN for a world that diverged.
        diverged: Why the episode of a world diverged, by the number of the world; others are left out.
        frames: Number of the last frame of each world's episode, shape [world_count].
        device: Device that recorded, judged and scored the worlds, as `cuda:0`. None if the engine records nothing, or
            the experiment is no passive one of rigid bodies: then the episode was stepped and scored on the host.
    """

    scores: Mapping[str, FloatArray]
    diverged: Mapping[int, str]
    frames: NDArray[np.intp]
    device: str | None


class RecordedEpisodes:
    """Episodes of all worlds, recorded from frame 0 to the end and judged.

    Args:
        episodes: The episode of each world, at frame 0; `EpisodesAtOnce.fits` is true for them.
        worlds: Their worlds at the start; `can_record` is true.
        bounds: Bounds of the worlds.

    Attributes:
        recording: The record.
        faults: Why the episode of a world diverged, by the number of the world.
        frames: Number of the last frame of each world's episode, shape [world_count].
        later: Number of frames after the last one that count for the release alignment, shape [world_count].
    """

    def __init__(self, episodes: Sequence[Episode], worlds: Worlds, bounds: RigidBoundsOfWorlds) -> None:
        experiment = episodes[0].experiment
        dynamic = [body.name for body in experiment.scene.dynamic_bodies]
        self._episodes = episodes
        self._last = experiment.frame_count - 1
        self.rows = [dynamic.index(name) for name in experiment.recorded]
        limits = np.array([episode.later_limit for episode in episodes], dtype=np.intp)
        self.recording: Recording = worlds.record(
            dynamic,
            frame_count=experiment.frame_count + int(limits.max()),
            samples=SAMPLES_PER_FRAME,
            interval_s=SAMPLE_INTERVAL_S,
        )
        self.faults: dict[int, str] = {}
        self.frames = np.full(len(episodes), self._last, dtype=np.intp)
        self.later = limits
        self._judge(bounds)

    def scores(self) -> dict[str, FloatArray]:
        """Return the scores of all worlds, shape [world_count] each; NaN for a world that diverged.

        The first episode has a band.
        """
        first = self._episodes[0]
        assert first.band is not None
        counts = (self.frames + self.later) * SAMPLES_PER_FRAME + 1
        # A world without samples has no score.
        counts[list(self.faults)] = 0
        return score_recording(
            first.experiment,
            first.band,
            positions_m=self.recording.positions_m,
            rows=self.rows,
            sample_counts=counts,
        )

    def host_arrays(self) -> tuple[FloatArray, FloatArray]:
        """Return copies of the positions and states of the record."""
        return device_array(self.recording.positions_m).numpy(), device_array(self.recording.states).numpy()

    def _judge(self, bounds: RigidBoundsOfWorlds) -> None:
        states, positions = device_array(self.recording.states), device_array(self.recording.positions_m)
        firsts = _first_suspects(states, positions, bounds, later=self._last + 1)
        suspects = np.flatnonzero(firsts < len(states))
        if not len(suspects):
            return
        import warp as wp

        with wp.ScopedDevice(states.device):
            chosen = wp.array(suspects.astype(np.int32), dtype=wp.int32)
            near = wp.indexedarray(states, [None, chosen]).numpy()
            places = wp.indexedarray(positions, [None, chosen]).numpy()
        for column, world in enumerate(suspects.tolist()):
            self._decide(world, int(firsts[world]), near[:, column], places[:, column])

    def _decide(self, world: int, first: int, states: FloatArray, positions_m: FloatArray) -> None:
        """Judge a world from a frame on, as `EpisodesAtOnce` does frame by frame."""
        episode = self._episodes[world]
        for frame in range(first, self._last + int(self.later[world]) + 1):
            fault = episode.fault_of(states[frame])
            if frame <= self._last:
                if fault is not None:
                    self.faults[world], self.frames[world], self.later[world] = fault, frame, 0
                    return
                continue
            samples = positions_m[(frame - 1) * SAMPLES_PER_FRAME + 1 : frame * SAMPLES_PER_FRAME + 1, self.rows]
            if fault is not None or not np.isfinite(samples).all():
                self.later[world] = frame - 1 - self._last
                return


def _first_suspects(states: object, positions: object, bounds: RigidBoundsOfWorlds, *, later: int) -> NDArray[np.int32]:
    """Return the first frame in which each world may be out of bounds, shape [world_count]; the frame count if none."""
    import warp as wp

    from gauge_envs.envs.bounds_kernel import find_suspects

    assert isinstance(states, wp.array)
    frame_count, world_count = states.shape[:2]
    limits = (bounds.masses_kg, bounds.distances_m, bounds.speeds_m_per_s, bounds.energies_j)
    with wp.ScopedDevice(states.device):
        first = wp.full(world_count, frame_count, dtype=wp.int32)
        wp.launch(
            find_suspects,
            dim=(frame_count - 1, world_count),
            inputs=[
                states,
                positions,
                *(wp.array(limit, dtype=wp.float64) for limit in limits),
                SAMPLES_PER_FRAME,
                later,
            ],
            outputs=[first],
        )
        return first.numpy()
