"""Episodes of one experiment in N worlds, and the only loop over time, `intervals`.

A step drives, advances and observes the worlds six times, and then checks for divergence. Engine checks, sanity checks
and control tasks use the same loop.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from gauge_envs.backends.simulation import Simulation
from gauge_envs.envs.initial_states import InitialState
from gauge_envs.envs.limits import diverged_bodies, diverged_nodes, spans_m
from gauge_envs.envs.reward import Reward, is_reward_bounded
from gauge_envs.envs.spaces import Observation
from gauge_envs.errors import BackendError, EpisodeError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.observables.observer import (
    MarkerProxy,
    Observer,
    ObserverMarkers,
    ObserverPositions,
)
from gauge_envs.references.band import Band
from gauge_envs.scene.geometry import BoolArray, FloatArray, IntArray
from gauge_envs.scene.prescribed_motion import prescribed_motions
from gauge_envs.scene.states import row_of, scene_at
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S, SAMPLES_PER_FRAME
from gauge_envs.scoring.metrics import MAX_TIME_OFFSET_S

if TYPE_CHECKING:
    # Scores import much of SciPy, and only the end of an episode needs them.
    from gauge_envs.scoring.score import Score

LATER_FRAMES = round(MAX_TIME_OFFSET_S * FRAME_RATE_HZ)
"""Frames that worlds with a release simulate after the last frame, for the time alignment."""


class DrivenMotion(Protocol):
    """Prescribed motion of a body, such as `gauge_envs.scene.prescribed_motion.PrescribedMotion`."""

    body: str

    def targets(self, first: int, actions: FloatArray, count: int = 1) -> FloatArray:
        """Return the targets of the next intervals for `Simulation.drive`, shape [count, N, 19]."""
        ...


def intervals(
    simulation: Simulation,
    motions: Sequence[DrivenMotion],
    first: int,
    count: int,
    actions: Sequence[FloatArray],
    *,
    interval_s: float = SAMPLE_INTERVAL_S,
) -> Iterator[int]:
    """Drive and advance all worlds, and yield the index of each interval after it.

    Args:
        simulation: The worlds.
        motions: Motions of the driven bodies.
        first: Number of the first interval since the start.
        count: Number of intervals.
        actions: Actions of each motion in all of these intervals, shape [N, motion_count].
        interval_s: Length of an interval [s].
    """
    targets = [
        motion.targets(first, action, count)
        for motion, action in zip(motions, actions, strict=True)
    ]
    for index in range(count):
        for motion, rows in zip(motions, targets, strict=True):
            simulation.drive(motion.body, rows[index])
        simulation.advance(interval_s)
        yield index


MAX_NORM_ERROR = 1e-3
"""Largest deviation of the norm of an initial quaternion from 1."""


def check_states(simulation: Simulation, names: Sequence[str]) -> None:
    """Raise an error if the states of an engine violate the contract of `Simulation.body_states`.

    Args:
        simulation: The worlds, at their start.
        names: Names of the bodies.
    """
    states: Any = simulation.body_states(names)
    method = f"{type(simulation).__name__}.body_states"
    shape = (simulation.world_count, len(names), 13)
    array = np.asanyarray(states)
    if states is not array or array.shape != shape or array.dtype.kind != "f":
        description = f"a {type(states).__name__} of shape {array.shape} and {array.dtype} numbers"
        raise BackendError(
            f"{method} returned {description}, expected an array of shape {shape} and float numbers"
        )
    norm_errors = np.abs(np.linalg.norm(states[..., 3:7], axis=-1) - 1.0)
    is_valid = np.isfinite(states).all(axis=-1) & (norm_errors <= MAX_NORM_ERROR)
    for world, row in np.argwhere(~is_valid)[:1].tolist():
        raise BackendError(
            f"{method} returned {states[world, row].tolist()} for {names[row]!r} at the start, expected "
            "finite numbers and a unit quaternion"
        )


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
        later_times_s: Times of samples after the last frame [s], for the time alignment, shape [later_count]; empty
            before the score is computed, and without an alignment.
        later_samples: g(t) at those times, shape [later_count, coordinate_count].
    """

    times_s: FloatArray
    samples: FloatArray
    frames: FloatArray
    bodies: FloatArray
    markers_m: FloatArray
    later_times_s: FloatArray
    later_samples: FloatArray

    @property
    def dense(self) -> tuple[FloatArray, FloatArray]:
        """All times [s], shape [sample_count + later_count], and g(t) at those times."""
        return (
            np.concatenate([self.times_s, self.later_times_s]),
            np.concatenate([self.samples, self.later_samples]),
        )


