"""What stacks on PhysX have in common: kinds of values, and settings of the backend `physx` that follow from others."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from gauge_envs.errors import TargetError
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.sanity.model import Need, TrainingConfiguration
from gauge_envs.tools.sanity.stacks.dialect import Kind, Stated, Table, python_text
from gauge_envs.tools.sanity.stacks.settings import checked_configuration

GRAVITY = (0.0, 0.0, -GRAVITY_M_PER_S2)
"""Gravity of a target that states none [m/s^2]."""

LARGEST = 1e16
"""Speed that stands for no limit; the backend takes no larger one [m/s] or [rad/s]."""

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


def _speed(table: Table, key: str) -> float | None:
    value = table.number(key)
    return None if value is None else min(value, LARGEST)


def _radians_per_s(table: Table, key: str) -> float | None:
    """Return a speed [rad/s] that is stated in degrees."""
    value = table.number(key)
    return None if value is None else min(math.radians(value), LARGEST)


KINDS: Mapping[str, Kind] = {
    "solver": (solver_name, lambda solver: str(SOLVERS.index(solver)), ""),
    "speed": (_speed, None, ""),
    "degrees": (_radians_per_s, lambda speed: python_text(math.degrees(speed)), ""),
    "argument": (Table.number, None, "{key}={value}"),
}
"""Kinds of values in PhysX's own units."""


def physx_configuration(
    table: Table, stated: Stated, *, bounces: bool, springs: str = "", **others: Any
) -> TrainingConfiguration:
    """Return the training configuration of a stack on PhysX.

    Args:
        table: What the target states.
        stated: Settings that it states, with their origins.
        bounces: Whether a material has a restitution.
        springs: Key that makes contacts springs; empty if none does.
        others: Further attributes of the configuration.
    """
    reasons = {}
    if not bounces:
        reasons[Need.REBOUND] = "the target states a restitution of 0"
    if springs:
        reasons[Need.CONTACT] = (
            f"{springs} makes contacts springs, which SAPIEN does not expose"
        )
    fixed = {
        "hinges": ("articulation", "a robot is an articulation"),
        "sustained_restitution": (bounces, "the stated restitution"),
    }
    return checked_configuration(
        table.source, "physx", {**stated, **fixed}, inapplicable=reasons, **others
    )
