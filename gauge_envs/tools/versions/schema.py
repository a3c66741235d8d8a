"""JSON object of `gauge backend versions --json`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, TypeAlias


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A mean with its 95 % interval.

    Attributes:
        value: The mean.
        low: Lower end; None for a single episode.
        high: Upper end; None for a single episode.
    """

    value: float
    low: float | None = None
    high: float | None = None


class Verdict(StrEnum):
    """Whether two versions differ on a model."""

    IDENTICAL = "identical"
    """Bit for bit, in all states."""
    SAME = "same"
    """Within the noise of the model itself."""
    DIFFERENT = "different"


class Quantity(StrEnum):
    """First differing quantity of two versions from the same state, in the order of computation."""

    CONTACTS = "contact count"
    DEPTH = "contact depth"
    SMOOTH = "acceleration without constraints"
    CONSTRAINT = "constraint force"
    STEP = "integration"


@dataclass(frozen=True, kw_only=True)
class Side:
    """One of the compared versions.

    Attributes:
        title: Name given by the user.
        requirement: Package of the environment, for example `mujoco==3.3.0`; empty for the installed package.
        python: Interpreter of the user; None for the current interpreter.
        engine: Engine of this package that runs an experiment of the suite; empty for a release of MuJoCo.
        settings: Settings of the engine that replace settings of the model.
    """

    title: str
    requirement: str = ""
    python: str | None = None
    engine: str = ""
    settings: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Parting:
    """Difference of two versions from one state.

    Attributes:
        segment: Segment of the motion, for example `push`.
        step: Step of the segment.
        of: Version whose motion visits the state.
        quantity: First differing quantity in the order of computation.
        detail: Quantity in words, on both sides.
        where: Body or joint with the largest difference of acceleration.
        acceleration: Difference of the accelerations, divided by the larger one.
        limit: Smallest relevant difference: ten times the noise at this state.
        acceleration_before, acceleration_after: Acceleration of this body or joint [m/s^2 or rad/s^2].
        contacts_before, contacts_after: Number of contacts.
        iterations_before, iterations_after: Iterations of the constraint solver.
        warnings_before, warnings_after: Number of warnings of the engine.
    """

    segment: str
    step: int
    of: str
    quantity: Quantity
    detail: str
    where: str
    acceleration: float
    limit: float
    acceleration_before: float
    acceleration_after: float
    contacts_before: int
    contacts_after: int
    iterations_before: int
    iterations_after: int
    warnings_before: int
    warnings_after: int


@dataclass(frozen=True, kw_only=True)
class FieldChange:
    """A differing field of the compiled model.

    Attributes:
        field: Name of the field, for example `geom_solref`.
        where: Row with the largest difference, for example `geom floor`; empty for a field of the whole model.
        count: Number of differing rows.
        before, after: Value of this row; None if the version lacks the field.
    """

    field: str
    where: str
    count: int
    before: Any
    after: Any


@dataclass(frozen=True, kw_only=True)
class Ruling:
    """A law that decides which side is right.

    Attributes:
        law: The law.
        before, after: Relative error of each side.
        states: Number of states to which the law applies.
        right: Title of the side that satisfies the law; empty if both do or both fail.
    """

    law: str
    before: float
    after: float
    states: int
    right: str


@dataclass(frozen=True, kw_only=True)
class Release:
    """A release tested by a bisection.

    Attributes:
        release: Requirement, for example `mujoco==3.4.0`.
        from_first, from_last: Distance of the accelerations from each end of the range.
        like: Nearer end: `first` or `last`.
    """

    release: str
    from_first: float
    from_last: float
    like: str


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Comparison of two versions on one model.

    Attributes:
        subject: Model, as given by the user.
        before, after: Titles of the versions.
        versions: Version of the engine on each side.
        verdict: Whether they differ.
        states: Number of states computed on both sides.
        differing: Number of states with accelerations that differ by more than the limit.
        largest: Largest difference of accelerations, divided by the larger one.
        noise: Median noise over the states: the change by a velocity difference of 1e-10, or by a cold start of the
            solver.
        first: First difference; None without one.
        worst: Largest difference; None without one.
        fields: Differing compiled fields.
        new_fields: Compiled fields and flags of only one side.
        dropped: Unknown attributes of the model file that each side ignores.
        rulings: Applied laws.
        right: Title of the side that is right; empty if no law decides.
        tried: Releases tested by a bisection, in their order; empty without a bisection.
    """

    subject: str
    before: str
    after: str
    versions: tuple[str, str]
    verdict: Verdict
    states: int
    differing: int
    largest: float
    noise: float
    first: Parting | None
    worst: Parting | None
    fields: tuple[FieldChange, ...]
    new_fields: tuple[str, ...]
    dropped: tuple[tuple[str, ...], tuple[str, ...]]
    rulings: tuple[Ruling, ...]
    right: str
    tried: tuple[Release, ...] = ()


@dataclass(frozen=True, kw_only=True)
class MotionComparison:
    """Comparison of two motions of an experiment of the suite.

    Attributes:
        subject: Experiment, as given by the user.
        before, after: Titles of the sides.
        verdict: Whether they differ by more than ten times the noise.
        unit: Unit of the coordinates.
        first_s: Time of the first difference [s]; None without one.
        coordinate: Coordinate that differs first, for example `x of the cube`.
        difference: Difference of this coordinate at this time.
        largest: Largest difference of a coordinate in the whole motion.
        noise: Change by a shift of the initial position by 1e-9 m until then, on the noisier side.
        right: Title of the side that is closer to the reference beyond its uncertainty; empty without one.
    """

    subject: str
    before: str
    after: str
    verdict: Verdict
    unit: str
    first_s: float | None = None
    coordinate: str = ""
    difference: float = 0.0
    largest: float
    noise: float
    right: str = ""


@dataclass(frozen=True, kw_only=True)
class ReturnComparison:
    """Comparison of a policy in an environment on two sides, from the same seeds.

    Attributes:
        subject: Environment, as given by the user.
        before, after: Titles of the sides.
        verdict: Whether mean returns or successes differ: the interval of the change excludes 0.
        versions: Version of the engine on each side.
        seeds: Number of seeds.
        returns: Sum of rewards of an episode on each side.
        change: Difference of the returns, paired by seed.
        success: Share of successful episodes on each side; None if the environment does not report success.
        success_change: Difference of the successes; None if the environment does not report success.
    """

    subject: str
    before: str
    after: str
    verdict: Verdict
    versions: tuple[str, str]
    seeds: int
    returns: tuple[Estimate, Estimate]
    change: Estimate
    success: tuple[Estimate | None, Estimate | None]
    success_change: Estimate | None


VersionsLine: TypeAlias = Comparison | MotionComparison | ReturnComparison
"""Steps of a model, motions of an experiment, or returns of a policy."""
