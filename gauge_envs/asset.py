"""Assets as the source of a scene: a USD layer, or a model file of an engine, in the place of a variant's task file.

From the file come bodies, constants and driven motion; what is observed, for how long, and what it is scored against
stay those of the variant. So the file must fit it: the recorded bodies move, and what carries markers is there.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gauge_envs.errors import AssetError
from gauge_envs.scene import Attachment, Contact, Hinge, Motion, Scene

if TYPE_CHECKING:
    from gauge_envs.experiment import Experiment, TaskExperiment
    from gauge_envs.usd import UsdScene

__all__ = [
    "USD_SUFFIXES",
    "Asset",
    "AssetKind",
    "check_fit",
    "contents_sha256",
    "is_experiment_file",
    "read_bytes",
    "scene_changes",
    "with_asset",
]

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
"""Suffixes of USD layers."""

EXPERIMENT_SUFFIX = ".toml"

MOST_NAMES = 4
"""So many names of a group are told in a line; more are counted."""

MOST_NUMBERS = 9
"""Arrays of more numbers than this are told by how many differ, and by how much."""


class AssetKind(StrEnum):
    """What an asset is."""

    USD = "usd"
    """A USD layer, for any engine."""
    MODEL = "model"
    """A model file in an engine's own format, for that engine alone."""
    EXPERIMENT = "experiment"
    """An experiment file, which names a USD layer."""


@dataclass(frozen=True, kw_only=True)
class Asset:
    """File that a scene is from.

    Attributes:
        path: Where it is, as it was given.
        kind: What it is.
        sha256: Hash of its bytes; where it names other files, as layers that it refers to, of theirs too.
        edited: Whether it differs from the calibrated variant in what moves it. An experiment file is its own measure.
        changes: How, a line each: `contact cube/board: friction 0.273673 -> 0.136837`.
    """

    path: Path
    kind: AssetKind
    sha256: str
    edited: bool = False
    changes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready dictionary, without the folder that the file is in."""
        return {
            "file": self.path.name,
            "kind": self.kind.value,
            "sha256": self.sha256,
            "edited": self.edited,
            "changes": list(self.changes),
        }


def is_experiment_file(path: Path) -> bool:
    """Whether a path is that of an experiment file, judged by its suffix."""
    return path.suffix == EXPERIMENT_SUFFIX


def read_bytes(path: Path) -> bytes:
    """Content of an asset.

    Raises:
        AssetError: It cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise AssetError(path, "", f"cannot be read: {error.strerror or error}") from error


def contents_sha256(contents: Sequence[bytes]) -> str:
    """Hash of the contents of files in a given order; of a single one the usual hash of its bytes."""
    if len(contents) == 1:
        return hashlib.sha256(contents[0]).hexdigest()
    return hashlib.sha256(b"".join(hashlib.sha256(content).digest() for content in contents)).hexdigest()


# --- the scene of a variant, from a file -----------------------------------------------------------------------------


def with_asset(resolved: TaskExperiment, path: Path) -> TaskExperiment:
    """An experiment with the scene of a file.

    Args:
        resolved: The experiment with its calibrated scene and bundled drivers.
        path: USD layer, or model file of an installed engine.

    Raises:
        AssetError: The file cannot be read, is of another variant, or does not fit this one.
    """
    from gauge_envs.backends.registry import backend_of_suffix
    from gauge_envs.experiment import driver_provenance

    contents = [read_bytes(path)]
    changes: tuple[str, ...]
    if path.suffix in USD_SUFFIXES:
        layer = _usd_scene(resolved, path)
        kind, scene = AssetKind.USD, layer.scene
        contents += map(read_bytes, layer.used_files)
        changes = tuple(scene_changes(resolved.scene, scene))
    elif (engine := backend_of_suffix(path.suffix)) is not None:
        kind, file = AssetKind.MODEL, engine.read_file(path, resolved.scene)
        scene, changes = file.scene, file.changes
    else:
        raise AssetError(path, "", f"suffix {path.suffix!r} is neither USD ({', '.join(USD_SUFFIXES)}) nor an engine's")
    found = replace(
        resolved,
        scene=scene,
        driver_provenance=driver_provenance(scene),
        asset=Asset(path=path, kind=kind, sha256=contents_sha256(contents), edited=bool(changes), changes=changes),
    )
    check_fit(found, resolved)
    return found


def _usd_scene(resolved: TaskExperiment, path: Path) -> UsdScene:
    from gauge_envs.usd import read_usd

    duration_s = resolved.scene.duration_s
    found = read_usd(path, duration_s=duration_s)
    of = found.metadata.get("variant", resolved.name)
    if of != resolved.name:
        raise AssetError(
            path,
            "customLayerData",
            f"it is the scene of {of}, and {resolved.name} was asked for; if that is meant, delete 'variant' there",
        )
    if not math.isclose(found.scene.duration_s, duration_s, rel_tol=1e-9):
        raise AssetError(
            path,
            "gauge:duration_s",
            f"it lasts {found.scene.duration_s:.10g} s, but an episode of {resolved.name} {duration_s:.10g} s",
        )
    return found


def check_fit(found: Experiment, wanted: Experiment) -> None:
    """Raise when what an experiment observes is not in its scene.

    Args:
        found: The experiment with the scene of its asset.
        wanted: The same with the scene that says what is observed.

    Raises:
        AssetError: A recorded body is missing or does not move, or markers are others, or on a rigid body.
    """
    from gauge_envs.trajectory_file import coordinate_names

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
        count = len(coordinate_names(wanted))
        if len(coordinate_names(found)) != count:
            raise AssetError(path, "markers", f"{len(coordinate_names(found))} coordinates, {found.name} has {count}")
    hinged = {joint.body for joint in scene.joints if isinstance(joint, Hinge)}
    if {"lsd", "mte", "pd", "el"} & set(found.score.metrics) and found.recorded[0] not in hinged:
        raise AssetError(path, found.recorded[0], f"no hinge, which {', '.join(found.score.metrics)} are measured from")


# --- what differs ----------------------------------------------------------------------------------------------------


def scene_changes(before: Scene, after: Scene) -> Iterator[str]:
    """How a scene differs from another, a line each, field by field; none where they are equal."""
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
    """Changes of bodies, contacts, joints, ...: matched by what they are called, else told as added and removed."""
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
    name = getattr(entry, "name", None)
    return name if name is not None else f"{type(entry).__name__.lower()} of {entry.body}"


def _side(names: Sequence[str]) -> str:
    return "+".join(names) if len(names) <= MOST_NAMES else f"{names[0]}+...+{names[-1]} ({len(names)})"


def _value_changes(title: str, name: str, before: Any, after: Any) -> Iterator[str]:
    """Changes of one value, down to numbers; a value of another type is told as a whole."""
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
        return f"{_told(before)} -> {_told(after)}"
    if old.shape != new.shape:
        return f"{list(old.shape)} numbers -> {list(new.shape)}"
    apart = np.abs(new - old)
    return f"{np.count_nonzero(apart)} of {old.size} numbers differ, by up to {apart.max():.6g}"


def _numbers(value: Any) -> Any:
    """A value as an array of numbers; None where it is none, or is ragged."""
    if not isinstance(value, int | float | tuple):
        return None
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return array


def _told(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, tuple):
        shown = [_told(entry) for entry in value[:MOST_NAMES]]
        return f"({', '.join(shown)}{', ...' if len(value) > MOST_NAMES else ''})"
    return type(value).__name__ if is_dataclass(value) or not isinstance(value, str | int | None) else str(value)


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - 12} more" if len(names) > 12 else ""
    return ", ".join(names[:12]) + more if names else "none"
