"""Tables that task files and experiment files share: shapes and drivers.

A shape is read as the scene's own class. A profile of a driver has a class here, as files state angles in degrees.
"""

from __future__ import annotations

from abc import abstractmethod
from fnmatch import fnmatchcase
from typing import Annotated, Any, ClassVar, Literal, Self, get_args

import numpy as np
from pydantic import (
    AfterValidator,
    Field,
    GetCoreSchemaHandler,
    GetPydanticSchema,
    model_validator,
)

from gauge_envs.references.tables import (
    FileModel,
    UnitVector,
    read_toml,
    scoring_folder,
)
from gauge_envs.scene import (
    Box,
    ConvexUnion,
    Cylinder,
    Plane,
    Pose,
    Sphere,
)
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.geometry import NonNegative, Positive, Vector
from gauge_envs.scene.profiles import (
    CosineProfile,
    Profile,
    SampledProfile,
    TrapezoidProfile,
)

Fraction = Annotated[float, Field(ge=0.0, le=1.0)]

Provenance = Literal["metadata", "paper", "video", "mocap", "derived", "nominal"]

PROVENANCES: tuple[str, ...] = get_args(Provenance)
"""Possible origins of a number; docs/coverage.md explains each."""


def _solid(union: ConvexUnion) -> ConvexUnion:
    for index, piece in enumerate(union.pieces_m):
        points = np.asarray(piece)
        if (
            len(piece) < 4
            or np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-9) < 3
        ):
            raise ValueError(
                f"piece {index} is flat or has fewer than four vertices: it encloses no volume"
            )
    return union


class Camera(FileModel):
    """Where pictures are taken from: a camera without roll.

    Attributes:
        target_m: Point in the middle of the picture [m].
        distance_m: Distance of the camera from it [m].
        azimuth_deg: Direction of the view in the level plane, anticlockwise from the x axis [deg].
        elevation_deg: Angle of the view above the level plane [deg]; negative from above.
    """

    target_m: Vector
    distance_m: Positive
    azimuth_deg: float
    elevation_deg: float


class CameraFile(FileModel):
    """Content of `scoring/cameras.toml`.

    Attributes:
        camera: Camera by the name of the task, which may have wildcards.
    """

    camera: dict[str, Camera]


def task_camera(name: str) -> Camera | None:
    """Return the camera of a task of the package, or None."""
    table = read_toml(scoring_folder("cameras.toml"), CameraFile).camera
    return next(
        (camera for pattern, camera in table.items() if fnmatchcase(name, pattern)),
        None,
    )


class PlateWithHoleSpec(FileModel):
    """`kind = "plate_with_hole"`: plate with a round hole along z, made of wedge-shaped convex pieces."""

    kind: Literal["plate_with_hole"]
    size_m: tuple[Positive, Positive, Positive]
    hole_radius_m: Positive
    hole_segments: Annotated[int, Field(ge=8, le=1000, multiple_of=4)]

    def build(self) -> ConvexUnion:
        """Return the pieces between the plate's outline and the polygon of the hole, which circumscribes the circle."""
        half_x, half_y, half_z = (0.5 * edge for edge in self.size_m)
        # Angles of the polygon and of the plate's four corners, so that each piece is convex.
        corner = float(np.arctan2(half_y, half_x))
        corners = [corner, np.pi - corner, np.pi + corner, 2 * np.pi - corner]
        angles = np.concatenate(
            [np.linspace(0, 2 * np.pi, self.hole_segments, endpoint=False), corners]
        )
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
            pieces.append(
                tuple(
                    (float(p[0]), float(p[1]), z)
                    for z in (-half_z, half_z)
                    for p in outline
                )
            )
        return ConvexUnion(pieces_m=tuple(pieces))


def _plate_schema(source: Any, handler: GetCoreSchemaHandler) -> Any:
    return handler.generate_schema(
        Annotated[PlateWithHoleSpec, AfterValidator(PlateWithHoleSpec.build)]
    )


ShapeTable = Annotated[
    Box
    | Sphere
    | Cylinder
    | Plane
    | Annotated[ConvexUnion, AfterValidator(_solid)]
    | Annotated[ConvexUnion, GetPydanticSchema(_plate_schema)],
    Field(discriminator="kind"),
]
"""Table of a shape, read as the shape itself."""


class _ProfileSpec(FileModel):
    """Table of a profile; the table of its motion checks the units."""

    @model_validator(mode="after")
    def _builds(self) -> Self:
        self.build()
        return self

    @abstractmethod
    def build(self) -> Profile:
        """Return the profile in m or rad."""


