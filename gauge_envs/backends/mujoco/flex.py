"""What all deformable bodies in MuJoCo share: a part of the model, made before it compiles and completed after."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.scene import Motion, Pose, Region

__all__ = ["FlexPart", "Glue", "Grip"]


@dataclass(frozen=True, kw_only=True)
class Glue:
    """A region of a deformable body that moves with a rigid one.

    Attributes:
        region: Which material, in the deformable body's frame.
        body: Name of the rigid body.
        motion: Fixed: the vertices are pinned. Kinematic: they are driven. Dynamic: they pull on the body.
        pose: Start pose of the rigid body.
    """

    region: Region
    body: str
    motion: Motion
    pose: Pose


class FlexPart(ABC):
    """A deformable body of a MuJoCo model.

    Attributes:
        name: Name of the deformable body, and of its flex.
        flex: The flex in the editable model; who builds contacts sets contact bits and friction on it.
        rest_m: World positions of the nodes at the start [m], shape [node_count, 3].
    """

    name: str
    flex: mujoco.MjsFlex
    rest_m: NDArray[np.float64]

    @abstractmethod
    def complete(self, model: mujoco.MjModel) -> None:
        """Write into the compiled model what the editable one cannot express: masses, stiffness, armature."""

    @abstractmethod
    def bind(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Look up addresses for reading and driving."""

    @abstractmethod
    def nodes(self) -> NDArray[np.float64]:
        """World positions of the nodes now [m], shape [node_count, 3], from joint coordinates."""

    @abstractmethod
    def drive(self, body: str, pose: Pose, velocity: NDArray[np.float64], acceleration: NDArray[np.float64]) -> None:
        """Move what is glued to a kinematic body; see `Simulation.drive`. Nothing where nothing is glued to it."""


class Grip:
    """Vertices that follow a kinematic body: each has three slide joints along the world axes, and a large armature.

    Their position and velocity are written at the start of an interval, and a force accelerates them uniformly; the
    armature keeps elastic forces from moving them noticeably until the next interval.

    Args:
        names: Names of the vertices' MuJoCo bodies, children of the world with three slide joints x, y, z.
        rest_m: Their world positions at the start [m], shape [count, 3].
        pose: Start pose of the body that they are glued to.
    """

    ARMATURE_KG = 100.0
    """1 N moves 100 kg by 0.2 micrometres in 1/180 s."""

    def __init__(self, names: list[str], rest_m: NDArray[np.float64], pose: Pose) -> None:
        self._names = names
        self._rest_m = rest_m
        self._arms_m = pose.to_body(rest_m)

    def _addresses(self, model: mujoco.MjModel) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        joints = np.array([model.body(name).jntadr[0] for name in self._names])[:, None] + np.arange(3)
        return model.jnt_qposadr[joints].astype(np.intp), model.jnt_dofadr[joints].astype(np.intp)

    def complete(self, model: mujoco.MjModel) -> None:
        """Give the vertices their armature."""
        model.dof_armature[self._addresses(model)[1]] = self.ARMATURE_KG

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Look up the joints."""
        self._qpos, self._dofs = self._addresses(model)
        self._data = data

    def drive(self, pose: Pose, velocity: NDArray[np.float64], acceleration: NDArray[np.float64]) -> None:
        """Place the vertices, and set them moving; see `Simulation.drive`."""
        arms = pose.rotation.apply(self._arms_m)
        turning = np.cross(velocity[3:], arms)
        self._data.qpos[self._qpos] = arms + np.asarray(pose.position_m) - self._rest_m
        self._data.qvel[self._dofs] = velocity[:3] + turning
        rate = acceleration[:3] + np.cross(acceleration[3:], arms) + np.cross(velocity[3:], turning)
        self._data.qfrc_applied[self._dofs] = self.ARMATURE_KG * rate
