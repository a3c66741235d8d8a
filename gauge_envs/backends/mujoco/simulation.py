"""MuJoCo worlds of one scene: driving, stepping and reading of their states."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

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
from gauge_envs.backends.mujoco.model import START_KEY
from gauge_envs.backends.mujoco.soft import Grip, SoftPartMuJoCo
from gauge_envs.backends.shared.rigid import CONJUGATE, MeanForces, body_state
from gauge_envs.backends.simulation import ContactForces, MaterialPoints, Simulation
from gauge_envs.files import processors
from gauge_envs.scene import Motion, Pose, Scene
from gauge_envs.scene.geometry import FloatArray, quaternion_products, unit_quaternions

BAD_STATES = {
    mujoco.mjtWarning.mjWARN_BADQPOS: "position",
    mujoco.mjtWarning.mjWARN_BADQVEL: "velocity",
    mujoco.mjtWarning.mjWARN_BADQACC: "acceleration",
}
"""Quantity of each warning after which MuJoCo puts the state back to its start."""


class SimulationMuJoCo(Simulation):
    """A scene in MuJoCo: one model, and one `MjData` for each world, which threads step.

    Args:
        scene: The scene.
        settings: Numerical settings in force, including `timestep_s`.
        spec: The editable model, for export and inspection.
        model: The compiled model.
        parts: Parts of its deformable bodies, by name; with any, there is one world.
        world_count: Number of worlds.

    Attributes:
        datas: MuJoCo's state of each world.
        data: MuJoCo's state of the first world.
        timestep_s: Time step [s].
        grips: Nodes of soft bodies that move with driven bodies.
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
        world_count: int = 1,
    ) -> None:
        self.settings = settings
        self.world_count = world_count
        self.spec = spec
        self.model = model
        self.datas = [mujoco.MjData(model) for _ in range(world_count)]
        self.data = self.datas[0]
        self.timestep_s = float(settings["timestep_s"])
        self._scene = scene
        self._parts = parts
        self.grips: list[Grip] = []
        for part in dict.fromkeys(parts.values()):
            part.bind(model, self.data)
            if isinstance(part, SoftPartMuJoCo):
                self.grips += part.grips
        self._cloths = {
            name: part
            for name, part in parts.items()
            if isinstance(part, ClothPartMuJoCo)
        }
        self._air: list[AirOnCloth] = []
        if scene.air is not None:
            cloths = [*self._cloths.values()]
            check_air_step(scene, cloths, self.timestep_s)
            self._air = [AirOnCloth(scene.air, part, self.data) for part in cloths]
        self._folds = self._fold_watch()
        self._force_readers: list[list[MeanForces]] = [[] for _ in self.datas]
        self._bodies = _Bodies(scene, model)
        # Views: fetching an array of MuJoCo costs more than reading from it.
        self._qpos = [data.qpos for data in self.datas]
        self._qvel = [data.qvel for data in self.datas]
        self._warnings = [data.warning.number for data in self.datas]
        self._driven: dict[str, list[DrivenBody]] = {}
        thread_count = min(processors(), world_count)
        self._threads = ThreadPoolExecutor(thread_count) if thread_count > 1 else None
        self.reset()

    def _fold_watch(self) -> FoldWatch | None:
        """Return the watch of a cloth that touches nothing but itself, or None."""
        touching = {
            name
            for contact in self._scene.contacts
            for name in (*contact.first, *contact.second)
        }
        if len(touching) != 1 or touching.isdisjoint(self._cloths):
            return None
        return FoldWatch(self._cloths[touching.pop()], self.model, self.data)

    def reset(self, starts: FloatArray | None = None, seed: int = 0) -> None:
        """Start all worlds; MuJoCo draws no random numbers, so the seed has no effect."""
        key = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_KEY, START_KEY)
        for data in self.datas:
            mujoco.mj_resetData(self.model, data)
            if key >= 0:
                data.qvel[:] = self.model.key_qvel[key]
        if self._folds is not None:
            self._folds.forget()
        if starts is None:
            return
        self._bodies.write(starts, self._qpos, self._qvel)
        names = [body.name for body in self._scene.deformables]
        attached = {one.deformable for one in self._scene.attachments}
        for name, part in self._cloths.items():
            if name not in attached:
                row = starts[0, len(self._scene.bodies) + names.index(name)].tolist()
                w, x, y, z = row[3:7]
                part.start_at(Pose(position_m=tuple(row[:3]), quaternion=(w, x, y, z)))

    def drive(self, body: str, targets: FloatArray) -> None:
        """Write each world's pose, velocity, and the force that gives the body's large mass the acceleration."""
        if body not in self._driven:
            self._driven[body] = [
                DrivenBody(self.model, data, body) for data in self.datas
            ]
        for driven, target in zip(self._driven[body], targets, strict=True):
            driven.write(target)
        for grip in self.grips:
            if grip.body == body:
                grip.follow()

    def apply_wrench(self, body: str, wrenches: FloatArray) -> None:
        """Apply a force and a torque to a dynamic body; see `Simulation.apply_wrench`."""
        index = self.model.body(body).id
        for data, wrench in zip(self.datas, wrenches, strict=True):
            data.xfrc_applied[index] = wrench

    def advance(self, seconds: float) -> None:
        """Step the model in all worlds."""
        count = round(seconds / self.timestep_s)
        flags = self.model.opt.disableflags
        if self._folds is not None and self._folds.stays_apart(count * self.timestep_s):
            no_contact = mujoco.mjtDisableBit.mjDSBL_CONTACT
            self.model.opt.disableflags = flags | no_contact
        apply = map if self._threads is None else self._threads.map
        # The results of the map raise the errors of its calls.
        list(apply(lambda world: self._step(world, count), range(self.world_count)))
        self.model.opt.disableflags = flags

    def _step(self, world: int, count: int) -> None:
        """Step one world."""
        readers = self._force_readers[world]
        for reader in readers:
            reader.clear()
        if not self._air and not readers:
            mujoco.mj_step(self.model, self.datas[world], nstep=count)
            return
        for _ in range(count):
            for air in self._air:
                air.apply()
            mujoco.mj_step(self.model, self.datas[world])
            for reader in readers:
                reader.add()

    def diverged(self) -> Mapping[int, str]:
        """Return the worlds whose state MuJoCo put back to its start since the last reset."""
        found = {}
        for world, counts in enumerate(self._warnings):
            for warning, quantity in BAD_STATES.items():
                if counts[warning]:
                    found[world] = (
                        f"MuJoCo found a {quantity} that is huge or not finite, and put the state back to its start"
                    )
                    break
        return found

    def body_states(self, names: Sequence[str]) -> FloatArray:
        """Return the states of bodies, shape [N, len(names), 13]."""
        return self._bodies.read(tuple(names), self._qpos, self._qvel)

    def nodes(self, name: str) -> FloatArray:
        """Return the nodes of a deformable body [m], shape [1, node_count, 3]."""
        part = self._parts[name]
        nodes = part.nodes()
        if name in part.node_indices:
            nodes = nodes[part.node_indices[name]]
        return nodes[None]

    def track(self, name: str, points_m: FloatArray) -> MaterialPoints | None:
        """Return a reader of material points of soft bodies, ropes and rods, or None for cloth."""
        part = self._parts[name]
        if not isinstance(part, SoftPartMuJoCo | LinePartMuJoCo):
            return None
        read = part.track(points_m)
        return lambda: read()[None]

    def contact_forces(self, pairs: Sequence[tuple[str, str]]) -> ContactForces:
        """Return a reader of contact forces, for which steps are taken one by one."""
        model = self.model
        bodies = [
            (model.body(first).id, model.body(second).id) for first, second in pairs
        ]
        readers = [
            MeanForces(bodies, lambda data=data: _touches(model, data))
            for data in self.datas
        ]
        for known, reader in zip(self._force_readers, readers, strict=True):
            known.append(reader)
        return lambda: np.concatenate([reader.mean() for reader in readers])

    def close(self) -> None:
        """End the threads."""
        if self._threads is not None:
            self._threads.shutdown()


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
    """Views of MuJoCo's arrays with the pose, velocity, force and mass of a driven body in one world."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, body: str) -> None:
        index = model.body(body).id
        self._pose, velocity = free_joint_views(model, data, body)
        self._linear, self._angular = velocity[:3], velocity[3:]
        self._force = data.xfrc_applied[index]
        self._mass_kg = model.body_mass[index : index + 1]
        self._inverse = np.empty(4)

    def write(self, target: FloatArray) -> None:
        """Write a row of `Simulation.drive`, shape [19]."""
        self._pose[:] = target[:7]
        self._linear[:] = target[7:10]
        # MuJoCo keeps a free joint's angular velocity in the body frame.
        mujoco.mju_negQuat(self._inverse, target[3:7])
        mujoco.mju_rotVecQuat(self._angular, target[10:13], self._inverse)
        # The mass and all moments of inertia of a driven body are the same number.
        np.multiply(self._mass_kg, target[13:], out=self._force)


class _Bodies:
    """Places of the states of rigid bodies in `qpos` and `qvel`.

    A dynamic or driven body has a free joint, or a hinge to the world; a fixed body has none.
    """

    def __init__(self, scene: Scene, model: mujoco.MjModel) -> None:
        self._scene = scene
        self._placed = {body.name: body_state(body.pose) for body in scene.bodies}
        self._hinges = scene.hinges
        self._qpos0 = model.qpos0
        self._rows: dict[tuple[str, ...], _Rows] = {}
        # The places of a body's joint in qpos and qvel.
        self.joints: dict[str, tuple[int, int]] = {}
        for body in scene.bodies:
            if body.motion is not Motion.FIXED:
                joint = model.body(body.name).jntadr[0]
                places = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
                self.joints[body.name] = places

    def write(
        self, starts: FloatArray, qpos: Sequence[FloatArray], qvel: Sequence[FloatArray]
    ) -> None:
        """Write initial states, shape [N, B, 13], of all bodies that move."""
        names = [body.name for body in self._scene.bodies]
        for name, (position, velocity) in self.joints.items():
            states = starts[:, names.index(name)]
            quaternions = unit_quaternions(states[:, 3:7])
            hinge = self._hinges.get(name)
            if hinge is None:
                for world, state in enumerate(states):
                    qpos[world][position : position + 3] = state[:3]
                    qpos[world][position + 3 : position + 7] = quaternions[world]
                    qvel[world][velocity : velocity + 3] = state[7:10]
                    angular = qvel[world][velocity + 3 : velocity + 6]
                    inverse = CONJUGATE * quaternions[world]
                    mujoco.mju_rotVecQuat(angular, state[10:], inverse)
                continue
            axis = np.asarray(hinge.axis)
            back = CONJUGATE * self._placed[name][3:7]
            turns = quaternion_products(quaternions, back)
            angles = 2.0 * np.arctan2(turns[:, 1:] @ axis, turns[:, 0])
            # The shorter way round.
            angles = (angles + np.pi) % (2.0 * np.pi) - np.pi
            for world, state in enumerate(states):
                qpos[world][position] = self._qpos0[position] + angles[world]
                qvel[world][velocity] = state[10:] @ axis

    def read(
        self,
        names: tuple[str, ...],
        qpos: Sequence[FloatArray],
        qvel: Sequence[FloatArray],
    ) -> FloatArray:
        """Return the states of bodies, shape [N, len(names), 13]."""
        if names not in self._rows:
            self._rows[names] = _Rows(self._scene, names, self.joints)
        rows = self._rows[names]
        states = np.empty((len(qpos), len(names), 13))
        states[:] = rows.placed
        if rows.free:
            for state, positions, velocities in zip(states, qpos, qvel, strict=True):
                state[rows.free, :7] = positions[rows.poses]
                state[rows.free, 7:] = velocities[rows.velocities]
                for row in rows.free:
                    # MuJoCo keeps a free joint's angular velocity in the body frame.
                    body = state[row]
                    mujoco.mju_rotVecQuat(body[10:], body[10:].copy(), body[3:7])
        if rows.hinged:
            angles = np.array(qpos)[:, rows.angles] - self._qpos0[rows.angles]
            rates = np.array(qvel)[:, rows.rates]
            states[:, rows.hinged] = rows.hinged_states(angles, rates)
        return states


class _Rows:
    """Places of the states of some bodies, and the circles of those on a hinge.

    Args:
        scene: The scene.
        names: Names of the bodies.
        joints: Places of the joint of each body that moves in `qpos` and `qvel`.
    """

    def __init__(
        self,
        scene: Scene,
        names: tuple[str, ...],
        joints: Mapping[str, tuple[int, int]],
    ) -> None:
        self.placed = np.array([body_state(scene.body(name).pose) for name in names])
        self.placed = self.placed.reshape(-1, 13)
        hinges = [scene.hinges.get(name) for name in names]
        moving = [row for row, name in enumerate(names) if name in joints]
        self.free = [row for row in moving if hinges[row] is None]
        self.hinged = [row for row in moving if hinges[row] is not None]
        free = np.array([joints[names[row]] for row in self.free], dtype=int)
        free = free.reshape(-1, 2)
        self.poses = free[:, :1] + np.arange(7)
        self.velocities = free[:, 1:] + np.arange(6)
        self.angles = [joints[names[row]][0] for row in self.hinged]
        self.rates = [joints[names[row]][1] for row in self.hinged]
        known = [hinge for hinge in hinges if hinge is not None]
        self._axes = np.array([hinge.axis for hinge in known]).reshape(-1, 3)
        anchors_m = np.array([hinge.anchor_m for hinge in known]).reshape(-1, 3)
        arms_m = self.placed[self.hinged, :3] - anchors_m
        along_m = (arms_m * self._axes).sum(axis=1, keepdims=True) * self._axes
        self._centres_m = anchors_m + along_m
        self._arms_m = arms_m - along_m
        self._sides_m = np.cross(self._axes, arms_m)
        self._quaternions = unit_quaternions(self.placed[self.hinged, 3:7])

    def hinged_states(self, angles: FloatArray, rates: FloatArray) -> FloatArray:
        """Return the states of bodies that have turned about their hinges.

        Args:
            angles: Angles from the nominal start [rad], shape [N, hinge_count].
            rates: Their rates [rad/s], shape [N, hinge_count].

        Returns:
            Shape [N, hinge_count, 13].
        """
        cosines, sines = np.cos(angles)[..., None], np.sin(angles)[..., None]
        states = np.empty((*angles.shape, 13))
        states[..., :3] = (
            self._centres_m + cosines * self._arms_m + sines * self._sides_m
        )
        tangents_m = cosines * self._sides_m - sines * self._arms_m
        states[..., 7:10] = rates[..., None] * tangents_m
        states[..., 10:] = rates[..., None] * self._axes
        halves = 0.5 * angles[..., None]
        turns = np.concatenate(
            [np.cos(halves), np.sin(halves) * self._axes], axis=-1
        ).reshape(-1, 4)
        starts = np.tile(self._quaternions, (len(angles), 1))
        quaternions = quaternion_products(turns, starts)
        states[..., 3:7] = quaternions.reshape(*angles.shape, 4)
        return states
