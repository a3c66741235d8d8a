"""Published baselines: Table 5 of the paper as printed, and the bands of real trials that reproduce it."""

import math
from collections import Counter
from typing import get_args

import numpy as np
import pytest

from gauge_envs import variants
from gauge_envs.references.band import load_band
from gauge_envs.references.metrics import METRICS, MetricKey
from gauge_envs.references.published import published_baselines

ROWS = [
    row for variant in variants() for row in published_baselines(variant.name).values()
]


def test_table_5_is_complete():
    """Sums over the columns of the paper's table; a wrong digit changes one of them."""
    counts = {"rmse": 53, "dtw": 53, "lsd": 1, "mte": 1, "pd": 1, "el": 1}
    assert Counter(row.metric for row in ROWS) == counts
    assert tuple(METRICS) == get_args(MetricKey) == tuple(counts)
    scores = {
        engine: [row.engines[engine] for row in ROWS]
        for engine in ("isaacsim", "genesis", "newton")
    }
    missing = [column.count(None) for column in scores.values()]
    sums = [sum(filter(None, column)) for column in scores.values()]
    assert missing == [0, 2, 4]
    assert sums == pytest.approx([2214.039, 913.682, 1714.982])
    assert sum(row.frames for row in ROWS) == 20210
    # The momentum transfer is a percentage in the paper.
    percent = {row.metric: 100.0 if row.metric == "mte" else 1.0 for row in ROWS}
    means = sum(percent[row.metric] * row.mean for row in ROWS)
    stds = sum(percent[row.metric] * (row.std or 0.0) for row in ROWS)
    assert (means, stds) == pytest.approx((699.7616 + 93.02, 402.27344 + 2.47))
    for row in ROWS:
        units = (METRICS[row.metric].unit,)
        assert row.unit in (("mm", "rad", "mm^2") if units == (None,) else units)
    assert published_baselines("WallBreaking-wood") == {}
    slide = published_baselines("SlopeSlider-2-wood")["rmse"]
    assert (slide.frames, slide.mean, slide.std) == (19, 18.00, 15.89)


@pytest.mark.parametrize(
    "variant",
    [
        "SlopeSlider-2-wood",
        "SlopeSlider-2-plastic",
        "SlopeSlider-2-metal",
        "BouncingBall-rubber",
    ],
)
def test_real_trials_reproduce_the_published_baseline(variant):
    published, band = published_baselines(variant), load_band(variant)
    # Later frames of some trials are not known.
    squares = np.square(band.trials - band.mean).sum(axis=2)
    rmse = np.sqrt(np.nanmean(squares, axis=1))
    assert np.mean(rmse) == pytest.approx(published["rmse"].mean, rel=0.03)
    assert np.std(rmse, ddof=1) == pytest.approx(published["rmse"].std, rel=0.03)
    # Stored distances are from the mean of the other trials, N / (N - 1) times as far.
    count = len(band.trials)
    expected = rmse * count / (count - 1)
    np.testing.assert_allclose(band.trial_rmse, expected, rtol=0.02)
    assert (band.trial_rmse_aligned <= band.trial_rmse + 1e-9).all()
    scatter = np.nanstd(band.trials, axis=0, ddof=1)
    known = np.isfinite(scatter) & band.measured[:, None]
    np.testing.assert_allclose(band.sigma[known], scatter[known], rtol=0.02)
    of_mean = math.sqrt(np.square(band.sigma).mean() / count)
    assert band.standard_uncertainty == pytest.approx(of_mean, rel=1e-6)
