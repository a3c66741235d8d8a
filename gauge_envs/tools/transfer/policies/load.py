"""Load a policy by its file or its place in a module, and check that it fits a task."""

import importlib
import pickle
import subprocess
import sys
import weakref
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import Env, spaces
from numpy.typing import NDArray

from gauge_envs.errors import MissingExtraError, PolicyError
from gauge_envs.files import (
    CHILD_MEMORY,
    MEGABYTE,
    child_command,
    os_errors,
    read_regular,
)
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.control import Policy
from gauge_envs.tools.transfer.policies import onnx_child
from gauge_envs.tools.transfer.policies.sb3 import MOST_BYTES, load_sb3

MOST_ONNX_BYTES = 512 * MEGABYTE

MOST_ONNX_CPU_S = 86400
"""Limit of the processor time of all actions of an ONNX policy [s]."""


def load_policies(
    sources: Sequence[str],
    env: Env[Any, Any],
    *,
    normalization: Sequence[Path] = (),
    trust: bool = False,
) -> dict[str, Policy]:
    """Return policies by their sources, in order; each is checked with the task.

    Args:
        sources: One or more sources, see `load_policy`.
        env: The task, without wrappers.
        normalization: No file of statistics, one for all policies, or one for each.
        trust: Whether loading may run code of the files.
    """
    if len({*sources}) < len(sources):
        raise PolicyError(f"a policy is given twice: {', '.join(sources)}")
    files: list[Path | None] = [*normalization] or [None]
    if len(files) == 1:
        files *= len(sources)
    if len(files) != len(sources):
        raise PolicyError(
            f"{len(files)} files of statistics for {len(sources)} policies: give one for all, or one for each"
        )
    return {
        source: load_policy(source, env, normalization=file, trust=trust)
        for source, file in zip(sources, files, strict=True)
    }


def load_policy(
    source: str,
    env: Env[Any, Any],
    *,
    normalization: Path | None = None,
    trust: bool = False,
) -> Policy:
    """Return a policy that fits a task.

    Args:
        source: A Stable-Baselines3 file (`.zip`), an ONNX file (`.onnx`), or `module:function`, where the function
            takes an observation and returns an action.
        env: The task, without wrappers.
        normalization: File of `VecNormalize.save` beside the policy, or None.
        trust: Whether loading may run code: of a module, of the pickle in a file of `VecNormalize`, or of those in a
            Stable-Baselines3 file whose network cannot be built from its weights.
    """
    spaces_of_env = (env.observation_space, env.action_space)
    if any(
        not isinstance(one, spaces.Box) or len(one.shape) != 1 for one in spaces_of_env
    ):
        raise PolicyError(
            f"{source}: the environment has {env.observation_space} and {env.action_space}: a policy takes one vector "
            "and returns one. Wrap it, as with gymnasium.wrappers.FlattenObservation"
        )
    observation_size, action_size = (
        int((one.shape or (0,))[0]) for one in spaces_of_env
    )
    suffix = Path(source).suffix.lower()
    if suffix == ".zip":
        policy = load_sb3(
            Path(source),
            observation_size=observation_size,
            action_size=action_size,
            trust=trust,
        )
    elif suffix == ".onnx":
        policy = _onnx(Path(source), observation_size=observation_size)
    elif ":" in source:
        policy = _function(source, trust=trust)
    else:
        raise PolicyError(
            f"{source}: expected a .zip of Stable-Baselines3, a .onnx, or module:function"
        )
    if normalization is None:
        return checked_policy(source, policy, env)
    normalize = _normalization(
        normalization, observation_size=observation_size, trust=trust
    )
    return checked_policy(
        source, lambda observation: policy(normalize(observation)), env
    )


def _function(source: str, *, trust: bool) -> Policy:
    """Return a function of a module; the folder of the command is searched too."""
    if not trust:
        raise PolicyError(
            f"{source}: importing a module runs its code: add --trust (trust=True) if you trust it"
        )
    name, _, attribute = source.partition(":")
    if "" not in sys.path:
        sys.path.insert(0, "")
    try:
        return getattr(importlib.import_module(name), attribute)
    except (
        Exception,
        SystemExit,
    ) as error:  # A module may raise anything, and may be a script.
        raise PolicyError(
            f"{source}: the import raised {type(error).__name__}: {error}"
        ) from error


def _normalization(
    file: Path, *, observation_size: int, trust: bool
) -> Callable[[FloatArray], FloatArray]:
    """Return the function that normalizes observations as in the training; the file is a pickle of `VecNormalize`."""
    if not trust:
        raise PolicyError(
            f"{file}: a file of VecNormalize is a pickle, and loading it runs its code: add --trust (trust=True) if "
            "you trust its author, or save policy and normalization as one ONNX network"
        )
    if find_spec("stable_baselines3") is None:
        raise MissingExtraError(
            "a file of VecNormalize",
            "rl",
            ModuleNotFoundError(name="stable_baselines3"),
        )
    try:
        saved = pickle.loads(read_regular(file, MOST_BYTES))
        shape = saved.observation_space.shape
    except OSError as error:
        raise PolicyError(
            f"{file}: cannot be read: {error.strerror or error}"
        ) from error
    except Exception as error:  # A damaged pickle raises errors of many kinds.
        raise PolicyError(
            f"{file}: expected a file of VecNormalize.save: {type(error).__name__}: {error}"
        ) from error
    if shape != (observation_size,):
        raise PolicyError(
            f"{file}: statistics of an observation of shape {shape}, the task has ({observation_size},)"
        )
    return saved.normalize_obs


def _onnx(file: Path, *, observation_size: int) -> Policy:
    """Return the policy of an ONNX file: one input of shape [1, n] or [n]; the first output is the action.

    The network runs in another process, which has limits of memory, and of time for each action.
    """
    if find_spec("onnxruntime") is None:
        raise MissingExtraError(
            "an ONNX policy", "onnx", ModuleNotFoundError(name="onnxruntime")
        )
    with os_errors(lambda cause: PolicyError(f"{file}: cannot be read: {cause}")):
        content = read_regular(file, MOST_ONNX_BYTES)
    command, environment = child_command(
        Path(onnx_child.__file__), str(observation_size), cpu_s=MOST_ONNX_CPU_S
    )
    child = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=environment,
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


def checked_policy(name: str, policy: Policy, env: Env[Any, Any]) -> Policy:
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
        except (
            Exception,
            SystemExit,
        ) as error:  # A policy of a stranger may raise anything.
            raise PolicyError(
                f"{name}: the policy raised {type(error).__name__}: {error}"
            ) from error
        if action.size != int(np.prod(space.shape)):
            raise PolicyError(
                f"{name}: the action has shape {action.shape}, the task takes {space.shape}"
            )
        if not np.isfinite(action).all():
            raise PolicyError(
                f"{name}: the action is {action.ravel().tolist()}, expected finite numbers"
            )
        return np.clip(action.reshape(space.shape), space.low, space.high)

    act(np.zeros(env.observation_space.shape or ()))
    return act
