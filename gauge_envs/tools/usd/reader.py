"""Reader of scenes from USD layers, written by this package or as plain UsdPhysics by other tools.

A layer of this package stores many numbers twice: as a `gauge:` double and in single precision in a standard attribute.
The edited one of both counts, see `Source.counted`. Without a `gauge:` attribute, the standard attribute counts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pxr import Sdf, Tf, Usd, UsdPhysics

from gauge_envs.errors import AssetError, ParameterError
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Contact,
    ContactMode,
    Motion,
    RigidBody,
    Scene,
)
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.geometry import length_of
from gauge_envs.tools.usd.bodies import read_body
from gauge_envs.tools.usd.contacts import (
    Collider,
    ContactOptions,
    is_enabled,
    read_contacts,
)
from gauge_envs.tools.usd.deformables import (
    is_deformable,
    read_air,
    read_attachments,
    read_deformable,
    read_markers,
)
from gauge_envs.tools.usd.joints import joint_prims, read_joint, welded_body
from gauge_envs.tools.usd.source import (
    MAX_DURATION_S,
    Source,
    StoredValue,
)

LEVEL = 1e-6
"""Largest angle between gravity and the vertical [rad]."""


@dataclass(frozen=True, kw_only=True)
class UsdScene:
    """Content of a USD file.

    Attributes:
        scene: The scene.
        paths: Prim path of each rigid and deformable body, by its name in the scene.
        metadata: Notes of the writer on the variant and its source; empty in files of other tools.
        used_files: Other files of the stage, sorted by their path relative to the main file.
    """

    scene: Scene
    paths: Mapping[str, str]
    metadata: Mapping[str, str]
    used_files: tuple[Path, ...]


def read_usd(
    path: str | Path,
    *,
    duration_s: float | None = None,
    friction: Literal["dynamic", "static"] | None = None,
    mode: ContactMode | Mapping[tuple[str, str], ContactMode] = ContactMode.SUSTAINED,
    contacts: Sequence[Contact] = (),
    unstated_duration_s: float | None = None,
) -> UsdScene:
    """Read the whole content of a USD file, written by `to_usd` or as plain UsdPhysics.

    A scene that `to_usd` wrote is restored exactly. If a number was edited in such a file, in the `gauge:` double or in
    the standard attribute, the edited value counts. The keywords are for files of other tools.

    Args:
        path: File of any format that USD reads.
        duration_s: Duration of the experiment [s], for files without `gauge:duration_s`. It replaces the start and end
            time codes of the file.
        friction: The coefficient that counts if static and dynamic friction of a material differ.
        mode: Mode of contacts without `gauge:mode`: one for all, or one per pair of names and sustained for others.
        contacts: Contacts that replace those of the file for their pairs.
        unstated_duration_s: Duration of a file that states none [s].

    Raises:
        AssetError: The file cannot be read, or holds what a scene does not have; the message names the prim.
    """
    options = ContactOptions(friction=friction, mode=mode, contacts=contacts)
    with _usd_errors(Path(path)):
        source = Source(Path(path))
        physics = _physics(source)
        length_s = _duration_s(source, physics, duration_s, unstated_duration_s)
        names, scene = _read_scene(source, physics, length_s, options)
        notes = source.stage.GetRootLayer().customLayerData.get("gauge", {})
        return UsdScene(
            scene=scene,
            paths={name: str(path) for path, name in names.items()},
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


@contextmanager
def _usd_errors(file: Path) -> Iterator[None]:
    """Convert errors of USD and of the scene to AssetError while a stage is read."""
    try:
        yield
    except Tf.ErrorException as error:
        # USD detects some faults only when values are read, such as an attribute of another type than in its schema.
        raise AssetError(file, "", f"USD cannot read it: {_reason(error)}") from None
    except ParameterError as error:
        # A scene refuses parts that contradict each other, such as a start velocity across a hinge.
        raise AssetError(file, "", str(error)) from None


def _reason(error: Tf.ErrorException) -> str:
    """Return the message of an error of USD, first cause first."""
    try:
        return str(error.args[0].commentary).strip()
    except UnicodeDecodeError:
        # The message quotes the file.
        return "it holds bytes that are not UTF-8 text"


def _physics(source: Source) -> UsdPhysics.Scene:
    """Return the only PhysicsScene of a stage."""
    scenes = [
        UsdPhysics.Scene(prim) for prim in source.prims() if prim.IsA(UsdPhysics.Scene)
    ]
    if len(scenes) != 1:
        raise source.fault(
            "",
            f"{len(scenes)} PhysicsScene prims: exactly one is expected, for gravity",
        )
    return scenes[0]


def _read_scene(
    source: Source,
    physics: UsdPhysics.Scene,
    duration_s: float,
    options: ContactOptions,
) -> tuple[dict[Sdf.Path, str], Scene]:
    """Return the names of all bodies by path, and the scene."""
    for prim in source.prims():
        source.check_derived(prim)
    rigid = _rigid_bodies(source)
    soft = [
        (prim, [prim] if prim.HasAPI(UsdPhysics.CollisionAPI) else [])
        for prim in source.prims()
        if is_deformable(prim)
    ]
    names = _names(source, [prim for prim, _ in (*rigid, *soft)])
    joints = joint_prims(source)
    welded = {welded_body(source, joint) for joint in joints}
    bodies: dict[Sdf.Path, RigidBody] = {}
    drivers: list[tuple[int, Driver]] = []
    for prim, shapes in rigid:
        path = prim.GetPath()
        body, driver, index = read_body(source, prim, shapes, names[path], welded)
        bodies[path] = body
        if driver is not None:
            # Drivers without an index in the file come last, in the stage's order.
            drivers.append((len(rigid) if index is None else index, driver))
    drivers.sort(key=lambda pair: pair[0])
    still = {path for path, body in bodies.items() if body.motion is not Motion.DYNAMIC}
    colliders = [
        Collider(
            name=names[prim.GetPath()],
            prim=prim,
            shapes=shapes,
            moves=prim.GetPath() not in still,
        )
        for prim, shapes in (*rigid, *soft)
    ]
    read_joints = [read_joint(source, joint, bodies) for joint in joints]
    scene = Scene(
        bodies=tuple(bodies.values()),
        deformables=tuple(
            read_deformable(source, prim, names[prim.GetPath()]) for prim, _ in soft
        ),
        joints=tuple(joint for joint in read_joints if joint is not None),
        attachments=tuple(read_attachments(source, names)),
        contacts=read_contacts(source, physics.GetPrim(), colliders, options),
        drivers=tuple(driver for _, driver in drivers),
        markers=read_markers(source, names),
        duration_s=duration_s,
        gravity_m_per_s2=_gravity_m_per_s2(source, physics),
        air=read_air(source, physics.GetPrim()),
    )
    return names, scene


def _gravity_m_per_s2(source: Source, physics: UsdPhysics.Scene) -> float:
    attribute = physics.GetGravityDirectionAttr()
    direction = source.numbers(attribute, (3,))
    # Zeros, the fallback of the schema, stand for down.
    if direction is not None and direction.any():
        down = source.up @ direction / length_of(direction)
        if length_of(down - (0.0, 0.0, -1.0)) > LEVEL:
            raise source.fault(
                attribute,
                f"is {direction.tolist()}: gravity must point down, against the up axis",
            )
    magnitude = physics.GetGravityMagnitudeAttr()
    # Minus infinity, the fallback of the schema, stands for standard gravity.
    stored = None
    if magnitude.Get() != -np.inf:
        stored = source.stored(magnitude, (), lambda value: value * source.metres)
    exact = physics.GetPrim().GetAttribute("gauge:gravity_m_per_s2")
    gravity = source.edited(exact, [stored])
    if gravity is None:
        return GRAVITY_M_PER_S2
    if gravity < 0.0:
        raise source.fault(
            magnitude, f"is {float(gravity)} m/s^2: 0 or more is expected"
        )
    return float(gravity)


def _duration_s(
    source: Source,
    physics: UsdPhysics.Scene,
    given_s: float | None,
    unstated_s: float | None,
) -> float:
    """Return `gauge:duration_s`, else the given duration, else that of the time codes, else that for unstated ones."""
    exact = physics.GetPrim().GetAttribute("gauge:duration_s")
    stored = None
    if source.stage.HasAuthoredTimeCodeRange() and (exact or given_s is None):
        length_s = np.array(source.seconds(source.stage.GetEndTimeCode()))
        stored = StoredValue("endTimeCode", length_s, length_s)
    value = source.edited(
        exact,
        [stored],
        rounded=lambda length_s: np.round(length_s * source.rate_hz) / source.rate_hz,
    )
    durations = [given_s if value is None else float(value), unstated_s]
    duration_s = next((length for length in durations if length is not None), None)
    if duration_s is None:
        raise source.fault(
            "",
            "its duration is not known: give duration_s, or author startTimeCode and endTimeCode",
        )
    if not 0.0 < duration_s <= MAX_DURATION_S:
        raise source.fault(
            "endTimeCode" if stored else "",
            f"its duration is {duration_s} s: above 0 and at most {MAX_DURATION_S:g} s are expected",
        )
    return duration_s


def _rigid_bodies(source: Source) -> list[tuple[Usd.Prim, list[Usd.Prim]]]:
    """Return rigid bodies in the stage's order with their colliders; one without a rigid body is a fixed body."""
    found: dict[Sdf.Path, list[Usd.Prim]] = {}
    for prim in source.prims():
        owner = source.body_of(prim)
        if is_deformable(prim) or (owner is not None and is_deformable(owner)):
            continue
        if owner == prim:
            found.setdefault(prim.GetPath(), [])
        if prim.HasAPI(UsdPhysics.CollisionAPI):
            found.setdefault((owner or prim).GetPath(), []).append(prim)
    bodies = []
    for path, shapes in found.items():
        prim = source.stage.GetPrimAtPath(path)
        if not shapes:
            raise source.fault(
                prim,
                "is a rigid body without a collider, so its shape is unknown: add a collider",
            )
        enabled = [shape for shape in shapes if is_enabled(shape)]
        if enabled or source.body_of(prim):
            bodies.append((prim, enabled or shapes))
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
