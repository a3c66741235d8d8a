"""Reader of scenes from USD layers, written by this package or as plain UsdPhysics by other tools.

A layer of this package stores many numbers twice: as a `gauge:` double and in single precision in a standard attribute.
The edited one of both counts, see `Source.counted`. Without a `gauge:` attribute, the standard attribute counts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from pxr import Sdf, Tf, Usd, UsdPhysics

from gauge_envs.errors import AssetError, ParameterError
from gauge_envs.scene.bodies import Contact, ContactMode, Motion, RigidBody
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.geometry import Pose, vector
from gauge_envs.scene.scene import GRAVITY_M_PER_S2, Scene
from gauge_envs.tools.usd.deformables import (
    is_deformable,
    read_air,
    read_attachments,
    read_deformable,
    read_markers,
)
from gauge_envs.tools.usd.driven import driven_body
from gauge_envs.tools.usd.joints import is_welded, joint_prims, read_joint
from gauge_envs.tools.usd.layer import WRITTEN
from gauge_envs.tools.usd.pairs import PairOptions, Party, contacts_of
from gauge_envs.tools.usd.solids import inertia_kg_m2, mass_kg, solid_of
from gauge_envs.tools.usd.source import LARGEST, Source, StoredValue, usd_reason
from gauge_envs.tools.usd.velocities import read_velocities

MOST_BODIES = 1000
"""Largest number of bodies; the number of pairs that may collide grows with the square."""

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
    """Read the whole content of a USD file; arguments and errors as in `from_usd`.

    `unstated_duration_s` is the duration of a file that states none [s].
    """
    options = PairOptions(friction=friction, mode=mode, contacts=contacts)
    with _opened(Path(path)) as source:
        reader = _Reader(source, options, duration_s)
        reader.unstated_duration_s = unstated_duration_s
        return reader.read()


def from_usd(
    path: str | Path,
    *,
    duration_s: float | None = None,
    friction: Literal["dynamic", "static"] | None = None,
    mode: ContactMode | Mapping[tuple[str, str], ContactMode] = ContactMode.SUSTAINED,
    contacts: Sequence[Contact] = (),
) -> Scene:
    """Read a scene from a USD file, written by `to_usd` or as plain UsdPhysics.

    A scene that `to_usd` wrote is restored exactly. If a number was edited in such a file, in the `gauge:` double or in
    the standard attribute, the edited value counts. The keywords are for files of other tools.

    Args:
        path: File of any format that USD reads.
        duration_s: Duration of the experiment [s], for files without `gauge:duration_s`. It replaces the start and end
            time codes of the file.
        friction: The coefficient that counts if static and dynamic friction of a material differ.
        mode: Mode of contacts without `gauge:mode`: one for all, or one per pair of names and sustained for others.
        contacts: Contacts that replace those of the file for their pairs.
    """
    return read_usd(
        path, duration_s=duration_s, friction=friction, mode=mode, contacts=contacts
    ).scene


@contextmanager
def _opened(file: Path) -> Iterator[Source]:
    """Open a stage; convert errors of USD to AssetError while it is read."""
    try:
        yield Source(file)
    except Tf.ErrorException as error:
        # USD detects some faults only when values are read, such as an attribute of another type than in its schema.
        raise AssetError(file, "", f"USD cannot read it: {usd_reason(error)}") from None
    except UnicodeDecodeError:
        raise AssetError(
            file, "", "it holds names or texts that are not UTF-8"
        ) from None
    except ParameterError as error:
        # A scene refuses parts that contradict each other, such as a start velocity across a hinge.
        raise AssetError(file, "", str(error)) from None


class _Reader:
    """Reader of one stage."""

    def __init__(
        self,
        source: Source,
        options: PairOptions,
        duration_s: float | None,
    ) -> None:
        self.source = source
        self.options = options
        self.duration_s = duration_s
        self.unstated_duration_s: float | None = None
        self.start = Usd.TimeCode(source.start)

    def read(self) -> UsdScene:
        source = self.source
        for prim in source.prims():
            source.check_followers(prim)
        scenes = [
            UsdPhysics.Scene(prim)
            for prim in source.prims()
            if prim.IsA(UsdPhysics.Scene)
        ]
        if len(scenes) != 1:
            raise source.fault(
                "",
                f"{len(scenes)} PhysicsScene prims: exactly one is expected, for gravity",
            )
        (self.physics,) = scenes
        self.joints = joint_prims(source)
        found = self._find()
        deformable = [prim for prim in source.prims() if is_deformable(prim)]
        if len(found) + len(deformable) > MOST_BODIES:
            raise source.fault(
                "",
                f"it has {len(found) + len(deformable)} bodies, the limit is {MOST_BODIES}",
            )
        self.names = self._names([*(prim for prim, _ in found), *deformable])
        bodies: dict[Sdf.Path, RigidBody] = {}
        drivers: list[tuple[int, Driver]] = []
        for prim, colliders in found:
            body, driver, place = self._body(prim, colliders)
            bodies[prim.GetPath()] = body
            if driver is not None:
                # Drivers without an index in the file come last, in the stage's order.
                drivers.append((len(found) if place is None else place, driver))
        parties = [
            self._party(
                prim, colliders, moves=bodies[prim.GetPath()].motion is Motion.DYNAMIC
            )
            for prim, colliders in found
        ]
        parties += [
            self._party(prim, (prim,) if prim.HasAPI(UsdPhysics.CollisionAPI) else ())
            for prim in deformable
        ]
        joints = [read_joint(source, prim, bodies) for prim in self.joints]
        scene = Scene(
            bodies=tuple(bodies.values()),
            deformables=tuple(
                read_deformable(source, prim, self.names[prim.GetPath()])
                for prim in deformable
            ),
            joints=tuple(joint for joint in joints if joint is not None),
            attachments=tuple(read_attachments(source, self.names)),
            contacts=contacts_of(source, self.physics.GetPrim(), parties, self.options),
            drivers=tuple(
                driver for _, driver in sorted(drivers, key=lambda pair: pair[0])
            ),
            markers=read_markers(source, self.names),
            duration_s=self._duration(),
            gravity_m_per_s2=self._gravity(),
            air=read_air(source, self.physics.GetPrim()),
        )
        noted = source.stage.GetRootLayer().customLayerData.get("gauge", {})
        return UsdScene(
            scene=scene,
            paths={name: str(place) for place, name in self.names.items()},
            metadata={key: str(value) for key, value in noted.items()}
            if isinstance(noted, dict)
            else {},
            used_files=source.used_files(),
        )

    # --- stage ---

    def _gravity(self) -> float:
        source, physics = self.source, self.physics
        attribute = physics.GetGravityDirectionAttr()
        direction = source.numbers(attribute, (3,))
        if direction is not None and direction.any():
            down = source.up @ (direction / np.linalg.norm(direction))
            if down[2] >= 0.0 or np.hypot(down[0], down[1]) > LEVEL:
                raise source.fault(
                    attribute,
                    f"is {direction.tolist()}: gravity must point down, against the up axis",
                )
        magnitude = physics.GetGravityMagnitudeAttr()
        # Minus infinity, the fallback of the schema, stands for standard gravity.
        is_given = magnitude.HasAuthoredValue() and magnitude.Get() != -np.inf
        standard = (
            source.reading(magnitude, (), lambda g: g * source.metres)
            if is_given
            else None
        )
        gravity = source.counted(
            physics.GetPrim().GetAttribute("gauge:gravity_m_per_s2"), [standard]
        )
        if gravity is None:
            return GRAVITY_M_PER_S2
        if gravity < 0.0:
            raise source.fault(
                magnitude, f"is {float(gravity)} m/s^2: 0 or more is expected"
            )
        return float(gravity)

    def _duration(self) -> float:
        source, stage = self.source, self.source.stage
        attribute = self.physics.GetPrim().GetAttribute("gauge:duration_s")
        stated = None
        if stage.HasAuthoredTimeCodeRange():
            length = np.array(source.seconds(stage.GetEndTimeCode()))
            stated = StoredValue(place="endTimeCode", raw=length, value=length)
        exact = attribute.HasAuthoredValue() if attribute else False
        if self.duration_s is not None and not exact:
            stated = None
        value = source.counted(
            attribute,
            [stated],
            rounded=lambda t: np.round(t * source.rate) / source.rate,
        )
        duration = float(value) if value is not None else self.duration_s
        if duration is None:
            duration = self.unstated_duration_s
        if duration is None:
            raise source.fault(
                "",
                "its duration is not known: give duration_s, or author startTimeCode and endTimeCode",
            )
        if not 0.0 < duration <= LARGEST:
            raise source.fault(
                "endTimeCode" if stated else "",
                f"its duration is {duration} s: a positive one is expected",
            )
        return duration

    # --- prims of bodies ---

    def _find(self) -> list[tuple[Usd.Prim, tuple[Usd.Prim, ...]]]:
        """Return rigid bodies in the stage's order with their colliders; one without a rigid body is a fixed body."""
        source = self.source
        roots: dict[Sdf.Path, list[Usd.Prim]] = {}
        for prim in source.prims():
            if source.is_rigid(prim) or (
                prim.HasAttribute("gauge:name") and not is_deformable(prim)
            ):
                roots.setdefault(prim.GetPath(), [])
            if prim.HasAPI(UsdPhysics.CollisionAPI) and not is_deformable(prim):
                owner = source.body_of(prim)
                colliders = roots.setdefault(
                    owner.GetPath() if owner else prim.GetPath(), []
                )
                colliders.append(prim)
        found = []
        for path, colliders in roots.items():
            prim = source.stage.GetPrimAtPath(path)
            enabled = [one for one in colliders if source.collides(one)]
            if (
                not enabled
                and not source.is_rigid(prim)
                and not prim.HasAttribute("gauge:name")
            ):
                continue
            if not colliders:
                raise source.fault(
                    prim,
                    "is a rigid body without a collider, so its shape is unknown: add a collider",
                )
            found.append((prim, tuple(enabled or colliders)))
        return found

    def _names(self, prims: Sequence[Usd.Prim]) -> dict[Sdf.Path, str]:
        """Return names in the scene: `gauge:name` if given, else the prim's name if unique, else its path."""
        often = Counter(prim.GetName() for prim in prims)
        names: dict[Sdf.Path, str] = {}
        paths: dict[str, Sdf.Path] = {}
        for prim in prims:
            short = (
                prim.GetName()
                if often[prim.GetName()] == 1
                else str(prim.GetPath())[1:]
            )
            name = self.source.text(prim.GetAttribute("gauge:name")) or short
            if name in paths:
                raise self.source.fault(
                    prim, f"is named {name!r}, as {paths[name]} is: rename one of them"
                )
            names[prim.GetPath()], paths[name] = name, prim.GetPath()
        return names

    def _party(
        self, prim: Usd.Prim, colliders: tuple[Usd.Prim, ...], *, moves: bool = True
    ) -> Party:
        return Party(
            name=self.names[prim.GetPath()], prim=prim, colliders=colliders, moves=moves
        )

    # --- rigid bodies ---

    def _body(
        self, prim: Usd.Prim, colliders: tuple[Usd.Prim, ...]
    ) -> tuple[RigidBody, Driver | None, int | None]:
        source, motion = self.source, self._motion(prim)
        frame = source.frame(prim, self.start)
        solid = solid_of(source, prim, frame, colliders, motion)
        mass = mass_kg(source, prim, colliders, solid, frame, motion)

        def pose_at(time: Usd.TimeCode) -> Pose:
            moved = source.frame(prim, time)
            return (
                moved.moved(solid.offset_m, solid.rotation) if solid.is_moved else moved
            ).pose

        name, driver, place = self.names[prim.GetPath()], None, None
        if motion is Motion.KINEMATIC:
            pose, driver, place = driven_body(source, prim, name, pose_at)
        elif motion is Motion.FIXED and len(source.sample_codes(prim)) > 1:
            raise source.fault(
                prim,
                "is a collider that moves without a rigid body: make it a kinematic body",
            )
        else:
            pose = pose_at(self.start)
        body = RigidBody(
            name=name,
            shape=solid.shape,
            motion=motion,
            pose=pose,
            mass_kg=mass,
            inertia_kg_m2=inertia_kg_m2(source, prim),
        )
        if motion is Motion.DYNAMIC:
            linear, angular = read_velocities(source, prim, frame, pose, solid.shape)
            body = replace(
                body,
                linear_velocity_m_per_s=vector(linear),
                angular_velocity_rad_per_s=vector(angular),
            )
        return body, driver, place

    def _motion(self, prim: Usd.Prim) -> Motion:
        source = self.source
        standard = Motion.FIXED
        if source.is_rigid(prim):
            driven = source.flag(
                UsdPhysics.RigidBodyAPI(prim).GetKinematicEnabledAttr(), default=False
            )
            standard = Motion.KINEMATIC if driven else Motion.DYNAMIC
            if any(is_welded(source, joint, prim) for joint in self.joints):
                standard = Motion.FIXED
        attribute = prim.GetAttribute("gauge:motion")
        exact = source.text(attribute, tuple(Motion))
        if exact is None or exact == standard:
            return standard
        written = attribute.GetCustomDataByKey(WRITTEN)
        if standard == written:
            return Motion(exact)
        if exact == written:
            return standard
        raise source.fault(
            attribute,
            f"is {exact}, but UsdPhysics makes the body {standard}: make them agree",
        )
