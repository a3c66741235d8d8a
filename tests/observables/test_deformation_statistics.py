"""Statistics of deformation: closed forms, planar and missing markers, and propagation of noise by Monte Carlo."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gauge_envs import load_experiment, variants
from gauge_envs.errors import ShapeError
from gauge_envs.observables.deformation import (
    STATISTICS,
    MarkedSolid,
    affine_map,
    deformation_statistics,
    independent_noise,
    marked_solid,
    trial_statistics,
    white_noise_m,
)

UPRIGHT = MarkedSolid(axes=np.eye(3), long_axis=2)
ROTATION = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
FOAM_MARKERS_M = np.array(
    load_experiment("FoamStretching-soft").scene.markers.positions_m
)


def statistics(rest_m, now_m, solid=UPRIGHT, **options):
    """Statistics of one frame by name."""
    return dict(
        zip(
            STATISTICS,
            deformation_statistics(rest_m, now_m[None], solid, **options)[0].tolist(),
            strict=True,
        )
    )


def mapped(rest_m, gradient):
    return rest_m @ np.asarray(gradient).T + [0.1, -0.2, 0.3]


# Closed forms


@pytest.mark.parametrize(
    ("elongation", "poisson"), [(0.05, 0.23), (-0.05, 0.34), (0.2, 0.05)]
)
@pytest.mark.parametrize("turned", [np.eye(3), ROTATION])
def test_uniaxial_stretch(elongation, poisson, turned):
    """In the axes of the block, whichever way the block stands, and however it is rotated afterwards."""
    stretch = np.diag(
        [1 - poisson * elongation, 1 - poisson * elongation, 1 + elongation]
    )
    rest = FOAM_MARKERS_M @ turned.T
    now = mapped(rest, ROTATION @ turned @ stretch @ turned.T)
    found = statistics(rest, now, MarkedSolid(axes=turned, long_axis=2))
    assert found["strain.zz"] == pytest.approx(elongation, abs=1e-12)
    for name in ("strain.xx", "strain.yy", "strain.lateral"):
        assert found[name] == pytest.approx(-poisson * elongation, abs=1e-12)
    assert found["volume_ratio"] == pytest.approx(
        (1 + elongation) * (1 - poisson * elongation) ** 2, abs=1e-12
    )
    assert found["non_affine"] < 1e-6


def test_simple_shear():
    """U of x' = x + gamma z is [[2, gamma], [gamma, 2 + gamma^2]] over sqrt(4 + gamma^2)."""
    gamma = 0.35
    found = statistics(
        FOAM_MARKERS_M, mapped(FOAM_MARKERS_M, [[1, 0, gamma], [0, 1, 0], [0, 0, 1]])
    )
    root = np.sqrt(4 + gamma**2)
    assert found["strain.xx"] == pytest.approx(2 / root - 1, abs=1e-12)
    assert found["strain.zz"] == pytest.approx((2 + gamma**2) / root - 1, abs=1e-12)
    assert found["strain.xz"] == pytest.approx(gamma / root, abs=1e-12)
    assert found["strain.yy"] == pytest.approx(0.0, abs=1e-12)
    assert found["volume_ratio"] == pytest.approx(1.0, abs=1e-12)


def test_pure_bending_is_not_affine():
    """Curvature k moves markers by k z^2 / 2 across and by -k x z along; both are at a right angle to affine maps."""
    x, y, z = (
        grid.ravel()
        for grid in np.meshgrid(
            [-0.02, 0.02], [-0.02, 0.02], np.linspace(-0.08, 0.08, 9)
        )
    )
    rest, curvature = np.column_stack([x, y, z]), 0.8
    now = rest + np.column_stack(
        [0.5 * curvature * z**2, np.zeros_like(z), -curvature * x * z]
    )
    found = statistics(rest, now)
    across = 0.25 * curvature**2 * (np.mean(z**4) - np.mean(z**2) ** 2)
    along = curvature**2 * 0.02**2 * np.mean(z**2)
    assert found["non_affine"] == pytest.approx(
        1e3 * np.sqrt(across + along), rel=1e-12
    )
    assert found["strain.zz"] == pytest.approx(0.0, abs=1e-12)


