"""The registry of metrics agrees with the score, with the published table and with the tables of files."""

import pytest
from pydantic import TypeAdapter, ValidationError

from gauge_envs.references.metrics import (
    METRICS,
    BaselineMetric,
    MetricKey,
)
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


def test_unknown_metrics_are_refused_with_the_known_ones():
    assert TypeAdapter(MetricKey).validate_python("el") == "el"
    with pytest.raises(
        ValidationError, match="'rmes' is none of rmse, dtw, lsd, mte, pd, el"
    ):
        TypeAdapter(MetricKey).validate_python("rmes")
    with pytest.raises(
        ValidationError, match="'el' is none of rmse, dtw, lsd, mte, pd"
    ):
        TypeAdapter(BaselineMetric).validate_python("el")
