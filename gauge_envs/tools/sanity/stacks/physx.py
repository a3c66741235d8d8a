"""What stacks on PhysX have in common: settings of the backend `physx` with their origins, and materials of two bodies.

Each body has a material. PhysX combines the materials of two bodies that touch.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from gauge_envs.errors import ParameterError, TargetError
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.sanity.model import (
    FootContact,
    Need,
    TrainingConfiguration,
    range_text,
)
from gauge_envs.tools.sanity.scenario import check_settings
from gauge_envs.tools.sanity.stacks.dialect import Dialect, Kind, number_text
from gauge_envs.tools.sanity.stacks.documents import Table

LEAST_NOTED_M_PER_S = 0.1
"""Smallest bounce threshold that gets a note [m/s]: a fall of half a millimetre."""

LARGEST = {
    "max_linear_velocity_m_per_s": 1e16,
    "max_angular_velocity_rad_per_s": 1e16,
    "max_depenetration_velocity_m_per_s": 1e32,
}
"""Values that stand for no limit."""

SOLVERS = ("PGS", "TGS")
"""Solvers by PhysX's number of them."""


def _solver_name(table: Table, key: str) -> str | None:
    number = table.whole(key)
    if number not in (None, 0, 1):
        raise TargetError(
            f"{table.source}: {table.name(key)} is {number}: give 0 (PGS) or 1 (TGS)"
        )
    return None if number is None else SOLVERS[number]


SOLVER = Kind(_solver_name, lambda name: str(SOLVERS.index(name)))
"""Solver, stated by PhysX's number of it."""


def _radians(table: Table, key: str) -> float | None:
    degrees = table.number(key)
    return None if degrees is None else math.radians(degrees)


DEGREES = Kind(_radians, lambda value: number_text(math.degrees(value)))
"""Angular velocity [rad/s], stated in degrees."""


class PhysxValues:
    """Settings of the backend `physx`, with their origins, and notes on what has no setting.

    Args:
        preset: Preset that supplies what the target does not state.
        dialect: Dialect of the target.
    """

    def __init__(self, preset: str, dialect: Dialect) -> None:
        self.settings: dict[str, Any] = {"preset": preset}
        self.origins = {"preset": "not stated: this package's preset"}
        self.notes: list[str] = []
        self._dialect = dialect

    def take(self, name: str, value: Any, origin: str) -> None:
        """Set a setting; None leaves it to the preset."""
        if value is not None:
            self.settings[name] = (
                min(value, LARGEST[name]) if name in LARGEST else value
            )
            self.origins[name] = origin

    def take_places(self, tables: Mapping[str, Table]) -> None:
        """Set the settings that stand at some places of the target."""
        for name, value, origin in self._dialect.read(tables):
            self.take(name, value, origin)

    def take_articulation(self) -> None:
        """Set the kind of hinges of a robot."""
        self.take("hinges", "articulation", "a robot is an articulation")

    def configuration(
        self,
        table: Table,
        *,
        name: str,
        source: str,
        gravity_m_per_s2: tuple[float, ...] | None,
        frame_skip: int | None,
        foot_contact: FootContact,
        inapplicable: Mapping[Need, str] | None = None,
    ) -> TrainingConfiguration:
        """Return the configuration, after a trial of its settings."""
        self.take_articulation()
        self.take(
            "sustained_restitution",
            any(foot_contact.restitution),
            "the stated restitution",
        )
        try:
            check_settings("physx", self.settings)
        except ParameterError as error:
            raise TargetError(f"{table.source}: {error}") from error
        reasons = dict(inapplicable or {})
        x, y, z = gravity_m_per_s2 or (0.0, 0.0, -GRAVITY_M_PER_S2)
        if not any((x, y, z)):
            reasons[Need.GRAVITY] = "the target has no gravity"
        threshold = self.settings.get("bounce_threshold_m_per_s")
        if threshold is not None and threshold >= LEAST_NOTED_M_PER_S:
            fall_mm = 1e3 * threshold**2 / (2.0 * GRAVITY_M_PER_S2)
            self.notes.append(
                f"what meets the ground more slowly than {threshold:g} m/s, as after a fall of {fall_mm:.3g} mm, does "
                "not bounce, whatever its restitution"
            )
        if step_s := self.settings.get("timestep_s"):
            # A contact stops a body within a step, so its force is m v / h.
            self.notes.append(
                f"a contact force is an impulse over the step: 1 kg that lands at 1 m/s reads {1.0 / step_s:.4g} N at "
                f"{1e3 * step_s:g} ms, twice that at half of it; compare impulses"
            )
        return TrainingConfiguration(
            name=name,
            source=source,
            backend="physx",
            settings=self.settings,
            origins=self.origins,
            frame_skip=frame_skip,
            notes=tuple(self.notes),
            inapplicable=reasons,
            gravity_m_per_s2=None if gravity_m_per_s2 is None else (x, y, z),
            language=self._dialect.name,
            foot_contact=foot_contact,
        )


