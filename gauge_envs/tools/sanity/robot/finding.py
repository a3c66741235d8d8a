"""What is found of a robot for a row, and how it is judged."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from gauge_envs.tools.sanity.model import (
    PartOutcome,
    PhenomenonResult,
    Reality,
    RealityKind,
    Verdict,
)
from gauge_envs.tools.sanity.phenomena.base import facts
from gauge_envs.tools.sanity.robot.mujoco_feet import Standing
from gauge_envs.tools.sanity.robot.robot import Robot

WHOLE = "the robot"
"""Part of a row that judges the robot as a whole."""

NOT_STANDING = "no robot of the model stands on the ground under its own weight"


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What was found of a robot for one row.

    Attributes:
        value: The value; not finite for a motion that diverges.
        parts: Value of each part that the row judges, by its name; empty for the robot as a whole.
        remark: Parts of the model that decide it.
        declined: Why it does not apply; empty when it does.
        unmeasured: Why it applies and was not measured; empty when it was.
        advisory: Why it does not count; empty when it does.
        is_usual: Whether the limit that it breaks says what is usual, in a row whose other limits prove a mistake.
    """

    value: float = 0.0
    parts: Mapping[str, float] = field(default_factory=dict)
    remark: str = ""
    declined: str = ""
    unmeasured: str = ""
    advisory: str = ""
    is_usual: bool = False


class NotApplicableError(Exception):
    """A row does not apply to a robot; the message is the reason."""


class NotMeasuredError(Exception):
    """A row applies to a robot and cannot be measured; the message is the reason."""


ROWS: dict[str, Callable[[Robot], Finding]] = {}
"""Function of each row, whose limits and words stand in `scoring/facts/robot_rows.toml`."""


def row(
    name: str,
) -> Callable[[Callable[[Robot], Finding]], Callable[[Robot], Finding]]:
    """Return a decorator that adds the function of a row."""

    def keep(function: Callable[[Robot], Finding]) -> Callable[[Robot], Finding]:
        def measured(robot: Robot) -> Finding:
            try:
                return function(robot)
            except NotApplicableError as reason:
                return Finding(declined=str(reason))
            except NotMeasuredError as reason:
                return Finding(unmeasured=str(reason))

        def found(robot: Robot) -> Finding:
            if name not in robot.known:
                robot.known[name] = measured(robot)
            known: Finding = robot.known[name]
            return known

        ROWS[name] = found
        return function

    return keep


def standing_of(robot: Robot) -> Standing:
    """Return the robot that stands; rows that need one do not apply to a model without."""
    if robot.standing is None:
        raise NotApplicableError(NOT_STANDING)
    return robot.standing


def limits_of(name: str) -> tuple[float, float]:
    """Return the limits of a row, in its unit."""
    low, high = facts("robot_rows")[name]["interval"]
    return low, high


def judged_row(name: str, found: Finding) -> PhenomenonResult:
    """Return the row of a finding: visible beyond its limits by the ratio of other rows, wrong beyond that.

    What breaks a limit that says what is usual, and not what is possible, is visible at most.
    """
    known = facts("robot_rows")[name]
    (low, high), value = known["interval"], found.value

    def judged(one: float) -> Verdict:
        verdict = Verdict.of(_ratio(one, low, high))
        is_usual = found.is_usual or known["proof"] == "usual"
        return Verdict.VISIBLE if is_usual and verdict.is_off else verdict

    verdict = judged(value)
    missing = found.declined or found.unmeasured
    is_off = verdict is not Verdict.INSIDE and not missing
    return PhenomenonResult(
        phenomenon=name,
        title=known["title"],
        unit=known["unit"],
        reality=Reality(
            kind=RealityKind.LAW,
            value=0.5 * (low + high),
            tolerance=0.5 * (high - low),
            source=known["source"],
            rationale=known["consequence"],
            limits=known["limits"],
        ),
        configured=None if missing or not np.isfinite(value) else float(value),
        verdict=Verdict.DECLINED if missing else verdict,
        remark=missing or found.remark,
        applies=not found.declined,
        consequence=known["consequence"] if is_off else "",
        advisory=found.advisory,
        parts=()
        if missing
        else tuple(
            PartOutcome(
                name=part,
                value=float(one) if np.isfinite(one) else None,
                verdict=judged(one),
                deviation=_ratio(one, low, high),
            )
            for part, one in (found.parts or {WHOLE: value}).items()
        ),
    )


def _ratio(value: float, low: float, high: float) -> float:
    """Return the ratio by which a value is beyond its limits; 1 between them, infinite for another sign."""
    if value < min(low, 0.0) or not np.isfinite(value):
        return np.inf
    ratio = float(max(low / max(value, 1e-12), value / high))
    return ratio if ratio > 1.0 + 1e-9 else 1.0


def body_name(robot: Robot, body: int) -> str:
    """Return the name of a body, or its number."""
    return robot.model.body(body).name or f"body {body}"


def joint_name(robot: Robot, dof: int) -> str:
    """Return the name of a degree of freedom's joint, or its number."""
    return name_of(robot, int(robot.model.dof_jntid[dof]))


def name_of(robot: Robot, joint: int) -> str:
    """Return the name of a joint, or its number."""
    return robot.model.joint(joint).name or f"joint {joint}"


def by_joint(robot: Robot, values: Mapping[int, float]) -> dict[str, float]:
    """Return values of degrees of freedom by the names of their joints."""
    return {joint_name(robot, dof): float(value) for dof, value in values.items()}
