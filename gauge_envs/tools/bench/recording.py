"""Record a scene on an engine, through the public contract alone."""

from __future__ import annotations

import math
import traceback
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from gauge_envs.backends import Simulation
from gauge_envs.envs.rollout import DrivenMotion, intervals
from gauge_envs.errors import BackendError, GaugeError
from gauge_envs.observables.kinds import Observable
from gauge_envs.observables.observer import MarkerProxy, ObserverMarkers
from gauge_envs.scene import Motion, Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.prescribed_motion import prescribed_motions
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

PACKAGE = Path(__file__).parents[2]

REST_S = 0.05
"""Time for which bodies must be slow to be at rest [s]: longer than they stop at a turning point of a vibration."""


NO_MARKERS = np.zeros((0, 3))
"""Markers of a scene without any."""


class DeclinedError(GaugeError):
    """The backend cannot build a scene, or rejects the settings for it.

    Attributes:
        missing: The reasons.
    """

    def __init__(self, missing: tuple[str, ...]) -> None:
        super().__init__("; ".join(missing))
        self.missing = missing


class DivergedError(GaugeError):
    """The engine failed, or a body left the bounds of position or speed of the scene."""


class NotFiniteError(DivergedError):
    """A state or a node is NaN or infinite."""


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Motion of all bodies of a scene, at evenly spaced samples.

    Attributes:
        scene: The scene.
        times_s: Times of the samples [s], shape [sample_count].
        states: States of each rigid body by name, shape [sample_count, 13]; see `Simulation.body_states`.
        nodes_m: Recorded nodes of deformable bodies by name [m], shape [sample_count, node_count, 3].
        markers_m: The scene's markers as points of the material [m], shape [sample_count, marker_count, 3].
    """

    scene: Scene
    times_s: FloatArray
    states: Mapping[str, FloatArray]
    nodes_m: Mapping[str, FloatArray] = field(default_factory=dict)
    markers_m: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 3)))

    @property
    def interval_s(self) -> float:
        """Time between samples [s]."""
        return float(self.times_s[1] - self.times_s[0])

    def position(self, name: str) -> FloatArray:
        """Return positions of a rigid body's origin [m], shape [sample_count, 3]."""
        return self.states[name][:, :3]

    def velocity(self, name: str) -> FloatArray:
        """Return velocities of a rigid body's origin [m/s], shape [sample_count, 3]."""
        return self.states[name][:, 7:10]

    def angular_velocity(self, name: str) -> FloatArray:
        """Return angular velocities of a rigid body [rad/s], shape [sample_count, 3]."""
        return self.states[name][:, 10:]

    def rotation(self, name: str) -> Rotation:
        """Return rotations of a rigid body from its frame to the world, one for each sample."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_quat(self.states[name][:, 3:7], scalar_first=True)

    def displacement(self, name: str) -> FloatArray:
        """Return displacements of a rigid body's origin from its start [m], shape [sample_count, 3]."""
        return self.position(name) - self.position(name)[0]

    def between(self, start_s: float, end_s: float) -> slice:
        """Return the samples from one time [s] to another, both included."""
        first = np.searchsorted(self.times_s, start_s - 1e-9, side="left")
        return slice(
            int(first), int(np.searchsorted(self.times_s, end_s + 1e-9, side="right"))
        )

    def cut(self, start_s: float, end_s: float) -> Recording:
        """Return the rollout from one time [s] to another, both included; times stay as they are."""
        part = self.between(start_s, end_s)
        return replace(
            self,
            times_s=self.times_s[part],
            states={name: states[part] for name, states in self.states.items()},
            nodes_m={name: nodes[part] for name, nodes in self.nodes_m.items()},
            markers_m=self.markers_m[part],
        )

    def sample_at(self, time_s: float) -> int:
        """Return the index of the sample nearest to a time [s]."""
        return int(np.abs(self.times_s - time_s).argmin())


