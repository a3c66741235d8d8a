"""Stepper of a Newton model: prescribed motion, the recorded step of the solver, and the states of all worlds.

Warp launches each kernel from Python, which costs more than the kernel itself in such small scenes. A step is therefore
recorded once as a graph, on the CPU or a GPU, and replayed. That is 20 to 100 times faster and bitwise identical.

All worlds of a model are equal, and its arrays hold them one after another. Bodies and particles are therefore given by
their index in a world. Positions are those of the model.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import newton
import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from gauge_envs.backends.newton.kernels import prescribe
from gauge_envs.backends.shared.rigid import MeanForces
from gauge_envs.scene import Pose
from gauge_envs.scene.geometry import BoolArray, FloatArray, IntArray

TO_WARP = [4, 5, 6, 3]
"""Columns of a state's quaternion w x y z in Warp's order x y z w."""


def warp_transform(pose: Pose) -> wp.transform:
    """Return Warp's transform of a pose; Warp's quaternions are x, y, z, w."""
    w, x, y, z = pose.quaternion
    return wp.transform(wp.vec3(*pose.position_m), wp.quat(x, y, z, w))


def rotated(quaternions: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return vectors rotated by unit quaternions x, y, z, w; all axes except the last are broadcast."""
    axes = quaternions[..., :3]
    twice = 2.0 * np.cross(axes, vectors)
    return vectors + quaternions[..., 3:] * twice + np.cross(axes, twice)


def _arrays(state: newton.State) -> dict[str, Any]:
    """Return a copy of each array of a state that has entries, by name."""
    arrays = {k: v for k, v in vars(state).items() if isinstance(v, wp.array)}
    return {name: array.numpy().copy() for name, array in arrays.items() if array.size}


def _write(array: wp.array, values: Any, worlds: BoolArray) -> None:
    """Write the values of some worlds, shape [N], into an array."""
    written = array.numpy().copy()
    rows = (len(worlds), -1, *written.shape[1:])
    written.reshape(rows)[worlds] = values.reshape(rows)[worlds]
    array.assign(written)


