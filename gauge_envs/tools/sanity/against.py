"""Compare two training configurations in physical terms: where a policy was trained, and where it runs.

Example:
    >>> from gauge_envs.tools.sanity.against import compare
    >>> comparison = compare("mujoco", "mujoco", only=["gravity"])
    >>> [row.id for row in comparison.rows][:2]
    ['step', 'gravity']
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from gauge_envs.files import json_ready, versions
from gauge_envs.runs.rollout import DeclinedError
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.sanity.engine import Engine, simulation_limit_s
from gauge_envs.tools.sanity.gravity import GRAVITY_ID, GRAVITY_REALITY, GRAVITY_TITLE
from gauge_envs.tools.sanity.measure import Measurements, TimeLimitError
from gauge_envs.tools.sanity.model import VISIBLE_WITHIN, Need, TrainingConfiguration
from gauge_envs.tools.sanity.phenomena import Phenomenon, phenomena
from gauge_envs.tools.sanity.selection import selection
from gauge_envs.tools.sanity.subject import subject_of, worst_of

SLOPE_DEG = 30.0
"""Slope of the boards on which cubes slide [degrees]."""

STEP_RATIO = 0.01
"""Relative difference of two steps that counts as none."""

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


@dataclass(frozen=True, kw_only=True)
class ChangeRow:
    """One quantity in both configurations.

    Attributes:
        id: Id of the phenomenon, or `step`, `gravity`, `foot-straight`, `foot-turned`, `foot-restitution`.
        title: Title.
        unit: Unit of both values; `1` for a pure number.
        trained: Value where the policy was trained; None when unknown.
        deployed: Value where it runs; None when unknown.
        tolerance: Difference up to which both count as the same.
        change: Size of the difference.
        remark: Why a value is unknown or failed; empty otherwise.
    """

    id: str
    title: str
    unit: str
    trained: float | None
    deployed: float | None
    tolerance: float
    change: Change
    remark: str = ""


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
        """The rows that change: a large change first, then by half-widths of the interval, to two digits."""
        changed = (row for row in self.rows if row.change in (Change.VISIBLE, Change.LARGE))
        return tuple(sorted(changed, key=lambda row: (row.change is not Change.LARGE, -float(f"{_size(row):.2g}"))))

    @property
    def largest(self) -> ChangeRow | None:
        """The row that changes most; None for no change."""
        return next(iter(self.changed), None)

    def to_dict(self) -> dict[str, Any]:
        """Return all attributes, JSON-ready."""
        values: dict[str, Any] = json_ready(asdict(self))
        return values


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
        only: Ids of phenomena or patterns such as `creep-*`; all when empty.
        include_deformables: Whether to measure phenomena of deformable bodies.
        time_limit_s: Time after which no simulation starts any more [s]; None for no limit.
    """
    from gauge_envs.tools.sanity.target import configuration

    started = time.perf_counter()
    limit_s = math.inf if time_limit_s is None else time_limit_s
    chosen = selection(only, include_deformables=include_deformables)
    targets = [configuration(target) for target in (trained, deployed)]
    with ExitStack() as stack:
        names = dict.fromkeys(target.backend for target in targets)
        limit = simulation_limit_s(time_limit_s)
        engines = {name: stack.enter_context(Engine(name, limit)) for name in names}
        known = {name: Measurements(engine, time_limit_s=limit_s) for name, engine in engines.items()}
        one, other = (_Side(target, known[target.backend]) for target in targets)
        rows = [_facts_row("step", "step of the engine", "s", one.step_s(), other.step_s(), ratio=STEP_RATIO)]
        if GRAVITY_ID in chosen:
            rows.append(_gravity_row(one.configuration, other.configuration))
        measured = [_row(p, one, other) for p in phenomena(include_deformables=True) if p.id in chosen]
        known_rows = {row.id: row for row in measured}
    found = {name: version for engine in engines.values() for name, version in engine.versions.items()}
    return Comparison(
        trained=one.configuration,
        deployed=other.configuration,
        rows=(*rows, *_foot_rows(one, other, known_rows), *_rebound_rows(one, other, known_rows), *measured),
        versions={**found, **versions()},
        wall_s=time.perf_counter() - started,
    )


