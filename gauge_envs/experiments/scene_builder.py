"""Build the scene of one variant from its task file."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from gauge_envs.errors import ParameterError, TaskFileError, first_fault, nearest
from gauge_envs.experiments.tables import JointConstants, MotorSpec, hinge_terms
from gauge_envs.experiments.task_format import JointSpec, Placement, TaskSpec
from gauge_envs.experiments.variants import Variant
from gauge_envs.scene import (
    Air,
    BodyHinge,
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
from gauge_envs.scene.timing import FRAME_RATE_HZ

AIR = "air"
"""Name under which overrides state the air of a scene, as `air.density_kg_per_m3`."""

NOT_OF_DEFORMABLES = ("friction", "restitution", "density_kg_per_m3")
"""Constants of a task file that are those of contacts, or follow from others."""

Parameters = str | Mapping[str, Any]
"""`calibrated`, another parameter set of the task file, or overrides such as `{"cube.friction": 0.3}`."""


def parameter_overrides(
    spec: TaskSpec, variant: Variant, parameters: Parameters
) -> tuple[str, dict[str, Any]]:
    """Return the name of the parameters, `custom` for overrides, and the overrides that they are."""
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
        for key, value in overrides.items():
            self._override(key, value)
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

    def _override(self, key: str, value: Any) -> None:
        name, _, constant = key.rpartition(".")
        if name == AIR:
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
                f"{self.variant.name}: override {key!r} names no body of the scene ({AIR!r} for cloth); {hint}"
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
            raise TaskFileError(self.path, "(file)", str(error)) from None

    def _check_hinges(self) -> None:
        """Check that each body with constants of a joint has one hinge that they belong to."""
        hinged = [joint.body for joint in self.spec.joints if joint.axis] + [
            h.bodies[1] for h in self.spec.body_hinges
        ]
        owners = {self.spec_name(name) for name in hinged}
        for name, constants in self.constants.items():
            stated = constants.keys() & JointConstants.model_fields.keys()
            if stated and (name not in owners or hinged.count(name) > 1):
                reason = f"{min(stated)} is a constant of one hinge, and {name!r} has {hinged.count(name)}"
                which = "a hinge to the world is of its body, one between bodies of its second body"
                raise TaskFileError(
                    self.path, f"constants.{name}", f"{reason}: {which}"
                )

    def _scene(self) -> Scene:
        self._check_hinges()
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
            body_hinges=tuple(
                BodyHinge(
                    first=first,
                    second=second,
                    anchor_m=one.anchor_m,
                    axis=one.axis,
                    **self._terms(second, one.motor),
                )
                for one in self.spec.body_hinges
                for first, second in [one.bodies]
                if self._is_present(first) and self._is_present(second)
            ),
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
            air=self._air(),
        )

    def _is_present(self, body: str) -> bool:
        """Return whether a body of the scene is part of the subtask. Counted bodies share one entry of the file."""
        return body in self.present or self.spec_name(body) in self.present

    def _bodies(self, name: str) -> Iterator[RigidBody]:
        body = self.spec.bodies[name]
        motion = (
            self.subtask.motion.get(name, body.motion) if self.subtask else body.motion
        )
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
        anchor_m = placement.hangs_from_m or joint.anchor_m
        if anchor_m is None or (placement.hangs_from_m and joint.anchor_m):
            needed = "hangs_from_m, or its hinge an anchor_m, and not both"
            raise TaskFileError(
                self.path, "joints", f"the start of {joint.body!r} needs {needed}"
            )
        if joint.axis is not None:
            terms = self._terms(joint.body, joint.motor)
            return Hinge(body=joint.body, anchor_m=anchor_m, axis=joint.axis, **terms)
        assert placement.length_m is not None
        return Tether(body=joint.body, anchor_m=anchor_m, length_m=placement.length_m)

    def _terms(self, body: str, motor: MotorSpec | None) -> dict[str, Any]:
        """Return `dynamics` and `motor` of the hinge whose constants a body states."""
        try:
            return hinge_terms(self.constants.get(self.spec_name(body), {}), motor)
        except ValueError as error:
            raise TaskFileError(self.path, f"constants.{body}", str(error)) from None

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
