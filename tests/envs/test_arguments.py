"""Arguments that no environment can use, environments used after `close`, and environments in threads."""

from __future__ import annotations

import copy
import gc
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import gauge_envs
from gauge_envs import GaugeEnv
from gauge_envs.errors import EpisodeError, ParameterError
from gauge_envs.runs.request import RunRequest

NAME = "SlopeSlider-2-wood"
ID = f"GAUGE/{NAME}"
CONTROL_ID = "GAUGE/Turntable-Limit-wood"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"width": 0}, "width is 0, expected a whole number of pixels"),
        ({"height": -3}, "height is -3"),
        ({"width": "wide"}, "width is 'wide'"),
        ({"width": 10**9}, "from 1 to 16384"),
        ({"backend": None}, "backend is None, expected the name of a backend"),
        ({"backend": ["mujoco"]}, "expected the name of a backend"),
        ({"parameters": {3: 1}}, "expected texts as keys"),
        ({"settings": {3: 1}}, "expected texts as keys"),
        ({"settings": [1]}, r"settings is \[1\], expected a mapping"),
        ({"settings": "fast"}, "expected a mapping"),
        ({"asset": 3}, "asset is 3, expected the path of a file"),
    ],
)
@pytest.mark.parametrize("make", [gymnasium.make, gymnasium.make_vec])
def test_arguments_of_a_wrong_type(
    make: Callable[..., Any], arguments: dict[str, Any], message: str
) -> None:
    with pytest.raises(ParameterError, match=message):
        make(ID, **arguments)


@pytest.mark.parametrize(
    "arguments",
    [{"width": 0}, {"backend": None}, {"settings": {"impratio": float("inf")}}],
)
def test_wrong_arguments_of_a_control_task(arguments: dict[str, Any]) -> None:
    with pytest.raises(ParameterError):
        gymnasium.make(CONTROL_ID, **arguments)


@pytest.mark.parametrize("variant", [3, None, ["SlopeSlider-2-wood"]])
def test_a_variant_is_a_name(variant: Any) -> None:
    with pytest.raises(ParameterError, match="expected a Variant or its name"):
        GaugeEnv(variant)


def test_a_window_is_no_render_mode() -> None:
    with pytest.raises(
        ParameterError, match="render_mode 'human': choose None or 'rgb_array'"
    ):
        GaugeEnv(NAME, render_mode="human")


@pytest.mark.parametrize("count", ["x", 0, -1, 2.5, None, True, 10**9])
def test_an_impossible_number_of_worlds(count: Any) -> None:
    with pytest.raises(
        ParameterError,
        match=r"num_envs is .*, expected a whole number from 1 to 100000",
    ):
        gymnasium.make_vec(ID, num_envs=count)


@pytest.mark.parametrize("seed", ["x", 1.5, [0]])
def test_impossible_seeds_of_worlds(seed: Any) -> None:
    with pytest.raises(ParameterError, match="seed"):
        gymnasium.make_vec(ID, num_envs=2).reset(seed=seed)


@pytest.mark.parametrize(
    "values",
    [
        {"seed": "x"},
        {"seed": -1},
        {"repeats": 1.5},
        {"repeats": 0},
        {"jitter": 1},
        {"backend": None},
    ],
)
def test_impossible_requests(values: dict[str, Any]) -> None:
    with pytest.raises(ParameterError, match=next(iter(values))):
        RunRequest(NAME, **values)


# --- after close ---


@pytest.mark.parametrize("name", [ID, CONTROL_ID])
@pytest.mark.parametrize("call", ["step", "reset", "render"])
def test_a_closed_environment_is_an_error(name: str, call: str) -> None:
    env = gymnasium.make(name, render_mode="rgb_array").unwrapped
    env.reset(seed=0)
    env.close()
    env.close()
    arguments = [env.action_space.sample()] if call == "step" else []
    with pytest.raises(
        EpisodeError, match=f"{call} after close; make the environment again"
    ):
        getattr(env, call)(*arguments)


@pytest.mark.parametrize("call", ["step", "reset", "render"])
def test_a_closed_vector_environment_is_an_error(call: str) -> None:
    envs = gymnasium.make_vec(ID, num_envs=2, render_mode="rgb_array")
    envs.reset(seed=0)
    envs.close()
    envs.close()
    with pytest.raises(EpisodeError, match=f"{call} after close"):
        getattr(envs.unwrapped, call)(*([[0, 0]] if call == "step" else []))


def test_jitter_builds_the_scene_anew_without_closing_the_environment() -> None:
    env = gymnasium.make(ID)
    for options in ({"jitter": True}, {"jitter": True}, {}):
        env.reset(seed=1, options=options)
        env.step(0)
    envs = gymnasium.make_vec(ID, num_envs=2)
    for options in ({"jitter": True}, {}):
        envs.reset(seed=1, options=options)
        envs.step([0, 0])


def test_a_copy_of_a_closed_environment_is_closed() -> None:
    env = GaugeEnv(NAME)
    env.reset(seed=0)
    env.close()
    with pytest.raises(EpisodeError, match="after close"):
        copy.deepcopy(env).reset()


# --- threads and memory ---


def rollout(name: str) -> list[Any]:
    """Frames of an episode."""
    env = gymnasium.make(f"GAUGE/{name}", disable_env_checker=True)
    env.reset(seed=0)
    space = env.action_space
    zero = np.zeros(space.shape) if isinstance(space, gymnasium.spaces.Box) else 0
    over = False
    while not over:
        *_, terminated, truncated, _ = env.step(zero)
        over = terminated or truncated
    frames = env.unwrapped.trajectory().samples.tolist()
    env.close()
    return frames


def test_eight_threads_with_an_environment_each_give_the_bits_of_one() -> None:
    names = [
        "SlopeSlider-2-wood",
        "SlopeSlider-3-metal",
        "BouncingBall-rubber",
        "Turntable-2-wood",
    ]
    alone = [rollout(name) for name in names]
    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(rollout, names * 2)) == alone * 2


def resident_mb() -> float:
    """Resident memory of this process [MB]."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs /proc")
def test_resets_and_new_environments_take_no_more_memory() -> None:
    env = GaugeEnv(NAME)

    def resets(count: int) -> None:
        for seed in range(count):
            env.reset(seed=seed)
            env.step(0)

    def environments(count: int) -> None:
        for number in range(count):
            one = gauge_envs.GaugeEnv(NAME if number % 2 else "Turntable-1-wood")
            one.reset(seed=0)
            one.step(one.action_space.sample())
            one.close()

    for work, warm_up, count in ((resets, 500, 5000), (environments, 20, 200)):
        work(warm_up)
        before = resident_mb()
        work(count)
        grown = resident_mb() - before
        print(f"{work.__name__}: {count}, {grown:+.1f} MB")
        assert grown < 10.0
