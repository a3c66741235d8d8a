"""Trained policies in the package: PPO on two tasks, by `examples/train_control.py` with seed 0 and 60,000 steps."""

from __future__ import annotations

from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import UnknownNameError
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.control.env import Policy

LAYERS = 3
"""Layers of the network; the last has no hyperbolic tangent."""


def stored_policy(task: str) -> Policy:
    """Return a trained policy: a perceptron with the mean action and scaled observations.

    Args:
        task: Id without `GAUGE/`, as `Throw-Limit-rubber`.

    Raises:
        UnknownNameError: The package has no policy of the task.
    """
    stored = {
        file.name.removesuffix(".npz"): file
        for file in files(__package__).joinpath("policies").iterdir()
    }
    if task not in stored:
        raise UnknownNameError("stored policy", task, stored)
    with stored[task].open("rb") as file, np.load(file) as arrays:
        mean, std, clip = arrays["mean"], arrays["std"], arrays["clip"]
        layers = [(arrays[f"weight{n}"], arrays[f"bias{n}"]) for n in range(LAYERS)]

    def policy(observation: FloatArray) -> NDArray[np.floating]:
        values = np.clip((observation - mean) / std, -clip, clip)
        for weight, bias in layers[:-1]:
            values = np.tanh(weight @ values + bias)
        weight, bias = layers[-1]
        return np.clip(weight @ values + bias, -1.0, 1.0)

    return policy
