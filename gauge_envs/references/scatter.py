"""What the published scatter of real trials tells: of bodies that start free, and of cloth and foam that is held.

`scoring/scatter.csv` has the test of each variant with starts that scatter, and `scoring/scatter_held.csv` that of held
cloth and foam, whose driven bodies are misplaced and late instead, with what each cause gives alone.
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
ASSUMPTIONS = ("half", "once", "twice", "uneven")
FAULTS = ("none", "friction", "rebound", "place", "release")
SCATTER_COLUMNS = (
    "variant",
    "unit",
    "runs",
    *(f"{group}.{name}" for group in ("real", "simulated") for name in NUMBERS),
    "release_s",
    *(f"p.{name}" for name in ASSUMPTIONS),
    *(f"{group}.{name}" for group in ("refused", "told") for name in FAULTS),
    "factor",
)
"""Columns of the file."""


def scatter_file() -> Path:
    """Return the file."""
    return scoring_folder("scatter.csv")


class HeldRow(FileModel):
    """The scatter test of a held cloth or foam on MuJoCo, what each assumed cause gives alone, and what it tells.

    Attributes:
        variant: Variant id.
        unit: Unit of the distances.
        real: Published numbers of real trials, by `rmse`, `rmse_std`, `dtw` and `dtw_std`.
        place: The same of runs whose driven body is misplaced by the jitter.
        late: The same of runs whose drive starts late.
        noise: The same of markers with noise of 0.1 mm.
        noise_mm: Noise of the markers that gives the real mean E_RMSE, beside the other causes [mm].
        p, refused, told: As of `ScatterRow`, by the faults of `HELD_FAULTS`.
    """

    variant: str
    unit: str
    real: Mapping[str, float]
    place: Mapping[str, float]
    late: Mapping[str, float]
    noise: Mapping[str, float]
    noise_mm: float
    p: Mapping[str, float]
    refused: Mapping[str, float | None]
    told: Mapping[str, float | None]


CAUSES = ("place", "late", "noise")
HELD_FAULTS = ("none", "frozen", "stiffness", "density", "friction", "place", "late")
HELD_COLUMNS = (
    "variant",
    "unit",
    *(f"{group}.{name}" for group in ("real", *CAUSES) for name in NUMBERS),
    "noise_mm",
    *(f"p.{name}" for name in ASSUMPTIONS),
    *(f"{group}.{name}" for group in ("refused", "told") for name in HELD_FAULTS),
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
