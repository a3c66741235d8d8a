"""Compare the models and the checks of two reports."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from gauge_envs.pages.document import Document, Paragraph, Tone
from gauge_envs.pages.table import Column, Table
from gauge_envs.pages.text import counted, quantity_text
from gauge_envs.tools.sanity.robot.model_text import COUNTS
from gauge_envs.tools.sanity.verdict import Report, SanityResult, SanityVerdict

MAX_CHANGES = 12
"""Largest number of changes of the model that the screen shows."""


@dataclass(frozen=True, kw_only=True)
class CheckDifference:
    """A check of two reports.

    Attributes:
        id: Id of the check.
        title: Title.
        unit: Unit of both values; `1` for a pure number.
        first: Value of the first target; None when not measured.
        second: Value of the second target.
        first_verdict: SanityVerdict of the first target.
        second_verdict: SanityVerdict of the second target.
        is_changed: Whether the verdicts differ, or the values by more than the half-width of the interval of reality.
    """

    id: str
    title: str
    unit: str
    first: float | None
    second: float | None
    first_verdict: SanityVerdict
    second_verdict: SanityVerdict
    is_changed: bool

    @property
    def is_measured(self) -> bool:
        """Whether both targets were measured."""
        return SanityVerdict.NOT_MEASURED not in (
            self.first_verdict,
            self.second_verdict,
        )


@dataclass(frozen=True, kw_only=True)
class TargetDifference:
    """The checks of two reports that apply to a target or to both.

    Attributes:
        first: Name of the first target.
        second: Name of the second target.
        checks: The checks, in the order of the reports.
        changes: What differs between the two models, an attribute of an element each.
    """

    first: str
    second: str
    checks: tuple[CheckDifference, ...]
    changes: tuple[str, ...] = ()


def difference(first: Report, second: Report) -> TargetDifference:
    """Return the checks of two reports side by side."""
    others = {result.id: result for result in second.checks}
    checks = []
    for result in first.checks:
        other = others.get(result.id)
        if other is not None and (result.applies or other.applies):
            checks.append(_check_difference(result, other))
    return TargetDifference(
        first=first.configuration.name,
        second=second.configuration.name,
        checks=tuple(checks),
        changes=tuple(_model_changes(first, second)),
    )


KINDS = ("body", "joint", "geom", "site", "actuator", "tendon", "equality", "sensor")

DERIVED = re.compile(
    r"(id|adr|num|user)$|^(bvh|aabb|rbound|invweight|subtree|name|plugin|length0|acc0|sameframe|M0)|^id$"
)
"""Attributes of a compiled model that count elements, or follow from others."""


def _model_changes(first: Report, second: Report) -> Iterator[str]:
    """Yield each attribute of an element that two models do not share, and elements that one of them lacks."""
    robots = first.configuration.robot, second.configuration.robot
    if robots[0] is None or robots[1] is None:
        return
    before, after = robots[0].model, robots[1].model
    for kind in KINDS:
        names, others = (
            [element.name for element in _elements(model, kind)]
            for model in (before, after)
        )
        yield from (f"{kind} {name} leaves" for name in names if name not in others)
        yield from (f"{kind} {name} is new" for name in others if name not in names)
        for name in filter(None, names):
            if name in others:
                elements = (getattr(model, kind)(name) for model in (before, after))
                yield from _attribute_changes(f"{kind} {name}", *elements)
    yield from _attribute_changes("option", before.opt, after.opt)


def _elements(model: mujoco.MjModel, kind: str) -> list[Any]:
    """Return the elements of a kind."""
    count = getattr(model, COUNTS.get(kind, f"n{kind}"))
    return [getattr(model, kind)(number) for number in range(count)]


def _attribute_changes(label: str, before: Any, after: Any) -> Iterator[str]:
    """Yield the attributes of an element that differ, with both values."""
    for key in dir(before):
        if key.startswith("_") or DERIVED.search(key):
            continue
        old, new = (np.atleast_1d(getattr(part, key)) for part in (before, after))
        if old.dtype.kind in "fiub" and not np.allclose(old, new, equal_nan=True):
            texts = [" ".join(f"{x:.4g}" for x in array) for array in (old, new)]
            yield f"{key} of {label}: {' to '.join(texts)}"


def _check_difference(first: SanityResult, second: SanityResult) -> CheckDifference:
    is_changed = first.verdict is not second.verdict
    if first.configured is not None and second.configured is not None:
        distance = abs(first.configured - second.configured)
        is_changed |= distance > first.reality.tolerance
    return CheckDifference(
        id=first.id,
        title=first.title,
        unit=first.unit,
        first=first.configured,
        second=second.configured,
        first_verdict=first.verdict,
        second_verdict=second.verdict,
        is_changed=is_changed,
    )


def difference_document(compared: TargetDifference) -> Document:
    """Return how many checks differ, and the table; its JSON rows are both names, then each check."""
    changed = [check for check in compared.checks if check.is_changed]
    text = f"{len(changed)} of {counted(len(compared.checks), 'check')} change"
    table = Table(
        columns=(
            Column("id", "id"),
            Column("title", "quantity", wide_only=True),
            Column("first", compared.first, quantity_text, is_number=True),
            Column("second", compared.second, quantity_text, is_number=True),
            Column("first_verdict", "verdict", lambda verdict: verdict.value),
            Column("second_verdict", "verdict", lambda verdict: verdict.value),
            Column(
                "is_changed", "", lambda is_changed: "changed" if is_changed else ""
            ),
        ),
        rows=changed,
    )
    names: dict[str, Any] = {"first": compared.first, "second": compared.second}
    shown = compared.changes[:MAX_CHANGES]
    lines = [f"model: {text}" for text in shown]
    if left := len(compared.changes) - len(shown):
        lines.append(f"model: {left} more, which --json lists")
    names["changes"] = compared.changes
    return Document(
        parts=(Paragraph(text, Tone.ANSWER), *map(Paragraph, lines), table),
        rows=[names, *map(vars, compared.checks)],
    )
