"""Checks of the arguments of environments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from enum import Enum
from os import PathLike, fspath
from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec

from gauge_envs.backends.registry import backend_for, backend_names
from gauge_envs.errors import GaugeError, ParameterError, UnsupportedSceneError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.scene.jitter import Jitter

__all__ = [
    "check_support",
    "jitter_option",
    "plain_spec",
]


def plain_spec(spec: EnvSpec | None) -> EnvSpec | None:
    """A copy of a spec whose arguments are such that `EnvSpec.to_json` takes them.

    Raises:
        ParameterError: An argument has no plain form.
    """
    if spec is None:
        return None
    return replace(spec, kwargs={name: _plain(name, value) for name, value in spec.kwargs.items()})


def _plain(name: str, value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(f"{name}[{key!r}]", entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        entries = [_plain(name, entry) for entry in value]
        return tuple(entries) if isinstance(value, tuple) else entries
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, PathLike):
        return fspath(value)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise ParameterError(
        f"argument {name} = {value!r} has no place in the spec of an environment: "
        "expected numbers, text, paths, or lists and mappings of them"
    )


def jitter_option(options: Mapping[str, Any]) -> Jitter | None:
    """How far the options of a reset let starts scatter; None where they do not.

    Raises:
        ParameterError: There is no such option, or its value is of another kind.
    """
    unknown = [repr(key) for key in options if key != "jitter"]
    if unknown:
        raise ParameterError(f"reset knows the option 'jitter' alone, got {', '.join(unknown)}")
    value = options.get("jitter", False)
    if isinstance(value, bool):
        return Jitter() if value else None
    if not isinstance(value, Jitter):
        raise ParameterError(f"option 'jitter' is {value!r}, expected True, False or a gauge_envs.Jitter")
    return value


def check_support(experiment: Experiment, backend: str) -> None:
    """Raise when a backend cannot build an experiment.

    Raises:
        UnknownNameError: No such backend.
        MissingExtraError: Its engine is not installed.
        UnsupportedSceneError: It declines; the message gives its reasons, and a backend that can.
    """
    support = backend_for(backend, experiment.model_file).supports(experiment.scene)
    if not support:
        raise UnsupportedSceneError(_unsupported_message(experiment, backend, support.missing))


def _unsupported_message(experiment: Experiment, asked: str, missing: tuple[str, ...]) -> str:
    able = []
    for name in backend_names():
        try:
            if name != asked and backend_for(name, experiment.model_file).supports(experiment.scene):
                able.append(name)
        except GaugeError:
            continue
    reasons = "; ".join(missing)
    others = f"backend={able[0]!r} can" if able else "no installed backend can run this experiment yet"
    return f"{experiment.id}: backend {asked!r} cannot build it: {reasons}; {others}"
