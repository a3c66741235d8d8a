"""The record of an asset in a result file, and the experiment that it restores."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from gauge_envs.errors import GaugeError, ResultFileError
from gauge_envs.experiments.experiment import Asset, AssetKind, Experiment, driver_provenance
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.user_file import FileExperiment, experiment_record, recorded_experiment_file
from gauge_envs.runs.result import Result
from gauge_envs.scene import Scene
from gauge_envs.scene.usd.reader import from_usd
from gauge_envs.scene.usd.writer import to_usd


def asset_record(experiment: Experiment) -> dict[str, Any]:
    """Return the record of an experiment's asset for its result; empty without an asset."""
    asset = experiment.asset
    if asset is None:
        return {}
    record = asset.to_dict()
    # The scene of a model file is that of the variant; only its engine could read the file back.
    if asset.kind is AssetKind.EXPERIMENT or (asset.kind is AssetKind.USD and asset.edited):
        record["scene"] = _scene_text(experiment.scene)
    if isinstance(experiment, FileExperiment):
        record["experiment"] = experiment_record(experiment)
    return record


def recorded_experiment(result: Result) -> Experiment:
    """Return the experiment of a result with the scene that ran; it needs no other file.

    If an engine's model file stated the scene, the scene is that of the variant.
    """
    record = result.asset
    if not record or "scene" not in record:
        return load_experiment(
            result.id, result.parameters, drivers=result.dataset["drivers"], reference=result.dataset["reference"]
        )
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
    experiment = load_experiment(result.id, reference=result.dataset["reference"])
    return replace(experiment, scene=scene, asset=asset, driver_provenance=driver_provenance(scene))


def _scene_text(scene: Scene) -> str:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "scene.usda"
        to_usd(scene, path)
        return path.read_text(encoding="utf-8")


def _scene_of_text(text: str) -> Scene:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "scene.usda"
        path.write_text(text, encoding="utf-8")
        return from_usd(path)