class Rollout:
    """Synchronous episodes in N worlds: they start together, and each step is one frame of all worlds.

    A world that diverges ends. Its observation stays that of its last frame, and the other worlds continue.

    Args:
        experiments: The experiment of each world; they may differ in constants.
        simulation: The worlds, at the nominal start.
        bands: Reference of rewards and scores of each world, or None.
        marker_proxy: Marker proxy of deformable bodies: material point or nearest node.

    Attributes:
        experiment: The experiment of the first world.
        simulation: The worlds.
        world_count: Number of worlds N.
        frame: Number of the current frame; None before `reset`.
        last_frames: Last frame of each world so far, shape [N].
        terminated: Which worlds have diverged, shape [N].
        diverged: Reason of each diverged world, by its number.
        initial_states: Initial state of each world; empty for the nominal ones.
        bands: Reference of each world; if it replays a trial, of this trial.
        rest_nodes_m: Nodes of each deformable body at the nominal start [m], shape [node_count, 3].

    Raises:
        BackendError: The states of the engine violate the contract of `Simulation.body_states`.
    """

    def __init__(
        self,
        experiments: Sequence[Experiment],
        simulation: Simulation,
        *,
        bands: Sequence[Band | None],
        marker_proxy: MarkerProxy = MarkerProxy.MATERIAL,
    ) -> None:
        self.experiment = experiment = experiments[0]
        scene = experiment.scene
        self.simulation = simulation
        self.world_count = count = simulation.world_count
        self.frame: int | None = None
        self.last_frames = np.zeros(count, dtype=np.intp)
        self.diverged: dict[int, str] = {}
        self.initial_states: Sequence[InitialState] = ()
        self._experiments = experiments
        self._nominal_bands = bands
        self._set_bands(bands)
        self.terminated = np.zeros(count, dtype=np.bool_)
        self.rest_nodes_m = {
            body.name: simulation.nodes(body.name)[0].copy()
            for body in scene.deformables
        }
        self._rest_spans_m = {
            name: float(spans_m(nodes[None])[0])
            for name, nodes in self.rest_nodes_m.items()
        }
        has_release = any(
            band is not None and band.has_release and world.trial is None
            for band, world in zip(bands, experiments, strict=True)
        )
        self._later_frames = LATER_FRAMES if has_release else 0
        frame_count = experiment.frame_count
        seconds = (frame_count - 1 + self._later_frames) / FRAME_RATE_HZ
        self._motions = prescribed_motions(scene, seconds, world_count=count)
        self._dynamic = [body.name for body in scene.dynamic_bodies]
        self._driven = [driver.body for driver in scene.drivers]
        check_states(simulation, [*self._dynamic, *self._driven])
        self._recorded = [self._dynamic.index(name) for name in experiment.recorded]
        self._observer: Observer
        observable = experiment.score.observable
        if observable is Observable.POSITION:
            self._observer = ObserverPositions(experiment.recorded)
        else:
            self._observer = ObserverMarkers(
                scene, observable, simulation, marker_proxy
            )
        sample_count = round(seconds * FRAME_RATE_HZ) * SAMPLES_PER_FRAME + 1
        points_shape = self._observer.read(simulation).shape
        self._points_m = np.empty((SAMPLES_PER_FRAME, *points_shape))
        self._samples = np.full((sample_count, count, self._observer.width), np.nan)
        self._bodies = np.full((frame_count, count, len(self._recorded), 13), np.nan)
        marker_shape = (frame_count, count, self._observer.marker_count, 3)
        self._markers_m = np.full(marker_shape, np.nan)
        self._driver_states = np.full(
            (frame_count, count, len(self._driven), 13), np.nan
        )

    @property
    def motion_count(self) -> int:
        """Length of an action: the degrees of freedom of all driven bodies."""
        return sum(motion.motion_count for motion in self._motions)

    @property
    def is_complete(self) -> bool:
        """Whether the current frame is the last one."""
        return self.frame == self.experiment.frame_count - 1

    @property
    def is_over(self) -> BoolArray:
        """Which worlds have ended, shape [N]."""
        return self.terminated | self.is_complete

    # --- frames ---

    def reset(
        self, initial_states: Sequence[InitialState] | None = None, seed: int = 0
    ) -> None:
        """Start an episode in every world, and record frame 0.

        Args:
            initial_states: Initial state of each world; None starts each as the scene gives.
            seed: Seed of the engine.
        """
        trials = [start.trial for start in self.initial_states]
        self.initial_states = initial_states or ()
        states = None
        if initial_states is None:
            for motion in self._motions:
                motion.reset()
        else:
            states = np.array([start.states for start in initial_states])
            for index, motion in enumerate(self._motions):
                row = row_of(self.experiment.scene, motion.body)
                drivers = [start.drivers[index] for start in initial_states]
                motion.reset(drivers, states[:, row, :7])
        self.simulation.reset(states, seed)
        if trials != [start.trial for start in self.initial_states]:
            self._set_bands([self._band_of(world) for world in range(self.world_count)])
        self.frame = 0
        self.diverged = {}
        self.terminated[:] = False
        self.last_frames[:] = 0
        self._later_counts: IntArray | None = None
        self._last_view: dict[str, FloatArray] | None = None
        points_m = self._observer.read(self.simulation)[None]
        self._samples[:1], self._markers_m[:1] = self._observer.observe(points_m)
        self._record()

    def step(self, actions: FloatArray) -> None:
        """Simulate one frame of all worlds.

        Args:
            actions: Actions from -1 to 1, shape [N, motion_count].
        """
        for _ in self.substeps(actions):
            pass

    def substeps(self, actions: FloatArray | None = None) -> Iterator[int]:
        """Simulate one frame of all worlds, and yield after each of its six intervals; see `step`."""
        assert self.frame is not None, "call reset first"
        yield from self._simulated(self.frame, actions)
        self.frame += 1
        self._markers_m[self.frame] = self._sampled(self.frame)
        self.last_frames[~self.terminated] = self.frame
        states = self._record()
        for world, reason in self.divergences(states).items():
            self.diverged.setdefault(world, reason)
            self.terminated[world] = True

    def play(self) -> None:
        """Simulate all episodes to their end without actions."""
        while not self.is_over.all():
            for _ in self.substeps():
                pass

    def _simulated(self, frame: int, actions: FloatArray | None) -> Iterator[int]:
        """Drive, advance and read all worlds in the six intervals after a frame, and yield after each."""
        if actions is None:
            actions = np.zeros((self.world_count, self.motion_count))
        motion_actions = []
        end = 0
        for motion in self._motions:
            begin, end = end, end + motion.motion_count
            motion_actions.append(actions[:, begin:end])
        first = frame * SAMPLES_PER_FRAME
        for index in intervals(
            self.simulation, self._motions, first, SAMPLES_PER_FRAME, motion_actions
        ):
            self._points_m[index] = self._observer.read(self.simulation)
            yield index

    def _sampled(self, frame: int) -> FloatArray:
        """Record g(t) in the six intervals before a frame, and return the markers of the frame [m]."""
        g, markers_m = self._observer.observe(self._points_m)
        last = frame * SAMPLES_PER_FRAME
        self._samples[last + 1 - SAMPLES_PER_FRAME : last + 1] = g
        return markers_m[-1]

    def _record(self) -> FloatArray:
        """Record the current frame, and return the states of the dynamic bodies, shape [N, body_count, 13]."""
        frame = self.frame or 0
        states = self.simulation.body_states(self._dynamic)
        self._bodies[frame] = states.take(self._recorded, axis=1)
        if self._driven:
            self._driver_states[frame] = self.simulation.body_states(self._driven)
        return states

    def divergences(self, states: FloatArray | None = None) -> dict[int, str]:
        """Return the reason of each world that has diverged by now, the engine's reason first.

        Args:
            states: Current states of the dynamic bodies, shape [N, body_count, 13]; None reads them.
        """
        if states is None:
            states = self.simulation.body_states(self._dynamic)
        reasons = dict(self.simulation.diverged())
        for name, rest_m in self._rest_spans_m.items():
            reasons = (
                diverged_nodes(name, self.simulation.nodes(name), rest_m) | reasons
            )
        return diverged_bodies(self._dynamic, states) | reasons

    def run_on(self) -> None:
        """Simulate frames after the last one, which the time alignment needs.

        Driven bodies continue their recorded motion without actions.
        """
        if (
            not self._later_frames
            or not self.is_complete
            or self._later_counts is not None
        ):
            return
        self._last_view = self._view()
        counts = np.zeros(self.world_count, dtype=np.intp)
        is_running = ~self.terminated
        last = self.experiment.frame_count - 1
        for later in range(self._later_frames):
            for _ in self._simulated(last + later, None):
                pass
            self._sampled(last + later + 1)
            first = (last + later) * SAMPLES_PER_FRAME + 1
            rows = self._samples[first : first + SAMPLES_PER_FRAME]
            is_running &= np.isfinite(rows).all(axis=(0, 2))
            is_running[[*self.divergences()]] = False
            counts[is_running] = later + 1
        self._later_counts = counts

    # --- recorded motion ---

    def observation(self) -> Observation:
        """Return the observations of all worlds in new arrays; a world that has ended keeps its last observation."""
        observation = {
            "observable": self._last(self._samples[::SAMPLES_PER_FRAME]),
            "time": self.last_frames[:, None] / FRAME_RATE_HZ,
        }
        if self.experiment.recorded:
            observation["bodies"] = self._last(self._bodies)
        else:
            observation["markers"] = self._last(self._markers_m)
        if self._driven:
            observation["driver"] = self._last(self._driver_states)
        return observation

    def _last(self, rows: FloatArray) -> FloatArray:
        """Return the last frame of each world in a new array, from rows of shape [frame_count, N, ...]."""
        if not self.diverged:
            return rows[self.frame].copy()
        return np.asarray(rows[self.last_frames, np.arange(self.world_count)])

    def rewards(self) -> FloatArray:
        """Return the reward of each world in the current frame, shape [N].

        It is 0 if the world ended before this frame, or if a number of the frame is not finite.
        """
        frame = self.frame or 0
        g, markers_m = self._samples[frame * SAMPLES_PER_FRAME], self._markers_m[frame]
        rewards = np.zeros(self.world_count)
        for reward, worlds in self._rewards:
            rewards[worlds] = reward.of(frame, g[worlds], markers_m[worlds])
        if self.diverged or not np.isfinite(rewards).all():
            rewards[(self.last_frames < frame) | ~np.isfinite(rewards)] = 0.0
        return rewards

    def info(self, world: int) -> dict[str, Any]:
        """Return the `info` of a world, see `GaugeEnv`."""
        frame = int(self.last_frames[world])
        band, experiment = self.bands[world], self.experiment
        info: dict[str, Any] = {
            "frame": frame,
            "time_s": frame / FRAME_RATE_HZ,
            "reference": "none" if band is None else band.kind.value,
            "reference_source": experiment.reference_source.value,
            "drivers": experiment.drivers.value,
        }
        if experiment.edited:
            info["edited"] = True
        trial = self._trial_of(world)
        if trial is not None:
            info["trial"] = trial
        if world in self.diverged:
            info["diverged"] = self.diverged[world]
        return info

    def experiment_of(self, world: int) -> Experiment:
        """Return the experiment of a world, with the initial state and the trial of its episode."""
        experiment = self._experiments[world]
        if not self.initial_states or not self.initial_states[world].record:
            return experiment
        start = self.initial_states[world]
        scene = replace(scene_at(experiment.scene, start.states), drivers=start.drivers)
        return replace(experiment, scene=scene, trial=self._trial_of(world))

    def _trial_of(self, world: int) -> int | None:
        """Return the trial that a world replays, or None."""
        if self.initial_states and self.initial_states[world].trial is not None:
            return self.initial_states[world].trial
        return self._experiments[world].trial

    def trajectory(self, world: int = 0) -> Trajectory:
        """Return the recorded motion of a world so far.

        Raises:
            EpisodeError: `reset` was not called.
        """
        if self.frame is None:
            raise EpisodeError(f"{self.experiment.id}: no trajectory before reset")
        frame = int(self.last_frames[world])
        end = frame * SAMPLES_PER_FRAME + 1
        later_count = 0
        if self._later_counts is not None:
            later_count = int(self._later_counts[world]) * SAMPLES_PER_FRAME
        times_s = np.arange(end + later_count, dtype=np.float64) * SAMPLE_INTERVAL_S
        samples = self._samples[:, world].copy()
        return Trajectory(
            times_s=times_s[:end],
            samples=samples[:end],
            frames=samples[:end:SAMPLES_PER_FRAME],
            bodies=self._bodies[: frame + 1, world].copy(),
            markers_m=self._markers_m[: frame + 1, world].copy(),
            later_times_s=times_s[end:],
            later_samples=samples[end : end + later_count],
        )

    def trajectories(self) -> tuple[FloatArray, FloatArray]:
        """Return times [s], shape [sample_count], and g(t) of all worlds, shape [N, sample_count, coordinate_count].

        Samples after the end of a world are NaN.
        """
        counts = self.last_frames * SAMPLES_PER_FRAME + 1
        if self._later_counts is not None:
            counts = counts + self._later_counts * SAMPLES_PER_FRAME
        numbers = np.arange(len(self._samples))
        is_reached = numbers[:, None] < counts
        samples = np.where(is_reached[:, :, None], self._samples, np.nan)
        times_s = SAMPLE_INTERVAL_S * numbers.astype(np.float64)
        return times_s, samples.transpose(1, 0, 2)

    def score(self, world: int = 0) -> Score:
        """Return the score of a world whose episode is over; if the world diverged, the score has no numbers."""
        from gauge_envs.scoring.score import Score, score_trajectory

        experiment, band = self.experiment_of(world), self.bands[world]
        if not self.is_over[world]:
            raise EpisodeError(f"{experiment.id}: no score before the episode is over")
        if world in self.diverged:
            kind = "none" if band is None else band.kind.value
            return Score(kind=kind, unit=experiment.score.observable.unit)
        self.run_on()
        trajectory = self.trajectory(world)
        times_s, values = trajectory.dense
        return score_trajectory(
            experiment,
            band,
            times_s=times_s,
            values=values,
            markers_m=trajectory.markers_m,
            is_checked=True,
            is_moved=bool(self.initial_states)
            and self.initial_states[world].is_scattered,
        )

    # --- poses for pictures ---

    def poses(self, world: int = 0) -> Mapping[str, FloatArray]:
        """Return the pose of each rigid body that moves: position [m] and quaternion w x y z, shape [7]."""
        view = self._last_view or self._view()
        return {name: view[name][world, :7] for name in (*self._dynamic, *self._driven)}

    def nodes_m(self, world: int = 0) -> Mapping[str, FloatArray]:
        """Return the nodes of each deformable body [m], shape [node_count, 3]."""
        view = self._last_view or self._view()
        return {name: view[name][world] for name in self.rest_nodes_m}

    def _view(self) -> dict[str, FloatArray]:
        """Return, by name, the states of moving bodies and the nodes of deformable bodies in all worlds."""
        names = [*self._dynamic, *self._driven]
        states = self.simulation.body_states(names)
        view = {name: states[:, row] for row, name in enumerate(names)}
        for name in self.rest_nodes_m:
            view[name] = self.simulation.nodes(name).copy()
        return view

    def _band_of(self, world: int) -> Band | None:
        """Return the reference of a world: of the trial that it replays, else the nominal one."""
        from gauge_envs.scoring.reference import reference_band

        if not self.initial_states or self.initial_states[world].trial is None:
            return self._nominal_bands[world]
        return reference_band(self.experiment_of(world))

    def _set_bands(self, bands: Sequence[Band | None]) -> None:
        self.bands = bands
        is_bounded = is_reward_bounded(self.experiment)
        distinct = {id(band): band for band in bands if band is not None}
        self._rewards: list[tuple[Reward, slice | BoolArray]] = []
        for band in distinct.values():
            worlds = np.array([world_band is band for world_band in bands])
            reward = Reward(band, is_bounded)
            # A slice of all worlds needs no copy.
            self._rewards.append((reward, slice(None) if worlds.all() else worlds))
