"""Read probe files: settings of a training environment in which this package is not installed.

The program that `gauge sanity probe` prints writes them. They hold numbers and texts; nothing of them is executed.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import mujoco
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gauge_envs.errors import ParameterError, TargetError, first_fault
from gauge_envs.files import MEGABYTE, json_document, read_regular
from gauge_envs.tools.sanity.contact_capacity import CapacityLimits, ContactCapacity
from gauge_envs.tools.sanity.model import TrainingConfiguration
from gauge_envs.tools.sanity.probe_model import ModelData, build_saved_model
from gauge_envs.tools.sanity.readers.isaac_gym import isaac_gym_configuration
from gauge_envs.tools.sanity.readers.isaac_lab import isaac_lab_configuration, isaac_lab_yaml
from gauge_envs.tools.sanity.readers.maniskill import maniskill_configuration
from gauge_envs.tools.sanity.readers.mujoco_model import read_model
from gauge_envs.tools.sanity.readers.reader import GeomPair, Reader

SUFFIX = ".gaugeprobe.json"

VERSION = 1
"""Version of the format that is read."""

MUJOCO = "mujoco-model"
"""Kind of files with a model of MuJoCo."""

MOST_PROBE_BYTES = 16 * MEGABYTE

START = re.compile(rb'\s*\{\s*"format"\s*:\s*"gauge-probe"')
"""Start of a probe file whatever its name."""

MARGINS_SINCE = (3, 9)
MARGINS_TEXT = ".".join(map(str, MARGINS_SINCE))
"""First version in which the margins of two geoms add up, and gaps come on top of them."""

DIFFERENCES = {
    "mjx": "training runs on MJX; the rows are measured with MuJoCo's C engine",
    "mujoco_warp": "training runs on MuJoCo Warp; the rows are measured with MuJoCo's C engine",
}

NOT_COUNTED = "a probe file does not hold what moves the robot, so its contacts are not counted"

ABSENT_PARTS = {
    "nflex": "deformable bodies of the model are not read",
    "flg_adhesion": "adhesion of geoms is not carried over",
    "flg_surfacevel": "surface velocity of geoms is not carried over",
}
"""Parts that the file leaves out, by the count of the model that shows them."""


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


def _read(path: Path, pair: GeomPair | None) -> TrainingConfiguration:
    try:
        file = _ProbeFile.model_validate(json_document(read_regular(path, MOST_PROBE_BYTES)))
    except OSError as error:
        raise TargetError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValidationError as error:
        raise TargetError(f"{path}: {_fault(error)}") from None
    except ValueError as error:
        raise TargetError(f"{path}: {error}") from None
    if file.version != VERSION:
        raise TargetError(
            f"{path}: version {file.version} of the format, this gauge-envs reads version {VERSION}: run `gauge sanity "
            "probe` again here, and its output where the policy is trained"
        )
    if file.kind != MUJOCO and file.kind not in KINDS:
        raise TargetError(f"{path}: kind {file.kind!r} is not known; known are {', '.join((MUJOCO, *KINDS))}")
    if file.kind != MUJOCO and pair is not None:
        raise TargetError(f"{path}: pairs of geoms are those of a MuJoCo model, and the target has none")
    try:
        read = _read_mujoco(file, path, pair) if file.kind == MUJOCO else KINDS[file.kind](file, path)
    except ParameterError as error:
        raise TargetError(f"{path}: {error}") from error
    return replace(read, name=file.name, source=f"probe file {path.name}: {file.source}")


def _fault(error: ValidationError) -> str:
    key, reason = first_fault(error)
    return f"{key or 'the file'}: {reason}"


def _read_mujoco(file: _ProbeFile, path: Path, pair: GeomPair | None) -> TrainingConfiguration:
    try:
        data = ModelData.model_validate(file.data, strict=True)
    except ValidationError as error:
        raise TargetError(f"{path}: data: {_fault(error)}") from None
    model, notes = build_saved_model(data, str(path))
    trained = file.versions.get("mujoco")
    if trained is not None and trained != mujoco.__version__:
        notes.append(f"training runs with MuJoCo {trained}; the rows are measured with MuJoCo {mujoco.__version__}")
    if data.implementation in DIFFERENCES:
        notes.append(DIFFERENCES[data.implementation])
    if _release(trained) < MARGINS_SINCE and any(data.arrays["geom_margin"] + data.arrays["geom_gap"]):
        notes.append(f"margins and gaps of two geoms are combined as since MuJoCo {MARGINS_TEXT}, not as in training")
    notes += [note for count, note in ABSENT_PARTS.items() if data.counts.get(count)]
    read = read_model(model, name=file.name, source=file.source, pair=pair, frame_skip=data.frame_skip)
    limits = CapacityLimits(njmax=data.limits.get("njmax"), naconmax=data.limits.get("naconmax"))
    capacity = ContactCapacity(limits=limits, reason=NOT_COUNTED) if data.limits else None
    return replace(read, notes=(*read.notes, *notes), capacity=capacity)


def _release(version: str | None) -> tuple[int, ...]:
    """Return the first two numbers of a version; large ones for a version that is unknown."""
    found = re.match(r"(\d{1,4})\.(\d{1,4})", version or "")
    return (int(found[1]), int(found[2])) if found else MARGINS_SINCE


def _read_isaac_lab(file: _ProbeFile, path: Path) -> TrainingConfiguration:
    text = file.data.get("env_yaml")
    if isinstance(text, str):
        return isaac_lab_yaml(text, name=str(path), source=file.source)
    return isaac_lab_configuration(_table(file, path, "cfg"), name=str(path), source=file.source)


def _read_isaac_gym(file: _ProbeFile, path: Path) -> TrainingConfiguration:
    return isaac_gym_configuration(_table(file, path, "cfg"), name=str(path), source=file.source)


def _read_maniskill(file: _ProbeFile, path: Path) -> TrainingConfiguration:
    return maniskill_configuration(_table(file, path, "sim_config"), name=str(path), source=file.source)


def _table(file: _ProbeFile, path: Path, key: str) -> Mapping[str, Any]:
    found = file.data.get(key)
    if not isinstance(found, Mapping):
        raise TargetError(f"{path}: data.{key}: expected an object")
    return found


KINDS: Mapping[str, Callable[[_ProbeFile, Path], TrainingConfiguration]] = {
    "isaaclab-cfg": _read_isaac_lab,
    "isaacgym-cfg": _read_isaac_gym,
    "maniskill-sim-config": _read_maniskill,
}
"""Function that reads each kind of file but MuJoCo's, whose models have geoms to choose from."""


def _is_probe_file(target: Any) -> bool:
    if not isinstance(target, str | Path):
        return False
    if str(target).endswith(SUFFIX):
        return True
    if Path(target).suffix.lower() != ".json":
        return False
    try:
        return START.match(read_regular(Path(target), MOST_PROBE_BYTES)[:200]) is not None
    except OSError:
        return False


PROBE_FILE = Reader(
    name="probe-file",
    accepts=f"a probe file ({SUFFIX})",
    matches=_is_probe_file,
    read=lambda target, pair: _read(Path(target), pair),
    has_geoms=True,
)
"""Reader of probe files."""
