"""Training stacks: what can be checked, how it is read, and the dialect in which its changes are written."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.model import TrainingConfiguration
from gauge_envs.tools.sanity.stacks.dialect import Dialect

if TYPE_CHECKING:
    from gauge_envs.tools.sanity.stacks.gymnasium_env import Target
    from gauge_envs.tools.sanity.stacks.mjcf import GeomPair

__all__ = ["Dialect", "configuration", "dialect"]

READERS = {
    **dict.fromkeys((".xml", ".mjcf", ".urdf"), "mjcf.read_model_file"),
    **dict.fromkeys((".yaml", ".yml"), "isaac_lab.read_file"),
    ".toml": "settings.read_file",
    ".json": "probe.read_file",
}
"""Module and function that reads a file, by its suffix."""

DIALECTS = {
    "toml": "dialect.TOML",
    "mjcf": "mjcf.MJCF",
    "genesis": "genesis.GENESIS",
    "maniskill": "maniskill.MANISKILL",
    "isaac_lab": "isaac_lab.ISAAC_LAB",
    "isaac_lab_3": "isaac_lab.ISAAC_LAB_3",
}


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
            a file that the probe writes in the Python of another stack (`NAME.gaugeprobe.json`);
            a `mujoco.MjModel`, a pair of it and its `mujoco.MjData`, in whose pose rows on the model start, or a
            `gymnasium.Env`;
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
    if isinstance(target, str | Path):
        read = _read_text(target, pair)
    else:
        read = _part("gymnasium_env.read_object")(target, pair)
    if pair is not None and not read.is_model:
        raise TargetError(
            f"{target}: pairs of geoms are those of a MuJoCo model, and the target has none"
        )
    return read


def _read_text(target: str | Path, pair: GeomPair | None) -> TrainingConfiguration:
    """Return the configuration of a file, a folder of a run, a backend or a Gymnasium id."""
    path = Path(target)
    if path.is_dir():
        path = _part("isaac_lab.file_of_run")(path)
    reader = READERS.get(path.suffix.lower())
    if reader is not None:
        read: TrainingConfiguration = _part(reader)(path, pair)
        return read
    backend: TrainingConfiguration | None = _part("settings.read_backend")(str(target))
    if backend is None and path.is_dir():
        raise TargetError(f"{path}: has no params/env.yaml: give the file of a model")
    return backend or _part("gymnasium_env.read_id")(str(target), pair)


def dialect(name: str) -> Dialect:
    """Return a dialect by the name that a `TrainingConfiguration` states as its language."""
    found: Dialect = _part(DIALECTS[name])
    return found


def _part(name: str) -> Any:
    module, part = name.split(".")
    return getattr(import_module(f"{__name__}.{module}"), part)
