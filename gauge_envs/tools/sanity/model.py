"""Define the parts of a sanity check: configuration, verdicts, results of checks, and the fix."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, asdict, dataclass, field, replace
from enum import EnumType, StrEnum
from typing import Any, TypeAlias

from gauge_envs.files import json_ready
from gauge_envs.scene import Vector
from gauge_envs.scoring.interval import student_t
from gauge_envs.tools.sanity.robot.foot import FootGeometry

Settings: TypeAlias = Mapping[str, Any]
"""Settings by name. A value is a number, a truth value, a text, a list, or None for what is not set."""

WARNED = "MuJoCo warns:"
"""First words of a note on the user's file, which is shown even where all checks pass."""

MAX_PASSED = 1.0
"""Largest deviation of a check that passes, in half-widths of the interval of reality."""

MAX_WARNING = 2.5
"""Largest deviation of a warning, in half-widths of the interval of reality."""

COVERAGE = 0.95
"""Share of further real trials that the interval of a measured quantity covers."""

RECORDING_FACTOR = 2.0
"""Half-width of the interval of a single recording, in standard uncertainties."""

RENAMED_VERDICTS = {
    "inside": "passed",
    "visible": "warning",
    "wrong": "failed",
}
"""Verdicts by their names before 1.0, which are read until 1.2."""


def warn_renamed(old: str, new: str, stacklevel: int = 3) -> None:
    """Warn that a name of 0.3 has a new one."""
    text = f"`{old}` is now `{new}`; the old name is read until 1.2"
    warnings.warn(text, DeprecationWarning, stacklevel=stacklevel)


class _VerdictType(EnumType):
    """Type of `Verdict`, which also has the names before 1.0, such as `Verdict.WRONG`."""

    def __getattr__(cls, name: str) -> Any:
        if name.lower() not in RENAMED_VERDICTS:
            raise AttributeError(name)
        new = RENAMED_VERDICTS[name.lower()]
        warn_renamed(name, new)
        return cls(new)


class Verdict(StrEnum, metaclass=_VerdictType):
    """Distance between a measured value and reality, in half-widths of the interval of reality."""

    PASSED = "passed"
    """In the interval: a real trial could give this value, or the law is met within its tolerance."""
    WARNING = "warning"
    """Outside of the interval, by at most 2.5 half-widths from its centre: a careful observer sees the difference."""
    FAILED = "failed"
    """Farther away, or a failure of another kind, such as divergence."""
    NOT_MEASURED = "not measured"
    """The check does not apply to the target, or cannot run; `PhenomenonResult.applies` tells which."""

    @classmethod
    def _missing_(cls, value: object) -> Verdict | None:
        """Return a verdict by its value before 1.0, such as `Verdict("wrong")`."""
        new = RENAMED_VERDICTS.get(str(value))
        if new is None:
            return None
        # Python's `Enum` makes two calls in between.
        warn_renamed(str(value), new, stacklevel=5)
        return cls(new)

    @property
    def is_off(self) -> bool:
        """Whether it is a warning or a failure."""
        return self in (Verdict.WARNING, Verdict.FAILED)

    @classmethod
    def of(cls, deviation: float) -> Verdict:
        """Return the verdict of a distance from reality, in half-widths of its interval."""
        if deviation <= MAX_PASSED:
            return cls.PASSED
        return cls.WARNING if deviation <= MAX_WARNING else cls.FAILED


class RealityKind(StrEnum):
    """What a check compares with."""

    MEASURED = "measured"
    """Real trials: their mean, scatter and number."""
    LAW = "law"
    """A law of mechanics, with a tolerance and its reason."""


class Need(StrEnum):
    """What a target must have for a phenomenon to apply to it."""

    GRAVITY = "gravity"
    CONTACT = "contact"
    FRICTION = "friction"
    FOOT = "foot"
    SPACE = "space"
    """Motion in space, not in a plane along an axis of the world."""
    REBOUND = "rebound"
    """A restitution; without it, checks of impacts are advice."""


