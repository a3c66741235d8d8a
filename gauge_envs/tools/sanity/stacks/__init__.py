"""Training stacks: what can be checked, how it is read, and the dialect in which its changes are written.

Each module has the readers of one stack, `READERS`, and its dialects, `DIALECTS`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.model import TrainingConfiguration
from gauge_envs.tools.sanity.stacks.dialect import Dialect
from gauge_envs.tools.sanity.stacks.reader import GeomPair, NotATargetError, Reader

if TYPE_CHECKING:
    from gauge_envs.tools.sanity.stacks.gymnasium_env import Target

__all__ = ["Dialect", "accepted", "configuration", "dialect", "reader_of"]

STACKS = (
    *("mjcf", "maniskill", "genesis", "probe", "settings", "isaac_lab"),
    # It takes every text.
    "gymnasium_env",
)
"""Modules of the stacks; the first reader that matches a target reads it."""


def configuration(
    target: Target | TrainingConfiguration, *, pair: GeomPair | None = None
) -> TrainingConfiguration:
    """Return the training configuration of a target.

    Args:
        target: One of
            a Gymnasium id (`HalfCheetah-v5`) whose environment has a `mujoco.MjModel` as `unwrapped.model`;
            an id of this suite, with its own settings;
            a model file that MuJoCo reads;
            a settings file: `backend`, optionally `preset`, and a table `settings`;
            a backend, with or without a preset (`mujoco:out_of_box`, `newton`);
            the `params/env.yaml` of a training run with Isaac Lab, or the folder of the run;
            the saved options of a Genesis scene;
            a `mujoco.MjModel` or a `gymnasium.Env`;
            a file that the probe writes in the Python of another stack (`NAME.gaugeprobe.json`);
            a configuration, which is returned unchanged.
        pair: Names of two geoms of a model whose contact constants the experiments get, instead of the most frequent
            ones of moving geoms on the ground.

    Raises:
        TargetError: The target cannot be read, or has no such pair of geoms.
        UnknownNameError: There is no such backend or preset.
        ParameterError: A setting does not exist or has an impossible value.
        MissingExtraError: The backend's engine is not installed.
    """
    if isinstance(target, TrainingConfiguration):
        return target
    reader = reader_of(target)
    if reader is None:
        raise TargetError(
            f"{type(target).__name__} cannot be checked; give {accepted()}"
        )
    if pair is not None and not reader.has_geoms:
        raise TargetError(
            f"{target}: pairs of geoms are those of a MuJoCo model, and the target has none"
        )
    try:
        return reader.read(target, pair) if reader.has_geoms else reader.read(target)
    except NotATargetError as error:
        raise TargetError(f"{error}; give {accepted()}") from error


def reader_of(target: Any) -> Reader | None:
    """Return the first reader that matches a target; None when none does."""
    return next((reader for reader in _readers() if reader.matches(target)), None)


def accepted() -> str:
    """Return what can be checked, as a list in words."""
    *first, last = (
        reader.accepts for reader in _readers(("gymnasium_env", *STACKS[:-1]))
    )
    return f"{', '.join(first)}, or {last}"


def dialect(name: str) -> Dialect:
    """Return a dialect by the name that a `TrainingConfiguration` states as its language."""
    return next(
        one
        for stack in STACKS
        for one in getattr(_stack(stack), "DIALECTS", ())
        if one.name == name
    )


def _readers(stacks: Sequence[str] = ()) -> Iterator[Reader]:
    for stack in stacks or STACKS:
        yield from getattr(_stack(stack), "READERS", ())


def _stack(name: str) -> Any:
    return import_module(f"{__name__}.{name}")
