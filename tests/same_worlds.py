"""A world of a vector environment is the single environment: one comparison for all engines, modes and faults."""

import gymnasium
import numpy as np


def kick(simulation):
    """Give the first body a speed that nothing in the scene can give it; for simulations of MuJoCo."""
    simulation = getattr(simulation, "simulation", simulation)
    simulation.data.qvel[0] = 900.0


def assert_worlds_are_singles(
    envs, *, steps=None, options=None, constants=None, kicks=None, **arguments
):
    """Step a vector environment and single ones with the same actions, and compare all that they return.

    Args:
        envs: Vector environment. A world that has ended waits for the others.
        steps: Number of steps; to the end and into the next episode without it.
        options: Options of `reset`.
        constants: Parameters of each world.
        kicks: World that is kicked before each of some frames.
        arguments: Other arguments of `gymnasium.make`.
    """
    options = options or {}
    kicks = kicks or {}
    name = envs.spec.id
    batches = [envs.reset(seed=5, options=options)]
    envs.action_space.seed(0)
    env = gymnasium.make(name, disable_env_checker=True, **arguments)
    frames = range(steps or env.unwrapped.experiment.frame_count - 1)
    actions = [envs.action_space.sample() for _ in frames]
    for frame, action in enumerate(actions):
        if frame in kicks:
            kick(envs.unwrapped.worlds.worlds[kicks[frame]])
        batches.append(envs.step(action))
    records = [one.trajectory() for one in getattr(envs.unwrapped, "episodes", [])]
    is_over = batches[-1][2] | batches[-1][3]
    after = envs.step(actions[0]) if is_over.all() else None
    for number in range(envs.num_envs):
        if constants is not None:
            arguments["parameters"] = constants[number]
        env = gymnasium.make(name, disable_env_checker=True, **arguments)
        expected = [env.reset(seed=5 + number, options=options)]
        for frame, action in enumerate(actions):
            if kicks.get(frame) == number:
                kick(env.unwrapped.simulation)
            expected.append(env.step(action[number]))
            if any(expected[-1][2:4]):
                break
        assert_same_steps(batches, number, expected)
        if records:
            assert_same_record(records[number], env.unwrapped.trajectory())
        if after is not None:
            assert_same_observation(after[0], number, env.reset()[0])
            assert [part[number] for part in after[1:4]] == [0.0, False, False]
            assert after[4]["frame"][number] == 0


def assert_same_steps(batches, number, expected):
    """Compare the steps of a world with those of an environment, after whose end the world waits."""
    for batch, single in zip(batches, expected, strict=False):
        assert_same_observation(batch[0], number, single[0])
        assert [part[number] for part in batch[1:-1]] == list(single[1:-1])
        info = batch[-1]
        assert {key: info[key][number] for key in single[-1]} == single[-1]
    for batch in batches[len(expected) :]:
        assert_same_observation(batch[0], number, expected[-1][0])
        assert batch[1][number] == 0.0
        assert not batch[-1]["_frame"][number]


def assert_same_record(mine, other):
    for key, values in vars(other).items():
        assert np.array_equal(getattr(mine, key), values, equal_nan=True), key


def assert_same_observation(batch, number, single):
    assert batch.keys() == single.keys()
    for key, values in single.items():
        assert np.array_equal(batch[key][number], values), key
