"""Statistics that `VecNormalize` of Stable-Baselines3 saves, read without running code of the file."""

from __future__ import annotations

import io
import pickle
import pickletools
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import PolicyError
from gauge_envs.files import MEGABYTE, read_regular

MOST_BYTES = 64 * MEGABYTE


MOST_OPERATIONS = 1_000_000
"""Most operations of a file; those of `VecNormalize` have a few hundred."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ObservationStatistics:
    """Mean and variance by which observations were normalized in training.

    Attributes:
        mean: Mean, shape [n].
        variance: Variance, shape [n].
        clip: Largest absolute normalized value.
        epsilon: Number that is added to the variance.
    """

    mean: NDArray[np.float64]
    variance: NDArray[np.float64]
    clip: float
    epsilon: float

    def apply(self, observation: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return a normalized observation, shape [n], with the formula and precision of `VecNormalize`."""
        scaled = (observation - self.mean) / np.sqrt(self.variance + self.epsilon)
        return np.clip(scaled, -self.clip, self.clip).astype(np.float32)


class _Inert:
    """Object that takes any arguments and state, and does nothing with them but keep its attributes."""

    def __init__(self, *_: Any, **__: Any) -> None:
        pass

    def __setstate__(self, state: Any) -> None:
        if isinstance(state, dict):
            vars(self).update({key: value for key, value in state.items() if isinstance(key, str)})


class _Type:
    """Stand-in of `numpy.dtype`: its code, as `f8`, and its byte order."""

    def __init__(self, code: Any, *_: Any) -> None:
        self._code, self._order = str(code), "="

    def __setstate__(self, state: Any) -> None:
        self._order = str(state[1])

    def array(self, data: Any) -> NDArray[Any]:
        """Return the numbers of bytes, shape [n]."""
        is_plain = re.fullmatch("[<>=|](b1|[iu][1248]|f[248])", self._order + self._code)
        if not is_plain or not isinstance(data, bytes | bytearray):
            raise ValueError(f"an array of type {self._order + self._code!r} holds no plain numbers")
        return np.frombuffer(bytes(data), dtype=self._order.replace("|", "=") + self._code)


class _Array:
    """Stand-in of `numpy.ndarray`, which reads its state when asked. Numpy's own takes any state, and may crash."""

    def __init__(self) -> None:
        self._state: Any = ()

    def __setstate__(self, state: Any) -> None:
        self._state = state

    def numbers(self) -> NDArray[np.float64]:
        """Return the numbers."""
        try:
            _, shape, kind, is_fortran, data = self._state
            numbers: NDArray[np.float64] = kind.array(data).astype(np.float64)
            return numbers.reshape(shape, order="F" if is_fortran else "C")
        except (TypeError, AttributeError) as error:
            raise ValueError(f"an array is damaged: {error}") from error


def _from_buffer(data: Any, kind: Any, shape: Any, order: Any) -> _Array:
    array = _Array()
    array.__setstate__((1, shape, kind, order == "F", data))
    return array


CLASSES: dict[tuple[str, str], Any] = {
    ("numpy", "dtype"): _Type,
    **{
        (f"numpy.{core}.{module}", name): made
        for core in ("core", "_core")
        for module, name, made in (
            ("multiarray", "_reconstruct", lambda *_: _Array()),
            ("multiarray", "scalar", lambda kind, data: kind.array(data).item()),
            ("numeric", "_frombuffer", _from_buffer),
        )
    },
}
"""What stands in for the names of a pickle: arrays and numbers. Every other name becomes an empty object."""


class _ArraysOnly(pickle.Unpickler):
    """Unpickler that makes arrays, numbers and texts, and runs no code of other packages."""

    def find_class(self, module: str, name: str) -> Any:
        """Return a stand-in of arrays, or the inert class."""
        return CLASSES.get((module, name), _Inert)


def _check_operations(content: bytes) -> None:
    """Check a pickle before it is loaded: Python takes gigabytes for a place of its memo that a file makes up."""
    for count, (operation, argument, _) in enumerate(pickletools.genops(content)):
        if count > MOST_OPERATIONS:
            raise ValueError(f"it has more than {MOST_OPERATIONS} operations")
        if operation.name.endswith("PUT") and not 0 <= int(str(argument)) <= count:
            raise ValueError("it is damaged")


def read_normalization(file: Path, *, observation_size: int) -> ObservationStatistics | None:
    """Read the statistics of observations from a file of `VecNormalize.save`; None if the training used none.

    The file is a pickle. Only its arrays and numbers are read; no code of it is run.

    Args:
        file: The file.
        observation_size: Size n of the task's observation.
    """
    try:
        content = read_regular(file, MOST_BYTES)
        _check_operations(content)
        saved = _ArraysOnly(io.BytesIO(content)).load()
    except OSError as error:
        raise PolicyError(f"{file}: cannot be read: {error.strerror or error}") from error
    except Exception as error:  # A damaged pickle raises errors of many kinds.
        raise PolicyError(f"{file}: expected a file of VecNormalize.save: {type(error).__name__}: {error}") from error
    values = vars(saved) if isinstance(saved, _Inert) else {}
    if values.get("norm_obs") is False:
        return None
    try:
        statistics = values["obs_rms"]
        found = ObservationStatistics(
            mean=statistics.mean.numbers(),
            variance=statistics.var.numbers(),
            clip=float(values["clip_obs"]),
            epsilon=float(values["epsilon"]),
        )
    except (KeyError, AttributeError, TypeError, ValueError, OverflowError):
        raise PolicyError(
            f"{file}: expected a file of VecNormalize.save with statistics of an array observation"
        ) from None
    if found.mean.shape != (observation_size,) or found.variance.shape != (observation_size,):
        raise PolicyError(
            f"{file}: statistics of an observation of shape {found.mean.shape}, the task has ({observation_size},)"
        )
    scale = found.variance + found.epsilon
    # A comparison with NaN is false.
    if not (np.isfinite(found.mean).all() and np.isfinite(scale).all() and (scale > 0.0).all() and found.clip > 0.0):
        raise PolicyError(f"{file}: expected finite means, and positive variances and clip_obs")
    return found
