"""Scenes of the suite, run with a configuration's settings at the configuration's own step."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from math import floor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends import Backend, Simulation
from gauge_envs.checks.rollout import DeclinedError, DivergedError
from gauge_envs.errors import ParameterError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.scene_builder import Parameters
from gauge_envs.experiments.variants import find_variant
from gauge_envs.observables.kinds import Observable
from gauge_envs.observables.observer import MarkerProxy, ObserverMarkers
from gauge_envs.scene import Motion, Scene
from gauge_envs.scene.driver_path import DriverPath
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S

__all__ = [
    "Rollout",
    "Scenario",
    "rollout",
    "settings_in_force",
]


def _unchanged(scene: Scene) -> Scene:
    return scene


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """A scene of the suite and how long it is watched.

    Attributes:
        name: Unique name; rollouts are kept by it.
        variant: Variant of the suite, as `SlopeSlider-1-wood`.
        seconds: How long it is simulated [s].
        parameters: Parameter set of the variant.
        interval_s: Longest time between samples, unless a step is longer [s].
        change: What is left of the scene, as a wall without the ball that strikes it.
        nodes_of: Deformable bodies of which all nodes are kept, and not markers alone.
    """

    name: str
    variant: str
    seconds: float
    parameters: Parameters = "calibrated"
    interval_s: float = 0.002
    change: Callable[[Scene], Scene] = field(default=_unchanged)
    nodes_of: tuple[str, ...] = ()

    @property
    def id(self) -> str:
        """Gymnasium id of the variant."""
        return find_variant(self.variant).id

    @cached_property
    def scene(self) -> Scene:
        """The scene, driven as the task file states."""
        return self.change(load_experiment(self.variant, self.parameters).scene)


@dataclass(frozen=True, kw_only=True)
class Rollout:
    """What happened on a stage.

    Attributes:
        scene: The scene.
        times_s: Times of the samples, shape [sample_count]; evenly spaced.
        states: States of each body that can move, by name, shape [sample_count, 13]; see `World.body_states`.
        settings: Settings in force.
        nodes_m: Nodes of deformable bodies that the stage names [m], shape [sample_count, node_count, 3].
        markers_m: The scene's markers as points of the material [m], shape [sample_count, marker_count, 3].
    """

    scene: Scene
    times_s: NDArray[np.float64]
    states: Mapping[str, NDArray[np.float64]]
    settings: Mapping[str, Any]
    nodes_m: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    markers_m: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0, 3)))

    @property
    def interval_s(self) -> float:
        """Time between samples [s]."""
        return float(self.times_s[1] - self.times_s[0])

    def position(self, name: str) -> NDArray[np.float64]:
        """Positions of a body [m], shape [sample_count, 3]."""
        return self.states[name][:, :3]

    def between(self, start_s: float, end_s: float) -> NDArray[np.bool_]:
        """Samples from one time to another, both included, shape [sample_count]."""
        return (self.times_s >= start_s - 1e-9) & (self.times_s <= end_s + 1e-9)


def rollout(backend: Backend, stage: Scenario, settings: Mapping[str, Any]) -> Rollout:
    """Build a stage's scene and run it.

    It is driven and sampled every few steps, as many as fit in the stage's interval, or every step. Settings without
    a step leave that to the backend: it is driven and sampled every 1/180 s then, unless its preset says otherwise.

    Args:
        backend: The backend.
        stage: The stage.
        settings: Settings of the backend; what they leave out is its default for the scene.

    Raises:
        DeclinedError: The backend cannot build the scene, or refuses the settings for it.
        DivergedError: A body or a node is not where, or not as fast as, the scene's energy allows.
    """
    simulation = _built(backend, stage, settings)
    try:
        simulation.reset(0)
        return _recorded(simulation, stage)
    finally:
        simulation.close()


def settings_in_force(backend: Backend, stage: Scenario, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Every numerical setting that a stage would run with, preset included.

    Raises:
        DeclinedError: The backend cannot build the scene, or refuses the settings for it.
    """
    simulation = _built(backend, stage, settings)
    try:
        return dict(simulation.settings)
    finally:
        simulation.close()


def _built(backend: Backend, stage: Scenario, settings: Mapping[str, Any]) -> Simulation:
    support = backend.supports(stage.scene)
    if not support:
        raise DeclinedError(support.missing)
    try:
        return backend.build(stage.scene, _with_interval(settings, stage.interval_s))
    except ParameterError as error:
        raise DeclinedError((str(error),)) from error
    # An engine refuses combinations of settings in its own words, and they may do for the next scene.
    except Exception as error:
        raise DeclinedError((f"{type(error).__name__}: {error}",)) from error


