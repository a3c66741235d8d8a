"""Common parts of all deformable bodies in MuJoCo, added before the model compiles and completed afterwards."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import mujoco
import numpy as np

from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.scene import Motion
from gauge_envs.scene.geometry import FloatArray, IntArray

STIFF_SOLIMP = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""Impedance of contacts and strings. MuJoCo softens the contacts of light bodies. With its default impedance, two balls
of 0.3 kg pull a rope of 5 g through its beam, and a cube sinks through foam, whose nodes weigh 20 mg."""

DAMPING_S = 1e-4
"""Viscous part of elastic stress, as the time that multiplies the rate of strain [s]."""


class Points:
    """The points that carry a flex: point bodies with slide joints x, y, z, or points of rigid bodies.

    An attached point needs no constraint: it is fixed in the frame of its rigid body, which receives its forces.

    Args:
        names: Name of each point's body; those of attached points are unused.
        rest_m: World positions at the start [m], shape [point_count, 3].
        attached: Attachment of each attached point, by point index.

    Attributes:
        attached: Attachment of each attached point, by point index.
        free: Indices of the points that are not attached, shape [free_count].
        dofs: Their degrees of freedom in the compiled model, shape [free_count, 3]; `bind` sets it.
    """

    def __init__(
        self,
        names: Sequence[str],
        rest_m: FloatArray,
        attached: Mapping[int, RigidAttachment],
    ) -> None:
        self._names = list(names)
        self._rest_m = rest_m
        self.attached = dict(attached)
        self.free = np.array(
            [index for index in range(len(rest_m)) if index not in self.attached],
            dtype=np.intp,
        )

    def carriers(self) -> tuple[list[str], list[float]]:
        """Return each point's body, and the flattened positions of all points in the frames of their bodies [m]."""
        owners, places = list(self._names), np.zeros_like(self._rest_m)
        for index, attachment in self.attached.items():
            owners[index] = attachment.body
            places[index] = attachment.pose.to_body(self._rest_m[index])
        return owners, places.ravel().tolist()

    def delete_attached(self, spec: mujoco.MjSpec) -> None:
        """Delete the bodies of attached points; a flex that still refers to one of them would be deleted too."""
        for index in self.attached:
            spec.delete(spec.body(self._names[index]))

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Look up the joints of the points in a compiled model."""
        bodies = [model.body(self._names[index]).id for index in self.free]
        self._bodies = np.array(bodies, dtype=np.intp)
        self._addresses, self.dofs = slide_addresses(model, self._bodies)
        self._qpos = data.qpos
        self._qvel = data.qvel
        rows_by_body: dict[str, list[int]] = {}
        for index, attachment in self.attached.items():
            if attachment.motion is not Motion.FIXED:
                rows_by_body.setdefault(attachment.body, []).append(index)
        # Attached points, their positions in the frame of their body [m], and views of its pose and its velocity.
        self._moving = []
        for body, rows in rows_by_body.items():
            arms_m = self.attached[rows[0]].pose.to_body(self._rest_m[rows])
            self._moving.append((rows, arms_m, *free_joint_views(model, data, body)))

    def set_positions(self, start_m: FloatArray) -> None:
        """Move points without attachments to initial positions.

        Args:
            start_m: World positions at the start [m], shape [point_count, 3].
        """
        self._qpos[self._addresses] = start_m - self._rest_m

    def positions(self) -> FloatArray:
        """Return the current world positions [m], shape [point_count, 3], from joint coordinates alone."""
        positions = self._rest_m.copy()
        positions[self.free] += self._qpos[self._addresses]
        for rows, arms_m, pose, _ in self._moving:
            positions[rows] = arms_m @ rotation_matrix(pose[3:]).T + pose[:3]
        return positions

    def velocities(self) -> FloatArray:
        """Return the current velocities [m/s], shape [point_count, 3], from joint coordinates alone."""
        velocities = np.zeros_like(self._rest_m)
        velocities[self.free] = self._qvel[self.dofs]
        for rows, arms_m, pose, velocity in self._moving:
            # v + w x r; MuJoCo keeps a free joint's angular velocity w in the body frame.
            turning = np.cross(velocity[3:], arms_m)
            velocities[rows] = velocity[:3] + turning @ rotation_matrix(pose[3:]).T
        return velocities


def free_joint_views(
    model: mujoco.MjModel, data: mujoco.MjData, body: str
) -> tuple[FloatArray, FloatArray]:
    """Return views of the pose, shape [7], and of the velocity, shape [6], of a body with a free joint."""
    joint = model.joint(model.body(body).jntadr[0])
    position, velocity = int(joint.qposadr[0]), int(joint.dofadr[0])
    return data.qpos[position : position + 7], data.qvel[velocity : velocity + 6]


def slide_addresses(
    model: mujoco.MjModel, bodies: IntArray
) -> tuple[IntArray, IntArray]:
    """Return the coordinates and the degrees of freedom of point bodies along x, y and z, shape [body_count, 3]."""
    # A point body has slide joints along x, y and z, one after another.
    joints = model.body_jntadr[bodies][:, None] + np.arange(3)
    coordinates, freedoms = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    return coordinates.astype(np.intp), freedoms.astype(np.intp)


def rotation_matrix(quaternion: FloatArray) -> FloatArray:
    """Return the matrix of a rotation w, x, y, z, shape [3, 3]."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


class FlexPart:
    """A deformable body of a MuJoCo model.

    Attributes:
        name: Name of the deformable body, and of its flex.
        flex: The flex in the editable model; `add_flex_contact` sets its contact bits and friction.
        rest_m: World positions of the nodes at the start [m], shape [node_count, 3].
        points: The points that carry the flex.
        node_indices: Indices of each body's nodes among those of a soft row, by name; empty for a single body.
    """

    node_indices: Mapping[str, IntArray] = MappingProxyType({})

    def __init__(
        self, flex: mujoco.MjsFlex, rest_m: FloatArray, points: Points
    ) -> None:
        self.name, self.flex = flex.name, flex
        self.rest_m = rest_m
        self.points = points

    def complete(self, model: mujoco.MjModel) -> None:
        """Write the tables of the compiled model that the editable model cannot express."""

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Look up the joints that `nodes` reads."""
        self.points.bind(model, data)

    def nodes(self) -> FloatArray:
        """Return the current world positions of the nodes [m], shape [node_count, 3]."""
        return self.points.positions()


def make_firm(flex: mujoco.MjsFlex, solref: tuple[float, float]) -> None:
    """Disable the contacts of a flex, and set the constants of every contact that it gets later."""
    collide_with_nothing(flex)
    # Without priority, MuJoCo would average these constants with those of the other geom, which is far too soft.
    flex.priority = 1
    flex.solref, flex.solimp = list(solref), list(STIFF_SOLIMP)


def collide_with_nothing(flex: mujoco.MjsFlex) -> None:
    """Remove all contacts of a flex."""
    flex.contype, flex.conaffinity = 0, 0
    flex.selfcollide = mujoco.mjtFlexSelf.mjFLEXSELF_NONE


def flex_table(model: mujoco.MjModel, table: str, index: int) -> FloatArray:
    """Return a writable view of the part of a compiled table that belongs to one flex; empty if it has none.

    Args:
        model: The compiled model.
        table: `flex_stiffness` or `flex_bending`.
        index: Index of the flex.
    """
    addresses, values = getattr(model, f"{table}adr").tolist(), getattr(model, table)
    start = addresses[index]
    if start < 0:
        return values[:0]
    end = min((address for address in addresses if address > start), default=None)
    return values[start:end]
