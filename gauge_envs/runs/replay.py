"""Run the episode of a stored result again: the request that it answers, and all poses that a result leaves out.

A result file holds g(t) alone. `replay` simulates its episode again and returns the poses of bodies, the nodes of
deformable bodies and the markers at each frame, with the largest difference of g(t) from the file. The same versions
of an engine on the same processor give a difference of 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.registry import backend_for
from gauge_envs.envs.arguments import jittered_experiment
from gauge_envs.envs.episode import Episode
from gauge_envs.envs.trial_start import TrialStart
from gauge_envs.errors import ResultFileError
from gauge_envs.experiments.experiment import AssetKind, Experiment
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Result
from gauge_envs.runs.scene_record import recorded_experiment
from gauge_envs.scene.jitter import Jitter
from gauge_envs.scene.timing import FRAME_RATE_HZ

__all__ = ["Replay", "replay", "request_of", "start_of_result"]


@dataclass(frozen=True, eq=False, kw_only=True)
class Replay:
    """An episode that was simulated again, at the 30 Hz frames.

    Attributes:
        experiment: Its experiment, with the start of the episode.
        times_s: Times of the frames [s], shape [frame_count].
        poses: Pose of each rigid body that moves by name: position [m] and quaternion w x y z, shape [frame_count, 7].
        nodes_m: Nodes of each deformable body by name [m], shape [frame_count, node_count, 3].
        markers_m: Markers as points of the material [m], shape [frame_count, marker_count, 3]; `marker_count` is 0 if
            bodies are recorded.
        g: Generalized trajectory at the frames, shape [frame_count, coordinate_count].
        largest_difference: Largest difference of g(t) from the result over all samples, in the unit of g(t); infinite
            if one of the two diverged earlier.
        unit: Unit of g(t).
    """

    experiment: Experiment
    times_s: NDArray[np.float64]
    poses: Mapping[str, NDArray[np.float64]]
    nodes_m: Mapping[str, NDArray[np.float64]]
    markers_m: NDArray[np.float64]
    g: NDArray[np.float64]
    largest_difference: float
    unit: str

    @property
    def is_exact(self) -> bool:
        """Whether g(t) has the bits of the result."""
        return self.largest_difference == 0.0


def request_of(result: Result) -> RunRequest:
    """Return the request of which a result is an episode.

    Raises:
        ResultFileError: The result names no engine, or an asset or experiment file stated its scene, which the result
            does not hold as a file.
    """
    if result.asset:
        raise ResultFileError(f"{result.id}: {result.asset['file']} stated its scene; only replay can run it again")
    return RunRequest(
        result.id,
        backend=_backend_of(result),
        parameters=result.parameters,
        settings=result.settings_given or None,
        marker_proxy=result.marker_proxy,
        drivers=result.dataset["drivers"],
        reference=result.dataset["reference"],
        use_withheld=result.score.withheld is not None,
        seed=result.seed or 0,
    )


def start_of_result(result: Result) -> Jitter | TrialStart | None:
    """Return the jitter or the trial of the start of a result; None for the calibrated start."""
    if not result.jitter:
        return None
    if "trial" in result.jitter:
        return TrialStart(int(result.jitter["trial"]))
    return Jitter(**result.jitter)


def replay(result: Result) -> Replay:
    """Simulate the episode of a result again, and return its frames.

    Args:
        result: A result with a trajectory, of an installed engine.

    Returns:
        The frames. An episode that diverges ends at that frame, as in the result.

    Raises:
        ResultFileError: The result names no engine, has no trajectory, or a model file of the engine stated its scene.
        GaugeError: The engine is not installed or cannot build the scene.
    """
    if result.trajectory is None:
        raise ResultFileError(f"{result.id}: the result has no trajectory to compare with")
    backend = _backend_of(result)
    if result.asset.get("kind") == AssetKind.MODEL:
        raise ResultFileError(f"{result.id}: the result does not hold {result.asset['file']}, which stated its scene")
    experiment = jittered_experiment(
        recorded_experiment(result), start_of_result(result), seed=result.seed or 0, backend=backend
    )
    simulation = backend_for(backend, None).build(experiment.scene, result.settings_given or None)
    try:
        simulation.reset(result.seed or 0)
        episode = Episode(experiment, simulation, band=None, marker_proxy=MarkerProxy(result.marker_proxy))
        episode.begin()
        poses, nodes = [episode.poses()], [episode.nodes_m()]
        zero = np.zeros(episode.action_space.shape or 0)
        while not episode.is_over:
            episode.advance(simulation, zero)
            episode.end_frame()
            poses.append(episode.poses())
            nodes.append(episode.nodes_m())
        recorded = episode.trajectory()
    finally:
        simulation.close()
    return Replay(
        experiment=experiment,
        times_s=np.arange(len(recorded.frames)) / FRAME_RATE_HZ,
        poses={name: np.array([frame[name] for frame in poses]) for name in poses[0]},
        nodes_m={name: np.array([frame[name] for frame in nodes]) for name in nodes[0]},
        markers_m=recorded.markers_m,
        g=recorded.frames,
        largest_difference=_largest_difference(result.trajectory.arrays()[1], recorded.samples),
        unit=experiment.score.observable.unit,
    )


def _backend_of(result: Result) -> str:
    if result.backend is None:
        raise ResultFileError(f"{result.id}: the result is of a trajectory file, so no engine can run it again")
    return result.backend


def _largest_difference(stored: NDArray[np.float64], again: NDArray[np.float64]) -> float:
    if stored.shape != again.shape:
        return float("inf")
    apart = np.abs(stored - again)
    # Both are NaN where an episode diverged.
    return float(np.where(np.isnan(stored) & np.isnan(again), 0.0, np.nan_to_num(apart, nan=np.inf)).max())
