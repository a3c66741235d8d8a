"""Episodes of environments."""

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
