"""A MuJoCo simulation: driving, stepping and reading of its state."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from math import cos, hypot, sin
from typing import Any, Protocol

import mujoco
import numpy as np

from gauge_envs.backends.mujoco.cloth import (
    AirOnCloth,
    ClothPartMuJoCo,
    FoldWatch,
    check_air_step,
)
from gauge_envs.backends.mujoco.flex import FlexPart, free_joint_views
from gauge_envs.backends.mujoco.line import LinePartMuJoCo
from gauge_envs.backends.mujoco.model import (
    START_KEY,
    hinge_in_body,
    start_velocities,
)
from gauge_envs.backends.mujoco.soft import Grip, SoftPartMuJoCo
from gauge_envs.backends.shared.rigid import MeanForces, starts_elsewhere
from gauge_envs.backends.shared.states import Snapshot, StateOrigin
from gauge_envs.backends.world import Simulation
from gauge_envs.scene import (
    Attachment,
    Cloth,
    Hinge,
    Motion,
    Pose,
    RigidBody,
    Scene,
)
from gauge_envs.scene.geometry import FloatArray

BAD_STATES = {
    mujoco.mjtWarning.mjWARN_BADQPOS: "position",
    mujoco.mjtWarning.mjWARN_BADQVEL: "velocity",
    mujoco.mjtWarning.mjWARN_BADQACC: "acceleration",
}
"""Quantity of each warning after which MuJoCo puts the state back to its start."""

NO_CLOCK = ctypes.cast(
    ctypes.pythonapi.PyFloat_GetMin, ctypes.CFUNCTYPE(ctypes.c_double)
)
"""A function of C that returns a constant. In Python MuJoCo reads a clock dozens of times in each step, for the timers
of `MjData`: a fifth to a third of a step of a few rigid bodies (studies/cost)."""


UNIT_LENGTH = 1e-14
"""Largest deviation of an axis from length 1 that MuJoCo's compiler leaves as it is."""


def without_clock(step: Callable[[], object]) -> None:
    """Call a function that steps, without a clock unless a user has set one; see `NO_CLOCK`."""
    # Of the user, or of another thread that is in this function.
    has_clock = mujoco.get_mjcb_time() is not None
    if not has_clock:
        mujoco.set_mjcb_time(NO_CLOCK)
    try:
        step()
    finally:
        if not has_clock:
            mujoco.set_mjcb_time(None)


