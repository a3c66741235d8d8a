"""What stacks on PhysX have in common: settings of the backend `physx` with their origins, and materials of two bodies.

Each body has a material. PhysX combines the materials of two bodies that touch.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
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
from gauge_envs.tools.sanity.stacks.dialect import (
    Dialect,
    Table,
)

LEAST_NOTED_M_PER_S = 0.1
"""Smallest bounce threshold that gets a note [m/s]: a fall of half a millimetre."""

LARGEST = {
    "max_linear_velocity_m_per_s": 1e16,
    "max_angular_velocity_rad_per_s": 1e16,
    "max_depenetration_velocity_m_per_s": 1e32,
}
"""Values that stand for no limit."""


@dataclass(kw_only=True)
class PhysxValues:
    """Settings of the backend `physx`, with their origins, and notes on what has no setting.

    Attributes:
        dialect: Dialect of the target.
        settings: Settings; the preset supplies what the target does not state.
        origins: Origin of each setting.
        notes: What is not carried over.
    """

    dialect: Dialect
    settings: dict[str, Any]
    origins: dict[str, str] = field(
        default_factory=lambda: {"preset": "not stated: this package's preset"}
    )
    notes: list[str] = field(default_factory=list)

    def take(self, name: str, value: Any, origin: str) -> None:
        """Set a setting; None leaves it to the preset."""
        if value is not None:
            limit = LARGEST.get(name)
            self.settings[name] = value if limit is None else min(value, limit)
            self.origins[name] = origin

    def take_places(self, tables: Mapping[str, Table]) -> None:
        """Set the settings that stand at some places of the target."""
        for name, value, origin in self.dialect.read(tables):
            self.take(name, value, origin)

    def configuration(
        self,
        table: Table,
        *,
        source: str,
        gravity_m_per_s2: tuple[float, ...] | None,
        frame_skip: int | None,
        foot_contact: FootContact,
        inapplicable: Mapping[Need, str],
    ) -> TrainingConfiguration:
        """Return the configuration, after a trial of its settings."""
        self.take("hinges", "articulation", "a robot is an articulation")
        bounces = any(foot_contact.restitution)
        self.take("sustained_restitution", bounces, "the stated restitution")
        try:
            check_settings("physx", self.settings)
        except ParameterError as error:
            keys = [o for n, o in self.origins.items() if f"'{n}'" in str(error)]
            raise TargetError(f"{table.source}: {', '.join(keys)}: {error}") from error
        x, y, z = gravity_m_per_s2 or (0.0, 0.0, -GRAVITY_M_PER_S2)
        reasons = dict(inapplicable)
        if not any((x, y, z)):
            reasons[Need.GRAVITY] = "the target has no gravity"
        threshold = self.settings.get("bounce_threshold_m_per_s") or 0.0
        if threshold >= LEAST_NOTED_M_PER_S:
            fall_mm = 1e3 * threshold**2 / (2.0 * GRAVITY_M_PER_S2)
            self.notes.append(
                f"what meets the ground more slowly than {threshold:g} m/s, as after a fall of {fall_mm:.3g} mm, does "
                "not bounce, whatever its restitution"
            )
        return TrainingConfiguration(
            name=table.source,
            source=source,
            backend="physx",
            settings=self.settings,
            origins=self.origins,
            frame_skip=frame_skip,
            notes=tuple(self.notes),
            inapplicable=reasons,
            gravity_m_per_s2=(x, y, z),
            language=self.dialect.name,
            foot_contact=foot_contact,
        )


# --- kinds of values -------------------------------------------------------------------------------------------------

SOLVERS = ("PGS", "TGS")
"""Solvers by PhysX's number of them."""


def solver_name(table: Table, key: str) -> str | None:
    """Return the solver that a number, or a flag that stands for TGS, states."""
    value = table.value(key)
    if value not in (None, 0, 1):
        raise TargetError(
            f"{table.source}: {table.name(key)} is {value!r}: give 0 (PGS) or 1 (TGS)"
        )
    return None if value is None else SOLVERS[int(value)]