# --- materials -------------------------------------------------------------------------------------------------------

Range = tuple[float, float]
"""Least and greatest value; equal where training does not randomize."""

COEFFICIENTS = ("static_friction", "dynamic_friction", "restitution")
"""Coefficients of a material."""

AVERAGE = "average"
"""Rule of a material that states none."""

MODES: dict[str, Callable[[float, float], float]] = {
    AVERAGE: lambda a, b: 0.5 * (a + b),
    "min": min,
    "multiply": lambda a, b: a * b,
    "max": max,
}
"""Rules of combination. Of two different ones, PhysX takes the one that comes later here."""


@dataclass(frozen=True, kw_only=True)
class Material:
    """Coefficients of a body before they are combined with those of another one.

    Attributes:
        body: Name of the body: `ground`, `robot`.
        origin: Key that states the material, or what stands in for it.
        ranges: Range of each of the `COEFFICIENTS`.
        friction_mode: Rule of combination of friction.
        restitution_mode: Rule of combination of restitution.
    """

    body: str
    origin: str
    ranges: Mapping[str, Range]
    friction_mode: str = AVERAGE
    restitution_mode: str = AVERAGE

    @classmethod
    def constant(
        cls, body: str, origin: str, *, friction: float, restitution: float = 0.0
    ) -> Material:
        """Return a material with one coefficient of friction that is not randomized."""
        values = zip(COEFFICIENTS, (friction, friction, restitution), strict=True)
        return cls(
            body=body,
            origin=origin,
            ranges={name: (value, value) for name, value in values},
        )

    @property
    def text(self) -> str:
        """Body, friction and origin in words."""
        return (
            f"{self.body} {range_text(self.ranges['dynamic_friction'])} ({self.origin})"
        )


def stated_material(table: Table | None, body: str, default: Material) -> Material:
    """Return a material with the coefficients of a table; what the table lacks is that of `default`."""
    if table is None:
        return replace(default, body=body)
    ranges = dict(default.ranges)
    for key in COEFFICIENTS:
        number = table.number(key)
        if number is not None and not 0.0 <= number < math.inf:
            raise TargetError(
                f"{table.source}: {table.name(key)} is {number:g}: give 0 or more"
            )
        if number is not None:
            ranges[key] = number, number
    return Material(
        body=body,
        origin=table.path,
        ranges=ranges,
        friction_mode=table.choice("friction_combine_mode", MODES)
        or default.friction_mode,
        restitution_mode=table.choice("restitution_combine_mode", MODES)
        or default.restitution_mode,
    )


def drawn_range(table: Table, key: str) -> Range | None:
    """Return the range from which training draws a coefficient; None when it is not stated."""
    ends = table.numbers(key, 2)
    if ends is None:
        return None
    low, high = sorted(ends)
    if not 0.0 <= low <= high < math.inf:
        raise TargetError(
            f"{table.source}: {table.name(key)} is {low:g} to {high:g}: give numbers of 0 or more"
        )
    return low, high


def combined(ground: Material, foot: Material) -> FootContact:
    """Return what a foot meets on the ground."""
    names = list(MODES)
    friction = max(ground.friction_mode, foot.friction_mode, key=names.index)
    restitution = max(ground.restitution_mode, foot.restitution_mode, key=names.index)
    found = []
    for key, mode in zip(COEFFICIENTS, (friction, friction, restitution), strict=True):
        (low, high), (other_low, other_high) = ground.ranges[key], foot.ranges[key]
        found.append((MODES[mode](low, other_low), MODES[mode](high, other_high)))
    return FootContact(
        static_friction=found[0],
        friction=found[1],
        restitution=found[2],
        source=f"{ground.text} and {foot.text}, friction by {friction}"
        + ("" if restitution == friction else f", restitution by {restitution}"),
    )
