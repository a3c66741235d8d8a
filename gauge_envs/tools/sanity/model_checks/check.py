"""Define a check of the target itself: its limits, source and texts stand above the function that measures it.

A rule is a check whose function yields the faulty elements of a model, most of them without a simulation.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, TypeAlias

import mujoco

from gauge_envs.pages.text import quantity_text
from gauge_envs.tools.sanity.robot.robot import Place, Robot, once
from gauge_envs.tools.sanity.verdict import (
    NotApplicableError,
    PartOutcome,
    Reality,
    SanityResult,
    SanityVerdict,
    Severity,
    TrainingConfiguration,
)

Change: TypeAlias = tuple[str, Any]
"""Attribute of an element as in MJCF, and its value."""

WHOLE = "the model"
"""Part of a check of the model as a whole."""

# --- what a check measures -------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What a check measures.

    Attributes:
        value: The value of the part that decides; not finite for a motion that diverges.
        remark: What happens there, with its numbers and the names of the user's elements, in one phrase.
        place: Element of the model that decides the value; None for the model as a whole.
        parts: Value of each part that is checked, by its name; empty for the model as a whole.
        most: Largest severity that the violated limit allows.
        changes: Elements with an attribute and its right value, which correct the model.
    """

    value: float
    remark: str = ""
    place: Place | None = None
    parts: Mapping[str, float] = field(default_factory=dict)
    most: Severity = Severity.ERROR
    changes: Sequence[tuple[Place, Change]] = ()


# --- checks ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelCheck:
    """A check of the target's own model, which runs none of the suite's experiments.

    Attributes:
        id: Its id.
        title: Phrase that names the quantity.
        unit: Unit of the value; `1` for a pure number.
        reality: The limits of the value.
        interval: Limits of the value.
        finding: Function that measures a model, once. It raises `NotApplicableError` with a reason.
        most: Largest severity of its findings: advice where the limits say what is usual.
        is_simulated: Whether it runs the target's own model, so that settings of the engine can change it.
    """

    id: str
    title: str
    unit: str
    reality: Reality
    interval: tuple[float, float]
    finding: Callable[[Robot], Finding]
    most: Severity
    is_simulated: bool = False

    def deviation(self, value: float) -> float:
        """Return the ratio of a value to the limit that it violates; 1 between them, infinite for another sign."""
        low, high = self.interval
        if value < min(low, 0.0) or not math.isfinite(value):
            return math.inf
        return max(1.0, low / max(value, 1e-12), value / high)

    def result(self, configuration: TrainingConfiguration) -> SanityResult:
        """Return the result for a target: a warning up to 2.5 times the limits, failed beyond."""
        unmeasured = SanityResult(
            id=self.id,
            title=self.title,
            unit=self.unit,
            reality=self.reality,
            verdict=SanityVerdict.NOT_MEASURED,
        )
        robot = configuration.robot
        if robot is None:
            reason = "the target's own model is not read"
            return replace(unmeasured, remark=reason, applies=False)
        try:
            finding = self.finding(robot)
        except (NotApplicableError, mujoco.FatalError) as error:
            applies = not isinstance(error, NotApplicableError)
            return replace(unmeasured, remark=str(error), applies=applies)
        most = min(self.most, finding.most, key=[*Severity].index)
        whole = self._part(WHOLE, finding.value, most)
        parts = [self._part(*part, most) for part in finding.parts.items()]
        place, file, line = "", "", 0
        if finding.place is not None:
            place = robot.place_text(finding.place)
            file, line = robot.source_of(finding.place)
        return replace(
            unmeasured,
            configured=whole.value,
            verdict=whole.verdict,
            is_usual=most is Severity.ADVICE,
            remark=finding.remark,
            place=place,
            file=file,
            line=line,
            parts=tuple(parts or [whole]),
        )

    def _part(self, name: str, value: float, most: Severity) -> PartOutcome:
        deviation = self.deviation(value)
        verdict = SanityVerdict.of(deviation)
        if verdict.is_off and most is not Severity.ERROR:
            verdict = SanityVerdict.WARNING
        return PartOutcome(
            name=name,
            value=value if math.isfinite(value) else None,
            verdict=verdict,
            deviation=deviation,
        )


