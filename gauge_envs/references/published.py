"""Published scores of real trials and of three engines (paper, Table 5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from pydantic import PositiveInt

from gauge_envs.references.metrics import MetricKey
from gauge_envs.references.tables import FileModel, read_rows, scoring_folder

PUBLISHED_ENGINES = {"isaacsim": "Isaac Sim", "genesis": "Genesis", "newton": "Newton"}
"""Titles of the engines whose scores were published, by column of the file."""


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
        disputed: Why some of these scores contradict the geometry of g(t); empty if none does.
    """

    variant: str
    metric: str
    frames: int
    unit: str
    mean: float
    std: float | None
    engines: Mapping[str, float | None]
    disputed: str


def published_baselines(variant: str) -> dict[str, Baseline]:
    """Return the published baselines of a variant by metric; empty if there are none."""
    return dict(_all_baselines(scoring_folder("published")).get(variant, {}))


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
    disputed: str | None

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
            engines={engine: getattr(self, engine) for engine in PUBLISHED_ENGINES},
            disputed=self.disputed or "",
        )


@cache
def _all_baselines(folder: Path) -> dict[str, dict[str, Baseline]]:
    file = folder / "engine_results.csv"
    table: dict[str, dict[str, Baseline]] = {}
    for row in read_rows(file, _BaselineRow):
        table.setdefault(row.variant, {})[row.metric] = row.baseline()
    return table
