"""Task files: TOML -> `TaskSpec` (validated) -> `Experiment`, the scene of one variant and how it is observed.

A variant is a family, a subtask where the family has several, and a material: `SlopeSlider-2-wood`. Everything that
differs between variants is data in `tasks/*.toml`; this module holds no number of any experiment.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, model_validator

from gauge_envs.driver import CosineProfile, Driver, DriverMotion, Profile, SampledProfile, TrapezoidProfile
from gauge_envs.errors import ParameterError, TaskFileError, UnknownNameError
from gauge_envs.paths import data_folder
from gauge_envs.scene import (
    Attachment,
    Box,
    Cloth,
    Contact,
    ContactMode,
    ConvexUnion,
    Cylinder,
    Deformable,
    Hinge,
    Markers,
    Motion,
    Plane,
    Pose,
    Region,
    RigidBody,
    Rod,
    Rope,
    Scene,
    Shape,
    SoftBody,
    Sphere,
    Tether,
    Vector,
)

__all__ = [
    "FRAME_RATE_HZ",
    "Experiment",
    "Group",
    "Observable",
    "Parameters",
    "TaskSpec",
    "Variant",
    "experiment",
    "find_variant",
    "load_task",
    "task_files",
    "task_path",
    "task_spec",
    "variants",
]

FRAME_RATE_HZ = 30.0
"""Rate at which trajectories are recorded and scored [Hz] (paper, data acquisition)."""

PROVENANCES = ("metadata", "paper", "video", "mocap", "derived", "nominal")
"""Where a number can be from; each is explained in the README."""

Parameters = str | Mapping[str, Any]
"""`calibrated`, the name of another parameter set of the task file, or overrides such as `{"cube.friction": 0.3}`."""


class Group(StrEnum):
    """Kind of matter that an experiment is about."""

    RIGID = "rigid"
    ROPE = "rope"
    TEXTILE = "textile"
    DEFORMABLE = "deformable"


class Observable(StrEnum):
    """The generalized trajectory g(t) that is scored."""

    POSITION = "position"
    """Positions of the recorded bodies [mm]."""
    CURVATURE = "curvature"
    """Angle deficit at each marker [rad]."""
    LINE_CURVATURE = "line_curvature"
    """Turning angle at each inner marker of a line [rad]."""
    FACE_AREA = "face_area"
    """Areas of the marker triangles [mm^2]."""
    MARKER_POSITION = "marker_position"
    """Marker positions [mm]."""


# --- the file format -------------------------------------------------------------------------------------------------


def _admissible_poisson(value: float) -> float:
    if not -1.0 < value < 0.5:
        raise ValueError(f"Poisson ratio {value} is out of range: an isotropic solid needs -1 < nu < 0.5")
    return value


def _unit(vector: Vector) -> Vector:
    if abs(float(np.linalg.norm(vector)) - 1.0) > 1e-9:
        raise ValueError(f"{list(vector)} is not a unit vector")
    return vector


Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
PoissonRatio = Annotated[float, AfterValidator(_admissible_poisson)]
Vector3 = tuple[Finite, Finite, Finite]
UnitVector = Annotated[Vector3, AfterValidator(_unit)]


DriverProvenance = Literal["metadata", "paper", "video", "mocap", "derived", "nominal"]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=False)


class BoxSpec(_Table):
    """`kind = "box"`."""

    kind: Literal["box"]
    size_m: tuple[Positive, Positive, Positive]

    def build(self) -> Shape:
        """The shape."""
        return Box(size_m=self.size_m)


class SphereSpec(_Table):
    """`kind = "sphere"`."""

    kind: Literal["sphere"]
    radius_m: Positive

    def build(self) -> Shape:
        """The shape."""
        return Sphere(radius_m=self.radius_m)


class CylinderSpec(_Table):
    """`kind = "cylinder"`, axis along body z."""

    kind: Literal["cylinder"]
    radius_m: Positive
    length_m: Positive

    def build(self) -> Shape:
        """The shape."""
        return Cylinder(radius_m=self.radius_m, length_m=self.length_m)


class PlaneSpec(_Table):
    """`kind = "plane"`: the half-space below the body."""

    kind: Literal["plane"]

    def build(self) -> Shape:
        """The shape."""
        return Plane()


class ConvexUnionSpec(_Table):
    """`kind = "convex_union"`: polyhedron given as convex pieces, each by its vertices."""

    kind: Literal["convex_union"]
    pieces_m: tuple[tuple[Vector3, ...], ...] = Field(min_length=1)

    def build(self) -> Shape:
        """The shape."""
        return ConvexUnion(pieces_m=self.pieces_m)

    @model_validator(mode="after")
    def _solid(self) -> ConvexUnionSpec:
        for index, piece in enumerate(self.pieces_m):
            points = np.asarray(piece)
            if len(piece) < 4 or np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-9) < 3:
                raise ValueError(f"piece {index} is flat or has fewer than four vertices: it encloses no volume")
        return self


class PlateWithHoleSpec(_Table):
    """`kind = "plate_with_hole"`: plate with a round hole along z, cut into wedge-shaped convex pieces."""

    kind: Literal["plate_with_hole"]
    size_m: tuple[Positive, Positive, Positive]
    hole_radius_m: Positive
    hole_segments: Annotated[int, Field(ge=8, multiple_of=4)]

    def build(self) -> Shape:
        """Pieces between the hole's polygon (circumscribed: the hole is never too narrow) and the plate's outline."""
        half_x, half_y, half_z = (0.5 * edge for edge in self.size_m)
        # Angles of the polygon and of the plate's four corners, so that each piece is convex.
        corner = float(np.arctan2(half_y, half_x))
        corners = [corner, np.pi - corner, np.pi + corner, 2 * np.pi - corner]
        angles = np.concatenate([np.linspace(0, 2 * np.pi, self.hole_segments, endpoint=False), corners])
        angles = np.unique(np.round(angles, 12))
        radius = self.hole_radius_m / np.cos(np.pi / self.hole_segments)
        directions = np.column_stack([np.cos(angles), np.sin(angles)])
        inner = radius * directions
        outer = (
            directions
            * np.minimum(
                half_x / np.maximum(np.abs(directions[:, 0]), 1e-12),
                half_y / np.maximum(np.abs(directions[:, 1]), 1e-12),
            )[:, None]
        )
        pieces = []
        for i in range(len(angles)):
            j = (i + 1) % len(angles)
            outline = [inner[i], outer[i], outer[j], inner[j]]
            pieces.append(tuple((float(p[0]), float(p[1]), z) for z in (-half_z, half_z) for p in outline))
        return ConvexUnion(pieces_m=tuple(pieces))


ShapeSpec = Annotated[
    BoxSpec | SphereSpec | CylinderSpec | PlaneSpec | ConvexUnionSpec | PlateWithHoleSpec, Field(discriminator="kind")
]


class BodySpec(_Table):
    """A rigid body, or `count` equal ones named `<name>-1`, `<name>-2`, ..."""

    shape: ShapeSpec
    motion: Motion
    recorded: bool = False
    material: str | None = None
    count: Annotated[int, Field(ge=1)] | None = None


class ClothSpec(_Table):
    """A rectangular sheet."""

    size_m: tuple[Positive, Positive]
    material: str | None = None


class SoftBodySpec(_Table):
    """A volumetric elastic block."""

    size_m: tuple[Positive, Positive, Positive]
    material: str | None = None


class LineSpec(_Table):
    """A rope or an elastic rod."""

    length_m: Positive
    radius_m: Positive
    material: str | None = None


class Substituted(_Table):
    """A calibrated constant that no simulation can use as it stands, and what is used in its place."""

    calibrated: Finite
    used: Finite
    reason: str


class RigidConstants(_Table):
    """Calibrated constants of a rigid body; friction and restitution are those of its contact in this experiment."""

    mass_kg: Positive
    density_kg_per_m3: Positive | None = None
    friction: NonNegative | None = None
    restitution: Fraction | None = None


class ClothConstants(_Table):
    """Calibrated constants of a fabric."""

    mass_kg: Positive
    areal_density_kg_per_m2: Positive
    thickness_m: Positive
    stretch_stiffness_n_per_m: Positive
    shear_stiffness_n_per_m: Positive
    bend_stiffness_n_m_per_rad: Positive
    friction: NonNegative
    restitution: Fraction


class SolidConstants(_Table):
    """Calibrated constants of a foam, a rubber, a rope or a rod."""

    mass_kg: Positive
    density_kg_per_m3: Positive | None = None
    young_modulus_pa: Positive
    poisson_ratio: PoissonRatio | None = None
    friction: NonNegative
    restitution: Fraction


class Placement(_Table):
    """Where a body starts.

    Give `position_m`; or `positions_m` for counted bodies; or `hangs_from_m` and `length_m` for a body on a string or
    light rod, whose hanging position is then turned about the anchor by `euler_deg`.
    """

    position_m: Vector3 | None = None
    positions_m: tuple[Vector3, ...] | None = None
    hangs_from_m: Vector3 | None = None
    length_m: Positive | None = None
    euler_deg: Vector3 = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _one_way(self) -> Placement:
        given = [self.position_m is not None, self.positions_m is not None, self.hangs_from_m is not None]
        if sum(given) != 1:
            raise ValueError("give exactly one of position_m, positions_m, hangs_from_m")
        if (self.hangs_from_m is None) != (self.length_m is None):
            raise ValueError("hangs_from_m and length_m go together")
        return self

    def poses(self) -> list[Pose]:
        """World poses of the body or bodies."""
        if self.hangs_from_m is not None and self.length_m is not None:
            turned = Pose.from_euler_deg((0.0, 0.0, 0.0), self.euler_deg)
            x, y, z = (self.hangs_from_m + turned.to_world(np.array([0.0, 0.0, -self.length_m]))).tolist()
            return [Pose(position_m=(x, y, z), quaternion=turned.quaternion)]
        positions = self.positions_m if self.positions_m is not None else (self.position_m,)
        return [Pose.from_euler_deg(position, self.euler_deg) for position in positions if position is not None]


class JointSpec(_Table):
    """A hinge or a string to the world at the point that the body hangs from."""

    kind: Literal["hinge", "tether"]
    body: str
    axis: UnitVector | None = None

    @model_validator(mode="after")
    def _axis(self) -> JointSpec:
        if (self.kind == "hinge") != (self.axis is not None):
            raise ValueError("a hinge needs an axis, a tether has none")
        return self


class RegionSpec(_Table):
    """End of a deformable body."""

    axis: Literal["x", "y", "z"]
    side: Literal["low", "high"]
    depth_m: NonNegative = 0.0


class AttachmentSpec(_Table):
    """Glues a region of a deformable body to another body."""

    deformable: str
    region: RegionSpec
    to: str


class ContactSpec(_Table):
    """Which bodies collide, and whose calibrated constants hold for the pair."""

    bodies: tuple[str, str]
    constants_of: str | None = None
    friction: NonNegative | None = None
    restitution: Fraction | None = None
    mode: ContactMode = ContactMode.SUSTAINED


class _ProfileSpec(_Table):
    def _amount(self) -> float:
        metres, degrees = getattr(self, "amount_m", None), getattr(self, "amount_deg", None)
        return float(metres) if metres is not None else float(np.radians(degrees))


class TrapezoidSpec(_ProfileSpec):
    """`kind = "trapezoid"`: constant acceleration, cruise, braking."""

    kind: Literal["trapezoid"]
    start_s: NonNegative
    duration_s: Positive
    accelerate_s: NonNegative
    brake_s: NonNegative
    amount_m: Finite | None = None
    amount_deg: Finite | None = None

    @model_validator(mode="after")
    def _fits(self) -> TrapezoidSpec:
        if self.accelerate_s + self.brake_s > self.duration_s:
            raise ValueError("accelerate_s and brake_s together are longer than duration_s")
        return self

    def build(self) -> Profile:
        """The profile."""
        return TrapezoidProfile(
            start_s=self.start_s,
            duration_s=self.duration_s,
            accelerate_s=self.accelerate_s,
            brake_s=self.brake_s,
            amount=self._amount(),
        )


class CosineSpec(_ProfileSpec):
    """`kind = "cosine"`: half a cosine from rest to rest."""

    kind: Literal["cosine"]
    start_s: NonNegative
    duration_s: Positive
    amount_m: Finite | None = None
    amount_deg: Finite | None = None

    def build(self) -> Profile:
        """The profile."""
        return CosineProfile(start_s=self.start_s, duration_s=self.duration_s, amount=self._amount())


class SampledSpec(_Table):
    """`kind = "sampled"`: measured at times."""

    kind: Literal["sampled"]
    times_s: tuple[Finite, ...] = Field(min_length=2)
    values_m: tuple[Finite, ...] | None = None
    values_deg: tuple[Finite, ...] | None = None

    @model_validator(mode="after")
    def _increasing(self) -> SampledSpec:
        values = self.values_m if self.values_m is not None else self.values_deg
        if values is not None and len(values) != len(self.times_s):
            raise ValueError(f"{len(self.times_s)} times but {len(values)} values")
        late = [i for i in range(1, len(self.times_s)) if self.times_s[i] <= self.times_s[i - 1]]
        if late:
            i = late[0]
            raise ValueError(
                f"driver time is not increasing: times_s[{i}] = {self.times_s[i]} after {self.times_s[i - 1]}"
            )
        return self

    def build(self) -> Profile:
        """The profile."""
        values = self.values_m if self.values_m is not None else tuple(np.radians(self.values_deg or ()).tolist())
        return SampledProfile(times_s=self.times_s, values=values)


ProfileSpec = Annotated[TrapezoidSpec | CosineSpec | SampledSpec, Field(discriminator="kind")]


class MotionSpec(_Table):
    """One coordinate of a driver; `point_in_body_m` is a point of the rotation axis in the body's start frame."""

    kind: Literal["translate", "rotate"]
    axis: UnitVector
    point_in_body_m: Vector3 = (0.0, 0.0, 0.0)
    profile: tuple[ProfileSpec, ...] = ()
    residual_rate_m_per_s: NonNegative = 0.0
    residual_rate_deg_per_s: NonNegative = 0.0

    @model_validator(mode="after")
    def _units(self) -> MotionSpec:
        unit, other = ("m", "deg") if self.kind == "translate" else ("deg", "m")
        for index, profile in enumerate(self.profile):
            stem = "values" if profile.kind == "sampled" else "amount"
            if getattr(profile, f"{stem}_{unit}") is None or getattr(profile, f"{stem}_{other}") is not None:
                raise ValueError(f"profile.{index}: a {self.kind} motion needs {stem}_{unit} and no {stem}_{other}")
        if getattr(self, f"residual_rate_{other}_per_s"):
            raise ValueError(f"a {self.kind} motion takes residual_rate_{unit}_per_s")
        return self

    def build(self, start: Pose) -> DriverMotion:
        """The motion of a body that starts at a pose."""
        x, y, z = start.to_world(np.asarray(self.point_in_body_m)).tolist()
        rate = self.residual_rate_m_per_s or float(np.radians(self.residual_rate_deg_per_s))
        return DriverMotion(
            kind=self.kind,
            axis=self.axis,
            point_m=(x, y, z),
            profiles=tuple(profile.build() for profile in self.profile),
            residual_rate=rate,
        )


