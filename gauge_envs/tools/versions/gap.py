"""What two versions compute from the same states, and where they part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.scene.geometry import length_of
from gauge_envs.tools.versions.model import Parting, Quantity
from gauge_envs.tools.versions.processes import Arrays, Observed

LEAST_LIMIT = 1e-6
"""Smallest difference of accelerations that counts, over the larger one. With constraints it is the square root of the
solver's tolerance, 1e-4 for the default."""

NOISE_FACTOR = 10.0
"""Differences below this multiple of the noise of a state do not count."""

DEPTH_TOLERANCE_M = 1e-7
"""Difference of depths that counts [m]; convex solvers stop at 1e-6."""

VARIANTS = ("perturbed", "cold")
"""Accelerations from a start 1e-10 apart, and without a warm start."""


class Gap:
    """Differences of what two sides compute from the same states.

    Attributes:
        before, after: What each side computed.
        relative: Difference of the accelerations over the larger one, shape [states].
        noise: What a start 1e-10 apart and a solver without its warm start change, on the quieter side, shape [states].
        limit: Difference that counts, shape [states].
        differs: Where the difference counts, shape [states].
    """

    def __init__(self, before: Arrays, after: Arrays) -> None:
        self.before, self.after = before, after
        self._scale = np.full(len(before["qacc"]), 1e-9)
        for side in (before, after):
            # At rest the acceleration is 0: that without constraints, gravity, remains.
            for name in ("qacc", "smooth", "step_acc"):
                norm = np.linalg.norm(side[name], axis=1)
                self._scale = np.fmax(self._scale, norm)
        self.relative = np.fmax(
            self._over_scale(before["qacc"] - after["qacc"]),
            self._over_scale(before["step_acc"] - after["step_acc"]),
        )
        noises = []
        for side in (before, after):
            changes = [self._over_scale(side["qacc"] - side[name]) for name in VARIANTS]
            noises.append(np.fmax(*changes))
        self.noise = np.fmin(*noises)
        solver_error = np.fmax(before["solver_error"], after["solver_error"])
        self.limit = np.fmax(NOISE_FACTOR * self.noise, LEAST_LIMIT)
        self.limit = np.fmax(self.limit, solver_error)
        warned = before["warnings"] != after["warnings"]
        self.differs = (self.relative > self.limit) | warned

    def _over_scale(self, difference: NDArray[Any]) -> NDArray[Any]:
        # What is no number on one side is as different as can be.
        return np.nan_to_num(np.linalg.norm(difference, axis=1) / self._scale, nan=2.0)

    @property
    def is_identical(self) -> bool:
        """Whether both sides computed the same bits."""
        return all(np.array_equal(self.before[name], self.after[name]) for name in BITS)


BITS = ("qacc", "step_acc", "constraint", "contact_dist", "contact_pair")
"""Results whose bits are compared."""


def distance(one: Observed, two: Observed) -> float:
    """Return the root mean square of the differences of accelerations that count, in all states."""
    squares = []
    for first, second in zip(one.probes, two.probes, strict=True):
        gap = Gap(first, second)
        counted = np.where(gap.differs, np.minimum(gap.relative, 2.0), 0.0)
        squares.append(counted**2)
    return float(np.sqrt(np.mean(np.concatenate(squares))))


