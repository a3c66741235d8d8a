"""Read stacks on PhysX: kinds of values, and settings of the backend `physx` that follow from others."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from gauge_envs.errors import TargetError
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.sanity.readers.dialect import (
    Kind,
    NestedTable,
    SettingOrigins,
    python_text,
)
from gauge_envs.tools.sanity.readers.settings import checked_configuration
from gauge_envs.tools.sanity.training import Need, TrainingConfiguration

GRAVITY = (0.0, 0.0, -GRAVITY_M_PER_S2)
"""Default gravity [m/s^2]."""

MAX_SPEED = 1e16
"""Speed that stands for no limit, the largest one of the backend [m/s] or [rad/s]."""

SOLVERS = ("PGS", "TGS")
"""Solvers by PhysX's number of them."""


def solver_name(table: NestedTable, key: str) -> str | None:
    """Return the solver of a number, or of a flag for TGS."""
    value = table.value(key)
    if value not in (None, 0, 1):
        raise TargetError(
            f"{table.source}: {table.name(key)} is {value!r}: give 0 (PGS) or 1 (TGS)"
        )
    return None if value is None else SOLVERS[int(value)]


def _speed(table: NestedTable, key: str) -> float | None:
    value = table.number(key)
    return None if value is None else min(value, MAX_SPEED)


def _radians_per_s(table: NestedTable, key: str) -> float | None:
    """Return a speed [rad/s] from degrees per second."""
    value = table.number(key)
    return None if value is None else min(math.radians(value), MAX_SPEED)


KINDS: Mapping[str, Kind] = {
    "solver": (solver_name, lambda solver: str(SOLVERS.index(solver)), ""),
    "speed": (_speed, None, ""),
    "degrees": (_radians_per_s, lambda speed: python_text(math.degrees(speed)), ""),
    "argument": (NestedTable.number, None, "{key}={value}"),
}
"""Kinds of values in PhysX's own units."""


def physx_configuration(
    table: NestedTable,
    settings: SettingOrigins,
    *,
    bounces: bool,
    springs: str = "",
    **attributes: Any,
) -> TrainingConfiguration:
    """Return the training configuration of a stack on PhysX.

    Args:
        table: Values of the target.
        settings: Settings of the target, with their origins.
        bounces: Whether a material has a restitution.
        springs: Key that makes contacts springs; empty if none does.
        attributes: Further attributes of the configuration.
    """
    reasons = {}
    if not bounces:
        reasons[Need.REBOUND] = "the target has a restitution of 0"
    if springs:
        reasons[Need.CONTACT] = (
            f"{springs} makes contacts springs, which SAPIEN does not expose"
        )
    fixed = {
        "hinges": ("articulation", "a robot is an articulation"),
        "sustained_restitution": (bounces, "the given restitution"),
    }
    return checked_configuration(
        table.source,
        "physx",
        {**settings, **fixed},
        inapplicable=reasons,
        **attributes,
    )
