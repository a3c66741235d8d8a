"""Episodes of one experiment in N worlds, and the only loop over time, `simulate`.

A step drives, advances and observes the worlds six times, and then checks for divergence. Control tasks use the same
rollout with their own motions and recording; engine checks and sanity checks use the same loop.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from gauge_envs.backends.simulation import Simulation
from gauge_envs.envs.initial_states import InitialState
from gauge_envs.envs.limits import diverged_bodies, diverged_nodes, spans_m
from gauge_envs.envs.recording import EpisodeRecording
from gauge_envs.errors import BackendError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.geometry import BoolArray, FloatArray, IntArray
from gauge_envs.scene.prescribed_motion import prescribed_motions
from gauge_envs.scene.states import row_of, scene_at
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S, SAMPLES_PER_FRAME


class DrivenMotion(Protocol):
    """Prescribed motion of a body, such as `gauge_envs.scene.prescribed_motion.PrescribedMotion`."""

    body: str

    def targets(
        self, first: int | IntArray, actions: FloatArray, count: int = 1
    ) -> FloatArray:
        """Return the targets of the next intervals for `Simulation.drive`, shape [count, N, 19]."""
        ...


class Motion(DrivenMotion, Protocol):
    """Prescribed motion that each episode starts anew; see `PrescribedMotion`."""

    motion_count: int

    def reset(
        self,
        drivers: Sequence[Driver] | None = None,
        start_poses: FloatArray | None = None,
        worlds: BoolArray | None = None,
    ) -> None:
        """Return to the start in some worlds."""


class Recording(Protocol):
    """What a rollout records; see `EpisodeRecording`."""

    def start(self, worlds: BoolArray) -> None:
        """Record the start of worlds."""

    def read_points(self, interval: int) -> None:
        """Read all worlds after an interval of a frame."""

    def end_frame(self, is_running: BoolArray) -> FloatArray | None:
        """Record a frame, and return the states of the dynamic bodies, shape [N, body_count, 13], if it read them."""


AfterInterval = Callable[[int], None]
"""Function that receives the index of each interval after it."""


def simulate(
    simulation: Simulation,
    motions: Sequence[DrivenMotion],
    first: int | IntArray,
    count: int,
    actions: Sequence[FloatArray],
    *,
    observers: Sequence[AfterInterval] = (),
    interval_s: float = SAMPLE_INTERVAL_S,
) -> None:
    """Drive and advance all worlds in intervals.

    Args:
        simulation: The worlds.
        motions: Motions of the driven bodies.
        first: Number of the first interval since the start, or the number in each world, shape [N].
        count: Number of intervals.
        actions: Actions of each motion in all of these intervals, shape [N, motion_count].
        observers: Functions that are called after each interval.
        interval_s: Length of an interval [s].
    """
    drives = [
        simulation.prepared(motion.body, motion.targets(first, action, count))
        for motion, action in zip(motions, actions, strict=True)
    ]
    for index in range(count):
        for drive in drives:
            drive(index)
        simulation.advance(interval_s)
        for observe in observers:
            observe(index)


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


class Rollout:
    """Episodes in N worlds, each with its own start and end; each step is one frame of all worlds.

    A world that diverges ends. Its observation stays that of its last frame, and the other worlds continue.

    Args:
        experiments: The experiment of each world; they may differ in constants.
        simulation: The worlds, at the nominal start.
        marker_proxy: Marker proxy of deformable bodies: material point or nearest node.
        motions: Motions of the driven bodies; None is the recorded motion with a displacement by actions.
        recorder: What is recorded; None is an `EpisodeRecording`.

    Attributes:
        experiment: The experiment of the first world.
        simulation: The worlds.
        world_count: Number of worlds N.
        frames: Number of the current frame of each world, shape [N].
        has_begun: Whether the worlds were reset.
        is_running: Which worlds the last step advanced, shape [N].
        is_over: Which worlds have ended, shape [N].
        terminated: Which worlds have diverged, shape [N].
        diverged: Reason of each diverged world, by its number.
        initial_states: Initial state of each world; empty for the nominal ones.
        rest_nodes_m: Nodes of each deformable body at the nominal start [m], shape [node_count, 3].

    Raises:
        BackendError: The states of the engine violate the contract of `Simulation.body_states`.
    """

    def __init__(
        self,
        experiments: Sequence[Experiment],
        simulation: Simulation,
        *,
        marker_proxy: MarkerProxy = MarkerProxy.MATERIAL,
        motions: Sequence[Motion] | None = None,
        recorder: Recording | None = None,
    ) -> None:
        self.experiment = experiment = experiments[0]
        scene = experiment.scene
        self.simulation = simulation
        self.world_count = simulation.world_count
        self.frames = np.zeros(self.world_count, dtype=np.intp)
        self.has_begun = False
        self.is_running = np.ones(self.world_count, dtype=np.bool_)
        self.is_over = np.zeros(self.world_count, dtype=np.bool_)
        self.terminated = np.zeros(self.world_count, dtype=np.bool_)
        self.diverged: dict[int, str] = {}
        self.initial_states: Sequence[InitialState] = ()
        self._experiments = experiments
        self._last_frame = experiment.frame_count - 1
        self._dynamic = [body.name for body in scene.dynamic_bodies]
        driven = [driver.body for driver in scene.drivers]
        check_states(simulation, [*self._dynamic, *driven])
        if motions is None:
            seconds = (experiment.frame_count - 1) / FRAME_RATE_HZ
            motions = prescribed_motions(scene, seconds, world_count=self.world_count)
        self._motions = motions
        self.rest_nodes_m = {
            body.name: simulation.nodes(body.name)[0].copy()
            for body in scene.deformables
        }
        self._rest_spans_m = {
            name: float(spans_m(nodes[None])[0])
            for name, nodes in self.rest_nodes_m.items()
        }
        self._recorder = recorder or EpisodeRecording(
            experiment, simulation, self.frames, marker_proxy
        )

    @property
    def recording(self) -> EpisodeRecording:
        """The recorded motion of the worlds; control tasks record none."""
        assert isinstance(self._recorder, EpisodeRecording)
        return self._recorder

    @property
    def motion_count(self) -> int:
        """Length of an action: the degrees of freedom of all driven bodies."""
        return sum(motion.motion_count for motion in self._motions)

    # --- frames ---

    def reset(
        self,
        initial_states: Sequence[InitialState] | None = None,
        seed: int = 0,
        worlds: BoolArray | None = None,
    ) -> None:
        """Start an episode in worlds, and record frame 0.

        Args:
            initial_states: Initial state of every world; None starts each as the scene gives.
            seed: Seed of the engine.
            worlds: Which worlds start, shape [N]; None is all.
        """
        if worlds is None:
            worlds = np.ones(self.world_count, dtype=np.bool_)
        self.initial_states = initial_states or ()
        states = None
        if initial_states is None:
            for motion in self._motions:
                motion.reset(worlds=worlds)
        else:
            states = np.array([start.states for start in initial_states])
            for index, motion in enumerate(self._motions):
                row = row_of(self.experiment.scene, motion.body)
                drivers = [start.drivers[index] for start in initial_states]
                motion.reset(drivers, states[:, row, :7], worlds)
        some = () if worlds.all() else (worlds,)
        self.simulation.reset(states, seed, *some)
        self.has_begun = True
        self.frames[worlds] = 0
        for world in np.flatnonzero(worlds & self.terminated).tolist():
            del self.diverged[world]
        self.terminated[worlds] = self.is_over[worlds] = False
        self._recorder.start(worlds)

    def step(
        self, actions: FloatArray | None = None, observers: Sequence[AfterInterval] = ()
    ) -> None:
        """Simulate one frame of all worlds.

        Args:
            actions: Actions from -1 to 1, shape [N, motion_count]; None is no action.
            observers: Functions that are called after each of the six intervals.
        """
        assert self.has_begun, "call reset first"
        if actions is None:
            actions = np.zeros((self.world_count, self.motion_count))
        motion_actions = []
        end = 0
        for motion in self._motions:
            begin, end = end, end + motion.motion_count
            motion_actions.append(actions[:, begin:end])
        simulate(
            self.simulation,
            self._motions,
            self.frames * SAMPLES_PER_FRAME,
            SAMPLES_PER_FRAME,
            motion_actions,
            observers=[self._recorder.read_points, *observers],
        )
        self.is_running = ~self.is_over
        self.frames += self.is_running
        states = self._recorder.end_frame(self.is_running)
        for world, reason in self.divergences(states).items():
            if self.is_running[world]:
                self.diverged[world] = reason
                self.terminated[world] = True
        self.is_over = self.terminated | (self.frames == self._last_frame)

    def play(self, *observers: AfterInterval) -> None:
        """Simulate all episodes to their end without actions.

        Args:
            *observers: Functions that are called after each interval of a frame.
        """
        while not self.is_over.all():
            self.step(observers=observers)

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

    # --- episode of a world ---

    def poses(self, world: int = 0) -> dict[str, FloatArray]:
        """Return the pose of each rigid body that moves now: position [m] and quaternion w x y z, shape [7]."""
        driven = [driver.body for driver in self.experiment.scene.drivers]
        names = [*self._dynamic, *driven]
        poses = self.simulation.body_states(names)[world, :, :7]
        return dict(zip(names, poses, strict=True))

    def nodes_m(self, world: int = 0) -> dict[str, FloatArray]:
        """Return the nodes of each deformable body now [m], shape [node_count, 3]."""
        return {
            name: self.simulation.nodes(name)[world].copy()
            for name in self.rest_nodes_m
        }

    @property
    def times_s(self) -> FloatArray:
        """Time since the start of each episode [s], shape [N]."""
        return self.frames / FRAME_RATE_HZ

    def info(self, world: int) -> dict[str, Any]:
        """Return the `info` of a world without its frame, time and reference, see `GaugeEnv`."""
        experiment = self.experiment
        info: dict[str, Any] = {
            "reference_source": experiment.reference_source.value,
            "drivers": experiment.drivers.value,
        }
        if experiment.edited:
            info["edited"] = True
        trial = self.trial_of(world)
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
        return replace(experiment, scene=scene, trial=self.trial_of(world))

    def trial_of(self, world: int) -> int | None:
        """Return the trial that a world replays, or None."""
        if self.initial_states and self.initial_states[world].trial is not None:
            return self.initial_states[world].trial
        return self._experiments[world].trial
