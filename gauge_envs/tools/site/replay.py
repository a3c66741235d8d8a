"""Poses and nodes of an episode that has a result: the same run again.

A result file holds the generalized trajectory g(t) alone, and everything that the run needs: scene, engine, settings,
parameters, start and seed.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends import backend_for, engine_call, versions_of
from gauge_envs.backends.shared.resampled import in_intervals
from gauge_envs.envs.arguments import check_support
from gauge_envs.envs.initial_states import Draw, InitialStates
from gauge_envs.envs.rollout import Rollout
from gauge_envs.errors import GaugeError, chosen
from gauge_envs.experiments.experiment import AssetKind
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.runs.isolation import call_engine
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import recorded_experiment
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


def replay(result: Result) -> Replay:
    """Run the episode of a result again and return where its bodies are.

    An engine outside this package runs in another process.

    Args:
        result: The result.

    Raises:
        ReplayError: The result does not hold the run, or other versions are installed.
        GaugeError: The engine cannot run it.
    """
    if result.backend is None or result.trajectory is None:
        raise ReplayError("the result is of a trajectory file: no engine ran it")
    if result.error is not None:
        raise ReplayError(f"the episode did not run: {result.error}")
    return call_engine(result.backend, _run_again, result, result.backend)


def _run_again(result: Result, backend: str) -> Replay:
    """Run the episode of a result on its engine and return where its bodies are."""
    if difference := result.made_with_other_than(versions_of(backend)):
        raise ReplayError(difference)
    experiment = recorded_experiment(result)
    if result.asset.get("kind") == AssetKind.MODEL:
        raise ReplayError(
            f"the scene is in the file {result.asset['file']}, which is no part of the result"
        )
    check_support(experiment, backend)
    with engine_call(backend, "build"):
        built = backend_for(backend, None).build(
            experiment.scene, result.settings_given or None
        )
        simulation = in_intervals(built, experiment.scene)
    try:
        with engine_call(backend, "advance"):
            rollout = Rollout(
                [experiment],
                simulation,
                bands=[None],
                marker_proxy=chosen(MarkerProxy, result.marker_proxy, "marker_proxy"),
            )
            start = InitialStates(experiment).sample(_draw(result), result.seed or 0)
            rollout.reset([start], result.seed or 0)
            return _recorded(rollout)
    finally:
        simulation.close()


def _draw(result: Result) -> Draw:
    """Return what drew the start of a result."""
    if not result.jitter:
        return None
    if "trial" in result.jitter:
        return int(result.jitter["trial"])
    # A result leaves out the standard deviations of velocities that are zero, which are the defaults.
    return Jitter(**result.jitter)


def _recorded(rollout: Rollout) -> Replay:
    """Run an episode to its end with zero actions, and return its views."""
    scene = rollout.experiment.scene
    views = 1 if scene.deformables else RIGID_VIEWS_PER_FRAME
    samples_per_view = SAMPLES_PER_FRAME // views
    names = tuple(rollout.poses())
    # The start is a view too.
    poses = [[*rollout.poses().values()]]
    nodes = {name: [points] for name, points in rollout.nodes_m().items()}
    while not rollout.is_over[0]:
        for sample in rollout.substeps():
            if (sample + 1) % samples_per_view == 0:
                poses.append([*rollout.poses().values()])
                for name, points in rollout.nodes_m().items():
                    nodes[name].append(points)
    return Replay(
        rate_hz=FRAME_RATE_HZ * views,
        bodies=names,
        poses=np.array(poses, dtype=np.float32).reshape(len(poses), len(names), 7),
        nodes_m={
            name: np.array(points, dtype=np.float32) for name, points in nodes.items()
        },
        markers_m=rollout.trajectory().markers_m.astype(np.float32),
    )
