"""One episode of one experiment on one world: it drives, observes, records and judges, frame by frame.

`Episode.simulated` is one frame. `Episode.advance` runs it for a world that is a simulation of its own. Worlds that
share a simulation advance together where it yields, six times a frame. `envs.stepper` does both for many worlds.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces

from gauge_envs.backends.settings import check_drive_interval
from gauge_envs.backends.world import Simulation, World
from gauge_envs.envs.arguments import checked_action
from gauge_envs.envs.divergence import DeformableBounds, RigidBounds
from gauge_envs.envs.driver_paths import DriverPaths
from gauge_envs.envs.reward import bounded_reward, is_reward_bounded, reward_terms
from gauge_envs.envs.spaces import (
    Observation,
    action_space_of,
    observation_space_of,
)
from gauge_envs.errors import EpisodeError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.observables.observer import (
    MarkerProxy,
    Observer,
    ObserverMarkers,
    ObserverPositions,
)
from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S, SAMPLES_PER_FRAME
from gauge_envs.scoring.metrics import MAX_TIME_OFFSET_S

if TYPE_CHECKING:
    # Scores import much of SciPy, and come with the end of an episode.
    from gauge_envs.scoring.score import Score

LATER_FRAMES = round(MAX_TIME_OFFSET_S * FRAME_RATE_HZ)
"""Frames that an aligned episode is simulated on after its last one."""

View = tuple[dict[str, FloatArray], dict[str, FloatArray]]
"""Poses of rigid bodies and nodes of deformable ones, by name."""


@dataclass(frozen=True, kw_only=True)
class Trajectory:
    """What an episode has recorded so far.

    Attributes:
        times_s: Times of the dense samples [s], 180 a second, shape [sample_count].
        samples: The generalized trajectory g(t) at those times, shape [sample_count, coordinate_count].
        frames: g(t) at the 30 Hz frames, shape [frame_count, coordinate_count].
        bodies: States of the recorded bodies at the frames, shape [frame_count, body_count, 13]; `body_count` is 0 if
            markers are recorded.
        markers_m: Marker positions at the frames [m], shape [frame_count, marker_count, 3]; `marker_count` is 0 if
            bodies are recorded.
        later_times_s: Times of samples after the last frame [s], for the release alignment; shape [later_count], empty
            before the score is read and where nothing is aligned.
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


