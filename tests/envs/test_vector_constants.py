"""Worlds of one vector environment with constants of their own: each is the single environment with these constants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import gymnasium
import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.backends.base import worlds_of
from gauge_envs.errors import ParameterError

SLIDE, DROP = "SlopeSlider-2-wood", "BouncingBall-rubber"
CUBES = [
    {"cube.friction": 0.20, "cube.restitution": 0.1},
    {"cube.friction": 0.30, "cube.mass_kg": 0.12},
    {"cube.friction": 0.27, "cube.mass_kg": 0.05},
]
BALLS = [{"ball.restitution": 0.70}, {"ball.restitution": 0.80, "ball.mass_kg": 0.2}]


def frames(
    envs: gymnasium.vector.VectorEnv, seed: int = 0, **options: object
) -> list[np.ndarray]:
    envs.reset(seed=seed, options=dict(options))
    over = np.zeros(envs.num_envs, dtype=bool)
    while not over.all():
        _, _, terminated, truncated, _ = envs.step(
            np.zeros(envs.num_envs, dtype=np.int64)
        )
        over |= terminated | truncated
    return [episode.trajectory().frames for episode in envs.unwrapped.episodes]


def single(
    name: str,
    engine: str,
    parameters: dict[str, float],
    seed: int = 0,
    **options: object,
) -> np.ndarray:
    env = gymnasium.make(f"GAUGE/{name}", backend=engine, parameters=parameters)
    env.reset(seed=seed, options=dict(options))
    over = False
    while not over:
        _, _, terminated, truncated, _ = env.step(0)
        over = terminated or truncated
    return env.unwrapped.episode.trajectory().frames


def check(name: str, engine: str, constants: Sequence[dict[str, float]]) -> None:
    envs = gymnasium.make_vec(
        f"GAUGE/{name}",
        num_envs=len(constants),
        backend=engine,
        world_parameters=list(constants),
    )
    together = frames(envs)
    # The constants matter: a batch in which all worlds have those of the first would pass a test of one world.
    assert np.abs(together[0] - together[1]).max() > 10.0
    for world, parameters in zip(together, constants, strict=True):
        assert np.array_equal(world, single(name, engine, parameters))


@pytest.mark.parametrize(("name", "constants"), [(SLIDE, CUBES), (DROP, BALLS)])
@pytest.mark.parametrize("engine", ["mujoco", "rapier"])
def test_each_world_is_the_single_environment_bit_for_bit(
    name: str, constants, engine: str
) -> None:
    if engine != "mujoco":
        pytest.importorskip("rapier3d")
    check(name, engine, constants)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "constants"), [(SLIDE, CUBES), (DROP, BALLS)])
def test_newton_mixes_constants_in_one_model(name: str, constants) -> None:
    pytest.importorskip("newton")
    check(name, "newton", constants)


def test_jitter_keeps_the_constants_of_each_world() -> None:
    envs = gymnasium.make_vec(f"GAUGE/{SLIDE}", num_envs=2, world_parameters=CUBES[:2])
    worlds = frames(envs, seed=3, jitter=True)
    for number in range(2):
        assert np.array_equal(
            worlds[number],
            single(SLIDE, "mujoco", CUBES[number], seed=3 + number, jitter=True),
        )


def test_they_come_on_top_of_the_parameters_of_all_worlds() -> None:
    envs = gymnasium.make_vec(
        f"GAUGE/{SLIDE}",
        num_envs=2,
        parameters={"cube.mass_kg": 0.2},
        world_parameters=[{}, {"cube.friction": 0.2}],
    )
    first, second = (episode.experiment.scene for episode in envs.unwrapped.episodes)
    assert first.body("cube").mass_kg == second.body("cube").mass_kg == 0.2
    assert (first.contacts[0].friction, second.contacts[0].friction) == (0.273673, 0.2)


def test_wrong_constants_are_named() -> None:
    with pytest.raises(
        ParameterError, match="world_parameters has 1 entries for 2 worlds"
    ):
        gymnasium.make_vec(f"GAUGE/{SLIDE}", num_envs=2, world_parameters=[{}])
    with pytest.raises(ParameterError, match=r"cube.*slipperiness"):
        gymnasium.make_vec(
            f"GAUGE/{SLIDE}", num_envs=1, world_parameters=[{"cube.slipperiness": 1.0}]
        )


def test_an_engine_that_does_not_declare_it_gets_its_worlds_one_by_one() -> None:
    """An engine whose batch takes all constants from the first scene would give wrong physics without a warning."""

    class FirstForAll(type(backend("mujoco"))):
        worlds_mix_constants = False

        def build_worlds(self, scenes, settings=None):
            return super().build_worlds(
                [replace(one, contacts=scenes[0].contacts) for one in scenes], settings
            )

    scenes = [load_experiment(SLIDE, parameters).scene for parameters in CUBES[:2]]
    worlds = worlds_of(FirstForAll(), scenes)
    worlds.reset(0)
    for _ in range(60):
        worlds.advance(1 / 180)
    first, second = (world.body_states(("cube",))[0, :3] for world in worlds.worlds)
    assert np.linalg.norm(first - second) > 0.01