def radians(table: Table, key: str) -> float | None:
    """Return an angular velocity [rad/s] that is stated in degrees."""
    degrees = table.number(key)
    return None if degrees is None else math.radians(degrees)


# --- materials -------------------------------------------------------------------------------------------------------

MODES: Mapping[str, Callable[[float, float], float]] = {
    "average": lambda a, b: 0.5 * (a + b),
    "min": min,
    "multiply": lambda a, b: a * b,
    "max": max,
}
"""Rules by which PhysX combines two coefficients; of the rules of two bodies, the later one counts."""

COEFFICIENTS = {
    "static_friction": "friction",
    "dynamic_friction": "friction",
    "restitution": "restitution",
}
"""Coefficients of a material, and what each is combined as."""

STIFFNESS = "compliant_contact_stiffness"

Range = tuple[float, float]
"""Least and greatest value."""


@dataclass(frozen=True, kw_only=True)
class Material:
    """Coefficients of a body before they are combined with those of another one.

    Attributes:
        body: Name of the body: `ground`, `robot`.
        origin: Key that states the material, or what stands in for it.
        ranges: Least and greatest value of each of the `COEFFICIENTS`.
        modes: Rules of combination of friction and of restitution.
        spring: Key that makes contacts springs; empty if none does.
    """

    body: str = "body"
    origin: str
    ranges: Mapping[str, Range]
    modes: Mapping[str, str] = field(
        default_factory=lambda: dict.fromkeys(COEFFICIENTS.values(), "average")
    )
    spring: str = ""

    @property
    def text(self) -> str:
        """Body, friction and origin in words."""
        friction = range_text(self.ranges["dynamic_friction"])
        return f"{self.body} {friction} ({self.origin})"


def constant(origin: str, friction: float, restitution: float = 0.0) -> Material:
    """Return a material with one coefficient of friction that is not randomized."""
    ranges = dict.fromkeys(COEFFICIENTS, (friction, friction))
    ranges["restitution"] = restitution, restitution
    return Material(origin=origin, ranges=ranges)


def stated_material(table: Table, body: str, default: Material) -> Material:
    """Return a material with the coefficients of a table; what the table lacks is that of `default`."""
    if not table:
        return replace(default, body=body)
    modes = {
        kind: table.value(f"{kind}_combine_mode") or mode
        for kind, mode in default.modes.items()
    }
    if wrong := set(modes.values()) - set(MODES):
        raise TargetError(
            f"{table.source}: {table.path} combines by {wrong.pop()!r}: choose one of {', '.join(MODES)}"
        )
    ranges = {k: coefficient_range(table, k) or default.ranges[k] for k in COEFFICIENTS}
    spring = table.name(STIFFNESS) if table.number(STIFFNESS) else ""
    return Material(
        body=body, origin=table.path, ranges=ranges, modes=modes, spring=spring
    )


def coefficient_range(table: Table, key: str) -> Range | None:
    """Return the range of a coefficient, which is one number or its two ends; None when it is not stated."""
    ends = table.numbers(key, 2)
    if ends is None:
        return None
    low, high = sorted(ends)
    if low < 0.0 or high == math.inf:
        raise TargetError(
            f"{table.source}: {table.name(key)} is {low:g}: give 0 or more"
        )
    return low, high


def combined(ground: Material, foot: Material) -> FootContact:
    """Return what a foot meets on the ground."""
    rank = [*MODES].index
    modes = {
        kind: max(mode, foot.modes[kind], key=rank)
        for kind, mode in ground.modes.items()
    }
    ranges = []
    for key, kind in COEFFICIENTS.items():
        low, high = map(MODES[modes[kind]], ground.ranges[key], foot.ranges[key])
        ranges.append((low, high))
    friction, bounce = modes.values()
    differs = "" if bounce == friction else f", restitution by {bounce}"
    return FootContact(
        static_friction=ranges[0],
        friction=ranges[1],
        restitution=ranges[2],
        source=f"{ground.text} and {foot.text}, friction by {friction}{differs}",
    )
