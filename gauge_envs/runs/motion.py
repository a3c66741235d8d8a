"""The motion of an episode for 3D views: poses and nodes over time, in a file beside its result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gauge_envs.envs.rollout import Rollout
from gauge_envs.errors import ResultFileError
from gauge_envs.files import os_errors
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME

RIGID_VIEWS_PER_FRAME = 2
"""Recorded views per frame of rigid scenes: 60 views per second. Deformable scenes have 30."""

NODES = "nodes_m."
"""Prefix of the arrays of nodes in a file."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """Positions of the bodies of an episode.

    Attributes:
        rate_hz: Views per second; the first view is the initial state.
        bodies: Names of the moving rigid bodies.
        poses: Positions [m] and quaternions w x y z of these bodies, shape [view_count, body_count, 7].
        nodes_m: Nodes of each deformable body by name [m], shape [view_count, node_count, 3].
    """

    rate_hz: float
    bodies: tuple[str, ...]
    poses: FloatArray
    nodes_m: Mapping[str, FloatArray]


def play_recorded(rollout: Rollout) -> Motion:
    """Simulate all episodes to their end without actions, and return the motion of the first."""
    is_soft = bool(rollout.experiment.scene.deformables)
    views_per_frame = 1 if is_soft else RIGID_VIEWS_PER_FRAME
    samples_per_view = SAMPLES_PER_FRAME // views_per_frame
    views = [(rollout.poses(), rollout.nodes_m())]

    def observe(sample: int) -> None:
        if not rollout.is_over[0] and (sample + 1) % samples_per_view == 0:
            views.append((rollout.poses(), rollout.nodes_m()))

    rollout.play(observe)
    bodies, softs = views[0]
    poses = np.array([[*poses.values()] for poses, _ in views])
    return Motion(
        rate_hz=FRAME_RATE_HZ * views_per_frame,
        bodies=tuple(bodies),
        poses=poses.reshape(len(views), len(bodies), 7),
        nodes_m={
            name: np.array([nodes_m[name] for _, nodes_m in views]) for name in softs
        },
    )


def motion_file(result_file: Path) -> Path:
    """Return the path of the motion of a result."""
    return result_file.with_suffix(".npz")


def write_motion(motion: Motion, file: Path) -> None:
    """Write a motion in single precision."""
    arrays: dict[str, Any] = {
        NODES + name: nodes_m.astype(np.float32)
        for name, nodes_m in motion.nodes_m.items()
    }
    arrays["poses"] = motion.poses.astype(np.float32)
    arrays["bodies"] = np.array(motion.bodies, dtype=np.str_)
    arrays["rate_hz"] = motion.rate_hz
    with os_errors(
        lambda cause: ResultFileError(f"{file}: cannot be written: {cause}")
    ):
        np.savez_compressed(file, **arrays)


def load_motion(file: Path) -> Motion:
    """Read a motion.

    Raises:
        ResultFileError: There is no such file, or it is damaged.
    """
    if not file.is_file():
        raise ResultFileError(
            f"{file} does not exist; gauge run writes it for the first repetition"
        )
    try:
        with np.load(file, allow_pickle=False) as arrays:
            bodies = tuple(arrays["bodies"].tolist())
            poses = arrays["poses"].reshape(-1, len(bodies), 7)
            return Motion(
                rate_hz=float(arrays["rate_hz"]),
                bodies=bodies,
                poses=poses,
                nodes_m={
                    name.removeprefix(NODES): arrays[name].reshape(len(poses), -1, 3)
                    for name in arrays.files
                    if name.startswith(NODES)
                },
            )
    # A damaged archive raises errors of zlib, zipfile and NumPy.
    except Exception as error:
        raise ResultFileError(
            f"{file} is damaged; gauge run of its result writes it again"
        ) from error