class DriverSpec(_Table):
    """Prescribed motion of a kinematic body, and where it is from, per material where that differs."""

    body: str
    provenance: DriverProvenance | dict[str, DriverProvenance]
    note: str
    motions: tuple[MotionSpec, ...] = Field(min_length=1)


class MarkersSpec(_Table):
    """Motion-capture markers; `positions_m` in the published order."""

    bodies: tuple[str, ...] = Field(min_length=1)
    positions_m: tuple[Vector3, ...] = Field(min_length=1)
    faces: tuple[tuple[int, int, int], ...] = ()
    lines: tuple[tuple[int, int], ...] = ()
    corner: tuple[int, ...] = ()
    edge: tuple[int, ...] = ()

    @model_validator(mode="after")
    def _indices(self) -> MarkersSpec:
        count = len(self.positions_m)
        for key in ("faces", "lines", "corner", "edge"):
            for entry in getattr(self, key):
                for index in entry if isinstance(entry, tuple) else (entry,):
                    if not 0 <= index < count:
                        raise ValueError(f"{key}: marker index {index} is out of range: there are {count} markers")
        return self


class ScoreSpec(_Table):
    """How the experiment is observed and scored."""

    observable: Observable
    metrics: tuple[Literal["rmse", "dtw", "lsd", "mte", "pd", "el"], ...] = ()
    period_axis: Literal["x", "y", "z"] | None = None


