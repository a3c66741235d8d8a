"""What a reference can tell: how far an episode moves as one constant of its scene is changed (`scoring/power.csv`)."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path

from gauge_envs.references.tables import FileModel, read_rows, scoring_folder

POWER_COLUMNS = ("variant", "change", "distance", "unit", "quantity")
"""Columns of the file."""


class PowerRow(FileModel):
    """One change of a scene.

    Attributes:
        variant: Variant id.
        change: What is changed, as `friction off` or `density x 0.8`.
        distance: Distance between the motions with and without the change, in the norm of the score; None for a scene
            that fails with the change.
        unit: Unit of the distance.
        quantity: Load of a rod or grip that is compared; None for what the score is of.
    """

    variant: str
    change: str
    distance: float | None
    unit: str
    quantity: str | None = None


def power_file() -> Path:
    """Return the file of the distances."""
    return scoring_folder("power.csv")


@cache
def _rows() -> Mapping[str, tuple[PowerRow, ...]]:
    table: dict[str, list[PowerRow]] = {}
    for _, row in read_rows(power_file(), list(POWER_COLUMNS), PowerRow):
        table.setdefault(row.variant, []).append(row)
    return {variant: tuple(rows) for variant, rows in table.items()}


def power_rows(variant: str, quantity: str | None = None) -> tuple[PowerRow, ...]:
    """Return the changes of a variant's scene that were measured; none for a variant without a reference.

    Args:
        variant: Variant id.
        quantity: Load of a rod or grip; None for what the score is of.
    """
    return tuple(row for row in _rows().get(variant, ()) if row.quantity == quantity)
