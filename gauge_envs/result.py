"""The result of one episode and its file, which holds all that is needed to judge, plot or repeat the episode."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import UTC, datetime
from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from gauge_envs.asset import Asset, AssetKind
from gauge_envs.driver import DriverSource
from gauge_envs.errors import GaugeError, ResultFileError, UnknownNameError
from gauge_envs.experiment import Experiment, driver_provenance, experiment
from gauge_envs.experiment_file import FileExperiment, experiment_record, recorded_experiment_file
from gauge_envs.scene import Scene
from gauge_envs.score import Score
from gauge_envs.task import find_variant

__all__ = [
    "Outcome",
    "RecordedTrajectory",
    "Result",
    "asset_record",
    "json_ready",
    "load_result",
    "recorded_experiment",
    "result_file_name",
    "versions",
    "write_result",
]


BULKY = ("scene", "experiment")
"""Parts of a result's asset that only reading it back needs."""


def versions() -> dict[str, str]:
    """Versions of gauge-envs, gymnasium, numpy and python."""
    packages = {name: version(name) for name in ("gauge-envs", "gymnasium", "numpy")}
    return packages | {"python": platform.python_version()}


class Outcome(StrEnum):
    """How an episode ended."""

    FINISHED = "finished"
    """It ran to its last frame."""
    DIVERGED = "diverged"
    """The simulation left what is physically possible; there is no score."""
    DECLINED = "declined"
    """Not run: the backend cannot build the scene, or the experiment lacks the parameters that were asked for."""
    FAILED = "failed"
    """Not run to the end because of an error."""


