"""PyBullet runs a scene of foam alone, which has no moving rigid body."""

import gymnasium
import numpy as np
import pytest

pytest.importorskip("pybullet")


def test_foam_between_fixed_ends_runs():
    env = gymnasium.make("GAUGE/FoamCompressing-soft", backend="pybullet")
    observation, _ = env.reset(seed=0)
    after, *_ = env.step(env.action_space.sample())
    assert np.isfinite(after["markers"]).all()
    assert after["markers"].shape == observation["markers"].shape
