"""The finite elements of a clamped bar."""

import pytest

from scripts.bar import axial_factor


def test_a_bar_without_poisson_effect_has_the_stiffness_e_a_over_l():
    assert axial_factor(0.05, 0.2, 0.0, cells_across=2) == pytest.approx(1.0, abs=1e-9)


def test_a_slice_between_clamps_is_as_stiff_as_a_layer_that_cannot_narrow():
    nu = 0.3
    constrained = (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu))
    factor = axial_factor(1.0, 0.05, nu, cells_across=40)
    assert factor == pytest.approx(constrained, rel=0.05)


def test_clamps_stiffen_a_long_bar_less_the_longer_it_is():
    short, long = (
        axial_factor(1.0, length, 0.34, cells_across=4) for length in (3.0, 6.0)
    )
    # The clamps add the same missing length to both.
    assert (1.0 - 1.0 / short) * 3.0 == pytest.approx(
        (1.0 - 1.0 / long) * 6.0, rel=0.02
    )
