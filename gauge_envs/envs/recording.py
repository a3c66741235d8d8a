"""What an episode records: samples of g(t), and states and markers at the frames, in N worlds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gauge_envs.backends.simulation import Simulation
from gauge_envs.envs.spaces import Observation
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.observables.observer import (
    MarkerProxy,
    Observer,
    ObserverMarkers,
    ObserverPositions,
)
from gauge_envs.scene.geometry import BoolArray, FloatArray, IntArray
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S, SAMPLES_PER_FRAME


@dataclass(frozen=True, kw_only=True)
class Trajectory:
    """Recorded motion of an episode so far.

    Attributes:
        times_s: Times of the dense samples [s], 180 a second, shape [sample_count].
        samples: The generalized trajectory g(t) at those times, shape [sample_count, coordinate_count].
        frames: g(t) at the 30 Hz frames, shape [frame_count, coordinate_count].
        bodies: States of the recorded bodies at the frames, shape [frame_count, body_count, 13]; `body_count` is 0 if
            markers are recorded.
        markers_m: Marker positions at the frames [m], shape [frame_count, marker_count, 3]; `marker_count` is 0 if
            bodies are recorded.
    """

    times_s: FloatArray
    samples: FloatArray
    frames: FloatArray
    bodies: FloatArray
    markers_m: FloatArray


class EpisodeRecording:
    """Recorded motion of N worlds.

    Args:
        experiment: The experiment of the worlds.
        simulation: The worlds, at the nominal start.
        frames: Current frame of each world, which the rollout counts, shape [N].
        marker_proxy: Marker proxy of deformable bodies: material point or nearest node.
    """

    def __init__(
        self,
        experiment: Experiment,
        simulation: Simulation,
        frames: IntArray,
        marker_proxy: MarkerProxy,
    ) -> None:
        scene, observable = experiment.scene, experiment.score.observable
        self._simulation = simulation
        self._dynamic = [body.name for body in scene.dynamic_bodies]
        self._driven = [driver.body for driver in scene.drivers]
        self._recorded = [self._dynamic.index(name) for name in experiment.recorded]
        self._observer: Observer
        if observable is Observable.POSITION:
            self._observer = ObserverPositions(experiment.recorded)
        else:
            self._observer = ObserverMarkers(
                scene, observable, simulation, marker_proxy
            )
        points_shape = self._observer.read(simulation).shape
        self._points_m = np.empty((SAMPLES_PER_FRAME, *points_shape))
        rows = (experiment.frame_count, simulation.world_count)
        sample_count = (experiment.frame_count - 1) * SAMPLES_PER_FRAME + 1
        self._samples = np.full((sample_count, rows[1], self._observer.width), np.nan)
        self._bodies = np.full((*rows, len(self._recorded), 13), np.nan)
        self._markers_m = np.full((*rows, self._observer.marker_count, 3), np.nan)
        self._drivers = np.full((*rows, len(self._driven), 13), np.nan)
        self._frames = frames
        self._worlds = np.arange(rows[1])

    def start(self, worlds: BoolArray) -> None:
        """Record frame 0 of worlds, shape [N], and forget their episodes before."""
        points_m = self._observer.read(self._simulation)[None]
        g, markers_m = self._observer.observe(points_m)
        self._samples[0, worlds] = g[0, worlds]
        self._markers_m[0, worlds] = markers_m[0, worlds]
        self._record_states(worlds)

    def read_points(self, interval: int) -> None:
        """Read the observed points after an interval of a frame, from 0 to 5."""
        self._points_m[interval] = self._observer.read(self._simulation)

    def end_frame(self, is_running: BoolArray) -> FloatArray:
        """Record the current frame of worlds after its six intervals.

        Args:
            is_running: Which worlds had not ended before this frame, shape [N].

        Returns:
            States of the dynamic bodies, shape [N, body_count, 13].
        """
        g, markers_m = self._observer.observe(self._points_m)
        worlds, frames = self._worlds[is_running], self._frames[is_running]
        before = np.arange(1 - SAMPLES_PER_FRAME, 1)[:, None]
        self._samples[frames * SAMPLES_PER_FRAME + before, worlds] = g[:, worlds]
        self._markers_m[frames, worlds] = markers_m[-1, worlds]
        return self._record_states(is_running)

    def _record_states(self, chosen: BoolArray) -> FloatArray:
        """Record the states of worlds, and return those of all dynamic bodies, shape [N, body_count, 13]."""
        states = self._simulation.body_states(self._dynamic)
        worlds, frames = self._worlds[chosen], self._frames[chosen]
        self._bodies[frames, worlds] = states[worlds].take(self._recorded, axis=1)
        if self._driven:
            driven = self._simulation.body_states(self._driven)
            self._drivers[frames, worlds] = driven[worlds]
        return states

    def compared(self) -> tuple[FloatArray, FloatArray]:
        """Return g(t) now, shape [N, coordinate_count], and the markers [m], shape [N, marker_count, 3]."""
        return self._last(self._samples[::SAMPLES_PER_FRAME]), self._last(
            self._markers_m
        )

    def observation(self) -> Observation:
        """Return the observations of all worlds in new arrays; a world that has ended keeps its last observation."""
        observation = {
            "observable": self._last(self._samples[::SAMPLES_PER_FRAME]),
            "time": self._frames[:, None] / FRAME_RATE_HZ,
        }
        if self._recorded:
            observation["bodies"] = self._last(self._bodies)
        else:
            observation["markers"] = self._last(self._markers_m)
        if self._driven:
            observation["driver"] = self._last(self._drivers)
        return observation

    def _last(self, rows: FloatArray) -> FloatArray:
        """Return the last frame of each world in a new array, from rows of shape [frame_count, N, ...]."""
        return np.asarray(rows[self._frames, self._worlds])

    def trajectory(self, world: int = 0) -> Trajectory:
        """Return the recorded motion of a world so far."""
        frame = int(self._frames[world])
        end = frame * SAMPLES_PER_FRAME + 1
        samples = self._samples[:end, world].copy()
        return Trajectory(
            times_s=np.arange(end, dtype=np.float64) * SAMPLE_INTERVAL_S,
            samples=samples,
            frames=samples[::SAMPLES_PER_FRAME],
            bodies=self._bodies[: frame + 1, world].copy(),
            markers_m=self._markers_m[: frame + 1, world].copy(),
        )

    def trajectories(self) -> tuple[FloatArray, FloatArray]:
        """Return times [s], shape [sample_count], and g(t) of all worlds, shape [N, sample_count, coordinate_count].

        Samples after the end of a world are NaN.
        """
        numbers = np.arange(len(self._samples))
        is_reached = numbers[:, None] <= self._frames * SAMPLES_PER_FRAME
        samples = np.where(is_reached[:, :, None], self._samples, np.nan)
        times_s = SAMPLE_INTERVAL_S * numbers.astype(np.float64)
        return times_s, samples.transpose(1, 0, 2)
