"""The residual of the solver, which a heavy driven body hides from its tolerance, does not move a light body."""

import numpy as np
import pytest

from gauge_envs.envs.env import GaugeEnv


def sideways_mm(**settings):
    """Return how far a cube leaves the plane of symmetry of the board that a motor tilts [mm]."""
    env = GaugeEnv("SlopeSlider-3-wood", settings=settings)
    env.reset(seed=0)
    env.rollout.play()
    frames_mm = env.trajectory().frames
    env.close()
    return float(np.ptp(frames_mm[:, 1]))


def test_a_cube_stays_in_the_plane_of_symmetry_of_its_board():
    assert sideways_mm() < 1e-6


def test_implicitfast_needs_a_smaller_tolerance():
    coarse = sideways_mm(integrator="implicitfast")
    fine = sideways_mm(integrator="implicitfast", tolerance=1e-12)
    assert coarse > 0.01
    assert fine == pytest.approx(0.0, abs=0.1 * coarse)
