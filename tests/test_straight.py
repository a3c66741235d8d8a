from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from straight import fitted_acceleration

TIMES_S = np.arange(20) / 30


@given(acceleration=st.floats(-20, 20), start=st.floats(-5, 5))
def test_acceleration_of_a_parabola_is_its_own(acceleration, start):
    fitted = fitted_acceleration(TIMES_S, start + 0.5 * acceleration * TIMES_S**2)
    assert fitted == pytest.approx(acceleration, abs=1e-9)