@dataclass(frozen=True, kw_only=True)
class ContactGroup:
    """Pairs of geoms of a model that collide with the same constants.

    Attributes:
        geoms: Description of the geoms, such as `floor with torso, bthigh and 6 more`.
        pair_count: Number of pairs of geoms.
        constants: Effective constants of a contact by MuJoCo's names: `condim`, `friction`, `solref`, ...
        is_used: Whether the experiments run with these constants.
        is_held: Whether a hand grasps a body with these constants.
        is_point: Whether the fingertips that grasp it are round, and touch it at a point each.
        settings: Settings of the backend that give all contacts these constants.
    """

    geoms: str
    pair_count: int
    constants: Settings
    is_used: bool = False
    is_held: bool = False
    is_point: bool = False
    settings: Settings = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class TrainingConfiguration:
    """Numerical settings that a policy is trained with.

    Attributes:
        name: Name that the user gave, such as `HalfCheetah-v5`.
        source: Description of what it was read from.
        backend: Name of the physics engine.
        settings: Settings of that backend for every scene; other settings are the backend's default.
        origins: Origin of each setting by its name, such as `option` or `floor with torso, ...`.
        frame_skip: Steps of the engine for one action; None when unknown.
        contact_groups: Contact constants of a model: those on ground first, then by the number of pairs.
        notes: Properties that are not carried over, or that need attention.
        inapplicable: Needs of phenomena that the target does not meet, with the reason.
        gravity_m_per_s2: Gravity of the target [m/s^2], shape [3]; None when it is unknown.
        up: Unit vector away from the ground, shape [3].
        is_model: Whether it was read from a MuJoCo model, for which this package recommends settings as a whole.
        foot_geometry: Foot of the robot; None when the target has none, or does not describe it.
        language: Name of the dialect in which changes are written; see `gauge_envs.tools.sanity.stacks`.
        robot: The target's own model, a `Robot`, which JSON leaves out; None when it is unknown.
    """

    name: str
    source: str
    backend: str
    settings: Settings
    origins: Mapping[str, str] = field(default_factory=dict)
    frame_skip: int | None = None
    contact_groups: tuple[ContactGroup, ...] = ()
    notes: tuple[str, ...] = ()
    inapplicable: Mapping[Need, str] = field(default_factory=dict)
    gravity_m_per_s2: Vector | None = None
    up: Vector = (0.0, 0.0, 1.0)
    is_model: bool = False
    foot_geometry: FootGeometry | None = None
    language: str = "toml"
    robot: Any = field(default=None, compare=False)

    def of_hand(self, *, is_flat: bool) -> TrainingConfiguration | None:
        """Return the configuration with the contacts of a hand alone in use; unchanged without a hand.

        Args:
            is_flat: Whether only contacts of flat pads count; the result is None for a hand without them.
        """
        if not any(group.is_held for group in self.contact_groups):
            return self
        groups = tuple(
            replace(group, is_used=group.is_held and not (is_flat and group.is_point))
            for group in self.contact_groups
        )
        is_any = any(group.is_used for group in groups)
        return replace(self, contact_groups=groups) if is_any else None

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


@dataclass(frozen=True)
class Reality:
    """Value of a phenomenon for real objects, and the interval in which a simulation is as good as a real trial.

    Attributes:
        value: Mean of real trials, or value from a law, in the phenomenon's unit.
        tolerance: Half-width of the interval, in the same unit.
        source: Source of the value.
        rationale: Reason for the tolerance.
        kind: Whether real trials or a law give the value.
        scatter: Standard deviation of real trials, or standard uncertainty of a single recording; None for a law.
        trial_count: Number of real trials; 0 for a law.
        limits: The interval as a text, where a value has a limit on one side; empty for centre and half-width.
    """

    value: float
    tolerance: float
    source: str
    rationale: str
    _: KW_ONLY
    kind: RealityKind = RealityKind.LAW
    scatter: float | None = None
    trial_count: int = 0
    limits: str = ""

    @classmethod
    def measured(
        cls, value: float, scatter: float, trial_count: int, source: str
    ) -> Reality:
        """Return what real trials gave, with the interval that covers 95 % of further trials.

        Args:
            value: Mean of the trials.
            scatter: Standard deviation of the trials; for one trial, the standard uncertainty of its measurement.
            trial_count: Number of trials.
            source: Source of the trials.
        """
        if trial_count == 1:
            factor, rationale = (
                RECORDING_FACTOR,
                "two standard uncertainties of one recording",
            )
        else:
            quantile = student_t(trial_count - 1, COVERAGE)
            factor = quantile * (1.0 + 1.0 / trial_count) ** 0.5
            rationale = f"covers {COVERAGE:.0%} of further trials, from the scatter of {trial_count} trials"
        return cls(
            value,
            factor * scatter,
            source,
            rationale,
            kind=RealityKind.MEASURED,
            scatter=scatter,
            trial_count=trial_count,
        )


