"""Names, reading and writing of result files, and the scene in a result."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from gauge_envs.errors import AssetError, ResultFileError
from gauge_envs.experiments.experiment import (
    Asset,
    AssetKind,
    Experiment,
)
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.task_files import task_spec
from gauge_envs.experiments.variants import (
    find_variant,
    recorded_variant,
    task_path,
)
from gauge_envs.files import os_errors, write_whole
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.optional import needs_extra
from gauge_envs.reading import reading
from gauge_envs.references.imported import dataset_record
from gauge_envs.references.kind import Kind
from gauge_envs.references.user_data import (
    BUNDLED_DATA,
    DataSource,
    own_task_files,
)
from gauge_envs.runs.motion import motion_file, write_motion
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.scene.diff import scene_changes
from gauge_envs.scoring.user_file.trajectory_file import LARGEST
from gauge_envs.text import json_document


def result_file_name(result: Result) -> str:
    """Return the file name of a result, as `SlopeSlider-2-wood.mujoco.published.json`.

    Further parts give differences from the defaults: hashes of overrides, asset, settings and jitter, imported data,
    the marker proxy and the seed.
    """
    parameters = result.parameters
    parts = [result.id.removeprefix("GAUGE/"), result.backend or "file"]
    if isinstance(parameters, str):
        parts.append(re.sub(r"[^\w-]", "_", parameters))
    else:
        parts.append(f"custom-{_digest(parameters)}")
    if result.is_edited:
        parts.append(f"asset-{result.asset['sha256'][:8]}")
    parts += [
        f"{key}-imported"
        for key in BUNDLED_DATA
        if result.dataset[key] == DataSource.IMPORTED
    ]
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
    """Write a result file, whole or not at all, and the motion beside it."""
    text = json.dumps(result.to_dict(), allow_nan=False) + "\n"
    with os_errors(
        lambda cause: ResultFileError(f"{file}: cannot be written: {cause}")
    ):
        write_whole(file, text.encode())
    if result.motion is not None:
        write_motion(result.motion, motion_file(file))


def load_result(file: Path) -> Result:
    """Read a result file."""
    with reading(file, ResultFileError, "a result file") as text:
        return parse_result(text)


def parse_result(text: bytes) -> Result:
    """Return the result in the content of a result file.

    Raises:
        ValueError: The content is not a result.
    """
    content = json_document(text)
    if not isinstance(content, dict):
        raise ValueError(f"expected a JSON object, got a {type(content).__name__}")
    for name in {key.name for key in fields(Result)} - {"motion"}:
        if name not in content:
            raise ValueError(f"no {name!r}")
    result = _result_adapter().validate_python(content)
    _check(result)
    _check_trajectory(result)
    return result


@cache
def _result_adapter() -> TypeAdapter[Result]:
    """Return the validator of results; building it takes 8 ms, much longer than validating a file."""
    return TypeAdapter(Result)


class _AssetRecord(BaseModel):
    """The asset of a result."""

    model_config = ConfigDict(strict=True, extra="ignore")

    file: str
    kind: Annotated[AssetKind, Field(strict=False)]
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{8,64}$")]
    edited: bool
    changes: list[str]
    scene: str = ""


def _check(result: Result) -> None:
    """Check values that the types do not check."""
    if result.asset:
        _AssetRecord.model_validate(result.asset)
    recorded_variant(result.id, result.task_file)
    choices = [
        ("score.kind", result.score.kind, Kind),
        ("marker_proxy", result.marker_proxy, MarkerProxy),
        *(
            (f"dataset.{key}", result.dataset.get(key), DataSource)
            for key in BUNDLED_DATA
        ),
    ]
    for key, value, known in choices:
        if value not in tuple(known):
            raise ValueError(f"{key} is {value!r}, expected one of {', '.join(known)}")


def _check_trajectory(result: Result) -> None:
    """Check a trajectory beyond its types."""
    trajectory = result.trajectory
    if trajectory is None:
        raise ValueError("it has no trajectory")
    if not trajectory.samples.size:
        raise ValueError("trajectory: it has no samples")
    times_s, samples = trajectory.arrays()
    # A comparison with NaN is false.
    if not (np.diff(times_s) > 0.0).all():
        raise ValueError("trajectory.times_s: increasing times are expected")
    largest = np.nanmax(np.abs(samples), initial=0.0)
    if result.outcome is Outcome.FINISHED and largest > LARGEST:
        raise ValueError(
            f"trajectory.samples: amounts of at most {LARGEST:g} are expected"
        )


# --- the scene of a result ---


def result_of(experiment: Experiment, **values: Any) -> Result:
    """Return a result with the facts of its experiment.

    Args:
        experiment: The experiment.
        **values: The other fields of the result.
    """
    return Result(
        id=experiment.id,
        task_sha256=experiment.file_sha256,
        revision=experiment.revision,
        driver_provenance=experiment.driver_provenance,
        dataset=dataset_record(
            experiment.name,
            drivers=experiment.drivers,
            reference=experiment.reference_source,
        ),
        asset=_asset_record(experiment),
        task_file=_own_task_file(experiment),
        **values,
    )


def _own_task_file(experiment: Experiment) -> str | None:
    """Return the path of the user's task file that has an experiment; None for the ids of the package."""
    file = task_path(experiment.spec.family)
    return str(file) if file in own_task_files() else None


def _asset_record(experiment: Experiment) -> dict[str, Any]:
    """Return the record of an experiment's asset for its result; empty without an asset."""
    asset = experiment.asset
    if asset is None:
        return {}
    record = asset.to_dict()
    # For a model file the scene is that of the variant, because only its engine could read the file back.
    if asset.kind is AssetKind.USD and asset.edited:
        with needs_extra("the scene of the result", "usd"):
            from gauge_envs.formats.usd import to_usd

        with TemporaryDirectory() as folder:
            path = Path(folder) / "scene.usda"
            to_usd(experiment.scene, path)
            record["scene"] = path.read_text(encoding="utf-8")
    return record


def recorded_experiment(result: Result) -> Experiment:
    """Return the experiment of a result with its scene; it needs no other file.

    If the scene came from a model file of an engine, the scene is that of the variant.
    """
    record = result.asset
    revision = task_spec(find_variant(result.id).family).revision
    if result.revision != revision:
        raise ResultFileError(
            f"{result.id}: it has revision {result.revision}, and the installed package revision {revision}: "
            f"use gauge-envs {result.versions.get('gauge-envs')} for it"
        )
    if not record or "scene" not in record:
        return load_experiment(
            result.id,
            result.parameters,
            drivers=result.dataset["drivers"],
            reference=result.dataset["reference"],
        )
    with needs_extra("the scene of the result", "usd"):
        from gauge_envs.formats.usd import read_usd

    with TemporaryDirectory() as folder:
        path = Path(folder) / "scene.usda"
        path.write_text(record["scene"], encoding="utf-8")
        try:
            scene = read_usd(path).scene
        except AssetError as error:
            reason = error.reason.replace(str(path), "line")
            raise ResultFileError(
                f"{result.id}: the scene of the result: {reason}"
            ) from error
    experiment = load_experiment(result.id, reference=result.dataset["reference"])
    asset = Asset(
        path=Path(record["file"]),
        kind=AssetKind(record["kind"]),
        sha256=record["sha256"],
        edited=record["edited"],
        changes=tuple(scene_changes(experiment.scene, scene)),
    )
    return replace(experiment, scene=scene, asset=asset)
