"""What an episode records: samples of g(t), and states and markers at the frames, in N worlds."""

from __future__ import annotations

from collections.abc import Mapping
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
from gauge_envs.scene.geometry import BoolArray, FloatArray
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
    """Recorded motion of N worlds, which start together.

    Args:
        experiment: The experiment of the worlds.
        simulation: The worlds, at the nominal start.
        marker_proxy: Marker proxy of deformable bodies: material point or nearest node.

    Attributes:
        last_frames: Last recorded frame of each world, shape [N].
    """

    def __init__(
        self, experiment: Experiment, simulation: Simulation, marker_proxy: MarkerProxy
    ) -> None:
        scene, observable = experiment.scene, experiment.score.observable
        self._simulation = simulation
        self._dynamic = [body.name for body in scene.dynamic_bodies]
        self._driven = [driver.body for driver in scene.drivers]
        self._recorded = [self._dynamic.index(name) for name in experiment.recorded]
        self._deformables = [body.name for body in scene.deformables]
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
        self.last_frames = np.zeros(rows[1], dtype=np.intp)

    def start(self) -> None:
        """Record frame 0, and forget the episodes before."""
        points_m = self._observer.read(self._simulation)[None]
        self._samples[:1], self._markers_m[:1] = self._observer.observe(points_m)
        self.last_frames[:] = 0
        self._record_states(0)

    def read_points(self, interval: int) -> None:
        """Read the observed points after an interval of a frame, from 0 to 5."""
        self._points_m[interval] = self._observer.read(self._simulation)

    def end_frame(self, frame: int, is_running: BoolArray) -> FloatArray:
        """Record a frame after its six intervals.

        Args:
            frame: Number of the frame.
            is_running: Which worlds have not ended, shape [N].

        Returns:
            States of the dynamic bodies, shape [N, body_count, 13].
        """
        g, markers_m = self._observer.observe(self._points_m)
        last = frame * SAMPLES_PER_FRAME
        self._samples[last + 1 - SAMPLES_PER_FRAME : last + 1] = g
        self._markers_m[frame] = markers_m[-1]
        self.last_frames[is_running] = frame
        return self._record_states(frame)

    def _record_states(self, frame: int) -> FloatArray:
        """Record the states at a frame, and return those of the dynamic bodies, shape [N, body_count, 13]."""
        states = self._simulation.body_states(self._dynamic)
        self._bodies[frame] = states.take(self._recorded, axis=1)
        if self._driven:
            self._drivers[frame] = self._simulation.body_states(self._driven)
        return states

    def compared_at(self, frame: int) -> tuple[FloatArray, FloatArray]:
        """Return g(t) at a frame, shape [N, coordinate_count], and the markers [m], shape [N, marker_count, 3]."""
        return self._samples[frame * SAMPLES_PER_FRAME], self._markers_m[frame]

    def observation(self) -> Observation:
        """Return the observations of all worlds in new arrays; a world that has ended keeps its last observation."""
        observation = {
            "observable": self._last(self._samples[::SAMPLES_PER_FRAME]),
            "time": self.last_frames[:, None] / FRAME_RATE_HZ,
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
        return np.asarray(rows[self.last_frames, np.arange(len(self.last_frames))])

    def trajectory(self, world: int = 0) -> Trajectory:
        """Return the recorded motion of a world so far."""
        frame = int(self.last_frames[world])
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
        is_reached = numbers[:, None] <= self.last_frames * SAMPLES_PER_FRAME
        samples = np.where(is_reached[:, :, None], self._samples, np.nan)
        times_s = SAMPLE_INTERVAL_S * numbers.astype(np.float64)
        return times_s, samples.transpose(1, 0, 2)

    def poses(self, world: int = 0) -> Mapping[str, FloatArray]:
        """Return the pose of each rigid body that moves now: position [m] and quaternion w x y z, shape [7]."""
        names = [*self._dynamic, *self._driven]
        poses = self._simulation.body_states(names)[world, :, :7]
        return dict(zip(names, poses, strict=True))

    def nodes_m(self, world: int = 0) -> Mapping[str, FloatArray]:
        """Return the nodes of each deformable body now [m], shape [node_count, 3]."""
        return {
            name: self._simulation.nodes(name)[world].copy()
            for name in self._deformables
        }
