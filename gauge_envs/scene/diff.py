"""Differences between two scenes, field by field, and what each of them changes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from gauge_envs.scene.air import Air
from gauge_envs.scene.bodies import Attachment, Contact, Hinge, Tether
from gauge_envs.scene.drivers import Driver
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
        name = ".".join(self.field)
        if self.others:
            return f"{self.entry} and {self.others} more: {name} {difference}, ..."
        return f"{self.entry}: {name} {difference}"


CONSTANTS = frozenset(
    {
        "mass_kg",
        "inertia_kg_m2",
        "areal_density_kg_per_m2",
        "thickness_m",
        "stretch_stiffness_n_per_m",
        "shear_stiffness_n_per_m",
        "bend_stiffness_n_m_per_rad",
        "young_modulus_pa",
        "poisson_ratio",
        "friction",
        "restitution",
        "mode",
        "torsion_m",
        "rolling_m",
        "density_kg_per_m3",
        "normal_coefficient",
        "tangential_coefficient",
        "lift_coefficient",
    }
)
"""Fields of bodies, contacts and air that hold constants."""

STARTS = frozenset({"pose", "linear_velocity_m_per_s", "angular_velocity_rad_per_s"})
"""Fields of a body that hold its initial state."""

LABELS = frozenset({"provenance", "residual_rate"})
"""Fields of drivers without effect on a motion without actions."""


def scene_changes(before: Scene, after: Scene) -> Iterator[Change]:
    """Yield each difference between two scenes, field by field."""
    for field in fields(Scene):
        old, new = getattr(before, field.name), getattr(after, field.name)
        if old == new:
            continue
        if isinstance(old, tuple):
            yield from _group_changes(before, field.name, old, new)
        elif is_dataclass(old) and is_dataclass(new):
            yield from _changes(field.name, (), old, new)
        else:
            yield Change(
                kind=_kind_of_still_air(old or new),
                entry="scene",
                field=(field.name,),
                before=old,
                after=new,
            )


def _kind_of_still_air(value: Any) -> ChangeKind:
    """Return the kind of an added or removed entry: still air is a constant, and all others are structure."""
    is_still = isinstance(value, Air) and not any(value.wind_m_per_s)
    return ChangeKind.CONSTANT if is_still else ChangeKind.STRUCTURE


def _group_changes(
    scene: Scene, group: str, before: Sequence[Any], after: Sequence[Any]
) -> Iterator[Change]:
    """Yield the changes of a group such as bodies or contacts; entries without a match are added or removed."""
    old, new = _titled(before), _titled(after)
    free = {body.name for body in scene.dynamic_bodies} | scene.free_cloths
    unmatched = [title for title in (*old, *new) if not (title in old and title in new)]
    for title in unmatched:
        yield Change(
            kind=ChangeKind.STRUCTURE,
            entry=title,
            before=old.get(title),
            after=new.get(title),
        )
    common = tuple(title for title in old if title in new)
    order = tuple(title for title in new if title in old)
    for title in common:
        yield from _changes(title, (), old[title], new[title], is_free=title in free)
    if common != order:
        yield Change(
            kind=ChangeKind.LABEL,
            entry=group,
            field=("order",),
            before=common,
            after=order,
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
    match entry:
        case Contact():
            return f"contact {_side(entry.first)}/{_side(entry.second)}"
        case Attachment():
            return f"attachment of {entry.deformable} to {entry.to}"
        case Hinge() | Tether() | Driver():
            return f"{type(entry).__name__.lower()} of {entry.body}"
    return str(entry.name)


def _side(names: Sequence[str]) -> str:
    if len(names) <= MAX_NAMES:
        return "+".join(names)
    return f"{names[0]}+...+{names[-1]} ({len(names)})"


def _changes(
    title: str, path: tuple[str, ...], before: Any, after: Any, *, is_free: bool = False
) -> Iterator[Change]:
    """Yield the changes between two values of an entry, down to numbers.

    Args:
        title: Title of the entry.
        path: Path of the values in it.
        before: Value before.
        after: Value after.
        is_free: Whether the entry is free to move, so that its pose is its start.
    """
    old, new = _parts(before), _parts(after)
    if old and type(before) is type(after) and old.keys() == new.keys():
        for name, part in old.items():
            if part != new[name]:
                yield from _changes(
                    title, (*path, name), part, new[name], is_free=is_free
                )
        return
    kind = ChangeKind.STRUCTURE
    if is_free and path[0] in STARTS:
        kind = ChangeKind.START
    elif path[-1] in CONSTANTS:
        kind = ChangeKind.CONSTANT
    elif path[-1] in LABELS:
        kind = ChangeKind.LABEL
    yield Change(kind=kind, entry=title, field=path, before=before, after=after)


def _parts(value: Any) -> dict[str, Any]:
    """Return the fields of a dataclass, or the dataclasses in a tuple by their numbers; empty for other values."""
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, tuple) and all(map(is_dataclass, value)):
        return {str(number): part for number, part in enumerate(value)}
    return {}


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
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        return None


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, tuple):
        shown = [_text(entry) for entry in value[:MAX_NAMES]]
        return f"({', '.join(shown)}{', ...' if len(value) > MAX_NAMES else ''})"
    return type(value).__name__ if is_dataclass(value) else str(value)
