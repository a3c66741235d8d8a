"""MuJoCo models: a model file, or a compiled model in this process."""

import copy
import re
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import mujoco

from gauge_envs.errors import TargetError
from gauge_envs.reading import reading
from gauge_envs.text import filled_text, printable
from gauge_envs.tools.sanity.readers.gauge_probe import mjcf_root
from gauge_envs.tools.sanity.readers.mujoco_model import mujoco_configuration
from gauge_envs.tools.sanity.verdict import TrainingConfiguration

POINTER = b"version https://git-lfs"
"""First bytes of the pointer that Git leaves in place of a large file."""

Texts = Mapping[Path, str]
"""Text of a model file and of those that it includes."""


def sentence(path: Path, text: str, error: str) -> str:
    """Return what is wrong with a model file.

    Args:
        path: The file.
        text: Its text.
        error: MuJoCo's message.
    """
    if "xmlns:xacro" in text:
        return f"{path}: is a xacro file, which is no model yet: run xacro {path.name} > robot.urdf"
    texts = _with_includes(path, text)
    for file, content in texts.items():
        try:
            ET.fromstring(content)
        except ET.ParseError as fault:
            line, column = fault.position
            cause = str(fault).partition(":")[0]
            return f"{file}:{line}: the XML is not well-formed at column {column}, {cause}: close what is open there"
    if unread := re.search(r"(?:opening|STL|mesh) file '(.*?)'", error):
        return _unread(texts, path, unread[1], error)
    return _placed(texts, path, error)


def _with_includes(path: Path, text: str) -> Texts:
    """Return the text of a file and of those that it includes, whose paths count from its folder."""
    texts, left = {path: text}, [text]
    while left:
        for name in re.findall(r'<include\s[^>]*?file\s*=\s*"(.*?)"', left.pop()):
            file = path.parent / name
            if file.is_file() and file not in texts:
                texts[file] = file.read_text(encoding="utf-8-sig", errors="replace")
                left.append(texts[file])
    return texts


def _element(texts: Texts, form: str) -> tuple[str, str, str] | None:
    """Return file and line, label and text of the first element that a pattern finds behind `<`."""
    for file, text in texts.items():
        if match := re.search(rf"<{form}[^<>]*", text):
            name = re.search(r'\bname\s*=\s*"(.*?)"', match[0])
            tag = re.split(r"\W", match[0], maxsplit=2)[1]
            line = text.count("\n", 0, match.start()) + 1
            label = f'{tag} "{name[1]}"' if name else f"<{tag}>"
            return f"{file}:{line}", label, match[0]
    return None


def _unread(texts: Texts, path: Path, sought: str, error: str) -> str:
    """Return which element needs a file that is not there or cannot be read."""
    name = re.escape(re.split(r"[/\\]", sought)[-1])
    form = rf"""\w+\b[^<>]*?\bfile(name)?\s*=\s*["']([^"'<>]*[/\\])?{name}["']"""
    place, label, text = _element(texts, form) or (path, "it", "")
    start = f"{place}: {label} needs {sought}, which"
    for file in (path.parent / sought, Path(sought)):
        if file.is_file():
            if file.read_bytes().startswith(POINTER):
                return f"{start} is a pointer of Git LFS: run git lfs pull"
            cause = error.split("\n")[0].removeprefix("Error: ")
            return f"{start} cannot be read: {cause}"
    advice = (
        "copy it there" if label == "<include>" else "copy it there, or set meshdir"
    )
    if "package:/" in text:
        advice = "write its path relative to this file, without package://"
    return f"{start} is not there: {advice}"


def _placed(texts: Texts, path: Path, error: str) -> str:
    """Return MuJoCo's own message with the file and line of its element."""
    message, _, rest = error.partition("\nElement")
    message = re.sub(r"((XML )?Error|Schema violation|ParseXML): ", "", message)
    end = printable(" ".join(message.split()))
    match = re.match(r"(?: name)? '(.+?)'", rest)
    line = re.search(r"line ([1-9]\d*)", rest)
    element = None
    if match and rest.startswith(" name"):
        element = _element(texts, rf'\w+\b[^<>]*?\bname\s*=\s*"{re.escape(match[1])}"')
    elif match and not line:
        # MuJoCo gives no line in an included file.
        attribute = re.search("'(.*?)'", message)
        element = _element(
            texts, rf"{match[1]}\b[^<>]*{attribute[1] if attribute else ''}"
        )
    if element:
        return f"{element[0]}: {element[1]}: {end}"
    place = f"{path}:{line[1]}" if line else str(path)
    return f"{place}: <{match[1]}>: {end}" if match else f"{place}: {end}"


GeomPair = tuple[str, str]
"""Names of two geoms of a model."""


def read_model_file(path: Path, pair: GeomPair | None) -> TrainingConfiguration:
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
