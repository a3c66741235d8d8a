"""Wrenches by which rods and grips hold a cloth or a foam, as solutions of the calibrated scenes give them.

`scoring/grips.json` holds them. Positions of driven material do not see mass and stiffness; the force that drives it
does.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Annotated

import numpy as np
from pydantic import Field, PositiveFloat, PositiveInt, TypeAdapter

from gauge_envs.references.tables import (
    FileModel,
    faults_of,
    read_content,
    scoring_folder,
)
from gauge_envs.scene.geometry import FloatArray

COMPONENTS = ("x", "y", "z", "torque x", "torque y", "torque z")
"""Names of the entries of a wrench."""


class _GripLoadRow(FileModel):
    """One quantity of `grips.json`; see `GripLoad`."""

    quantity: str
    unit: str
    bodies: Mapping[str, float]
    components: Annotated[tuple[str, ...], Field(min_length=1)]
    windows: Annotated[tuple[tuple[PositiveInt, PositiveInt], ...], Field(min_length=1)]
    mean: tuple[tuple[float, ...], ...]
    uncertainty: tuple[tuple[PositiveFloat, ...], ...]
    source: str


@dataclass(frozen=True, kw_only=True, eq=False)
class GripLoad:
    """A force or a torque of bodies on what they hold, in the mean over some windows of frames.

    Attributes:
        quantity: What it is, as `force of rod`.
        unit: `N` or `N m`.
        weights: Weight of each body's wrench in the sum, by name.
        components: Indices of the compared entries of a wrench, shape [C].
        windows: First and last frame of each of the W windows.
        mean: Value of the solution, shape [W, C].
        uncertainty: Its standard uncertainty, shape [W, C].
        source: Where the solution is from, one sentence.
    """

    quantity: str
    unit: str
    weights: Mapping[str, float]
    components: tuple[int, ...]
    windows: tuple[tuple[int, int], ...]
    mean: FloatArray
    uncertainty: FloatArray
    source: str

    def values(self, holders: tuple[str, ...], wrenches: FloatArray) -> FloatArray:
        """Return the load of an episode, shape [W, C]; NaN for a window that was not run.

        Args:
            holders: Names of the bodies.
            wrenches: Their wrenches in the mean over each frame, shape [frame_count, len(holders), 6].
        """
        weights = np.array([self.weights.get(name, 0.0) for name in holders])
        total = np.einsum("b,fbc->fc", weights, wrenches)[:, self.components]
        found = np.full(self.mean.shape, np.nan)
        for row, (first, last) in zip(found, self.windows, strict=True):
            if last < len(total):
                row[:] = total[first : last + 1].mean(axis=0)
        return found


@cache
def _loads() -> Mapping[str, tuple[GripLoad, ...]]:
    file = scoring_folder("grips.json")
    with faults_of(file):
        table = TypeAdapter(dict[str, tuple[_GripLoadRow, ...]]).validate_json(
            read_content(file)
        )
    return {
        variant: tuple(
            GripLoad(
                quantity=row.quantity,
                unit=row.unit,
                weights=row.bodies,
                components=tuple(COMPONENTS.index(name) for name in row.components),
                windows=row.windows,
                mean=np.array(row.mean),
                uncertainty=np.array(row.uncertainty),
                source=row.source,
            )
            for row in rows
        )
        for variant, rows in table.items()
    }


def solved_loads(variant: str) -> tuple[GripLoad, ...]:
    """Return the solved loads of a variant's calibrated scene; none for most variants."""
    return _loads().get(variant, ())
