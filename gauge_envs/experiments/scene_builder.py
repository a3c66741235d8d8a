"""Build the scene of one variant from its task file."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from gauge_envs.errors import ParameterError, TaskFileError, first_fault, nearest
from gauge_envs.experiments.task_format import (
    ContactSpec,
    JointSpec,
    Placement,
    TaskSpec,
)
from gauge_envs.experiments.variants import Variant
from gauge_envs.scene import (
    Air,
    Box,
    Cloth,
    Contact,
    Deformable,
    Hinge,
    Markers,
    Motion,
    Pose,
    RigidBody,
    Rod,
    Rope,
    Scene,
    SoftBody,
    Tether,
    Vector,
)
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.timing import FRAME_RATE_HZ

AIR = "air"
"""Name under which overrides state the air of a scene, as `air.density_kg_per_m3`."""

GRAVITY = "scene.gravity_m_per_s2"
"""Override of the gravity of a scene [m/s^2]."""

NUMBERS = {
    "position_m": 1,
    "positions_m": 2,
    "hangs_from_m": 1,
    "euler_deg": 1,
    "velocity_m_per_s": 1,
    "angular_velocity_deg_per_s": 1,
    "wind_m_per_s": 1,
}
"""Dimensions of the overrides that are not one number."""

EXPECTED = ("a number", "three numbers", "three numbers for each body")
"""What an override of 0, 1 or 2 dimensions must be."""

OF_CONTACTS = ("friction", "restitution")
"""Constants that contacts read."""

NOT_OF_DEFORMABLES = (*OF_CONTACTS, "density_kg_per_m3")
"""Constants of a task file that are those of contacts, or follow from others."""

Parameters = str | Mapping[str, Any]
"""`calibrated`, another parameter set of the task file, or overrides such as `{"cube.friction": 0.3}`."""


def parameter_overrides(
    spec: TaskSpec, variant: Variant, parameters: Parameters
) -> tuple[str, dict[str, Any]]:
    """Return the name of the parameters, `custom` for overrides, and the overrides that they are."""
    if not isinstance(parameters, str | Mapping):
        raise ParameterError(
            f"parameters is {parameters!r}: expected the name of a parameter set, as 'calibrated', or overrides, as "
            "{'cube.friction': 0.3}"
        )
    if isinstance(parameters, Mapping):
        return ("custom" if parameters else "calibrated"), dict(parameters)
    if parameters == "calibrated":
        return parameters, {}
    if parameters not in spec.parameters:
        hint = nearest(parameters, ["calibrated", *spec.parameters])
        raise ParameterError(
            f"{variant.name} has no parameter set {parameters!r}; {hint}"
        )
    values = spec.parameters[parameters].values
    return parameters, {
        k: v[variant.material] if isinstance(v, dict) else v for k, v in values.items()
    }


class SceneBuilder:
    """Builder of the scene of one variant.

    Args:
        path: Task file, for messages.
        spec: Content of the task file.
        variant: The variant.
        overrides: Values that replace calibrated ones, keyed `body.constant`; `air.<field>` adds air to a scene with
            cloth, by the fields of `scene.Air`.
    """

    def __init__(
        self, path: Path, spec: TaskSpec, variant: Variant, overrides: Mapping[str, Any]
    ) -> None:
        self.path = path
        self.spec = spec
        self.variant = variant
        self.is_overridden = bool(overrides)
        self.subtask = subtask = (
            spec.subtasks[variant.subtask] if variant.subtask else None
        )
        self.present = subtask.bodies if subtask and subtask.bodies else spec.names
        self.contacts = (
            spec.contacts
            if subtask is None or subtask.contacts is None
            else subtask.contacts
        )
        self.drivers = (
            spec.drivers
            if subtask is None or subtask.drivers is None
            else subtask.drivers
        )
        self.placements = self._placements()
        self.constants = {
            name: spec.constants_of(
                name, spec.owner(name).material or variant.material, variant.subtask
            )
            for name in self.present
            if name in spec.constants
        }
        self.air: dict[str, Any] = {}
        self.gravity_m_per_s2 = GRAVITY_M_PER_S2
        for key, value in overrides.items():
            self._override(key, self._numbers(key, value))
        frames = subtask.frames if subtask else spec.frames
        try:
            self.frame_count = frames.get(variant.material) or frames["all"]
        except KeyError:
            raise TaskFileError(
                path, "frames", f"no frame count for {variant.name}"
            ) from None

    def _placements(self) -> dict[str, Placement]:
        merged: dict[str, Placement] = {}
        for table in (self.spec, self.subtask):
            for material in ("all", self.variant.material):
                merged.update(table.initial.get(material, {}) if table else {})
        for name in self.present:
            if name not in merged:
                raise TaskFileError(
                    self.path,
                    "initial",
                    f"no start of {name!r} for {self.variant.name}",
                )
        return merged

    def _numbers(self, key: str, value: Any) -> Any:
        """Return an override as a number, or as tuples of numbers; a text is none, also that of a number."""
        if isinstance(value, np.ndarray | np.generic):
            value = value.tolist()
        dimensions = NUMBERS.get(key.rpartition(".")[2], 0)
        if not _has_dimensions(value, dimensions):
            kind = "text" if isinstance(value, str) else type(value).__name__
            raise ParameterError(
                f"{self.variant.name}: override {key!r} is {value!r} ({kind}): expected {EXPECTED[dimensions]}"
            )
        return value

    def _override(self, key: str, value: Any) -> None:
        name, _, constant = key.rpartition(".")
        if key == GRAVITY:
            if not 0.0 < value < np.inf:
                raise ParameterError(
                    f"{self.variant.name}: override {key!r} is {value!r}: expected a number above 0, downwards"
                )
            self.gravity_m_per_s2 = float(value)
            return
        if name == AIR:
            if not any(one in self.spec.cloths for one in self.present):
                raise ParameterError(
                    f"{self.variant.name}: override {key!r} would change nothing: air acts on cloth, "
                    "and the scene has none"
                )
            air = [one.name for one in fields(Air)]
            if constant not in air:
                raise ParameterError(
                    f"{self.variant.name}: air has no constant {constant!r}; {nearest(constant, air)}"
                )
            self.air[constant] = value
            return
        if name not in self.present:
            hint = nearest(name, self.present)
            raise ParameterError(
                f"{self.variant.name}: override {key!r} names no body of the scene "
                f"({AIR!r} for cloth, {GRAVITY!r}); {hint}"
            )
        try:
            if constant in Placement.model_fields:
                placed = self.placements[name].model_dump(exclude_none=True) | {
                    constant: value
                }
                self.placements[name] = Placement.model_validate(placed)
            elif constant in self.constants.get(name, {}):
                self.constants[name] = self.constants[name] | {constant: value}
                self.spec.constants_model(name).model_validate(self.constants[name])
            else:
                hint = nearest(
                    constant, [*self.constants.get(name, {}), *Placement.model_fields]
                )
                raise ParameterError(
                    f"{self.variant.name}: {name!r} has no constant {constant!r}; {hint}"
                )
        except ValidationError as error:
            raise ParameterError(
                f"{self.variant.name}: override {key!r}: {first_fault(error)[1]}"
            ) from error

    @property
    def constants_read(self) -> set[str]:
        """Keys `body.constant` of the constants that a contact, a mass or a fabric of the scene reads."""
        read = set()
        for name, constants in self.constants.items():
            if name not in self.spec.bodies:
                unread = {*NOT_OF_DEFORMABLES}
                if name in self.spec.cloths:
                    unread.add("mass_kg")
            elif self._motion(name) is Motion.DYNAMIC:
                unread = {*NOT_OF_DEFORMABLES}
            else:
                unread = {*constants}
            read |= {f"{name}.{one}" for one in constants.keys() - unread}
        for contact, movable in self._pairs():
            if movable and contact.constants_of is not None:
                read |= {
                    f"{contact.constants_of}.{constant}"
                    for constant in OF_CONTACTS
                    if getattr(contact, constant) is None
                }
        return read

    def _motion(self, name: str) -> Motion:
        stated = self.spec.bodies[name].motion
        return self.subtask.motion.get(name, stated) if self.subtask else stated

    def _pairs(self) -> Iterator[tuple[ContactSpec, tuple[str, ...]]]:
        """Yield each contact with the bodies of the scene that it is of; none where nothing of it can move."""
        for contact in self.contacts:
            sides = [
                {
                    name
                    for name in self.present
                    for scene_name in self._scene_names(name)
                    if fnmatchcase(scene_name, pattern)
                }
                for pattern in contact.bodies
            ]
            moves = any(
                name not in self.spec.bodies or self._motion(name) is Motion.DYNAMIC
                for name in sides[0] | sides[1]
            )
            both = all(sides) and moves
            yield contact, tuple(sorted(sides[0] | sides[1])) if both else ()

    def _scene_names(self, name: str) -> list[str]:
        count = self.spec.bodies[name].count if name in self.spec.bodies else None
        return [name] if count is None else [f"{name}-{i + 1}" for i in range(count)]

    def is_constant(self, key: str) -> bool:
        """Return whether the key of an override is that of a constant of a body."""
        name, _, constant = key.rpartition(".")
        return constant in self.constants.get(name, {})

    def check_read(self, overrides: Mapping[str, Any]) -> None:
        """Raise an error for an override of a constant that nothing in the scene reads; it names what is read."""
        read = self.constants_read
        for key in overrides:
            name, _, constant = key.rpartition(".")
            if self.is_constant(key) and key not in read:
                raise ParameterError(
                    f"{self.variant.name}: override {key!r} would change nothing: {self._reader(name, constant, read)}"
                )

    def _reader(self, name: str, constant: str, read: set[str]) -> str:
        """Return why nothing reads a constant of a body, and which override does what it seems to."""
        if constant in OF_CONTACTS:
            for contact, bodies in self._pairs():
                if name not in bodies:
                    continue
                pair = " and ".join(contact.bodies)
                if getattr(contact, constant) is not None:
                    return f"the contact of {pair} states its own {constant} in the task file"
                return (
                    f"the contact of {pair} has the {constant} of {contact.constants_of}. "
                    f"Override '{contact.constants_of}.{constant}'"
                )
            known = sorted(key for key in read if key.endswith(f".{constant}"))
            if not known:
                return f"no contact of the scene has {constant}"
            return f"no contact of the scene has the {constant} of {name}. Overrides of others: {', '.join(known)}"
        if name in self.spec.bodies and self._motion(name) is not Motion.DYNAMIC:
            return f"{name} is {self._motion(name)}, so no motion depends on its {constant}"
        if name in self.spec.cloths:
            return f"the mass follows from the size. Override '{name}.areal_density_kg_per_m2'"
        return f"the mass is stated. Override '{name}.mass_kg'"

    def _air(self) -> Air | None:
        """Return the air that the overrides state; None without such overrides."""
        if not self.air:
            return None
        try:
            return TypeAdapter(Air).validate_python(self.air)
        except ValidationError as error:
            place, reason = first_fault(error)
            raise ParameterError(f"override 'air.{place}': {reason}") from error

    def spec_name(self, body: str) -> str:
        """Return the name in the task file of a scene body; counted bodies share one entry."""
        return body if body in self.spec.bodies else body.rpartition("-")[0]

    def build(self) -> Scene:
        """Return the scene."""
        try:
            return self._scene()
        except ParameterError as error:
            if self.is_overridden:
                raise ParameterError(f"{self.variant.name}: {error}") from None
            raise TaskFileError(self.path, None, str(error)) from None

    def _scene(self) -> Scene:
        bodies = tuple(
            body
            for name in self.present
            if name in self.spec.bodies
            for body in self._bodies(name)
        )
        names = [
            *(body.name for body in bodies),
            *(n for n in self.present if n not in self.spec.bodies),
        ]
        drivers = []
        for stated in self.drivers:
            driven = next(body for body in bodies if body.name == stated.body)
            if driven.motion is not Motion.KINEMATIC:
                raise TaskFileError(
                    self.path,
                    "drivers",
                    f"{driven.name!r} is driven but {driven.motion}, not kinematic",
                )
            origin = stated.provenance
            provenance = (
                origin if isinstance(origin, str) else origin[self.variant.material]
            )
            drivers.append(stated.build(driven.name, driven.pose, provenance))
        markers = self.spec.markers
        carriers = (
            tuple(name for name in markers.bodies if name in self.present)
            if markers
            else ()
        )
        return Scene(
            bodies=bodies,
            deformables=tuple(
                self._deformable(name)
                for name in self.present
                if name not in self.spec.bodies
            ),
            joints=tuple(self._joint(joint) for joint in self.spec.joints),
            attachments=tuple(
                one
                for one in self.spec.attachments
                if self._is_present(one.deformable) and self._is_present(one.to)
            ),
            contacts=tuple(self._contacts(names)),
            drivers=tuple(drivers),
            markers=None
            if markers is None
            else Markers(**(markers.model_dump() | {"bodies": carriers})),
            duration_s=(self.frame_count - 1) / FRAME_RATE_HZ,
            gravity_m_per_s2=self.gravity_m_per_s2,
            air=self._air(),
        )

    def _is_present(self, body: str) -> bool:
        """Return whether a body of the scene is part of the subtask. Counted bodies share one entry of the file."""
        return body in self.present or self.spec_name(body) in self.present

    def _bodies(self, name: str) -> Iterator[RigidBody]:
        body = self.spec.bodies[name]
        motion = self._motion(name)
        poses = self.placements[name].poses()
        if len(poses) != (body.count or 1):
            raise TaskFileError(
                self.path,
                f"initial.{name}",
                f"{len(poses)} positions for {body.count or 1} bodies",
            )
        mass = self.constants.get(name, {}).get("mass_kg") or 0.0
        linear, angular = self._velocities(name, poses[0])
        for index, pose in enumerate(poses):
            yield RigidBody(
                name=f"{name}-{index + 1}" if body.count else name,
                shape=body.shape,
                motion=motion,
                pose=pose,
                mass_kg=mass,
                linear_velocity_m_per_s=linear,
                angular_velocity_rad_per_s=angular,
                inertia_kg_m2=self.constants.get(name, {}).get("inertia_kg_m2"),
            )

    def _velocities(self, name: str, pose: Pose) -> tuple[Vector, Vector]:
        """Return the start velocities of a body in the world frame [m/s, rad/s]."""
        placement, rest = self.placements[name], (0.0, 0.0, 0.0)
        linear = placement.velocity_m_per_s
        if placement.angular_velocity_deg_per_s is None:
            return linear or rest, rest
        angular = np.radians(placement.angular_velocity_deg_per_s)
        hinge = next(
            (
                joint
                for joint in self.spec.joints
                if joint.body == name and joint.kind == "hinge"
            ),
            None,
        )
        if linear is None and hinge is not None:
            linear = vector(
                np.cross(
                    angular, np.subtract(pose.position_m, self._joint(hinge).anchor_m)
                )
            )
        return linear or rest, vector(angular)

    def _deformable(self, name: str) -> Deformable:
        placement = self.placements[name]
        values: dict[str, Any] = {"name": name, "pose": placement.poses()[0]}
        values |= {
            key: value
            for key, value in self.constants[name].items()
            if key not in NOT_OF_DEFORMABLES
        }
        if any(
            (
                *(placement.velocity_m_per_s or ()),
                *(placement.angular_velocity_deg_per_s or ()),
            )
        ):
            raise ParameterError(
                f"{name!r} is deformable and starts at rest: remove its start velocity"
            )
        if name in self.spec.cloths:
            return Cloth(size_m=self.spec.cloths[name].size_m, **values)
        if name in self.spec.soft_bodies:
            return SoftBody(
                shape=Box(size_m=self.spec.soft_bodies[name].size_m), **values
            )
        line, kind = (
            (self.spec.ropes[name], Rope)
            if name in self.spec.ropes
            else (self.spec.rods[name], Rod)
        )
        return kind(length_m=line.length_m, radius_m=line.radius_m, **values)

    def _joint(self, joint: JointSpec) -> Hinge | Tether:
        placement = self.placements[joint.body]
        anchor_m = placement.hangs_from_m
        if anchor_m is None:
            raise TaskFileError(
                self.path, "joints", f"the start of {joint.body!r} needs hangs_from_m"
            )
        if joint.axis is not None:
            return Hinge(body=joint.body, anchor_m=anchor_m, axis=joint.axis)
        assert placement.length_m is not None
        return Tether(body=joint.body, anchor_m=anchor_m, length_m=placement.length_m)

    def _contacts(self, names: Sequence[str]) -> Iterator[Contact]:
        for contact in self.contacts:
            first, second = (
                tuple(n for n in names if fnmatchcase(n, pattern))
                for pattern in contact.bodies
            )
            constants = (
                self.constants.get(contact.constants_of, {})
                if contact.constants_of
                else {}
            )
            friction, restitution = (
                stated
                if (stated := getattr(contact, name)) is not None
                else constants.get(name)
                for name in ("friction", "restitution")
            )
            if friction is None or restitution is None:
                raise TaskFileError(
                    self.path,
                    "contacts",
                    f"{contact.constants_of!r} has no friction or restitution",
                )
            yield Contact(
                first=first,
                second=second,
                friction=friction,
                restitution=restitution,
                mode=contact.mode,
            )


def _has_dimensions(value: Any, dimensions: int) -> bool:
    """Return whether a value is a number, three of them, or a list of three of them each, for 0, 1 or 2 dimensions."""
    if dimensions == 0:
        return isinstance(value, int | float) and not isinstance(value, bool)
    return (
        isinstance(value, list | tuple)
        and (dimensions > 1 or len(value) == 3)
        and all(_has_dimensions(one, dimensions - 1) for one in value)
    )
