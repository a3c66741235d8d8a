"""Load a policy by its file or its place in a module, and check that it fits a task.

Statistics that `VecNormalize` of Stable-Baselines3 saves are read without running code of the file.
"""

import importlib
import io
import pickle
import pickletools
import re
import subprocess
import sys
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from gauge_envs.errors import MissingExtraError, PolicyError
from gauge_envs.files import CHILD_MEMORY, MEGABYTE, child_command, os_errors, read_regular
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.control import ControlEnv, Policy
from gauge_envs.tools.transfer.policies import onnx_child
from gauge_envs.tools.transfer.policies.sb3 import load_sb3

MOST_ONNX_BYTES = 512 * MEGABYTE

MOST_ONNX_CPU_S = 86400
"""Limit of the processor time of all actions of an ONNX policy [s]."""


def load_policies(
    sources: Sequence[str], env: ControlEnv, *, normalization: Sequence[Path] = (), trust: bool = False
) -> dict[str, Policy]:
    """Return policies by their sources, in order; each is checked with the task.

    Args:
        sources: One or more sources, see `load_policy`.
        env: The task, without wrappers.
        normalization: No file of statistics, one for all policies, or one for each.
        trust: Whether loading may run code of the files.
    """
    if not sources:
        raise PolicyError("give one policy or more")
    if len({*sources}) < len(sources):
        raise PolicyError(f"a policy is given twice: {', '.join(sources)}")
    if len(normalization) not in (0, 1, len(sources)):
        raise PolicyError(
            f"{len(normalization)} files of statistics for {len(sources)} policies: give one for all, or one for each"
        )
    files: list[Path | None] = [*normalization] if len(normalization) > 1 else [*normalization, None][:1] * len(sources)
    return {
        source: load_policy(source, env, normalization=file, trust=trust)
        for source, file in zip(sources, files, strict=True)
    }


def load_policy(source: str, env: ControlEnv, *, normalization: Path | None = None, trust: bool = False) -> Policy:
    """Return a policy that fits a task.

    Args:
        source: A Stable-Baselines3 file (`.zip`), an ONNX file (`.onnx`), or `module:function`, where the function
            takes an observation and returns an action.
        env: The task, without wrappers.
        normalization: Statistics of `VecNormalize` beside the policy, or None.
        trust: Whether loading may run code: of a module, or of the pickles in a Stable-Baselines3 file whose network
            cannot be built from its weights.
    """
    shape = env.observation_space.shape or ()
    actions = int(np.prod(env.action_space.shape or ()))
    suffix = Path(source).suffix.lower()
    if suffix == ".zip":
        policy = load_sb3(Path(source), observation_size=shape[0], action_size=actions, trust=trust)
    elif suffix == ".onnx":
        policy = _onnx(Path(source), observation_size=shape[0])
    elif ":" in source:
        policy = _function(source, trust=trust)
    else:
        raise PolicyError(f"{source}: expected a .zip of Stable-Baselines3, a .onnx, or module:function")
    statistics = None if normalization is None else read_normalization(normalization, observation_size=shape[0])
    if statistics is None:
        return checked_policy(source, policy, env)
    return checked_policy(source, lambda observation: policy(np.asarray(statistics.apply(observation))), env)


def _function(source: str, *, trust: bool) -> Policy:
    """Return a function of a module; the folder of the command is searched too."""
    if not trust:
        raise PolicyError(f"{source}: importing a module runs its code: add --trust (trust=True) if you trust it")
    name, _, attribute = source.partition(":")
    if "" not in sys.path:
        sys.path.insert(0, "")
    try:
        module = importlib.import_module(name)
    except ImportError as error:
        raise PolicyError(f"{source}: the module cannot be imported: {error}") from error
    except (Exception, SystemExit) as error:  # A module of a user may raise anything, and may be a script.
        raise PolicyError(f"{source}: importing the module raised {type(error).__name__}: {error}") from error
    try:
        found = getattr(module, attribute)
    except AttributeError:
        raise PolicyError(f"{source}: module {name!r} has no {attribute!r}") from None
    except Exception as error:
        raise PolicyError(f"{source}: reading {attribute!r} raised {type(error).__name__}: {error}") from error
    if not callable(found):
        raise PolicyError(f"{source}: it is a {type(found).__name__}, expected a function of an observation")
    return found