class SimulationMuJoCo(Simulation):
    """A scene in MuJoCo.

    Args:
        scene: The scene.
        settings: Numerical settings in force, including `timestep_s`.
        spec: The editable model, for export and inspection.
        model: The compiled model.
        parts: Parts of its deformable bodies, by name.
        fixes_start: Whether the model is a file's, which states the start.

    Attributes:
        data: MuJoCo's state of the model.
        timestep_s: Time step [s].
        grips: Nodes of soft bodies that move with driven bodies.
        contact_readers: Readers of contact forces.
    """

    frees_python = True

    def __init__(
        self,
        scene: Scene,
        settings: Mapping[str, Any],
        spec: mujoco.MjSpec,
        model: mujoco.MjModel,
        parts: Mapping[str, FlexPart],
        *,
        fixes_start: bool = False,
    ) -> None:
        self.settings = settings
        self._fixes_start = fixes_start
        self.spec = spec
        self.model = model
        self._parts = parts
        self.data = mujoco.MjData(model)
        self.grips: list[Grip] = []
        for part in dict.fromkeys(parts.values()):
            part.bind(model, self.data)
            if isinstance(part, SoftPartMuJoCo):
                self.grips += part.grips
        self.timestep_s = float(settings["timestep_s"])
        self._cloths = {
            name: part
            for name, part in parts.items()
            if isinstance(part, ClothPartMuJoCo)
        }
        self._stated_nodes = {name: one.nodes() for name, one in self._cloths.items()}
        self._air: list[AirOnCloth] = []
        if scene.air is not None:
            cloth = [*self._cloths.values()]
            check_air_step(scene, cloth, self.timestep_s)
            self._air = [AirOnCloth(scene.air, part, self.data) for part in cloth]
        # A scene in which a cloth touches nothing but itself.
        touching = {
            name
            for contact in scene.contacts
            for name in (*contact.first, *contact.second)
        }
        lone = self._cloths.get(touching.pop()) if len(touching) == 1 else None
        self._folds = FoldWatch(lone, model, self.data) if lone else None
        self._state_size = mujoco.mj_stateSize(
            model, mujoco.mjtState.mjSTATE_INTEGRATION
        )
        self._readers: dict[tuple[str, ...], StateReader] = {}
        self.contact_readers: list[MeanForces] = []
        self._driven: dict[str, DrivenBody] = {}
        self._built = self._scene = scene
        self._origin = _origin(settings, scene)
        key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, START_KEY)
        self._start_velocities = model.key_qvel[key] if key >= 0 else np.zeros(model.nv)
        self.data.qvel[:] = self._start_velocities
        self._warning_counts = self.data.warning.number

    def reset(self, seed: int) -> None:
        """Return to the scene's start. MuJoCo draws no random numbers, so the seed has no effect."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qvel[:] = self._start_velocities

    def start_at(self, scene: Scene) -> bool:
        """Place bodies elsewhere in the compiled model; see `Simulation.start_at`.

        A scene is built anew if more than the starts of rigid bodies and cloths and the motion of driven bodies
        differs. Fixed and driven bodies and cloths start elsewhere only in a model that was compiled at their stated
        start, of which a rigid motion keeps all but places.
        The editable model, and the centre and extent of MuJoCo's own pictures, stay those of the first start.
        """
        moved = starts_elsewhere(self._scene, scene)
        if moved == []:
            self._scene = scene
            self.reset(0)
            return True
        model = self.model
        is_scaled = self.settings.get("inverse_weight_scale", 1.0) != 1.0
        # The compiler normalizes an axis of another length, with bits of its own.
        is_rounded = any(
            abs(hypot(*hinge.axis) - 1.0) > UNIT_LENGTH
            for hinge in scene.hinges.values()
        )
        if moved is None or self._fixes_start or is_scaled or is_rounded:
            return False
        others = {one.name for one in moved} - {
            one.name for one in scene.dynamic_bodies
        }
        if others and not self._takes(scene, others):
            return False
        velocities = start_velocities(scene, model)
        if velocities.any() != bool(model.nkey):
            return False
        for one in moved:
            if isinstance(one, Cloth):
                self._cloths[one.name].place(model, one.pose)
            else:
                self._place(one, scene.hinges.get(one.name))
        if scene.dynamic_bodies:
            # What follows from the start, such as inverse weights.
            mujoco.mj_setConst(model, self.data)
        model.key_qpos[:] = model.qpos0
        self._start_velocities[:] = velocities
        self._scene = scene
        if scene.hinges:  # The reader of a hinged body keeps its start.
            self._readers.clear()
        self._origin = _origin(self.settings, scene)
        self.reset(0)
        return True

    def _takes(self, scene: Scene, others: set[str]) -> bool:
        """Return whether bodies that are not dynamic can start as a scene says.

        Args:
            scene: The scene.
            others: Names of the fixed and driven bodies and of the cloths that start elsewhere than now.
        """
        if not scene.deformables or (scene.stated or scene) != self._built:
            return False
        rounding = 1e-9
        return all(
            held.deformable in self._cloths
            # The reader of wrenches frees fixed bodies where they were compiled.
            and scene.body(held.to).motion is not Motion.FIXED
            and np.abs(_seen(scene, held) - _seen(self._built, held)).max() < rounding
            for held in scene.attachments
            if not others.isdisjoint((held.deformable, held.to))
        )

    def _place(self, body: RigidBody, hinge: Hinge | None) -> None:
        """Let a rigid body start elsewhere in the compiled model."""
        model = self.model
        index = model.body(body.name).id
        quaternion = np.array(body.pose.quaternion)
        mujoco.mju_normalize4(quaternion)
        model.body_pos[index] = body.pose.position_m
        model.body_quat[index] = quaternion
        if body.motion is Motion.FIXED:
            return
        first = model.joint(body.name)
        if hinge is None:
            start = np.concatenate([body.pose.position_m, quaternion])
            first.qpos0[:] = first.qpos_spring[:] = start
        else:
            first.pos[:], first.axis[:] = hinge_in_body(body, hinge)

    def drive(
        self,
        body: str,
        pose: Pose,
        velocity: FloatArray,
        acceleration: FloatArray,
    ) -> None:
        """Write the body's pose, its velocity, and the force that gives its large mass the acceleration."""
        place = (*pose.position_m, *pose.quaternion)
        self.driven_body(body).write(place, velocity, acceleration)
        for grip in self.grips:
            if grip.body == body:
                grip.follow()

    def driven_body(self, name: str) -> DrivenBody:
        """Return what drives a body by its name."""
        if name not in self._driven:
            self._driven[name] = DrivenBody(self.model, self.data, name)
        return self._driven[name]

    def apply_wrench(self, body: str, wrench: FloatArray) -> None:
        """Apply a force and a torque to a dynamic body; see `World.apply_wrench`."""
        self.data.xfrc_applied[self.model.body(body).id] = wrench

    def advance(self, seconds: float) -> None:
        """Step the model."""
        self._step(round(seconds / self.timestep_s))

    def _step(self, count: int) -> None:
        if self._folds is None or not self._folds.stays_apart(count * self.timestep_s):
            self._steps(count)
            return
        flags = self.model.opt.disableflags
        self.model.opt.disableflags = flags | mujoco.mjtDisableBit.mjDSBL_CONTACT
        self._steps(count)
        self.model.opt.disableflags = flags

    def _steps(self, count: int) -> None:
        for reader in self.contact_readers:
            reader.clear()
        if not self._air and not self.contact_readers:
            without_clock(partial(mujoco.mj_step, self.model, self.data, nstep=count))
            return
        for _ in range(count):
            for air in self._air:
                air.apply()
            mujoco.mj_step(self.model, self.data)
            for reader in self.contact_readers:
                reader.add()

    def fault(self) -> str | None:
        """Return why MuJoCo put the state back to its start since the last reset, or None; see `World.fault`."""
        counts = self._warning_counts.tolist()
        for warning, quantity in BAD_STATES.items():
            if counts[warning]:
                return f"MuJoCo found a {quantity} that is huge or not finite, and put the state back to its start"
        return None

    def body_states(self, names: Sequence[str]) -> FloatArray:
        """Return poses and velocities of bodies, shape [len(names), 13]; see `World.body_states`."""
        return self.reader(names).states()

    def sample_positions(
        self, names: Sequence[str], count: int, interval_s: float
    ) -> FloatArray:
        """Advance and return positions; see `Simulation.sample_positions`."""
        positions = np.empty((count, len(names), 3))
        read = self.reader(names).read_positions
        steps = round(interval_s / self.timestep_s)
        for row in positions:
            self._step(steps)
            read(row)
        return positions

    def reader(self, names: Sequence[str]) -> StateReader:
        """Return a reader of the states of some bodies."""
        key = tuple(names)
        if key not in self._readers:
            self._readers[key] = _reader(self._scene, self.model, self.data, key)
        return self._readers[key]

    def nodes(self, name: str) -> FloatArray:
        """Return the current nodes of a deformable body [m], shape [node_count, 3]."""
        part = self._parts[name]
        return (
            part.nodes()[part.node_indices[name]]
            if name in part.node_indices
            else part.nodes()
        )

    def stated_nodes(self, name: str) -> FloatArray | None:
        """Return the nodes of a cloth where it was compiled; see `World.stated_nodes`."""
        is_stated = self._scene.stated == self._built
        return self._stated_nodes.get(name) if is_stated else None

    def track(self, name: str, points_m: FloatArray) -> Callable[[], FloatArray] | None:
        """Return a reader of material points of soft bodies, ropes and rods, or None for cloth; see `World.track`."""
        part = self._parts[name]
        return (
            part.track(points_m)
            if isinstance(part, SoftPartMuJoCo | LinePartMuJoCo)
            else None
        )

    def contact_forces(
        self, pairs: Sequence[tuple[str, str]]
    ) -> Callable[[], FloatArray]:
        """Return a reader of contact forces, for which steps are taken one by one; see `World.contact_forces`."""
        model, data = self.model, self.data
        bodies = [(model.body(one).id, model.body(other).id) for one, other in pairs]
        reader = MeanForces(bodies, lambda: _touches(model, data))
        self.contact_readers.append(reader)
        return reader.mean

    def state(self) -> Snapshot:
        """Return MuJoCo's integration state, shape [state_size], with its origin."""
        state = np.empty(self._state_size)
        mujoco.mj_getState(
            self.model, self.data, state, mujoco.mjtState.mjSTATE_INTEGRATION
        )
        return self._origin.state(state)

    def restore(self, state: Snapshot) -> None:
        """Restore an integration state."""
        values = self._origin.values(state)
        self._warning_counts[:] = 0
        mujoco.mj_setState(
            self.model, self.data, values, mujoco.mjtState.mjSTATE_INTEGRATION
        )

    def close(self) -> None:
        """Do nothing, since the simulation only holds memory."""


