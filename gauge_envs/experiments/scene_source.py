"""Take the scene of a variant from an asset: a USD layer, or a model file of an engine.

The file states bodies, constants and driven motion. Observation, duration and reference stay those of the variant. The
file must fit the variant: it has the recorded bodies, which move under forces, and the bodies that carry markers.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from gauge_envs.errors import AssetError, first_names
from gauge_envs.experiments.experiment import Asset, AssetKind, Experiment
from gauge_envs.files import os_errors
from gauge_envs.references.metrics import EVENT_METRICS
from gauge_envs.registry import MODEL_SUFFIX, SCENE_SUFFIXES, model_files, scene_files
from gauge_envs.scene import Motion
from gauge_envs.scene.diff import scene_changes

RECORDED_SUFFIX = ".usda"
"""Suffix of the scene file in a result."""


def with_asset(experiment: Experiment, path: Path) -> Experiment:
    """Return an experiment with the scene of a file.

    Args:
        experiment: Experiment with its calibrated scene and bundled drivers.
        path: USD layer or MJCF file.
    """
    digests = [_digest(path)]
    changes: tuple[str, ...]
    if path.suffix in SCENE_SUFFIXES:
        layer = _scene_of_file(experiment, path)
        kind, scene = AssetKind.USD, layer.scene
        digests += map(_digest, layer.used_files)
        changes = tuple(scene_changes(experiment.scene, scene))
    elif path.suffix == MODEL_SUFFIX:
        kind = AssetKind.MODEL
        scene, changes = model_files().read_model(path, experiment.scene)
    else:
        known = ", ".join(SCENE_SUFFIXES)
        raise AssetError(
            path,
            "",
            f"suffix {path.suffix!r} is neither that of a scene file ({known}) nor an engine's",
        )
    # One file has its own hash; a stage of several has that of their hashes.
    digest = digests[0]
    if len(digests) > 1:
        digest = hashlib.sha256(b"".join(digests)).digest()
    found = replace(
        experiment,
        scene=scene,
        asset=Asset(
            path=path,
            kind=kind,
            sha256=digest.hex(),
            edited=bool(changes),
            changes=changes,
        ),
    )
    for place, reason in _misfits(found, experiment):
        raise AssetError(path, place, reason)
    return found


def _digest(path: Path) -> bytes:
    with os_errors(lambda cause: AssetError(path, "", f"cannot be read: {cause}")):
        return hashlib.sha256(path.read_bytes()).digest()


def _scene_of_file(experiment: Experiment, path: Path) -> Any:
    """Return what a USD layer states; raise an error if it is of another variant."""
    duration_s = experiment.scene.duration_s
    found = scene_files(path.suffix).read_scene(path, duration_s=duration_s)
    of, name = found.metadata.get("variant", experiment.name), experiment.name
    if of != name:
        reason = f"it is the scene of {of}, not of {name}; to use it anyway, delete 'variant' there"
        raise AssetError(path, "customLayerData", reason)
    if not math.isclose(found.scene.duration_s, duration_s, rel_tol=1e-9):
        reason = f"it lasts {found.scene.duration_s:.10g} s, but an episode of {name} lasts {duration_s:.10g} s"
        raise AssetError(path, "gauge:duration_s", reason)
    return found


def _misfits(found: Experiment, wanted: Experiment) -> Iterator[tuple[str, str]]:
    """Yield place and reason of what the scene of an asset lacks of that which an experiment observes."""
    scene, name = found.scene, found.name
    bodies = {body.name: body for body in scene.bodies}
    for body in found.recorded:
        if body not in bodies:
            yield (
                body,
                f"no body of that name, which {name} records; it has: {first_names([*bodies])}",
            )
        if bodies[body].motion is not Motion.DYNAMIC:
            yield (
                body,
                f"{name} records it, so it must move under forces: {bodies[body].motion}",
            )
    if not found.recorded and scene.markers is None:
        yield "", f"no markers, which {name} records"
    for body in scene.markers.bodies if scene.markers is not None else ():
        if body in bodies:
            yield (
                body,
                "it is rigid, and markers are read off the nodes of deformable bodies",
            )
    counts = len(found.coordinates), len(wanted.coordinates)
    if counts[0] != counts[1]:
        yield "markers", f"{counts[0]} coordinates, {name} has {counts[1]}"
    events = [metric for metric in found.score.metrics if metric in EVENT_METRICS]
    if events and found.recorded[0] not in scene.hinges:
        yield (
            found.recorded[0],
            f"no hinge, which {', '.join(events)} are measured from",
        )