class Stepper(ABC):
    """Stepper of the worlds of one model with one solver.

    Args:
        model: The finalized model.
        solver: Its solver.
        driven: Indices of the kinematic bodies.
        timestep_s: Time step of the solver [s].

    Attributes:
        states: The two states between which steps alternate.
        current: Number of the state that the last step wrote.
        control: Forces on joints, none here.
        force_readers: Readers of contact forces.
    """

    def __init__(
        self,
        model: newton.Model,
        solver: Any,
        *,
        driven: Sequence[int],
        timestep_s: float,
    ) -> None:
        self.model = model
        self.solver = solver
        self.timestep_s = timestep_s
        self.world_count = model.world_count
        self.states = (model.state(), model.state())
        self.current = 0
        self.control = model.control()
        self.force_readers: list[MeanForces] = []
        self._first = model.state()
        self._first_poses = self.poses()
        body_count = model.body_count // self.world_count
        self._centres_m = np.zeros((body_count, 3))
        if body_count:
            self._centres_m[:] = model.body_com.numpy()[:body_count]
        self._driven_rows = {body: row for row, body in enumerate(driven)}
        shape = (self.world_count, len(driven))
        self._targets = np.zeros((*shape, 19), dtype=np.float32)
        self._elapsed = np.zeros(shape, dtype=np.int32)
        with wp.ScopedDevice(model.device):
            self._driven = wp.array(self.in_worlds(driven, body_count), dtype=wp.int32)
            self._device_targets = wp.zeros((self._elapsed.size, 19), dtype=wp.float32)
            self._device_elapsed = wp.zeros(self._elapsed.size, dtype=wp.int32)
        self._graphs: list[Any] = []

    def in_worlds(self, indices: ArrayLike, count: int) -> IntArray:
        """Return the indices in the model of entities of all worlds, which have a number of them each."""
        first = count * np.arange(self.world_count)[:, None]
        return (first + np.asarray(indices, dtype=np.intp)).ravel()

    @abstractmethod
    def _step(self, state: newton.State, after: newton.State) -> None:
        """Move the driven bodies and step from one state to the other; `record` records this method."""

    def record(self) -> None:
        """Record the step in both directions between the two states, and return to the start."""
        # Solvers allocate their arrays in the first step.
        self._step(*self.states)
        self._graphs = []
        for state, after in (self.states, self.states[::-1]):
            with wp.ScopedCapture(device=self.model.device) as capture:
                self._step(state, after)
            self._graphs.append(capture.graph)
        self.reset()

    def reset(
        self,
        bodies: Sequence[int] = (),
        initial_states: FloatArray | None = None,
        particles_m: FloatArray | None = None,
        worlds: BoolArray | None = None,
    ) -> None:
        """Start worlds; bodies and particles that are not given start as in the model.

        Args:
            bodies: Indices of bodies.
            initial_states: Their states, shape [N, len(bodies), 13].
            particles_m: Positions of all particles [m], shape [N, particle_count, 3].
            worlds: Which worlds start, shape [N]; the others continue. None is all.
        """
        if worlds is None:
            worlds = np.ones(self.world_count, dtype=np.bool_)
        state, next_state = self.states
        before = {} if worlds.all() else _arrays(self.current_state)
        state.assign(self._first)
        poses = self._first_poses.copy()
        if initial_states is not None:
            poses[:, bodies] = initial_states[:, :, [0, 1, 2, *TO_WARP]]
            velocities = np.zeros((*poses.shape[:2], 6))
            spins = initial_states[:, :, 10:]
            # Newton's linear velocity is that of the centre of mass.
            arms_m = rotated(poses[:, bodies, 3:], self._centres_m[bodies])
            velocities[:, bodies, :3] = initial_states[:, :, 7:10] + np.cross(
                spins, arms_m
            )
            velocities[:, bodies, 3:] = spins
            if poses.size:
                state.body_q.assign(poses.reshape(-1, 7))
                state.body_qd.assign(velocities.reshape(-1, 6))
        if particles_m is not None:
            state.particle_q.assign(particles_m.reshape(-1, 3))
        self._elapsed[worlds] = 0
        self._targets[worlds] = 0.0
        numbers = np.flatnonzero(worlds)[:, None]
        for body, row in self._driven_rows.items():
            self._targets[numbers, row, [0, 1, 2, *TO_WARP]] = poses[worlds, body]
        self._complete(state)
        for name, values in before.items():
            _write(getattr(state, name), values, ~worlds)
        next_state.assign(state)
        mask = wp.array([*worlds, False], dtype=wp.bool, device=self.model.device)
        self.solver.reset(state, world_mask=None if worlds.all() else mask, flags=0)
        self.current = 0

    def _complete(self, state: newton.State) -> None:  # noqa: B027
        """Derive the other arrays of a state from bodies and particles."""

    def drive(self, body: int, targets: FloatArray) -> None:
        """Prescribe a kinematic body from the next step on.

        Args:
            body: Its index.
            targets: As in `Simulation.drive`, shape [N, 19].
        """
        row = self._driven_rows[body]
        self._targets[:, row] = targets
        self._elapsed[:, row] = 0

    def advance(self, seconds: float) -> None:
        """Run the steps of an interval [s]."""
        if self._driven_rows:
            self._device_targets.assign(self._targets.reshape(-1, 19))
            self._device_elapsed.assign(self._elapsed.ravel())
        for reader in self.force_readers:
            reader.clear()
        count = round(seconds / self.timestep_s)
        for _ in range(count):
            self._run_step()
            self.current = 1 - self.current
            for reader in self.force_readers:
                reader.add()
        self._elapsed += count

    def _run_step(self) -> None:
        """Replay the recorded step from the current state."""
        wp.capture_launch(self._graphs[self.current])

    @property
    def current_state(self) -> newton.State:
        """The state that the last step wrote."""
        return self.states[self.current]

    def poses(self) -> FloatArray:
        """Return the poses of all bodies with quaternions x, y, z, w, shape [N, body_count, 7]."""
        return self._copied(self.current_state.body_q, 7)

    def first_particles_m(self) -> FloatArray:
        """Return the positions of all particles in the model [m], shape [N, particle_count, 3]."""
        return self._copied(self._first.particle_q, 3)

    def particles_m(self) -> FloatArray:
        """Return the positions of all particles [m], shape [N, particle_count, 3]."""
        return self._copied(self.current_state.particle_q, 3)

    def _copied(self, array: wp.array | None, columns: int) -> FloatArray:
        values = np.zeros(0) if array is None else array.numpy().astype(np.float64)
        return values.reshape(self.world_count, -1, columns)

    def body_states(self, bodies: Sequence[int]) -> FloatArray:
        """Return the states of bodies, shape [N, len(bodies), 13]."""
        poses = self.poses()[:, bodies]
        velocities = self._copied(self.current_state.body_qd, 6)[:, bodies]
        spins = velocities[:, :, 3:]
        arms_m = rotated(poses[:, :, 3:], self._centres_m[bodies])
        speeds = velocities[:, :, :3] - np.cross(spins, arms_m)
        parts = [poses[:, :, :3], poses[:, :, 6:], poses[:, :, 3:6], speeds, spins]
        return np.concatenate(parts, axis=2)

    def _prescribe(
        self,
        body_q: wp.array,
        body_qd: wp.array,
        *,
        steps_ahead: int = 0,
        counts: bool = True,
    ) -> None:
        """Write poses and velocities of the driven bodies.

        Args:
            body_q: Poses of all bodies.
            body_qd: Velocities of all bodies.
            steps_ahead: 0 for the start of the current step, 1 for its end.
            counts: Whether this is the last call in the step, so that the elapsed time advances by one step.
        """
        if self._driven_rows:
            wp.launch(
                prescribe,
                dim=len(self._driven),
                inputs=[
                    self._driven,
                    self._device_targets,
                    self._device_elapsed,
                    steps_ahead,
                    int(counts),
                    self.timestep_s,
                ],
                outputs=[body_q, body_qd],
                device=self.model.device,
            )
