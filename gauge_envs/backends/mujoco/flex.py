"""What all deformable bodies in MuJoCo share: a part of the model, made before it compiles and completed after."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.scene import Motion

__all__ = [
    "FlexPart",
    "Points",
    "attached_points",
]


class Points:
    """The points that carry a flex: bodies of their own with slide joints x, y, z, or places on rigid bodies.

    A glued point needs no constraint and no driving: it is where the rigid body is, which feels its forces.

    Args:
        names: Names of the bodies of the free points; names of glued ones are not used.
        rest_m: World positions at the start [m], shape [point_count, 3].
        held: What holds each glued point, by its index.
    """

    def __init__(self, names: Sequence[str], rest_m: NDArray[np.float64], held: Mapping[int, RigidAttachment]) -> None:
        self._names = list(names)
        self._rest_m = rest_m
        self._held = dict(held)
        self.free = np.array([index for index in range(len(rest_m)) if index not in self._held], dtype=np.intp)

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Look up the joints."""
        joints = np.array([model.body(self._names[index]).jntadr[0] for index in self.free])
        self._addresses = model.jnt_qposadr[joints[:, None] + np.arange(3)].astype(np.intp)
        self._carriers = []
        for glue in {glue.body: glue for glue in self._held.values() if glue.motion is not Motion.FIXED}.values():
            rows = np.array([index for index, other in self._held.items() if other.body == glue.body])
            address = int(model.joint(model.body(glue.body).jntadr[0]).qposadr[0])
            self._carriers.append((rows, slice(address, address + 7), glue.pose.to_body(self._rest_m[rows])))
        self._qpos = data.qpos

    def positions(self) -> NDArray[np.float64]:
        """World positions now [m], shape [point_count, 3], straight from joint coordinates."""
        positions = self._rest_m.copy()
        positions[self.free] += self._qpos[self._addresses]
        turn = np.empty(9)
        for rows, address, arms in self._carriers:
            pose = self._qpos[address]
            mujoco.mju_quat2Mat(turn, pose[3:])
            positions[rows] = arms @ turn.reshape(3, 3).T + pose[:3]
        return positions


class FlexPart(ABC):
    """A deformable body of a MuJoCo model.

    Attributes:
        name: Name of the deformable body, and of its flex.
        flex: The flex in the editable model; who builds contacts sets contact bits and friction on it.
        rest_m: World positions of the nodes at the start [m], shape [node_count, 3].
        points: The points that carry the flex.
    """

    name: str
    flex: mujoco.MjsFlex
    rest_m: NDArray[np.float64]
    points: Points

    @abstractmethod
    def complete(self, model: mujoco.MjModel) -> None:
        """Write into the compiled model what the editable one cannot express."""

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Look up the joints, for reading."""
        self.points.bind(model, data)

    @abstractmethod
    def nodes(self) -> NDArray[np.float64]:
        """World positions of the nodes now [m], shape [node_count, 3]."""


def attached_points(
    names: Sequence[str], rest_m: NDArray[np.float64], held: Mapping[int, RigidAttachment]
) -> tuple[list[str], NDArray[np.float64]]:
    """For each point the body that it belongs to and its place in that body's frame [m], shape [point_count, 3]."""
    owners, places = list(names), np.zeros_like(rest_m)
    for index, glue in held.items():
        owners[index] = glue.body
        places[index] = glue.pose.to_body(rest_m[index])
    return owners, places