class _Side:
    """One configuration and the measurements on its engine."""

    def __init__(self, configuration: TrainingConfiguration, measurements: Measurements) -> None:
        self.configuration = configuration
        self._measurements = measurements

    def value(self, phenomenon: Phenomenon) -> tuple[float | None, str]:
        """Return the value with the worst set of contact constants, and a remark."""
        subject = subject_of(self._measurements, self.configuration, phenomenon)
        if subject.inapplicable:
            return None, subject.inapplicable
        try:
            _, worst = worst_of(subject.measured(self._measurements))
        except TimeLimitError:
            return None, "not measured within the time limit"
        return worst.value, worst.remark

    def step_s(self) -> float | None:
        """Return the step for a cube on a board [s]; None when the backend declines the scene."""
        scenario = phenomena(["slide-wood"])[0].scenario
        try:
            force = self._measurements.in_force(scenario, next(iter(self.configuration.contact_sets.values())))
        except DeclinedError:
            return None
        step = force.get("timestep_s")
        return None if step is None else float(step)

    def stated_friction(self) -> float | None:
        """Return the sliding friction of a foot on the ground; None when the target states none."""
        if self.configuration.foot_contact is not None:
            return self.configuration.foot_contact.mean_friction
        used = [group.constants for group in self.configuration.contact_groups if group.is_used]
        return float(used[0]["friction"][0]) if used else None

    def foot_remark(self) -> str:
        """Return the materials that a foot meets; empty when the target states none."""
        return "" if self.configuration.foot_contact is None else self.configuration.foot_contact.text

    def restitution(self, row: ChangeRow, value: float | None) -> float | None:
        """Return the restitution that a foot meets, from the rebound of a ball; None when unknown."""
        foot = self.configuration.foot_contact
        if foot is None:
            return None
        if not any(foot.restitution):
            return 0.0
        (phenomenon,) = phenomena([row.id])
        return None if value is None else foot.mean_restitution * value / phenomenon.reality.value


def _row(phenomenon: Phenomenon, one: _Side, other: _Side) -> ChangeRow:
    (trained, first), (deployed, second) = one.value(phenomenon), other.value(phenomenon)
    tolerance = phenomenon.reality.tolerance
    return ChangeRow(
        id=phenomenon.id,
        title=phenomenon.title,
        unit=phenomenon.unit,
        trained=trained,
        deployed=deployed,
        tolerance=tolerance,
        change=_change(trained, deployed, tolerance),
        remark=_both(first, second),
    )


def _both(first: str, second: str) -> str:
    """Return the remarks of both sides in one line."""
    return "; ".join([f"trained: {first}"] * bool(first) + [f"deployed: {second}"] * bool(second))


def _change(trained: float | None, deployed: float | None, tolerance: float) -> Change:
    if trained is None or deployed is None:
        return Change.UNKNOWN
    difference = abs(trained - deployed)
    if difference <= tolerance:
        return Change.NONE
    return Change.VISIBLE if difference <= VISIBLE_WITHIN * tolerance else Change.LARGE


def _size(row: ChangeRow) -> float:
    assert row.trained is not None and row.deployed is not None, "only known rows change"
    return abs(row.trained - row.deployed) / row.tolerance


def _facts_row(
    name: str, title: str, unit: str, trained: float | None, deployed: float | None, *, ratio: float
) -> ChangeRow:
    """Return a row on a stated number, with a relative tolerance. A difference is visible, since it may do no harm."""
    tolerance = ratio * max(abs(trained or 0.0), abs(deployed or 0.0))
    change = _change(trained, deployed, tolerance)
    return ChangeRow(
        id=name,
        title=title,
        unit=unit,
        trained=trained,
        deployed=deployed,
        tolerance=tolerance,
        change=Change.VISIBLE if change is Change.LARGE else change,
    )


