"""A world of a vector environment is the single environment: for engines, kinds of experiment, constants and faults."""

import gymnasium
import numpy as np
import pytest

from gauge_envs import Jitter, load_experiment
from gauge_envs.backends import LoopedSimulation
from gauge_envs.errors import EpisodeError, ParameterError

SLIDE, DROP = "SlopeSlider-2-wood", "BouncingBall-rubber"
SLOW = pytest.mark.slow
SCATTERED = {"options": {"jitter": Jitter(velocity_m_per_s=0.05)}}
COARSE = {"timestep_s": 1 / 900}
"""A step for what does not depend on it."""

CUBES = [
    {"cube.friction": 0.20, "cube.restitution": 0.1},
    {"cube.friction": 0.30, "cube.mass_kg": 0.12},
    {},
]


def kick(rollout, world):
    """Give the first body of a MuJoCo world a speed that nothing in the scene can give it."""
    rollout.simulation.datas[world].qvel[0] = 900.0


def assert_near(batch, single, tolerance):
    if isinstance(single, dict):
        for key, value in single.items():
            assert_near(batch[key], value, tolerance)
    elif isinstance(single, np.ndarray | float):
        np.testing.assert_allclose(batch, single, rtol=tolerance, atol=tolerance)
    else:
        assert batch == single


def compare(
    name,
    *,
    count=3,
    steps=6,
    options=None,
    constants=None,
    kicked=None,
    tolerance=1e-9,
    **arguments,
):
    """Step worlds and single environments with the same actions; compare all that they return.

    Args:
        name: Name of the variant.
        count: Number of worlds.
        steps: Number of steps; None for the whole episode.
        options: Options of the reset.
        constants: Parameters of each world.
        kicked: Number of a world that is kicked before the third step.
        tolerance: Largest difference, absolute and relative.
        arguments: Other arguments of `gymnasium.make`.
    """
    varied = {} if constants is None else {"world_parameters": constants}
    envs = gymnasium.make_vec(f"GAUGE/{name}", num_envs=count, **varied, **arguments)
    envs.action_space.seed(0)
    steps = steps or envs.unwrapped.experiment.frame_count - 1
    actions = [envs.action_space.sample() for _ in range(steps)]
    batches = [envs.reset(seed=5, options=options)]
    for frame, action in enumerate(actions):
        if frame == 2 and kicked is not None:
            kick(envs.unwrapped.rollout, kicked)
        batches.append(envs.step(action))
    for world in range(count):
        if constants is not None:
            arguments["parameters"] = constants[world] or "calibrated"
        env = gymnasium.make(f"GAUGE/{name}", disable_env_checker=True, **arguments)
        single = run_single(env.unwrapped, world, actions, options, kicked)
        compare_world(batches, world, single, tolerance)
        env.close()
    envs.close()


def run_single(env, world, actions, options, kicked):
    """Return what reset and steps of a single environment return, until its episode ends."""
    steps = [env.reset(seed=5 + world, options=options)]
    for frame, action in enumerate(actions):
        if frame == 2 and world == kicked:
            kick(env.rollout, 0)
        steps.append(env.step(action[world]))
        if any(steps[-1][2:4]):
            break
    return steps


def compare_world(batches, world, steps, tolerance):
    """Compare a world with a single environment, after whose end the world waits."""
    for batch, single in zip(batches, steps, strict=False):
        rows = {key: values[world] for key, values in batch[0].items()}
        assert_near(rows, single[0], tolerance)
        for values, value in zip(batch[1:-1], single[1:-1], strict=True):
            assert_near(values[world], value, tolerance)
        infos = {key: batch[-1][key][world] for key in single[-1]}
        assert_near(infos, single[-1], tolerance)
    for batch in batches[len(steps) :]:
        rows = {key: values[world] for key, values in batch[0].items()}
        assert_near(rows, steps[-1][0], tolerance)
        assert batch[1][world] == 0.0
        assert not batch[-1]["_frame"][world]


@pytest.mark.parametrize(
    ("name", "how"),
    [
        (SLIDE, {"steps": None, "options": {"jitter": True}}),
        ("SlopeSlider-3-metal", SCATTERED),
        ("Pendulum-metal", SCATTERED),
        ("NewtonsCradle-metal", SCATTERED | {"steps": 2}),
        ("Turntable-1-wood", SCATTERED),
        ("CubePush-light", {"options": {"trial": 3}}),
        ("CubeToss-acrylic", {}),
        (SLIDE, {"constants": CUBES}),
        (DROP, {"kicked": 1}),
        ("StickStack-soft", {"count": 2, "steps": 3}),
        ("RotatingBall-rayon", {"count": 2, "steps": 2, "options": {"jitter": True}}),
    ],
)
def test_worlds_of_mujoco_are_single_environments(name, how):
    compare(name, settings=COARSE if name in (SLIDE, DROP) else None, **how)


