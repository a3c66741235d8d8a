"""Combine the materials of ground and foot, as PhysX does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.foot_contact import FootContact
from gauge_envs.tools.sanity.readers.table import Table

Range = tuple[float, float]
"""Least and greatest value."""

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
        static_friction: Least and greatest coefficient.
        dynamic_friction: Least and greatest coefficient.
        restitution: Least and greatest restitution.
        friction_mode: Rule of combination of friction.
        restitution_mode: Rule of combination of restitution.
    """

    body: str
    origin: str
    static_friction: Range
    dynamic_friction: Range
    restitution: Range
    friction_mode: str = AVERAGE
    restitution_mode: str = AVERAGE


def one_value(number: float) -> Range:
    """Return the range of a value that is not randomized."""
    return number, number


def stated_material(table: Table, *, body: str, default: Material) -> Material:
    """Return a material with the coefficients of a table; what the table lacks is that of `default`."""

    def coefficient(key: str, otherwise: Range) -> Range:
        number = table.number(key)
        if number is None:
            return otherwise
        if not 0.0 <= number < float("inf"):
            raise TargetError(f"{table.source}: {table.name(key)} is {number:g}: give 0 or more")
        return one_value(number)

    def mode(key: str, otherwise: str) -> str:
        name = table.text(key)
        if name is not None and name not in MODES:
            raise TargetError(f"{table.source}: {table.name(key)} is {name!r}: choose one of {', '.join(MODES)}")
        return name or otherwise

    return Material(
        body=body,
        origin=table.path,
        static_friction=coefficient("static_friction", default.static_friction),
        dynamic_friction=coefficient("dynamic_friction", default.dynamic_friction),
        restitution=coefficient("restitution", default.restitution),
        friction_mode=mode("friction_combine_mode", default.friction_mode),
        restitution_mode=mode("restitution_combine_mode", default.restitution_mode),
    )


def of_body(material: Material, body: str) -> Material:
    """Return a material as that of a body."""
    return replace(material, body=body)


def combined(ground: Material, foot: Material) -> FootContact:
    """Return what a foot meets on the ground."""
    friction_mode = _mode(ground.friction_mode, foot.friction_mode)
    restitution_mode = _mode(ground.restitution_mode, foot.restitution_mode)
    return FootContact(
        friction=_combined(friction_mode, ground.dynamic_friction, foot.dynamic_friction),
        static_friction=_combined(friction_mode, ground.static_friction, foot.static_friction),
        restitution=_combined(restitution_mode, ground.restitution, foot.restitution),
        source=f"{_text(ground)} and {_text(foot)}, friction by {friction_mode}"
        + ("" if restitution_mode == friction_mode else f", restitution by {restitution_mode}"),
    )


def _mode(one: str, other: str) -> str:
    names = list(MODES)
    return max(one, other, key=names.index)


def _combined(mode: str, one: Range, other: Range) -> Range:
    rule = MODES[mode]
    return rule(one[0], other[0]), rule(one[1], other[1])


def _text(material: Material) -> str:
    low, high = material.dynamic_friction
    friction = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
    return f"{material.body} {friction} ({material.origin})"