def _seen(scene: Scene, held: Attachment) -> FloatArray:
    """Return origin [m] and axes of a cloth in the frame of the body that holds it, shape [4, 3]."""
    (cloth,) = (one for one in scene.deformables if one.name == held.deformable)
    holder = scene.body(held.to).pose
    return np.vstack(
        [
            holder.to_body(np.array(cloth.pose.position_m)),
            cloth.pose.matrix.T @ holder.matrix,
        ]
    )


def _origin(settings: Mapping[str, Any], scene: Scene) -> StateOrigin:
    return StateOrigin(f"mujoco {mujoco.__version__}", settings, scene)


def _touches(
    model: mujoco.MjModel, data: mujoco.MjData
) -> Iterator[tuple[int, int, FloatArray]]:
    """Yield the contacts of the last step: two bodies, and the force on the first [N]."""
    wrench = np.empty(6)
    for index in range(data.ncon):
        touch = data.contact[index]
        if min(touch.geom) < 0:
            continue
        first, second = model.geom_bodyid[touch.geom].tolist()
        mujoco.mj_contactForce(model, data, index, wrench)
        # The first row of the frame points from the first geom to the second, which the force pushes.
        yield first, second, -touch.frame.reshape(3, 3).T @ wrench[:3]


class DrivenBody:
    """Views of MuJoCo's arrays with the pose, velocity, force and mass of a driven body."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, body: str) -> None:
        index = model.body(body).id
        self._pose, velocity = free_joint_views(model, data, body)
        self._quaternion = self._pose[3:]
        self._linear = velocity[:3]
        self._angular = velocity[3:]
        self._force = data.xfrc_applied[index]
        self._mass_kg = model.body_mass[index : index + 1]
        self._inverse = np.empty(4)

    def write(
        self,
        pose: Sequence[float] | FloatArray,
        velocity: FloatArray,
        acceleration: FloatArray,
    ) -> None:
        """Write a motion of `World.drive`; the pose is position [m] and quaternion w x y z, shape [7]."""
        self._pose[:] = pose
        self._linear[:] = velocity[:3]
        # MuJoCo keeps a free joint's angular velocity in the body frame.
        mujoco.mju_negQuat(self._inverse, self._quaternion)
        mujoco.mju_rotVecQuat(self._angular, velocity[3:], self._inverse)
        # The mass and all moments of inertia of a driven body are the same number.
        np.multiply(self._mass_kg, acceleration, out=self._force)


class StateReader(Protocol):
    """Reader of the states of a fixed list of bodies.

    It keeps views of MuJoCo's arrays, because fetching an array costs more than reading from it.
    """

    def states(self) -> FloatArray:
        """Return the states of the bodies, shape [body_count, 13]."""

    def read_positions(self, out: FloatArray) -> None:
        """Write the positions of the bodies [m] to `out`, shape [body_count, 3]."""


def _reader(
    scene: Scene, model: mujoco.MjModel, data: mujoco.MjData, names: tuple[str, ...]
) -> StateReader:
    if all(
        scene.body(name).motion is not Motion.FIXED and name not in scene.hinges
        for name in names
    ):
        return (
            _OneFreeBody(model, data, names[0])
            if len(names) == 1
            else _FreeBodies(model, data, names)
        )
    hinge = scene.hinges.get(names[0]) if len(names) == 1 else None
    if hinge is not None:
        return _OneHingedBody(scene, model, data, hinge)
    return _AnyBodies(model, data, names)


class _OneFreeBody:
    """A single free body: its state is a slice of qpos and qvel."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, name: str) -> None:
        self._pose, velocity = free_joint_views(model, data, name)
        self._position = self._pose[:3]
        self._quaternion = self._pose[3:]
        self._linear = velocity[:3]
        self._angular = velocity[3:]

    def states(self) -> FloatArray:
        """Return the state of the body, shape [1, 13]."""
        state = np.empty((1, 13))
        row = state[0]
        row[:7] = self._pose
        row[7:10] = self._linear
        mujoco.mju_rotVecQuat(row[10:], self._angular, self._quaternion)
        return state

    def read_positions(self, out: FloatArray) -> None:
        """Write the position of the body to `out`, shape [1, 3]."""
        out[0] = self._position


