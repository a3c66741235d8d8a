"""Format of a task file: one pydantic model per TOML table, in SI units."""

from __future__ import annotations

import fnmatch
from dataclasses import replace
from enum import StrEnum
from itertools import chain
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from gauge_envs.experiments.names import Collection, Variant
from gauge_envs.experiments.tables import (
    DriverSpec,
    Fraction,
    ShapeTable,
)
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.metrics import MetricKey
from gauge_envs.references.tables import FileModel, UnitVector
from gauge_envs.scene import Attachment, ContactMode, Markers, Motion, Pose
from gauge_envs.scene.geometry import NonNegative, Positive, Vector, vector
from gauge_envs.scene.timing import MAX_FRAMES

Name = Annotated[str, Field(pattern="^[A-Za-z0-9_]+$")]
"""Part of an id and of names of files."""

FrameCounts = dict[str, Annotated[int, Field(ge=2, le=MAX_FRAMES)]]
"""Frames of an episode, the first included, by material or for `all`."""

NO_ORIGIN = "not stated"
"""Origin of a number without an entry in `[provenance]`."""


class Matter(StrEnum):
    """Kind of matter in an experiment."""

    RIGID = "rigid"
    ROPE = "rope"
    TEXTILE = "textile"
    DEFORMABLE = "deformable"


def _admissible_poisson(value: float) -> float:
    if not -1.0 < value < 0.5:
        raise ValueError(
            f"Poisson ratio {value} is out of range: an isotropic solid needs -1 < nu < 0.5"
        )
    return value


PoissonRatio = Annotated[float, AfterValidator(_admissible_poisson)]


class BodySpec(FileModel):
    """A rigid body, or `count` equal bodies with the names `<name>-1`, `<name>-2`, ..."""

    shape: ShapeTable
    motion: Motion
    recorded: bool = False
    material: str | None = None
    count: Annotated[int, Field(ge=1)] | None = None


class ClothSpec(FileModel):
    """A rectangular sheet, whose warp has an angle to its x axis."""

    size_m: tuple[Positive, Positive]
    warp_angle_deg: Annotated[float, Field(ge=-90.0, le=90.0)] = 0.0
    material: str | None = None


class SoftBodySpec(FileModel):
    """A volumetric elastic block."""

    size_m: tuple[Positive, Positive, Positive]
    material: str | None = None


class LineSpec(FileModel):
    """A rope or an elastic rod."""

    length_m: Positive
    radius_m: Positive
    material: str | None = None


AnyBody = BodySpec | ClothSpec | SoftBodySpec | LineSpec


class Substituted(FileModel):
    """A published constant that simulations cannot use, and its substitute."""

    published: float
    used: float
    reason: str


class RigidConstants(FileModel):
    """Constants of a rigid body; friction and restitution apply to its contact in this experiment.

    Attributes:
        inertia_kg_m2: Moment of inertia about every axis through the centre; None is that of uniform density.
    """

    mass_kg: Positive
    density_kg_per_m3: Positive | None = None
    inertia_kg_m2: Positive | None = None
    friction: NonNegative | None = None
    restitution: Fraction | None = None


class ClothConstants(FileModel):
    """Constants of a fabric."""

    mass_kg: Positive
    areal_density_kg_per_m2: Positive
    thickness_m: Positive
    stretch_stiffness_n_per_m: Positive
    shear_stiffness_n_per_m: Positive
    bend_stiffness_n_m_per_rad: Positive
    friction: NonNegative
    restitution: Fraction


class SolidConstants(FileModel):
    """Constants of a foam, a rubber, a rope or a rod."""

    mass_kg: Positive
    density_kg_per_m3: Positive | None = None
    young_modulus_pa: Positive
    poisson_ratio: PoissonRatio | None = None
    friction: NonNegative
    restitution: Fraction


