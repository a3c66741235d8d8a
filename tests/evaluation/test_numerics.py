"""Quantiles against SciPy, a root and a minimum against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import special
from scipy.stats import binomtest

from gauge_envs.evaluation.numerics import (
    beta_quantile,
    bounded_minimum,
    normal_probability,
    share_interval,
    student_quantile,
)

PROBABILITIES = (0.025, 0.3, 0.5, 0.95)


@pytest.mark.parametrize("a", [0.5, 1.0, 7.3, 90.0])
@pytest.mark.parametrize("b", [0.5, 2.0, 22.7])
def test_beta_quantiles_are_those_of_scipy(a, b):
    found = [beta_quantile(a, b, probability) for probability in PROBABILITIES]
    expected = special.betaincinv(a, b, PROBABILITIES)
    assert found == pytest.approx(expected, rel=1e-11)


@pytest.mark.parametrize("successes", [0, 1, 7, 10])
def test_the_interval_of_a_share_is_that_of_scipy(successes):
    expected = binomtest(successes, 10).proportion_ci(0.95, "exact")
    assert share_interval(successes, 10, 0.95) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("freedom", [1, 3, 21, 150])
def test_student_quantiles_are_those_of_scipy(freedom):
    expected = special.stdtrit(freedom, 0.975)
    assert student_quantile(freedom, 0.975) == pytest.approx(expected, rel=1e-11)


def test_normal_probabilities_are_those_of_scipy():
    values = (-9.0, -1.96, 0.0, 0.3, 4.0)
    found = [normal_probability(value) for value in values]
    assert found == pytest.approx(special.ndtr(values), rel=1e-13)


@pytest.mark.parametrize("place", [-1.0, -0.3, 0.7123, 2.0])
def test_the_minimum_of_a_parabola_is_found_inside_and_at_a_bound(place):
    argument, value = bounded_minimum(
        lambda x: 3.0 + (x - place) ** 2, -1.0, 1.0, tolerance=1e-7
    )
    nearest = min(max(place, -1.0), 1.0)
    assert argument == pytest.approx(nearest, abs=1e-7)
    assert value == pytest.approx(3.0 + (nearest - place) ** 2)


def test_a_minimum_with_a_kink_is_found():
    argument, _ = bounded_minimum(lambda x: np.abs(x - 0.2), 0.0, 1.0, tolerance=1e-9)
    assert argument == pytest.approx(0.2, abs=1e-9)
