"""Policies in ONNX files, which hold a network and no code."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.envs.control.play import Policy
from gauge_envs.errors import MissingExtraError, PolicyError
from gauge_envs.files import MEGABYTE, child_refusal, read_regular

MOST_BYTES = 512 * MEGABYTE

NUMBERS = {"tensor(float)": np.float32, "tensor(double)": np.float64}
"""Types of the input that a policy may have."""


def load_onnx(file: Path, *, observation_size: int) -> Policy:
    """Return the policy of an ONNX file: one input of shape [1, n] or [n]; the first output is the action.

    The network is loaded and run in another process first, which has limits of memory and time.

    Args:
        file: The file.
        observation_size: Size n of the task's observation.
    """
    try:
        import onnxruntime
    except ImportError as error:
        raise MissingExtraError("an ONNX policy", "onnx", error) from error
    try:
        content = read_regular(file, MOST_BYTES)
    except OSError as error:
        raise PolicyError(f"{file}: cannot be read: {error.strerror or error}") from error
    refusal = child_refusal(Path(__file__).with_name("onnx_probe.py"), str(observation_size), content=content)
    if refusal is not None:
        raise PolicyError(f"{file}: {refusal}")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # The runtime has a class of its own for each kind of damage.
        raise PolicyError(f"{file}: it is no network that onnxruntime can load: {str(error)[:200]}") from error
    inputs = session.get_inputs()
    if len(inputs) != 1:
        names = ", ".join(one.name for one in inputs)
        raise PolicyError(f"{file}: the network has the inputs {names}, expected one, the observation")
    entry = inputs[0]
    if entry.type not in NUMBERS:
        raise PolicyError(f"{file}: input {entry.name!r} has the type {entry.type}, expected {' or '.join(NUMBERS)}")
    shape = _shape(entry.shape, observation_size)
    if shape is None:
        raise PolicyError(
            f"{file}: input {entry.name!r} has shape {entry.shape}, "
            f"the task's observation has {observation_size} entries"
        )
    number, first = NUMBERS[entry.type], session.get_outputs()[0].name

    def act(observation: NDArray[np.float64]) -> NDArray[np.floating]:
        fed = np.asarray(observation, dtype=number).reshape(shape)
        return np.asarray(session.run([first], {entry.name: fed})[0])

    return act


def _shape(stated: list[Any], size: int) -> tuple[int, ...] | None:
    """Return the shape of an input for one observation, or None if the observation does not fit."""
    # A free dimension has a name or None.
    if not 1 <= len(stated) <= 2 or (isinstance(stated[-1], int) and stated[-1] != size):
        return None
    if len(stated) == 2 and isinstance(stated[0], int) and stated[0] != 1:
        return None
    return (1, size)[-len(stated) :]
