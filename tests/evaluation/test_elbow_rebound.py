"""The rebound that the study of tosses reads from heights, against the closed form of a bouncing corner."""

from __future__ import annotations

import numpy as np
import pytest
from elbow_rebound import crossing, rebound

GRAVITY = 9.80665
INTERVAL_S = 1.0 / 150.0


def bouncing(speed_m_per_s: float, restitution: float, hit_s: float) -> np.ndarray:
    """Return the heights of three corners, the second of which strikes at a time with a speed; shape [T, 3]."""
    since = np.arange(40) * INTERVAL_S - hit_s
    speed = np.where(since < 0.0, -speed_m_per_s, restitution * speed_m_per_s)
    height = speed * since - 0.5 * GRAVITY * since**2
    return np.stack([height + 0.05, height, height + 0.02], axis=1)


@pytest.mark.parametrize("restitution", [0.0, 0.2, 0.35, 0.6])
@pytest.mark.parametrize("part", [0.0, 0.3, 0.7])
def test_the_rebound_of_a_bouncing_corner_is_its_restitution(
    restitution: float, part: float
) -> None:
    hit = rebound(bouncing(1.8, restitution, (12 + part) * INTERVAL_S), INTERVAL_S)
    assert hit is not None
    corner, approach, found = hit
    assert corner == 1
    # Speeds are those between samples, and the approach is carried to the end of an interval: off by up to g dt.
    assert approach == pytest.approx(1.8, abs=GRAVITY * INTERVAL_S)
    assert found == pytest.approx(restitution, abs=1.5 * GRAVITY * INTERVAL_S / 1.8)


def test_slow_contacts_and_flights_have_no_rebound() -> None:
    assert rebound(bouncing(0.5, 0.3, 12 * INTERVAL_S), INTERVAL_S) is None
    assert rebound(bouncing(1.8, 0.3, 12 * INTERVAL_S) + 0.1, INTERVAL_S) is None


def test_the_estimate_is_where_the_medians_cross() -> None:
    medians = np.array([0.1, 0.2, 0.4])
    assert crossing([0.0, 0.1, 0.3], medians, 0.3) == pytest.approx(0.2)
    assert crossing([0.0, 0.1, 0.3], medians, 0.05) == 0.0
