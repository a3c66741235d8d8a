"""Define a rule: a check whose function yields the faulty elements of a model, most of them without a simulation."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

from gauge_envs.tools.sanity.model_checks.check import (
    Change,
    Finding,
    ModelCheck,
    model_check,
)
from gauge_envs.tools.sanity.robot.robot import Place, Robot
from gauge_envs.tools.sanity.verdict import Severity

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
