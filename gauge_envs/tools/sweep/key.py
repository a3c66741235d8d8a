"""Content keys: two episodes have the same key if and only if they must give the same result.

A key is a SHA-256 over everything that the trajectory and the score of an episode follow from: the scene, the hash of
its task file, the engine with its version and its resolved settings, the parameters, the jitter and the seed.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any

import numpy as np

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.files import json_ready
from gauge_envs.references.imported import dataset_record

KEY_FORMAT = 1
"""Number of this way to make keys; another way gets another number, so that no old result is taken for a new one."""

KEY_LENGTH = 16
"""Hexadecimal digits of a key in a file name: among a million episodes, two share them with a probability of 3e-8."""


def content_sha256(value: Any) -> str:
    """Return the hash of a value of dataclasses, mappings, sequences, arrays, enums, numbers, texts and None."""
    return hashlib.sha256(json.dumps(_plain(value), sort_keys=True, allow_nan=True).encode()).hexdigest()


def _plain(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        # What is not compared is derived from the other fields.
        kept = {field.name: _plain(getattr(value, field.name)) for field in fields(value) if field.compare}
        return {"type": type(value).__name__, **kept}
    if isinstance(value, Enum):
        return _plain(value.value)
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.ndarray | np.generic):
        return {"shape": list(np.shape(value)), "values": np.asarray(value).tolist()}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"{type(value).__name__} has no content hash")


def experiment_sha256(experiment: Experiment) -> str:
    """Return the hash of what is simulated and how it is scored, apart from engine, jitter and seed."""
    asset = experiment.asset
    return content_sha256(
        {
            "id": experiment.id,
            "task": experiment.file_sha256,
            "scene": experiment.scene,
            "recorded": experiment.recorded,
            "frames": experiment.frame_count,
            "trial": experiment.trial,
            "asset": None if asset is None else asset.sha256,
            "dataset": dataset_record(
                experiment.name, drivers=experiment.drivers, reference=experiment.reference_source
            ),
        }
    )


def run_sha256(
    experiment: str,
    *,
    backend: str,
    versions: Mapping[str, str],
    settings: str,
    parameters: Any,
    jitter: Mapping[str, float] | None,
) -> str:
    """Return the hash that the episodes of a run share; they differ in their seeds.

    Args:
        experiment: `experiment_sha256`.
        backend: Name of the engine.
        versions: Versions of the engine's packages and of gauge-envs.
        settings: Hash of the resolved settings, or of the given ones where an engine does not resolve them.
        parameters: Name of the parameter set, or the overrides.
        jitter: Standard deviations of the start and the number of the way to draw it; None for the start that the
            experiment states for a seed.
    """
    return content_sha256(
        {
            "format": KEY_FORMAT,
            "experiment": experiment,
            "backend": backend,
            "versions": dict(versions),
            "settings": settings,
            "parameters": json_ready(parameters),
            "jitter": jitter,
        }
    )


def episode_key(run: str, seed: int) -> str:
    """Return the key of an episode: 64 hexadecimal digits.

    Args:
        run: `run_sha256`.
        seed: Seed of the reset and of the jitter.
    """
    return hashlib.sha256(f"{run}:{seed}".encode()).hexdigest()
