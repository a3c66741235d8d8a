"""Stepper of a Newton model: prescribed motion, the recorded step of the solver, and snapshots of the state.

Warp launches each kernel from Python, which costs more than the kernel itself in such small scenes. A step is therefore
recorded once as a graph, on the CPU or a GPU, and replayed. That is 20 to 100 times faster and bitwise identical.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from functools import cache, cached_property
from typing import Any

import newton
import newton._src.geometry.narrow_phase as narrow_phase
import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.backends.newton.kernels import begin_drives, prescribe
from gauge_envs.backends.shared.bundled import replaced
from gauge_envs.backends.shared.rigid import MeanForces
from gauge_envs.errors import BackendError
from gauge_envs.scene import Pose

_shared = {
    name: cache(factory)
    for name, factory in vars(narrow_phase).items()
    if name.startswith("create_narrow_phase_")
}
"""Newton's factories of kernels, which depend on their arguments alone, with one kernel for all pipelines."""

Snapshot = list[NDArray[Any]]


def warp_transform(pose: Pose) -> wp.transform:
    """Return Warp's transform of a pose; Warp's quaternions are x, y, z, w."""
    w, x, y, z = pose.quaternion
    return wp.transform(wp.vec3(*pose.position_m), wp.quat(x, y, z, w))


def collision_pipeline(model: newton.Model, **options: Any) -> newton.CollisionPipeline:
    """Return Newton's collision pipeline of a model.

    Newton makes the kernels of each pipeline anew, and Warp reads the source of each new kernel to find its binary;
    this takes most of the time in which a rigid scene is built.

    Args:
        model: The finalized model.
        **options: Arguments of the pipeline.
    """
    with replaced(narrow_phase, **_shared):
        return newton.CollisionPipeline(model, **options)


