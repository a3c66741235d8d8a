from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from gauge_envs.errors import ShapeError
from gauge_envs.evaluation.laws import fitted_acceleration

TIMES_S = np.arange(20) / 30


@given(acceleration=st.floats(-20, 20), start=st.floats(-5, 5))
def test_acceleration_of_a_parabola_is_its_own(acceleration, start):
    fitted = fitted_acceleration(TIMES_S, start + 0.5 * acceleration * TIMES_S**2)
    assert fitted == pytest.approx(acceleration, abs=1e-9)


@pytest.mark.parametrize(
    ("times_s", "values"), [([0.0, 0.0], [1.0, 2.0]), ([0.0, 1.0], [1.0]), ([0.0, 1.0], [np.nan, 1.0])]
)
def test_series_that_cannot_be_fitted_are_refused(times_s, values):
    with pytest.raises(ShapeError):
        fitted_acceleration(times_s, values)
