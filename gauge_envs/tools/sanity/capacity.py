"""Judge the limits of an engine's memory for contacts, which needs no rollout."""

from __future__ import annotations

import math
from typing import Any

from gauge_envs.tools.sanity.contact_capacity import ContactCapacity
from gauge_envs.tools.sanity.languages import Language
from gauge_envs.tools.sanity.model import Cause, PhenomenonResult, Reality, TrainingConfiguration, Verdict

CAPACITY_ID = "contact-capacity"
CAPACITY_TITLE = "contact capacity: constraint rows and contacts that find no place in the engine's memory"

CAPACITY_REALITY = Reality.law(
    0.0,
    tolerance=0.5,
    source="no contact and no joint limit of the target's own model may be left out",
    rationale="rows are whole numbers",
)
"""Rows of a world and contacts of a world that do not fit."""

SPARE = 1.25
"""Ratio of recommended limits and the counted need, since other motions may need more."""


def capacity_row(
    configuration: TrainingConfiguration, language: Language, *, is_wanted: bool = False
) -> PhenomenonResult | None:
    """Return the row on the memory for contacts; None when the target states no limit.

    Args:
        configuration: The configuration.
        language: Language of the target.
        is_wanted: Whether to return a declined row when the target states no limit.
    """
    capacity = configuration.capacity
    if capacity is None:
        remark = "the target states no limit of its memory for contacts"
        return _row(None, Verdict.DECLINED, remark=remark, applies=False) if is_wanted else None
    if capacity.need is None:
        return _row(None, Verdict.DECLINED, remark=capacity.reason, applies=False)
    missing = capacity.missing_rows + math.ceil(capacity.missing_contacts)
    if not missing:
        return _row(0.0, Verdict.INSIDE, remark=_need_text(capacity))
    changes = capacity_changes(capacity)
    line = f"{language.paste_text(changes)}: {_need_text(capacity)}"
    return _row(float(missing), Verdict.WRONG, cause=Cause(settings=tuple(changes), line=line))


def capacity_changes(capacity: ContactCapacity) -> dict[str, Any]:
    """Return the limits that the target's own model needs, with a quarter to spare; empty when all fits."""
    need, limits, changes = capacity.need, capacity.limits, {}
    if need is not None and capacity.missing_rows:
        changes["njmax"] = math.ceil(SPARE * need.rows)
    if need is not None and capacity.missing_contacts and limits.worlds is not None:
        changes["naconmax"] = math.ceil(SPARE * need.mean_contacts) * limits.worlds
    return changes


def _need_text(capacity: ContactCapacity) -> str:
    """Return what the target's own model needs, and its limits."""
    need, limits, parts = capacity.need, capacity.limits, []
    assert need is not None, "only a counted need is described"
    if limits.njmax is not None:
        place = f"in {need.situation}" if need.rows else "at most"
        parts.append(f"its model needs {need.rows} constraint rows {place}, and njmax is {limits.njmax}")
    if limits.naconmax is not None and limits.worlds:
        share = limits.naconmax / limits.worlds
        parts.append(f"it needs {need.mean_contacts:.3g} contacts in the mean of all worlds, and has {share:.3g}")
    return "; ".join(parts)


def _row(
    value: float | None, verdict: Verdict, *, remark: str = "", applies: bool = True, cause: Cause | None = None
) -> PhenomenonResult:
    return PhenomenonResult(
        phenomenon=CAPACITY_ID,
        title=CAPACITY_TITLE,
        experiment="",
        unit="1",
        reality=CAPACITY_REALITY,
        default=None,
        configured=value,
        verdict=verdict,
        default_verdict=Verdict.DECLINED,
        cause=cause,
        remark=remark,
        applies=applies,
    )
