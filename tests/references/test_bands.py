"""The bundled bands reproduce what was published about the real trials."""

import math
import tomllib

import numpy as np
import pytest

from gauge_envs.files import data_folder
from gauge_envs.references.band import load_band
from gauge_envs.references.published import published_baselines

MATERIALS = ("wood", "plastic", "metal")
VARIANTS = (
    *(f"SlopeSlider-2-{material}" for material in MATERIALS),
    "BouncingBall-rubber",
)
GRAVITY = 9.80665


# Reproduction of the published scatter


@pytest.mark.parametrize("variant", VARIANTS)
def test_real_trials_reproduce_the_published_baseline(variant):
    published, band = published_baselines(variant), load_band(variant)
    # Later frames of some trials are not known.
    rmse = [
        np.sqrt(np.nanmean(np.square(trial - band.mean).sum(axis=1)))
        for trial in band.trials
    ]
    assert np.mean(rmse) == pytest.approx(published["rmse"].mean, rel=0.03)
    assert np.std(rmse, ddof=1) == pytest.approx(published["rmse"].std, rel=0.03)
    # The stored distances are from the mean of the others, N / (N - 1) times as far.
    count = len(band.trials)
    expected = np.array(rmse) * count / (count - 1)
    np.testing.assert_allclose(band.trial_rmse, expected, rtol=0.02)
    assert (band.trial_rmse_aligned <= band.trial_rmse + 1e-9).all()


@pytest.mark.parametrize("variant", VARIANTS)
def test_sigma_and_uncertainty_are_those_of_the_trials(variant):
    band = load_band(variant)
    scatter = np.nanstd(band.trials, axis=0, ddof=1)
    known = np.isfinite(scatter) & band.measured[:, None]
    np.testing.assert_allclose(band.sigma[known], scatter[known], rtol=0.02)
    root = math.sqrt(len(band.trials))
    assert band.standard_uncertainty == pytest.approx(
        math.sqrt(np.square(band.sigma / root).mean()), rel=1e-6
    )


# What is measured


@pytest.mark.parametrize(
    ("material", "first", "last"),
    [("wood", 6, 14), ("plastic", 6, 13), ("metal", 7, 15)],
)
def test_slope_frames_without_half_of_the_trials_are_extrapolated(
    material, first, last
):
    measured = np.flatnonzero(load_band(f"SlopeSlider-2-{material}").measured)
    assert measured.tolist() == list(range(first, last + 1))


def test_ball_frames_before_the_arcs_are_extrapolated():
    assert np.flatnonzero(load_band("BouncingBall-rubber").measured).tolist() == list(
        range(4, 18)
    )


# Ideal bodies


@pytest.mark.parametrize(
    ("material", "x", "z", "friction", "score"),
    [
        ("wood", 97.247, 359.354, 0.273673, 0.42),
        ("plastic", 99.205, 359.256, 0.275018, 0.87),
        ("metal", 98.720, 359.680, 0.262758, 0.76),
    ],
)
def test_ideal_coulomb_cube(material, x, z, friction, score):
    """Released at frame 0 from the metadata's position, with the metadata's friction."""
    variant, slope = f"SlopeSlider-2-{material}", math.radians(30)
    baseline = published_baselines(variant)["rmse"]
    time = np.arange(baseline.frames) / 30
    travel = 500 * GRAVITY * (math.sin(slope) - friction * math.cos(slope)) * time**2
    positions = np.array([x, 400.0, z]) + travel[:, np.newaxis] * [
        math.cos(slope),
        0,
        -math.sin(slope),
    ]
    band = load_band(variant)
    rmse = math.sqrt(np.square(band.project(positions) - band.mean).mean())
    assert rmse / baseline.mean == pytest.approx(score, abs=0.01)


def ball_score(*, restitution, start, contact, release):
    """Normalized E_RMSE of a ball dropped at a time, from a height, over a contact height (m, s)."""
    time = np.maximum(np.arange(18) / 30 - release, 0)
    fall_time = math.sqrt(2 * (start - contact) / GRAVITY)
    after = time - fall_time
    falling = start - GRAVITY / 2 * time**2
    rising = (
        contact + restitution * GRAVITY * fall_time * after - GRAVITY / 2 * after**2
    )
    z = 1000 * np.where(after < 0, falling, rising)
    band = load_band("BouncingBall-rubber")
    deviation = band.project(np.column_stack([0 * z, 0 * z, z])) - band.mean
    return (
        math.sqrt(np.square(deviation).mean())
        / published_baselines("BouncingBall-rubber")["rmse"].mean
    )


@pytest.mark.parametrize(
    ("restitution", "start", "contact", "release", "score"),
    [
        (0.576733, 0.451023, 0.043297, 0.0, 14.1),
        (0.576733, 0.451023, 0.043297, 0.056, 6.6),
        (0.735, 0.451023, 0.043297, 0.0577, 1.27),
        (0.735, 0.4423, 0.0372, 0.0601, 0.13),
    ],
)
def test_ideal_ball(restitution, start, contact, release, score):
    """Metadata ball, the same released late, with the recorded rebound too, with the recorded heights too."""
    measured = ball_score(
        restitution=restitution, start=start, contact=contact, release=release
    )
    assert measured == pytest.approx(score, rel=0.02)
    if release > 0:
        assert measured <= min(
            ball_score(
                restitution=restitution,
                start=start,
                contact=contact,
                release=release + shift,
            )
            for shift in (-0.002, 0.002)
        )


def test_slope_summary_inverts_coulomb_sliding():
    text = (
        data_folder("scoring") / "facts" / "slope_slider_30deg_summary.toml"
    ).read_text()
    for material, summary in tomllib.loads(text).items():
        friction, acceleration = (
            summary["friction"]["mean"],
            summary["acceleration_m_s2"]["mean"],
        )
        expected = GRAVITY * (
            math.sin(math.radians(30)) - friction * math.cos(math.radians(30))
        )
        assert acceleration == pytest.approx(expected, abs=1e-5), material
