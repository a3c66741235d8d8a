"""Tables that task files and experiment files share: shapes, drivers and kinds of numbers."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from gauge_envs.scene import Box, ConvexUnion, Cylinder, Plane, Pose, Shape, Sphere, Vector
from gauge_envs.scene.drivers import CosineProfile, DriverMotion, Profile, SampledProfile, TrapezoidProfile

__all__ = [
    "DriverSpec",
    "Fraction",
    "NonNegative",
    "PlaneSpec",
    "Positive",
    "Table",
]


def _unit(vector: Vector) -> Vector:
    if abs(float(np.linalg.norm(vector)) - 1.0) > 1e-9:
        raise ValueError(f"{list(vector)} is not a unit vector")
    return vector


Finite = Annotated[float, Field(allow_inf_nan=False)]


Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]


NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


Fraction = Annotated[float, Field(ge=0.0, le=1.0)]


Vector3 = tuple[Finite, Finite, Finite]


UnitVector = Annotated[Vector3, AfterValidator(_unit)]


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


DriverProvenance = Literal["metadata", "paper", "video", "mocap", "derived", "nominal"]


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