def test_markers_in_a_plane_give_strain_in_the_plane():
    plane = np.array(
        [[0.44, y, z] for y in np.linspace(0.3, 0.4, 7) for z in (0.19, 0.21)]
    )
    gradient = ROTATION @ np.diag([0.7, 1.1, 0.9])
    found = statistics(plane, mapped(plane, gradient))
    assert found["strain.yy"] == pytest.approx(0.1, abs=1e-12)
    assert found["strain.zz"] == pytest.approx(-0.1, abs=1e-12)
    assert found["area_ratio"] == pytest.approx(1.1 * 0.9, abs=1e-12)
    unknown = {name for name, value in found.items() if np.isnan(value)}
    assert unknown == {
        "strain.xx",
        "strain.xy",
        "strain.xz",
        "strain.lateral",
        "volume_ratio",
    }


def test_placement_errors_do_not_make_a_plane_a_solid():
    """Dots on a face are off it by less than a millimetre; that is no extent."""
    random = np.random.default_rng(1)
    plane = np.array(
        [[0.44, y, z] for y in np.linspace(0.3, 0.4, 7) for z in (0.19, 0.21)]
    )
    placed = plane + 0.0009 * random.normal(size=plane.shape)
    found = statistics(placed, placed @ np.diag([1.0, 1.1, 0.9]))
    assert np.isnan(found["volume_ratio"]) and np.isnan(found["strain.xx"])
    assert found["strain.yy"] == pytest.approx(0.1, abs=0.002)
    assert found["area_ratio"] == pytest.approx(1.1 * 0.9, abs=0.002)


def test_markers_on_a_line_give_the_strain_along_it():
    line = np.array([[0.4, y, 0.2] for y in (0.40, 0.45, 0.50)])
    now = mapped(line, 1.1 * ROTATION)
    now[1] += 0.003 * ROTATION[:, 2]
    found = statistics(line, now)
    assert found["strain.yy"] == pytest.approx(0.1, abs=1e-12)
    assert np.isnan(
        [
            found[name]
            for name in ("strain.xx", "strain.zz", "volume_ratio", "area_ratio")
        ]
    ).all()
    # 3 mm in the middle of three: the mean takes 1 mm of it; rms of (-1, 2, -1) mm.
    assert found["non_affine"] == pytest.approx(np.sqrt(2.0), rel=1e-9)


# Missing markers


def test_missing_markers_are_left_out():
    now = mapped(FOAM_MARKERS_M, np.diag([0.99, 0.98, 1.05]))
    whole = statistics(FOAM_MARKERS_M, now)
    rest, now = FOAM_MARKERS_M.copy(), now.copy()
    rest[3], now[[0, 11, 20]] = np.nan, np.nan
    left = statistics(rest, now)
    assert left == pytest.approx(whole, abs=1e-9, nan_ok=True)
    fit = affine_map(rest, now[None])
    assert np.isnan(fit.residual_m[0]).all(axis=1).nonzero()[0].tolist() == [
        0,
        3,
        11,
        20,
    ]


def test_too_few_markers_determine_nothing():
    now = np.stack([FOAM_MARKERS_M] * 3)
    now[1, 1:], now[2] = np.nan, np.nan
    found = deformation_statistics(FOAM_MARKERS_M, now, UPRIGHT)
    assert np.isfinite(found[0]).sum() == len(STATISTICS) - 1
    assert np.isnan(found[1:]).all()


def test_four_markers_have_no_residual_to_speak_of():
    found = statistics(FOAM_MARKERS_M[[0, 6, 7, 14]], FOAM_MARKERS_M[[0, 6, 7, 14]])
    assert found["volume_ratio"] == pytest.approx(1.0)
    assert np.isnan(found["non_affine"])


