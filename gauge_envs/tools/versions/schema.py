"""JSON object of `gauge backend versions --json`."""

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


class VersionsVerdict(StrEnum):
    """Whether two versions differ on a model."""

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
class StepDifference:
    """Difference of two versions from one state.

    Attributes:
        segment: Segment of the motion, for example `push`.
        step: Step of the segment.
        quantity: First differing quantity in the order of computation.
        where: Pair of geoms, or degree of freedom, with the largest difference of this quantity.
        before, after: Value of the quantity: number of contacts, depth [m], or acceleration [m/s^2 or rad/s^2].
    """

    segment: str
    step: int
    quantity: Quantity
    where: str
    before: float
    after: float


@dataclass(frozen=True, kw_only=True)
class FieldChange:
    """A differing field of the compiled model.

    Attributes:
        field: Name of the field, for example `geom_solref`.
        row: Index of the row with the largest difference, for example of a geom.
        count: Number of differing rows.
        before, after: Value of this row on each side.
    """

    field: str
    row: int
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
        like: End of the range with the nearer accelerations: `first` or `last`.
    """

    release: str
    like: str


@dataclass(frozen=True, kw_only=True)
class SubjectComparison:
    """Comparison of two sides on one subject.

    Attributes:
        subject: Model, experiment or environment, as given by the user.
        before, after: Titles of the sides.
        verdict: Whether they differ.
    """

    subject: str
    before: str
    after: str
    verdict: VersionsVerdict


@dataclass(frozen=True, kw_only=True)
class StepComparison(SubjectComparison):
    """Comparison of two versions on one model, by more than ten times the noise.

    Attributes:
        versions: Version of the engine on each side.
        states: Number of states computed on both sides.
        differing: Number of states with accelerations that differ by more than the limit.
        largest: Largest difference of accelerations, divided by the larger one.
        noise: Median noise over the states: the change by a velocity difference of 1e-10, or by a cold start of the
            solver.
        first: First difference; None without one.
        worst: Largest difference; None without one.
        fields: Differing compiled fields.
        unknown_fields: Fields of a newer release that this package does not know. They are compared as physical ones.
        rulings: Applied laws.
        right: Title of the side that is right; empty if no law decides.
        tried: Releases tested by a bisection; empty without a bisection.
    """

    versions: tuple[str, str]
    states: int
    differing: int
    largest: float
    noise: float
    first: StepDifference | None
    worst: StepDifference | None
    fields: tuple[FieldChange, ...]
    unknown_fields: tuple[str, ...]
    rulings: tuple[Ruling, ...]
    right: str
    tried: tuple[Release, ...] = ()


@dataclass(frozen=True, kw_only=True)
class MotionComparison(SubjectComparison):
    """Comparison of two motions of an experiment of the suite, by more than ten times the noise.

    Attributes:
        unit: Unit of the coordinates.
        first_s: Time of the first difference [s]; None without one.
        largest: Largest difference of a coordinate in the whole motion.
        largest_s: Time of the largest difference [s].
        noise: Change by a shift of the initial position by 1e-9 m until the first difference, on the noisier side.
        right: Title of the side that is closer to the reference beyond its uncertainty; empty without one.
    """

    unit: str
    first_s: float | None
    largest: float
    largest_s: float
    noise: float
    right: str


@dataclass(frozen=True, kw_only=True)
class ReturnComparison(SubjectComparison):
    """Comparison of a policy on two sides, from the same seeds: the interval of a change excludes 0.

    Attributes:
        versions: Version of the engine on each side.
        seeds: Number of seeds.
        returns: Mean sum of rewards of an episode on each side.
        change: Difference of the returns, paired by seed.
    """

    versions: tuple[str, str]
    seeds: int
    returns: tuple[float, float]
    change: Estimate


VersionsLine: TypeAlias = StepComparison | MotionComparison | ReturnComparison
"""Steps of a model, motions of an experiment, or returns of a policy."""
