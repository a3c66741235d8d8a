"""Files in JSON: files of the probe in another stack's Python, and settings of this package.

The program that `gauge sanity probe` prints writes a model of MuJoCo as MJCF.
Nothing of a file is run.
"""

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import mujoco

from gauge_envs.errors import TargetError
from gauge_envs.reading import reading
from gauge_envs.text import json_document
from gauge_envs.tools.sanity.readers.gauge_probe import FORMAT, VERSION
from gauge_envs.tools.sanity.readers.mjcf import GeomPair
from gauge_envs.tools.sanity.readers.mujoco_model import mujoco_configuration
from gauge_envs.tools.sanity.readers.settings import read_settings
from gauge_envs.tools.sanity.verdict import TrainingConfiguration


def read_file(path: Path, pair: GeomPair | None) -> TrainingConfiguration:
    """Return the configuration of a file in JSON.

    Raises:
        TargetError: The file is none of the kinds, or of another version of the probe.
    """
    with reading(path, TargetError) as content:
        file = json_document(content)
    if not isinstance(file, dict) or "format" not in file:
        return read_settings(path, file)
    if (file["format"], file.get("version")) != (FORMAT, VERSION):
        raise TargetError(
            f"{path}: version {file.get('version')} of the probe, and this gauge-envs reads version {VERSION}: run "
            "gauge sanity probe here, and its program again where the policy is trained"
        )
    name = path.name.removesuffix(".json").removesuffix(".gaugeprobe")
    source = f"probe file {path.name}: {file['source']}"
    trained, here = file["mujoco"], mujoco.__version__
    text, notes = _known(file["data"])
    try:
        model = mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        cause = " ".join(str(error).split())
        raise TargetError(
            f"{path}: MuJoCo {here} cannot load the model of MuJoCo {trained}: {cause}"
        ) from None
    if trained != here:
        notes.append(
            f"training runs with MuJoCo {trained}; the checks run with MuJoCo {here}"
        )
    if file["engine"] != "MuJoCo":
        notes.append(
            f"training runs on {file['engine']}; the checks run with MuJoCo's C engine"
        )
    read = mujoco_configuration(
        model,
        name=name,
        source=source,
        pair=pair,
    )
    return replace(read, notes=(*read.notes, *notes, *file["notes"]))


def _known(text: str) -> tuple[str, list[str]]:
    """Return a model without attributes that the installed MuJoCo lacks, and a note on each that has an effect."""
    root, notes = ET.fromstring(text), {}
    known = set(mujoco.mj_printSchema(False, False).split())
    for element in root.iter():
        for name in element.attrib.keys() - known:
            value, tag = element.attrib.pop(name), element.tag
            # An unknown flag is at its default there, or off.
            if tag != "flag" and value != "0":
                notes[tag, name] = (
                    f"MuJoCo {mujoco.__version__} has no {name} of <{tag}>, which is {value} in training"
                )
    return ET.tostring(root, encoding="unicode"), [*notes.values()]