@dataclass(frozen=True, kw_only=True)
class RecordedTrajectory:
    """What an episode did, dense enough to plot and to score again.

    Attributes:
        unit: Unit of the samples.
        coordinates: Names of the coordinates, as `cube.x`.
        times_s: Times [s], 180 a second, shape [sample_count].
        samples: g(t) at those times, shape [sample_count, coordinate_count]; None where a diverged one was not finite.
    """

    unit: str
    coordinates: list[str]
    times_s: list[float]
    samples: list[list[float | None]]

    def __post_init__(self) -> None:
        if len(self.samples) != len(self.times_s):
            raise ValueError(f"{len(self.times_s)} times but {len(self.samples)} samples")
        if any(len(row) != len(self.coordinates) for row in self.samples):
            raise ValueError(f"a sample has not {len(self.coordinates)} coordinates")

    def arrays(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Times [s], shape [sample_count], and g(t), shape [sample_count, coordinate_count], NaN for None."""
        samples = np.array(self.samples, dtype=np.float64)
        return np.array(self.times_s), samples.reshape(len(self.times_s), len(self.coordinates))


@dataclass(frozen=True, kw_only=True)
class Result:
    """One episode, or one trajectory that a user brought (then `backend`, `seed` and `wall_s` are None).

    Attributes:
        id: Gymnasium id.
        outcome: How the episode ended.
        backend: Name of the physics engine.
        parameters: Name of the parameter set, or the overrides.
        frames: Frames that there are, the first included.
        diverged: Whether the simulation left what is physically possible.
        diverged_reason: How it did.
        wall_s: Time that reset and steps took [s], building the scene not included; for one of several that ran
            together, its share.
        sim_s: Simulated time [s].
        settings: Every numerical setting of the engine that was in force.
        settings_given: Those of them that the caller gave.
        versions: Versions of the engine, gauge-envs, gymnasium, numpy and python.
        seed: Seed of the reset and of the jitter.
        jitter: How far the start was moved at random, as standard deviations; empty where it was not.
        score: Distance to reality; metrics are None where they do not apply.
        task_sha256: Hash of the task file that the episode was built from; of an experiment file and all that it names.
        marker_proxy: What stood for a marker on a deformable body: `node` or `material`.
        driver_provenance: Where the driven motion is from; None where nothing is driven.
        dataset: Import of real trials that score or drivers rest on: `revision`, `sha256` over its trials, `drivers`
            (`imported`, `bundled` or `none recorded`); empty where nothing was imported.
        asset: File that the scene was from: its name `file`, `kind`, `sha256`, whether it is `edited` and in which
            `changes`; with the `scene` as text of a USD layer where the package does not have it, and the
            `experiment` of an experiment file. Empty where the task file stated the scene.
        created: When, ISO 8601, UTC.
        error: Why it was declined or failed.
        trajectory: What it did; None when it did not run.
    """

    id: str
    outcome: Outcome
    parameters: str | dict[str, Any]
    score: Score
    task_sha256: str
    backend: str | None = None
    frames: int = 0
    diverged: bool = False
    diverged_reason: str | None = None
    wall_s: float | None = None
    sim_s: float = 0.0
    settings: dict[str, Any] = field(default_factory=dict)
    settings_given: dict[str, Any] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=versions)
    seed: int | None = None
    jitter: dict[str, float] = field(default_factory=dict)
    marker_proxy: str = "node"
    driver_provenance: str | None = None
    dataset: dict[str, str] = field(default_factory=dict)
    asset: dict[str, Any] = field(default_factory=dict)
    created: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    error: str | None = None
    trajectory: RecordedTrajectory | None = None

    @property
    def is_edited(self) -> bool:
        """Whether the scene was that of an asset which differs from the calibrated one."""
        return bool(self.asset.get("edited"))

    @property
    def has_experiment_file(self) -> bool:
        """Whether it is of an experiment that a user's file states, which the package does not have."""
        return self.asset.get("kind") == AssetKind.EXPERIMENT

    def to_dict(self, *, trajectory: bool = True) -> dict[str, Any]:
        """JSON-ready dictionary, every field present; without the bulky trajectory and scene on request."""
        kept = self if trajectory else replace(self, trajectory=None)
        values = json_ready(asdict(kept)) | {"score": json_ready(self.score.to_dict())}
        if not trajectory:
            del values["trajectory"]
            values["asset"] = {key: value for key, value in values["asset"].items() if key not in BULKY}
        return values


def json_ready(value: Any) -> Any:
    """Plain containers, None for numbers that are not finite: JSON has neither NaN nor infinity."""
    if isinstance(value, Mapping):
        return {str(key): json_ready(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [json_ready(entry) for entry in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value


def result_file_name(result: Result) -> str:
    """`SlopeSlider-2-wood.mujoco.calibrated.json`; what else was chosen by a hash, seeds other than 0."""
    named = result.parameters
    parts = [result.id.removeprefix("GAUGE/"), result.backend or "file"]
    parts.append(re.sub(r"[^\w-]", "_", named) if isinstance(named, str) else f"custom-{_digest(named)}")
    if result.is_edited:
        parts.append(f"asset-{result.asset['sha256'][:8]}")
    if result.settings_given:
        parts.append(f"settings-{_digest(result.settings_given)}")
    if result.jitter:
        parts.append(f"jitter-{_digest(result.jitter)}")
    if result.marker_proxy != "node":
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
    part = file.with_name(f".{file.name}.{os.getpid()}.tmp")
    try:
        with part.open("w", encoding="utf-8") as stream:
            json.dump(result.to_dict(), stream, allow_nan=False)
            stream.write("\n")
            stream.flush()
            os.fsync(stream.fileno())
        part.replace(file)
    except OSError as error:
        raise ResultFileError(f"{file}: cannot be written: {error.strerror or error}") from error
    finally:
        part.unlink(missing_ok=True)


def load_result(file: Path) -> Result:
    """Read a result file.

    Raises:
        ResultFileError: It cannot be read, or is not a whole and consistent result file.
    """
    try:
        content = json.loads(file.read_bytes())
        if not isinstance(content, dict):
            raise ValueError(f"expected a JSON object, got a {type(content).__name__}")
        # Older files lack these keys, and stand for the defaults.
        content.setdefault("jitter", {})
        content.setdefault("marker_proxy", "node")
        content.setdefault("dataset", {})
        content.setdefault("asset", {})
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
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise ResultFileError(f"{file}: not a result file: {place}: {first['msg']}") from error
    except (ValueError, RecursionError, UnknownNameError) as error:
        raise ResultFileError(f"{file}: not a result file: {error}") from error
    return result


# --- the experiment of a result --------------------------------------------------------------------------------------


def asset_record(resolved: Experiment) -> dict[str, Any]:
    """What a result keeps of the asset that an experiment was built from; empty where there was none."""
    asset = resolved.asset
    if asset is None:
        return {}
    record = asset.to_dict()
    # A model file stands for a scene that the package has; the engine alone could read it back.
    if asset.kind is AssetKind.EXPERIMENT or (asset.kind is AssetKind.USD and asset.edited):
        record["scene"] = _scene_text(resolved.scene)
    if isinstance(resolved, FileExperiment):
        record["experiment"] = experiment_record(resolved)
    return record


def recorded_experiment(result: Result) -> Experiment:
    """The experiment that a result is of, with the scene that it ran; needs no file but the result's.

    Where an engine's own model file stood for the scene, the scene is that of the variant.

    Raises:
        GaugeError: The package no longer has the variant or its parameters, or the result's asset is damaged.
    """
    record = result.asset
    if not record or "scene" not in record:
        drivers = result.dataset.get("drivers")
        source = drivers if drivers in tuple(DriverSource) else None
        return experiment(result.id, result.parameters, drivers=source)
    try:
        scene = _scene_of_text(record["scene"])
        asset = Asset(
            path=Path(record["file"]),
            kind=AssetKind(record["kind"]),
            sha256=record["sha256"],
            edited=record["edited"],
            changes=tuple(record["changes"]),
        )
        if result.has_experiment_file:
            return recorded_experiment_file(record["experiment"], scene, asset=asset, file_sha256=result.task_sha256)
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, GaugeError):
            raise
        raise ResultFileError(f"{result.id}: the asset in the result is damaged: {error}") from error
    resolved = experiment(result.id, drivers=DriverSource.BUNDLED)
    return replace(resolved, scene=scene, asset=asset, driver_provenance=driver_provenance(scene))


def _scene_text(scene: Scene) -> str:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "scene.usda"
        scene.to_usd(path)
        return path.read_text(encoding="utf-8")


def _scene_of_text(text: str) -> Scene:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "scene.usda"
        path.write_text(text, encoding="utf-8")
        return Scene.from_usd(path)