class _FreeBodies:
    """Several free bodies, read from qpos and qvel by index arrays."""

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, names: tuple[str, ...]
    ) -> None:
        self._qpos = data.qpos
        self._qvel = data.qvel
        joints = [model.joint(name).id for name in names]
        self._poses = model.jnt_qposadr[joints][:, None] + np.arange(7)
        self._velocities = model.jnt_dofadr[joints][:, None] + np.arange(6)

    def states(self) -> FloatArray:
        """Return the states of the bodies, shape [body_count, 13]."""
        states = np.empty((len(self._poses), 13))
        states[:, :7] = self._qpos[self._poses]
        states[:, 7:] = self._qvel[self._velocities]
        for state in states:
            mujoco.mju_rotVecQuat(state[10:], state[10:].copy(), state[3:7])
        return states

    def read_positions(self, out: FloatArray) -> None:
        """Write the positions of the bodies to `out`, shape [body_count, 3]."""
        out[:] = self._qpos[self._poses[:, :3]]


class _AnyBodies:
    """Free, hinged and fixed bodies, read through MuJoCo's kinematics."""

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, names: tuple[str, ...]
    ) -> None:
        self._model = model
        self._data = data
        ids = [model.body(name).id for name in names]
        self._bodies = [(index, data.xpos[index], data.xquat[index]) for index in ids]
        self._velocity = np.empty(6)

    def states(self) -> FloatArray:
        """Return the states of the bodies, shape [body_count, 13]."""
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_comVel(self._model, self._data)
        states = np.empty((len(self._bodies), 13))
        velocity = self._velocity
        for state, (index, position, quaternion) in zip(
            states, self._bodies, strict=True
        ):
            mujoco.mj_objectVelocity(
                self._model, self._data, mujoco.mjtObj.mjOBJ_XBODY, index, velocity, 0
            )
            state[:3] = position
            state[3:7] = quaternion
            state[7:10] = velocity[3:]
            state[10:] = velocity[:3]
        return states

    def read_positions(self, out: FloatArray) -> None:
        """Write the positions of the bodies to `out`, shape [body_count, 3]."""
        mujoco.mj_kinematics(self._model, self._data)
        for row, (_, position, _) in zip(out, self._bodies, strict=True):
            row[:] = position


class _OneHingedBody(_AnyBodies):
    """A single hinged body; evaluating its circle is faster than MuJoCo's kinematics."""

    def __init__(
        self, scene: Scene, model: mujoco.MjModel, data: mujoco.MjData, hinge: Hinge
    ) -> None:
        super().__init__(model, data, (hinge.body,))
        address = int(model.joint(hinge.body).qposadr[0])
        self._angle = data.qpos[address : address + 1]
        axis = np.asarray(hinge.axis)
        arm = np.asarray(scene.body(hinge.body).pose.position_m) - hinge.anchor_m
        along = axis * (axis @ arm)
        self._circle = np.column_stack(
            [hinge.anchor_m + along, arm - along, np.cross(axis, arm)]
        ).tolist()

    def read_positions(self, out: FloatArray) -> None:
        """Write the position of the body to `out`, shape [1, 3]."""
        angle = self._angle.item()
        cosine, sine = cos(angle), sin(angle)
        for axis, (centre, arm, side) in enumerate(self._circle):
            out[0, axis] = centre + cosine * arm + sine * side