def _gravity_row(one: TrainingConfiguration, other: TrainingConfiguration) -> ChangeRow:
    (trained, first), (deployed, second) = _gravity(one), _gravity(other)
    tilted = float(np.linalg.norm(first - second))
    tolerance = GRAVITY_REALITY.tolerance
    return ChangeRow(
        id=GRAVITY_ID,
        title=GRAVITY_TITLE,
        unit="m/s^2",
        trained=trained,
        deployed=deployed,
        tolerance=tolerance,
        change=_change(0.0, tilted, tolerance),
        remark="the directions differ" if tilted > abs(trained - deployed) + tolerance else "",
    )


def _gravity(configuration: TrainingConfiguration) -> tuple[float, np.ndarray]:
    """Return the size of gravity, and its components along and across the ground, shape [2]."""
    if Need.GRAVITY in configuration.inapplicable:
        return 0.0, np.zeros(2)
    if configuration.gravity_m_per_s2 is None:
        return GRAVITY_M_PER_S2, np.array([-GRAVITY_M_PER_S2, 0.0])
    vector, up = np.asarray(configuration.gravity_m_per_s2), np.asarray(configuration.up)
    along = float(vector @ up)
    return float(np.linalg.norm(vector)), np.array([along, float(np.linalg.norm(vector - along * up))])


def _foot_rows(one: _Side, other: _Side, rows: Mapping[str, ChangeRow]) -> list[ChangeRow]:
    """Return the friction that a foot meets: the stated coefficient times what a cube meets of its own."""
    found: list[ChangeRow] = []
    for name, direction in FRICTION_SLIDES.items():
        if name not in rows:
            continue
        (slide,) = phenomena([name])
        real = _friction(slide.reality.value)
        shares = [None if a is None else _friction(a) / real for a in (rows[name].trained, rows[name].deployed)]
        stated = [one.stated_friction(), other.stated_friction()]
        has_both = None not in stated
        trained, deployed = (
            None if share is None else share * (mu if has_both and mu is not None else 1.0)
            for share, mu in zip(shares, stated, strict=True)
        )
        tolerance = slide.reality.tolerance / (GRAVITY_M_PER_S2 * math.cos(math.radians(SLOPE_DEG))) / real
        tolerance *= max(mu for mu in stated if mu is not None) if has_both else 1.0
        found.append(
            ChangeRow(
                id=f"foot-{direction.split(' ')[0]}",
                title=f"friction that a {'foot' if has_both else 'cube'} meets, {direction}"
                + ("" if has_both else ", over the stated one"),
                unit="1",
                trained=trained,
                deployed=deployed,
                tolerance=tolerance,
                change=_change(trained, deployed, tolerance),
                remark=_both(one.foot_remark(), other.foot_remark()) if has_both and not found else "",
            )
        )
    return found


def _rebound_rows(one: _Side, other: _Side, rows: Mapping[str, ChangeRow]) -> list[ChangeRow]:
    """Return the restitution that a foot meets: the stated one times what a ball keeps of its own."""
    row = rows.get(REBOUND)
    if row is None:
        return []
    trained, deployed = one.restitution(row, row.trained), other.restitution(row, row.deployed)
    if trained is None or deployed is None:
        return []
    (phenomenon,) = phenomena([REBOUND])
    return [
        ChangeRow(
            id="foot-restitution",
            title="restitution that a foot meets",
            unit="1",
            trained=trained,
            deployed=deployed,
            tolerance=phenomenon.reality.tolerance,
            change=_change(trained, deployed, phenomenon.reality.tolerance),
        )
    ]


def _friction(acceleration_m_per_s2: float) -> float:
    """Return the friction with which a cube slides with an acceleration on the slope."""
    slope = math.radians(SLOPE_DEG)
    return math.tan(slope) - acceleration_m_per_s2 / (GRAVITY_M_PER_S2 * math.cos(slope))
