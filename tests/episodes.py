"""Episodes of environments, and worlds of vector environments beside single environments."""

from dataclasses import asdict, is_dataclass

import numpy as np


def run_to_end(env, **reset):
    """Return the rewards of an episode with zero actions, and its last info."""
    env.reset(**({"seed": 0} | reset))
    zero = np.zeros(env.action_space.shape, dtype=env.action_space.dtype)
    rewards, over = [], False
    while not over:
        _, reward, terminated, truncated, info = env.step(zero)
        rewards.append(reward)
        over = terminated or truncated
    return rewards, info


def assert_same(found, expected, tolerance=1e-9):
    """Compare observations, arrays of rewards and flags, and nested infos, whose masks name the worlds that count."""
    if not isinstance(expected, dict):
        assert_value(found, expected, tolerance)
        return
    names = {key for key in expected if not key.startswith("_")}
    assert {key for key in found if not key.startswith("_")} == names
    for key in names:
        if isinstance(expected[key], dict):
            assert_same(found[key], expected[key], tolerance)
            continue
        worlds = expected.get(f"_{key}", np.ones(len(expected[key]), dtype=bool))
        if f"_{key}" in expected:
            assert found[f"_{key}"].tolist() == worlds.tolist()
        pairs = zip(found[key][worlds], expected[key][worlds], strict=True)
        for one, other in pairs:
            assert_value(one, other, tolerance)


def assert_value(found, expected, tolerance):
    if is_dataclass(expected):
        found, expected = asdict(found), asdict(expected)
    if isinstance(expected, dict):
        assert found.keys() == expected.keys()
        for key, value in expected.items():
            assert_value(found[key], value, tolerance)
    elif isinstance(expected, float | np.ndarray):
        np.testing.assert_allclose(found, expected, rtol=tolerance, atol=tolerance)
    else:
        assert found == expected
