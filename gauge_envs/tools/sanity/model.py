"""Define the parts of a sanity check: configuration, verdicts, phenomena in reality and in simulation, and the cure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from typing import Any, TypeAlias

from scipy.special import stdtrit

from gauge_envs.files import json_ready
from gauge_envs.scene import Vector
from gauge_envs.tools.sanity.robot.foot import FootGeometry

Settings: TypeAlias = Mapping[str, Any]
"""Settings by name. A value is a number, a truth value, a text, a list, or None for what is not set."""

WARNED = "MuJoCo warns:"
"""Start of a note on the user's file, which is shown even where nothing is flagged."""

INSIDE_WITHIN = 1.0
"""Largest deviation of the verdict `inside`, in half-widths of the interval of reality."""

VISIBLE_WITHIN = 2.5
"""Largest deviation of the verdict `visible`, in half-widths of the interval of reality."""

COVERAGE = 0.95
"""Share of further real trials that the interval of a measured row covers."""

ONE_RECORDING_FACTOR = 2.0
"""Half-width of the interval of one recording, in standard uncertainties."""


class Verdict(StrEnum):
    """Distance between a measured value and reality, in half-widths of the interval of reality."""

    INSIDE = "inside"
    """In the interval: a real trial could give this value, or the law is met within its tolerance."""
    VISIBLE = "visible"
    """Outside of the interval, by at most 2.5 half-widths from its centre: a careful observer sees the difference."""
    WRONG = "wrong"
    """Farther away, or a failure of another kind, such as divergence."""
    DECLINED = "declined"
    """Not measured: it does not apply to the target, or could not run; `PhenomenonResult.applies` tells which."""

    @property
    def is_off(self) -> bool:
        """Whether it is visible or wrong."""
        return self in (Verdict.VISIBLE, Verdict.WRONG)

    @classmethod
    def of(cls, deviation: float) -> Verdict:
        """Return the verdict of a distance from reality, in half-widths of its interval."""
        if deviation <= INSIDE_WITHIN:
            return cls.INSIDE
        return cls.VISIBLE if deviation <= VISIBLE_WITHIN else cls.WRONG


class RealityKind(StrEnum):
    """What a row is compared with."""

    MEASURED = "measured"
    """Real trials: their mean, scatter and number."""
    LAW = "law"
    """A law of mechanics, with a tolerance whose reason is stated."""


class Need(StrEnum):
    """What a target must have for a phenomenon to apply to it."""

    GRAVITY = "gravity"
    CONTACT = "contact"
    FRICTION = "friction"
    FOOT = "foot"
    SPACE = "space"
    """Motion in space, not in a plane along an axis of the world."""
    REBOUND = "rebound"
    """A restitution; without it, rows on impacts are advice."""


