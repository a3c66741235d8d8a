"""Compare two training configurations in physical terms: where a policy was trained, and where it runs.

Example:
    >>> from gauge_envs.tools.sanity import compare
    >>> comparison = compare("mujoco", "mujoco", only=["gravity"])
    >>> [row.id for row in comparison.rows][:2]
    ['step', 'gravity']
"""

import math
import re
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np

from gauge_envs.files import versions
from gauge_envs.runs.rollout import DeclinedError
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.geometry import length_of
from gauge_envs.tools.sanity.measure import (
    Measurements,
    TimeLimitError,
    subject_of,
)
from gauge_envs.tools.sanity.model import (
    VISIBLE_WITHIN,
    Need,
    TrainingConfiguration,
    plain_report,
)
from gauge_envs.tools.sanity.phenomena import (
    CONTROL_ID,
    GRAVITY_ID,
    ROBOT_IDS,
    STATED_IDS,
    matches,
    patterns_of,
    phenomenon,
    selection,
)
from gauge_envs.tools.sanity.phenomena.base import Phenomenon
from gauge_envs.tools.sanity.robot.finding import body_name
from gauge_envs.tools.sanity.robot.mujoco_feet import joints_of
from gauge_envs.tools.sanity.robot.quantities import QUANTITIES, quantities
from gauge_envs.tools.sanity.robot.robot import Robot
from gauge_envs.tools.sanity.stacks import configuration
from gauge_envs.tools.sanity.target_checks import (
    CONTROL_ROW,
    GRAVITY_ROW,
    control_s,
    robot_row,
)

SLOPE_DEG = 30.0
"""Slope of the boards on which cubes slide [degrees]."""

STEP_ID = "step"
"""Row on the step of the engine."""

STEP_RATIO = 0.01
"""Relative difference of two steps that counts as none."""

ROBOT_RATIO = 0.05
"""Relative difference of two values of a row on the robot that counts as none."""

ROBOT_LEAST = 0.01
"""The same in widths of the row's interval, for rows whose interval begins at 0."""

SIMPLE_EXPRESSION = re.compile(
    r"(?:[\w.|\[\]-]|\.\*|\((?:[\w.|\[\]-]|\.\*)*\)(?![*+?{]))*"
)
"""Expressions of joint names without nested repetition, as `.*_(hip|knee)_joint`."""

MOST_STARS = 4

NO_MODEL = "the target's own model is not read"
NO_ACTION = "the target does not state how many steps an action takes"

FRICTION_SLIDES = {"slide-wood": "straight", "slide-turned": "turned by 45 degrees"}
"""Slides that show the friction that a foot meets, and their direction."""

REBOUND = "rebound-slow"
"""Rebound that shows the restitution that a foot meets: feet land at 2 m/s at most."""


class Change(StrEnum):
    """Size of the difference between two configurations."""

    NONE = "same"
    """At most the half-width of the interval of reality: no real trial could resolve it."""
    VISIBLE = "visible"
    """At most 2.5 half-widths."""
    LARGE = "large"
    """More, or one of the two fails."""
    UNKNOWN = "unknown"
    """One of the two was not measured."""
    NEITHER = "not compared"
    """Neither of the two has, or states, what the row compares."""


@dataclass(frozen=True, kw_only=True)
class PartChange:
    """A link, joint or motor that differs.

    Attributes:
        name: Its name.
        trained: Value where the policy was trained; None without such a part, or without a limit.
        deployed: Value where it runs.
    """

    name: str
    trained: float | None
    deployed: float | None