class ParameterSetSpec(_Table):
    """Named alternative values, keyed `body.constant`; per material where they differ."""

    summary: str
    values: dict[str, Any] = Field(min_length=1)


class SourceSpec(_Table):
    """What the file was transcribed from."""

    metadata: str
    paper: str
    video: str | None = None


class SubtaskSpec(_Table):
    """What a subtask adds to, or replaces in, the family."""

    title: str
    frames: dict[str, Annotated[int, Field(ge=2)]]
    bodies: tuple[str, ...] = ()
    motion: dict[str, Motion] = {}
    initial: dict[str, dict[str, Placement]] = {}
    contacts: tuple[ContactSpec, ...] | None = None
    drivers: tuple[DriverSpec, ...] | None = None


class TaskSpec(_Table):
    """One task file; its keys stand in this order."""

    family: str
    title: str
    group: Group
    summary: str
    evaluates: tuple[str, ...]
    materials: tuple[str, ...] = Field(min_length=1)
    metadata_materials: dict[str, str] = {}
    decisions: tuple[str, ...] = ()
    source: SourceSpec
    bodies: dict[str, BodySpec] = {}
    cloths: dict[str, ClothSpec] = {}
    soft_bodies: dict[str, SoftBodySpec] = {}
    ropes: dict[str, LineSpec] = {}
    rods: dict[str, LineSpec] = {}
    constants: dict[str, dict[str, dict[str, Any]]]
    initial: dict[str, dict[str, Placement]] = {}
    joints: tuple[JointSpec, ...] = ()
    attachments: tuple[AttachmentSpec, ...] = ()
    contacts: tuple[ContactSpec, ...] = ()
    score: ScoreSpec
    frames: dict[str, Annotated[int, Field(ge=2)]] = {}
    drivers: tuple[DriverSpec, ...] = ()
    markers: MarkersSpec | None = None
    parameters: dict[str, ParameterSetSpec] = {}
    subtasks: dict[str, SubtaskSpec] = {}
    provenance: dict[str, str]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all bodies, rigid and deformable, as the file spells them."""
        return (*self.bodies, *self.cloths, *self.soft_bodies, *self.ropes, *self.rods)

    def variants(self) -> tuple[Variant, ...]:
        """Variants of the family: subtasks first, then materials, in the file's order."""
        return tuple(
            Variant(self.family, subtask, material)
            for subtask in (self.subtasks or {None: None})
            for material in self.materials
        )

    def provenance_of(self, key: str) -> str:
        """Where the number under a dotted key is from: the entry with the longest matching prefix.

        Raises:
            UnknownNameError: No entry covers the key.
        """
        parts = key.split(".")
        for length in range(len(parts), 0, -1):
            prefix = ".".join(parts[:length])
            for pattern, provenance in self.provenance.items():
                if pattern.count(".") == prefix.count(".") and fnmatchcase(prefix, pattern):
                    return provenance
        raise UnknownNameError("provenance of", key, self.provenance)


