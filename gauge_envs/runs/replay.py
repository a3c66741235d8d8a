"""Poses and nodes of an episode that has a result: the run again, checked bit for bit against the result's g(t).

A result file holds the generalized trajectory g(t) alone. It also states everything that the run needs: scene, engine,
settings, parameters, start and seed. A replay runs the episode once more and records where the bodies are. It counts
only if its g(t) is that of the file, bit for bit; the same versions of the packages on the same kind of processor give
that.
"""

import hashlib
import io
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends import backend_for, engine_call, is_bundled, versions_of
from gauge_envs.backends.shared.resampled import in_intervals
from gauge_envs.envs.arguments import TrialStart, check_support, jittered_experiment
from gauge_envs.envs.episode import Episode
from gauge_envs.errors import GaugeError, chosen
from gauge_envs.experiments.experiment import AssetKind, Experiment
from gauge_envs.files import npz_arrays, os_errors, write_whole
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.runs.isolation import Worker
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import recorded_experiment
from gauge_envs.scene import Scene
from gauge_envs.scene.jitter import Jitter
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME

PoseArray = NDArray[np.float32]

RIGID_VIEWS_PER_FRAME = 2
"""Recorded views in each frame of a scene of rigid bodies, so 60 a second; deformable bodies are recorded 30 times."""


class ReplayError(GaugeError, RuntimeError):
    """An episode has no replay; the message states the reason."""


@dataclass(frozen=True, kw_only=True)
class Replay:
    """Where the bodies of an episode are.

    Attributes:
        rate_hz: Views a second.
        bodies: Names of the rigid bodies that move.
        poses: Their positions [m] and quaternions w x y z, shape [view_count, body_count, 7].
        nodes_m: Nodes of each deformable body by name [m], shape [view_count, node_count, 3].
        markers_m: Markers at the frames [m], shape [frame_count, marker_count, 3]; `marker_count` is 0 if bodies are
            observed.
    """

    rate_hz: float
    bodies: tuple[str, ...]
    poses: PoseArray
    nodes_m: Mapping[str, PoseArray]
    markers_m: PoseArray


def replayed_experiment(result: Result) -> Experiment:
    """Return the experiment of a result with the scene and the start of its episode."""
    experiment = recorded_experiment(result)
    if result.asset.get("kind") == AssetKind.MODEL:
        raise ReplayError(
            f"the scene is in the file {result.asset['file']}, which is no part of the result"
        )
    return jittered_experiment(experiment, _start(result), seed=result.seed or 0)


def replay(result: Result) -> Replay:
    """Run the episode of a result again and return where its bodies are.

    Args:
        result: The result.
    """
    if result.backend is None or result.trajectory is None:
        raise ReplayError("the result is of a trajectory file: no engine ran it")
    if result.error is not None:
        raise ReplayError(f"the episode did not run: {result.error}")
    try:
        installed = versions_of(result.backend)
    except GaugeError as error:
        raise ReplayError(str(error)) from error
    experiment = replayed_experiment(result)
    check_support(experiment, result.backend)
    with engine_call(result.backend, "build"):
        built = backend_for(result.backend, None).build(
            experiment.scene, result.settings_given or None
        )
        simulation = in_intervals(built, experiment.scene)
    try:
        with engine_call(result.backend, "advance"):
            simulation.reset(result.seed or 0)
            episode = Episode(
                experiment,
                simulation,
                band=None,
                marker_proxy=chosen(MarkerProxy, result.marker_proxy, "marker_proxy"),
            )
            recorded = _recorded(episode, experiment.scene)
    finally:
        simulation.close()
    _check_same(result, episode, installed)
    return recorded


def load_or_replay(result: Result, file: Path) -> Replay:
    """Return the replay of a result file from the file beside it, or run it and write that file.

    The replay file holds the hash of the result file, so that it counts for that content alone. A folder that cannot be
    written gets no replay file. An engine outside this package runs in another process.

    Args:
        result: Content of the result file.
        file: The result file.
    """
    with os_errors(lambda cause: ReplayError(f"{file}: cannot be read: {cause}")):
        key = np.frombuffer(hashlib.sha256(file.read_bytes()).digest(), dtype=np.uint8)
    path = replay_path(file)
    known = _stored(result, path, key)
    if known is not None:
        return known
    if result.backend is None or is_bundled(result.backend):
        made = replay(result)
    else:
        with Worker() as worker:
            made = worker.call(replay, result)
    stream = io.BytesIO()
    arrays: dict[str, Any] = {
        f"nodes_{index}": points for index, points in enumerate(made.nodes_m.values())
    }
    arrays |= {
        "key": key,
        "rate_hz": np.array([made.rate_hz]),
        "poses": made.poses,
        "markers_m": made.markers_m,
    }
    np.savez_compressed(stream, **arrays)
    with suppress(OSError):
        write_whole(path, stream.getvalue())
    return made