@dataclass(frozen=True, kw_only=True)
class ChangePart:
    """A part of a fix, such as an attribute.

    Attributes:
        text: The part in the target's language, such as `<option cone="elliptic"/>`.
        corrects: Ids of the failed checks and warnings that pass after this part alone.
    """

    text: str
    corrects: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Fix:
    """The change of a few settings that resolves most failed checks and warnings, as measured.

    Attributes:
        changes: Changed settings with their new values.
        line: The change in the target's language, and what it resolves.
        flag_count: Number of failed checks and warnings before the change.
        fixed: Value of each of these checks that passes after the change; None where it was not measured.
        lines: The change as lines of a diff, which start with `- ` or `+ `.
        parts: The parts of the change, each with what it resolves alone.
        speed_ratio: Simulated time of the target in a second after the change, over that before; None if not measured.
    """

    changes: Settings
    line: str
    flag_count: int
    fixed: Mapping[str, float | None] = field(default_factory=dict)
    lines: tuple[str, ...] = ()
    parts: tuple[ChangePart, ...] = ()
    speed_ratio: float | None = None


@dataclass(frozen=True, kw_only=True)
class PartOutcome:
    """Outcome of a check for one part: a set of contact constants, or a joint, a link or a pair of geoms of the robot.

    Attributes:
        name: The part; for contact constants, the geoms that touch with them.
        value: Measured value; None when not measured.
        verdict: The verdict.
        deviation: Distance from reality, in half-widths of its interval or as the ratio to a limit.
        remark: Why it was not measured, or how it failed; empty otherwise.
    """

    name: str
    value: float | None
    verdict: Verdict
    deviation: float
    remark: str = ""


@dataclass(frozen=True, kw_only=True)
class PhenomenonResult:
    """Result of one check.

    Attributes:
        phenomenon: Id, such as `creep-wood`.
        title: Title, such as `creep of a cube of wood on 10 degrees`.
        experiment: Gymnasium id of the experiment; empty when nothing is simulated.
        unit: Unit of the values; `1` for a pure number.
        reality: Value for real objects.
        default: Value with the backend's default; None when not measured.
        configured: Value in this configuration; None when not measured.
        verdict: Verdict of this configuration.
        default_verdict: Verdict of the backend's default.
        remark: Why it was not measured, or how it failed; empty otherwise.
        advisory: Why the verdict does not count for the whole configuration; empty when it counts.
        applies: Whether the check applies to the target.
        geoms: Geoms whose contact constants decide the verdict; empty when all contacts have the same.
        parts: Outcome for each part that is checked; empty when nothing was measured.
        consequence: What a failure means for a policy, in one sentence; empty when the title says it.
        place: Element of the target's own model that decides the verdict, with file and line; empty otherwise.
    """

    phenomenon: str
    title: str
    experiment: str = ""
    unit: str
    reality: Reality
    default: float | None = None
    configured: float | None = None
    verdict: Verdict
    default_verdict: Verdict = Verdict.NOT_MEASURED
    remark: str = ""
    advisory: str = ""
    applies: bool = True
    geoms: str = ""
    parts: tuple[PartOutcome, ...] = ()
    consequence: str = ""
    place: str = ""

    @property
    def is_on_target(self) -> bool:
        """Whether the check is on the target itself, and runs none of the suite's experiments."""
        return not self.experiment

    @property
    def is_flag(self) -> bool:
        """Whether the check is a warning or failed, and counts."""
        return self.verdict.is_off and not self.advisory

    @property
    def deviation(self) -> float:
        """Distance of the worst part from reality, in half-widths of its interval; 0 if nothing was measured."""
        return max((part.deviation for part in self.parts), default=0.0)

    def to_dict(self) -> dict[str, Any]:
        """Return all attributes, JSON-ready."""
        return json_ready(asdict(self))


