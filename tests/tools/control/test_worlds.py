"""Many worlds of a control task: each is the single environment with its constants, to the bit."""

import gymnasium
import numpy as np
import pytest

import gauge_envs  # noqa: F401  # registers the ids
from gauge_envs.tools.control.vector import ControlVectorEnv

CONSTANTS = [{"cube.friction": 0.30}, {"cube.friction": 0.42, "cube.mass_kg": 0.15}, {}]
FAST = {"timestep_s": 1 / 1080}
EXTRAS = {
    "rapier": "rapier3d",
    "newton": "newton",
    "pybullet": "pybullet",
    "physx": "sapien",
    "drake": "pydrake",
}


def singles(task, constants, **options):
    """Return separate environments, as Gymnasium steps them."""
    return gymnasium.vector.SyncVectorEnv(
        [
            lambda one=one: gymnasium.make(
                f"GAUGE/{task}", parameters=one or "calibrated", **options
            )
            for one in constants
        ]
    )


def check(task, constants, *, steps, **options):
    """Compare all that many worlds return with separate environments; return the number of episodes that ended."""
    worlds = gymnasium.make_vec(
        f"GAUGE/{task}", num_envs=len(constants), world_parameters=constants, **options
    )
    others = singles(task, constants, **options)
    random = np.random.default_rng(0)
    found, expected = worlds.reset(seed=3), others.reset(seed=3)
    ended = 0
    for number in range(steps):
        assert np.array_equal(found[0], expected[0])
        for one, other in zip(found[1:-1], expected[1:-1], strict=True):
            assert np.array_equal(one, other)
        assert set(found[-1]) == set(expected[-1])
        for key, values in expected[-1].items():
            assert np.array_equal(found[-1][key], values), key
        ended += int("limit" in expected[-1]) and int(expected[-1]["_limit"].sum())
        share = [0.9, 1.3, 0.9][: len(constants)]
        actions = np.stack(
            [
                one.unwrapped.law_action(fraction)
                for one, fraction in zip(others.envs, share, strict=True)
            ]
        )
        if number % 3 == 0:
            actions = np.clip(
                actions + 0.1 * random.standard_normal(actions.shape), -1, 1
            ).astype(np.float32)
        found, expected = worlds.step(actions), others.step(actions)
    worlds.close()
    others.close()
    return ended


@pytest.mark.parametrize("engine", ["mujoco", "rapier"])
def test_each_world_is_the_single_environment_bit_for_bit(engine):
    """With restarts: worlds end in different frames, and draw their next goals on their own."""
    if engine != "mujoco":
        pytest.importorskip(EXTRAS[engine])
    assert (
        check("Carry-Limit-wood", CONSTANTS, steps=60, backend=engine, settings=FAST)
        >= 4
    )


@pytest.mark.parametrize(
    ("task", "constants"),
    [
        ("Pendulum-Limit-metal", [{"ball.mass_kg": 0.25}, {}]),
        ("Throw-Limit-rubber", [{"ball.restitution": 0.6}, {}]),
        ("Push-Limit-plastic", CONSTANTS[:2]),
        ("SlopeSlider-Limit-metal", CONSTANTS[:2]),
        ("Fling-Limit-satin", [{"textile.areal_density_kg_per_m2": 0.12}, {}]),
    ],
)
def test_all_tasks_run_as_worlds(task, constants):
    check(
        task,
        constants,
        steps=30,
        settings={"preset": "training"} if task.startswith("Fling") else FAST,
    )


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["newton", "pybullet", "physx", "drake"])
@pytest.mark.parametrize("task", ["Carry-Limit-wood", "Pendulum-Limit-metal"])
def test_other_engines_run_worlds_bit_for_bit(engine, task):
    """Newton's worlds share a model, and restart alone in it."""
    pytest.importorskip(EXTRAS[engine])
    constants = CONSTANTS if task.startswith("Carry") else [{"ball.mass_kg": 0.25}, {}]
    ended = check(task, constants, steps=80, backend=engine)
    assert ended >= (4 if task.startswith("Carry") else 1)


def test_spaces_and_order_are_those_of_gymnasium():
    envs = gymnasium.make_vec("GAUGE/Carry-Limit-wood", num_envs=2)
    assert isinstance(envs, ControlVectorEnv)
    assert envs.observation_space.shape == (2, 10)
    assert envs.action_space.shape == (2, 2)
    assert envs.spec.id == "GAUGE/Carry-Limit-wood"
    observations, _ = envs.reset(seed=[5, 5])
    assert np.array_equal(observations[0], observations[1])
    assert observations in envs.observation_space
    assert envs.render() is None


def test_worlds_with_other_constants_differ():
    """A batch in which all worlds have the constants of the first would pass a test of one world."""
    envs = gymnasium.make_vec(
        "GAUGE/Carry-Limit-wood",
        num_envs=2,
        world_parameters=CONSTANTS[:2],
        settings=FAST,
    )
    envs.reset(seed=[0, 0])
    for _ in range(4):
        observations, *_ = envs.step(np.ones((2, 2)))
    assert np.linalg.norm(observations[0, :2] - observations[1, :2]) > 1e-3