def replay_path(file: Path) -> Path:
    """Return the path of the replay file beside a result file: `<name>.replay.npz`."""
    return file.with_suffix(".replay.npz")


def _start(result: Result) -> Jitter | TrialStart | None:
    if not result.jitter:
        return None
    if "trial" in result.jitter:
        return TrialStart(int(result.jitter["trial"]))
    # A result leaves out the standard deviations of velocities that are zero, which are the defaults.
    return Jitter(**result.jitter)


def _recorded(episode: Episode, scene: Scene) -> Replay:
    """Run an episode to its end with zero actions, and return its views."""
    views = 1 if scene.deformables else RIGID_VIEWS_PER_FRAME
    samples_per_view = SAMPLES_PER_FRAME // views
    names = tuple(episode.poses())
    poses: list[Any] = []
    nodes: dict[str, list[Any]] = {body.name: [] for body in scene.deformables}

    def look(sample: int) -> None:
        if (sample + 1) % samples_per_view:
            return
        now = episode.poses()
        poses.append([now[name] for name in names])
        for name, points in episode.nodes_m().items():
            nodes[name].append(points.astype(np.float32))

    # The start is a view too; the world is there.
    look(-1)
    episode.play(after_sample=look)
    return Replay(
        rate_hz=FRAME_RATE_HZ * views,
        bodies=names,
        poses=np.array(poses, dtype=np.float32).reshape(len(poses), len(names), 7),
        nodes_m={
            name: np.array(points, dtype=np.float32) for name, points in nodes.items()
        },
        markers_m=episode.trajectory().markers_m.astype(np.float32),
    )


def _check_same(result: Result, episode: Episode, installed: Mapping[str, str]) -> None:
    """Raise an error unless the g(t) of the run is that of the result, bit for bit."""
    assert result.trajectory is not None
    _, stored = result.trajectory.arrays()
    samples = episode.trajectory().samples
    # JSON has no infinity, so that a result holds None for it as for NaN.
    now = np.where(np.isfinite(samples), samples, np.nan)
    if stored.shape == now.shape and np.array_equal(stored, now, equal_nan=True):
        return
    changed = [
        f"{name} {result.versions[name]} in the result, {text} installed"
        for name, text in installed.items()
        if name in result.versions and result.versions[name] != text
    ]
    cause = (
        f"; versions: {', '.join(changed)}"
        if changed
        else "; the versions of the engine are the same"
    )
    if stored.shape != now.shape:
        size = f"{len(now)} samples of {now.shape[1]} coordinates, the result has {len(stored)} of {stored.shape[1]}"
        raise ReplayError(f"the run again has {size}{cause}")
    apart = (
        np.nanmax(np.abs(stored - now)) if np.isfinite(stored - now).any() else np.nan
    )
    raise ReplayError(
        f"the run again differs from the result by up to {apart:.3g} {result.trajectory.unit}{cause}"
    )


def _stored(result: Result, path: Path, key: NDArray[np.uint8]) -> Replay | None:
    """Return the replay in a file; None without a file, or if it is damaged or of another result."""
    try:
        scene = recorded_experiment(result).scene
        bodies = (
            *(body.name for body in scene.dynamic_bodies),
            *(driver.body for driver in scene.drivers),
        )
        names = {
            f"nodes_{index}": body.name for index, body in enumerate(scene.deformables)
        }
        wanted = ("key", "rate_hz", "poses", "markers_m", *names)
        arrays = npz_arrays(path.read_bytes(), wanted)
    except (OSError, ValueError, GaugeError):
        return None
    if len(arrays) < len(wanted) or not np.array_equal(arrays["key"], key):
        return None
    views = len(arrays["poses"])
    shapes_fit = arrays["poses"].shape == (views, len(bodies), 7) and all(
        arrays[name].ndim == 3 and len(arrays[name]) == views for name in names
    )
    if (
        not shapes_fit
        or arrays["rate_hz"].shape != (1,)
        or arrays["markers_m"].ndim != 3
    ):
        return None
    return Replay(
        rate_hz=float(arrays["rate_hz"][0]),
        bodies=bodies,
        poses=arrays["poses"].astype(np.float32),
        nodes_m={body: arrays[name].astype(np.float32) for name, body in names.items()},
        markers_m=arrays["markers_m"].astype(np.float32),
    )
