"""What the published scatter of real trials tells: of bodies that start free, and of cloth and foam that is held.

`scoring/scatter.csv` has the test of each variant with starts that scatter. Held cloth and foam have none; for these
`scoring/scatter_held.csv` has the noise of markers and the late releases that would scatter as much.
"""

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


class HeldRow(FileModel):
    """What would scatter as real trials of a held cloth or foam do, by one run of MuJoCo.

    Attributes:
        variant: Variant id.
        unit: Unit of the distances.
        real: Published numbers of real trials, by `rmse`, `rmse_std`, `dtw` and `dtw_std`.
        motion: Root mean square of g(t) about its mean over the frames.
        noise_mm: Standard deviation of white noise of each marker coordinate that gives the real mean E_RMSE [mm].
        noise_dtw: E_DTW with it.
        still_mm: The noise that a body needs which does not move [mm].
        release_s: Spread of the release, late by |N(0, s)|, that gives the real mean E_RMSE [s]; None if none does.
    """

    variant: str
    unit: str
    real: Mapping[str, float]
    motion: float
    noise_mm: float
    noise_dtw: float
    still_mm: float
    release_s: float | None

    @property
    def noise_std_mm(self) -> float:
        """Standard deviation of the noise among trials that gives the real one of E_RMSE [mm]."""
        return self.noise_mm * self.real["rmse_std"] / self.real["rmse"]


HELD_COLUMNS = (
    "variant",
    "unit",
    *(f"real.{name}" for name in NUMBERS),
    *("motion", "noise_mm", "noise_dtw", "still_mm", "release_s"),
)
"""Columns of the file of held bodies."""


def held_file() -> Path:
    """Return the file of held bodies."""
    return scoring_folder("scatter_held.csv")


@cache
def held_rows() -> Mapping[str, HeldRow]:
    """Return the rows of held bodies by variant."""
    rows = read_rows(held_file(), HELD_COLUMNS, HeldRow)
    return {row.variant: row for _, row in rows}


@cache
def scatter_rows() -> Mapping[str, ScatterRow]:
    """Return the rows by variant."""
    rows = read_rows(scatter_file(), SCATTER_COLUMNS, ScatterRow)
    return {row.variant: row for _, row in rows}
