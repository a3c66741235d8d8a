"""Published scores of real trials and of three engines (paper, Table 5)."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import Field, PositiveInt, model_validator

from gauge_envs.references.metrics import MetricKey
from gauge_envs.references.tables import FileModel, read_rows, scoring_folder

PUBLISHED_ENGINES = {"isaacsim": "Isaac Sim", "genesis": "Genesis", "newton": "Newton"}
"""Titles of the engines whose scores were published, by column of the file."""


PUBLISHED_TRIALS = 20
"""Number of real trials of each task whose mean and standard deviation are published (paper, "Data Acquisition")."""


class Baseline(FileModel):
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
    metric: MetricKey
    frames: PositiveInt
    unit: str
    mean: float = Field(alias="baseline_mean")
    std: float | None = Field(alias="baseline_std")
    engines: dict[str, float | None]
    disputed: str

    @property
    def standard_uncertainty(self) -> float | None:
        """Standard uncertainty of the mean; None if no standard deviation was published."""
        return None if self.std is None else self.std / math.sqrt(PUBLISHED_TRIALS)

    @model_validator(mode="before")
    @classmethod
    def _of_row(cls, row: dict[str, Any]) -> dict[str, Any]:
        """Return the fields of a row of `engine_results.csv`, with percentages as ratios."""
        fields = dict(row)
        fields["engines"] = {engine: fields.pop(engine) for engine in PUBLISHED_ENGINES}
        fields["disputed"] = fields["disputed"] or ""
        if fields["unit"] == "percent":
            fields["unit"] = "1"
            for name in ("baseline_mean", "baseline_std"):
                fields[name] = float(fields[name]) / 100
        return fields


def published_baselines(variant: str) -> dict[str, Baseline]:
    """Return the published baselines of a variant by metric; empty if there are none."""
    return dict(_all_baselines(scoring_folder("published")).get(variant, {}))


@cache
def _all_baselines(folder: Path) -> dict[str, dict[str, Baseline]]:
    file = folder / "engine_results.csv"
    table: dict[str, dict[str, Baseline]] = {}
    for row in read_rows(file, Baseline):
        table.setdefault(row.variant, {})[row.metric] = row
    return table
