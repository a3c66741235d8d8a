"""MuJoCo worlds of one scene: driving, stepping and reading of their states."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import compress
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
from gauge_envs.backends.shared.rigid import (
    CONJUGATE,
    MeanForces,
    PlacedSimulation,
    hinge_angle,
    placed_states,
)
from gauge_envs.backends.simulation import ContactForces, MaterialPoints, Sampler
from gauge_envs.processors import processor_count
from gauge_envs.scene import Hinge, Motion, Pose, RigidBody, Scene
from gauge_envs.scene.geometry import BoolArray, FloatArray, unit_quaternions
from gauge_envs.scene.states import row_of
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S

BAD_STATES = {
    mujoco.mjtWarning.mjWARN_BADQPOS: "position",
    mujoco.mjtWarning.mjWARN_BADQVEL: "velocity",
    mujoco.mjtWarning.mjWARN_BADQACC: "acceleration",
}
"""Quantity of each warning after which MuJoCo resets the state."""


class SimulationMuJoCo(PlacedSimulation):
    """A scene in MuJoCo: one model, and one `MjData` for each world, which threads step.

    Args:
        scene: The scene.
        settings: Effective numerical settings, including `timestep_s`.
        spec: The editable model, for export and inspection.
        model: The compiled model.
        parts: Parts of its deformable bodies, by name; with any, there is one world.
        world_count: Number of worlds.

    Attributes:
        datas: MuJoCo's state of each world.
        data: MuJoCo's state of the first world.
        timestep_s: Time step [s].
        parts: Parts of deformable bodies, by name.
        grips: Nodes of soft bodies that move with driven bodies.
    """

    releases_gil = True

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
        self.parts = parts
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
        # Whether nothing acts or reads between the steps of an interval.
        self._is_plain = not self._air
        self.placed = placed_states(scene)
        self._moving = {
            body.name: self._moving_body(body)
            for body in scene.bodies
            if body.motion is not Motion.FIXED
        }
        # Views: fetching an array of MuJoCo costs more than reading from it.
        self._options = model.opt
        self._warnings = [data.warning.number for data in self.datas]
        self._driven: dict[str, _DrivenBody] = {}
        self._thread_count = min(processor_count(), world_count)
        self._threads = None
        if self._thread_count > 1:
            self._threads = ThreadPoolExecutor(self._thread_count - 1)
        self.reset()

    def _fold_watch(self) -> FoldWatch | None:
        """Return the watch of a cloth that touches nothing but itself, or None.

        With three steps in an interval, the watch takes as long as the searches for contacts that it saves.
        """
        if self.timestep_s > 0.3 * SAMPLE_INTERVAL_S:
            return None
        touching = {
            name
            for contact in self._scene.contacts
            for name in (*contact.first, *contact.second)
        }
        if len(touching) != 1 or touching.isdisjoint(self._cloths):
            return None
        return FoldWatch(self._cloths[touching.pop()], self.model, self.data)

    def _moving_body(self, body: RigidBody) -> _FreeBody | _HingedBody:
        """Return the object that reads and writes the states of a body."""
        hinge = self._scene.hinges.get(body.name)
        if hinge is None:
            return _FreeBody(self.model, self.datas, body.name)
        return _HingedBody(self.model, self.datas, hinge, body.pose)

    def reset(
        self,
        starts: FloatArray | None = None,
        seed: int = 0,
        worlds: BoolArray | None = None,
    ) -> None:
        """Start worlds; MuJoCo draws no random numbers, so the seed has no effect."""
        key = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_KEY, START_KEY)
        chosen = [*range(self.world_count)]
        if worlds is not None:
            chosen = np.flatnonzero(worlds).tolist()
        for world in chosen:
            data = self.datas[world]
            mujoco.mj_resetData(self.model, data)
            if key >= 0:
                data.qvel[:] = self.model.key_qvel[key]
        if self._folds is not None:
            self._folds.forget()
        if starts is None:
            return
        for row, body in enumerate(self._scene.bodies):
            if body.name in self._moving:
                for world in chosen:
                    self._moving[body.name].write(world, starts[world, row])
        for name in self._scene.free_cloths:
            state = starts[0, row_of(self._scene, name)]
            self._cloths[name].set_pose(Pose.of_state(state))

    def drive(self, body: str, targets: FloatArray) -> None:
        """Write each world's pose, velocity, and the force that gives the body's large mass the acceleration."""
        self._prepared(body, targets[None])(0)

    def prepared(self, body: str, targets: FloatArray) -> Callable[[int], None]:
        """Return a function that drives a body in one of several intervals; a subclass may change `drive` alone."""
        is_own = type(self).drive is SimulationMuJoCo.drive
        return (self._prepared if is_own else super().prepared)(body, targets)

    def _prepared(self, body: str, targets: FloatArray) -> Callable[[int], None]:
        if body not in self._driven:
            driven = _DrivenBody(self.model, self.datas, body)
            driven.grips = [grip for grip in self.grips if grip.body == body]
            self._driven[body] = driven
        return self._driven[body].prepared(targets)

    def apply_wrench(self, body: str, wrenches: FloatArray) -> None:
        """Apply a force and a torque to a dynamic body; see `Simulation.apply_wrench`."""
        index = self.model.body(body).id
        for data, wrench in zip(self.datas, wrenches, strict=True):
            data.xfrc_applied[index] = wrench

    def advance(self, seconds: float) -> None:
        """Step the model in all worlds."""
        count = round(seconds / self.timestep_s)
        # Access to the options takes as long as a drive.
        if self._folds is None:
            self._step_all(count)
            return
        flags = self._options.disableflags
        if self._folds.stays_apart(count * self.timestep_s):
            no_contact = mujoco.mjtDisableBit.mjDSBL_CONTACT
            self._options.disableflags = flags | no_contact
        self._step_all(count)
        self._options.disableflags = flags

    def _step_all(self, count: int) -> None:
        """Step all worlds in threads, of which this thread is the first."""
        if self._threads is None:
            self._step_worlds(0, count)
            return
        others = range(1, self._thread_count)
        steps = [self._threads.submit(self._step_worlds, n, count) for n in others]
        self._step_worlds(0, count)
        for step in steps:
            step.result()

    def _step_worlds(self, thread: int, count: int) -> None:
        """Step the worlds of a thread."""
        for world in range(thread, self.world_count, self._thread_count):
            if self._is_plain:
                mujoco.mj_step(self.model, self.datas[world], count)
            else:
                self._step(world, count)

    def _step(self, world: int, count: int) -> None:
        """Step one world with air or readers of forces."""
        readers = self._force_readers[world]
        for reader in readers:
            reader.clear()
        for _ in range(count):
            for air in self._air:
                air.apply()
            mujoco.mj_step(self.model, self.datas[world])
            for reader in readers:
                reader.add()

    def diverged(self) -> Mapping[int, str]:
        """Return the worlds whose state MuJoCo reset since the last call of `reset`."""
        if not any(any(numbers.tolist()) for numbers in self._warnings):
            return {}
        is_bad = np.array(self._warnings)[:, [*map(int, BAD_STATES)]] > 0
        return {
            world: f"MuJoCo found a {next(compress(BAD_STATES.values(), is_bad[world]))} that is huge or not finite, "
            "and reset the state"
            for world in np.flatnonzero(is_bad.any(axis=1)).tolist()
        }

    def moving_states(self, names: Sequence[str]) -> FloatArray:
        """Return the states of dynamic and driven bodies, shape [N, len(names), 13]."""
        states = np.empty((self.world_count, len(names), 13))
        for row, name in enumerate(names):
            self._moving[name].read(states[:, row])
        return states

    def sampler(self, names: Sequence[str], rows: FloatArray) -> Sampler:
        """Return a sampler that copies coordinates of free bodies; a subclass may change `body_states` alone."""
        is_own = type(self).body_states is SimulationMuJoCo.body_states
        bodies = [self._moving.get(name) for name in names]
        free = [body for body in bodies if isinstance(body, _FreeBody)]
        if is_own and len(free) == len(bodies):
            return _FreeSampler(free, rows)
        return super().sampler(names, rows)

    def nodes(self, name: str) -> FloatArray:
        """Return the nodes of a deformable body [m], shape [1, node_count, 3]."""
        part = self.parts[name]
        nodes = part.nodes()
        if name in part.node_indices:
            nodes = nodes[part.node_indices[name]]
        return nodes[None]

    def track(self, name: str, points_m: FloatArray) -> MaterialPoints | None:
        """Return a reader of material points of soft bodies, ropes and rods, or None for cloth."""
        part = self.parts[name]
        if not isinstance(part, SoftPartMuJoCo | LinePartMuJoCo):
            return None
        read = part.track(points_m)
        return lambda: read()[None]

    def contact_forces(self, pairs: Sequence[tuple[str, str]]) -> ContactForces:
        """Return a reader of contact forces, which are summed after every step."""
        model = self.model
        bodies = [
            (model.body(first).id, model.body(second).id) for first, second in pairs
        ]
        readers = [
            MeanForces(bodies, partial(_touches, model, data)) for data in self.datas
        ]
        for known, reader in zip(self._force_readers, readers, strict=True):
            known.append(reader)
        self._is_plain = False
        return lambda: np.concatenate([reader.mean() for reader in readers])

    def close(self) -> None:
        """End the threads."""
        if self._threads is not None:
            self._threads.shutdown()


KINEMATICS = (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel)
"""Stages of a step that compute the poses and velocities of bodies from those of joints."""


def kinematic_state(data: mujoco.MjData, body: int) -> FloatArray:
    """Return the state of a body after the stages `KINEMATICS`, shape [13]; see `Simulation.body_states`."""
    velocity = np.empty(6)
    kind = mujoco.mjtObj.mjOBJ_XBODY
    mujoco.mj_objectVelocity(data.model, data, kind, body, velocity, 0)
    angular, linear = velocity[:3], velocity[3:]
    return np.concatenate([data.xpos[body], data.xquat[body], linear, angular])


def _touches(
    model: mujoco.MjModel, data: mujoco.MjData
) -> Iterator[tuple[int, int, FloatArray]]:
    """Yield the contacts of the last step: two bodies, and the force on the first [N]."""
    wrench = np.empty(6)
    for index in range(data.ncon):
        point = data.contact[index]
        if min(point.geom) < 0:
            continue
        first, second = model.geom_bodyid[point.geom].tolist()
        mujoco.mj_contactForce(model, data, index, wrench)
        # The first row of the frame points from the first geom to the second, which the force pushes.
        yield first, second, -point.frame.reshape(3, 3).T @ wrench[:3]


class _FreeBody:
    """Views of MuJoCo's arrays with the states of a body on a free joint in all worlds.

    Attributes:
        poses: Its position and quaternion w x y z in each world, shape [7] each.
        rates: Its velocity, and its angular velocity in its own frame, shape [6] each.
    """

    def __init__(
        self, model: mujoco.MjModel, datas: Sequence[mujoco.MjData], name: str
    ) -> None:
        views = [free_joint_views(model, data, name) for data in datas]
        self.poses = [pose for pose, _ in views]
        self._quaternions = [pose[3:] for pose, _ in views]
        self.rates = [rate for _, rate in views]
        self._spins = [rate[3:] for _, rate in views]

    def write(self, world: int, state: FloatArray) -> None:
        """Write an initial state of a world, shape [13]."""
        quaternion = unit_quaternions(state[3:7])
        self.poses[world][:3] = state[:3]
        self._quaternions[world][:] = quaternion
        self.rates[world][:3] = state[7:10]
        # MuJoCo keeps a free joint's angular velocity in the body frame.
        back = CONJUGATE * quaternion
        mujoco.mju_rotVecQuat(self._spins[world], state[10:], back)

    def read(self, states: FloatArray) -> None:
        """Write the states of the body to an array, shape [N, 13]."""
        # For one world, the calls of NumPy would take longer than the copy.
        if len(states) == 1:
            states[0, :7], states[0, 7:10] = self.poses[0], self.rates[0][:3]
        else:
            states[:, :7] = np.concatenate(self.poses).reshape(-1, 7)
            states[:, 7:10] = np.concatenate(self.rates).reshape(-1, 6)[:, :3]
        rows = zip(states[:, 10:], self._spins, self._quaternions, strict=True)
        for spin, inner, quaternion in rows:
            mujoco.mju_rotVecQuat(spin, inner, quaternion)


class _FreeSampler(Sampler):
    """Sampler that copies MuJoCo's coordinates at each time.

    Args:
        bodies: Bodies on free joints.
        rows: Array for their states, shape [count, N, len(bodies), 13].
    """

    def __init__(self, bodies: Sequence[_FreeBody], rows: FloatArray) -> None:
        rates = np.empty((*rows.shape[:-1], 6))
        self._velocities, self._linear = rows[..., 7:10], rates[..., :3]
        self._turns = []
        self._copies: list[list[tuple[FloatArray, FloatArray]]] = [[] for _ in rows]
        for place in np.ndindex(rows.shape[:-1]):
            index, world, number = place
            state, rate, body = rows[place], rates[place], bodies[number]
            self._copies[index].append((state[:7], body.poses[world]))
            self._copies[index].append((rate, body.rates[world]))
            self._turns.append((state[10:], rate[3:], state[3:7]))

    def read(self, index: int) -> None:
        """Copy the coordinates of all worlds for a row."""
        for row, coordinates in self._copies[index]:
            row[:] = coordinates

    def finish(self) -> None:
        """Copy the velocities, and turn the spins into the frame of the world."""
        self._velocities[:] = self._linear
        for spin, inner, quaternion in self._turns:
            mujoco.mju_rotVecQuat(spin, inner, quaternion)


class _DrivenBody(_FreeBody):
    """Views of MuJoCo's arrays with the state, force and mass of a driven body in all worlds.

    Attributes:
        grips: Nodes of soft bodies that move with it.
    """

    grips: Sequence[Grip] = ()

    def __init__(
        self, model: mujoco.MjModel, datas: Sequence[mujoco.MjData], name: str
    ) -> None:
        super().__init__(model, datas, name)
        index = model.body(name).id
        forces = [data.xfrc_applied[index] for data in datas]
        self._views = self.poses, self.rates, forces
        self._mass_kg = model.body_mass[index : index + 1]
        # Integrators but RK4 move a body by its speed at the end of a step, a h / 2 above the mean speed of the step.
        is_exact = model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
        self._lead_s = 0.0 if is_exact else 0.5 * model.opt.timestep

    def prepared(self, targets: FloatArray) -> Callable[[int], None]:
        """Return a function that writes the targets of an interval; see `Simulation.prepared`."""
        rates = targets[..., 7:13] - self._lead_s * targets[..., 13:]
        # A body that only translates has no spin to rotate into its frame.
        if np.count_nonzero(rates[..., 3:]):
            back = targets[..., 3:7] * CONJUGATE
            spins = rates.reshape(-1, 6)[:, 3:]
            for spin, quaternion in zip(spins, back.reshape(-1, 4), strict=True):
                mujoco.mju_rotVecQuat(spin, spin.copy(), quaternion)
        # The mass and all moments of inertia of a driven body are the same number.
        forces = self._mass_kg * targets[..., 13:]
        given = zip(self._views, (targets[..., :7], rates, forces), strict=True)
        writes = [
            (view, rows[:, world])
            for views, rows in given
            for world, view in enumerate(views)
        ]

        def write(interval: int) -> None:
            for view, rows in writes:
                view[:] = rows[interval]
            for grip in self.grips:
                grip.follow()

        return write


class _HingedBody:
    """A body on a hinge to the world in all worlds, read through MuJoCo's kinematics.

    Args:
        model: The model.
        datas: MuJoCo's state of each world.
        hinge: The hinge.
        start: Pose of the body at the nominal start.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        datas: Sequence[mujoco.MjData],
        hinge: Hinge,
        start: Pose,
    ) -> None:
        self._model, self._datas = model, datas
        self._hinge, self._start = hinge, start
        self._index = model.body(hinge.body).id
        joint = model.body_jntadr[self._index]
        self._angle, self._rate = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
        self._nominal_rad = float(model.qpos0[self._angle])

    def write(self, world: int, state: FloatArray) -> None:
        """Write an initial state of a world, shape [13]."""
        data = self._datas[world]
        turned_rad = hinge_angle(self._hinge, self._start, state)
        data.qpos[self._angle] = self._nominal_rad + turned_rad
        data.qvel[self._rate] = state[10:] @ self._hinge.axis

    def read(self, states: FloatArray) -> None:
        """Write the states of the body to an array, shape [N, 13]."""
        for data, state in zip(self._datas, states, strict=True):
            for stage in KINEMATICS:
                stage(self._model, data)
            state[:] = kinematic_state(data, self._index)