def record(
    simulation: Simulation,
    scene: Scene,
    seconds: float,
    *,
    interval_s: float = SAMPLE_INTERVAL_S,
    nodes_of: Collection[str] | None = None,
    speed_limit_m_per_s: float = math.inf,
    ends_beyond_m: float = math.inf,
    rest_m_per_s: float = 0.0,
) -> Recording:
    """Drive a simulation from its start and record it.

    Args:
        simulation: The simulation, at time 0.
        scene: Its scene.
        seconds: Time to simulate [s].
        interval_s: Time between samples, and of one call of `advance` [s].
        nodes_of: Deformable bodies whose nodes are kept; all when None.
        speed_limit_m_per_s: Highest plausible speed of a dynamic or deformable body [m/s].
        ends_beyond_m: Displacement of a rigid body with which the rollout ends [m].
        rest_m_per_s: Speed along each axis; the rollout also ends if all dynamic bodies stay below it for `REST_S`
            [m/s].
    """
    count = round(seconds / interval_s)
    motions = prescribed_motions(scene, seconds, interval_s=interval_s)
    actions = [np.zeros((1, motion.motion_count)) for motion in motions]
    observer = None
    if scene.markers is not None:
        observer = ObserverMarkers(
            scene, Observable.MARKER_POSITION, simulation, MarkerProxy.MATERIAL
        )
    names = [body.name for body in scene.bodies]
    dynamic = [
        index
        for index, body in enumerate(scene.bodies)
        if body.motion is Motion.DYNAMIC
    ]
    last: _Sample | None = None
    samples: list[_Sample] = []
    last_motion = 0
    for index in range(count + 1):
        time = f"after {index * interval_s:.3g} s"
        sample = _read(simulation, scene, names, observer)
        if reason := simulation.diverged().get(0):
            raise DivergedError(f"{time} {reason}")
        if name := _not_finite(names, sample):
            raise NotFiniteError(f"{time} {name!r} is not finite")
        speeds = _speeds_m_per_s(dynamic, last or sample, sample, interval_s)
        fastest_m_per_s = max(speeds, default=0.0)
        if fastest_m_per_s > speed_limit_m_per_s:
            several = [*(names[index] for index in dynamic), *sample.nodes_m]
            name = several[speeds.index(fastest_m_per_s)]
            limit = f"the scene allows {speed_limit_m_per_s:.3g} m/s at most"
            raise DivergedError(
                f"{time} {name!r} moves at {fastest_m_per_s:.3g} m/s; {limit}"
            )
        kept = {
            name: nodes
            for name, nodes in sample.nodes_m.items()
            if nodes_of is None or name in nodes_of
        }
        samples.append(sample._replace(nodes_m=kept) if sample.nodes_m else sample)
        last = sample
        if fastest_m_per_s >= rest_m_per_s:
            last_motion = index
        is_at_rest = (index - last_motion) * interval_s >= REST_S
        if is_at_rest or _has_left(samples[0], sample, ends_beyond_m):
            break
        if index < count:
            _advance(simulation, motions, actions, index, interval_s, time)
    states = np.stack([sample.states for sample in samples])
    return Recording(
        scene=scene,
        times_s=interval_s * np.arange(len(samples), dtype=np.float64),
        states={body.name: states[:, index] for index, body in enumerate(scene.bodies)},
        nodes_m={
            name: np.stack([sample.nodes_m[name] for sample in samples])
            for name in samples[0].nodes_m
        },
        markers_m=np.stack([sample.markers_m for sample in samples]),
    )