# --- loading ---------------------------------------------------------------------------------------------------------


def task_files() -> tuple[Path, ...]:
    """All task files, sorted by name."""
    return tuple(sorted(data_folder("tasks").glob("*.toml")))


def load_task(path: Path) -> TaskSpec:
    """Read and validate one task file.

    Raises:
        TaskFileError: The file does not parse, has an unknown key, a value out of range, a name that nothing
            defines, or a number without provenance; the message names file, key and reason.
    """
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise TaskFileError(path, "(file)", str(error)) from error
    try:
        spec = TaskSpec.model_validate(raw)
    except ValidationError as error:
        raise _task_file_error(path, error) from error
    _check_names(path, spec)
    _check_constants(path, spec)
    _check_provenance(path, spec, raw)
    return spec


def _task_file_error(path: Path, error: ValidationError, prefix: str = "") -> TaskFileError:
    first = error.errors(include_url=False)[0]
    key = ".".join([*([prefix] if prefix else []), *(str(part) for part in first["loc"])])
    if first["type"] == "extra_forbidden":
        return TaskFileError(path, key, "unknown key")
    if first["type"] == "missing":
        return TaskFileError(path, key, "missing key")
    reason = first["msg"].removeprefix("Value error, ")
    given = first["input"]
    shown = f" (given: {given!r})" if isinstance(given, int | float | str) else ""
    return TaskFileError(path, key, reason + shown)