@dataclass(frozen=True, kw_only=True)
class Report:
    """Result of a sanity check.

    Attributes:
        configuration: The checked configuration.
        rows: Result of each check, in a fixed order.
        versions: Versions of the engine's packages, of gauge-envs and of its dependencies.
        wall_s: Time that the check took [s].
        fix: The change that resolves most failed checks and warnings; None when no change resolves one.
        tried: Changes that were tried and not chosen, and how far each came.
        trade: The best of these with its price, when no change resolves a check without harm; empty otherwise.
        unstated: Properties that the target's model leaves open, in one sentence; empty for none.
        notes: What limits the check, such as an expired time limit.
        asked: Ids of checks that were requested by their full id.
    """

    configuration: TrainingConfiguration
    rows: tuple[PhenomenonResult, ...]
    versions: Mapping[str, str]
    wall_s: float
    fix: Fix | None = None
    tried: tuple[str, ...] = ()
    trade: str = ""
    unstated: str = ""
    notes: tuple[str, ...] = ()
    asked: tuple[str, ...] = ()

    @property
    def cure(self) -> Fix | None:
        """The fix by its name before 1.0, which is read until 1.2."""
        warn_renamed("cure", "fix")
        return self.fix

    @property
    def flags(self) -> dict[str, PhenomenonResult]:
        """Failed checks and warnings that count, by id."""
        return {row.phenomenon: row for row in self.rows if row.is_flag}

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """Ids of checks that apply, or were requested by id, and were not measured; all ids when none was measured."""
        missing = [row for row in self.rows if row.verdict is Verdict.NOT_MEASURED]
        is_all = len(missing) == len(self.rows)
        return tuple(
            row.phenomenon
            for row in missing
            if is_all or row.applies or row.phenomenon in self.asked
        )

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of checks that were measured, that apply and were not measured, and that do not apply."""
        missing = [row for row in self.rows if row.verdict is Verdict.NOT_MEASURED]
        inapplicable = sum(not row.applies for row in missing)
        return {
            "measured": len(self.rows) - len(missing),
            "not_measured": len(missing) - inapplicable,
            "not_applicable": inapplicable,
        }

    @property
    def worst(self) -> Verdict:
        """The worst verdict of all checks that count; `not measured` only when nothing was measured."""
        order = (Verdict.FAILED, Verdict.WARNING, Verdict.PASSED)
        verdicts = {
            Verdict.PASSED if row.advisory else row.verdict for row in self.rows
        }
        return next(filter(verdicts.__contains__, order), Verdict.NOT_MEASURED)

    def to_dict(self) -> dict[str, Any]:
        """Return all attributes, JSON-ready, without the target's own model."""
        bare = replace(self, configuration=replace(self.configuration, robot=None))
        values: dict[str, Any] = json_ready(asdict(bare))
        del values["configuration"]["robot"]
        return values | {
            "worst": self.worst.value,
            "unmeasured": list(self.unmeasured),
            "counts": self.counts,
        }


def flags_text(rows: Sequence[PhenomenonResult]) -> str:
    """Return what failed checks and warnings are called together, such as `failed checks`."""
    verdicts = {row.verdict for row in rows}
    nouns = {Verdict.FAILED: "failed checks", Verdict.WARNING: "warnings"}
    return " and ".join(noun for verdict, noun in nouns.items() if verdict in verdicts)
