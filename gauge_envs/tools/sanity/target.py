"""Read a target that a user names: the numerical settings with which a policy is trained."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

import gymnasium
import mujoco
from gymnasium.vector import VectorEnv

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.model import TrainingConfiguration
from gauge_envs.tools.sanity.readers import READERS, GeomPair
from gauge_envs.tools.sanity.readers.reader import NotATargetError

Target: TypeAlias = str | Path | mujoco.MjModel | gymnasium.Env | VectorEnv[Any, Any, Any] | Mapping[str, Any]
"""A target of a sanity check; see `configuration`."""


def configuration(target: Target | TrainingConfiguration, *, pair: GeomPair | None = None) -> TrainingConfiguration:
    """Return the training configuration of a target.

    Args:
        target: One of
            a Gymnasium id (`HalfCheetah-v5`) whose environment has a `mujoco.MjModel` as `unwrapped.model`;
            an id of this suite, with its own settings;
            a task of dm_control's suite (`dm_control:walker/walk`), whose model file is read without dm_control;
            a task of MuJoCo Playground (`playground:WalkerWalk`) or of mjlab (`mjlab:TASK`), read from its source;
            `params/env.yaml` of a training run of mjlab, or its task configuration;
            a model file that MuJoCo reads;
            a settings file: `backend`, optionally `preset`, and a table `settings`;
            a backend, with or without a preset (`mujoco:out_of_box`, `newton`);
            the `params/env.yaml` of a training run with Isaac Lab, the folder of the run, or the same as a mapping;
            a YAML file in the style of IsaacGym, or the same as a mapping or an object;
            a task of ManiSkill (`maniskill:PickCube-v1`), an environment of it, or a SimConfig;
            a `mujoco.MjModel`, a `gymnasium.Env`, a `gymnasium.vector.VectorEnv`, or an env of MuJoCo Playground;
            a `mujoco.mjx.Model`, a `mujoco_warp.Model`, or a pair of the latter with its data;
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
    reader = next((one for one in READERS if one.matches(target)), None)
    if reader is None:
        raise TargetError(f"{type(target).__name__} cannot be checked; give {accepted()}")
    if pair is not None and not reader.has_geoms:
        raise TargetError(f"{target}: pairs of geoms are those of a MuJoCo model, and the target has none")
    try:
        return reader.read(target, pair)
    except NotATargetError as error:
        raise TargetError(f"{error}; give {accepted()}") from error


def compiled_model(target: Any) -> mujoco.MjModel | None:
    """Return the model of a target whose memory for contacts is limited; None for other targets."""
    reader = next((one for one in READERS if one.matches(target)), None)
    return None if reader is None or reader.model is None else reader.model(target)


def accepted() -> str:
    """Return what can be checked, as a list in words."""
    *others, most_frequent = READERS
    *most, last = (reader.accepts for reader in (most_frequent, *others))
    return f"{', '.join(most)}, or {last}"
