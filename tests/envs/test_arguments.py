"""Environments in threads, and their memory."""

import gc
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import gymnasium
import pytest
from episodes import run_to_end

import gauge_envs
from gauge_envs import GaugeEnv

NAME = "SlopeSlider-2-wood"


def rollout(name):
    """Frames of an episode."""
    env = gymnasium.make(f"GAUGE/{name}", disable_env_checker=True)
    run_to_end(env)
    frames = env.unwrapped.trajectory().samples.tolist()
    env.close()
    return frames


def test_eight_threads_with_an_environment_each_give_the_bits_of_one():
    names = [
        "SlopeSlider-2-wood",
        "SlopeSlider-3-metal",
        "BouncingBall-rubber",
        "Turntable-2-wood",
    ]
    alone = [rollout(name) for name in names]
    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(rollout, names * 2)) == alone * 2


def resident_mb():
    """Resident memory of this process [MB]."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs /proc")
def test_resets_and_new_environments_take_no_more_memory():
    env = GaugeEnv(NAME)

    def resets(count):
        for seed in range(count):
            env.reset(seed=seed)
            env.step(0)

    def environments(count):
        for number in range(count):
            one = gauge_envs.GaugeEnv(NAME if number % 2 else "Turntable-1-wood")
            one.reset(seed=0)
            one.step(one.action_space.sample())
            one.close()

    # The first 200 environments fill the allocator's arenas, by 12 to 24 MB once; a leak goes on.
    for work, warm_up, count in ((resets, 500, 5000), (environments, 200, 200)):
        work(warm_up)
        before = resident_mb()
        work(count)
        grown = resident_mb() - before
        print(f"{work.__name__}: {count}, {grown:+.1f} MB")
        assert grown < 10.0
