"""What `gauge backend versions` prints with `--json`, an object for each pair of sides."""

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
        low: Lower end; None with a single episode, which has no interval.
        high: Upper end; None with a single episode.
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
    """What differs first between two versions from the same state, in the order in which an engine computes it."""

    CONTACTS = "contact count"
    DEPTH = "contact depth"
    SMOOTH = "acceleration without constraints"
    CONSTRAINT = "constraint force"
    STEP = "integration"


@dataclass(frozen=True, kw_only=True)
class Side:
    """One of the versions.

    Attributes:
        title: As the user gave it.
        requirement: Package of its environment, as `mujoco==3.3.0`; empty for what is installed.
        python: Interpreter of the user, or None for the one that runs here.
        engine: Engine of this package that runs an experiment of the suite; empty for a release of MuJoCo.
        settings: Settings of the engine that differ from those of the model.
    """

    title: str
    requirement: str = ""
    python: str | None = None
    engine: str = ""
    settings: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Parting:
    """Where two versions differ, from one state.

    Attributes:
        segment: Segment of the motion, as `push`.
        step: Step of the segment.
        of: Version whose motion visits the state.
        quantity: What differs first in the order of computation.
        detail: That quantity in words, on both sides.
        where: Body or joint whose acceleration differs most.
        acceleration: Difference of the accelerations over the larger one.
        limit: Difference above which it counts: ten times the noise at this state.
        acceleration_before, acceleration_after: Acceleration there [m/s^2 or rad/s^2].
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
    """A field of the compiled model that differs.

    Attributes:
        field: Its name, as `geom_solref`.
        where: The row that differs most, as `geom floor`; empty for a field of the whole model.
        count: Rows that differ.
        before, after: Value there; None where the version lacks the field.
    """

    field: str
    where: str
    count: int
    before: Any
    after: Any


@dataclass(frozen=True, kw_only=True)
class Ruling:
    """A law that says which side is right.

    Attributes:
        law: The law.
        before, after: By how much each side misses it, as a fraction.
        states: States in which the law applies.
        right: Title of the side that keeps it; empty where both do or both fail.
    """

    law: str
    before: float
    after: float
    states: int
    right: str


@dataclass(frozen=True, kw_only=True)
class Release:
    """A release that a bisection tried.

    Attributes:
        release: The requirement, as `mujoco==3.4.0`.
        from_first, from_last: Largest difference of accelerations from each end of the range.
        like: `first` or `last`: the end that it is nearer to.
    """

    release: str
    from_first: float
    from_last: float
    like: str


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """What two versions make of one model.

    Attributes:
        subject: The model, as the user named it.
        before, after: Titles of the versions.
        versions: Version of the engine on each side.
        verdict: Whether they differ.
        states: States that were computed on both sides.
        differing: Those in which the accelerations differ by more than the limit.
        largest: Largest difference of accelerations over the larger one.
        noise: Median over the states of the noise: what a start that is 1e-10 apart, or a solver without its warm
            start, changes.
        first: Where they differ first; None if they do not.
        worst: Where they differ most; None if they do not.
        fields: Compiled fields that differ.
        new_fields: Compiled fields and flags that one side alone has.
        dropped: Attributes of the model file that each side does not know, and runs without.
        rulings: Laws that were applied.
        right: Title of the side that is right; empty if nothing here can tell.
        tried: Releases that a bisection tried, in their order; empty without one.
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
    """Two motions of an experiment of the suite.

    Attributes:
        subject: The experiment, as the user named it.
        before, after: Titles of the sides.
        verdict: Whether they differ by more than ten times the noise.
        unit: Unit of the coordinates.
        first_s: Time at which they differ first [s]; None if they do not.
        coordinate: Coordinate that differs first, as `x of the cube`.
        difference: Difference of the coordinate then.
        largest: Largest difference of a coordinate in the whole motion.
        noise: What an initial position 1e-9 m apart changes until then, on the noisier side.
        right: Title of the side that is closer to the reference by more than its uncertainty; empty if none is.
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
    """A policy in an environment on two sides, from the same seeds.

    Attributes:
        subject: The environment, as the user named it.
        before, after: Titles of the sides.
        verdict: Whether returns or successes differ in the mean over seeds: the interval of the change is without 0.
        versions: Version of the engine on each side.
        seeds: Number of seeds.
        returns: Sum of rewards of an episode on each side.
        change: Difference of the returns, seed by seed.
        success: Share of episodes that succeed on each side; None where the environment does not say.
        success_change: Difference of the successes; None likewise.
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
