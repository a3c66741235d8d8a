"""Take the scene of a variant from an asset: a USD layer, or a model file of an engine.

The file states bodies, constants and driven motion. Observation, duration and reference stay those of the variant. The
file must fit the variant: it has the recorded bodies, which move under forces, and the bodies that carry markers.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from gauge_envs.backends.registry import backend_of_suffix
from gauge_envs.errors import AssetError, first_names
from gauge_envs.experiments.experiment import Asset, AssetKind, Experiment
from gauge_envs.files import os_errors
from gauge_envs.references.metrics import EVENT_METRICS
from gauge_envs.registry import SCENE_SUFFIXES, scene_files
from gauge_envs.scene import Hinge, Motion
from gauge_envs.scene.diff import scene_changes

RECORDED_SUFFIX = ".usda"
"""Suffix of the scene file in a result."""


def with_asset(experiment: Experiment, path: Path) -> Experiment:
    """Return an experiment with the scene of a file.

    Args:
        experiment: Experiment with its calibrated scene and bundled drivers.
        path: USD layer, or model file of an installed engine.
    """
    digests = [_digest(path)]
    changes: tuple[str, ...]
    if path.suffix in SCENE_SUFFIXES:
        layer = _scene_of_file(experiment, path)
        kind, scene = AssetKind.USD, layer.scene
        digests += map(_digest, layer.used_files)
        changes = tuple(scene_changes(experiment.scene, scene))
    elif (engine := backend_of_suffix(path.suffix)) is not None:
        kind, file = AssetKind.MODEL, engine.read_file(path, experiment.scene)
        scene, changes = file.scene, file.changes
    else:
        known = ", ".join(SCENE_SUFFIXES)
        raise AssetError(
            path,
            "",
            f"suffix {path.suffix!r} is neither that of a scene file ({known}) nor an engine's",
        )
    found = replace(
        experiment,
        scene=scene,
        asset=Asset(
            path=path,
            kind=kind,
            sha256=digests[0].hex() if len(digests) == 1 else _joint_digest(digests),
            edited=bool(changes),
            changes=changes,
        ),
    )
    _check_fit(found, experiment)
    return found


def _digest(path: Path) -> bytes:
    with os_errors(lambda cause: AssetError(path, "", f"cannot be read: {cause}")):
        return hashlib.sha256(path.read_bytes()).digest()


def _joint_digest(digests: Sequence[bytes]) -> str:
    """Return the hash of the hashes of a file and of those that it refers to, in the given order."""
    return hashlib.sha256(b"".join(digests)).hexdigest()


def _scene_of_file(experiment: Experiment, path: Path) -> Any:
    duration_s = experiment.scene.duration_s
    found = scene_files(path.suffix).read_scene(path, duration_s=duration_s)
    of = found.metadata.get("variant", experiment.name)
    if of != experiment.name:
        raise AssetError(
            path,
            "customLayerData",
            f"it is the scene of {of}, not of {experiment.name}; to use it anyway, delete 'variant' there",
        )
    if not math.isclose(found.scene.duration_s, duration_s, rel_tol=1e-9):
        raise AssetError(
            path,
            "gauge:duration_s",
            f"it lasts {found.scene.duration_s:.10g} s, but an episode of {experiment.name} lasts {duration_s:.10g} s",
        )
    return found


def _check_fit(found: Experiment, wanted: Experiment) -> None:
    """Raise an error if an experiment with the scene of its asset lacks what the wanted one observes."""
    assert found.asset is not None
    path, scene = found.asset.path, found.scene
    names = [body.name for body in scene.bodies]
    for name in found.recorded:
        if name not in names:
            raise AssetError(
                path,
                name,
                f"no body of that name, which {found.name} records; it has: {first_names(names)}",
            )
        if scene.body(name).motion is not Motion.DYNAMIC:
            raise AssetError(
                path,
                name,
                f"{found.name} records it, so it must move under forces: {scene.body(name).motion}",
            )
    if not found.recorded:
        if scene.markers is None:
            raise AssetError(path, "", f"no markers, which {found.name} records")
        known = [body.name for body in scene.deformables]
        for name in scene.markers.bodies:
            if name not in known:
                raise AssetError(
                    path,
                    name,
                    f"no deformable body of that name carries markers; it has: {first_names(known)}; markers are read "
                    "off nodes, and rigid bodies have none: record those by position",
                )
        count = len(wanted.coordinates)
        if len(found.coordinates) != count:
            raise AssetError(
                path,
                "markers",
                f"{len(found.coordinates)} coordinates, {found.name} has {count}",
            )
    hinged = {joint.body for joint in scene.joints if isinstance(joint, Hinge)}
    if (
        not set(EVENT_METRICS).isdisjoint(found.score.metrics)
        and found.recorded[0] not in hinged
    ):
        raise AssetError(
            path,
            found.recorded[0],
            f"no hinge, which {', '.join(found.score.metrics)} are measured from",
        )
