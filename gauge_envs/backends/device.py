"""Worlds in arrays of a device, which learners drive and read without a copy to the host."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import BackendError


class DeviceWorlds(ABC):
    """Worlds of rigid bodies that are driven, read and restarted in arrays of one library on one device.

    The first axis of every array is the world. An engine may use 32-bit floats. Its arrays have Python's operators,
    indices, `reshape`, `all` and `sum`, as those of NumPy, PyTorch, JAX and CuPy have.

    Attributes:
        arrays: Module of the library's functions, such as `torch` or `jax.numpy`. Environments use `abs`, `atan2`,
            `broadcast_to`, `clip`, `concat`, `cos`, `einsum`, `isfinite`, `matmul`, `sin`, `sqrt`, `square`, `stack`,
            `where` and `zeros_like`.
        name: Name of the device, as `cuda:0`.
    """

    arrays: Any
    name: str

    @abstractmethod
    def asarray(self, values: Any) -> Any:
        """Return values as an array of the device; numbers that are not whole get the engine's precision.

        Args:
            values: A NumPy array, which is copied; or an array of any library that follows the DLPack protocol, which
                is copied only if it lies elsewhere or has another precision.
        """

    @abstractmethod
    def begin(self, states: Any | None) -> None:
        """Return all worlds to time 0, as after a fresh build.

        Args:
            states: States of the scene's dynamic bodies, in its order, shape [world_count, body_count, 13]; see
                `World.body_states`. None is the start of each world's scene.
        """

    def drive(self, body: str, motions: Any) -> None:
        """Prescribe the motion of a kinematic body in all worlds, shape [world_count, 19]; see `Worlds.drive`.

        Raises:
            BackendError: The engine drives no body here.
        """
        raise BackendError(f"{type(self).__name__} drives no body")

    @abstractmethod
    def advance(self, seconds: float) -> None:
        """Simulate an interval in all worlds, a multiple of 1/180 s. It need not wait for the device."""

    @abstractmethod
    def body_states(self, names: Sequence[str]) -> Any:
        """Return poses and velocities in a new array, shape [world_count, len(names), 13]; see `World.body_states`."""

    def copied(self, array: Any) -> NDArray[Any]:
        """Return an array on the host, for learners; no environment calls it."""
        return np.asarray(array)


class HostArrays:
    """The device of `DeviceWorlds` that NumPy has: what computes on devices computes on the host with it."""

    arrays = np

    @staticmethod
    def asarray(values: Any) -> NDArray[Any]:
        """Return the values."""
        return np.asarray(values)


HOST = HostArrays()
