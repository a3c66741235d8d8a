"""A check of the target's own model: limits, source and texts stand above the function that measures it.

In code, a row is a check with its result.

Example:
    ```python
    @row(
        "model-spin",
        title="angular momentum that a free body loses in 2 s",
        unit="1",
        interval=(0.0, 0.02),
        source="angular momentum of a free body is conserved",
        consequence="What is thrown or falls stops turning in the air.",
    )
    def spin(robot: Robot) -> Finding: ...
    ```
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from gauge_envs.pages.text import quantity_text
from gauge_envs.tools.sanity.model import (
    PartOutcome,
    PhenomenonResult,
    Reality,
    Verdict,
)

if TYPE_CHECKING:
    from gauge_envs.tools.sanity.robot.robot import Robot

Place = tuple[str, int]
"""Kind of an element of the model, such as `joint`, and its id in the compiled model."""

WHOLE = "the model"
"""Part of a check of the model as a whole."""


class NotApplicableError(Exception):
    """A check does not apply to a model; the message is the reason."""


class NotMeasuredError(Exception):
    """A check applies to a model and cannot be measured; the message is the reason."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What a check measures.

    Attributes:
        value: The value of the part that decides; not finite for a motion that diverges.
        remark: What happens there, with its numbers and the names of the user's elements, in one phrase.
        place: Element of the model that decides the value; None for the model as a whole.
        parts: Value of each part that is checked, by its name; empty for the model as a whole.
        is_usual: Whether the violated limit says what is usual: the verdict is then a warning at worst.
    """

    value: float
    remark: str = ""
    place: Place | None = None
    parts: Mapping[str, float] = field(default_factory=dict)
    is_usual: bool = False


@dataclass(frozen=True, kw_only=True)
class Row:
    """A check of the target's own model.

    Attributes:
        id: Its id.
        title: Phrase that names the quantity.
        unit: Unit of the value; `1` for a pure number.
        interval: Limits of the value.
        source: Source of the limits.
        consequence: What a failure means for a policy, in one sentence.
        is_usual: Whether the limits say what is usual: the verdict is then a warning at worst.
        measure: Function that measures a model. It raises `NotApplicableError` or `NotMeasuredError` with a reason.
    """

    id: str
    title: str
    unit: str
    interval: tuple[float, float]
    source: str
    consequence: str
    is_usual: bool = False
    measure: Callable[[Robot], Finding]

    @property
    def reality(self) -> Reality:
        """The limits, as the reality of a law."""
        low, high = self.interval
        numbers = [quantity_text(limit) for limit in self.interval]
        limits = f"{numbers[0]} to {numbers[1]}"
        if low <= 0.0:
            limits = f"at most {numbers[1]}"
        if math.isinf(high):
            limits = f"at least {numbers[0]}"
        return Reality(
            value=low if math.isinf(high) else 0.5 * (low + high),
            tolerance=1.0 if math.isinf(high) else 0.5 * (high - low),
            source=self.source,
            rationale=self.consequence,
            limits=limits,
        )

    def deviation(self, value: float) -> float:
        """Return the ratio of a value to the limit that it violates; 1 between them, infinite for another sign."""
        low, high = self.interval
        if value < min(low, 0.0) or not np.isfinite(value):
            return math.inf
        return max(1.0, low / max(value, 1e-12), value / high)


ROWS: dict[str, Row] = {}
"""Checks by their id."""


def row(
    name: str, **attributes: Any
) -> Callable[[Callable[[Robot], Finding]], Callable[[Robot], Finding]]:
    """Return a decorator that registers the function of a check; see `Row` for the attributes."""

    def register(measure: Callable[[Robot], Finding]) -> Callable[[Robot], Finding]:
        ROWS[name] = Row(id=name, measure=measure, **attributes)
        return measure

    return register


def row_result(row: Row, robot: Robot | None) -> PhenomenonResult:
    """Return the result of a check: a warning up to 2.5 times its limits, failed beyond.

    Args:
        row: The check.
        robot: The target's own model; None where it is unknown.
    """
    result = PhenomenonResult(
        phenomenon=row.id,
        title=row.title,
        unit=row.unit,
        reality=row.reality,
        verdict=Verdict.NOT_MEASURED,
    )
    try:
        if robot is None:
            raise NotApplicableError("the target's own model is not read")
        finding = robot.finding(row)
    except (NotApplicableError, NotMeasuredError, mujoco.FatalError) as reason:
        applies = not isinstance(reason, NotApplicableError)
        return replace(result, remark=str(reason), applies=applies)

    def judged(value: float) -> Verdict:
        verdict = Verdict.of(row.deviation(value))
        is_usual = row.is_usual or finding.is_usual
        return Verdict.WARNING if is_usual and verdict.is_off else verdict

    def finite(value: float) -> float | None:
        return value if np.isfinite(value) else None

    verdict = judged(finding.value)
    parts = finding.parts or {WHOLE: finding.value}
    return replace(
        result,
        configured=finite(finding.value),
        verdict=verdict,
        remark=finding.remark,
        place="" if finding.place is None else robot.place_text(finding.place),
        consequence=row.consequence if verdict.is_off else "",
        parts=tuple(
            PartOutcome(
                name=part,
                value=finite(value),
                verdict=judged(value),
                deviation=row.deviation(value),
            )
            for part, value in parts.items()
        ),
    )
