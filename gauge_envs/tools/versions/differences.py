"""What differs between two versions: one step from the same states, compiled fields, contacts, and final positions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.versions.environments import Arrays
from gauge_envs.tools.versions.schema import (
    FieldChange,
    PairChange,
    Parting,
    Quantity,
    Settled,
)

MIN_LIMIT = 1e-6
"""Smallest difference of accelerations that counts, over the larger one. With constraints the limit is at least the
square root of the solver's tolerance, 1e-4 by default."""

NOISE_FACTOR = 10.0
"""Differences below this multiple of the noise of a state do not count."""

DEPTH_TOLERANCE_M = 1e-7
"""Difference of depths that counts [m]; convex solvers stop at 1e-6."""

FIELD_TOLERANCE = 1e-9
"""Relative difference of a compiled number that counts."""

END_TOLERANCE_M = 1e-3
"""Smallest distance between two final positions of a body that counts [m]."""

OWNERS = {
    "body": "body",
    "jnt": "joint",
    "dof": "dof",
    "geom": "geom",
    "mesh": "mesh",
    "pair": "pair",
    "eq": "equality",
    "tendon": "tendon",
    "actuator": "actuator",
    "key": "key",
}
"""Objects that the rows of a compiled field describe, by the prefix of its name."""

WHEN = ("before", "after")
"""The two sides in the names of values."""

FINAL = {
    "displacements_m": "moved_{}_m",
    "depths_m": "depth_{}_m",
    "speeds_m_per_s": "speed_{}_m_per_s",
    "kinds": "end_{}",
}
"""Names of the values of a body at the end of a motion, by their keys in the output of a worker."""


class Gap:
    """Differences of what two sides compute from the same states.

    Args:
        sides: Arrays that each side computed.

    Attributes:
        relative: Difference of the accelerations over the larger one, shape [states].
        noise: What a velocity 1e-10 apart and a solver without its warm start change, on the quieter side,
            shape [states].
        limit: Difference that counts, shape [states].
        differs: Where the difference counts, shape [states].
    """

    def __init__(self, *sides: Arrays) -> None:
        self.sides = sides
        before, after = sides
        # At rest the acceleration is 0; the acceleration without constraints, gravity, remains.
        norms = [
            np.linalg.norm(side[name], axis=1)
            for side in sides
            for name in ("qacc", "smooth", "step_acc")
        ]
        scale = np.fmax(np.fmax.reduce(norms), 1e-9)

        def distance(first: FloatArray, second: FloatArray) -> FloatArray:
            """Return a relative distance; 2, its maximum, where one side is not a number."""
            norm = np.linalg.norm(first - second, axis=1)
            return np.nan_to_num(norm / scale, nan=2.0)

        self.relative = np.fmax(
            distance(before["qacc"], after["qacc"]),
            distance(before["step_acc"], after["step_acc"]),
        )
        noises = [
            np.fmax(
                *(distance(side["qacc"], side[name]) for name in ("perturbed", "cold"))
            )
            for side in sides
        ]
        self.noise = np.fmin(*noises)
        solver_error = np.fmax(before["solver_error"], after["solver_error"])
        limits = [NOISE_FACTOR * self.noise, solver_error]
        self.limit = np.fmax(np.fmax(*limits), MIN_LIMIT)
        is_warned = before["warnings"] != after["warnings"]
        self.differs = (self.relative > self.limit) | is_warned

    @property
    def distance(self) -> float:
        """Root mean square of the differences that count."""
        counted = np.where(self.differs, np.minimum(self.relative, 2.0), 0.0)
        return float(np.sqrt(np.mean(counted**2)))

    def worst(self, count: int) -> list[int]:
        """Return the indices of the states that differ most, the largest difference first."""
        order = np.argsort(
            np.where(self.differs, -self.relative, np.inf), kind="stable"
        )
        return order[: min(count, int(np.sum(self.differs)))].tolist()

    def is_close(self, name: str, index: int) -> bool:
        """Return whether both sides computed the same in a state, up to rounding."""
        first, second = (side[name][index] for side in self.sides)
        size = max(np.linalg.norm(first), np.linalg.norm(second))
        return bool(np.allclose(first, second, rtol=0.0, atol=MIN_LIMIT / 10.0 * size))


# --- where two sides differ ------------------------------------------------------------------------------------------


def depths_m(side: Arrays, index: int) -> dict[tuple[int, int], list[float]]:
    """Return the sorted distances of the contacts of a state [m], by pair of geoms."""
    depths: dict[tuple[int, int], list[float]] = {}
    for contact in np.flatnonzero(side["contact_state"] == index):
        first, second = side["contact_pair"][contact].tolist()
        distances_m = depths.setdefault((first, second), [])
        distances_m.append(float(side["contact_dist"][contact]))
    return {pair: sorted(distances_m) for pair, distances_m in depths.items()}


def parting(
    gap: Gap, index: int, step: int, names: Mapping[str, list[str]], **place: Any
) -> Parting:
    """Return how two sides differ in a state.

    Args:
        gap: The differences.
        index: The state.
        step: Step of the state in its segment.
        names: Names of geoms and degrees of freedom.
        place: The segment, and the side that visits the state, `of`.
    """
    quantity, detail = _cause(gap, index, names["geom"])
    kind = "step_acc" if gap.is_close("qacc", index) else "qacc"
    changes = np.abs(gap.sides[0][kind][index] - gap.sides[1][kind][index])
    dof = int(np.argmax(np.nan_to_num(changes, nan=np.inf)))
    for when, side in zip(WHEN, gap.sides, strict=True):
        place[f"acceleration_{when}"] = float(side[kind][index, dof])
        for name in ("contacts", "iterations", "warnings"):
            place[f"{name}_{when}"] = int(side[name][index])
    return Parting(
        step=step,
        quantity=quantity,
        detail=detail,
        where=names["dof"][dof],
        acceleration=float(gap.relative[index]),
        limit=float(gap.limit[index]),
        **place,
    )


