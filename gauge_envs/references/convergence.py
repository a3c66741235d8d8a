"""Convergence: the change of an episode with half the time step, half the cells, or the training preset.

It is in `scoring/convergence/<engine>.csv`. A missing row was not measured.
"""

from functools import cache
from pathlib import Path
from typing import Any, Literal, get_args

from pydantic import NonNegativeFloat, PositiveFloat

from gauge_envs.references.tables import FileModel, read_rows, scoring_folder

RefinedSetting = Literal["timestep_s", "cell_m", "training"]
"""Setting that differs: the time step or the edge of the cells of a deformable body, halved, or preset `training`."""


class Convergence(FileModel):
    """Difference between an episode with default settings and one with other settings, over all frames.

    The distance of one frame is Euclidean over the coordinates of g(t), as in the paper's RMSE. Deformable bodies are
    observed at the material points of their markers.

    Attributes:
        variant: Variant id, as in `SlopeSlider-2-wood`.
        setting: Setting that differs: `timestep_s` [s], `cell_m` [m], or `training`, the preset.
        default: Its value in the default run; for a mesh with several edges, the smallest edge of its cells. For
            `training`, the environment steps per second of processor time, both runs in turn on one core.
        refined: Its value in the other run.
        unit: Unit of rms and max.
        rms: Root mean square of the distance over frames; None if one of the runs diverged.
        max: Largest distance of a frame; None if one of the runs diverged.
        share: `rms` over the scatter of real trials, the mean of their published RMSE; None if none was published.
        points_rms_mm: Root mean square distance of the observed points over frames and points [mm].
        points_max_mm: Largest distance of an observed point [mm].
    """

    variant: str
    setting: RefinedSetting
    default: PositiveFloat
    refined: PositiveFloat
    unit: str
    rms: NonNegativeFloat | None = None
    max: NonNegativeFloat | None = None
    share: NonNegativeFloat | None = None
    points_rms_mm: NonNegativeFloat | None = None
    points_max_mm: NonNegativeFloat | None = None


@cache
def read_convergence(file: Path) -> dict[tuple[str, RefinedSetting], Convergence]:
    """Return the rows of a table by variant and setting."""
    return {(row.variant, row.setting): row for row in read_rows(file, Convergence)}


def convergence_rows(engine: str | None, name: str) -> dict[str, dict[str, Any]]:
    """Return the measured convergence of an experiment on an engine, JSON-ready, by the setting that differs.

    Args:
        engine: Name of the engine; None for a trajectory file, which has no rows.
        name: Id or name of the experiment.
    """
    file = scoring_folder("convergence") / f"{engine}.csv"
    rows = read_convergence(file) if file.is_file() else {}
    variant = name.removeprefix("GAUGE/")
    return {
        setting: rows[variant, setting].model_dump()
        for setting in get_args(RefinedSetting)
        if (variant, setting) in rows
    }
