"""Probe files: settings of a training environment in which this package is not installed.

The program that `gauge sanity probe` prints writes them. They hold numbers and texts; nothing of them is executed.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import mujoco
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gauge_envs.errors import ParameterError, TargetError, first_fault
from gauge_envs.files import json_document
from gauge_envs.tools.sanity.gauge_probe import (
    SUFFIX,
    VERSION,
)
from gauge_envs.tools.sanity.model import (
    TrainingConfiguration,
)
from gauge_envs.tools.sanity.robot.mujoco_model import (
    ABSENT_PARTS,
    mujoco_configuration,
)
from gauge_envs.tools.sanity.robot.saved_model import ModelData, build_saved_model
from gauge_envs.tools.sanity.stacks.documents import file_value, yaml_document
from gauge_envs.tools.sanity.stacks.reader import GeomPair, Reader, has_suffix

MUJOCO = "mujoco-model"
"""Kind of files with a model of MuJoCo, which has geoms to choose from."""

STACKS = {
    "isaaclab-cfg": ("isaac_lab", "cfg"),
    "maniskill-sim-config": ("maniskill", "sim_config"),
}
"""Stack of each other kind of files, and the key of its configuration."""

START = re.compile(rb'\s*\{\s*"format"\s*:\s*"gauge-probe"')
"""Start of a probe file whatever its name."""

MARGINS_SINCE = (3, 9)
MARGINS_TEXT = ".".join(map(str, MARGINS_SINCE))
"""First version in which the margins of two geoms add up, and gaps come on top of them."""

ENGINES = {"mjx": "MJX", "mujoco_warp": "MuJoCo Warp"}
"""Engines that run a model in training, by implementation."""

_Model = TypeVar("_Model", bound=BaseModel)


class _ProbeFile(BaseModel):
    """Content of a probe file; what `data` holds depends on `kind`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    format: Literal["gauge-probe"]
    version: int
    kind: Annotated[str, Field(max_length=64)]
    engine: Annotated[str, Field(max_length=64)]
    name: Annotated[str, Field(max_length=400)]
    source: Annotated[str, Field(max_length=400)]
    versions: dict[str, Annotated[str, Field(max_length=64)]]
    data: dict[str, Any]


def _validated(
    kind: type[_Model], values: Any, where: str, *, strict: bool = False
) -> _Model:
    try:
        return kind.model_validate(values, strict=strict)
    except ValidationError as error:
        key, reason = first_fault(error)
        raise TargetError(f"{where}: {key or 'the file'}: {reason}") from None


def _read(path: Path, pair: GeomPair | None) -> TrainingConfiguration:
    file = _validated(_ProbeFile, file_value(path, json_document), str(path))
    if file.version != VERSION:
        raise TargetError(
            f"{path}: version {file.version} of the format, this gauge-envs reads version {VERSION}: run `gauge sanity "
            "probe` again here, and its output where the policy is trained"
        )
    if file.kind != MUJOCO and file.kind not in STACKS:
        raise TargetError(
            f"{path}: kind {file.kind!r} is not known; known are {', '.join((MUJOCO, *STACKS))}"
        )
    if file.kind != MUJOCO and pair is not None:
        raise TargetError(
            f"{path}: pairs of geoms are those of a MuJoCo model, and the target has none"
        )
    try:
        read = (
            _read_mujoco(file, path, pair)
            if file.kind == MUJOCO
            else _read_stack(file, path)
        )
    except ParameterError as error:
        raise TargetError(f"{path}: {error}") from error
    return replace(
        read, name=file.name, source=f"probe file {path.name}: {file.source}"
    )


def _read_mujoco(
    file: _ProbeFile, path: Path, pair: GeomPair | None
) -> TrainingConfiguration:
    data = _validated(ModelData, file.data, f"{path}: data", strict=True)
    model, notes = build_saved_model(data, str(path))
    trained = file.versions.get("mujoco")
    if trained is not None and trained != mujoco.__version__:
        notes.append(
            f"training runs with MuJoCo {trained}; the rows are measured with MuJoCo {mujoco.__version__}"
        )
    if data.implementation in ENGINES:
        engine = ENGINES[data.implementation]
        notes.append(
            f"training runs on {engine}; the rows are measured with MuJoCo's C engine"
        )
    if _release(trained) < MARGINS_SINCE and any(
        data.arrays["geom_margin"] + data.arrays["geom_gap"]
    ):
        notes.append(
            f"margins and gaps of two geoms are combined as since MuJoCo {MARGINS_TEXT}, not as in training"
        )
    notes += [note for count, note in ABSENT_PARTS.items() if data.counts.get(count)]
    read = mujoco_configuration(
        model, name=file.name, source=file.source, pair=pair, frame_skip=data.frame_skip
    )
    return replace(
        read,
        notes=(*read.notes, *notes),
        # Its actuators have no gains.
        robot=None,
    )


def _release(version: str | None) -> tuple[int, ...]:
    """Return the first two numbers of a version; large ones for a version that is unknown."""
    found = re.match(r"(\d{1,4})\.(\d{1,4})", version or "")
    return (int(found[1]), int(found[2])) if found else MARGINS_SINCE


def _read_stack(file: _ProbeFile, path: Path) -> TrainingConfiguration:
    stack, key = STACKS[file.kind]
    found, text = file.data.get(key), file.data.get("env_yaml")
    if stack == "isaac_lab" and isinstance(text, str):
        try:
            found = yaml_document(text)
        except ValueError as error:
            raise TargetError(f"{path}: {error}") from None
    elif not isinstance(found, Mapping):
        raise TargetError(f"{path}: data.{key}: expected an object")
    read = getattr(
        import_module(f"gauge_envs.tools.sanity.stacks.{stack}"),
        f"{stack}_configuration",
    )
    return read(found, name=str(path), source=file.source)


def _is_probe_file(target: Any) -> bool:
    if not has_suffix(".json")(target):
        return False
    try:
        content = Path(target).read_bytes()
    except OSError:
        content = b""
    return str(target).endswith(SUFFIX) or START.match(content[:200]) is not None


READERS = (
    Reader(
        f"a probe file of another environment (NAME{SUFFIX}, see gauge sanity probe)",
        _is_probe_file,
        lambda target, pair: _read(Path(target), pair),
    ),
)