@pytest.mark.parametrize(
    ("rest", "now", "message"),
    [
        ((28, 2), (1, 28, 3), "rest_m has shape"),
        ((28, 3), (1, 27, 3), "markers_m has shape"),
    ],
)
def test_wrong_shapes_are_named(rest, now, message):
    with pytest.raises(ShapeError, match=message):
        affine_map(np.zeros(rest), np.zeros(now))


# Noise


def test_noise_is_taken_off_the_residual():
    """In squares, on average over draws."""
    random = np.random.default_rng(4)
    sigma = 0.2e-3
    now = FOAM_MARKERS_M + 0.001 * np.sin(40 * FOAM_MARKERS_M)
    exact = statistics(FOAM_MARKERS_M, now)["non_affine"]
    draws = now + sigma * random.normal(size=(4000, *now.shape))
    noise = independent_noise(np.full(now.shape, sigma))
    raw = deformation_statistics(FOAM_MARKERS_M, draws, UPRIGHT)[:, 9]
    corrected = deformation_statistics(FOAM_MARKERS_M, draws, UPRIGHT, noise_m=noise)[
        :, 9
    ]
    degrees = 3 * (len(FOAM_MARKERS_M) - 4)
    assert np.mean(raw**2) - exact**2 == pytest.approx(
        1e6 * sigma**2 * degrees / len(FOAM_MARKERS_M), rel=0.02
    )
    assert np.mean(corrected**2) == pytest.approx(exact**2, rel=0.01)


def test_white_noise_of_a_moving_trial_is_found():
    times = np.arange(60) / 30
    swing = 0.05 * np.sin(2 * np.pi * 1.7 * times)[:, None, None]
    noisy = (
        FOAM_MARKERS_M
        + swing
        + 1e-4 * np.random.default_rng(6).normal(size=(60, *FOAM_MARKERS_M.shape))
    )
    noisy[10, 3] = np.nan
    noisy[20, 5] += 0.05
    assert white_noise_m(noisy) == pytest.approx(1e-4, rel=0.05)
    assert white_noise_m(FOAM_MARKERS_M + swing) < 4e-6
    assert white_noise_m(noisy[:6]) == 0.0


def test_a_noisy_trial_at_rest_has_no_residual():
    trials = FOAM_MARKERS_M + 1e-4 * np.random.default_rng(7).normal(
        size=(20, 30, *FOAM_MARKERS_M.shape)
    )
    squares = np.array(
        [trial_statistics(trial, UPRIGHT)[1:, 9] ** 2 for trial in trials]
    )
    raw = np.array(
        [
            deformation_statistics(trial[0], trial, UPRIGHT)[1:, 9] ** 2
            for trial in trials
        ]
    )
    assert raw.mean() == pytest.approx(6 * 0.01 * 24 / 28, rel=0.1)
    # What is negative after the correction is reported as 0, so a tenth is left.
    assert squares.mean() < 0.15 * raw.mean()


# Which experiments


def test_foams_and_the_beam_have_a_marked_solid():
    found = {
        variant.family
        for variant in variants()
        if marked_solid(load_experiment(variant.name).scene) is not None
    }
    foams = {
        f"Foam{motion}"
        for motion in ("Stretching", "Compressing", "Shearing", "Twisting", "Bending")
    }
    assert found == {*foams, "CantileverBeam"}


def test_axes_of_a_block_that_lies_down():
    solid = marked_solid(load_experiment("FoamBending-soft").scene)
    assert solid is not None and solid.long_axis == 2
    assert np.abs(solid.axes[:, 2]).tolist() == pytest.approx(
        [0.0, 1.0, 0.0], abs=1e-12
    )
    beam = marked_solid(load_experiment("CantileverBeam-soft").scene)
    assert beam is not None and beam.long_axis is None
