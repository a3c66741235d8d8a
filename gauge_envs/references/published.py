"""Published scores of real trials and of three engines, and laws that give the real outcome of a variant."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, PositiveInt

from gauge_envs.errors import ReferenceFileError, ShapeError, UnknownNameError
from gauge_envs.references.bands import Band, BandGrade, SigmaSource
from gauge_envs.references.metrics import MetricKey
from gauge_envs.references.tables import FileModel, read_rows, read_toml, scoring_folder

__all__ = [
    "ENGINES",
    "Baseline",
    "Law",
    "Reference",
    "carried_band",
    "law_for",
    "published_baselines",
    "published_variants",
]

ENGINES = ("isaacsim", "genesis", "newton")
"""Engines whose scores were published."""


@dataclass(frozen=True)
class Baseline:
    """One row of the published results (paper, Table 5): scores of real trials and of three engines.

    Attributes:
        variant: Variant id, as in `SlopeSlider-2-wood`.
        metric: `rmse`, `dtw`, `lsd`, `mte`, `pd` or `el`.
        frames: Number of 30 Hz frames that were evaluated.
        unit: Unit of mean and std: `mm`, `rad`, `mm^2`, `s` or `1`. MTE is a ratio here, a percentage in the paper.
        mean: Mean over real trials.
        std: Standard deviation over real trials; None if none was published.
        engines: Published score of `isaacsim`, `genesis` and `newton` over `mean`; None if none was published. For el
            it is the raw score, as the mean is 0.
    """

    variant: str
    metric: str
    frames: int
    unit: str
    mean: float
    std: float | None
    engines: Mapping[str, float | None]


def published_baselines(variant: str) -> dict[str, Baseline]:
    """Return the published baselines of a variant by metric, which may be none.

    Raises:
        ReferenceFileError: The table is damaged.
    """
    return dict(_all_baselines(scoring_folder("published")).get(variant, {}))


def published_variants() -> tuple[str, ...]:
    """Return the variants with a published baseline, in the order of the paper's Table 5."""
    return tuple(_all_baselines(scoring_folder("published")))


class _BaselineRow(FileModel):
    """One row of `engine_results.csv`; its fields are the columns."""

    variant: str
    frames: PositiveInt
    metric: MetricKey
    unit: str
    baseline_mean: float
    baseline_std: float | None
    isaacsim: float | None
    genesis: float | None
    newton: float | None

    def baseline(self) -> Baseline:
        """Return the row with percentages as ratios."""
        percent = self.unit == "percent"
        mean, std = self.baseline_mean, self.baseline_std
        return Baseline(
            variant=self.variant,
            metric=self.metric,
            frames=self.frames,
            unit="1" if percent else self.unit,
            mean=mean / 100 if percent else mean,
            std=std / 100 if percent and std is not None else std,
            engines={engine: getattr(self, engine) for engine in ENGINES},
        )


@cache
def _all_baselines(folder: Path) -> dict[str, dict[str, Baseline]]:
    file = folder / "engine_results.csv"
    table: dict[str, dict[str, Baseline]] = {}
    for line, row in read_rows(file, list(_BaselineRow.model_fields), _BaselineRow):
        metrics = table.setdefault(row.variant, {})
        if row.metric in metrics:
            raise ReferenceFileError(file, line, f"{row.variant} has a second row for {row.metric}")
        metrics[row.metric] = row.baseline()
    return table


@dataclass(frozen=True, eq=False)
class Reference:
    """Reference that an experiment file states.

    Attributes:
        band: Mean and scatter of reality; None without a band.
        baselines: Scores of real trials by metric; normalized scores are divided by their mean.
    """

    band: Band | None
    baselines: Mapping[str, Baseline]


class Law(FileModel):
    """A closed form that gives the real outcome of some variants (`scoring/bands/laws.toml`).

    Attributes:
        variants: Shell-style pattern of the variants that it covers.
        kind: `carried`: the body keeps its place on a carrier, which moves as the scene's driver states.
        body: Name of the body whose motion the law gives.
        carrier: Name of the body that carries it.
        condition: Condition under which the law holds, with its numbers.
        evidence: Published results that support it.
    """

    variants: str
    kind: Literal["carried"]
    body: str
    carrier: str
    condition: str
    evidence: str


class _Laws(FileModel):
    """The file `laws.toml`."""

    law: Annotated[tuple[Law, ...], Field(min_length=1)]


def law_for(variant: str) -> Law | None:
    """Return the law that gives the real outcome of a variant, or None.

    A law needs the published scatter of the variant's trials. A new material, which nobody has measured, has no law.

    Raises:
        ReferenceFileError: The table of laws or of published scores is damaged.
    """
    if "rmse" not in published_baselines(variant):
        return None
    return next((law for law in _all_laws(scoring_folder("bands")) if fnmatchcase(variant, law.variants)), None)


def carried_band(*, variant: str, positions_mm: ArrayLike) -> Band:
    """Return the band of a rigidly carried body: the given mean, and sigma from the published baseline.

    Sigma is constant in time. The mean over trials of the squared E_RMSE is the time-averaged variance of the vector
    deviation, so sigma_rms^2 = mean^2 + std^2 of the published E_RMSE. This is exact if all three divide by the number
    of trials n. If std and sigma divide by n - 1, sigma_rms^2 is larger by mean^2 / (n - 1). That term is left out, as
    n is not published; for n = 20, sigma is then at most 2.6 % too small. The split of the variance over x, y and z is
    not published either. It is taken as equal, sigma_rms / sqrt(3) each.

    Args:
        variant: Variant with a law of kind `carried`.
        positions_mm: Position of the carried body by the law and the scene's driver [mm], shape [published frame
            count, 3].

    Returns:
        Band of grade `law` over x, y and z [mm]. Every frame counts as measured.

    Raises:
        UnknownNameError: The variant has no such law.
        ShapeError: `positions_mm` has another shape, or is not finite.
    """
    law, baseline = law_for(variant), published_baselines(variant).get("rmse")
    if law is None or baseline is None:
        raise UnknownNameError("carried variant", variant, filter(law_for, published_variants()))
    positions = np.asarray(positions_mm, dtype=np.float64)
    if positions.shape != (baseline.frames, 3):
        raise ShapeError(f"positions_mm has shape {positions.shape}; {(baseline.frames, 3)} is needed for {variant}")
    if not np.isfinite(positions).all():
        raise ShapeError("positions_mm holds a value that is not finite")
    sigma_rms = math.hypot(baseline.mean, baseline.std or 0.0)
    return Band(
        grade=BandGrade.LAW,
        sigma_source=SigmaSource.BASELINE,
        unit=baseline.unit,
        coordinates=("x", "y", "z"),
        projection=np.eye(3),
        mean=positions,
        sigma=np.full(positions.shape, sigma_rms / math.sqrt(3)),
        measured=np.ones(len(positions), dtype=bool),
        trial_count=None,
        source=f"{law.body} carried by {law.carrier}, {law.condition}; sigma from the paper's Table 5",
    )


@cache
def _all_laws(folder: Path) -> tuple[Law, ...]:
    return read_toml(folder / "laws.toml", _Laws).law