@dataclass(frozen=True, kw_only=True)
class ContactGroup:
    """Pairs of geoms of a model that collide with the same constants.

    Attributes:
        geoms: Description of the geoms, such as `floor with torso, bthigh and 6 more`.
        pair_count: Number of pairs of geoms.
        constants: Effective constants of a contact by MuJoCo's names: `condim`, `friction`, `solref`, ...
        is_used: Whether the experiments run with these constants.
        is_held: Whether a hand holds a body with these constants, and grasps run with them.
        is_point: Whether the fingertips that hold it are round, and touch it at one point each.
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
        gravity_m_per_s2: Gravity of the target [m/s^2], shape [3]; None when the target states none.
        up: Unit vector away from the ground, shape [3].
        is_model: Whether it was read from a MuJoCo model, for which this package recommends settings as a whole.
        foot_geometry: Foot of the robot; None when the target has none, or does not state it.
        language: Name of the dialect in which changes are written; see `gauge_envs.tools.sanity.stacks`.
        robot: The target's own model, a `Robot`, which reports do not hold; None when it is not known.
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
        """Return this with the contacts of a hand alone in use, if there is one; of its flat pads, or None without."""
        if not any(one.is_held for one in self.contact_groups):
            return self
        used_groups = [
            replace(one, is_used=one.is_held and not (is_flat and one.is_point))
            for one in self.contact_groups
        ]
        if not any(one.is_used for one in used_groups):
            return None
        return replace(self, contact_groups=tuple(used_groups))

    @property
    def contact_sets(self) -> dict[str, dict[str, Any]]:
        """Settings for each set of contact constants that is judged, by its geoms; one without name if unknown."""
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


@dataclass(frozen=True, kw_only=True)
class Reality:
    """Value of a phenomenon for real objects, and the interval in which a simulation is as good as a real trial.

    Attributes:
        kind: Whether real trials or a law give the value.
        value: Mean of real trials, or value from a law, in the phenomenon's unit.
        tolerance: Half-width of the interval, in the same unit.
        source: Source of the value.
        rationale: Reason for the tolerance.
        scatter: Standard deviation of real trials, or standard uncertainty of one recording; None for a law.
        trial_count: Number of real trials; 0 for a law.
        limits: The interval in words, where a value has a limit on one side; empty for centre and half-width.
    """

    kind: RealityKind
    value: float
    tolerance: float
    source: str
    rationale: str
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
                ONE_RECORDING_FACTOR,
                "two standard uncertainties of one recording",
            )
        else:
            quantile = float(stdtrit(trial_count - 1, 0.5 + 0.5 * COVERAGE))
            factor = quantile * (1.0 + 1.0 / trial_count) ** 0.5
            rationale = f"covers {COVERAGE:.0%} of further trials, from the scatter of {trial_count} trials"
        return cls(
            kind=RealityKind.MEASURED,
            value=value,
            tolerance=factor * scatter,
            source=source,
            rationale=rationale,
            scatter=scatter,
            trial_count=trial_count,
        )

    @classmethod
    def law(
        cls, value: float, tolerance: float, source: str, rationale: str
    ) -> Reality:
        """Return what a law states, with a tolerance and its reason."""
        return cls(
            kind=RealityKind.LAW,
            value=value,
            tolerance=tolerance,
            source=source,
            rationale=rationale,
        )


@dataclass(frozen=True, kw_only=True)
class ChangePart:
    """A part of a change, such as one attribute.

    Attributes:
        text: The part in the target's language, such as `<option cone="elliptic"/>`.
        corrects: Ids of the flagged rows that are inside after this part alone.
    """

    text: str
    corrects: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Cure:
    """The change of a few settings that corrects most flagged rows, as measured.

    Attributes:
        changes: Changed settings with their new values.
        line: The change in the target's language, and what it corrects.
        flag_count: Number of visible or wrong rows before the change.
        mended: Value of each of these rows that is inside after the change; None where it was not measured.
        lines: The change as lines of a diff, which start with `- ` or `+ `.
        parts: The parts of the change, each with what it corrects alone.
        speed_ratio: Simulated time of the target in a second after the change, over that before; None if not measured.
    """

    changes: Settings
    line: str
    flag_count: int
    mended: Mapping[str, float | None] = field(default_factory=dict)
    lines: tuple[str, ...] = ()
    parts: tuple[ChangePart, ...] = ()
    speed_ratio: float | None = None

    @property
    def mended_count(self) -> int:
        """Number of flagged rows that are inside after the change."""
        return len(self.mended)


@dataclass(frozen=True, kw_only=True)
class PartOutcome:
    """Outcome of a row for one part: a set of contact constants, or a joint, a link or a pair of geoms of the robot.

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
    """Result of one phenomenon.

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
        applies: Whether the phenomenon applies to the target.
        geoms: Geoms whose contact constants decide the row; empty when all contacts have the same.
        parts: Outcome for each part that the row judges; empty when it judges one alone.
        consequence: What a flag means for a policy, in one sentence; empty when the title says it.
        place: Element of the target that decides a row on its own model, with file and line; empty otherwise.
    """

    phenomenon: str
    title: str
    experiment: str = ""
    unit: str
    reality: Reality
    default: float | None = None
    configured: float | None = None
    verdict: Verdict
    default_verdict: Verdict = Verdict.DECLINED
    remark: str = ""
    advisory: str = ""
    applies: bool = True
    geoms: str = ""
    parts: tuple[PartOutcome, ...] = ()
    consequence: str = ""
    place: str = ""

    @property
    def is_own(self) -> bool:
        """Whether the row is on the target itself, and runs none of the suite's experiments."""
        return not self.experiment

    @property
    def is_flag(self) -> bool:
        """Whether the row is visible or wrong, and counts."""
        return self.verdict.is_off and not self.advisory

    @property
    def deviation(self) -> float:
        """Distance of the worst part from reality, in half-widths of its interval; 0 if nothing was measured."""
        return max((part.deviation for part in self.parts), default=0.0)

    @property
    def effect(self) -> float | None:
        """Difference between this configuration and reality, in the row's unit; None when nothing was measured."""
        return None if self.configured is None else self.configured - self.reality.value

    def to_dict(self) -> dict[str, Any]:
        """Return all attributes, JSON-ready."""
        return json_ready(asdict(self))


@dataclass(frozen=True, kw_only=True)
class Report:
    """Result of a sanity check.

    Attributes:
        configuration: The checked configuration.
        rows: One result for each phenomenon, in a fixed order.
        versions: Versions of the engine's packages, of gauge-envs and of its dependencies.
        wall_s: Time that the check took [s].
        cure: The change that mends most rows; None when no row is flagged or no change mends one.
        tried: Changes that were tried and not chosen, and how far each came.
        trade: The best of these with its price, when no change corrects a row without harm; empty otherwise.
        unstated: Properties that the target's model leaves open, in one sentence; empty for none.
        notes: What limits the check, such as an expired time limit.
        asked: Ids of rows that were asked for one by one.
    """

    configuration: TrainingConfiguration
    rows: tuple[PhenomenonResult, ...]
    versions: Mapping[str, str]
    wall_s: float
    cure: Cure | None = None
    tried: tuple[str, ...] = ()
    trade: str = ""
    unstated: str = ""
    notes: tuple[str, ...] = ()
    asked: tuple[str, ...] = ()

    @property
    def flags(self) -> dict[str, PhenomenonResult]:
        """Rows that are visible or wrong, and count, by id."""
        return {row.phenomenon: row for row in self.rows if row.is_flag}

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """Ids of rows that apply, or were asked for by name, and were not measured; all rows when none was measured."""
        declined = [row for row in self.rows if row.verdict is Verdict.DECLINED]
        every = len(declined) == len(self.rows)
        return tuple(
            r.phenomenon
            for r in declined
            if every or r.applies or r.phenomenon in self.asked
        )

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of rows that were measured, that apply and were declined, and that do not apply."""
        missing = [row for row in self.rows if row.verdict is Verdict.DECLINED]
        inapplicable = sum(not row.applies for row in missing)
        return {
            "measured": len(self.rows) - len(missing),
            "declined": len(missing) - inapplicable,
            "not_applicable": inapplicable,
        }

    @property
    def worst(self) -> Verdict:
        """The worst verdict of all rows that count; `declined` only when nothing was measured."""
        order = (Verdict.WRONG, Verdict.VISIBLE, Verdict.INSIDE)
        found = {Verdict.INSIDE if row.advisory else row.verdict for row in self.rows}
        return next(
            (verdict for verdict in order if verdict in found), Verdict.DECLINED
        )

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