def _with_interval(settings: Mapping[str, Any], longest_s: float) -> dict[str, Any]:
    """Settings with the drive interval that goes with their step, if they state one."""
    step = settings.get("timestep_s")
    if step is None:
        return dict(settings)
    return {**settings, "drive_interval_s": step * max(1, floor(longest_s / step + 1e-6))}


def _recorded(simulation: Simulation, stage: Scenario) -> Rollout:
    scene = stage.scene
    interval = float(simulation.settings.get("drive_interval_s", SAMPLE_INTERVAL_S))
    count = round(stage.seconds / interval)
    frames = 2 + floor(stage.seconds * FRAME_RATE_HZ)
    paths = [DriverPath(driver, scene, frames, interval_s=interval) for driver in scene.drivers]
    names = [body.name for body in scene.bodies if body.motion is not Motion.FIXED]
    dynamic = [index for index, name in enumerate(names) if scene.body(name).motion is Motion.DYNAMIC]
    states = np.empty((count + 1, len(names), 13))
    soft = _SoftRecord(simulation, stage, count)
    states[0] = simulation.body_states(names)
    for sample in range(count):
        for path in paths:
            simulation.drive(path.body, *path.interval(sample, np.zeros(path.motion_count)))
        _advance(simulation, interval, sample)
        states[sample + 1] = simulation.body_states(names)
        fault = _fault(states[sample : sample + 2, dynamic], scene, interval) or soft.take(sample + 1, interval)
        if fault:
            raise DivergedError(f"after {(sample + 1) * interval:.3g} s {fault}")
    return Rollout(
        scene=scene,
        times_s=interval * np.arange(count + 1, dtype=np.float64),
        states={name: states[:, index] for index, name in enumerate(names)},
        settings=dict(simulation.settings),
        nodes_m=soft.nodes_m,
        markers_m=soft.markers_m,
    )


def _advance(simulation: Simulation, interval_s: float, sample: int) -> None:
    try:
        simulation.advance(interval_s)
    # An engine gives up in its own words, as MuJoCo where what blows up makes more contacts than it has memory for.
    except Exception as error:
        cause = " ".join(str(error).split())
        raise DivergedError(f"after {sample * interval_s:.3g} s the engine gives up: {cause}") from error


class _SoftRecord:
    """What deformable bodies do in a rollout.

    Args:
        simulation: The simulation, at the start.
        stage: The stage.
        count: How many samples will follow.
    """

    def __init__(self, simulation: Simulation, stage: Scenario, count: int) -> None:
        scene = stage.scene
        self._simulation = simulation
        self._limit_m_per_s = scene.speed_limit_m_per_s
        self._last_m = {body.name: simulation.nodes(body.name) for body in scene.deformables}
        self.nodes_m = {name: np.empty((count + 1, *self._last_m[name].shape)) for name in stage.nodes_of}
        self._observer = (
            None
            if scene.markers is None
            else ObserverMarkers(scene, Observable.MARKER_POSITION, simulation, MarkerProxy.MATERIAL)
        )
        self.markers_m = np.empty((count + 1, 0 if scene.markers is None else len(scene.markers.positions_m), 3))
        self._keep(0)

    def take(self, sample: int, interval_s: float) -> str:
        """Read everything; why it is not of this scene, or an empty text where it may be."""
        for name, before in self._last_m.items():
            self._last_m[name] = now = self._simulation.nodes(name)
            speed = float(np.abs(now - before).max(initial=0.0)) / interval_s
            # A comparison with NaN is false.
            if not speed <= self._limit_m_per_s:
                return f"{name} moves at {speed:.3g} m/s, more than the scene can give ({self._limit_m_per_s:.3g} m/s)"
        self._keep(sample)
        return ""

    def _keep(self, sample: int) -> None:
        for name, kept in self.nodes_m.items():
            kept[sample] = self._last_m[name]
        if self._observer is not None:
            self._observer.now(self._simulation)
            self.markers_m[sample] = self._observer.markers_m


def _fault(states: NDArray[np.float64], scene: Scene, interval_s: float) -> str:
    """Why two samples in a row, shape [2, body_count, 13], are not of this scene; empty where they may be.

    The way between them is bounded too, since an engine may catch what blows up and set it back to the start.
    """
    limit = scene.speed_limit_m_per_s
    speed = float(np.abs(states[1, :, 7:10]).max(initial=0.0))
    way = float(np.abs(np.diff(states[:, :, :3], axis=0)).max(initial=0.0))
    # A comparison with NaN is false.
    if speed <= limit and way <= limit * interval_s:
        return ""
    if not np.isfinite(states).all():
        return "the state is not finite"
    return f"a body moves at {max(speed, way / interval_s):.3g} m/s, more than the scene can give ({limit:.3g} m/s)"
