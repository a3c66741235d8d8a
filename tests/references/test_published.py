"""Published baselines and bands: what is loaded is what was published."""

from collections import Counter

import numpy as np
import pytest

from gauge_envs.errors import ShapeError
from gauge_envs.files import data_folder
from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.references.published import (
    published_baselines,
    published_variants,
)


def make_band(**changes):
    values = {
        "kind": Kind.TRIALS,
        "unit": "mm",
        "coordinates": ("a",),
        "projection": np.array([[0.0, 2.0, 0.0]]),
        "mean": np.zeros((4, 1)),
        "sigma": np.ones((4, 1)),
        "measured": np.ones(4, dtype=bool),
        "trial_count": 3,
        "source": "made up",
    }
    return Band(**(values | changes))


# Published baselines


def test_table_5_is_complete():
    rows = [
        row
        for variant in published_variants()
        for row in published_baselines(variant).values()
    ]
    assert len(rows) == 110
    assert Counter(row.metric for row in rows) == {
        "rmse": 53,
        "dtw": 53,
        "lsd": 1,
        "mte": 1,
        "pd": 1,
        "el": 1,
    }
    missing = Counter(
        engine for row in rows for engine, score in row.engines.items() if score is None
    )
    assert missing == {"genesis": 2, "newton": 4}
    # Sums over the columns of the paper's table: a digit that slips anywhere moves one of them.
    assert sum(row.frames for row in rows) == 20210
    assert sum(row.engines["isaacsim"] or 0 for row in rows) == pytest.approx(2214.039)
    assert sum(row.engines["genesis"] or 0 for row in rows) == pytest.approx(913.682)
    assert sum(row.engines["newton"] or 0 for row in rows) == pytest.approx(1714.982)
    means = sum(row.mean for row in rows if row.metric != "mte")
    stds = sum(row.std or 0 for row in rows if row.metric != "mte")
    assert means == pytest.approx(699.7616)
    assert stds == pytest.approx(402.27344)


@pytest.mark.parametrize(
    (
        "variant",
        "metric",
        "frames",
        "unit",
        "mean",
        "std",
        "isaacsim",
        "genesis",
        "newton",
    ),
    [
        ("SlopeSlider-2-wood", "rmse", 19, "mm", 18.00, 15.89, 1.23, 0.53, 1.71),
        ("NewtonsCradle-metal", "lsd", 1027, "s", 0.38, 0.015, 0, None, 0),
        ("Pendulum-metal", "el", 3000, "1", 0.0, None, 0.034, -0.041, 0.022),
        (
            "TextileStretching-uniform",
            "rmse",
            432,
            "rad",
            0.018,
            0.012,
            6.12,
            13.79,
            None,
        ),
        ("FoamBending-hard", "dtw", 33, "mm^2", 2.28, 0.21, 72.88, 12.41, 69.62),
    ],
)
def test_rows_read_as_printed(
    variant, metric, frames, unit, mean, std, isaacsim, genesis, newton
):
    row = published_baselines(variant)[metric]
    assert (row.variant, row.metric, row.frames, row.unit) == (
        variant,
        metric,
        frames,
        unit,
    )
    assert row.mean == pytest.approx(mean, rel=1e-12)
    assert row.std == (None if std is None else pytest.approx(std, rel=1e-12))
    assert row.engines == {"isaacsim": isaacsim, "genesis": genesis, "newton": newton}


def test_an_unpublished_variant_has_no_baseline():
    assert published_baselines("WallBreaking-wood") == {}


def test_the_table_cannot_be_emptied_through_the_returned_dict():
    published_baselines("SlopeSlider-2-wood").clear()
    assert set(published_baselines("SlopeSlider-2-wood")) == {"rmse", "dtw"}


def test_world_model_table_is_complete():
    lines = (
        (data_folder("scoring") / "published" / "world_model_results.csv")
        .read_text()
        .splitlines()
    )
    assert len(lines) == 1 + 14
    assert {line.count(",") for line in lines} == {13}
    fields = [field for line in lines[1:] for field in line.split(",")[3:]]
    assert fields.count("") == 6
    assert sum(float(field) for field in fields if field) == pytest.approx(15987.42155)


# Bands


def test_band_arrays_are_read_only_copies():
    mean = np.zeros((4, 1))
    band = make_band(mean=mean)
    mean[0] = 5
    assert band.mean[0, 0] == 0
    for array in (band.mean, band.sigma, band.measured, band.projection):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


@pytest.mark.parametrize(
    "changes",
    [
        {"mean": np.zeros(4)},
        {"mean": np.zeros((4, 2))},
        {"sigma": np.ones((3, 1))},
        {"coordinates": ("a", "b")},
    ],
)
def test_a_band_of_arrays_that_disagree_is_refused(changes):
    with pytest.raises(ShapeError):
        make_band(**changes)


def test_project_maps_any_number_of_frames():
    assert make_band().project([[1, 10, 100], [2, 20, 200]]).tolist() == [[20], [40]]


@pytest.mark.parametrize("shape", [(3,), (5, 2), (5, 4)])
def test_project_refuses_another_width(shape):
    with pytest.raises(ShapeError, match=r"\[frame_count, 3\]"):
        make_band().project(np.zeros(shape))


def test_only_the_bendings_are_published_in_another_unit() -> None:
    """Ten turning angles differ by sqrt(10) pi = 9.93 rad at most; 16 of 18 published errors are larger."""
    disputed = {
        name: [row.disputed for row in published_baselines(name).values()]
        for name in published_variants()
    }
    broken = {name for name, texts in disputed.items() if any(texts)}
    assert {name.split("-")[0] for name in broken} == {"TextileBending"}
    assert len(broken) == 6
    largest = np.sqrt(10.0) * np.pi
    assert all(
        f"{largest:.3g} rad" in text for name in broken for text in disputed[name]
    )
