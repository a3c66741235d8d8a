"""Many worlds of a control task are Gymnasium's vector environment of single ones."""

import gymnasium
import numpy as np

import gauge_envs  # noqa: F401  # registers the ids


def test_worlds_end_and_restart_one_by_one_and_report_each_end():
    envs = gymnasium.make_vec(
        "GAUGE/Carry-Limit-wood", num_envs=2, settings={"timestep_s": 1 / 1080}
    )
    assert envs.observation_space.shape == (2, 10)
    observations, _ = envs.reset(seed=3)
    assert observations in envs.observation_space
    # Each world draws its own goal.
    assert not np.allclose(observations[0], observations[1])
    reports = []
    for _ in range(80):
        actions = [
            env.unwrapped.law_action(share)
            for env, share in zip(envs.envs, (0.9, 1.3), strict=True)
        ]
        observations, _, terminations, truncations, infos = envs.step(actions)
        if "limit" in infos:
            assert np.array_equal(infos["_limit"], terminations | truncations)
            reports += [one for one in infos["limit"] if one is not None]
    assert len(reports) >= 3
    assert {str(report.ending) for report in reports} == {"reached"}
    envs.close()