class Placement(FileModel):
    """Initial pose and velocities of a body; the position has one of three forms.

    Attributes:
        position_m: Position of one body.
        positions_m: Positions of counted bodies.
        hangs_from_m: Anchor of a body on a string or light rod; `euler_deg` rotates the hanging body about it.
        length_m: Length of that string or rod.
        euler_deg: Rotations about the fixed x, then y, then z axis.
        velocity_m_per_s: Initial velocity of the body origin in the world frame. For a hinged body it follows from the
            angular velocity.
        angular_velocity_deg_per_s: Initial angular velocity in the world frame. Only dynamic rigid bodies have initial
            velocities.
    """

    position_m: Vector | None = None
    positions_m: tuple[Vector, ...] | None = None
    hangs_from_m: Vector | None = None
    length_m: Positive | None = None
    euler_deg: Vector = (0.0, 0.0, 0.0)
    velocity_m_per_s: Vector | None = None
    angular_velocity_deg_per_s: Vector | None = None

    @model_validator(mode="after")
    def _one_placement(self) -> Placement:
        places = (self.position_m, self.positions_m, self.hangs_from_m)
        if sum(place is not None for place in places) != 1:
            raise ValueError(
                "give exactly one of position_m, positions_m, hangs_from_m"
            )
        if (self.hangs_from_m is None) != (self.length_m is None):
            raise ValueError("hangs_from_m and length_m go together")
        return self

    def poses(self) -> list[Pose]:
        """Return the world poses of the body or bodies."""
        rotated = Pose.from_euler_deg((0.0, 0.0, 0.0), self.euler_deg)
        positions = self.positions_m or (self.position_m,)
        if self.hangs_from_m is not None:
            string_m = rotated.to_world(np.array([0.0, 0.0, -(self.length_m or 0.0)]))
            positions = (vector(self.hangs_from_m + string_m),)
        return [replace(rotated, position_m=place) for place in positions if place]


class JointSpec(FileModel):
    """A hinge or a string to the world at the point `hangs_from_m` of the body."""

    kind: Literal["hinge", "tether"]
    body: str
    axis: UnitVector | None = None

    @model_validator(mode="after")
    def _axis(self) -> JointSpec:
        if (self.kind == "hinge") != (self.axis is not None):
            raise ValueError("a hinge needs an axis, a tether has none")
        return self


class ContactSpec(FileModel):
    """Two groups of bodies that collide, and the body whose constants apply to each pair."""

    bodies: tuple[str, str]
    constants_of: str
    mode: ContactMode = ContactMode.SUSTAINED


def _within_markers(markers: Markers) -> Markers:
    count = len(markers.positions_m)
    lists = (markers.corner, markers.edge, *markers.faces, *markers.lines)
    for index in chain(*lists):
        if not 0 <= index < count:
            raise ValueError(
                f"marker index {index} is out of range: there are {count} markers"
            )
    return markers


class ScoreSpec(FileModel):
    """Observation and metrics of an experiment."""

    observable: Observable
    metrics: tuple[MetricKey, ...] = ()
    period_axis: Literal["x", "y", "z"] | None = None


class ParameterSetSpec(FileModel):
    """Alternative values by `body.constant`, and by material if materials differ."""

    summary: str
    values: dict[str, Any] = Field(min_length=1)


class SourceSpec(FileModel):
    """Sources of a task file."""

    metadata: str
    paper: str
    video: str | None = None


class SubtaskSpec(FileModel):
    """Values that a subtask adds to its family, or replaces."""

    title: str
    frames: FrameCounts
    bodies: tuple[str, ...] = ()
    motion: dict[str, Motion] = Field({})
    initial: dict[str, dict[str, Placement]] = Field({})
    contacts: tuple[ContactSpec, ...] | None = None
    drivers: tuple[DriverSpec, ...] | None = None


