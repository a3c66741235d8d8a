"""The format of a task file: one pydantic table for each TOML table, in SI units; unknown keys are errors."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from fnmatch import fnmatchcase
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from gauge_envs.driver import CosineProfile, DriverMotion, Profile, SampledProfile, TrapezoidProfile
from gauge_envs.errors import UnknownNameError
from gauge_envs.scene import (
    Box,
    ContactMode,
    ConvexUnion,
    Cylinder,
    Motion,
    Plane,
    Pose,
    Shape,
    Sphere,
    Vector,
)

__all__ = [
    "FRAME_RATE_HZ",
    "PROVENANCES",
    "ClothConstants",
    "ContactSpec",
    "DriverSpec",
    "Fraction",
    "Group",
    "JointSpec",
    "MarkersSpec",
    "NonNegative",
    "Observable",
    "Placement",
    "PlaneSpec",
    "Positive",
    "RigidConstants",
    "ScoreSpec",
    "SolidConstants",
    "Table",
    "TaskSpec",
    "Variant",
]

FRAME_RATE_HZ = 30.0
"""Rate at which trajectories are recorded and scored [Hz] (paper, data acquisition)."""

PROVENANCES = ("metadata", "paper", "video", "mocap", "derived", "nominal")
"""Where a number can be from; each is explained in the README."""


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

    @property
    def unit(self) -> str:
        """Unit of g(t)."""
        if self in (Observable.CURVATURE, Observable.LINE_CURVATURE):
            return "rad"
        return "mm^2" if self is Observable.FACE_AREA else "mm"


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


class Table(BaseModel):
    """One TOML table: frozen, and without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False)


class BoxSpec(Table):
    """`kind = "box"`."""

    kind: Literal["box"]
    size_m: tuple[Positive, Positive, Positive]

    def build(self) -> Shape:
        """The shape."""
        return Box(size_m=self.size_m)


class SphereSpec(Table):
    """`kind = "sphere"`."""

    kind: Literal["sphere"]
    radius_m: Positive

    def build(self) -> Shape:
        """The shape."""
        return Sphere(radius_m=self.radius_m)


class CylinderSpec(Table):
    """`kind = "cylinder"`, axis along body z."""

    kind: Literal["cylinder"]
    radius_m: Positive
    length_m: Positive

    def build(self) -> Shape:
        """The shape."""
        return Cylinder(radius_m=self.radius_m, length_m=self.length_m)


class PlaneSpec(Table):
    """`kind = "plane"`: the half-space below the body."""

    kind: Literal["plane"]

    def build(self) -> Shape:
        """The shape."""
        return Plane()


class ConvexUnionSpec(Table):
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


class PlateWithHoleSpec(Table):
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


class BodySpec(Table):
    """A rigid body, or `count` equal ones named `<name>-1`, `<name>-2`, ..."""

    shape: ShapeSpec
    motion: Motion
    recorded: bool = False
    material: str | None = None
    count: Annotated[int, Field(ge=1)] | None = None


class ClothSpec(Table):
    """A rectangular sheet."""

    size_m: tuple[Positive, Positive]
    material: str | None = None


class SoftBodySpec(Table):
    """A volumetric elastic block."""

    size_m: tuple[Positive, Positive, Positive]
    material: str | None = None


class LineSpec(Table):
    """A rope or an elastic rod."""

    length_m: Positive
    radius_m: Positive
    material: str | None = None


class Substituted(Table):
    """A calibrated constant that no simulation can use as it stands, and what is used in its place."""

    calibrated: Finite
    used: Finite
    reason: str


class RigidConstants(Table):
    """Calibrated constants of a rigid body; friction and restitution are those of its contact in this experiment."""

    mass_kg: Positive
    density_kg_per_m3: Positive | None = None
    friction: NonNegative | None = None
    restitution: Fraction | None = None


class ClothConstants(Table):
    """Calibrated constants of a fabric."""

    mass_kg: Positive
    areal_density_kg_per_m2: Positive
    thickness_m: Positive
    stretch_stiffness_n_per_m: Positive
    shear_stiffness_n_per_m: Positive
    bend_stiffness_n_m_per_rad: Positive
    friction: NonNegative
    restitution: Fraction


class SolidConstants(Table):
    """Calibrated constants of a foam, a rubber, a rope or a rod."""

    mass_kg: Positive
    density_kg_per_m3: Positive | None = None
    young_modulus_pa: Positive
    poisson_ratio: PoissonRatio | None = None
    friction: NonNegative
    restitution: Fraction


class Placement(Table):
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


class JointSpec(Table):
    """A hinge or a string to the world at the point that the body hangs from."""

    kind: Literal["hinge", "tether"]
    body: str
    axis: UnitVector | None = None

    @model_validator(mode="after")
    def _axis(self) -> JointSpec:
        if (self.kind == "hinge") != (self.axis is not None):
            raise ValueError("a hinge needs an axis, a tether has none")
        return self


