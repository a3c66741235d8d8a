"""Probabilities against SciPy, and a minimum against closed forms."""

from __future__ import annotations

import os

import numpy as np
import pytest
from programs import printed
from scipy import special
from scipy.stats import binomtest

from gauge_envs.scoring.numerics import (
    bounded_minimum,
    normal_probability,
    share_interval,
    student_quantile,
)


@pytest.mark.parametrize("successes", [0, 1, 7, 10])
def test_the_interval_of_a_share_is_that_of_scipy(successes):
    expected = binomtest(successes, 10).proportion_ci(0.95, "exact")
    assert share_interval(successes, 10, 0.95) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("freedom", [1, 2.5, 19, 4000])
def test_student_quantiles_are_those_of_scipy(freedom):
    found = [student_quantile(freedom, probability) for probability in (0.6, 0.975)]
    assert found == pytest.approx(special.stdtrit(freedom, [0.6, 0.975]), rel=1e-10)


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


TALL_PRODUCTS = """
import time
import numpy as np
from gauge_envs.scoring.numerics import tall_product
tall = np.arange(80_000.0).reshape(4000, 20)
own_s, all_s = time.thread_time(), time.process_time()
for other in (np.ones(20), np.ones((20, 19)), np.ones((20, 300))):
    for _ in range(50):
        product = tall_product(tall, other)
all_s, own_s = time.process_time() - all_s, time.thread_time() - own_s
assert np.array_equal(product, tall @ other)
assert all_s < 1.2 * own_s, (all_s, own_s)
"""


def test_no_threads_wait_in_tall_products():
    printed("-c", TALL_PRODUCTS, env=os.environ | {"OMP_NUM_THREADS": "2"})
