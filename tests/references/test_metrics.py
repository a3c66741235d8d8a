"""The registry of metrics agrees with the score, with the published table and with the tables of files."""

from dataclasses import fields

import pytest
from pydantic import TypeAdapter, ValidationError

from gauge_envs.references.metrics import (
    METRICS,
    BaselineMetric,
    MetricKey,
)
from gauge_envs.references.published import published_baselines, published_variants
from gauge_envs.scoring.score import Score, Validation


def test_every_metric_names_fields_of_the_score():
    known = {field.name for field in (*fields(Score), *fields(Validation))}
    named = {metric.score_field for metric in METRICS.values()}
    normalized = {
        metric.normalized_field for metric in METRICS.values() if metric.is_normalized
    }
    assert named | normalized <= known
    # Each normalized field of the score belongs to one metric, apart from the aligned RMSE, which is not published, and
    # from other estimators of a published metric.
    own = {
        "rmse_aligned_normalized",
        "lsd_speed_3d_normalized",
        "lsd_central_normalized",
        "pd_fft_normalized",
    }
    assert normalized == {name for name in known if name.endswith("_normalized")} - own


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
