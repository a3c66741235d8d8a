"""Differences between two scenes, field by field, and what each of them changes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np

from gauge_envs.scene.air import Air
from gauge_envs.scene.bodies import (
    Attachment,
    Cloth,
    Contact,
    RigidBody,
    Rod,
    Rope,
    SoftBody,
)
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.scene import Scene

MAX_NAMES = 4
"""Largest number of names that a line lists."""

MAX_NUMBERS = 9
"""Largest array whose numbers a line lists; a larger one is summarized by count and largest difference."""


class ChangeKind(StrEnum):
    """What a change of a scene, or of a model of it, changes."""

    CONSTANT = "constant"
    """A constant of a material, of a contact, of a mass or of still air."""
    START = "start"
    """The initial state of a body that is free to move."""
    SETTING = "setting"
    """A numerical setting of an engine."""
    LABEL = "label"
    """Nothing that moves without actions: an order, an origin, the rate of an action."""
    STRUCTURE = "structure"
    """Everything else: bodies, shapes, joints, clamps, markers, prescribed motion, gravity, wind."""


@dataclass(frozen=True, kw_only=True)
class Change:
    """One difference between two scenes, or between two models of them.

    Attributes:
        kind: What it changes.
        entry: Title of the entry, as `cube` or `contact cube/board`; `scene` for the scene itself.
        field: Path of the field in the entry, as `("pose", "position_m")`; empty for an added or removed entry.
        before: Value before; None if the entry is added.
        after: Value after; None if the entry is removed.
        others: Number of further entries with a change of this field.
    """

    kind: ChangeKind
    entry: str
    field: tuple[str, ...] = ()
    before: Any = None
    after: Any = None
    others: int = 0

    def __str__(self) -> str:
        """Return the change in a line, as `contact cube/board: friction 0.3 -> 0.2`."""
        if not self.field:
            return f"{self.entry}: {'added' if self.before is None else 'removed'}"
        difference = _difference(self.before, self.after)
        if self.others:
            title, difference = (
                f"{self.entry} and {self.others} more",
                f"{difference}, ...",
            )
        else:
            title = self.entry
        return f"{title}: {'.'.join(self.field)} {difference}"


CONSTANTS: Mapping[type, frozenset[str]] = {
    RigidBody: frozenset({"mass_kg", "inertia_kg_m2"}),
    Cloth: frozenset(
        {
            "mass_kg",
            "areal_density_kg_per_m2",
            "thickness_m",
            "stretch_stiffness_n_per_m",
            "shear_stiffness_n_per_m",
            "bend_stiffness_n_m_per_rad",
        }
    ),
    SoftBody: frozenset({"mass_kg", "young_modulus_pa", "poisson_ratio"}),
    Rope: frozenset({"mass_kg", "young_modulus_pa"}),
    Rod: frozenset({"mass_kg", "young_modulus_pa", "poisson_ratio"}),
    Contact: frozenset({"friction", "restitution", "mode", "torsion_m", "rolling_m"}),
    Air: frozenset(
        {
            "density_kg_per_m3",
            "normal_coefficient",
            "tangential_coefficient",
            "lift_coefficient",
        }
    ),
}
"""Fields that hold constants, by class."""

STARTS = frozenset({"pose", "linear_velocity_m_per_s", "angular_velocity_rad_per_s"})
"""Fields of a body that hold its initial state."""

LABELS: Mapping[type, frozenset[str]] = {
    Driver: frozenset({"provenance"}),
    DriverMotion: frozenset({"residual_rate"}),
}
"""Fields without effect on a motion without actions, by class."""


def scene_changes(before: Scene, after: Scene) -> Iterator[Change]:
    """Yield each difference between two scenes, field by field."""
    if before == after:
        return
    for field in fields(Scene):
        old, new = getattr(before, field.name), getattr(after, field.name)
        if not field.compare or old == new:
            continue
        if isinstance(old, tuple) and isinstance(new, tuple):
            yield from _group_changes(before, field.name, old, new)
        elif isinstance(old, Air) and isinstance(new, Air):
            yield from _field_changes("air", (), old, new)
        else:
            kind = (
                _kind_of_air(old, new) if field.name == "air" else ChangeKind.STRUCTURE
            )
            yield Change(
                kind=kind, entry="scene", field=(field.name,), before=old, after=new
            )


def _kind_of_air(before: Air | None, after: Air | None) -> ChangeKind:
    """Return the kind of air that is added or removed: still air is a constant, wind is not."""
    air = before or after
    has_wind = air is not None and any(air.wind_m_per_s)
    return ChangeKind.STRUCTURE if has_wind else ChangeKind.CONSTANT


def _group_changes(
    scene: Scene, group: str, before: Sequence[Any], after: Sequence[Any]
) -> Iterator[Change]:
    """Yield the changes of a group such as bodies or contacts; entries without a match are added or removed."""
    old, new = _titled(before), _titled(after)
    structure = ChangeKind.STRUCTURE
    for title, entry in old.items():
        if title not in new:
            yield Change(kind=structure, entry=title, before=entry)
    for title, entry in new.items():
        if title not in old:
            yield Change(kind=structure, entry=title, after=entry)
    common = [title for title in old if title in new]
    free = {body.name for body in scene.dynamic_bodies} | scene.free_cloths
    for title in common:
        yield from _entry_changes(title, old[title], new[title], is_free=title in free)
    order = [title for title in new if title in old]
    if common != order:
        yield Change(
            kind=ChangeKind.LABEL,
            entry=group,
            field=("order",),
            before=tuple(common),
            after=tuple(order),
        )


def _titled(entries: Sequence[Any]) -> dict[str, Any]:
    titles: dict[str, Any] = {}
    for entry in entries:
        title = _title(entry)
        count = 2
        while title in titles:
            title, count = f"{_title(entry)} ({count})", count + 1
        titles[title] = entry
    return titles


def _title(entry: Any) -> str:
    if isinstance(entry, Contact):
        return f"contact {_side(entry.first)}/{_side(entry.second)}"
    if isinstance(entry, Attachment):
        return f"attachment of {entry.deformable} to {entry.to}"
    name = getattr(entry, "name", None)
    return (
        name if name is not None else f"{type(entry).__name__.lower()} of {entry.body}"
    )


def _side(names: Sequence[str]) -> str:
    return (
        "+".join(names)
        if len(names) <= MAX_NAMES
        else f"{names[0]}+...+{names[-1]} ({len(names)})"
    )


def _entry_changes(
    title: str, before: Any, after: Any, *, is_free: bool
) -> Iterator[Change]:
    """Yield the changes of one entry; the pose of a body that is free to move is its start."""
    for change in _field_changes(title, (), before, after):
        if is_free and change.field[0] in STARTS:
            change = replace(change, kind=ChangeKind.START)
        yield change


def _field_changes(
    title: str, path: tuple[str, ...], before: Any, after: Any
) -> Iterator[Change]:
    """Yield the changes of the fields of two dataclasses of one type, down to numbers."""
    for field in fields(before):
        old, new = getattr(before, field.name), getattr(after, field.name)
        if not field.compare or old == new:
            continue
        name = (*path, field.name)
        for inner, old_part, new_part in _parts(name, old, new):
            if is_dataclass(old_part) and type(old_part) is type(new_part):
                yield from _field_changes(title, inner, old_part, new_part)
            elif old_part != new_part:
                kind = _kind(type(before), field.name)
                yield Change(
                    kind=kind, entry=title, field=inner, before=old_part, after=new_part
                )


def _parts(
    path: tuple[str, ...], before: Any, after: Any
) -> Iterator[tuple[tuple[str, ...], Any, Any]]:
    """Yield path and values of a field; a tuple of dataclasses has a number for each."""
    is_list = isinstance(before, tuple) and isinstance(after, tuple)
    if is_list and len(before) == len(after) and all(map(is_dataclass, before)):
        for number, (old, new) in enumerate(zip(before, after, strict=True)):
            yield (*path, str(number)), old, new
    else:
        yield path, before, after


def _kind(owner: type, name: str) -> ChangeKind:
    """Return the kind of a field of a class."""
    if name in CONSTANTS.get(owner, ()):
        return ChangeKind.CONSTANT
    if name in LABELS.get(owner, ()):
        return ChangeKind.LABEL
    return ChangeKind.STRUCTURE


def _difference(before: Any, after: Any) -> str:
    old, new = _numbers(before), _numbers(after)
    if old is None or new is None or old.size <= MAX_NUMBERS >= new.size:
        return f"{_text(before)} -> {_text(after)}"
    if old.shape != new.shape:
        return f"{list(old.shape)} numbers -> {list(new.shape)}"
    change = np.abs(new - old)
    return f"{np.count_nonzero(change)} of {old.size} numbers differ, by up to {change.max():.6g}"


def _numbers(value: Any) -> Any:
    """Return a value as an array of numbers; None if it is not numeric or is ragged."""
    if not isinstance(value, int | float | tuple):
        return None
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return array


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, tuple):
        shown = [_text(entry) for entry in value[:MAX_NAMES]]
        return f"({', '.join(shown)}{', ...' if len(value) > MAX_NAMES else ''})"
    return (
        type(value).__name__
        if is_dataclass(value) or not isinstance(value, str | int | None)
        else str(value)
    )
