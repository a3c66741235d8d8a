"""List the reference, the drivers and the baselines of each variant."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from gauge_envs.evaluation.reference import band_grade, load_band
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.task_files import task_sha256
from gauge_envs.experiments.variants import Variant
from gauge_envs.files import json_ready
from gauge_envs.references.bands import bundled_sidecar
from gauge_envs.references.imported import DataSource, load_imported
from gauge_envs.references.published import published_baselines


def status_rows(variants: Iterable[Variant]) -> list[dict[str, Any]]:
    """Return one JSON-ready row per variant.

    Keys: `id`, `grade`, `imported`, `trials`, `revision`, `is_current` (whether the task file is unchanged since the
    import; None without an import), `drivers` (body, provenance, and the record of an imported driver) and `baselines`
    (metric, own and published mean and standard deviation).
    """
    return [_row(variant) for variant in variants]


def _row(variant: Variant) -> dict[str, Any]:
    imported = load_imported(variant.name)
    source = DataSource.BUNDLED if imported is None else DataSource.IMPORTED
    experiment, band = load_experiment(variant, drivers=source), load_band(variant.name, source)
    record = imported.record if imported else None
    recorded = {driver.body: driver.model_dump() for driver in record.drivers} if record else {}
    return json_ready(
        {
            "id": variant.id,
            "grade": band_grade(variant.name, source).value,
            "imported": record is not None,
            "trials": band.trial_count if band else None,
            "revision": record.revision if record else None,
            "is_current": record.task_sha256 == task_sha256(variant.family) if record else None,
            "drivers": [
                {"body": driver.body, "provenance": driver.provenance, "recorded": recorded.get(driver.body)}
                for driver in experiment.scene.drivers
            ],
            "baselines": _baselines(variant),
        }
    )


def _baselines(variant: Variant) -> list[dict[str, Any]]:
    """Return mean and standard deviation of each metric: own are those of the trials of the band."""
    published, imported = published_baselines(variant.name), load_imported(variant.name)
    sidecar = bundled_sidecar(variant.name) if imported is None else None
    scores = {} if sidecar is None else {"rmse": sidecar.rmse, "dtw": sidecar.dtw}
    own = imported.record.metrics if imported else {metric: score for metric, score in scores.items() if score}
    return [
        {
            "metric": metric,
            **{
                f"{whose}_{key}": getattr(spreads.get(metric), key, None)
                for whose, spreads in (("own", own), ("published", published))
                for key in ("mean", "std")
            },
        }
        for metric in dict.fromkeys([*published, *own])
    ]
