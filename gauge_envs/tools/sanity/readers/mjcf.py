"""MuJoCo models: a model file, or a compiled model in this process."""

from __future__ import annotations

import copy
import warnings
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import mujoco

from gauge_envs.errors import TargetError
from gauge_envs.reading import reading
from gauge_envs.text import filled_text
from gauge_envs.tools.sanity.readers.gauge_probe import mjcf_root
from gauge_envs.tools.sanity.readers.mjcf_errors import sentence
from gauge_envs.tools.sanity.readers.mujoco_model import mujoco_configuration
from gauge_envs.tools.sanity.training import TrainingConfiguration

GeomPair = tuple[str, str]
"""Names of two geoms of a model."""


def read_model_file(path: Path, pair: GeomPair | None = None) -> TrainingConfiguration:
    """Return the configuration of a model file that MuJoCo reads.

    Raises:
        TargetError: MuJoCo cannot load it; the message has the file, the line and what to do.
    """
    with reading(path, TargetError) as content:
        text = filled_text(content)
    try:
        with warnings.catch_warnings(record=True, action="always") as caught:
            if path.suffix == ".mjcf":
                # MuJoCo reads a file of another name than .xml and .urdf from its text alone.
                spec = mujoco.MjSpec.from_string(text)
                spec.modelfiledir = str(path.parent)
            else:
                spec = mujoco.MjSpec.from_file(str(path))
            # Pictures can be 30 times as large as the model: a pixel replaces them.
            for texture in spec.textures:
                texture.file, texture.cubefiles = "", [""] * 6
                texture.builtin = mujoco.mjtBuiltin.mjBUILTIN_FLAT
                texture.width = texture.height = 1
            model = spec.compile()
    except ValueError as error:
        raise TargetError(sentence(path, text, str(error))) from None
    read = mujoco_configuration(
        model,
        name=path.name,
        source=f"model file {path}",
        pair=pair,
        spec=spec,
        file=path,
    )
    warned = {str(warning.message) for warning in caught}
    return replace(read, warnings=tuple(warned))


def read_model(
    model: mujoco.MjModel,
    data: mujoco.MjData | None = None,
    pair: GeomPair | None = None,
) -> TrainingConfiguration:
    """Return the configuration of a compiled model; with data, checks of the model start in its state."""
    return mujoco_configuration(
        model if data is None else _with_start(model, data),
        name=model_name(model),
        source="mujoco.MjModel",
        pair=pair,
    )


def _with_start(model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjModel:
    """Return a copy of a model whose keyframes are the state of data; a model without a keyframe gets one."""
    if model.nkey:
        started = copy.copy(model)
    else:
        root = mjcf_root(model)
        keyframe = ET.SubElement(root, "keyframe")
        ET.SubElement(keyframe, "key", name="data")
        text = ET.tostring(root, encoding="unicode")
        started = mujoco.MjModel.from_xml_string(text)
    for name in ("qpos", "qvel", "act", "ctrl"):
        getattr(started, f"key_{name}")[:] = getattr(data, name)
    started.key_mpos[:] = data.mocap_pos.ravel()
    started.key_mquat[:] = data.mocap_quat.ravel()
    return started


def model_name(model: mujoco.MjModel) -> str:
    """Return the name of a model, or `unnamed model`."""
    return model.names.split(b"\0", 1)[0].decode() or "unnamed model"
