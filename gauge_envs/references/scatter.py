"""What is known of the scatter test of each variant on MuJoCo (`scoring/scatter.csv`)."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path

from gauge_envs.references.tables import FileModel, read_rows, scoring_folder


class ScatterRow(FileModel):
    """The scatter test of a variant on MuJoCo, and how often it tells a fault.

    Attributes:
        variant: Variant id.
        unit: Unit of the distances.
        runs: Number of runs with each spread of the starts.
        real: Published numbers of real trials, by `rmse`, `rmse_std`, `dtw` and `dtw_std`.
        simulated: The same of runs with the assumed spread of starts.
        release_s: Spread of the release that fits best, with these starts [s].
        p: p-value with `half`, `once` and `twice` the assumed spread of starts, and with `uneven` trials.
        refused: Share of simulated realities that the test refuses with the assumed spread, by their fault; None for a
            fault that the scene cannot have. That of `none`, of no fault, is the size of the test.
        told: The same where it refuses with every spread, as the verdict needs.
        factor: Smallest factor of the mean and standard deviation of E_DTW, of 1.25 to 4, that it tells in 80 % of
            realities; None without one.
    """

    variant: str
    unit: str
    runs: int
    real: Mapping[str, float]
    simulated: Mapping[str, float]
    release_s: float
    p: Mapping[str, float]
    refused: Mapping[str, float | None]
    told: Mapping[str, float | None]
    factor: float | None


NUMBERS = ("rmse", "rmse_std", "dtw", "dtw_std")
FAULTS = ("none", "friction", "rebound", "place", "release")
SCATTER_COLUMNS = (
    "variant",
    "unit",
    "runs",
    *(f"{group}.{name}" for group in ("real", "simulated") for name in NUMBERS),
    "release_s",
    *(f"p.{name}" for name in ("half", "once", "twice", "uneven")),
    *(f"{group}.{name}" for group in ("refused", "told") for name in FAULTS),
    "factor",
)
"""Columns of the file."""


def scatter_file() -> Path:
    """Return the file."""
    return scoring_folder("scatter.csv")


@cache
def scatter_rows() -> Mapping[str, ScatterRow]:
    """Return the rows by variant."""
    rows = read_rows(scatter_file(), SCATTER_COLUMNS, ScatterRow)
    return {row.variant: row for _, row in rows}
