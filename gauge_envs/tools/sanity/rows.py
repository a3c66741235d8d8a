"""A row on the target's own model: limits, source and words stand above the function that measures it.

Example:
    ```python
    @row(
        "model-spin",
        title="angular momentum that a free body loses in 2 s",
        unit="1",
        interval=(0.0, 0.02),
        source="angular momentum of a free body is conserved",
        consequence="What is thrown or falls stops to turn in the air.",
    )
    def spin(robot: Robot) -> Finding: ...
    ```
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from gauge_envs.pages.text import quantity_text
from gauge_envs.tools.sanity.model import (
    PartOutcome,
    PhenomenonResult,
    Reality,
    RealityKind,
    Verdict,
)

if TYPE_CHECKING:
    from gauge_envs.tools.sanity.robot.robot import Robot

Place = tuple[str, int]
"""Kind of an element of the model, such as `joint`, and its id in the compiled model."""

WHOLE = "the model"
"""Part of a row that judges the model as a whole."""


class NotApplicableError(Exception):
    """A row does not apply to a model; the message is the reason."""


class NotMeasuredError(Exception):
    """A row applies to a model and cannot be measured; the message is the reason."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What a row measured.

    Attributes:
        value: The value of the part that decides; not finite for a motion that diverges.
        remark: What happens there, with its numbers and the names of the user's elements, in one phrase.
        place: Element of the model that decides the value; None for the model as a whole.
        parts: Value of each part that the row judges, by its name; empty for the model as a whole.
        is_usual: Whether the limit that it breaks says what is usual: the row is then visible at most.
    """

    value: float
    remark: str = ""
    place: Place | None = None
    parts: Mapping[str, float] = field(default_factory=dict)
    is_usual: bool = False


@dataclass(frozen=True, kw_only=True)
class Row:
    """A row on the target's own model.

    Attributes:
        id: Its id.
        title: Phrase that names the quantity.
        unit: Unit of the value; `1` for a pure number.
        interval: Limits of the value.
        source: Where the limits come from.
        consequence: What a flag means for a policy, in one sentence.
        is_usual: Whether the limits say what is usual: the row is then visible at most.
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
            kind=RealityKind.LAW,
            value=low if math.isinf(high) else 0.5 * (low + high),
            tolerance=1.0 if math.isinf(high) else 0.5 * (high - low),
            source=self.source,
            rationale=self.consequence,
            limits=limits,
        )

    def deviation(self, value: float) -> float:
        """Return the ratio by which a value is beyond the limits; 1 between them, infinite for another sign."""
        low, high = self.interval
        if value < min(low, 0.0) or not np.isfinite(value):
            return math.inf
        return max(1.0, low / max(value, 1e-12), value / high)


ROWS: dict[str, Row] = {}
"""Rows by their id, in the order in which their modules were imported."""


def row(
    name: str,
    *,
    title: str,
    unit: str,
    interval: tuple[float, float],
    source: str,
    consequence: str,
    is_usual: bool = False,
) -> Callable[[Callable[[Robot], Finding]], Callable[[Robot], Finding]]:
    """Return a decorator that registers the function of a row; see `Row` for the arguments."""

    def register(measure: Callable[[Robot], Finding]) -> Callable[[Robot], Finding]:
        ROWS[name] = Row(
            id=name,
            title=title,
            unit=unit,
            interval=interval,
            source=source,
            consequence=consequence,
            is_usual=is_usual,
            measure=measure,
        )
        return measure

    return register


def row_result(row: Row, robot: Robot | None) -> PhenomenonResult:
    """Return the result of a row: visible up to 2.5 times its limits, wrong beyond.

    Args:
        row: The row.
        robot: The target's own model; None where it is not known.
    """
    result = PhenomenonResult(
        phenomenon=row.id,
        title=row.title,
        unit=row.unit,
        reality=row.reality,
        verdict=Verdict.DECLINED,
    )
    try:
        if robot is None:
            raise NotApplicableError("the target's own model is not read")
        found = robot.finding(row)
    except (NotApplicableError, NotMeasuredError, mujoco.FatalError) as reason:
        applies = not isinstance(reason, NotApplicableError)
        return replace(result, remark=str(reason), applies=applies)

    def judged(value: float) -> Verdict:
        verdict = Verdict.of(row.deviation(value))
        is_usual = row.is_usual or found.is_usual
        return Verdict.VISIBLE if is_usual and verdict.is_off else verdict

    verdict = judged(found.value)
    return replace(
        result,
        configured=found.value if np.isfinite(found.value) else None,
        verdict=verdict,
        remark=found.remark,
        place="" if found.place is None else robot.place_text(found.place),
        consequence=row.consequence if verdict.is_off else "",
        parts=tuple(
            PartOutcome(
                name=part,
                value=value if np.isfinite(value) else None,
                verdict=judged(value),
                deviation=row.deviation(value),
            )
            for part, value in (found.parts or {WHOLE: found.value}).items()
        ),
    )