@pytest.mark.parametrize(
    ("engine", "module", "name", "how"),
    [
        ("rapier", "rapier3d", SLIDE, {"constants": CUBES}),
        ("pybullet", "pybullet", SLIDE, {"options": {"jitter": True}}),
        ("physx", "sapien", SLIDE, {}),
        pytest.param("newton", "newton", SLIDE, {"tolerance": 1e-4}, marks=SLOW),
        pytest.param(
            "newton",
            "newton",
            "NonsmoothContact-1-wood",
            {"options": {"jitter": True}, "tolerance": 1e-3},
            marks=SLOW,
        ),
        pytest.param(
            "newton",
            "newton",
            "TextileFlinging-satin",
            {"count": 2, "tolerance": 1e-3},
            marks=SLOW,
        ),
    ],
)
def test_worlds_of_other_engines_are_single_environments(engine, module, name, how):
    pytest.importorskip(module)
    compare(name, backend=engine, **how)


def test_constants_of_a_world_come_on_top_of_those_of_all():
    envs = gymnasium.make_vec(
        f"GAUGE/{SLIDE}",
        num_envs=2,
        parameters={"cube.mass_kg": 0.2},
        world_parameters=[{}, {"cube.friction": 0.2}],
    )
    envs.reset(seed=0)
    rollout = envs.unwrapped.rollout
    first, second = (rollout.experiment_of(world).scene for world in range(2))
    calibrated = load_experiment(SLIDE).scene
    assert first.body("cube").mass_kg == second.body("cube").mass_kg == 0.2
    assert first.contacts[0] == calibrated.contacts[0]
    assert second.contacts[0].friction == 0.2
    assert isinstance(rollout.simulation, LoopedSimulation)


def zeros(envs):
    return np.zeros(envs.action_space.shape, dtype=envs.action_space.dtype)


def test_scores_as_arrays_are_those_of_each_world():
    envs = gymnasium.make_vec(f"GAUGE/{SLIDE}", num_envs=3, score_arrays=True)
    envs.reset(seed=1, options={"jitter": True})
    for _ in range(18):
        *_, infos = envs.step(zeros(envs))
    assert "score" not in infos
    scores = envs.unwrapped.scores()
    for key in ("rmse", "rmse_normalized", "rmse_aligned_normalized", "time_offset_s"):
        expected = [getattr(score, key) for score in scores]
        assert infos[f"_{key}"].all()
        assert infos[key] == pytest.approx(expected, rel=1e-6, abs=2e-6)


def test_a_world_with_another_geometry_has_no_score_in_arrays_and_alone():
    place_m = (0.46, 0.40688, 0.213902)
    envs = gymnasium.make_vec(
        "GAUGE/Turntable-1-wood",
        num_envs=2,
        world_parameters=[{}, {"cube.position_m": place_m}],
        score_arrays=True,
    )
    envs.reset(seed=1)
    infos = {}
    while "rmse" not in infos:
        *_, infos = envs.step(zeros(envs))
    expected = [score.rmse for score in envs.unwrapped.scores()]
    assert expected[1] is None
    expected = np.array(expected, dtype=float)
    assert infos["rmse"] == pytest.approx(expected, rel=1e-9, nan_ok=True)


def test_worlds_that_diverged_have_no_scores():
    envs = gymnasium.make_vec(f"GAUGE/{DROP}", num_envs=2, score_arrays=True)
    envs.reset(seed=0)
    kick(envs.unwrapped.rollout, 0)
    over = False
    while not over:
        *_, terminations, truncations, infos = envs.step(zeros(envs))
        over = (terminations | truncations).all()
    assert infos["_rmse"].tolist() == [False, True]
    assert np.isnan(infos["rmse"][0])


def test_training_leaves_scores_out():
    envs = gymnasium.make_vec(f"GAUGE/{SLIDE}", num_envs=2, score=False)
    single = gymnasium.make(f"GAUGE/{SLIDE}", score=False)
    for env, action in ((envs, zeros(envs)), (single, 0)):
        env.reset(seed=0)
        for _ in range(18):
            *_, truncated, infos = env.step(action)
        assert np.all(truncated) and "score" not in infos


def test_trajectories_of_worlds_end_where_their_episodes_do():
    envs = gymnasium.make_vec(f"GAUGE/{SLIDE}", num_envs=2).unwrapped
    envs.reset(seed=0)
    envs.step(zeros(envs))
    times_s, samples = envs.rollout.trajectories()
    assert samples.shape == (2, len(times_s), 3)
    assert np.isfinite(samples[:, :7]).all()
    assert np.isnan(samples[:, 7:]).all()
    assert np.array_equal(samples[1, :7], envs.rollout.trajectory(1).samples)


def test_wrong_numbers_of_worlds_and_closed_worlds_are_refused():
    for arguments in (
        {"num_envs": 0},
        {"num_envs": 2, "world_parameters": [{}]},
    ):
        with pytest.raises(ParameterError):
            gymnasium.make_vec(f"GAUGE/{SLIDE}", **arguments)
    envs = gymnasium.make_vec(f"GAUGE/{SLIDE}", num_envs=2)
    with pytest.raises(EpisodeError, match="reset before step"):
        envs.step(zeros(envs))
    with pytest.raises(ParameterError, match="3 seeds for 2 worlds"):
        envs.reset(seed=[1, 2, 3])
    envs.close()
    with pytest.raises(EpisodeError, match="after close"):
        envs.reset()