def _check_names(path: Path, spec: TaskSpec) -> None:
    """Every name that the file uses is one that it defines."""

    def check(key: str, name: str, known: Sequence[str]) -> None:
        if not any(fnmatchcase(candidate, name) for candidate in known):
            raise TaskFileError(path, key, f"{name!r} is not defined; known: {', '.join(known)}")

    counted = [f"{n}-{i + 1}" for n, b in spec.bodies.items() if b.count for i in range(b.count)]
    names = [*spec.names, *counted]
    everywhere = ["all", *spec.materials]
    for key, table in [("frames", spec.frames)] + [
        (f"subtasks.{k}.frames", s.frames) for k, s in spec.subtasks.items()
    ]:
        for material in table:
            check(key, material, everywhere)
    for key, initial in [("initial", spec.initial)] + [
        (f"subtasks.{k}.initial", s.initial) for k, s in spec.subtasks.items()
    ]:
        for material, placements in initial.items():
            check(key, material, everywhere)
            for name in placements:
                check(f"{key}.{material}", name, spec.names)
    for k, subtask in spec.subtasks.items():
        for name in [*subtask.bodies, *subtask.motion]:
            check(f"subtasks.{k}", name, spec.names)
    for i, joint in enumerate(spec.joints):
        check(f"joints.{i}.body", joint.body, names)
    for i, attachment in enumerate(spec.attachments):
        check(f"attachments.{i}.deformable", attachment.deformable, names)
        check(f"attachments.{i}.to", attachment.to, names)
    contact_lists = [("contacts", spec.contacts)]
    driver_lists = [("drivers", spec.drivers)]
    for k, subtask in spec.subtasks.items():
        contact_lists.append((f"subtasks.{k}.contacts", subtask.contacts or ()))
        driver_lists.append((f"subtasks.{k}.drivers", subtask.drivers or ()))
    for key, contacts in contact_lists:
        for i, contact in enumerate(contacts):
            for name in [*contact.bodies, *([contact.constants_of] if contact.constants_of else [])]:
                check(f"{key}.{i}", name, names)
            given = contact.friction is not None and contact.restitution is not None
            if contact.constants_of is None and not given:
                raise TaskFileError(path, f"{key}.{i}", "give constants_of, or both friction and restitution")
    for key, drivers in driver_lists:
        for i, driver in enumerate(drivers):
            check(f"{key}.{i}.body", driver.body, list(spec.bodies))
            if isinstance(driver.provenance, dict) and set(driver.provenance) != set(spec.materials):
                raise TaskFileError(path, f"{key}.{i}.provenance", f"name each of {', '.join(spec.materials)} once")
    if spec.markers is not None:
        for name in spec.markers.bodies:
            check("markers.bodies", name, names)


def _constants_model(spec: TaskSpec, name: str) -> type[RigidConstants | ClothConstants | SolidConstants]:
    if name in spec.bodies:
        return RigidConstants
    return ClothConstants if name in spec.cloths else SolidConstants


