"""Reader of scenes from USD layers, written by this package or as plain UsdPhysics by other tools.

A layer of this package stores many numbers twice: as a `gauge:` double and in single precision in a standard attribute.
The edited one of both counts, see `Source.edited`. Without a `gauge:` attribute, the standard attribute counts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdPhysics

from gauge_envs.errors import AssetError
from gauge_envs.formats.usd.bodies import read_body
from gauge_envs.formats.usd.contacts import (
    Collider,
    is_enabled,
    read_contacts,
)
from gauge_envs.formats.usd.deformables import (
    is_deformable,
    read_air,
    read_attachment,
    read_deformable,
    read_markers,
)
from gauge_envs.formats.usd.joints import joint_prims, read_joint
from gauge_envs.formats.usd.layer import WRITTEN
from gauge_envs.formats.usd.source import Source
from gauge_envs.reading import faults_of
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Motion,
    Scene,
)
from gauge_envs.scene.geometry import length_of

MAX_DURATION_S = 3600.0
"""Longest duration of a scene [s]."""

LEVEL = 1e-6
"""Largest angle between gravity and the vertical [rad]."""


UNIT_FACTORS = (1e-3, 1e-2, 1e2, 1e3)
"""Ratios of a gravity in a wrong unit of length to that of the earth."""

UNIT_RELATIVE = 0.02
"""Largest relative difference of a ratio from a factor of `UNIT_FACTORS`; gravities are often rounded, as to 10."""


@dataclass(frozen=True, kw_only=True)
class UsdScene:
    """Content of a USD file.

    Attributes:
        scene: The scene.
        metadata: Notes of the writer on the variant and its source; empty in files of other tools.
        used_files: Other files of the stage, sorted by their path relative to the main file.
    """

    scene: Scene
    metadata: Mapping[str, str]
    used_files: tuple[Path, ...]


def read_usd(
    path: str | Path,
    *,
    duration_s: float | None = None,
) -> UsdScene:
    """Read the whole content of a USD file, written by `to_usd` or as plain UsdPhysics.

    A scene that `to_usd` wrote is restored exactly. If a number was edited in such a file, in the `gauge:` double or in
    the standard attribute, the edited value applies. The keywords are for files of other tools, whose contacts are all
    sustained.

    Args:
        path: File of any format that USD reads.
        duration_s: Duration of the experiment [s], for files without `gauge:duration_s`. It replaces the start and end
            time codes of the file.

    Raises:
        AssetError: The file cannot be read, or has a part that scenes lack; the message names the prim.
    """
    # Messages of USD about damaged bytes are no text, which is an error of another kind.
    with faults_of(path, AssetError):
        source = Source(Path(path))
        notes = source.stage.GetRootLayer().customLayerData.get("gauge", {})
        return UsdScene(
            scene=_read_scene(source, duration_s),
            metadata={key: str(value) for key, value in notes.items()},
            used_files=source.used_files(),
        )


def from_usd(path: str | Path, **options: Any) -> Scene:
    """Read a scene from a USD file.

    Args:
        path: File of any format that USD reads.
        **options: Keywords and errors as in `read_usd`.
    """
    return read_usd(path, **options).scene


def _physics(source: Source) -> UsdPhysics.Scene:
    """Return the only PhysicsScene of a stage."""
    scenes = [prim for prim in source.prims() if prim.IsA(UsdPhysics.Scene)]
    if len(scenes) != 1:
        raise source.fault(
            "",
            f"{len(scenes)} PhysicsScene prims: exactly one is expected, for gravity",
        )
    return UsdPhysics.Scene(scenes[0])


def _read_scene(source: Source, duration_s: float | None) -> Scene:
    """Return the scene of a stage."""
    physics = _physics(source)
    with source.errors_at(physics.GetPrim()):
        duration_s = _duration_s(source, physics, duration_s)
        gravity_m_per_s2 = _gravity_m_per_s2(source, physics)
        air = read_air(physics.GetPrim())
    source.read_each(source.prims(), source.check_derived)
    rigid = _rigid_bodies(source)
    soft = {
        prim: [prim] if prim.HasAPI(UsdPhysics.CollisionAPI) else []
        for prim in source.prims()
        if is_deformable(prim)
    }
    names = _names(source, [*rigid, *soft])
    results = source.read_each(
        rigid, lambda prim: read_body(source, prim, rigid[prim], names[prim.GetPath()])
    )
    bodies = {
        prim.GetPath(): body for prim, (body, _, _) in zip(rigid, results, strict=True)
    }
    # Drivers without an index in the file come last, in the stage's order.
    results.sort(key=lambda result: result[2])
    colliders = [
        Collider(
            name=names[prim.GetPath()],
            prim=prim,
            shapes=shapes,
            moves=prim in soft or bodies[prim.GetPath()].motion is Motion.DYNAMIC,
        )
        for prim, shapes in (rigid | soft).items()
    ]
    joints = source.read_each(
        joint_prims(source), lambda joint: read_joint(source, joint, bodies)
    )
    attachments = source.read_each(
        source.prims(), lambda prim: read_attachment(source, prim, names)
    )
    return Scene(
        bodies=tuple(bodies.values()),
        deformables=tuple(
            source.read_each(
                soft, lambda prim: read_deformable(source, prim, names[prim.GetPath()])
            )
        ),
        joints=tuple(joints),
        attachments=tuple(attachment for attachment in attachments if attachment),
        contacts=read_contacts(source, colliders),
        drivers=tuple(driver for _, driver, _ in results if driver),
        markers=read_markers(source, names),
        duration_s=duration_s,
        gravity_m_per_s2=gravity_m_per_s2,
        air=air,
    )


def _gravity_m_per_s2(source: Source, physics: UsdPhysics.Scene) -> float:
    down = source.up @ np.array(physics.GetGravityDirectionAttr().Get())
    # Zeros, the fallback of the schema, stand for down.
    if down.any() and length_of(down / length_of(down) - (0.0, 0.0, -1.0)) > LEVEL:
        raise source.fault(
            physics.GetGravityDirectionAttr(),
            "gravity must point down, against the up axis",
        )
    magnitude = physics.GetGravityMagnitudeAttr()
    stored = None
    # In UsdPhysics a negative number stands for standard gravity.
    if magnitude.Get() >= 0.0:
        stored = source.stored(magnitude, (), lambda value: value * source.metres)
    exact = physics.GetPrim().GetAttribute("gauge:gravity_m_per_s2")
    value = source.edited(exact, [stored])
    gravity = GRAVITY_M_PER_S2 if value is None else float(value)
    ratio = gravity / GRAVITY_M_PER_S2
    factors = [
        factor for factor in UNIT_FACTORS if abs(ratio / factor - 1.0) < UNIT_RELATIVE
    ]
    if factors:
        raise source.fault(
            magnitude,
            f"is {gravity:g} m/s^2, {factors[0]:g} times the earth's: in units of metersPerUnit = {source.metres:g}, "
            f"the earth's is {GRAVITY_M_PER_S2 / source.metres:g}",
        )
    return gravity


def _duration_s(
    source: Source,
    physics: UsdPhysics.Scene,
    duration_s: float | None,
) -> float:
    """Return `gauge:duration_s`, else the given duration, else the duration of the time codes."""
    double = physics.GetPrim().GetAttribute("gauge:duration_s")
    exact_s = source.number(double)
    stated_s = None
    if source.stage.HasAuthoredTimeCodeRange():
        stated_s = source.seconds(source.stage.GetEndTimeCode())
        if stated_s != (double.GetCustomDataByKey(WRITTEN) or stated_s):
            exact_s = stated_s
    choices = (exact_s, duration_s, stated_s)
    chosen_s = next((choice for choice in choices if choice is not None), None)
    if chosen_s is None or not 0.0 < chosen_s <= MAX_DURATION_S:
        raise source.fault(
            "",
            f"its duration is {chosen_s} s: set startTimeCode and endTimeCode, or duration_s, to a duration above 0 "
            f"and of at most {MAX_DURATION_S:g} s",
        )
    return chosen_s


def _rigid_bodies(source: Source) -> dict[Usd.Prim, list[Usd.Prim]]:
    """Return rigid bodies in the stage's order with their colliders; a collider without a body is a fixed body."""
    colliders: dict[Usd.Prim, list[Usd.Prim]] = {}
    for prim in source.prims():
        body = source.body_of(prim)
        if is_deformable(body or prim):
            continue
        if body == prim:
            colliders.setdefault(prim, [])
        if prim.HasAPI(UsdPhysics.CollisionAPI):
            colliders.setdefault(body or prim, []).append(prim)
    bodies = {}
    for prim, shapes in colliders.items():
        if not shapes:
            raise source.fault(
                prim,
                "is a rigid body without a collider, so its shape is unknown: add a collider",
            )
        enabled = [shape for shape in shapes if is_enabled(shape)]
        if enabled or source.body_of(prim):
            bodies[prim] = enabled or shapes
    return bodies


def _names(source: Source, prims: Sequence[Usd.Prim]) -> dict[Sdf.Path, str]:
    """Return names in the scene: `gauge:name` if given, else the prim's name if unique, else its path."""
    counts = Counter(prim.GetName() for prim in prims)
    names: dict[Sdf.Path, str] = {}
    for prim in prims:
        path, short = prim.GetPath(), prim.GetName()
        unique = short if counts[short] == 1 else str(path)[1:]
        name = source.text(prim.GetAttribute("gauge:name")) or unique
        if name in names.values():
            raise source.fault(
                prim, f"is named {name!r}, as another body is: rename it"
            )
        names[path] = name
    return names
