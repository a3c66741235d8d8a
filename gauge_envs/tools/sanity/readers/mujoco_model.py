"""Read MuJoCo models: a model file, or a compiled model in this process."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco

from gauge_envs.backends.mujoco import mjcf_probe
from gauge_envs.errors import TargetError
from gauge_envs.files import MEGABYTE, child_refusal, read_regular
from gauge_envs.tools.sanity.model import TrainingConfiguration
from gauge_envs.tools.sanity.mujoco_model import mujoco_configuration
from gauge_envs.tools.sanity.readers.reader import GeomPair, Reader, check_settings

MODEL_SUFFIXES = (".xml", ".mjcf", ".urdf")

MOST_MODEL_BYTES = 16 * MEGABYTE
"""Largest size of a model file, without the meshes that it names."""

MODEL_CPU_S = 60
"""Limit of the processor time of loading it; meshes take their time."""


def read_model(
    model: mujoco.MjModel,
    *,
    name: str,
    source: str,
    pair: GeomPair | None = None,
    frame_skip: int | None = None,
) -> TrainingConfiguration:
    """Return the configuration of a compiled model, after a trial of its settings.

    Args:
        model: The compiled model.
        name: Name of the configuration.
        source: Description of where the model is from.
        pair: Names of two geoms whose constants the experiments get, instead of all sets on ground.
        frame_skip: Steps of the engine for one action; None when unknown.
    """
    read = mujoco_configuration(model, name=name, source=source, pair=pair, frame_skip=frame_skip)
    check_settings(read.backend, read.settings)
    return read


def read_model_file(path: Path, pair: GeomPair | None = None) -> TrainingConfiguration:
    """Return the configuration of a model file that MuJoCo reads."""
    try:
        read_regular(path, MOST_MODEL_BYTES)
    except FileNotFoundError:
        raise TargetError(f"{path}: there is no such file") from None
    except OSError as error:
        raise TargetError(f"{path}: cannot be read: {error.strerror or error}") from None
    refusal = child_refusal(Path(mjcf_probe.__file__), str(path), cpu_s=MODEL_CPU_S)
    if refusal is not None:
        raise TargetError(f"{path}: {refusal}: simplify the model")
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise TargetError(f"{path}: MuJoCo cannot load it: {' '.join(str(error).split())}") from None
    return read_model(model, name=path.name, source=f"model file {path}", pair=pair)


def model_name(model: mujoco.MjModel) -> str:
    """Return the name that a model states, or `unnamed model`."""
    return model.names.split(b"\0", 1)[0].decode() or "unnamed model"


def _is_model_file(target: Any) -> bool:
    return isinstance(target, str | Path) and Path(target).suffix.lower() in MODEL_SUFFIXES


def _read_object(target: Any, pair: GeomPair | None) -> TrainingConfiguration:
    return read_model(target, name=model_name(target), source="mujoco.MjModel", pair=pair)


MODEL_FILE = Reader(
    name="model-file",
    accepts="a model file (.xml, .mjcf, .urdf)",
    matches=_is_model_file,
    read=lambda target, pair: read_model_file(Path(target), pair),
    has_geoms=True,
)
"""Reader of model files."""

MODEL_OBJECT = Reader(
    name="mujoco-model",
    accepts="a mujoco.MjModel",
    matches=lambda target: isinstance(target, mujoco.MjModel),
    read=_read_object,
    has_geoms=True,
)
"""Reader of compiled models."""