def model_check(
    name: str,
    *,
    title: str,
    interval: tuple[float, float],
    source: str,
    consequence: str,
    unit: str = "1",
    most: Severity = Severity.WARNING,
    is_simulated: bool = False,
) -> Callable[[Callable[[Robot], Finding]], ModelCheck]:
    """Return a decorator that makes a check of a function; see `ModelCheck`.

    Args:
        name: Id of the check.
        title: Phrase that names the quantity.
        interval: Limits of the value.
        source: Source of the limits.
        consequence: What a failure means for a policy, in one sentence.
        unit: Unit of the value; `1` for a pure number.
        most: As in `ModelCheck`.
        is_simulated: As in `ModelCheck`.
    """

    def decorate(function: Callable[[Robot], Finding]) -> ModelCheck:
        return ModelCheck(
            id=name,
            title=title,
            unit=unit,
            reality=_limits(interval, source, consequence),
            most=most,
            is_simulated=is_simulated,
            interval=interval,
            finding=once(function),
        )

    return decorate


def _limits(interval: tuple[float, float], source: str, consequence: str) -> Reality:
    """Return limits of a value as the reality of a law."""
    low, high = interval
    low_text, high_text = map(quantity_text, interval)
    if math.isinf(high):
        limits = f"at least {low_text}"
        return Reality(low, 1.0, source, consequence, limits=limits)
    limits = f"{low_text} to {high_text}"
    if low <= 0.0:
        limits = f"at most {high_text}"
    value, tolerance = 0.5 * (low + high), 0.5 * (high - low)
    return Reality(value, tolerance, source, consequence, limits=limits)


def leave_to(check: ModelCheck, robot: Robot) -> None:
    """Raise `NotApplicableError` where another check has the cause of a fault."""
    if check.deviation(check.finding(robot).value) > 1.0:
        raise NotApplicableError(f"{check.id} has the cause")


UNITS = {
    1000.0: "grams or millimetres",
    57.29578: "degrees",
    3282.806: "degrees on both sides of a gain",
    25.4: "inches",
}
"""Units that a ratio names."""

UNIT_TOLERANCE = 0.02
"""Relative distance up to which a ratio names a unit."""


class Fault(NamedTuple):
    """A number of the model that contradicts another one.

    Attributes:
        place: Element of the model.
        name: Name of the element.
        text: What is wrong, with its numbers, as a sentence without a full stop.
        ratio: Ratio of the two numbers; the largest is shown first.
        is_error: Whether the model cannot do at all what its file says.
        change: Attribute of the element and its right value, in the units of the file; None where it is unknown.
        changed: Element that the change corrects; None for the faulty one.
        is_usual: Whether the second number says what is usual, so that the fault is advice.
    """

    place: Place
    name: str
    text: str
    ratio: float = 1.0
    is_error: bool = False
    change: Change | None = None
    changed: Place | None = None
    is_usual: bool = False

    @property
    def most(self) -> Severity:
        """Severity of the fault."""
        if self.is_error:
            return Severity.ERROR
        return Severity.ADVICE if self.is_usual else Severity.WARNING


def rule(
    name: str,
    *,
    title: str,
    source: str,
    consequence: str,
    most: Severity = Severity.ERROR,
    is_simulated: bool = False,
) -> Callable[[Callable[[Robot], Iterable[Fault]]], ModelCheck]:
    """Return a decorator that makes a check of a function which yields faults; see `model_check`."""

    def decorate(function: Callable[[Robot], Iterable[Fault]]) -> ModelCheck:
        def measure(robot: Robot) -> Finding:
            return found(function(robot))

        check = model_check(
            name,
            title=title,
            interval=(0.0, 0.25),
            source=source,
            consequence=consequence,
            most=most,
            is_simulated=is_simulated,
        )
        return check(measure)

    return decorate


def found(faults: Iterable[Fault]) -> Finding:
    """Return the finding of faults: the number of faulty elements, and the worst one with the number of others."""
    ranked = sorted(
        faults,
        key=lambda fault: (not fault.is_error, fault.is_usual, -fault.ratio),
    )
    if not ranked:
        return Finding(value=0.0)
    names = dict.fromkeys(fault.name for fault in ranked)
    worst, more = ranked[0], len(names) - 1
    # Several faults may have one correction.
    changes = [(f.changed or f.place, f.change) for f in ranked if f.change]
    return Finding(
        value=float(len(names)),
        remark=f"{worst.text}; {more} more" if more else worst.text,
        place=worst.place,
        parts=dict.fromkeys(names, 1.0),
        most=worst.most,
        changes=[*{repr(change): change for change in changes}.values()],
    )


def unit_text(ratio: float) -> str:
    """Return the unit that a ratio names, as `: looks like degrees`; empty for another ratio."""
    ratio = max(abs(ratio), 1.0 / max(abs(ratio), 1e-300))
    for factor, unit in UNITS.items():
        if abs(ratio / factor - 1.0) < UNIT_TOLERANCE:
            return f" ({factor:.4g} times: {unit})"
    return ""
