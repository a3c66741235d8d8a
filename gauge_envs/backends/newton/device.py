"""Newton's worlds as tensors of PyTorch, which share the memory of the Warp arrays of the model's device."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gauge_envs.backends.device import DeviceWorlds
from gauge_envs.backends.newton.kernels import bodies_to_joints
from gauge_envs.backends.newton.model import WorldLayout
from gauge_envs.backends.newton.mujoco_stepper import StepperMuJoCo
from gauge_envs.errors import UnsupportedSceneError, needs_extra
from gauge_envs.scene import Scene


class NewtonOnDevice(DeviceWorlds):
    """Worlds of one Newton model in PyTorch, in single precision.

    Args:
        scene: Scene of a world.
        stepper: Stepper of the model.
        layouts: Layout of each world.
        bodies: Indices in the model of each moving body, over the worlds, by its name.

    Raises:
        UnsupportedSceneError: Dynamic bodies have joints, whose coordinates the solver would need at a new start.
    """

    def __init__(
        self,
        scene: Scene,
        stepper: StepperMuJoCo,
        layouts: Sequence[WorldLayout],
        bodies: Mapping[str, NDArray[np.intp]],
    ) -> None:
        with needs_extra("mode='device'", "rl"):
            import torch

        self.arrays = self._torch = torch
        self._stepper = stepper
        self.name = str(stepper.model.device)
        self._is_jointed = bool(scene.joints)
        # PyTorch counts by its current stream, which Warp must use too.
        self._device = wp.device_to_torch(stepper.model.device)
        self._bodies = {name: self.asarray(index) for name, index in bodies.items()}
        self._dynamic = self._indices([body.name for body in scene.dynamic_bodies])
        self._states = [
            (wp.to_torch(state.body_q), wp.to_torch(state.body_qd))
            for state in stepper.states
        ]
        self._centres_m = wp.to_torch(stepper.model.body_com)
        self._origins_m = self.asarray(np.array([one.origin_m for one in layouts]))
        self._sent = wp.to_torch(stepper.sent)
        # An index in NumPy would be copied to the device at each use.
        self._rows = {
            name: self.asarray(stepper.rows_of(index)) for name, index in bodies.items()
        }
        self._marks = self.asarray(np.ones((len(layouts), 1)))
        self._has_drives = False
        joints = stepper.free_joints([*self._dynamic.reshape(-1).tolist()])
        self._joints = [
            wp.array(one, dtype=wp.int32, device=self.name) for one in joints
        ]

    def _indices(self, names: Sequence[str]) -> Any:
        return self._torch.stack([self._bodies[name] for name in names], axis=1)

    def asarray(self, values: Any) -> Any:
        """Return values as a tensor; those that are not whole numbers are single."""
        torch = self._torch
        if not isinstance(values, np.ndarray | torch.Tensor):
            values = torch.from_dlpack(values)
        tensor = torch.as_tensor(
            np.array(values) if isinstance(values, np.ndarray) else values
        )
        if tensor.is_floating_point():
            tensor = tensor.to(torch.float32)
        return tensor.to(self._device)

    def copied(self, array: Any) -> NDArray[Any]:
        """Return a tensor on the host."""
        return np.asarray(array.cpu())

    def begin(self, states: Any | None) -> None:
        """Return all worlds to their starts, or to other states."""
        with self._in_stream():
            self._stepper.reset()
            self._has_drives = False
            if states is None:
                return
            if self._is_jointed:
                raise UnsupportedSceneError(
                    "Newton restarts no body on a joint elsewhere in mode='device': leave out the jitter"
                )
            q, qd = self._newton_states(self.asarray(states))
            for number, state in enumerate(self._stepper.states):
                for values, given in zip(self._states[number], (q, qd), strict=True):
                    values[self._dynamic] = given
                wp.launch(
                    bodies_to_joints,
                    dim=len(self._joints[0]),
                    inputs=[*self._joints, state.body_q, state.body_qd],
                    outputs=[state.joint_q, state.joint_qd],
                    device=self.name,
                )

    def _newton_states(self, states: Any) -> tuple[Any, Any]:
        """Return poses with quaternions x y z w and velocities of the centres of mass; see `World.body_states`."""
        concat = self._torch.concat
        places = states[:, :, :3] - self._origins_m[:, None]
        quaternions = concat([states[:, :, 4:7], states[:, :, 3:4]], axis=2)
        arms = self._turned(quaternions, self._centres_m[self._dynamic])
        spins = states[:, :, 10:]
        speeds = states[:, :, 7:10] + self._torch.linalg.cross(spins, arms)
        return concat([places, quaternions], axis=2), concat([speeds, spins], axis=2)

    def _turned(self, quaternions: Any, vectors: Any) -> Any:
        """Return vectors turned by quaternions x y z w, shape [world_count, body_count, 3]."""
        cross = self._torch.linalg.cross
        axis = quaternions[:, :, :3]
        twice = 2.0 * cross(axis, vectors)
        return vectors + quaternions[:, :, 3:] * twice + cross(axis, twice)

    def drive(self, body: str, motions: Any) -> None:
        """Prescribe a kinematic body in all worlds."""
        places = motions[:, :3] - self._origins_m
        sent = self._torch.concat([places, motions[:, 3:], self._marks], axis=1)
        self._sent[self._rows[body]] = sent
        self._has_drives = True

    def advance(self, seconds: float) -> None:
        """Step the model."""
        with self._in_stream():
            if self._has_drives:
                self._stepper.begin_drives()
                self._sent[:, 19] = 0.0
                self._has_drives = False
            self._stepper.advance(seconds)

    def body_states(self, names: Sequence[str]) -> Any:
        """Return poses and velocities of moving bodies, shape [world_count, len(names), 13]."""
        index = self._indices(names)
        poses, velocities = (one[index] for one in self._states[self._stepper.current])
        arms = self._turned(poses[:, :, 3:], self._centres_m[index])
        spins = velocities[:, :, 3:]
        speeds = velocities[:, :, :3] - self._torch.linalg.cross(spins, arms)
        places = poses[:, :, :3] + self._origins_m[:, None]
        parts = [places, poses[:, :, 6:], poses[:, :, 3:6], speeds, spins]
        return self._torch.concat(parts, axis=2)

    @contextmanager
    def _in_stream(self) -> Iterator[None]:
        """Let Warp work in PyTorch's stream, so that each waits for the other."""
        if not self._stepper.model.device.is_cuda:
            yield
            return
        stream = self._torch.cuda.current_stream(self._device)
        with wp.ScopedStream(wp.stream_from_torch(stream)):
            yield
