"""Deformation of a marked solid: the Biot strain in closed form, for markers in a volume, in a plane and on a line."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gauge_envs import load_experiment
from gauge_envs.observables.deformation import deformation, solid_axes

ROTATION = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
FOAM_MARKERS_M = np.array(
    load_experiment("FoamStretching-soft").scene.markers.positions_m
)
PLANE_M = np.array(
    [[0.44, y, z] for y in np.linspace(0.3, 0.4, 7) for z in (0.19, 0.21)]
)


def mapped(rest_m, gradient):
    return rest_m @ np.asarray(gradient).T + [0.1, -0.2, 0.3]


@pytest.mark.parametrize("elongation", [0.05, -0.05])
@pytest.mark.parametrize("turned", [np.eye(3), ROTATION])
def test_a_stretch_counts_along_the_axes_of_the_block(elongation, turned):
    """The strain does not depend on the axes of the block and on its rotation."""
    stretch = turned @ np.diag([0.98, 0.98, 1 + elongation]) @ turned.T
    rest = FOAM_MARKERS_M @ turned.T
    strains = deformation(rest, mapped(rest, ROTATION @ stretch), turned)
    assert strains["strain_zz"] == pytest.approx(elongation, abs=1e-12)
    assert strains["strain_xz"] == pytest.approx(0.0, abs=1e-12)
    assert np.isnan(strains["area_ratio"])


def test_a_simple_shear_has_the_stretch_of_its_polar_decomposition():
    """U of x' = x + gamma z is [[2, gamma], [gamma, 2 + gamma^2]] over sqrt(4 + gamma^2)."""
    gamma = 0.35
    sheared = mapped(FOAM_MARKERS_M, [[1, 0, gamma], [0, 1, 0], [0, 0, 1]])
    strains = deformation(FOAM_MARKERS_M, sheared, np.eye(3))
    root = np.sqrt(4 + gamma**2)
    assert strains["strain_zz"] == pytest.approx((2 + gamma**2) / root - 1, abs=1e-12)
    assert strains["strain_xz"] == pytest.approx(gamma / root, abs=1e-12)


@pytest.mark.parametrize("placement_m", [0.0, 0.0009])
def test_markers_in_a_plane_give_strain_in_the_plane(placement_m):
    """Dots on a face are less than a millimetre off its plane, which does not count as an extent."""
    noise = np.random.default_rng(1).normal(size=PLANE_M.shape)
    rest = PLANE_M + placement_m * noise
    deformed = mapped(rest, ROTATION @ np.diag([0.7, 1.1, 0.9]))
    strains = deformation(rest, deformed, np.eye(3))
    tolerance = 1e-12 + 6.0 * placement_m
    assert strains["strain_zz"] == pytest.approx(-0.1, abs=tolerance)
    assert strains["area_ratio"] == pytest.approx(1.1 * 0.9, abs=tolerance)
    assert np.isnan(strains["strain_xz"])
    line = PLANE_M[::2]
    on_line = deformation(line, mapped(line, 1.1 * ROTATION), np.eye(3))
    assert np.isnan([*on_line.values()]).all()


def test_the_axes_are_those_of_a_block_that_lies_down():
    axes = solid_axes(load_experiment("FoamBending-soft").scene)
    assert np.abs(axes[:, 2]).tolist() == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)
