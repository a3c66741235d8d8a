"""Define what is checked, what a check says, and the report of all checks with the best fix."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import KW_ONLY, asdict, dataclass, field, replace
from enum import StrEnum
from typing import Any, TypeAlias

from gauge_envs.files import json_ready
from gauge_envs.scene import Vector
from gauge_envs.scoring.interval import student_t
from gauge_envs.tools.sanity.robot.robot import Robot

Settings: TypeAlias = Mapping[str, Any]
"""Settings by name. A value is a number, a truth value, a text, a list, or None for what is not set."""


class Need(StrEnum):
    """What a target must have for a check of measured objects to apply to it."""

    GRAVITY = "gravity"
    CONTACT = "contact"
    SPACE = "space"
    """Motion in space, not in a plane along an axis of the world."""


@dataclass(frozen=True, kw_only=True)
class ContactGroup:
    """Pairs of geoms of a model that collide with the same constants.

    Attributes:
        geoms: Description of the geoms, such as `floor with torso, bthigh and 6 more`.
        pair_count: Number of pairs of geoms.
        is_used: Whether the experiments run with these constants.
        settings: Settings of the backend that give all contacts these constants.
    """

    geoms: str
    pair_count: int
    is_used: bool = False
    settings: Settings = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class TrainingConfiguration:
    """Numerical settings that a policy is trained with.

    Attributes:
        name: Name that the user gave, such as `HalfCheetah-v5`.
        source: Description of what it was read from.
        backend: Name of the physics engine.
        settings: Settings of that backend for every scene; other settings are the backend's default.
        contact_groups: Contact constants of a model: those on ground first, then by the number of pairs.
        notes: Properties that are not carried over, or that need attention.
        warnings: MuJoCo's warnings on the user's file, which are shown even where all checks pass.
        inapplicable: Needs of checks that the target does not meet, with the reason.
        up: Unit vector away from the ground, shape [3].
        robot: The target's own model, which JSON leaves out; None when it is unknown.
    """

    name: str
    source: str
    backend: str
    settings: Settings
    contact_groups: tuple[ContactGroup, ...] = ()
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    inapplicable: Mapping[Need, str] = field(default_factory=dict)
    up: Vector = (0.0, 0.0, 1.0)
    robot: Robot | None = field(default=None, compare=False)

    @property
    def contact_sets(self) -> dict[str, dict[str, Any]]:
        """Settings of each set of contact constants that is checked, by its geoms, which may be unknown."""
        sets: dict[str, dict[str, Any]] = {}
        contact = {name for group in self.contact_groups for name in group.settings}
        options = {
            name: value for name, value in self.settings.items() if name not in contact
        }
        for group in self.contact_groups:
            settings = {**options, **group.settings}
            if group.is_used and settings not in sets.values():
                sets[group.geoms] = settings
        return sets or {"": dict(self.settings)}


MAX_PASSED = 1.0
"""Largest deviation of a check that passes, in half-widths of the interval of reality."""

MAX_WARNING = 2.5
"""Largest deviation of a warning, in half-widths of the interval of reality."""

WORSE_BY = 1.0
"""Growth of a deviation that makes a failed check or a warning worse, in half-widths of the interval of reality."""

COVERAGE = 0.95
"""Share of further real trials that the interval of a measured quantity covers."""


class SanityVerdict(StrEnum):
    """Distance between a measured value and reality, in half-widths of the interval of reality."""

    PASSED = "passed"
    """In the interval: a real trial could give this value, or the law is met within its tolerance."""
    WARNING = "warning"
    """Outside of the interval, by at most 2.5 half-widths from its centre: a careful observer sees the difference."""
    FAILED = "failed"
    """Farther away, or a failure of another kind, such as divergence."""
    NOT_MEASURED = "not measured"
    """The check does not apply to the target, or cannot run; `SanityResult.applies` tells which."""

    @property
    def is_off(self) -> bool:
        """Whether it is a warning or a failure."""
        return self in (SanityVerdict.WARNING, SanityVerdict.FAILED)

    @classmethod
    def of(cls, deviation: float) -> SanityVerdict:
        """Return the verdict of a distance from reality, in half-widths of its interval."""
        if deviation <= MAX_PASSED:
            return cls.PASSED
        return cls.WARNING if deviation <= MAX_WARNING else cls.FAILED


class Severity(StrEnum):
    """Consequence of a finding, in rising order.

    Only a law, the model's own statement against what is in force, its own run, or a ratio that names a unit makes a
    warning or an error. A comparison with what is usual, and a motion that only the check makes, are advice: a number.
    """

    NONE = ""
    """The check passed, was not measured, or follows from another finding."""
    ADVICE = "advice"
    """A number is unusual, or a measured object moves otherwise than in reality."""
    WARNING = "warning"
    """The model does not do what its file says, or breaks a law."""
    ERROR = "error"
    """The model cannot be used: it falls through the floor, diverges, or does not reach its commands."""


class NotApplicableError(Exception):
    """A check does not apply to a target; the message is the reason."""


class RealityKind(StrEnum):
    """What a check compares with."""

    MEASURED = "measured"
    """Real trials: their mean, scatter and number."""
    LAW = "law"
    """A law of mechanics, with a tolerance and its reason."""


@dataclass(frozen=True)
class Reality:
    """Real value of a checked quantity, and the interval in which a simulation is as good as a real trial.

    Attributes:
        value: Mean of real trials, or value from a law, in the unit of the check.
        tolerance: Half-width of the interval, in the same unit.
        source: Source of the value.
        rationale: Reason for the tolerance.
        kind: Whether real trials or a law give the value.
        trial_count: Number of real trials; 0 for a law.
        limits: The interval as a text, where a value has a limit on one side; empty for centre and half-width.
    """

    value: float
    tolerance: float
    source: str
    rationale: str
    _: KW_ONLY
    kind: RealityKind = RealityKind.LAW
    trial_count: int = 0
    limits: str = ""

    @classmethod
    def measured(
        cls, value: float, scatter: float, trial_count: int, source: str
    ) -> Reality:
        """Return what real trials gave, with the interval that covers 95 % of further trials.

        Args:
            value: Mean of the trials.
            scatter: Standard deviation of the trials.
            trial_count: Number of trials, two or more.
            source: Source of the trials.
        """
        quantile = student_t(trial_count - 1, COVERAGE)
        factor = quantile * (1.0 + 1.0 / trial_count) ** 0.5
        rationale = f"covers {COVERAGE:.0%} of further trials, from the scatter of {trial_count} trials"
        return cls(
            value,
            factor * scatter,
            source,
            rationale,
            kind=RealityKind.MEASURED,
            trial_count=trial_count,
        )

    def deviation(self, value: float) -> float:
        """Return the distance of a value from the real one, in half-widths of the interval."""
        return abs(value - self.value) / self.tolerance


@dataclass(frozen=True, kw_only=True)
class PartOutcome:
    """Outcome of a check for one part: a set of contact constants, or a joint, a link or a pair of geoms of the robot.

    Attributes:
        name: The part; for contact constants, the geoms that touch with them.
        value: Measured value; None when nothing was measured.
        verdict: The verdict.
        deviation: Distance from reality, in half-widths of its interval or as the ratio to a limit.
        remark: Why nothing was measured, or a failure of another kind; empty otherwise.
    """

    name: str = ""
    value: float | None = None
    verdict: SanityVerdict
    deviation: float = math.inf
    remark: str = ""


@dataclass(frozen=True, kw_only=True)
class SanityResult:
    """Result of one check.

    Attributes:
        id: Id, such as `creep-wood`.
        title: Title, such as `creep of a cube of wood on 10 degrees`.
        experiment: Gymnasium id of the experiment; empty when nothing is simulated.
        unit: Unit of the values; `1` for a pure number.
        reality: Value for real objects.
        configured: Value in this configuration; None when not measured.
        verdict: SanityVerdict of this configuration.
        remark: Why it was not measured, or how it failed; empty otherwise.
        applies: Whether the check applies to the target.
        is_usual: Whether the check compares with what is usual, so that its finding is advice.
        geoms: Geoms whose contact constants decide the verdict; empty when all contacts have the same.
        parts: Outcome for each part that is checked; empty when nothing was measured.
        place: Element of the target's own model that decides the verdict; empty otherwise.
        file: File of this element; empty where it is unknown.
        line: Its line in the file; 0 where it is unknown.
        cause: Id of the check that explains this one; empty for none.
        accepted: Why the user accepts the finding; empty for one that counts.
        fix: Change of the attributes that the finding names, which was tried; empty where none is known.
        effects: What else follows from the finding, in short sentences.
    """

    id: str
    title: str
    experiment: str = ""
    unit: str
    reality: Reality
    configured: float | None = None
    verdict: SanityVerdict
    remark: str = ""
    applies: bool = True
    is_usual: bool = False
    geoms: str = ""
    parts: tuple[PartOutcome, ...] = ()
    place: str = ""
    file: str = ""
    line: int = 0
    cause: str = ""
    accepted: str = ""
    fix: str = ""
    effects: tuple[str, ...] = ()

    @property
    def severity(self) -> Severity:
        """Consequence of the finding."""
        if not self.is_flag:
            return Severity.NONE
        if self.is_usual or not self.is_on_target:
            return Severity.ADVICE
        is_error = self.verdict is SanityVerdict.FAILED
        return Severity.ERROR if is_error else Severity.WARNING

    @property
    def is_on_target(self) -> bool:
        """Whether the check is on the target itself, and runs none of the suite's experiments."""
        return not self.experiment

    @property
    def is_flag(self) -> bool:
        """Whether the check is a warning or failed, counts, is not accepted, and follows from no other one."""
        return self.verdict.is_off and not (self.cause or self.accepted)

    @property
    def deviation(self) -> float:
        """Distance of the worst part from reality, in half-widths of its interval; 0 if nothing was measured."""
        return max((part.deviation for part in self.parts), default=0.0)