class _MoveSpec(_ProfileSpec):
    profile: ClassVar[type[TrapezoidProfile | CosineProfile]]

    start_s: NonNegative
    duration_s: Positive
    amount_m: float | None = None
    amount_deg: float | None = None

    def build(self) -> Profile:
        """Return the profile in m or rad."""
        amount = (
            self.amount_m
            if self.amount_m is not None
            else float(np.radians(self.amount_deg or 0.0))
        )
        return self.profile(
            **self.model_dump(exclude={"amount_m", "amount_deg"}), amount=amount
        )


class TrapezoidSpec(_MoveSpec):
    """`kind = "trapezoid"`: constant acceleration, cruise, braking."""

    profile = TrapezoidProfile

    kind: Literal["trapezoid"]
    accelerate_s: NonNegative
    brake_s: NonNegative


class CosineSpec(_MoveSpec):
    """`kind = "cosine"`: half a cosine from rest to rest."""

    profile = CosineProfile

    kind: Literal["cosine"]


class SampledSpec(_ProfileSpec):
    """`kind = "sampled"`: values measured at times."""

    kind: Literal["sampled"]
    times_s: tuple[float, ...]
    values_m: tuple[float, ...] | None = None
    values_deg: tuple[float, ...] | None = None

    def build(self) -> Profile:
        """Return the profile in m or rad."""
        if self.values_m is None and self.values_deg is None:
            raise ValueError("give values_m or values_deg")
        values = (
            self.values_m
            if self.values_m is not None
            else tuple(np.radians(self.values_deg or ()).tolist())
        )
        return SampledProfile(times_s=self.times_s, values=values)


ProfileSpec = Annotated[
    TrapezoidSpec | CosineSpec | SampledSpec, Field(discriminator="kind")
]


class MotionSpec(FileModel):
    """One coordinate of a driver.

    Attributes:
        kind: Translation or rotation.
        axis: Unit vector in the world.
        point_in_body_m: Point of the rotation axis in the body's start frame.
        profile: Profiles whose sum is the coordinate over time.
        residual_rate_m_per_s: Rate that an action of 1 adds to a translation.
        residual_rate_deg_per_s: Rate that an action of 1 adds to a rotation.
    """

    kind: Literal["translate", "rotate"]
    axis: UnitVector
    point_in_body_m: Vector = (0.0, 0.0, 0.0)
    profile: tuple[ProfileSpec, ...] = ()
    residual_rate_m_per_s: NonNegative = 0.0
    residual_rate_deg_per_s: NonNegative = 0.0

    @model_validator(mode="after")
    def _units(self) -> MotionSpec:
        unit, other = ("m", "deg") if self.kind == "translate" else ("deg", "m")
        for index, profile in enumerate(self.profile):
            stem = "values" if profile.kind == "sampled" else "amount"
            if (
                getattr(profile, f"{stem}_{unit}") is None
                or getattr(profile, f"{stem}_{other}") is not None
            ):
                raise ValueError(
                    f"profile.{index}: a {self.kind} motion needs {stem}_{unit} and no {stem}_{other}"
                )
        if getattr(self, f"residual_rate_{other}_per_s"):
            raise ValueError(f"a {self.kind} motion takes residual_rate_{unit}_per_s")
        return self

    def build(self, start: Pose) -> DriverMotion:
        """Return the motion of a body that starts at a pose."""
        x, y, z = start.to_world(np.asarray(self.point_in_body_m)).tolist()
        rate = self.residual_rate_m_per_s or float(
            np.radians(self.residual_rate_deg_per_s)
        )
        return DriverMotion(
            kind=self.kind,
            axis=self.axis,
            point_m=(x, y, z),
            profiles=tuple(profile.build() for profile in self.profile),
            residual_rate=rate,
        )


class DriverSpec(FileModel):
    """Prescribed motion of a kinematic body.

    Attributes:
        body: Name of the body.
        provenance: Where the motion is from; by material where materials differ.
        note: How it was measured or chosen.
        motions: Motions in the order in which they apply.
    """

    body: str
    provenance: Provenance | dict[str, Provenance]
    note: str
    motions: tuple[MotionSpec, ...] = Field(min_length=1)

    def build(self, body: str, start: Pose, provenance: str) -> Driver:
        """Return the driver of a body that starts at a pose."""
        return Driver(
            body=body,
            motions=tuple(one.build(start) for one in self.motions),
            provenance=provenance,
        )
