"""Common parts of all deformable bodies in MuJoCo, added before the model compiles and completed afterwards."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.scene import Motion


class Points:
    """The points that carry a flex: point bodies with slide joints x, y, z, or points of rigid bodies.

    An attached point needs no constraint: it is fixed in the frame of its rigid body, which receives its forces.

    Args:
        names: Name of each point's body; those of attached points are unused.
        rest_m: World positions at the start [m], shape [point_count, 3].
        held: Attachment of each attached point, by point index.

    Attributes:
        free: Indices of the points that are not attached, shape [free_count].
        dofs: Their degrees of freedom in the compiled model, shape [free_count, 3]; `bind` sets it.
    """

    def __init__(self, names: Sequence[str], rest_m: NDArray[np.float64], held: Mapping[int, RigidAttachment]) -> None:
        self._names = list(names)
        self._rest_m = rest_m
        self._held = dict(held)
        self.free = np.array([index for index in range(len(rest_m)) if index not in self._held], dtype=np.intp)

    def carriers(self) -> tuple[list[str], list[float]]:
        """Return each point's body, and the positions of all points in the frames of their bodies [m], in a row."""
        owners, places = list(self._names), np.zeros_like(self._rest_m)
        for index, attachment in self._held.items():
            owners[index] = attachment.body
            places[index] = attachment.pose.to_body(self._rest_m[index])
        return owners, places.ravel().tolist()

    def delete_held(self, spec: mujoco.MjSpec) -> None:
        """Delete the bodies of attached points; a flex that still refers to one of them would be deleted too."""
        for index in self._held:
            spec.delete(spec.body(self._names[index]))

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Look up the joints of the points in a compiled model."""
        joints = np.array([model.body(self._names[index]).jntadr[0] for index in self.free])
        self._addresses = model.jnt_qposadr[joints[:, None] + np.arange(3)].astype(np.intp)
        self._carriers = []
        for attachment in {
            attachment.body: attachment for attachment in self._held.values() if attachment.motion is not Motion.FIXED
        }.values():
            rows = np.array([index for index, other in self._held.items() if other.body == attachment.body])
            address = int(model.joint(model.body(attachment.body).jntadr[0]).qposadr[0])
            arms = attachment.pose.to_body(self._rest_m[rows])
            speeds = int(model.joint(model.body(attachment.body).jntadr[0]).dofadr[0])
            self._carriers.append((rows, slice(address, address + 7), slice(speeds, speeds + 6), arms))
        self._qpos, self._qvel = data.qpos, data.qvel
        self.dofs = model.jnt_dofadr[joints[:, None] + np.arange(3)].astype(np.intp)

    def positions(self) -> NDArray[np.float64]:
        """Return the current world positions [m], shape [point_count, 3], from joint coordinates alone."""
        positions = self._rest_m.copy()
        positions[self.free] += self._qpos[self._addresses]
        rotation = np.empty(9)
        for rows, address, _, arms in self._carriers:
            pose = self._qpos[address]
            mujoco.mju_quat2Mat(rotation, pose[3:])
            positions[rows] = arms @ rotation.reshape(3, 3).T + pose[:3]
        return positions

    def velocities(self) -> NDArray[np.float64]:
        """Return the current velocities [m/s], shape [point_count, 3], from joint coordinates alone."""
        velocities = np.zeros_like(self._rest_m)
        velocities[self.free] = self._qvel[self.dofs]
        rotation = np.empty(9)
        for rows, address, speeds, arms in self._carriers:
            mujoco.mju_quat2Mat(rotation, self._qpos[address][3:])
            linear, spin = self._qvel[speeds][:3], self._qvel[speeds][3:]
            # MuJoCo keeps a free joint's angular velocity in the body frame.
            velocities[rows] = linear + np.cross(spin, arms) @ rotation.reshape(3, 3).T
        return velocities


class FlexPart:
    """A deformable body of a MuJoCo model.

    Attributes:
        name: Name of the deformable body, and of its flex.
        flex: The flex in the editable model; `add_flex_contact` sets its contact bits and friction.
        rest_m: World positions of the nodes at the start [m], shape [node_count, 3].
        points: The points that carry the flex.
        node_indices: Indices of each body's nodes among those of a soft row, by name; empty for a single body.
    """

    node_indices: Mapping[str, NDArray[np.intp]] = MappingProxyType({})

    def __init__(self, flex: mujoco.MjsFlex, rest_m: NDArray[np.float64], points: Points) -> None:
        self.name, self.flex = flex.name, flex
        self.rest_m = rest_m
        self.points = points

    def complete(self, model: mujoco.MjModel) -> None:
        """Write the tables of the compiled model that the editable model cannot express."""

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Look up the joints that `nodes` reads."""
        self.points.bind(model, data)

    def nodes(self) -> NDArray[np.float64]:
        """Return the current world positions of the nodes [m], shape [node_count, 3]."""
        return self.points.positions()


def make_firm(flex: mujoco.MjsFlex, solref: tuple[float, ...], solimp: tuple[float, ...]) -> None:
    """Let a flex collide with nothing yet, with constants that hold for every contact that it gets."""
    collide_with_nothing(flex)
    # Without priority, MuJoCo would average these constants with those of the other geom, which is far too soft.
    flex.priority = 1
    flex.solref, flex.solimp = list(solref), list(solimp)


def collide_with_nothing(flex: mujoco.MjsFlex) -> None:
    """Remove all contacts of a flex."""
    flex.contype, flex.conaffinity = 0, 0
    flex.selfcollide = mujoco.mjtFlexSelf.mjFLEXSELF_NONE


def flex_table(model: mujoco.MjModel, table: str, index: int) -> NDArray[np.float64]:
    """Return a writable view of the part of a compiled table that belongs to one flex; empty if it has none.

    Args:
        model: The compiled model.
        table: `flex_stiffness` or `flex_bending`.
        index: Index of the flex.
    """
    addresses, values = getattr(model, f"{table}adr").tolist(), getattr(model, table)
    start = addresses[index]
    return values[start : min((a for a in addresses if a > start), default=len(values))] if start >= 0 else values[:0]
