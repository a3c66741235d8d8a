"""Names, reading and writing of result files."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import fields
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from gauge_envs.errors import ResultFileError, UnknownNameError, first_fault
from gauge_envs.experiments.experiment import ASSET_NAME, AssetKind
from gauge_envs.experiments.user_file import EXPERIMENT_NAME
from gauge_envs.experiments.variants import find_variant
from gauge_envs.files import MEGABYTE, json_document, read_regular, write_whole
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.references.bands import BandGrade
from gauge_envs.references.imported import BUNDLED_DATA, DataSource
from gauge_envs.runs.result import Result

MOST_RESULT_BYTES = 32 * MEGABYTE


def result_file_name(result: Result) -> str:
    """Return the file name of a result, as `SlopeSlider-2-wood.mujoco.calibrated.json`.

    Further parts name what differs from the defaults: hashes of overrides, asset, settings and jitter, imported data,
    the marker proxy and the seed.
    """
    named = result.parameters
    parts = [result.id.removeprefix("GAUGE/"), result.backend or "file"]
    parts.append(re.sub(r"[^\w-]", "_", named) if isinstance(named, str) else f"custom-{_digest(named)}")
    if result.is_edited:
        parts.append(f"asset-{result.asset['sha256'][:8]}")
    parts += [f"{key}-imported" for key in BUNDLED_DATA if result.dataset[key] == DataSource.IMPORTED]
    if result.settings_given:
        parts.append(f"settings-{_digest(result.settings_given)}")
    if result.jitter:
        parts.append(f"jitter-{_digest(result.jitter)}")
    if result.marker_proxy != MarkerProxy.MATERIAL:
        parts.append(result.marker_proxy)
    if result.seed:
        parts.append(f"seed-{result.seed}")
    return ".".join([*parts, "json"])


def _digest(values: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:8]


def write_result(result: Result, file: Path) -> None:
    """Write a result file, whole or not at all."""
    text = json.dumps(result.to_dict(), allow_nan=False) + "\n"
    try:
        write_whole(file, text.encode())
    except OSError as error:
        raise ResultFileError(f"{file}: cannot be written: {error.strerror or error}") from error


def load_result(file: Path, *, needs_trajectory: bool = True) -> Result:
    """Read a result file.

    Args:
        file: The file.
        needs_trajectory: Whether a result of an episode that did not run is an error.
    """
    try:
        content = json_document(read_regular(file, MOST_RESULT_BYTES))
        if not isinstance(content, dict):
            raise ValueError(f"expected a JSON object, got a {type(content).__name__}")
        # Files of older versions lack these keys; they have the defaults of that time.
        content.setdefault("jitter", {})
        content.setdefault("marker_proxy", MarkerProxy.NODE.value)
        stated = content.get("dataset") or {}
        content["dataset"] = BUNDLED_DATA | stated if isinstance(stated, dict) else stated
        content.setdefault("asset", {})
        content.setdefault("deformation", None)
        content.setdefault("cpu_s", None)
        missing = [key.name for key in fields(Result) if key.name not in content]
        if missing:
            raise ValueError(f"no {missing[0]!r}")
        result = TypeAdapter(Result).validate_python(content)
        _check(result, needs_trajectory=needs_trajectory)
    except OSError as error:
        raise ResultFileError(f"{file}: cannot be read: {error.strerror or error}") from error
    except ValidationError as error:
        place, reason = first_fault(error)
        raise ResultFileError(f"{file}: not a result file: {place}: {reason}") from error
    except (ValueError, UnknownNameError) as error:
        raise ResultFileError(f"{file}: not a result file: {error}") from error
    return result


class _AssetRecord(BaseModel):
    """The asset of a result; `scene` and `experiment` are checked when the scene is built again."""

    model_config = ConfigDict(strict=True, extra="ignore")

    file: str
    kind: Annotated[AssetKind, Field(strict=False)]
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{8,64}$")]
    edited: bool
    changes: list[str]


def _check(result: Result, *, needs_trajectory: bool) -> None:
    """Check what types alone do not state."""
    if result.asset:
        _AssetRecord.model_validate(result.asset)
    if not result.has_experiment_file:
        find_variant(result.id)
    elif not re.fullmatch(f"GAUGE/{ASSET_NAME}-{EXPERIMENT_NAME}", result.id):
        raise ValueError(f"id is {result.id!r}, expected 'GAUGE/{ASSET_NAME}-' and a name of letters and digits")
    stated = {"score.grade": (result.score.grade, BandGrade), "marker_proxy": (result.marker_proxy, MarkerProxy)}
    stated |= {f"dataset.{key}": (result.dataset[key], DataSource) for key in BUNDLED_DATA}
    for key, (value, known) in stated.items():
        if value not in tuple(known):
            raise ValueError(f"{key} is {value!r}, expected one of {', '.join(known)}")
    trajectory = result.trajectory
    if trajectory is None and result.error is not None and not needs_trajectory:
        return
    if trajectory is None:
        raise ValueError("it has no trajectory")
    if not (trajectory.times_s and trajectory.coordinates):
        raise ValueError("trajectory: it has no samples")
    times_s = [*trajectory.times_s, *trajectory.later_times_s]
    if any(later <= earlier for earlier, later in pairwise(times_s)):
        raise ValueError("trajectory.times_s: increasing times are expected")