def raised_at(error: BaseException) -> str:
    """Return where an engine raised an error, as ` (advance, my_engine.py, line 12)`; or "" for an intended error.

    The place is the last line in the engine's own folder, followed by the line of a library that it called.
    """
    if isinstance(error, BackendError) and error.__cause__ is not None:
        error = error.__cause__
    frames = traceback.extract_tb(error.__traceback__)
    if isinstance(error, GaugeError) or not frames:
        return ""
    folders = [Path(frame.filename).parent for frame in frames]
    first = next(
        (at for at, folder in enumerate(folders) if _is_of_engine(folder)),
        len(frames) - 1,
    )
    last = max(at for at, folder in enumerate(folders) if folder == folders[first])
    shown = [frames[last]]
    if last < len(frames) - 1:
        shown.append(frames[-1])
    places = [
        f"{frame.name}, {Path(frame.filename).name}, line {frame.lineno}"
        for frame in shown
    ]
    return f" ({'; in '.join(places)})"


def _is_of_engine(folder: Path) -> bool:
    """Return whether a folder belongs to an engine: a folder outside this package or of a bundled engine."""
    return not folder.is_relative_to(PACKAGE) or (
        folder.parent == PACKAGE / "backends" and folder.name != "shared"
    )


class _Sample(NamedTuple):
    """All bodies at one time.

    Attributes:
        states: States of the rigid bodies in the scene's order, shape [body_count, 13].
        nodes_m: Nodes of the deformable bodies by name [m], shape [node_count, 3].
        markers_m: The scene's markers [m], shape [marker_count, 3].
    """

    states: FloatArray
    nodes_m: dict[str, FloatArray]
    markers_m: FloatArray


def _read(
    simulation: Simulation,
    scene: Scene,
    names: Sequence[str],
    observer: ObserverMarkers | None,
) -> _Sample:
    markers_m = NO_MARKERS if observer is None else observer.markers(simulation)[0]
    return _Sample(
        states=np.array(simulation.body_states(names)[0], dtype=np.float64),
        nodes_m={
            body.name: np.array(simulation.nodes(body.name)[0], dtype=np.float64)
            for body in scene.deformables
        },
        markers_m=markers_m,
    )


def _advance(
    simulation: Simulation,
    motions: Sequence[DrivenMotion],
    actions: Sequence[FloatArray],
    index: int,
    interval_s: float,
    time: str,
) -> None:
    try:
        for _ in intervals(
            simulation, motions, index, 1, actions, interval_s=interval_s
        ):
            pass
    # Engines raise any exception; MuJoCo does when a diverged scene has more contacts than fit in memory.
    except Exception as error:
        reason = " ".join(str(error).split())
        raise DivergedError(
            f"{time} the engine raises {type(error).__name__}: {reason}{raised_at(error)}"
        ) from error


def _has_left(start: _Sample, sample: _Sample, beyond_m: float) -> bool:
    """Return whether a rigid body is farther from its start than a distance [m]."""
    if beyond_m == math.inf:
        return False
    moved_m = sample.states[:, :3] - start.states[:, :3]
    return bool((np.linalg.norm(moved_m, axis=-1) > beyond_m).any())


def _not_finite(names: Sequence[str], sample: _Sample) -> str:
    """Return the first body whose state or node is not finite; empty when all are."""
    if np.isfinite(sample.states).all() and not sample.nodes_m:
        return ""
    rigid = dict(zip(names, sample.states, strict=True))
    return next(
        (
            name
            for name, values in (rigid | sample.nodes_m).items()
            if not np.isfinite(values).all()
        ),
        "",
    )


def _speeds_m_per_s(
    dynamic: Sequence[int], last: _Sample, sample: _Sample, interval_s: float
) -> list[float]:
    """Return the largest speed along an axis of each dynamic and deformable body, reported or from displacements.

    The displacement is bounded like the speed, since an engine may set diverged bodies back to the start.
    """
    speeds = np.abs(sample.states[:, 7:10])
    between = np.abs(sample.states[:, :3] - last.states[:, :3])
    between /= interval_s
    largest: list[float] = (
        np.maximum(speeds, between).max(axis=1).take(dynamic).tolist()
    )
    for name, nodes in sample.nodes_m.items():
        moved_m = np.abs(nodes - last.nodes_m[name]).max(initial=0.0)
        largest.append(float(moved_m) / interval_s)
    return largest