def _check_constants(path: Path, spec: TaskSpec) -> None:
    """Every body has the constants of every material that a variant may ask for, each in range."""
    for name in spec.constants:
        if name not in spec.names:
            raise TaskFileError(path, f"constants.{name}", f"no body of that name; known: {', '.join(spec.names)}")
    for name in spec.names:
        if name in spec.bodies and isinstance(spec.bodies[name].shape, PlaneSpec):
            continue
        owner = _owner(spec, name)
        needed = [owner.material] if owner.material else list(spec.materials)
        tables = spec.constants.get(name, {})
        for material in needed:
            if material not in tables:
                raise TaskFileError(path, f"constants.{name}.{material}", f"missing material {material!r}")
        for material, table in tables.items():
            for subtask in spec.subtasks or {None: None}:
                values = _constants_table(path, spec, name, material, subtask)
                try:
                    _constants_model(spec, name).model_validate(values)
                except ValidationError as error:
                    raise _task_file_error(path, error, f"constants.{name}.{material}") from error
            for key, value in table.items():
                if isinstance(value, dict) and "calibrated" not in value:
                    for subtask in value:
                        if subtask not in spec.subtasks:
                            raise TaskFileError(path, f"constants.{name}.{material}.{key}", f"no subtask {subtask!r}")


def _owner(spec: TaskSpec, name: str) -> BodySpec | ClothSpec | SoftBodySpec | LineSpec:
    for table in (spec.bodies, spec.cloths, spec.soft_bodies, spec.ropes, spec.rods):
        if name in table:
            return table[name]
    raise KeyError(name)


def _constants_table(
    path: Path | str, spec: TaskSpec, name: str, material: str, subtask: str | None
) -> dict[str, float | None]:
    """Constants of one body in one variant, with per-subtask values picked and substitutes put in."""
    values: dict[str, float | None] = {}
    for key, value in spec.constants[name][material].items():
        if isinstance(value, dict) and "calibrated" in value:
            try:
                values[key] = Substituted.model_validate(value).used
            except ValidationError as error:
                raise _task_file_error(path, error, f"constants.{name}.{material}.{key}") from error
        elif isinstance(value, dict):
            values[key] = value.get(subtask)
        else:
            values[key] = value
    return values


def _number_keys(value: Any, key: str = "") -> Iterator[str]:
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _number_keys(inner, f"{key}.{name}" if key else name)
    elif isinstance(value, list) and any(isinstance(entry, dict) for entry in value):
        for index, inner in enumerate(value):
            yield from _number_keys(inner, f"{key}.{index}")
    elif isinstance(value, list):
        if not all(isinstance(entry, str) for entry in value):
            yield key
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield key


def _check_provenance(path: Path, spec: TaskSpec, raw: dict[str, Any]) -> None:
    """Every number of the file is covered by a provenance entry of a known kind."""
    for key, provenance in spec.provenance.items():
        if provenance.split(":")[0] not in PROVENANCES:
            raise TaskFileError(
                path, f"provenance.{key}", f"{provenance!r} must start with one of {', '.join(PROVENANCES)}"
            )
    for key in _number_keys({k: v for k, v in raw.items() if k != "provenance"}):
        try:
            spec.provenance_of(key)
        except UnknownNameError as error:
            raise TaskFileError(path, key, "a number without an entry in [provenance]") from error


@cache
def _headers() -> dict[str, tuple[Path, dict[str, Any]]]:
    """Path and raw content of every task file, by family; read once, validated only when a family is used."""
    headers = {}
    for path in task_files():
        try:
            raw = tomllib.loads(path.read_text(encoding="utf-8"))
            headers[raw["family"]] = (path, raw)
        except (tomllib.TOMLDecodeError, KeyError) as error:
            raise TaskFileError(path, "family", f"cannot be read: {error}") from error
    return headers


def task_path(family: str) -> Path:
    """Path of a family's task file.

    Raises:
        UnknownNameError: No such family.
    """
    try:
        return _headers()[family][0]
    except KeyError:
        raise UnknownNameError("family", family, _headers()) from None


@cache
def task_spec(family: str) -> TaskSpec:
    """The validated task file of a family.

    Raises:
        UnknownNameError: No such family.
        TaskFileError: Its file is wrong.
    """
    return load_task(task_path(family))


# --- variants --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, order=True)
class Variant:
    """Family, subtask (None where the family has one experiment) and material."""

    family: str
    subtask: str | None
    material: str

    @property
    def name(self) -> str:
        """`SlopeSlider-2-wood`."""
        return "-".join(part for part in (self.family, self.subtask, self.material) if part)

    @property
    def id(self) -> str:
        """Gymnasium id, `GAUGE/SlopeSlider-2-wood`."""
        return f"GAUGE/{self.name}"


@cache
def variants() -> tuple[Variant, ...]:
    """All variants, in the order of the task files.

    Reads only names, so that importing the package stays light; a file is validated when one of its variants is used.
    """
    return tuple(
        Variant(family, subtask, material)
        for family, (_, raw) in _headers().items()
        for subtask in raw.get("subtasks") or {None: None}
        for material in raw["materials"]
    )