class TaskSpec(FileModel):
    """One task file; its keys are in this order.

    Attributes:
        collection: `gauge` for an experiment of the benchmark; `beyond` for one of other sources, which lists, counts
            and averages of the benchmark exclude.
        revision: Grows by one when a change of this file or its references changes scores.
    """

    family: Name
    collection: Collection = Collection.GAUGE
    revision: int = Field(1, ge=1)
    title: str
    group: Matter
    summary: str
    evaluates: tuple[str, ...]
    materials: tuple[Name, ...] = Field(min_length=1)
    metadata_materials: dict[str, str] = Field({})
    decisions: tuple[str, ...] = ()
    source: SourceSpec
    bodies: dict[str, BodySpec] = Field({})
    cloths: dict[str, ClothSpec] = Field({})
    soft_bodies: dict[str, SoftBodySpec] = Field({})
    ropes: dict[str, LineSpec] = Field({})
    rods: dict[str, LineSpec] = Field({})
    constants: dict[str, dict[str, dict[str, float | Substituted | dict[str, float]]]]
    initial: dict[str, dict[str, Placement]] = Field({})
    joints: tuple[JointSpec, ...] = ()
    attachments: tuple[Attachment, ...] = ()
    contacts: tuple[ContactSpec, ...] = ()
    score: ScoreSpec
    frames: FrameCounts = Field({})
    drivers: tuple[DriverSpec, ...] = ()
    markers: Annotated[Markers, AfterValidator(_within_markers)] | None = None
    parameters: dict[str, ParameterSetSpec] = Field({})
    subtasks: dict[Name, SubtaskSpec] = Field({})
    provenance: dict[str, str] = Field({})

    @model_validator(mode="after")
    def _names_are_defined(self) -> TaskSpec:
        """Raise an error for the name of a body without a table; contacts may use patterns of names."""
        known = [*self.names]
        for name, body in self.bodies.items():
            known += [f"{name}-{index + 1}" for index in range(body.count or 0)]
        used = [*self.constants]
        if self.markers is not None:
            used += self.markers.bodies
        for attachment in self.attachments:
            used += [attachment.deformable, attachment.to]
        contacts = [*self.contacts]
        for subtask in self.subtasks.values():
            used += [*subtask.bodies, *subtask.motion]
            contacts += subtask.contacts or ()
        for contact in contacts:
            used += contact.bodies
        for name in used:
            if not fnmatch.filter(known, name):
                raise ValueError(
                    f"{name!r} is not defined; known: {', '.join(self.names)}"
                )
        return self

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all rigid and deformable bodies in the file."""
        return tuple(self._tables())

    def entry(self, body: str) -> str:
        """Return the name in the file of a body of the scene; equal bodies by `count` share one entry."""
        return body if body in self.names else body.rpartition("-")[0]

    def owner(self, body: str) -> BodySpec | ClothSpec | SoftBodySpec | LineSpec | None:
        """Return the table of a body of the scene; None for a body that the file does not have."""
        return self._tables().get(self.entry(body))

    def _tables(self) -> dict[str, AnyBody]:
        return self.bodies | self.cloths | self.soft_bodies | self.ropes | self.rods

    def bodies_of(self, variant: Variant) -> dict[str, AnyBody]:
        """Return the table of each body of a variant, in the order of its scene."""
        tables, subtask = self._tables(), self.subtask_of(variant)
        if subtask is None:
            return tables
        for name, motion in subtask.motion.items():
            tables[name] = tables[name].model_copy(update={"motion": motion})
        return {name: tables[name] for name in subtask.bodies or tables}

    def variants(self) -> tuple[Variant, ...]:
        """Return the variants of the family, by subtask, then by material, in the file's order."""
        return tuple(
            Variant(self.family, subtask, material)
            for subtask in (self.subtasks or [None])
            for material in self.materials
        )

    def subtask_of(self, variant: Variant) -> SubtaskSpec | None:
        """Return the table of the subtask of a variant, or None."""
        return self.subtasks[variant.subtask] if variant.subtask else None

    def frame_count(self, variant: Variant) -> int:
        """Return the number of frames of an episode, the first included."""
        frames = (self.subtask_of(variant) or self).frames
        count = frames.get(variant.material) or frames.get("all")
        if count is None:
            raise ValueError(f"frames: no frame count for {variant.name}")
        return count

    def contacts_of(self, variant: Variant) -> tuple[ContactSpec, ...]:
        """Return the contacts of a variant."""
        subtask = self.subtask_of(variant)
        if subtask is None or subtask.contacts is None:
            return self.contacts
        return subtask.contacts

    def drivers_of(self, variant: Variant) -> tuple[DriverSpec, ...]:
        """Return the driven motions of a variant."""
        subtask = self.subtask_of(variant)
        if subtask is None or subtask.drivers is None:
            return self.drivers
        return subtask.drivers

    def placements_of(self, variant: Variant) -> dict[str, Placement]:
        """Return the placement of each body of a variant."""
        tables = [self.initial]
        if subtask := self.subtask_of(variant):
            tables.append(subtask.initial)
        merged: dict[str, Placement] = {}
        for initial in tables:
            for material in ("all", variant.material):
                merged |= initial.get(material, {})
        return merged

    def constants_model(
        self, name: str
    ) -> type[RigidConstants | ClothConstants | SolidConstants]:
        """Return the model of a body's constants."""
        if name in self.bodies:
            return RigidConstants
        return ClothConstants if name in self.cloths else SolidConstants

    def constants_of(
        self, name: str, material: str, subtask: str | None
    ) -> dict[str, float | None]:
        """Return the constants of one body in one variant, with substitutes and the values of the subtask."""
        values: dict[str, float | None] = {}
        for key, value in self.constants[name][material].items():
            if isinstance(value, Substituted):
                values[key] = value.used
            elif isinstance(value, dict):
                values[key] = value.get(subtask or "")
            else:
                values[key] = value
        return values

    def provenance_of(self, key: str) -> str:
        """Return the origin of the number under a dotted key; `not stated` without an entry.

        The entry with the longest matching prefix counts. Of equally long entries, the one with the fewest wildcards
        counts.
        """
        parts = key.split(".")
        matching = []
        for pattern in self.provenance:
            dots = pattern.count(".")
            if fnmatch.fnmatchcase(".".join(parts[: dots + 1]), pattern):
                matching.append((dots, -pattern.count("*"), pattern))
        if not matching:
            return NO_ORIGIN
        return self.provenance[max(matching)[2]]
