"""Take the scene of a variant from an asset: a USD layer or a model file of an engine.

The file has bodies, constants and driven motion. Observation, duration and reference stay those of the variant. The
file must have the recorded bodies, which move under forces, and the bodies with markers.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from gauge_envs.errors import AssetError
from gauge_envs.experiments.experiment import Asset, AssetKind, Experiment
from gauge_envs.formats import USD_SUFFIXES
from gauge_envs.names import first_names
from gauge_envs.optional import needs_extra
from gauge_envs.reading import reading
from gauge_envs.references.metrics import EVENT_METRICS
from gauge_envs.scene import Motion
from gauge_envs.scene.diff import Change, scene_changes

if TYPE_CHECKING:
    from gauge_envs.formats.usd import UsdScene

MODEL_SUFFIX = ".xml"
"""Suffix of MJCF files, which only MuJoCo reads."""


def with_asset(experiment: Experiment, path: Path) -> Experiment:
    """Return an experiment with the scene of a file.

    Args:
        experiment: Experiment with its published scene and bundled drivers.
        path: USD layer or MJCF file.
    """
    digests = [_digest(path)]
    changes: tuple[Change, ...]
    if path.suffix in USD_SUFFIXES:
        layer = _scene_of_file(experiment, path)
        kind, scene = AssetKind.USD, layer.scene
        digests += map(_digest, layer.used_files)
        changes = tuple(scene_changes(experiment.scene, scene))
    elif path.suffix == MODEL_SUFFIX:
        # MuJoCo is imported at its first use.
        from gauge_envs.backends.mujoco.mjcf.reader import read_model

        kind = AssetKind.MODEL
        scene, changes = read_model(path, experiment.scene)
    else:
        known = ", ".join(USD_SUFFIXES)
        raise AssetError(
            path,
            "",
            f"suffix {path.suffix!r} is neither a scene file ({known}) nor a model file ({MODEL_SUFFIX})",
        )
    # A stage of several files has the hash of their hashes.
    digest = digests[0]
    if len(digests) > 1:
        digest = hashlib.sha256(b"".join(digests)).digest()
    candidate = replace(
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
    for place, reason in _misfits(candidate, experiment):
        raise AssetError(path, place, reason)
    return candidate


def _digest(path: Path) -> bytes:
    with reading(path, AssetError) as content:
        return hashlib.sha256(content).digest()


def _scene_of_file(experiment: Experiment, path: Path) -> UsdScene:
    """Return the content of a USD layer; raise an error if it belongs to another variant."""
    duration_s = experiment.scene.duration_s
    with needs_extra(f"a file {path.suffix}", "usd"):
        from gauge_envs.formats.usd import read_usd

    layer = read_usd(path, duration_s=duration_s)
    name = experiment.name
    origin = layer.metadata.get("variant", name)
    if origin != name:
        reason = f"it is the scene of {origin}, not of {name}; to use it anyway, delete 'variant' there"
        raise AssetError(path, "customLayerData", reason)
    if not math.isclose(layer.scene.duration_s, duration_s, rel_tol=1e-9):
        reason = f"it lasts {layer.scene.duration_s:.10g} s, but an episode of {name} lasts {duration_s:.10g} s"
        raise AssetError(path, "gauge:duration_s", reason)
    return layer


def _misfits(candidate: Experiment, wanted: Experiment) -> Iterator[tuple[str, str]]:
    """Yield place and reason of everything observed that the scene of an asset lacks."""
    scene, name = candidate.scene, candidate.name
    bodies = {body.name: body for body in scene.bodies}
    for body in candidate.recorded:
        if body not in bodies:
            yield (
                body,
                f"{name} records this body, but the file has only: {first_names([*bodies])}",
            )
        if bodies[body].motion is not Motion.DYNAMIC:
            yield (
                body,
                f"{name} records it, so it must be dynamic, but it is {bodies[body].motion}",
            )
    if not candidate.recorded and scene.markers is None:
        yield "", f"{name} records markers, but the file has none"
    for body in scene.markers.bodies if scene.markers is not None else ():
        if body in bodies:
            yield (
                body,
                "it is rigid, but markers need the nodes of a deformable body",
            )
    counts = len(candidate.coordinates), len(wanted.coordinates)
    if counts[0] != counts[1]:
        yield "markers", f"it has {counts[0]} coordinates, but {name} has {counts[1]}"
    events = [metric for metric in candidate.score.metrics if metric in EVENT_METRICS]
    if events and candidate.recorded[0] not in scene.hinges:
        yield (
            candidate.recorded[0],
            f"it has no hinge, but {', '.join(events)} need one",
        )