def find_variant(name: str) -> Variant:
    """Variant by its name or Gymnasium id.

    Raises:
        UnknownNameError: There is none; the message offers the nearest.
    """
    by_name = {variant.name: variant for variant in variants()}
    try:
        return by_name[name.removeprefix("GAUGE/")]
    except KeyError:
        raise UnknownNameError("experiment", name, by_name) from None


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """One variant, resolved: its scene and how it is observed.

    Attributes:
        variant: Which one.
        spec: Its task file.
        scene: What a backend builds.
        recorded: Names of the bodies whose positions are observed.
        frame_count: Frames of an episode, the first included.
        parameters: Name of the parameter set, or `custom`.
        overrides: What differs from the calibrated constants, keyed `body.constant`.
        driver_provenance: Where the driven motion is from; None where nothing is driven.
    """

    variant: Variant
    spec: TaskSpec
    scene: Scene
    recorded: tuple[str, ...]
    frame_count: int
    parameters: str
    overrides: Mapping[str, Any]
    driver_provenance: str | None


def experiment(name: str | Variant, parameters: Parameters = "calibrated") -> Experiment:
    """Resolve one variant.

    Args:
        name: Variant, its name, or its Gymnasium id.
        parameters: `calibrated`, another parameter set of the task file, or overrides keyed `body.constant`, where a
            constant is a mass, friction, stiffness, ... or `position_m`, `euler_deg`, `hangs_from_m`, `length_m`.

    Raises:
        UnknownNameError: No such variant.
        ParameterError: No such parameter set, body or constant, or a value out of range.
        TaskFileError: The task file is wrong.
    """
    variant = find_variant(name) if isinstance(name, str) else name
    path, spec = task_path(variant.family), task_spec(variant.family)
    label, overrides = _overrides(spec, variant, parameters)
    builder = _SceneBuilder(path, spec, variant, overrides)
    scene = builder.build()
    recorded = tuple(b.name for b in scene.bodies if spec.bodies[builder.spec_name(b.name)].recorded)
    drivers = {driver.provenance for driver in scene.drivers}
    return Experiment(
        variant=variant,
        spec=spec,
        scene=scene,
        recorded=recorded,
        frame_count=builder.frame_count,
        parameters=label,
        overrides=overrides,
        driver_provenance=", ".join(sorted(drivers)) or None,
    )


def _overrides(spec: TaskSpec, variant: Variant, parameters: Parameters) -> tuple[str, dict[str, Any]]:
    if isinstance(parameters, Mapping):
        return ("custom" if parameters else "calibrated"), dict(parameters)
    if parameters == "calibrated":
        return parameters, {}
    if parameters not in spec.parameters:
        known = ", ".join(["calibrated", *spec.parameters])
        raise ParameterError(f"{variant.name} has no parameter set {parameters!r}; it has: {known}")
    values = spec.parameters[parameters].values
    return parameters, {k: v[variant.material] if isinstance(v, dict) else v for k, v in values.items()}


