"""What an episode records: samples of g(t), and states and markers at the frames, in N worlds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

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
        dynamic = [body.name for body in scene.dynamic_bodies]
        self._dynamic_count = len(dynamic)
        self._bodies_read = [*dynamic, *(driver.body for driver in scene.drivers)]
        self._recorded = [dynamic.index(name) for name in experiment.recorded]
        self._observer: Observer
        if observable is Observable.POSITION:
            self._observer = ObserverPositions(experiment.recorded)
        else:
            self._observer = ObserverMarkers(
                scene, observable, simulation, marker_proxy
            )
        reading = self._observer.read(simulation)
        self._readings = np.empty((SAMPLES_PER_FRAME, *reading.shape))
        self._sampler = self._observer.sampler(simulation, self._readings)
        point_shape = self._observer.points(reading).shape[1:]
        rows = (experiment.frame_count, simulation.world_count)
        # A frame has the samples of its six intervals; frame 0 has only its start, as the last.
        self._points_m = np.full((*rows, SAMPLES_PER_FRAME, *point_shape), np.nan)
        self._bodies = np.full((*rows, len(self._recorded), 13), np.nan)
        self._frames = frames
        # What observations contain of the last frame of each world.
        self._last: dict[str, FloatArray] = {}

    def start(self, worlds: BoolArray) -> None:
        """Record frame 0 of worlds, shape [N], and forget their episodes before."""
        points_m = self._observer.points(self._observer.read(self._simulation))
        self._points_m[0, worlds, -1] = points_m[worlds]
        self._record(*self._place(worlds), points_m)

    def read_points(self, interval: int) -> None:
        """Read the observed points after an interval of a frame, from 0 to 5."""
        self._sampler.read(interval)

    def end_frame(self, is_running: BoolArray) -> FloatArray:
        """Record the current frame of worlds after its six intervals.

        Args:
            is_running: Which worlds had not ended before this frame, shape [N].

        Returns:
            States of the dynamic bodies, shape [N, body_count, 13].
        """
        points_m = self._observer.points(self._readings)
        place, chosen = self._place(is_running)
        self._points_m[place] = points_m.swapaxes(0, 1)[chosen]
        return self._record(place, chosen, points_m[-1])

    def _record(self, place: Any, chosen: Any, points_m: FloatArray) -> FloatArray:
        """Record the frame of worlds, and return the states of all dynamic bodies, shape [N, body_count, 13]."""
        states = self._simulation.body_states(self._bodies_read)
        bodies = states.take(self._recorded, axis=1)
        self._bodies[place] = bodies[chosen]
        g = self._observer.observe(points_m)
        last = {"observable": g, "bodies": bodies, "markers": points_m.copy()}
        driven = states[:, self._dynamic_count :]
        if driven.size:
            last["driver"] = driven
        if self._last and isinstance(chosen, np.ndarray):
            for name, rows in last.items():
                rows[~chosen] = self._last[name][~chosen]
        self._last = last
        return states[:, : self._dynamic_count]

    def _place(self, chosen: BoolArray) -> tuple[Any, Any]:
        """Return the index of the frames of worlds in a history of shape [frame_count, N, ...], and of their rows."""
        if chosen.all() and len(set(self._frames.tolist())) == 1:
            # A slice is faster than indices.
            return self._frames[0], slice(None)
        return (self._frames[chosen], np.flatnonzero(chosen)), chosen

    def compared(self) -> tuple[FloatArray, FloatArray]:
        """Return g(t) now, shape [N, coordinate_count], and the observed points [m], shape [N, point_count, 3]."""
        return self._last["observable"], self._last["markers"]

    def observation(self) -> Observation:
        """Return the observations of all worlds in new arrays; a world that has ended keeps its last observation."""
        seen = "bodies" if self._recorded else "markers"
        names = {"observable", seen, "driver"}
        observation = {
            name: rows.copy() for name, rows in self._last.items() if name in names
        }
        observation["time"] = self._frames[:, None] / FRAME_RATE_HZ
        return observation

    def trajectory(self, world: int = 0) -> Trajectory:
        """Return the recorded motion of a world so far."""
        end = int(self._frames[world]) + 1
        points_m = self._points_m[:end, world]
        samples = self._samples(points_m[None])[0]
        return Trajectory(
            times_s=np.arange(len(samples), dtype=np.float64) * SAMPLE_INTERVAL_S,
            samples=samples,
            frames=samples[::SAMPLES_PER_FRAME],
            bodies=self._bodies[:end, world].copy(),
            markers_m=points_m[:, -1, : 0 if self._recorded else None].copy(),
        )

    def trajectories(self) -> tuple[FloatArray, FloatArray]:
        """Return times [s], shape [sample_count], and g(t) of all worlds, shape [N, sample_count, coordinate_count].

        Samples after the end of a world are NaN.
        """
        samples = self._samples(self._points_m.swapaxes(0, 1))
        numbers = np.arange(samples.shape[1])
        samples[numbers > self._frames[:, None] * SAMPLES_PER_FRAME] = np.nan
        return SAMPLE_INTERVAL_S * numbers.astype(np.float64), samples

    def _samples(self, points_m: FloatArray) -> FloatArray:
        """Return g(t), shape [N, S, width], from points [m] of shape [N, frame_count, 6, point_count, 3]."""
        samples_m = points_m.reshape(len(points_m), -1, *points_m.shape[-2:])
        return self._observer.observe(samples_m[:, SAMPLES_PER_FRAME - 1 :])
