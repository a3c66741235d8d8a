"""The registry of metrics agrees with the score, with the published table and with the tables of files."""

from typing import get_args

from gauge_envs.references.metrics import METRICS, MetricKey
from gauge_envs.references.published import published_baselines, published_variants


def test_units_are_those_of_the_published_table():
    rows = [
        row
        for variant in published_variants()
        for row in published_baselines(variant).values()
    ]
    assert {row.metric for row in rows} == set(METRICS)
    for row in rows:
        unit = METRICS[row.metric].unit
        assert (
            row.unit == unit if unit is not None else row.unit in ("mm", "rad", "mm^2")
        )


def test_keys_in_files_are_those_of_the_metrics():
    assert get_args(MetricKey) == tuple(METRICS)
