"""Fields of the compiled model that differ between two versions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gauge_envs.tools.versions.model import FieldChange

OWNERS = {
    "body_": "body",
    "jnt_": "joint",
    "dof_": "dof",
    "geom_": "geom",
    "mesh_": "mesh",
    "pair_": "pair",
    "eq_": "equality",
    "tendon_": "tendon",
    "actuator_": "actuator",
    "key_": "key",
    "qpos": "coordinate",
}
"""What the rows of a field are of."""

FIELD_TOLERANCE = 1e-9
"""Relative difference of a compiled number that counts."""


def field_changes(
    one: Mapping[str, Any], two: Mapping[str, Any]
) -> tuple[tuple[FieldChange, ...], tuple[str, ...]]:
    """Return the compiled fields that differ, and the names of those that one side alone has.

    Args:
        one: What the worker wrote of the first side.
        two: What it wrote of the second side.
    """
    before, after = one["fields"], two["fields"]
    changes = []
    for name in before:
        if name in after and (change := _field_change(name, before, after, one)):
            changes.append(change)
    return tuple(changes), tuple(sorted({*before} ^ {*after}))


def _field_change(
    name: str,
    before: Mapping[str, Any],
    after: Mapping[str, Any],
    words: Mapping[str, Any],
) -> FieldChange | None:
    one, two = np.array(before[name]), np.array(after[name])
    if one.shape != two.shape:
        return FieldChange(
            field=name, where="", count=1, before=before[name], after=after[name]
        )
    if one.dtype.kind == "f" or two.dtype.kind == "f":
        differs = ~np.isclose(
            one, two, rtol=FIELD_TOLERANCE, atol=1e-12, equal_nan=True
        )
        size = np.abs(np.subtract(one, two, dtype=float))
    else:
        differs = one != two
        size = differs.astype(float)
    if not np.any(differs):
        return None
    if name.startswith("opt.") or one.ndim == 0:
        where, count, values = "", 1, (one, two)
    else:
        rows = np.any(differs.reshape(len(one), -1), axis=1)
        sizes = np.where(differs, size, -1.0).reshape(len(one), -1)
        at = int(np.argmax(np.max(sizes, axis=1)))
        start = next((start for start in OWNERS if name.startswith(start)), "")
        owners = words["names"].get(OWNERS.get(start, ""), [])
        where = owners[at] if len(owners) == len(one) else f"row {at}"
        count, values = int(np.sum(rows)), (one[at], two[at])
    return FieldChange(
        field=name,
        where=where,
        count=count,
        before=values[0].tolist(),
        after=values[1].tolist(),
    )