def _cause(gap: Gap, index: int, geoms: list[str]) -> tuple[Quantity, str]:
    """Return what differs first in the order of computation, and both values in words."""
    before, after = (depths_m(side, index) for side in gap.sides)
    for pair in sorted({*before, *after}):
        first, second = before.get(pair, []), after.get(pair, [])
        title = " and ".join(geoms[geom] for geom in pair)
        if len(first) != len(second):
            text = f"{title}: {len(first)} and {len(second)} contacts"
            return Quantity.CONTACTS, text
        changes_m = np.abs(np.subtract(first, second))
        if np.max(changes_m) > DEPTH_TOLERANCE_M:
            contact = int(np.argmax(changes_m))
            depths_mm = (-1e3 * side[contact] for side in (first, second))
            text = " and ".join(f"{depth_mm:.6g}" for depth_mm in depths_mm)
            return Quantity.DEPTH, f"{title}: {text} mm"
    if not gap.is_close("smooth", index):
        return Quantity.SMOOTH, "the accelerations without contacts and limits differ"
    if not gap.is_close("qacc", index):
        counts = " and ".join(str(side["iterations"][index]) for side in gap.sides)
        text = f"equal contacts and other forces; the solver took {counts} iterations"
        return Quantity.CONSTRAINT, text
    return Quantity.STEP, "equal accelerations; the velocities after the step differ"


def pair_changes(gap: Gap, geoms: list[str]) -> tuple[PairChange, ...]:
    """Return the pairs of geoms whose contacts differ in number or depth, the largest change first."""
    changes = []
    both = np.concatenate([side["contact_pair"] for side in gap.sides])
    for pair in np.unique(both, axis=0):
        values: dict[str, Any] = {}
        for when, side in zip(WHEN, gap.sides, strict=True):
            is_pair = np.all(side["contact_pair"] == pair, axis=1)
            depths_m = -side["contact_dist"][is_pair]
            values[f"states_{when}"] = len(np.unique(side["contact_state"][is_pair]))
            values[f"contacts_{when}"] = len(depths_m)
            values[f"depth_{when}_m"] = float(np.max(depths_m, initial=0.0))
        names = (geoms[pair[0]], geoms[pair[1]])
        change = PairChange(pair=names, states=len(gap.relative), **values)
        deepening_m = abs(change.depth_before_m - change.depth_after_m)
        count = abs(change.contacts_before - change.contacts_after)
        if count or deepening_m > 10.0 * DEPTH_TOLERANCE_M:
            changes.append((count, change))
    changes.sort(key=lambda each: -each[0])
    return tuple(change for _, change in changes)


# --- fields and final positions --------------------------------------------------------------------------------------


def field_changes(
    before: Mapping[str, Any], after: Mapping[str, Any], names: Mapping[str, list[str]]
) -> Iterator[FieldChange]:
    """Yield the compiled fields of two sides that differ.

    Args:
        before: Fields of the first side.
        after: Fields of the second side.
        names: Names of the objects that the rows of fields describe.
    """
    for name in before:
        if name in after:
            sides = np.array(before[name]), np.array(after[name])
            yield from _field_change(name, *sides, names)


def _field_change(
    name: str, before: FloatArray, after: FloatArray, names: Mapping[str, list[str]]
) -> Iterator[FieldChange]:
    """Yield the row of a field that differs most, and how many differ; nothing if none does."""
    where, count = "", 1
    if before.shape == after.shape:
        size = before != after
        if before.dtype.kind == "f":
            is_close = np.isclose(
                before, after, rtol=FIELD_TOLERANCE, atol=1e-12, equal_nan=True
            )
            size = np.where(is_close, 0.0, np.abs(before - after))
        if not np.any(size):
            return
        if not name.startswith("opt."):
            rows = size.reshape(len(size), -1).max(axis=1)
            row, count = int(np.argmax(rows)), int(np.count_nonzero(rows))
            kind = OWNERS.get(name.partition("_")[0], "")
            owners = names.get(kind, [])
            where = owners[row] if len(owners) == len(rows) else f"row {row}"
            before, after = before[row], after[row]
    yield FieldChange(
        field=name,
        where=where,
        count=count,
        before=before.tolist(),
        after=after.tolist(),
    )


def settled(
    before: list[Any], after: list[Any], bodies: list[str]
) -> Iterator[Settled]:
    """Yield the segments that end differently, by more than a velocity 1e-10 apart changes.

    Args:
        before: Descriptions of the segments by the worker of the first side.
        after: Those of the second side.
        bodies: Names of the bodies.
    """
    for first, second in zip(before, after, strict=True):
        change_m = np.subtract(first["positions_m"], second["positions_m"])
        distance_m = np.linalg.norm(change_m, axis=1)
        noise_m = float(np.fmax(first["noise_m"], second["noise_m"]))
        body = int(np.argmax(np.nan_to_num(distance_m, nan=np.inf)))
        if distance_m[body] > max(END_TOLERANCE_M, NOISE_FACTOR * noise_m):
            values: dict[str, Any] = {
                name.format(when): end[key][body]
                for key, name in FINAL.items()
                for when, end in zip(WHEN, (first, second), strict=True)
            }
            yield Settled(
                segment=first["segment"],
                body=bodies[body],
                difference_m=float(distance_m[body]),
                noise_m=noise_m,
                **values,
            )