class Episode:
    """One episode on one world.

    Args:
        experiment: The experiment.
        world: The world, at the start of the experiment's scene.
        band: Band that scores are relative to, or None.
        marker_proxy: Marker proxy of deformable bodies: tracked node or material point.

    Attributes:
        experiment: The experiment.
        band: Band that scores and rewards are relative to, or None: rewards are 0.
        marker_proxy: Marker proxy of deformable bodies.
        frame: Number of the current frame; None before `begin`.
        fault: Why the simulation counts as diverged, or None.
        action_space: Action space of the environment.
        rest_nodes_m: Nodes of each deformable body at the start [m], each of shape [node_count, 3].
        deformable_bounds: Bounds of each deformable body.
        observer: Observer of g(t).
    """

    def __init__(
        self,
        experiment: Experiment,
        world: World,
        *,
        band: Band | None,
        marker_proxy: MarkerProxy,
    ) -> None:
        check_drive_interval(world.settings)
        scene = experiment.scene
        self.experiment = experiment
        self.band = band
        self.marker_proxy = marker_proxy
        self.frame: int | None = None
        self.fault: str | None = None
        self._world = world
        is_aligned = band is not None and band.has_release and experiment.trial is None
        self._later_frames = LATER_FRAMES if is_aligned else 0
        self._later = 0
        self._later_limit = self._later_frames
        self._last_view: View | None = None
        self._drivers = DriverPaths(
            scene, (experiment.frame_count + self._later_frames) / FRAME_RATE_HZ
        )
        self._driven = tuple(driver.body for driver in scene.drivers)
        self._dynamic = tuple(body.name for body in scene.dynamic_bodies)
        rows = [self._dynamic.index(name) for name in experiment.recorded]
        # A slice reads faster than an index array, and most experiments record all dynamic bodies.
        self._recorded_rows = (
            slice(None) if rows == list(range(len(self._dynamic))) else rows
        )
        self.is_reward_bounded = is_reward_bounded(experiment)
        self._reward_terms = reward_terms(band, is_bounded=self.is_reward_bounded)
        self._rewards_points = band is not None and band.points is not None
        self.rest_nodes_m = self.nodes_m()
        self._rigid_bounds = RigidBounds(scene)
        self.deformable_bounds = [
            DeformableBounds(name, scene, rest)
            for name, rest in self.rest_nodes_m.items()
        ]
        observable = experiment.score.observable
        self.observer: Observer
        if observable is Observable.POSITION:
            self.observer = ObserverPositions(experiment.recorded)
        else:
            self.observer = ObserverMarkers(scene, observable, world, marker_proxy)
        self._kind = Kind.NONE.value if band is None else band.kind.value
        # What `info` states of every frame.
        self._origin: dict[str, Any] = {
            "reference": self._kind,
            "reference_source": experiment.reference_source.value,
            "drivers": experiment.drivers.value,
        }
        if experiment.edited:
            self._origin["edited"] = True
        if experiment.trial is not None:
            self._origin["trial"] = experiment.trial
        frame_count = experiment.frame_count
        sample_count = (frame_count - 1 + self._later_frames) * SAMPLES_PER_FRAME + 1
        self._samples = np.full((sample_count, self.observer.width), np.nan)
        self._bodies = np.full((frame_count, len(experiment.recorded), 13), np.nan)
        self._markers_m = np.full((frame_count, *self.observer.markers_m.shape), np.nan)
        self.action_space = action_space_of(experiment)

    @cached_property
    def observation_space(self) -> spaces.Space[Observation]:
        """Observation space of the environment."""
        return observation_space_of(self.experiment)

    # --- rollout ---

    @property
    def settings(self) -> Mapping[str, Any]:
        """Numerical settings of the engine."""
        return self._world.settings

    @property
    def is_complete(self) -> bool:
        """Whether this is the last frame."""
        return self.frame == self.experiment.frame_count - 1

    @property
    def is_over(self) -> bool:
        """Whether the episode is complete or has diverged."""
        return self.fault is not None or self.is_complete

    def begin(self) -> None:
        """Record frame 0; the world is at the start."""
        self.restart()
        self._samples[0] = self.observer.now(self._world)
        self._record()

    def start_at(self, experiment: Experiment) -> bool:
        """Take another start of rigid bodies in the next episode, or return False.

        Args:
            experiment: The same experiment, whose start or trial may be another one.
        """
        scene = experiment.scene
        is_same = (
            not scene.deformables
            and scene.drivers == self.experiment.scene.drivers
            and experiment.trial is self.experiment.trial is None
        )
        if is_same:
            self.experiment = experiment
            self._rigid_bounds = RigidBounds(scene)
        return is_same

    def restart(self) -> None:
        """Return to frame 0 without recording it, for a caller that records it in the arrays of `record_in`."""
        self._drivers.reset()
        self.frame = 0
        self.fault = None
        self._later = 0
        self._later_limit = self._later_frames
        self._last_view = None

    @property
    def no_rates(self) -> FloatArray:
        """Residual rates of zero, which replay the recorded motion, shape [motion_count]."""
        return self._drivers.no_rates

    def simulated(
        self, rates: FloatArray, *, after_sample: Callable[[int], None] | None = None
    ) -> Generator[None]:
        """Drive and observe the next frame. It yields where a world that someone else advances must do so, by 1/180 s.

        A world that is a simulation of its own advances here, and nothing is yielded: engines advance and read it
        faster in one call.

        Args:
            rates: Residual rates from `checked`, shape [motion_count].
            after_sample: Called after each sample with its number in the frame, from 0 to 5; it does not change g(t).
        """
        world = self._world
        first = self._simulated_frame * SAMPLES_PER_FRAME
        rows = self._samples[first + 1 : first + 1 + SAMPLES_PER_FRAME]
        simulation = world if isinstance(world, Simulation) else None
        is_watched = after_sample is not None
        if simulation is not None and self._drivers.is_passive and not is_watched:
            rows[:] = self.observer.sample(
                simulation, SAMPLES_PER_FRAME, SAMPLE_INTERVAL_S
            )
            return
        motions = self._drivers.motions(first, rates, SAMPLES_PER_FRAME)
        for sample, row in enumerate(rows):
            self._drivers.prescribe(world, motions[sample])
            if simulation is not None:
                row[:] = self.observer.sample(simulation, 1, SAMPLE_INTERVAL_S)[0]
            else:
                yield
                row[:] = self.observer.now(world)
            if after_sample is not None:
                after_sample(sample)

    def advance(
        self, rates: FloatArray, *, after_sample: Callable[[int], None] | None = None
    ) -> None:
        """Run the next frame of a world that is a simulation of its own; the arguments are those of `simulated`."""
        next(self.simulated(rates, after_sample=after_sample), None)

    def play(self, *, after_sample: Callable[[int], None] | None = None) -> None:
        """Run the episode without actions, on a world that is a simulation of its own and at its start.

        Args:
            after_sample: As for `simulated`.
        """
        self.begin()
        while not self.is_over:
            self.advance(self.no_rates, after_sample=after_sample)
            self.end_frame()

    def end_frame(self) -> str | None:
        """Record the frame, and return why the simulation counts as diverged, or None."""
        self.frame = (self.frame or 0) + 1
        self.fault = self.fault_of(self._record())
        return self.fault

    @property
    def _simulated_frame(self) -> int:
        """Frame of the world, which runs on after the last frame."""
        return (self.frame or 0) + self._later

    @property
    def runs_on(self) -> bool:
        """Whether the world must run on after the last frame before the episode can be scored."""
        return (
            self.is_complete and self.fault is None and self._later < self._later_limit
        )

    def run_on(self) -> None:
        """Simulate on past the last frame, so that the release alignment knows the later motion.

        Driven bodies continue their recorded motion without actions. The simulation then returns to the last frame.
        """
        world = self._world
        if not self.runs_on or not isinstance(world, Simulation):
            return
        state = world.state()
        run_on_together([self], lambda _: self.advance(self.no_rates))
        world.restore(state)

    def begin_later_frame(self, view: View | None = None) -> None:
        """Keep the view of the last frame before the world runs on.

        Args:
            view: Poses and nodes of the last frame, if they are known; None reads them.
        """
        if self._last_view is None:
            self._last_view = view or (self.poses(), self.nodes_m())

    def end_later_frame(self) -> None:
        """Count a frame after the last one; a world that diverges there ends before it."""
        self._later += 1
        states = self._world.body_states(self._dynamic)
        if (
            self.fault_of(states) is not None
            or not np.isfinite(self._later_rows()).all()
        ):
            self.count_later_frames(self._later - 1)

    def count_later_frames(self, count: int) -> None:
        """State how many frames the world ran on after the last one; it runs on no further."""
        self._later = self._later_limit = count

    @property
    def later_limit(self) -> int:
        """Largest number of frames that the world runs on after the last one."""
        return self._later_limit

    def _later_rows(self) -> FloatArray:
        first = ((self.frame or 0) * SAMPLES_PER_FRAME) + 1
        return self._samples[first : first + self._later * SAMPLES_PER_FRAME]

    def record_in(
        self,
        samples: FloatArray,
        bodies: FloatArray,
        markers_m: FloatArray,
    ) -> None:
        """Record in arrays of the caller from now on, which may be parts of those of many worlds.

        Args:
            samples: Place of g(t) at the samples, of the shape of `sample_shape`.
            bodies: Place of the states of the recorded bodies at the frames, shape [frame_count, body_count, 13].
            markers_m: Place of the markers at the frames [m], shape [frame_count, marker_count, 3].
        """
        places = (samples, bodies, markers_m)
        for place, record in zip(places, self._records(), strict=True):
            place[:] = record
        self._samples, self._bodies, self._markers_m = places

    @property
    def sample_shape(self) -> tuple[int, int]:
        """Shape of the record of g(t): samples up to the last later frame, and coordinates."""
        count, width = self._samples.shape
        return count, width

    def _records(self) -> tuple[FloatArray, ...]:
        return self._samples, self._bodies, self._markers_m

    @property
    def sample_count(self) -> int:
        """Number of samples of g(t) that were recorded, those after the last frame included."""
        return self._simulated_frame * SAMPLES_PER_FRAME + 1

    def trajectory(self) -> Trajectory:
        """Return what the episode has recorded so far."""
        if self.frame is None:
            raise EpisodeError(f"{self.experiment.id}: no trajectory before reset")
        last = self.frame * SAMPLES_PER_FRAME + 1
        return Trajectory(
            times_s=np.arange(last, dtype=np.float64) * SAMPLE_INTERVAL_S,
            samples=self._samples[:last].copy(),
            frames=self._samples[:last:SAMPLES_PER_FRAME].copy(),
            bodies=self._bodies[: self.frame + 1].copy(),
            markers_m=self._markers_m[: self.frame + 1].copy(),
            later_times_s=(last + np.arange(len(self._later_rows()), dtype=np.float64))
            * SAMPLE_INTERVAL_S,
            later_samples=self._later_rows().copy(),
        )

    def score(self) -> Score:
        """Return the score of the episode; if it diverged, the score has a kind and no number."""
        from gauge_envs.scoring.score import Score, score_trajectory

        if not self.is_over:
            raise EpisodeError(
                f"{self.experiment.id}: no score before the episode is over"
            )
        if self.fault is not None:
            return Score(kind=self._kind, unit=self.experiment.score.observable.unit)
        times_s, values = self.trajectory().dense
        return score_trajectory(
            self.experiment,
            self.band,
            times_s=times_s,
            values=values,
            markers_m=self._markers_m,
            is_checked=True,
        )

    # --- reading ---

    def poses(self) -> dict[str, FloatArray]:
        """Return the pose of each rigid body that moves: position [m] and quaternion w x y z, shape [7]."""
        if self._last_view is not None:
            return self._last_view[0]
        moving = (*self._dynamic, *self._driven)
        return dict(zip(moving, self._world.body_states(moving)[:, :7], strict=True))

    def nodes_m(self) -> dict[str, FloatArray]:
        """Return the nodes of each deformable body [m], shape [node_count, 3]."""
        if self._last_view is not None:
            return self._last_view[1]
        return {
            body.name: self._world.nodes(body.name).copy()
            for body in self.experiment.scene.deformables
        }

    def _record(self) -> FloatArray:
        """Record bodies and markers of the frame; return the states of the dynamic bodies, shape [body_count, 13]."""
        states = self._world.body_states(self._dynamic)
        frame = self.frame or 0
        self._bodies[frame] = states[self._recorded_rows]
        if self._markers_m.size:
            self._markers_m[frame] = self.observer.markers_m
        return states

    def checked(self, action: Any) -> FloatArray:
        """Return the residual rates of an action, shape [motion_count]."""
        return checked_action(action, self.action_space)

    def observation(self) -> Observation:
        """Return the observation of the current frame."""
        frame = self.frame or 0
        observation = {
            "observable": self._samples[frame * SAMPLES_PER_FRAME].copy(),
            "time": np.array([frame / FRAME_RATE_HZ]),
        }
        if self.experiment.recorded:
            observation["bodies"] = self._bodies[frame].copy()
        else:
            observation["markers"] = self._markers_m[frame].copy()
        if self._driven:
            observation["driver"] = self._world.body_states(self._driven)
        return observation

    def info(self) -> dict[str, Any]:
        """Return frame, time, kind of the reference, sources of reference and driven motion, and any divergence."""
        frame = self.frame or 0
        info = {"frame": frame, "time_s": frame / FRAME_RATE_HZ, **self._origin}
        if self.fault is not None:
            info["diverged"] = self.fault
        return info

    def reward(self) -> float:
        """Return minus the mean over band coordinates of |z| at the frame; 0 where the band knows nothing.

        A band with `points` compares the positions of the markers [mm] instead. Of deformable bodies it is bounded.
        """
        if self._reward_terms is None:
            return 0.0
        projection, mean, weight = self._reward_terms
        frame = self.frame or 0
        here = self._samples[frame * SAMPLES_PER_FRAME]
        if self._rewards_points:
            here = 1e3 * self._markers_m[frame].ravel()
        deviation = projection.dot(here) - mean[frame]
        distance = float(np.abs(deviation).dot(weight[frame]))
        return bounded_reward(distance) if self.is_reward_bounded else -distance

    def fault_of(self, states: FloatArray) -> str | None:
        """Return why the simulation counts as diverged, or None.

        Args:
            states: Current states of the dynamic bodies, shape [body_count, 13].
        """
        engine_fault = self._world.fault()
        if engine_fault is not None:
            return engine_fault
        for bounds in self.deformable_bounds:
            fault = bounds.fault(self._world.nodes(bounds.name))
            if fault:
                return fault
        return self._rigid_bounds.fault(states)


def run_on_together(
    episodes: Sequence[Episode], advance: Callable[[Sequence[int]], None]
) -> None:
    """Simulate worlds on past the last frame, so that the release alignment knows the later motion.

    Args:
        episodes: The episode of each world.
        advance: Function that advances the worlds of some numbers by a frame without actions.
    """
    while running := [
        number for number, episode in enumerate(episodes) if episode.runs_on
    ]:
        for number in running:
            episodes[number].begin_later_frame()
        advance(running)
        for number in running:
            episodes[number].end_later_frame()
