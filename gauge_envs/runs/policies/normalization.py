"""Statistics that `VecNormalize` of Stable-Baselines3 saves, read without running code of the file."""

from __future__ import annotations

import io
import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import PolicyError
from gauge_envs.files import MEGABYTE, read_regular

__all__ = ["ObservationStatistics", "UnchangedObservations", "read_normalization"]

MOST_BYTES = 64 * MEGABYTE

ARRAYS = {("numpy", "ndarray"), ("numpy", "dtype")} | {
    (f"numpy.{core}.{module}", name)
    for core in ("core", "_core")
    for module, name in (("multiarray", "_reconstruct"), ("multiarray", "scalar"), ("numeric", "_frombuffer"))
}
"""Names that a pickle may use: arrays and numbers. Every other name becomes an empty object, whose code is not run."""


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


class _ArraysOnly(pickle.Unpickler):
    """Unpickler that makes arrays, numbers and texts; objects of all other classes are inert."""

    def find_class(self, module: str, name: str) -> Any:
        """Return a constructor of arrays, or the inert class."""
        return super().find_class(module, name) if (module, name) in ARRAYS else _Inert


class UnchangedObservations:
    """Statistics of a training that did not normalize observations."""

    def apply(self, observation: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the observation."""
        return observation


def read_normalization(file: Path, *, observation_size: int) -> ObservationStatistics | UnchangedObservations:
    """Read the statistics of observations from a file that `VecNormalize.save` wrote.

    The file is a pickle. Only its arrays and numbers are read; no code of it is run.

    Args:
        file: The file.
        observation_size: Size n of the task's observation.

    Raises:
        PolicyError: The file cannot be read, holds no statistics of observations, or those of another size.
    """
    try:
        saved = _ArraysOnly(io.BytesIO(read_regular(file, MOST_BYTES))).load()
    except OSError as error:
        raise PolicyError(f"{file}: cannot be read: {error.strerror or error}") from error
    except Exception as error:  # A damaged pickle raises errors of many kinds.
        raise PolicyError(f"{file}: expected a file of VecNormalize.save: {type(error).__name__}: {error}") from error
    values = vars(saved) if isinstance(saved, _Inert) else {}
    if values.get("norm_obs") is False:
        return UnchangedObservations()
    try:
        statistics = values["obs_rms"]
        found = ObservationStatistics(
            mean=np.asarray(statistics.mean, dtype=np.float64),
            variance=np.asarray(statistics.var, dtype=np.float64),
            clip=float(values["clip_obs"]),
            epsilon=float(values["epsilon"]),
        )
    except (KeyError, AttributeError, TypeError, ValueError):
        raise PolicyError(
            f"{file}: expected a file of VecNormalize.save with statistics of an array observation"
        ) from None
    if found.mean.shape != (observation_size,) or found.variance.shape != (observation_size,):
        raise PolicyError(
            f"{file}: statistics of an observation of shape {found.mean.shape}, the task has ({observation_size},)"
        )
    return found
