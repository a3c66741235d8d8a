"""Build the scene of one variant from its task file, with overrides of constants and initial states."""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from fnmatch import fnmatchcase
from typing import Annotated, Any

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from gauge_envs.errors import ParameterError
from gauge_envs.experiments.names import Variant
from gauge_envs.experiments.task_format import (
    AnyBody,
    BodySpec,
    ClothSpec,
    ContactSpec,
    JointSpec,
    LineSpec,
    Placement,
    SoftBodySpec,
    TaskSpec,
)
from gauge_envs.names import nearest
from gauge_envs.scene import (
    Air,
    Box,
    Cloth,
    Contact,
    Deformable,
    Hinge,
    Markers,
    Motion,
    Plane,
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
from gauge_envs.validation import first_fault

AIR = "air"
"""Prefix of overrides of the air of a scene, as `air.density_kg_per_m3`."""

AIR_CONSTANTS = [field.name for field in fields(Air)]

GRAVITY = "scene.gravity_m_per_s2"
"""Key of the override of gravity [m/s^2]."""

GRAVITY_TYPE = TypeAdapter(Annotated[float, Field(gt=0.0, allow_inf_nan=False)])

OF_NO_FABRIC = ("friction", "restitution", "density_kg_per_m3")
"""Constants of a deformable body that contacts use, or that follow from others."""

Parameters = str | Mapping[str, Any]
"""`published`, another parameter set of the task file, or overrides such as `{"cube.friction": 0.3}`."""


def parameter_overrides(
    spec: TaskSpec, variant: Variant, parameters: Parameters
) -> tuple[str, dict[str, Any]]:
    """Return the name of the parameters, `custom` for overrides, and their overrides."""
    if isinstance(parameters, Mapping):
        return ("custom" if parameters else "published"), dict(parameters)
    if not isinstance(parameters, str):
        raise ParameterError(
            f"parameters is {parameters!r}: expected the name of a parameter set, as 'published', or overrides, as "
            "{'cube.friction': 0.3}"
        )
    if parameters == "published":
        return parameters, {}
    if parameters not in spec.parameters:
        hint = nearest(parameters, ["published", *spec.parameters])
        raise ParameterError(
            f"{variant.name} has no parameter set {parameters!r}; {hint}"
        )
    values = spec.parameters[parameters].values
    return parameters, {
        key: value[variant.material] if isinstance(value, dict) else value
        for key, value in values.items()
    }


class SceneBuilder:
    """Builder of the scene of one variant.

    Attributes:
        placements: Placement of each body, by its name in the task file.
        constants: Constants of each body, by its name in the task file.
        read: Keys `body.constant` of the constants on which the motion depends; complete after `build`.

    Args:
        spec: Content of the task file.
        variant: The variant.
        overrides: Values that replace those of the file, keyed `body.constant`.

    Raises:
        ParameterError: The key of an override is unknown, or its value is out of range.
        ValueError: The file lacks a placement or a material.
    """

    def __init__(
        self, spec: TaskSpec, variant: Variant, overrides: Mapping[str, Any]
    ) -> None:
        self.spec = spec
        self.variant = variant
        self._bodies = spec.bodies_of(variant)
        self.placements = spec.placements_of(variant)
        for name in self._bodies:
            if name not in self.placements:
                raise ValueError(f"initial: no start of {name!r} for {variant.name}")
        self.constants = {
            name: self._material_constants(name)
            for name, table in self._bodies.items()
            if name in spec.constants or not _is_plane(table)
        }
        self.read: set[str] = set()
        self._air: dict[str, Any] = {}
        self._gravity_m_per_s2 = GRAVITY_M_PER_S2
        for key, value in overrides.items():
            try:
                self._override(key, value)
            except ValidationError as error:
                fault = ": ".join(filter(None, first_fault(error, noun="number")))
                raise ParameterError(f"override {key!r}: {fault}") from error
            except ParameterError as error:
                raise ParameterError(f"override {key!r} {error}") from error

    def _material_constants(self, name: str) -> dict[str, float | None]:
        material = self._bodies[name].material or self.variant.material
        if material not in self.spec.constants.get(name, {}):
            raise ValueError(f"constants.{name}: no material {material!r}")
        values = self.spec.constants_of(name, material, self.variant.subtask)
        try:
            self.spec.constants_model(name).model_validate(values)
        except ValidationError as error:
            key, reason = first_fault(error)
            raise ValueError(f"constants.{name}.{material}.{key}: {reason}") from error
        return values

    # --- overrides ---------------------------------------------------------------------------------------------------

    def _override(self, key: str, value: Any) -> None:
        """Replace one value; the message of an error continues "override KEY"."""
        name, _, constant = key.rpartition(".")
        if value is None:
            raise ParameterError("is None: expected numbers")
        if key == GRAVITY:
            self._gravity_m_per_s2 = GRAVITY_TYPE.validate_json(
                _json(value), strict=True
            )
        elif name == AIR and constant in AIR_CONSTANTS:
            self._air[constant] = value
        elif name not in (AIR, *self._bodies):
            raise ParameterError(
                f"names no body of the scene ({AIR!r} for cloth, {GRAVITY!r}); {nearest(name, self._bodies)}"
            )
        elif constant in Placement.model_fields:
            placed = self.placements[name].model_dump(exclude_none=True)
            self.placements[name] = Placement.model_validate_json(
                _json(placed | {constant: value}), strict=True
            )
        elif constant in self.constants.get(name, {}):
            constants = self.constants[name] | {constant: value}
            model = self.spec.constants_model(name)
            self.constants[name] = model.model_validate_json(
                _json(constants), strict=True
            ).model_dump(exclude_unset=True)
        else:
            known = [*self.constants.get(name, {}), *Placement.model_fields]
            if name == AIR:
                known = AIR_CONSTANTS
            raise ParameterError(
                f"names no constant of {name!r}; {nearest(constant, known)}"
            )

    def is_constant(self, key: str) -> bool:
        """Return whether the key of an override is a constant of a body."""
        name, _, constant = key.rpartition(".")
        return constant in self.constants.get(name, {})

    def check_read(self, overrides: Mapping[str, Any]) -> None:
        """Raise an error for an override of a constant without effect; it lists constants with an effect."""
        for key in overrides:
            if not self.is_constant(key) or key in self.read:
                continue
            name, _, constant = key.rpartition(".")
            near = [
                other_key
                for other_key in sorted(self.read)
                if other_key.startswith(f"{name}.")
                or other_key.endswith(f".{constant}")
            ]
            raise ParameterError(
                f"override {key!r} would change nothing: no motion depends on it. "
                f"Those that change the scene: {', '.join(near or sorted(self.read))}"
            )

    def _read(
        self, name: str, constant: str, *, has_effect: bool = True
    ) -> float | None:
        """Return a constant, or None, and add it to `read` if the motion depends on it."""
        constants = self.constants.get(name, {})
        if has_effect and constant in constants:
            self.read.add(f"{name}.{constant}")
        return constants.get(constant)

    # --- scene -------------------------------------------------------------------------------------------------------

    def build(self) -> Scene:
        """Return the scene.

        Raises:
            ValueError: The tables contradict one another.
        """
        spec, variant = self.spec, self.variant
        bodies = tuple(
            body
            for name, table in self._bodies.items()
            if isinstance(table, BodySpec)
            for body in self._rigid_bodies(name, table)
        )
        deformables = tuple(
            self._deformable(name, table)
            for name, table in self._bodies.items()
            if not isinstance(table, BodySpec)
        )
        bodies_by_name = {body.name: body for body in bodies}
        kinematic = [body.name for body in bodies if body.motion is Motion.KINEMATIC]
        for driver in spec.drivers_of(variant):
            if driver.body not in kinematic:
                raise ValueError(f"drivers: {driver.body!r} is not kinematic")
        names = [*bodies_by_name, *(body.name for body in deformables)]
        return Scene(
            bodies=bodies,
            deformables=deformables,
            joints=tuple(map(self._joint, spec.joints)),
            attachments=tuple(
                attachment
                for attachment in spec.attachments
                if attachment.deformable in names and attachment.to in names
            ),
            contacts=tuple(
                self._contact(contact, names) for contact in spec.contacts_of(variant)
            ),
            drivers=tuple(
                driver.build(bodies_by_name[driver.body].pose, variant.material)
                for driver in spec.drivers_of(variant)
            ),
            markers=self._markers(),
            duration_s=(spec.frame_count(variant) - 1) / FRAME_RATE_HZ,
            gravity_m_per_s2=self._gravity_m_per_s2,
            air=self._scene_air(),
        )

    def _rigid_bodies(self, name: str, body: BodySpec) -> Iterator[RigidBody]:
        is_dynamic = body.motion is Motion.DYNAMIC
        mass_kg = self._read(name, "mass_kg", has_effect=is_dynamic)
        inertia_kg_m2 = self._read(name, "inertia_kg_m2", has_effect=is_dynamic)
        poses = self.placements[name].poses()
        names = [name]
        if body.count:
            names = [f"{name}-{index + 1}" for index in range(body.count)]
        if len(poses) != len(names):
            raise ValueError(
                f"initial.{name}: {len(poses)} positions for {len(names)} bodies"
            )
        linear, angular = self._velocities(name, poses[0])
        for body_name, pose in zip(names, poses, strict=True):
            yield RigidBody(
                name=body_name,
                shape=body.shape,
                motion=body.motion,
                pose=pose,
                mass_kg=mass_kg or 0.0,
                linear_velocity_m_per_s=linear,
                angular_velocity_rad_per_s=angular,
                inertia_kg_m2=inertia_kg_m2,
            )

    def _velocities(self, name: str, pose: Pose) -> tuple[Vector, Vector]:
        """Return the initial velocities of a body in the world frame [m/s, rad/s]."""
        placement, rest = self.placements[name], (0.0, 0.0, 0.0)
        linear = placement.velocity_m_per_s
        if placement.angular_velocity_deg_per_s is None:
            return linear or rest, rest
        angular = np.radians(placement.angular_velocity_deg_per_s)
        is_hinged = any(
            joint.body == name and joint.kind == "hinge" for joint in self.spec.joints
        )
        if linear is None and is_hinged and placement.hangs_from_m is not None:
            arm_m = np.subtract(pose.position_m, placement.hangs_from_m)
            linear = vector(np.cross(angular, arm_m))
        return linear or rest, vector(angular)

    def _deformable(
        self, name: str, body: ClothSpec | SoftBodySpec | LineSpec
    ) -> Deformable:
        placement = self.placements[name]
        speeds = (
            *(placement.velocity_m_per_s or ()),
            *(placement.angular_velocity_deg_per_s or ()),
        )
        if any(speeds):
            raise ParameterError(
                f"{name!r} is deformable and starts at rest: remove its start velocity"
            )
        values: dict[str, Any] = {"name": name, "pose": placement.poses()[0]}
        for constant in self.constants[name]:
            if constant not in OF_NO_FABRIC:
                # The mass of a cloth follows from its size, so it has no effect of its own.
                is_free = not isinstance(body, ClothSpec) or constant != "mass_kg"
                values[constant] = self._read(name, constant, has_effect=is_free)
        if isinstance(body, ClothSpec):
            warp_angle_rad = math.radians(body.warp_angle_deg)
            return Cloth(size_m=body.size_m, warp_angle_rad=warp_angle_rad, **values)
        if isinstance(body, SoftBodySpec):
            return SoftBody(shape=Box(size_m=body.size_m), **values)
        kind = Rope if name in self.spec.ropes else Rod
        return kind(length_m=body.length_m, radius_m=body.radius_m, **values)

    def _joint(self, joint: JointSpec) -> Hinge | Tether:
        placement = self.placements.get(joint.body)
        if (
            placement is None
            or placement.hangs_from_m is None
            or placement.length_m is None
        ):
            raise ValueError(f"joints: the start of {joint.body!r} needs hangs_from_m")
        if joint.axis is not None:
            return Hinge(
                body=joint.body, anchor_m=placement.hangs_from_m, axis=joint.axis
            )
        return Tether(
            body=joint.body,
            anchor_m=placement.hangs_from_m,
            length_m=placement.length_m,
        )

    def _contact(self, spec: ContactSpec, names: list[str]) -> Contact:
        first, second = (
            tuple(name for name in names if fnmatchcase(name, pattern))
            for pattern in spec.bodies
        )
        entries = {self.spec.entry(name) for name in (*first, *second)}
        moves = any(
            not isinstance(body := self._bodies[name], BodySpec)
            or body.motion is Motion.DYNAMIC
            for name in entries
        )
        is_effective = bool(first and second) and moves
        values = {}
        for constant in ("friction", "restitution"):
            number = self._read(spec.constants_of, constant, has_effect=is_effective)
            if number is None:
                raise ValueError(f"contacts: {spec.constants_of!r} has no {constant}")
            values[constant] = number
        return Contact(first=first, second=second, mode=spec.mode, **values)

    def _markers(self) -> Markers | None:
        markers = self.spec.markers
        if markers is None:
            return None
        carriers = tuple(name for name in markers.bodies if name in self._bodies)
        return replace(markers, bodies=carriers)

    def _scene_air(self) -> Air | None:
        """Return the air of the overrides; None without overrides of air."""
        if not self._air:
            return None
        try:
            return TypeAdapter(Air).validate_json(_json(self._air), strict=True)
        except ValidationError as error:
            place, reason = first_fault(error)
            raise ParameterError(f"override 'air.{place}': {reason}") from error


def _is_plane(body: AnyBody) -> bool:
    return isinstance(body, BodySpec) and isinstance(body.shape, Plane)


def _json(value: Any) -> str:
    """Return an override as JSON, so that pydantic reads lists as tuples and rejects texts as numbers."""
    return json.dumps(value, default=_plain)


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else repr(value)
