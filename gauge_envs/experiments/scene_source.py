"""Take the scene of a variant from an asset: a USD layer, or a model file of an engine.

The file states bodies, constants and driven motion. Observation, duration and reference stay those of the variant. The
file must fit the variant: it has the recorded bodies, which move under forces, and the bodies that carry markers.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gauge_envs.errors import AssetError
from gauge_envs.experiments.experiment import Asset, AssetKind
from gauge_envs.files import MEGABYTE, os_errors, read_regular
from gauge_envs.references.metrics import EVENT_METRICS
from gauge_envs.scene import Hinge, Motion
from gauge_envs.scene.bodies import Attachment, BodyHinge, Contact
from gauge_envs.scene.scene import Scene

if TYPE_CHECKING:
    from gauge_envs.experiments.experiment import Experiment, TaskExperiment
    from gauge_envs.scene.usd.reader import UsdScene

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
"""Suffixes of USD layers."""

MOST_ASSET_BYTES = 256 * MEGABYTE
"""Largest size of an asset or of a file that it refers to."""


def read_bytes(path: Path) -> bytes:
    """Return the content of an asset."""
    with os_errors(lambda cause: AssetError(path, "", f"cannot be read: {cause}")):
        return read_regular(path, MOST_ASSET_BYTES)


def contents_sha256(contents: Sequence[bytes]) -> str:
    """Return the hash of one file, or of the hashes of several files in the given order."""
    if len(contents) == 1:
        return hashlib.sha256(contents[0]).hexdigest()
    return hashlib.sha256(b"".join(hashlib.sha256(content).digest() for content in contents)).hexdigest()


# --- the scene of a variant, from a file -----------------------------------------------------------------------------


def with_asset(experiment: TaskExperiment, path: Path) -> TaskExperiment:
    """Return an experiment with the scene of a file.

    Args:
        experiment: Experiment with its calibrated scene and bundled drivers.
        path: USD layer, or model file of an installed engine.
    """
    from gauge_envs.backends.registry import backend_of_suffix
    from gauge_envs.experiments.experiment import driver_provenance

    contents = [read_bytes(path)]
    changes: tuple[str, ...]
    if path.suffix in USD_SUFFIXES:
        layer = _usd_scene(experiment, path)
        kind, scene = AssetKind.USD, layer.scene
        contents += map(read_bytes, layer.used_files)
        changes = tuple(scene_changes(experiment.scene, scene))
    elif (engine := backend_of_suffix(path.suffix)) is not None:
        kind, file = AssetKind.MODEL, engine.read_file(path, experiment.scene)
        scene, changes = file.scene, file.changes
    else:
        raise AssetError(path, "", f"suffix {path.suffix!r} is neither USD ({', '.join(USD_SUFFIXES)}) nor an engine's")
    found = replace(
        experiment,
        scene=scene,
        driver_provenance=driver_provenance(scene),
        asset=Asset(path=path, kind=kind, sha256=contents_sha256(contents), edited=bool(changes), changes=changes),
    )
    check_fit(found, experiment)
    return found


def _usd_scene(experiment: TaskExperiment, path: Path) -> UsdScene:
    from gauge_envs.scene.usd.reader import read_usd

    duration_s = experiment.scene.duration_s
    found = read_usd(path, duration_s=duration_s)
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


def check_fit(found: Experiment, wanted: Experiment) -> None:
    """Raise an error if the scene of an asset lacks what the experiment observes.

    Args:
        found: Experiment with the scene of its asset.
        wanted: Experiment with the scene that states what is observed.
    """
    assert found.asset is not None
    path, scene = found.asset.path, found.scene
    names = [body.name for body in scene.bodies]
    for name in found.recorded:
        if name not in names:
            raise AssetError(path, name, f"no body of that name, which {found.name} records; it has: {_listed(names)}")
        if scene.body(name).motion is not Motion.DYNAMIC:
            raise AssetError(
                path, name, f"{found.name} records it, so it must move under forces: {scene.body(name).motion}"
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
                    f"no deformable body of that name carries markers; it has: {_listed(known)}; markers are read off "
                    "nodes, and rigid bodies have none: record those by position",
                )
        count = len(wanted.coordinates)
        if len(found.coordinates) != count:
            raise AssetError(path, "markers", f"{len(found.coordinates)} coordinates, {found.name} has {count}")
    hinged = {joint.body for joint in scene.joints if isinstance(joint, Hinge)}
    if not set(EVENT_METRICS).isdisjoint(found.score.metrics) and found.recorded[0] not in hinged:
        raise AssetError(path, found.recorded[0], f"no hinge, which {', '.join(found.score.metrics)} are measured from")


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - 12} more" if len(names) > 12 else ""
    return ", ".join(names[:12]) + more if names else "none"


MOST_NAMES = 4
"""Largest number of names of a group that a line lists."""

MOST_NUMBERS = 9
"""Largest array whose numbers a line lists; larger ones are summarized by count and largest difference."""


def scene_changes(before: Scene, after: Scene) -> Iterator[str]:
    """Yield one line for each difference between two scenes, field by field."""
    if before == after:
        return
    for field in fields(Scene):
        if not field.compare:
            continue
        old, new = getattr(before, field.name), getattr(after, field.name)
        if old == new:
            continue
        if isinstance(old, tuple) and isinstance(new, tuple):
            yield from _group_changes(field.name, old, new)
        else:
            yield from _value_changes("scene", field.name, old, new)


def _group_changes(group: str, before: Sequence[Any], after: Sequence[Any]) -> Iterator[str]:
    """Yield the changes of a group such as bodies or contacts; entries without a match count as added or removed."""
    old, new = _titled(before), _titled(after)
    yield from (f"{title}: removed" for title in old if title not in new)
    yield from (f"{title}: added" for title in new if title not in old)
    common = [title for title in old if title in new]
    for title in common:
        if old[title] != new[title]:
            yield from _value_changes(title, "", old[title], new[title])
    if common != [title for title in new if title in old]:
        yield f"{group}: in another order"


def _titled(entries: Sequence[Any]) -> dict[str, Any]:
    titles: dict[str, Any] = {}
    for entry in entries:
        title = _title(entry)
        count = 2
        while title in titles:
            title, count = f"{_title(entry)} ({count})", count + 1
        titles[title] = entry
    return titles


def _title(entry: Any) -> str:
    if isinstance(entry, Contact):
        return f"contact {_side(entry.first)}/{_side(entry.second)}"
    if isinstance(entry, Attachment):
        return f"attachment of {entry.deformable} to {entry.to}"
    if isinstance(entry, BodyHinge):
        return f"hinge of {entry.first} and {entry.second}"
    name = getattr(entry, "name", None)
    return name if name is not None else f"{type(entry).__name__.lower()} of {entry.body}"


def _side(names: Sequence[str]) -> str:
    return "+".join(names) if len(names) <= MOST_NAMES else f"{names[0]}+...+{names[-1]} ({len(names)})"


def _value_changes(title: str, name: str, before: Any, after: Any) -> Iterator[str]:
    """Yield the changes of one value, down to numbers; a value of another type changes as a whole."""
    if before == after:
        return
    if is_dataclass(before) and type(before) is type(after):
        for field in fields(before):
            if field.compare:
                inner = f"{name}.{field.name}" if name else field.name
                yield from _value_changes(title, inner, getattr(before, field.name), getattr(after, field.name))
        return
    label = f"{title}: {name} " if name else f"{title}: "
    yield f"{label}{_difference(before, after)}"


def _difference(before: Any, after: Any) -> str:
    old, new = _numbers(before), _numbers(after)
    if old is None or new is None or old.size <= MOST_NUMBERS >= new.size:
        return f"{_text(before)} -> {_text(after)}"
    if old.shape != new.shape:
        return f"{list(old.shape)} numbers -> {list(new.shape)}"
    apart = np.abs(new - old)
    return f"{np.count_nonzero(apart)} of {old.size} numbers differ, by up to {apart.max():.6g}"


def _numbers(value: Any) -> Any:
    """Return a value as an array of numbers, or None if it is not numeric or ragged."""
    if not isinstance(value, int | float | tuple):
        return None
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return array


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, tuple):
        shown = [_text(entry) for entry in value[:MOST_NAMES]]
        return f"({', '.join(shown)}{', ...' if len(value) > MOST_NAMES else ''})"
    return type(value).__name__ if is_dataclass(value) or not isinstance(value, str | int | None) else str(value)
