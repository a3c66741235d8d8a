"""Known limits of single experiments, and what their episodes cost: findings that are no part of an experiment."""

from __future__ import annotations

from fnmatch import fnmatchcase

from pydantic import Field, PositiveFloat, PositiveInt

from gauge_envs.files import data_folder
from gauge_envs.references.tables import FileModel, read_rows, read_toml


class Limit(FileModel):
    """What is known to be wrong or uncertain of some experiments.

    Attributes:
        variants: Patterns of variants.
        text: One or two sentences.
        study: Folder of `studies/` that has the numbers, or None.
    """

    variants: tuple[str, ...] = Field(min_length=1)
    text: str
    study: str | None = None


class _Limits(FileModel):
    limit: tuple[Limit, ...]


class Cost(FileModel):
    """Measured processor time of the episodes of a family on an engine, over the simulated time [s/s].

    Attributes:
        engine: Name of the engine.
        family: Name of the family.
        ids: Number of variants that were measured.
        least: Smallest cost among them.
        most: Largest cost among them.
    """

    engine: str
    family: str
    ids: PositiveInt
    least: PositiveFloat
    most: PositiveFloat


def all_limits() -> tuple[Limit, ...]:
    """Return all known limits."""
    return read_toml(data_folder("scoring") / "limits.toml", _Limits).limit


def known_limits(variant: str) -> tuple[Limit, ...]:
    """Return the known limits of a variant, as `SlopeSlider-2-wood`."""
    return tuple(one for one in all_limits() if any(fnmatchcase(variant, pattern) for pattern in one.variants))


def episode_costs(family: str) -> dict[str, Cost]:
    """Return what episodes of a family cost, by engine; engines that were not measured are absent."""
    file = data_folder("scoring") / "costs.csv"
    rows = (row for _, row in read_rows(file, list(Cost.model_fields), Cost))
    return {row.engine: row for row in rows if row.family == family}