@dataclass(frozen=True, kw_only=True)
class Visit:
    """States that one side visits, and what both compute there.

    Attributes:
        gap: The differences.
        states: The states.
        title: Title of the side.
        segments: Names of the segments.
        names: Names of bodies, joints and geoms.
    """

    gap: Gap
    states: Arrays
    title: str
    segments: Sequence[str]
    names: Mapping[str, Sequence[str]]

    def first(self) -> Parting | None:
        """Return where the sides part first; None if they do not."""
        found = np.flatnonzero(self.gap.differs)
        return self._parting(int(found[0])) if len(found) else None

    def worst(self) -> Parting | None:
        """Return where the sides part most; None if they do not."""
        if not np.any(self.gap.differs):
            return None
        return self._parting(
            int(np.argmax(np.where(self.gap.differs, self.gap.relative, -1.0)))
        )

    def _parting(self, index: int) -> Parting:
        gap = self.gap
        name = "qacc" if self._differs(index, "qacc") else "step_acc"
        one, two = gap.before[name][index], gap.after[name][index]
        dof = int(np.argmax(np.abs(np.nan_to_num(one - two, nan=np.inf))))
        quantity, detail = self._cause(index)
        return Parting(
            segment=self.segments[int(self.states["segment"][index])],
            step=int(self.states["step"][index]),
            of=self.title,
            quantity=quantity,
            detail=detail,
            where=self.names["dof"][dof],
            acceleration=float(gap.relative[index]),
            limit=float(gap.limit[index]),
            acceleration_before=float(one[dof]),
            acceleration_after=float(two[dof]),
            contacts_before=int(gap.before["contacts"][index]),
            contacts_after=int(gap.after["contacts"][index]),
            iterations_before=int(gap.before["iterations"][index]),
            iterations_after=int(gap.after["iterations"][index]),
            warnings_before=int(gap.before["warnings"][index]),
            warnings_after=int(gap.after["warnings"][index]),
        )

    def _differs(self, index: int, name: str) -> bool:
        """Return whether accelerations of a kind part at a state by more than rounding."""
        one, two = self.gap.before[name][index], self.gap.after[name][index]
        size = max(length_of(one), length_of(two))
        return not np.allclose(one, two, rtol=0.0, atol=LEAST_LIMIT / 10.0 * size)

    def _cause(self, index: int) -> tuple[Quantity, str]:
        """Return what parts first in the order of computation, and both values in words."""
        depths = [depths_m(side, index) for side in (self.gap.before, self.gap.after)]
        for pair in sorted({*depths[0], *depths[1]}):
            one, two = (found.get(pair, []) for found in depths)
            names = " and ".join(self.names["geom"][geom] for geom in pair)
            if len(one) != len(two):
                return Quantity.CONTACTS, f"{names}: {len(one)} and {len(two)} contacts"
            change = np.abs(np.subtract(one, two))
            if np.max(change) > DEPTH_TOLERANCE_M:
                at = int(np.argmax(change))
                depths_mm = pair_text(-1e3 * one[at], -1e3 * two[at], digits=4)
                return Quantity.DEPTH, f"{names}: {depths_mm} mm"
        if self._differs(index, "smooth"):
            return Quantity.SMOOTH, "without contacts and limits the accelerations part"
        if self._differs(index, "qacc"):
            iterations = [
                int(side["iterations"][index])
                for side in (self.gap.before, self.gap.after)
            ]
            return Quantity.CONSTRAINT, (
                "the same contacts and forces beside them; the solver took "
                f"{iterations[0]} and {iterations[1]} iterations"
            )
        return Quantity.STEP, "the same accelerations; the velocities after it part"


EXACT_DIGITS = 17
"""Digits that tell any two numbers apart."""


def pair_text(one: float, two: float, digits: int = 3) -> str:
    """Return two numbers with the digits that tell them apart, and at least as many as stated."""
    if one != two:
        while digits < EXACT_DIGITS and f"{one:.{digits}g}" == f"{two:.{digits}g}":
            digits += 1
    return f"{one:.{digits}g} and {two:.{digits}g}"


def depths_m(side: Arrays, index: int) -> dict[tuple[int, int], list[float]]:
    """Return the sorted distances of the contacts of a state [m], by pair of geoms."""
    found: dict[tuple[int, int], list[float]] = {}
    for row in np.flatnonzero(side["contact_state"] == index):
        first, second = side["contact_pair"][row]
        pair = (int(first), int(second))
        found.setdefault(pair, []).append(float(side["contact_dist"][row]))
    return {pair: sorted(distances) for pair, distances in found.items()}
