"""Tables of shapes and drivers in task files. Shapes and profiles become classes of the scene."""

from __future__ import annotations

from typing import Annotated, Any, Literal

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
from gauge_envs.scene.geometry import NonNegative, Positive, Vector, vector
from gauge_envs.scene.profiles import Profile

Fraction = Annotated[float, Field(ge=0.0, le=1.0)]

Provenance = Literal["metadata", "paper", "video", "mocap", "derived", "nominal"]
"""Origin of a number; docs/coverage.md explains each."""


def _solid(union: ConvexUnion) -> ConvexUnion:
    for index, piece in enumerate(union.pieces_m):
        points = np.asarray(piece)
        # Fewer than four vertices have a smaller rank too.
        if np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-9) < 3:
            raise ValueError(
                f"piece {index} is flat or has fewer than four vertices: it encloses no volume"
            )
    return union


class PlateWithHoleSpec(FileModel):
    """`kind = "plate_with_hole"`: plate with a round hole along z, made of wedge-shaped convex pieces."""

    kind: Literal["plate_with_hole"]
    size_m: tuple[Positive, Positive, Positive]
    hole_radius_m: Positive
    hole_segments: Annotated[int, Field(ge=8, le=1000, multiple_of=4)]

    def build(self) -> ConvexUnion:
        """Return the pieces between the outline of the plate and the polygon around the circular hole."""
        half_x, half_y, half_z = (0.5 * edge for edge in self.size_m)
        # With the angles of the polygon and of the four corners, each piece is convex.
        corner = float(np.arctan2(half_y, half_x))
        corners = [corner, np.pi - corner, np.pi + corner, 2 * np.pi - corner]
        angles = np.concatenate(
            [np.linspace(0, 2 * np.pi, self.hole_segments, endpoint=False), corners]
        )
        angles = np.unique(np.round(angles, 12))
        radius = self.hole_radius_m / np.cos(np.pi / self.hole_segments)
        directions = np.column_stack([np.cos(angles), np.sin(angles)])
        inner = radius * directions
        # The ray of each direction ends at the nearer side.
        widths = np.maximum(np.abs(directions), 1e-12)
        outer = directions * ([half_x, half_y] / widths).min(axis=1)[:, None]
        following = np.roll(inner, -1, axis=0), np.roll(outer, -1, axis=0)
        outlines = np.stack([inner, outer, following[1], following[0]], axis=1)
        pieces = []
        for outline in outlines.tolist():
            low = [(x, y, -half_z) for x, y in outline]
            high = [(x, y, half_z) for x, y in outline]
            pieces.append((*low, *high))
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
"""Table of a shape, which becomes the shape."""


class MotionSpec(FileModel):
    """One coordinate of a driver.

    Attributes:
        kind: Translation or rotation.
        axis: Unit vector in the world.
        point_in_body_m: Point of the rotation axis in the initial body frame.
        profile: Profiles whose sum is the coordinate over time, see `gauge_envs.scene.profiles`. In place of `amount`
            and `values`, a file has `amount_m` and `values_m`, or `amount_deg` and `values_deg` of a rotation.
        residual_rate_m_per_s: Rate that an action of 1 adds to a translation.
        residual_rate_deg_per_s: Rate that an action of 1 adds to a rotation.
    """

    kind: Literal["translate", "rotate"]
    axis: UnitVector
    point_in_body_m: Vector = (0.0, 0.0, 0.0)
    profile: tuple[Profile, ...] = ()
    residual_rate_m_per_s: NonNegative = 0.0
    residual_rate_deg_per_s: NonNegative = 0.0

    @model_validator(mode="before")
    @classmethod
    def _profiles_in_si(cls, table: dict[str, Any]) -> dict[str, Any]:
        """Return the table with profiles in m or rad."""
        is_rotation = table.get("kind") == "rotate"
        unit = "deg" if is_rotation else "m"
        profiles = []
        for index, profile in enumerate(table.get("profile", ())):
            name = "values" if profile.get("kind") == "sampled" else "amount"
            key = f"{name}_{unit}"
            if key not in profile:
                raise ValueError(f"profile.{index}: {key} is missing")
            value = np.radians(profile[key]).tolist() if is_rotation else profile[key]
            rest = {k: v for k, v in profile.items() if k != key}
            profiles.append(rest | {name: value})
        return table | {"profile": profiles}

    @model_validator(mode="after")
    def _rate_unit(self) -> MotionSpec:
        is_rotation = self.kind == "rotate"
        if self.residual_rate_m_per_s if is_rotation else self.residual_rate_deg_per_s:
            unit = "deg" if is_rotation else "m"
            raise ValueError(f"a {self.kind} motion takes residual_rate_{unit}_per_s")
        return self

    def build(self, start: Pose) -> DriverMotion:
        """Return the motion of a body with an initial pose."""
        rate = self.residual_rate_m_per_s or float(
            np.radians(self.residual_rate_deg_per_s)
        )
        return DriverMotion(
            kind=self.kind,
            axis=self.axis,
            point_m=vector(start.to_world(np.asarray(self.point_in_body_m))),
            profiles=self.profile,
            residual_rate=rate,
        )


class DriverSpec(FileModel):
    """Prescribed motion of a kinematic body.

    Attributes:
        body: Name of the body.
        provenance: Origin of the motion; by material if materials differ.
        note: How it was measured or chosen.
        motions: Motions in the order in which they apply.
    """

    body: str
    provenance: Provenance | dict[str, Provenance]
    note: str
    motions: tuple[MotionSpec, ...] = Field(min_length=1)

    def build(self, start: Pose, material: str) -> Driver:
        """Return the driver of a body with an initial pose, for a material."""
        origin = self.provenance
        if not isinstance(origin, str):
            if material not in origin:
                raise ValueError(f"drivers: no provenance of {material!r}")
            origin = origin[material]
        motions = tuple(motion.build(start) for motion in self.motions)
        return Driver(body=self.body, motions=motions, provenance=origin)