@dataclass(frozen=True, kw_only=True)
class ChangeRow:
    """One quantity in both configurations.

    Attributes:
        id: Id of the phenomenon or quantity, or `step`, `gravity`, `foot-straight`, `foot-turned`, `foot-restitution`.
        title: Title.
        unit: Unit of both values; `1` for a pure number.
        trained: Value where the policy was trained; None when unknown.
        deployed: Value where it runs; None when unknown.
        tolerance: Difference up to which both count as the same.
        change: Size of the difference.
        remark: Why a value is unknown or failed; empty otherwise.
        parts: Links, joints or motors that differ, the largest difference first; the values are those of the first.
    """

    id: str
    title: str
    unit: str
    trained: float | None
    deployed: float | None
    tolerance: float
    change: Change
    remark: str = ""
    parts: tuple[PartChange, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Two configurations against each other.

    Attributes:
        trained: Configuration in which the policy was trained.
        deployed: Configuration in which it runs.
        rows: The quantities; what is not simulated comes first.
        versions: Versions of the packages.
        wall_s: Time that the comparison took [s].
    """

    trained: TrainingConfiguration
    deployed: TrainingConfiguration
    rows: tuple[ChangeRow, ...]
    versions: Mapping[str, str]
    wall_s: float

    @property
    def changed(self) -> tuple[ChangeRow, ...]:
        """The rows that change: large changes first, of these what is stated, then by half-widths, to two digits."""
        order = {Change.LARGE: 0, Change.VISIBLE: 1}
        stated = (STEP_ID, GRAVITY_ID, CONTROL_ID, *QUANTITIES)

        def key(row: ChangeRow) -> tuple[int, bool, float]:
            return order[row.change], row.id not in stated, -float(f"{_size(row):.2g}")

        return tuple(sorted((r for r in self.rows if r.change in order), key=key))

    def to_dict(self) -> dict[str, Any]:
        """Return all attributes, JSON-ready."""
        return plain_report(self, "trained", "deployed")


def compare(
    trained: Any,
    deployed: Any,
    *,
    only: Sequence[str] = (),
    include_deformables: bool = False,
    time_limit_s: float | None = None,
) -> Comparison:
    """Return what changes in physical terms between two configurations, each on its own engine.

    Args:
        trained: A `TrainingConfiguration`, or a target of `gauge_envs.tools.sanity.configuration`.
        deployed: The other one.
        only: Ids of phenomena, of rows on the robot and of what its model states (`mass`, `kp`), or patterns such as
            `creep-*`; all when empty.
        include_deformables: Whether to measure phenomena of deformable bodies.
        time_limit_s: Time after which no simulation starts any more [s]; None for no limit.
    """
    started = time.perf_counter()
    stated = [name for name in QUANTITIES if not only or matches(name, only)]
    others = [
        pattern
        for pattern in patterns_of(only)
        if not any(matches(name, [pattern]) for name in (STEP_ID, *stated))
    ]
    chosen: tuple[str, ...] = ()
    if others or not only:
        chosen = selection(others, include_deformables=include_deformables)
    targets = [configuration(target) for target in (trained, deployed)]
    with ExitStack() as stack:
        known = {
            name: stack.enter_context(
                closing(Measurements(name, time_limit_s=time_limit_s))
            )
            for name in dict.fromkeys(target.backend for target in targets)
        }
        sides = [_Side(target, known[target.backend]) for target in targets]
        rows = [_step_row(sides)]
        if GRAVITY_ID in chosen:
            rows.append(_gravity_row(sides))
        if CONTROL_ID in chosen:
            rows.append(_control_row(targets))
        rows += _quantity_rows(targets, stated)
        rows += [_robot_row(name, targets) for name in chosen if name in ROBOT_IDS]
        simulated = [phenomenon(name) for name in chosen if name not in STATED_IDS]
        measured = {one.id: _measured_row(one, sides) for one in simulated}
    found: dict[str, str] = {}
    for one in known.values():
        found |= one.versions
    return Comparison(
        trained=targets[0],
        deployed=targets[1],
        rows=(
            *rows,
            *_friction_rows(sides, measured),
            *_restitution_rows(sides, measured),
            *measured.values(),
        ),
        versions={**found, **versions()},
        wall_s=time.perf_counter() - started,
    )


class _Side:
    """One configuration and the measurements on its engine."""

    def __init__(
        self, configuration: TrainingConfiguration, measurements: Measurements
    ) -> None:
        self.configuration = configuration
        self._measurements = measurements

    def value(self, phenomenon: Phenomenon) -> tuple[float | None, str]:
        """Return the value with the worst set of contact constants, and a remark."""
        subject = subject_of(self._measurements, self.configuration, phenomenon)
        if subject.inapplicable:
            return None, subject.inapplicable
        try:
            worst = subject.worst()
        except TimeLimitError:
            return None, "not measured within the time limit"
        return worst.value, worst.remark

    def step_s(self) -> float | None:
        """Return the step for a cube on a board [s]; None when the backend declines the scene."""
        scenario = phenomenon("slide-wood").scenario
        try:
            force = self._measurements.in_force(
                scenario, next(iter(self.configuration.contact_sets.values()))
            )
        except DeclinedError:
            return None
        step = force.get("timestep_s")
        return None if step is None else float(step)

    def gravity(self) -> tuple[float, np.ndarray]:
        """Return the size of gravity, and its components along and across the ground, shape [2]."""
        gravity = self.configuration.gravity_m_per_s2
        if Need.GRAVITY in self.configuration.inapplicable:
            return 0.0, np.zeros(2)
        if gravity is None:
            return GRAVITY_M_PER_S2, np.array([-GRAVITY_M_PER_S2, 0.0])
        vector, up = np.asarray(gravity), np.asarray(self.configuration.up)
        along = float(vector @ up)
        return length_of(vector), np.array([along, length_of(vector - along * up)])

    def stated_friction(self) -> float | None:
        """Return the sliding friction of a foot on the ground; None when the target states none."""
        if self.configuration.foot_contact is not None:
            return self.configuration.foot_contact.mean_friction
        for group in self.configuration.contact_groups:
            if group.is_used:
                return float(group.constants["friction"][0])
        return None

    def restitution(self, rebound: float | None, real: float) -> float | None:
        """Return the restitution that a foot meets, by the rebounds of a ball and of a real one; None if unknown."""
        foot = self.configuration.foot_contact
        if foot is None:
            return None
        if not any(foot.restitution):
            return 0.0
        return None if rebound is None else foot.mean_restitution * rebound / real


# --- rows ------------------------------------------------------------------------------------------------------------


def _row(
    name: str,
    title: str,
    unit: str,
    values: Sequence[float | None],
    tolerance: float,
    remarks: Sequence[str] = (),
) -> ChangeRow:
    """Return the row on a value where the policy was trained, and where it runs."""
    trained, deployed = values
    shown = [
        f"{where}: {text}"
        for where, text in zip(("trained", "deployed"), remarks, strict=False)
        if text
    ]
    return ChangeRow(
        id=name,
        title=title,
        unit=unit,
        trained=trained,
        deployed=deployed,
        tolerance=tolerance,
        change=_change(trained, deployed, tolerance),
        remark="; ".join(shown),
    )


def _measured_row(one: Phenomenon, sides: Sequence[_Side]) -> ChangeRow:
    values, remarks = zip(*(side.value(one) for side in sides), strict=True)
    return _row(one.id, one.title, one.unit, values, one.reality.tolerance, remarks)


def _step_row(sides: Sequence[_Side]) -> ChangeRow:
    """Return the row on the step. A difference is visible at most, since it may do no harm."""
    steps = [side.step_s() for side in sides]
    row = _row(
        STEP_ID,
        "step of the engine",
        "s",
        steps,
        STEP_RATIO * max(abs(step or 0.0) for step in steps),
    )
    return replace(row, change=Change.VISIBLE) if row.change is Change.LARGE else row


def _gravity_row(sides: Sequence[_Side]) -> ChangeRow:
    """Return the row on gravity, by the length of the difference of both."""
    (trained, first), (deployed, second) = (side.gravity() for side in sides)
    apart = length_of(first - second)
    tolerance, both = GRAVITY_ROW.reality.tolerance, (trained, deployed)
    differs = apart > abs(trained - deployed) + tolerance
    remark = "the directions differ" if differs else ""
    row = _row(GRAVITY_ID, GRAVITY_ROW.title, GRAVITY_ROW.unit, both, tolerance)
    return replace(row, change=_change(0.0, apart, tolerance), remark=remark)


def _control_row(targets: Sequence[TrainingConfiguration]) -> ChangeRow:
    """Return the row on the time of one action, of which policies learn how far the robot moves."""
    actions_s = [control_s(target) for target in targets]
    values_ms = [None if one is None else 1e3 * one for one in actions_s]
    remarks = [NO_ACTION if one is None else "" for one in values_ms]
    tolerance_ms = STEP_RATIO * max(one or 0.0 for one in values_ms)
    row = _row(CONTROL_ID, CONTROL_ROW.title, "ms", values_ms, tolerance_ms, remarks)
    return row if any(values_ms) else _not_compared(row, remarks)


def _robot_row(name: str, targets: Sequence[TrainingConfiguration]) -> ChangeRow:
    """Return the row on the robot, whose values are the same within a ratio, or a small share of the interval."""
    both = [robot_row(name, target.robot) for target in targets]
    reality = both[0].reality
    low, high = reality.value - reality.tolerance, reality.value + reality.tolerance
    values = [one.configured for one in both]
    tolerance = ROBOT_RATIO * max(abs(value or 0.0) for value in values)
    if low <= 1e-9 * high:
        tolerance = max(tolerance, ROBOT_LEAST * high)
    remarks = [one.remark for one in both]
    row = _row(name, both[0].title, both[0].unit, values, tolerance, remarks)
    if not any(one.applies for one in both):
        return _not_compared(row, remarks)
    if row.change is Change.UNKNOWN and any(one.verdict.is_off for one in both):
        # One of the two fails, as by a motion that diverges.
        return replace(row, change=Change.LARGE)
    return replace(row, remark="") if row.change is Change.NONE else row


def _quantity_rows(
    targets: Sequence[TrainingConfiguration], names: Sequence[str]
) -> list[ChangeRow]:
    """Return the rows on what both models state of each link, joint and motor."""
    known = _known_quantities(targets)
    rows = []
    for name in names:
        quantity = QUANTITIES[name]
        reasons = [NO_MODEL if one is None else "" for one in known]
        neither = (None, None)
        row = _row(
            name, quantity.title, quantity.unit, neither, quantity.least, reasons
        )
        stating = [one is not None and name in one for one in known]
        if all(stating):
            trained, deployed = (one[name] for one in known if one is not None)
            row = _parts_row(row, trained, deployed, quantity.ratio)
        elif known == [None, None]:
            row = _not_compared(row, [NO_MODEL])
        elif None not in known:
            row = _not_compared(row, ["a file without a model does not state it"])
        rows.append(row)
    return rows


def _known_quantities(
    targets: Sequence[TrainingConfiguration],
) -> list[dict[str, dict[str, float]] | None]:
    """Return what both targets state of their parts; expressions get the names of joints of the other's model."""
    known = [
        None if target.robot is None else _with_objects(target.robot)
        for target in targets
    ]
    joints = next((list(one["damping"]) for one in known if one is not None), None)
    return [
        {name: _of_names(several, joints) for name, several in target.stated.items()}
        if one is None and target.stated
        else one
        for one, target in zip(known, targets, strict=True)
    ]


def _with_objects(robot: Robot) -> dict[str, dict[str, float]]:
    """Return the quantities of a robot, with the masses of the free bodies beside it."""
    model = robot.model
    free = set(model.jnt_bodyid[joints_of(model, "FREE")].tolist())
    objects = free - set(robot.bodies)
    masses = {body_name(robot, body): float(model.body_mass[body]) for body in objects}
    known = quantities(robot)
    return {**known, "mass": masses | known["mass"]}


def _of_names(
    values: Mapping[str, float], joints: Sequence[str] | None
) -> dict[str, float]:
    """Return values by the names of joints that regular expressions match; by the expressions without names."""
    if joints is None:
        return dict(values)
    return {
        joint: value
        for expression, value in values.items()
        for joint in joints
        if _matches(expression, joint)
    }


def _matches(expression: str, joint: str) -> bool:
    """Return whether an expression of Isaac Lab matches a name; those that could take long are plain names."""
    is_simple = SIMPLE_EXPRESSION.fullmatch(expression) is not None
    if not is_simple or expression.count("*") > MOST_STARS:
        return expression == joint
    try:
        return re.fullmatch(expression, joint) is not None
    except re.error:
        return False


def _parts_row(
    row: ChangeRow,
    trained: Mapping[str, float],
    deployed: Mapping[str, float],
    ratio: float,
) -> ChangeRow:
    """Return a row with the part that differs most, and with all that differ or that one of the two does not have."""
    sizes: dict[str, float] = {}
    tolerances: dict[str, float] = {}
    for part in dict.fromkeys((*trained, *deployed)):
        both = (trained.get(part, math.nan), deployed.get(part, math.nan))
        largest = max((abs(one) for one in both if math.isfinite(one)), default=0.0)
        tolerances[part] = max(row.tolerance, ratio * largest)
        is_same = both[0] == both[1]
        difference = 0.0 if is_same else abs(both[0] - both[1])
        size = difference / tolerances[part] if tolerances[part] else math.inf
        # A part that one of the two does not have, and a limit that one of the two does not have, is a large change.
        sizes[part] = 0.0 if is_same else size if math.isfinite(size) else math.inf
    if not sizes:
        return _not_compared(row, ["no part of either robot has it"])
    order = sorted(sizes, key=lambda part: -sizes[part])
    worst = order[0]
    changed = [part for part in order if sizes[part] > 1.0]
    values = {
        part: PartChange(
            name=part,
            trained=_finite(trained.get(part)),
            deployed=_finite(deployed.get(part)),
        )
        for part in (worst, *changed)
    }
    return replace(
        row,
        trained=values[worst].trained,
        deployed=values[worst].deployed,
        tolerance=tolerances[worst],
        change=_change(0.0, sizes[worst], 1.0),
        parts=tuple(values[part] for part in changed),
    )


def _not_compared(row: ChangeRow, reasons: Sequence[str]) -> ChangeRow:
    """Return a row that neither of the two has, with the reasons."""
    text = "; ".join(dict.fromkeys(reasons))
    return replace(row, change=Change.NEITHER, remark=text)


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else value


def _friction_rows(
    sides: Sequence[_Side], rows: Mapping[str, ChangeRow]
) -> list[ChangeRow]:
    """Return the friction that a foot meets: the stated coefficient times what a cube meets of its own."""
    found: list[ChangeRow] = []
    stated = [side.stated_friction() for side in sides]
    has_both = None not in stated
    known = [1.0 if mu is None or not has_both else mu for mu in stated]
    feet = [side.configuration.foot_contact for side in sides]
    for name, direction in FRICTION_SLIDES.items():
        if name not in rows:
            continue
        slide = phenomenon(name)
        real = slide_friction(slide.reality.value)
        measured = (rows[name].trained, rows[name].deployed)
        values = [
            None if a is None else slide_friction(a) / real * mu
            for a, mu in zip(measured, known, strict=True)
        ]
        width = slide.reality.tolerance / _normal_m_per_s2()
        tolerance = width / real * max(known)
        title = f"friction that a {'foot' if has_both else 'cube'} meets, {direction}"
        title += "" if has_both else ", over the stated one"
        remarks = (
            ["" if foot is None else foot.text for foot in feet]
            if has_both and not found
            else []
        )
        name = f"foot-{direction.split(' ')[0]}"
        found.append(_row(name, title, "1", values, tolerance, remarks))
    return found


def _restitution_rows(
    sides: Sequence[_Side], rows: Mapping[str, ChangeRow]
) -> list[ChangeRow]:
    """Return the restitution that a foot meets: the stated one times what a ball keeps of its own."""
    row = rows.get(REBOUND)
    if row is None:
        return []
    reality, measured = phenomenon(REBOUND).reality, (row.trained, row.deployed)
    values = [
        side.restitution(value, reality.value)
        for side, value in zip(sides, measured, strict=True)
    ]
    if None in values:
        return []
    title = "restitution that a foot meets"
    return [_row("foot-restitution", title, "1", values, reality.tolerance)]


def _change(trained: float | None, deployed: float | None, tolerance: float) -> Change:
    if trained is None or deployed is None:
        return Change.UNKNOWN
    difference = abs(trained - deployed)
    if difference <= tolerance:
        return Change.NONE
    return Change.VISIBLE if difference <= VISIBLE_WITHIN * tolerance else Change.LARGE


def _size(row: ChangeRow) -> float:
    if row.trained is None or row.deployed is None or not row.tolerance:
        return math.inf
    return abs(row.trained - row.deployed) / row.tolerance


def slide_friction(acceleration_m_per_s2: float) -> float:
    """Return the friction with which a cube slides with an acceleration on the slope of `SLOPE_DEG`."""
    slope = math.tan(math.radians(SLOPE_DEG))
    return slope - acceleration_m_per_s2 / _normal_m_per_s2()


def _normal_m_per_s2() -> float:
    """Return the part of gravity that presses a cube on the slope."""
    return GRAVITY_M_PER_S2 * math.cos(math.radians(SLOPE_DEG))
