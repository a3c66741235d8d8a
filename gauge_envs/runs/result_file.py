"""Names, reading and writing of result files."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from gauge_envs.errors import ResultFileError, UnknownNameError, first_fault
from gauge_envs.experiments.variants import find_variant
from gauge_envs.files import write_whole
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.references.imported import BUNDLED_DATA, DataSource
from gauge_envs.runs.result import Result

__all__ = ["load_result", "result_file_name", "write_result"]


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
    """Write a result file, whole or not at all.

    Raises:
        ResultFileError: It cannot be written.
    """
    text = json.dumps(result.to_dict(), allow_nan=False) + "\n"
    try:
        write_whole(file, text.encode())
    except OSError as error:
        raise ResultFileError(f"{file}: cannot be written: {error.strerror or error}") from error


def load_result(file: Path) -> Result:
    """Read a result file.

    Raises:
        ResultFileError: The file cannot be read, or is not a complete and consistent result file.
    """
    try:
        content = json.loads(file.read_bytes())
        if not isinstance(content, dict):
            raise ValueError(f"expected a JSON object, got a {type(content).__name__}")
        # Files of older versions lack these keys; they have the defaults of that time.
        content.setdefault("jitter", {})
        content.setdefault("marker_proxy", MarkerProxy.NODE.value)
        content["dataset"] = BUNDLED_DATA | dict(content.get("dataset") or {})
        content.setdefault("asset", {})
        content.setdefault("deformation", None)
        missing = [key.name for key in fields(Result) if key.name not in content]
        if missing:
            raise ValueError(f"no {missing[0]!r}")
        result = TypeAdapter(Result).validate_python(content)
        if not result.has_experiment_file:
            find_variant(result.id)
        if result.trajectory is None:
            raise ValueError("it has no trajectory")
    except OSError as error:
        raise ResultFileError(f"{file}: cannot be read: {error.strerror or error}") from error
    except ValidationError as error:
        place, reason = first_fault(error)
        raise ResultFileError(f"{file}: not a result file: {place}: {reason}") from error
    except (ValueError, RecursionError, UnknownNameError) as error:
        raise ResultFileError(f"{file}: not a result file: {error}") from error
    return result