# --- the report ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Fix:
    """The change of a few settings that resolves most failed checks and warnings, as measured.

    Attributes:
        changes: Changed settings with their new values.
        line: The change in the target's language.
        fixed: Value of each of these checks that passes after the change; None where it was not measured.
        lines: The change as lines of a diff, which start with `- ` or `+ `.
        speed_ratio: Simulated time of the target in a second after the change, over that before; None if not measured.
    """

    changes: Settings
    line: str
    fixed: Mapping[str, float | None] = field(default_factory=dict)
    lines: tuple[str, ...] = ()
    speed_ratio: float | None = None


class Findings(dict[str, "SanityResult"]):
    """Findings by the id of their check; a failed assertion shows the screen of the report.

    Attributes:
        screen: The screen.
    """

    screen = ""

    def __repr__(self) -> str:
        return self.screen or super().__repr__()


@dataclass(frozen=True, kw_only=True, repr=False)
class Report:
    """Result of a sanity check.

    Attributes:
        configuration: The checked configuration.
        checks: Result of each check, in a fixed order.
        versions: Versions of the engine's packages, of gauge-envs and of its dependencies.
        fix: The change that resolves most failed checks and warnings; None when no change resolves one.
        trade: How many changes were tried, when none resolves a check without harm; empty otherwise.
        asked: Ids of checks that were requested by their full id.
        notes: Sentences on entries that accept no finding.
        screen: What `gauge sanity` prints, which JSON leaves out.
    """

    configuration: TrainingConfiguration
    checks: tuple[SanityResult, ...]
    versions: Mapping[str, str]
    fix: Fix | None = None
    trade: str = ""
    asked: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    screen: str = ""

    @property
    def flags(self) -> Findings:
        """Failed checks and warnings that count, by id."""
        return self._findings(*Severity)

    @property
    def errors(self) -> Findings:
        """Findings with which the model cannot be used, by id."""
        return self._findings(Severity.ERROR)

    @property
    def warnings(self) -> Findings:
        """Findings with which the model does not do what its file says, by id."""
        return self._findings(Severity.WARNING)

    def _findings(self, *severities: Severity) -> Findings:
        flags = [result for result in self.checks if result.is_flag]
        found = Findings({f.id: f for f in flags if f.severity in severities})
        found.screen = self.screen
        return found

    def __repr__(self) -> str:
        return f"<Report of {self.configuration.name}>"

    @property
    def _missing(self) -> list[SanityResult]:
        missing = SanityVerdict.NOT_MEASURED
        return [result for result in self.checks if result.verdict is missing]

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """Ids of checks that apply, or were requested by id, and were not measured; all ids when none was measured."""
        is_all = len(self._missing) == len(self.checks)
        return tuple(
            result.id
            for result in self._missing
            if is_all or result.applies or result.id in self.asked
        )

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of checks that were measured, that apply and were not measured, and that do not apply."""
        missing = len(self._missing)
        inapplicable = sum(not result.applies for result in self._missing)
        return {
            "measured": len(self.checks) - missing,
            "not_measured": missing - inapplicable,
            "not_applicable": inapplicable,
        }

    @property
    def worst(self) -> SanityVerdict:
        """The worst verdict of all checks that count; `not measured` only when nothing was measured."""
        order = (SanityVerdict.FAILED, SanityVerdict.WARNING, SanityVerdict.PASSED)
        verdicts = {result.verdict for result in self.checks}
        return next(filter(verdicts.__contains__, order), SanityVerdict.NOT_MEASURED)

    def to_dict(self) -> dict[str, Any]:
        """Return all attributes, JSON-ready, without the target's own model."""
        bare = replace(self, configuration=replace(self.configuration, robot=None))
        values: dict[str, Any] = json_ready(asdict(bare))
        for line, result in zip(values["checks"], self.checks, strict=True):
            line["severity"] = result.severity.value
        del values["configuration"]["robot"], values["screen"]
        return values | {
            "worst": self.worst.value,
            "unmeasured": list(self.unmeasured),
            "counts": self.counts,
        }
