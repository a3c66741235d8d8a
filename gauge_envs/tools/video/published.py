"""Read the published results of video models: Table 3 of GAUGE's paper, ten configurations of six models."""

from __future__ import annotations

import csv
from functools import cache

from gauge_envs.references.tables import scoring_folder

PUBLISHED_NAMES = {"a": "a_m_s2", "qfi": "qfi", "r2": "r2", "pd": "pd_s", "mte": "mte", "de": "de_n"}
"""Names of the metrics in this package by those of the table."""


@cache
def published_results() -> dict[str, dict[tuple[str, str], float | None]]:
    """Return the published values by model and by task and metric; None where the paper prints a dash."""
    found: dict[str, dict[tuple[str, str], float | None]] = {}
    with (scoring_folder("published") / "world_model_results.csv").open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            key = (row.pop("variant"), PUBLISHED_NAMES[row.pop("metric")])
            for name in ("real_baseline", "unit"):
                row.pop(name, None)
            for model, text in row.items():
                found.setdefault(model, {})[key] = float(text) if text else None
    return found