class RegionSpec(Table):
    """End of a deformable body."""

    axis: Literal["x", "y", "z"]
    side: Literal["low", "high"]
    depth_m: NonNegative = 0.0


class AttachmentSpec(Table):
    """Glues a region of a deformable body to another body."""

    deformable: str
    region: RegionSpec
    to: str


class ContactSpec(Table):
    """Which bodies collide, and whose calibrated constants hold for the pair."""

    bodies: tuple[str, str]
    constants_of: str | None = None
    friction: NonNegative | None = None
    restitution: Fraction | None = None
    mode: ContactMode = ContactMode.SUSTAINED


class _MoveSpec(Table):
    amount_m: Finite | None = None
    amount_deg: Finite | None = None

    def _amount(self) -> float:
        """The amount in m or rad; that the right one is given, the motion has checked."""
        return self.amount_m if self.amount_m is not None else float(np.radians(self.amount_deg or 0.0))


class TrapezoidSpec(_MoveSpec):
    """`kind = "trapezoid"`: constant acceleration, cruise, braking."""

    kind: Literal["trapezoid"]
    start_s: NonNegative
    duration_s: Positive
    accelerate_s: NonNegative
    brake_s: NonNegative

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


class CosineSpec(_MoveSpec):
    """`kind = "cosine"`: half a cosine from rest to rest."""

    kind: Literal["cosine"]
    start_s: NonNegative
    duration_s: Positive

    def build(self) -> Profile:
        """The profile."""
        return CosineProfile(start_s=self.start_s, duration_s=self.duration_s, amount=self._amount())


class SampledSpec(Table):
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


class MotionSpec(Table):
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


class DriverSpec(Table):
    """Prescribed motion of a kinematic body, and where it is from, per material where that differs."""

    body: str
    provenance: DriverProvenance | dict[str, DriverProvenance]
    note: str
    motions: tuple[MotionSpec, ...] = Field(min_length=1)


class MarkersSpec(Table):
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


class ScoreSpec(Table):
    """How the experiment is observed and scored."""

    observable: Observable
    metrics: tuple[Literal["rmse", "dtw", "lsd", "mte", "pd", "el"], ...] = ()
    period_axis: Literal["x", "y", "z"] | None = None


class ParameterSetSpec(Table):
    """Named alternative values, keyed `body.constant`; per material where they differ."""

    summary: str
    values: dict[str, Any] = Field(min_length=1)


class SourceSpec(Table):
    """What the file was transcribed from."""

    metadata: str
    paper: str
    video: str | None = None


class SubtaskSpec(Table):
    """What a subtask adds to, or replaces in, the family."""

    title: str
    frames: dict[str, Annotated[int, Field(ge=2)]]
    bodies: tuple[str, ...] = ()
    motion: dict[str, Motion] = {}
    initial: dict[str, dict[str, Placement]] = {}
    contacts: tuple[ContactSpec, ...] | None = None
    drivers: tuple[DriverSpec, ...] | None = None


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


class TaskSpec(Table):
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
    constants: dict[str, dict[str, dict[str, float | Substituted | dict[str, float]]]]
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

    def owner(self, name: str) -> BodySpec | ClothSpec | SoftBodySpec | LineSpec:
        """The table that defines a body; KeyError where there is none."""
        for table in (self.bodies, self.cloths, self.soft_bodies, self.ropes, self.rods):
            if name in table:
                return table[name]
        raise KeyError(name)

    def constants_model(self, name: str) -> type[RigidConstants | ClothConstants | SolidConstants]:
        """What constants a body has."""
        if name in self.bodies:
            return RigidConstants
        return ClothConstants if name in self.cloths else SolidConstants

    def constants_of(self, name: str, material: str, subtask: str | None) -> dict[str, float | None]:
        """Constants of one body in one variant: per-subtask values picked, substitutes put in."""
        values: dict[str, float | None] = {}
        for key, value in self.constants[name][material].items():
            if isinstance(value, Substituted):
                values[key] = value.used
            else:
                values[key] = value.get(subtask or "") if isinstance(value, dict) else value
        return values

    def variants(self) -> tuple[Variant, ...]:
        """Variants of the family: subtasks first, then materials, in the file's order."""
        return tuple(
            Variant(self.family, subtask, material)
            for subtask in (self.subtasks or [None])
            for material in self.materials
        )

    def provenance_of(self, key: str) -> str:
        """Where the number under a dotted key is from.

        The entry with the longest matching prefix counts; of several as long, the one with the fewest wildcards.

        Raises:
            UnknownNameError: No entry covers the key.
        """
        parts = key.split(".")
        for length in range(len(parts), 0, -1):
            prefix = ".".join(parts[:length])
            matching = [p for p in self.provenance if p.count(".") == prefix.count(".") and fnmatchcase(prefix, p)]
            if matching:
                return self.provenance[min(matching, key=lambda pattern: pattern.count("*"))]
        raise UnknownNameError("provenance of", key, self.provenance)
