"""Differences between two scenes, field by field."""

from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from gauge_envs.scene.bodies import Attachment, Contact
from gauge_envs.scene.scene import Scene

MAX_NAMES = 4
"""Largest number of names that a line lists."""

MAX_NUMBERS = 9
"""Largest array whose numbers a line lists; a larger one is summarized by count and largest difference."""


def scene_changes(before: Scene, after: Scene) -> Iterator[str]:
    """Yield one line for each difference between two scenes, field by field."""
    if before == after:
        return
    for field in fields(Scene):
        if not field.compare:
            continue
        old, new = getattr(before, field.name), getattr(after, field.name)
        if old == new:
            continue
        if isinstance(old, tuple) and isinstance(new, tuple):
            yield from _group_changes(field.name, old, new)
        else:
            yield from _value_changes("scene", field.name, old, new)


def _group_changes(
    group: str, before: Sequence[Any], after: Sequence[Any]
) -> Iterator[str]:
    """Yield the changes of a group such as bodies or contacts; entries without a match are added or removed."""
    old, new = _titled(before), _titled(after)
    yield from (f"{title}: removed" for title in old if title not in new)
    yield from (f"{title}: added" for title in new if title not in old)
    common = [title for title in old if title in new]
    for title in common:
        if old[title] != new[title]:
            yield from _value_changes(title, "", old[title], new[title])
    if common != [title for title in new if title in old]:
        yield f"{group}: in another order"


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


def _value_changes(title: str, name: str, before: Any, after: Any) -> Iterator[str]:
    """Yield the changes of one value down to numbers; a value of another type changes as a whole."""
    if before == after:
        return
    if is_dataclass(before) and type(before) is type(after):
        for field in fields(before):
            if field.compare:
                inner = f"{name}.{field.name}" if name else field.name
                yield from _value_changes(
                    title,
                    inner,
                    getattr(before, field.name),
                    getattr(after, field.name),
                )
        return
    label = f"{title}: {name} " if name else f"{title}: "
    yield f"{label}{_difference(before, after)}"


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