class Stepper(ABC):
    """Stepper of one model with one solver.

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
        sent: Drives on the device, shape [driven_count, 20]: rows of `Worlds.drive`, and 1 for those that are new.
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
        self.states = (model.state(), model.state())
        self.control = model.control()
        self._centres_m = (
            model.body_com.numpy() if model.body_count else np.zeros((0, 3))
        )
        count = len(driven)
        self._rows = np.full(model.body_count, -1, dtype=np.intp)
        self._rows[list(driven)] = np.arange(count)
        with wp.ScopedDevice(model.device):
            self._driven = wp.array(list(driven), dtype=wp.int32)
            self.sent = wp.zeros((count, 20), dtype=wp.float32)
            self._elapsed = wp.zeros(count, dtype=wp.int32)
            self._velocity = wp.zeros(count, dtype=wp.spatial_vector)
            self._acceleration = wp.zeros(count, dtype=wp.spatial_vector)
            body_q = model.body_q.numpy() if model.body_count else np.zeros((0, 7))
            self._start = wp.array(
                body_q[list(driven)].reshape(count, 7), dtype=wp.transform
            )
        # The next `advance` sends all collected drives to the device in one copy: rows of `Worlds.drive`, and 1 in a
        # last column for those that are new.
        self._drives = np.zeros((count, 20), dtype=np.float32)
        self.current = 0
        self.force_readers: list[MeanForces] = []
        self._graphs: list[Any] = []
        self._first: Snapshot = []

    @abstractmethod
    def _step(self, state: newton.State, after: newton.State) -> None:
        """Move the driven bodies and step from one state to the other; `record` records this method."""

    def record(self) -> None:
        """Record the step in both directions between the two states, then return to the start."""
        states = self.states
        first = {id(array): array.numpy().copy() for array in self._arrays()}
        # Solvers allocate their arrays in the first step.
        self._step(*states)
        for state, after in (states, states[::-1]):
            with wp.ScopedCapture(device=self.model.device) as capture:
                self._step(state, after)
            self._graphs.append(capture.graph)
        # Arrays that the solver allocated during the warm-up are zero at the start.
        self._first = [
            first.get(id(array), np.zeros_like(array.numpy()))
            for array in self._arrays()
        ]
        self.reset()
        # The start stays on the device: 4096 worlds of a sliding cube have 55 MB, which a reset need not send.
        self._first = [wp.clone(array) for array in self._arrays()]

    def reset(self) -> None:
        """Return to the start."""
        self._restore_arrays(self._first)
        self._drives[:, -1] = 0.0
        self.current = 0

    def restart(self, world: int, world_count: int) -> None:
        """Return one of several equal worlds to its start.

        The arrays of a model hold the worlds one after another. Those of contacts mix them, and are written anew in
        each step before they are read.

        Args:
            world: Number of the world.
            world_count: Number of worlds in the model.
        """
        for array, first in zip(self._arrays(), self._first, strict=True):
            size, rest = divmod(len(first), world_count)
            if size and not rest:
                count = array.size // world_count
                offset = world * count
                wp.copy(array, first, offset, offset, count)

    def drive(self, bodies: NDArray[np.intp], motions: NDArray[np.float64]) -> None:
        """Prescribe kinematic bodies from the next step on.

        Args:
            bodies: Their indices in the model.
            motions: Their motions in the model's coordinates; see `Worlds.drive`.
        """
        rows = self.rows_of(bodies)
        if (rows < 0).any():
            raise KeyError(f"body {bodies[rows < 0][0]} of the model is not driven")
        self._drives[rows, :-1] = motions
        self._drives[rows, -1] = 1.0

    def rows_of(self, bodies: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the rows of bodies in `sent`; -1 for those that are not driven."""
        return self._rows[bodies]

    def apply_wrench(self, body: int, wrench: NDArray[np.float64]) -> None:
        """Apply a force and a torque to a body from the next step on; see `World.apply_wrench`."""
        raise BackendError(
            f"{type(self.solver).__name__} applies no force or torque here: choose a preset with SolverMuJoCo"
        )

    def advance(self, seconds: float) -> None:
        """Replay the recorded step."""
        self._send_drives()
        for reader in self.force_readers:
            reader.clear()
        for _ in range(round(seconds / self.timestep_s)):
            wp.capture_launch(self._graphs[self.current])
            self.current = 1 - self.current
            for reader in self.force_readers:
                reader.add()

    def _send_drives(self) -> None:
        """Copy the collected drives to the device, if there are any."""
        if not self._drives[:, -1].any():
            return
        self.sent.assign(self._drives)
        self.begin_drives()
        self._drives[:, -1] = 0.0

    def begin_drives(self) -> None:
        """Begin the drives that `sent` marks as new."""
        wp.launch(
            begin_drives,
            dim=len(self._drives),
            inputs=[self.sent],
            outputs=[self._start, self._velocity, self._acceleration, self._elapsed],
            device=self.model.device,
        )

    @property
    def now(self) -> newton.State:
        """The state that the last step wrote."""
        return self.states[self.current]

    def body_states(
        self, bodies: Sequence[int] | NDArray[np.intp]
    ) -> NDArray[np.float64]:
        """Return poses and velocities of bodies by index, shape [len(bodies), 13]; see `World.body_states`."""
        poses = self.now.body_q.numpy()[bodies].astype(np.float64)
        velocities = self.now.body_qd.numpy()[bodies].astype(np.float64)
        # Newton's linear velocity is that of the centre of mass.
        arms = Rotation.from_quat(poses[:, 3:]).apply(self._centres_m[bodies])
        linear = velocities[:, :3] - np.cross(velocities[:, 3:], arms)
        return np.column_stack(
            [poses[:, :3], poses[:, 6], poses[:, 3:6], linear, velocities[:, 3:]]
        )

    def body_positions(
        self, bodies: Sequence[int] | NDArray[np.intp]
    ) -> NDArray[np.float64]:
        """Return positions of body origins by index [m], shape [len(bodies), 3]."""
        return self.now.body_q.numpy()[bodies, :3].astype(np.float64)

    def state(self) -> tuple[int, NDArray[np.float32], Snapshot]:
        """Return a snapshot for `restore`."""
        arrays = [array.numpy().copy() for array in self._arrays()]
        return self.current, self._drives.copy(), arrays

    def restore(self, state: tuple[int, NDArray[np.float32], Snapshot]) -> None:
        """Restore a snapshot that `state` returned."""
        self.current, self._drives[:], snapshot = state
        self._restore_arrays(snapshot)

    # --- snapshots ---

    def _arrays(self) -> list[wp.array]:
        """Return every array that a step may change: those of both states, of the solver and of the drives."""
        found: dict[int, wp.array] = {}
        for root in (*self.states, self.solver):
            found |= {id(array): array for array in _arrays_in(root, depth=3)}
        return [
            *found.values(),
            self._elapsed,
            self._start,
            self._velocity,
            self._acceleration,
        ]

    def _restore_arrays(self, snapshot: Snapshot) -> None:
        for array, values in zip(self._arrays(), snapshot, strict=True):
            array.assign(values)

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
        if len(self._driven):
            wp.launch(
                prescribe,
                dim=len(self._driven),
                inputs=[
                    self._driven,
                    self._start,
                    self._velocity,
                    self._acceleration,
                    self._elapsed,
                    steps_ahead,
                    int(counts),
                    self.timestep_s,
                ],
                outputs=[body_q, body_qd],
                device=self.model.device,
            )


class HostState:
    """A state whose arrays are copied from the device once, whoever reads them."""

    def __init__(self, state: newton.State) -> None:
        self._state = state

    @cached_property
    def particle_q(self) -> HostArray:
        """Positions of the particles."""
        return HostArray(self._state.particle_q.numpy())

    @cached_property
    def body_q(self) -> HostArray:
        """Poses of the rigid bodies."""
        return HostArray(self._state.body_q.numpy())


class HostArray:
    """An array with the method of Warp's arrays that copies them.

    Args:
        values: The values on the host, which nobody changes.
    """

    def __init__(self, values: NDArray[Any]) -> None:
        self._values = values

    def numpy(self) -> NDArray[Any]:
        """Return the values."""
        return self._values


def _arrays_in(root: Any, *, depth: int) -> Iterator[wp.array]:
    """Yield the Warp arrays among the attributes of an object and of its attributes, down to a depth."""
    for value in vars(root).values():
        for entry in value if isinstance(value, list | tuple) else (value,):
            if isinstance(entry, wp.array):
                if entry.size and entry.is_contiguous:
                    yield entry
            elif (
                depth
                and hasattr(entry, "__dict__")
                and not isinstance(entry, newton.Model | type)
            ):
                yield from _arrays_in(entry, depth=depth - 1)
