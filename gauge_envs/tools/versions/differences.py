"""What differs between two versions in one step from the same states."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from typing import Any

import numpy as np

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.versions.environments import Arrays
from gauge_envs.tools.versions.schema import Parting, Quantity

MIN_LIMIT = 1e-6
"""Smallest difference of accelerations that counts, over the larger one. With constraints the limit is at least the
square root of the solver's tolerance, 1e-4 by default."""

NOISE_FACTOR = 10.0
"""Differences below this multiple of the noise of a state do not count."""

DEPTH_TOLERANCE_M = 1e-7
"""Difference of depths that counts [m]; convex solvers stop at 1e-6."""


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
        # At rest the acceleration is 0; the acceleration without constraints, gravity, remains.
        accelerations = [
            side[name] for side in sides for name in ("qacc", "smooth", "step_acc")
        ]
        scale = np.fmax.reduce(np.linalg.norm(accelerations, axis=2), initial=1e-9)

        def distance(first: FloatArray, second: FloatArray) -> FloatArray:
            """Return a relative distance; 2, its maximum, where one side is not a number."""
            norm = np.linalg.norm(first - second, axis=1)
            return np.nan_to_num(norm / scale, nan=2.0)

        self.relative = np.fmax(
            distance(*self.pair("qacc")), distance(*self.pair("step_acc"))
        )
        noises = [
            np.fmax(
                distance(side["qacc"], side["perturbed"]),
                distance(side["qacc"], side["cold"]),
            )
            for side in sides
        ]
        self.noise = np.fmin(*noises)
        limits = [NOISE_FACTOR * self.noise, *self.pair("solver_error")]
        self.limit = np.fmax(np.fmax.reduce(limits), MIN_LIMIT)
        self.differs = self.relative > self.limit

    def pair(self, name: str, index: Any = ...) -> tuple[FloatArray, FloatArray]:
        """Return an array of both sides, or its values in a state."""
        first, second = self.sides
        return first[name][index], second[name][index]

    @property
    def distance(self) -> float:
        """Root mean square of the differences that count."""
        counted = np.where(self.differs, np.minimum(self.relative, 2.0), 0.0)
        return float(np.sqrt(np.mean(counted**2)))

    def worst(self, count: int) -> list[int]:
        """Return the indices of the states that differ most, the largest difference first."""
        indices = np.flatnonzero(self.differs)
        order = np.argsort(-self.relative[indices], kind="stable")
        return indices[order[:count]].tolist()

    def is_close(self, name: str, index: int) -> bool:
        """Return whether both sides computed the same in a state, up to rounding."""
        first, second = self.pair(name, index)
        size = max(np.linalg.norm(first), np.linalg.norm(second))
        return bool(np.linalg.norm(first - second) <= MIN_LIMIT / 10.0 * size)


def distances_m(side: Arrays, index: int) -> dict[tuple[int, int], list[float]]:
    """Return the sorted distances of the contacts of a state [m], by pair of geoms."""
    distances: dict[tuple[int, int], list[float]] = defaultdict(list)
    touching = side["touching"]
    for _, first, second, distance_m in touching[touching[:, 0] == index].tolist():
        distances[int(first), int(second)].append(distance_m)
    return {pair: sorted(values) for pair, values in distances.items()}


def parting(
    gap: Gap, index: int, states: Arrays, names: Mapping[str, list[str]]
) -> Parting:
    """Return how two sides differ in a state.

    Args:
        gap: The differences.
        index: The state.
        states: Segment and step of each state, and the side that visits it, `of`.
        names: Names of geoms and degrees of freedom.
    """
    quantity, detail = _cause(gap, index, names["geom"])
    kind = "step_acc" if gap.is_close("qacc", index) else "qacc"
    first, second = gap.pair(kind, index)
    dof = int(np.argmax(np.nan_to_num(np.abs(first - second), nan=np.inf)))
    place = {name: states[name][index].item() for name in ("segment", "step", "of")}
    for when, side in zip(("before", "after"), gap.sides, strict=True):
        place[f"acceleration_{when}"] = float(side[kind][index, dof])
        for name in ("contacts", "iterations", "warnings"):
            place[f"{name}_{when}"] = int(side[name][index])
    return Parting(
        quantity=quantity,
        detail=detail,
        where=names["dof"][dof],
        acceleration=float(gap.relative[index]),
        limit=float(gap.limit[index]),
        **place,
    )


def _cause(gap: Gap, index: int, geoms: list[str]) -> tuple[Quantity, str]:
    """Return what differs first in the order of computation, and both values in words."""
    before, after = (distances_m(side, index) for side in gap.sides)
    for pair in sorted({*before, *after}):
        first, second = before.get(pair, []), after.get(pair, [])
        title = " and ".join(geoms[geom] for geom in pair)
        if len(first) != len(second):
            text = f"{title}: {len(first)} and {len(second)} contacts"
            return Quantity.CONTACTS, text
        changes_m = np.abs(np.subtract(first, second))
        contact = int(np.argmax(changes_m))
        if changes_m[contact] > DEPTH_TOLERANCE_M:
            depths_mm = (-1e3 * first[contact], -1e3 * second[contact])
            return Quantity.DEPTH, "{}: {:.6g} and {:.6g} mm".format(title, *depths_mm)
    if not gap.is_close("smooth", index):
        return Quantity.SMOOTH, "the accelerations without contacts and limits differ"
    if not gap.is_close("qacc", index):
        counts = " and ".join(map(str, gap.pair("iterations", index)))
        text = f"equal contacts and other forces; the solver took {counts} iterations"
        return Quantity.CONSTRAINT, text
    return Quantity.STEP, "equal accelerations; the velocities after the step differ"