def _onnx(file: Path, *, observation_size: int) -> Policy:
    """Return the policy of an ONNX file: one input of shape [1, n] or [n]; the first output is the action.

    The network runs in another process, which has limits of memory, and of time for each action.
    """
    if find_spec("onnxruntime") is None:
        raise MissingExtraError("an ONNX policy", "onnx", ModuleNotFoundError(name="onnxruntime"))
    with os_errors(lambda cause: PolicyError(f"{file}: cannot be read: {cause}")):
        content = read_regular(file, MOST_ONNX_BYTES)
    command, environment = child_command(Path(onnx_child.__file__), str(observation_size), cpu_s=MOST_ONNX_CPU_S)
    child = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment
    )

    def ask(message: bytes) -> FloatArray:
        try:
            onnx_child.write_message(child.stdin, message)
            answer = onnx_child.read_message(child.stdout)
        except OSError:  # The process has ended.
            answer = None
        if answer is None:
            raise PolicyError(
                f"{file}: the network needs more than {onnx_child.ACTION_CPU_S} s of processor time for an action or "
                f"{CHILD_MEMORY // MEGABYTE} MB of memory, or the runtime crashes on it"
            )
        if not answer.startswith(b"+"):
            raise PolicyError(f"{file}: {answer[1:].decode(errors='replace')}")
        return np.frombuffer(answer[1:])

    def act(observation: FloatArray) -> FloatArray:
        return ask(np.asarray(observation, dtype=np.float64).tobytes())

    weakref.finalize(act, child.kill)
    ask(content)
    return act


def checked_policy(name: str, policy: Policy, env: ControlEnv) -> Policy:
    """Return a policy whose actions are checked and clipped to the task's action space.

    It is called once, with an observation of zeros.

    Args:
        name: Name of the policy in messages.
        policy: Function that returns an action for an observation of shape [n].
        env: The task, without wrappers.
    """
    space = env.action_space
    assert isinstance(space, spaces.Box)

    def act(observation: FloatArray) -> NDArray[np.float32]:
        try:
            action = np.asarray(policy(observation), dtype=np.float32)
        except PolicyError:
            raise
        except (Exception, SystemExit) as error:  # A policy of a stranger may raise anything.
            raise PolicyError(f"{name}: the policy raised {type(error).__name__}: {error}") from error
        if action.size != int(np.prod(space.shape)):
            raise PolicyError(f"{name}: the action has shape {action.shape}, the task takes {space.shape}")
        if not np.isfinite(action).all():
            raise PolicyError(f"{name}: the action is {action.ravel().tolist()}, expected finite numbers")
        return np.clip(action.reshape(space.shape), space.low, space.high)

    act(np.zeros(env.observation_space.shape or ()))
    return act


# --- normalization ---------------------------------------------------------------------------------------------------

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

    mean: FloatArray
    variance: FloatArray
    clip: float
    epsilon: float

    def apply(self, observation: FloatArray) -> NDArray[np.float32]:
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

    def __init__(self, state: Any = ()) -> None:
        self._state = state

    def __setstate__(self, state: Any) -> None:
        self._state = state

    def numbers(self) -> FloatArray:
        """Return the numbers."""
        try:
            _, shape, kind, is_fortran, data = self._state
            numbers: FloatArray = kind.array(data).astype(np.float64)
            return numbers.reshape(shape, order="F" if is_fortran else "C")
        except (TypeError, AttributeError) as error:
            raise ValueError(f"an array is damaged: {error}") from error


CLASSES: dict[tuple[str, str], Any] = {
    ("numpy", "dtype"): _Type,
    **{
        (f"numpy.{core}.{module}", name): made
        for core in ("core", "_core")
        for module, name, made in (
            ("multiarray", "_reconstruct", lambda *_: _Array()),
            ("multiarray", "scalar", lambda kind, data: kind.array(data).item()),
            ("numeric", "_frombuffer", lambda data, kind, shape, order: _Array((1, shape, kind, order == "F", data))),
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