class _SceneBuilder:
    """Puts one variant's scene together from its task file."""

    def __init__(self, path: Path, spec: TaskSpec, variant: Variant, overrides: Mapping[str, Any]) -> None:
        self.path = path
        self.spec = spec
        self.variant = variant
        self.subtask = spec.subtasks[variant.subtask] if variant.subtask else None
        self.present = self.subtask.bodies if self.subtask and self.subtask.bodies else spec.names
        self.placements = self._placements()
        self.constants = {
            name: _constants_table(path, spec, name, _owner(spec, name).material or variant.material, variant.subtask)
            for name in self.present
            if name in spec.constants
        }
        for key, value in overrides.items():
            self._override(key, value)
        frames = self.subtask.frames if self.subtask else spec.frames
        try:
            self.frame_count = frames.get(variant.material) or frames["all"]
        except KeyError:
            raise TaskFileError(path, "frames", f"no frame count for {variant.name}") from None

    def _placements(self) -> dict[str, Placement]:
        merged: dict[str, Placement] = {}
        tables = [self.spec.initial] + ([self.subtask.initial] if self.subtask else [])
        for table in tables:
            for material in ("all", self.variant.material):
                merged.update(table.get(material, {}))
        for name in self.present:
            if name not in merged:
                raise TaskFileError(self.path, "initial", f"no start of {name!r} for {self.variant.name}")
        return merged

    def _override(self, key: str, value: Any) -> None:
        name, _, constant = key.rpartition(".")
        if name not in self.present:
            known = ", ".join(self.present)
            raise ParameterError(f"{self.variant.name}: override {key!r} names no body of the scene; bodies: {known}")
        if constant in Placement.model_fields:
            table, model = self.placements[name].model_dump(exclude_none=True) | {constant: value}, Placement
        elif constant in self.constants.get(name, {}):
            table, model = self.constants[name] | {constant: value}, _constants_model(self.spec, name)
        else:
            known = ", ".join([*self.constants.get(name, {}), *Placement.model_fields])
            raise ParameterError(f"{self.variant.name}: {name!r} has no constant {constant!r}; it has: {known}")
        try:
            checked = TypeAdapter(model).validate_python(table)
        except ValidationError as error:
            raise ParameterError(
                f"{self.variant.name}: override {key!r} = {value!r}: {error.errors()[0]['msg']}"
            ) from error
        if isinstance(checked, Placement):
            self.placements[name] = checked
        else:
            self.constants[name] = table

    def spec_name(self, body: str) -> str:
        """Name in the task file of a scene body: counted bodies share one entry."""
        return body if body in self.spec.bodies else body.rpartition("-")[0]

    def build(self) -> Scene:
        bodies = tuple(body for name in self.present if name in self.spec.bodies for body in self._bodies(name))
        poses = {body.name: body.pose for body in bodies}
        names = [*poses, *(n for n in self.present if n not in self.spec.bodies)]
        specs = self.subtask.drivers if self.subtask and self.subtask.drivers is not None else self.spec.drivers
        drivers = tuple(
            Driver(
                body=driver.body,
                motions=tuple(motion.build(poses[driver.body]) for motion in driver.motions),
                provenance=driver.provenance
                if isinstance(driver.provenance, str)
                else driver.provenance[self.variant.material],
            )
            for driver in specs
        )
        for driver in drivers:
            motion = next(body.motion for body in bodies if body.name == driver.body)
            if motion is not Motion.KINEMATIC:
                raise TaskFileError(self.path, "drivers", f"{driver.body!r} is driven but {motion}, not kinematic")
        markers = self.spec.markers
        return Scene(
            bodies=bodies,
            deformables=tuple(self._deformable(name) for name in self.present if name not in self.spec.bodies),
            joints=tuple(self._joint(joint) for joint in self.spec.joints),
            attachments=tuple(
                Attachment(deformable=a.deformable, region=Region(**a.region.model_dump()), to=a.to)
                for a in self.spec.attachments
            ),
            contacts=tuple(self._contacts(names)),
            drivers=drivers,
            markers=None if markers is None else Markers(**markers.model_dump()),
            duration_s=(self.frame_count - 1) / FRAME_RATE_HZ,
        )

    def _bodies(self, name: str) -> Iterator[RigidBody]:
        body = self.spec.bodies[name]
        motion = self.subtask.motion.get(name, body.motion) if self.subtask else body.motion
        poses = self.placements[name].poses()
        if len(poses) != (body.count or 1):
            raise TaskFileError(self.path, f"initial.{name}", f"{len(poses)} positions for {body.count or 1} bodies")
        mass = self.constants.get(name, {}).get("mass_kg") or 0.0
        for index, pose in enumerate(poses):
            yield RigidBody(
                name=f"{name}-{index + 1}" if body.count else name,
                shape=body.shape.build(),
                motion=motion,
                pose=pose,
                mass_kg=mass,
            )

    def _deformable(self, name: str) -> Deformable:
        values = dict(self.constants[name])
        pose = self.placements[name].poses()[0]
        for key in ("friction", "restitution", "density_kg_per_m3"):
            values.pop(key, None)
        if name in self.spec.cloths:
            return Cloth(name=name, pose=pose, size_m=self.spec.cloths[name].size_m, **values)
        if name in self.spec.soft_bodies:
            return SoftBody(name=name, pose=pose, shape=Box(size_m=self.spec.soft_bodies[name].size_m), **values)
        line, kind = (self.spec.ropes[name], Rope) if name in self.spec.ropes else (self.spec.rods[name], Rod)
        return kind(name=name, pose=pose, length_m=line.length_m, radius_m=line.radius_m, **values)

    def _joint(self, joint: JointSpec) -> Hinge | Tether:
        placement = self.placements[joint.body]
        if placement.hangs_from_m is None or placement.length_m is None:
            raise TaskFileError(self.path, "joints", f"the start of {joint.body!r} lacks hangs_from_m")
        if joint.axis is not None:
            return Hinge(body=joint.body, anchor_m=placement.hangs_from_m, axis=joint.axis)
        return Tether(body=joint.body, anchor_m=placement.hangs_from_m, length_m=placement.length_m)

    def _contacts(self, names: Sequence[str]) -> Iterator[Contact]:
        contacts = self.spec.contacts
        if self.subtask and self.subtask.contacts is not None:
            contacts = self.subtask.contacts
        for contact in contacts:
            first, second = (tuple(n for n in names if fnmatchcase(n, pattern)) for pattern in contact.bodies)
            constants = self.constants.get(contact.constants_of, {}) if contact.constants_of else {}
            friction = contact.friction if contact.friction is not None else constants.get("friction")
            restitution = contact.restitution if contact.restitution is not None else constants.get("restitution")
            if friction is None or restitution is None:
                raise TaskFileError(self.path, "contacts", f"{contact.constants_of!r} has no friction or restitution")
            yield Contact(first=first, second=second, friction=friction, restitution=restitution, mode=contact.mode)
