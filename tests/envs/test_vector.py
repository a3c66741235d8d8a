"""A world of a vector environment is the single environment: for engines, kinds of experiment, constants and faults.

Expected values are those of single environments with the same seeds, actions and constants.
"""

from functools import partial

import gymnasium
import numpy as np
import pytest
from episodes import assert_same
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from opengl import needs_opengl

from gauge_envs import GaugeEnv, Jitter, load_experiment
from gauge_envs.envs.vector import ScoreEpisodes
from gauge_envs.errors import ActionError, EpisodeError, ParameterError

SLIDE, TILTED, BALL = "SlopeSlider-2-wood", "SlopeSlider-3-metal", "BouncingBall-rubber"
SLOW = pytest.mark.slow
NOISE = {"options": {"jitter": Jitter(velocity_m_per_s=0.05)}}
CUBES = [
    {"cube.friction": 0.20, "cube.restitution": 0.1},
    {"cube.friction": 0.30, "cube.mass_kg": 0.12},
    {},
]


def make(name, count=2, **options):
    return gymnasium.make_vec(f"GAUGE/{name}", num_envs=count, **options)


def zeros(envs):
    return np.zeros(envs.action_space.shape, dtype=envs.action_space.dtype)


def kick(rollout, world):
    """Give the first body of a MuJoCo world an impossible speed."""
    rollout.simulation.datas[world].qvel[0] = 900.0


def run_to_end(envs):
    """Return all steps until the episode of every world is over."""
    steps, over = [], np.zeros(envs.num_envs, dtype=bool)
    while not over.all():
        steps.append(envs.step(zeros(envs)))
        over |= steps[-1][2] | steps[-1][3]
    return steps


# --- worlds and single environments ---


def compare(
    name,
    *,
    count=3,
    steps=6,
    options=None,
    constants=None,
    tolerance=1e-9,
    **arguments,
):
    """Step worlds and single environments with the same actions, and compare all results.

    Args:
        name: Name of the variant.
        count: Number of worlds.
        steps: Number of steps.
        options: Options of the reset.
        constants: Parameters of each world.
        tolerance: Largest difference, absolute and relative.
        arguments: Other arguments of `gymnasium.make`.
    """
    varied = {} if constants is None else {"world_parameters": constants}
    envs = make(name, count, **varied, **arguments)
    singles = SyncVectorEnv(
        [
            partial(gymnasium.make, f"GAUGE/{name}", parameters=of_world, **arguments)
            for of_world in constants or ["published"] * count
        ]
    )
    starts = (each.reset(seed=5, options=options) for each in (envs, singles))
    for one, other in zip(*starts, strict=True):
        assert_same(one, other, tolerance)
    singles.action_space.seed(0)
    for _ in range(steps):
        actions = singles.action_space.sample()
        for one, other in zip(envs.step(actions), singles.step(actions), strict=True):
            assert_same(one, other, tolerance)


@pytest.mark.parametrize(
    ("name", "how"),
    [
        (SLIDE, {"steps": 18, "options": {"jitter": True}}),
        (TILTED, NOISE),
        ("Pendulum-metal", NOISE),
        ("CubePush-light", {"options": {"trial": 3}}),
        ("CubeToss-acrylic", {}),
        (SLIDE, {"constants": CUBES}),
        (BALL, {}),
        ("StickStack-soft", {"count": 2, "steps": 3}),
        ("RotatingBall-rayon", {"count": 2, "steps": 2, "options": {"jitter": True}}),
    ],
)
def test_worlds_of_mujoco_are_single_environments(name, how):
    compare(name, **how)


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
            "TextileFlinging-satin",
            {"count": 2, "tolerance": 1e-3},
            marks=SLOW,
        ),
    ],
)
def test_worlds_of_other_engines_are_single_environments(engine, module, name, how):
    pytest.importorskip(module)
    compare(name, backend=engine, **how)


def test_constants_of_a_world_add_to_the_parameters_of_all_worlds():
    envs = make(
        SLIDE,
        parameters={"cube.mass_kg": 0.2},
        world_parameters=[{}, {"cube.friction": 0.2}],
    )
    envs.reset(seed=0)
    rollout = envs.unwrapped.rollout
    first, second = (rollout.experiment_of(world).scene for world in range(2))
    assert first.body("cube").mass_kg == second.body("cube").mass_kg == 0.2
    assert first.contacts[0] == load_experiment(SLIDE).scene.contacts[0]
    assert second.contacts[0].friction == 0.2


@pytest.mark.parametrize("name", ["SlopeSlider-2-wood", "Turntable-Limit-wood"])
def test_vector_env_is_a_direct_base(name):
    """By its direct bases, skrl recognizes an environment of Gymnasium."""
    options = {} if "Limit" in name else {"score": False}
    envs = gymnasium.make_vec(f"GAUGE/{name}", num_envs=2, **options)
    assert VectorEnv in type(envs).__bases__


def test_each_world_takes_its_own_seed():
    envs = make(SLIDE, 3)
    together = envs.reset(seed=7, options={"jitter": True})[0]["bodies"]
    assert envs.unwrapped.seeds_used == (7, 8, 9)
    chosen = envs.reset(seed=[9, 7, 8], options={"jitter": True})[0]["bodies"]
    assert np.array_equal(chosen, together[[2, 0, 1]])


@needs_opengl
def test_pictures_are_those_of_single_environments():
    size = {"render_mode": "rgb_array", "width": 80, "height": 60}
    envs = make(SLIDE, **size)
    env = gymnasium.make(f"GAUGE/{SLIDE}", **size)
    for environment, action in ((envs, zeros(envs)), (env, 0)):
        environment.reset(seed=0)
        environment.step(action)
    expected = env.render()
    assert len(np.unique(expected)) > 10
    for picture in envs.render():
        # The first picture of a renderer may differ in a rounding of its normals.
        assert np.abs(picture.astype(int) - expected).max() <= 1
    envs.close()
    env.close()


def test_mistakes_raise_an_error():
    for options in ({"count": 0}, {"count": 2.5}, {"world_parameters": [{}]}):
        with pytest.raises(ParameterError, match=r"num_envs|world_parameters has 1"):
            make(SLIDE, **options)
    with pytest.raises(ParameterError, match="max_episode_steps is 3, and the episode"):
        make(SLIDE, max_episode_steps=3)
    envs = make(SLIDE)
    with pytest.raises(EpisodeError, match="reset before step"):
        envs.step(zeros(envs))
    with pytest.raises(ParameterError, match="3 seeds for 2 worlds"):
        envs.reset(seed=[1, 2, 3])
    envs.reset(seed=0)
    for actions in (0, np.zeros(3, dtype=int), [0, 1], [0, "up"], None):
        with pytest.raises(ActionError):
            envs.step(actions)
    assert envs.step([0, 0])[4]["frame"].tolist() == [1, 1]
    envs.close()
    with pytest.raises(EpisodeError, match="after close"):
        envs.reset()


# --- scores ---


def test_score_arrays_equal_the_scores_of_the_worlds():
    """A solution does not score a world with another start or another friction; trials score any friction."""
    place_m = (0.46, 0.40688, 0.213902)
    for name, constants, is_scored in (
        (SLIDE, [{}, {"cube.friction": 0.2}], [True, True]),
        ("SlopeSlider-3-wood", [{}, {"cube.friction": 0.2}], [True, False]),
        ("Turntable-1-wood", [{}, {"cube.position_m": place_m}], [True, False]),
    ):
        envs = make(name, world_parameters=constants, score_arrays=True)
        envs.reset(seed=1)
        infos = run_to_end(envs)[-1][4]
        assert "score" not in infos
        scores = envs.unwrapped.scores()
        expected = np.array([score.rmse for score in scores], dtype=float)
        assert infos["rmse"] == pytest.approx(expected, rel=1e-6, nan_ok=True)
        assert infos["_rmse"].tolist() == is_scored
        assert infos["reference"][0] == infos["reference"][1] != "none"


def test_a_world_that_diverged_has_no_score_and_its_own_length():
    envs = RecordEpisodeStatistics(make(BALL, score_arrays=True))
    envs.reset(seed=0)
    envs.step(zeros(envs))
    kick(envs.unwrapped.rollout, 0)
    assert envs.step(zeros(envs))[4]["episode"]["l"].tolist() == [2, 0]
    infos = envs.step(zeros(envs))[4]
    assert infos["frame"].tolist() == [0, 3]
    for _ in range(14):
        infos = envs.step(zeros(envs))[4]
    assert infos["episode"]["l"].tolist() == [0, 17]
    assert infos["_rmse"].tolist() == [False, True]
    assert np.isnan(infos["rmse"][0])


def test_arrays_need_a_reference_and_a_native_vector_environment():
    with pytest.raises(ParameterError, match="needs a reference, and it has none"):
        make("RotatingBall-satin", score_arrays=True)
    with pytest.raises(ParameterError, match="expected a GaugeVectorEnv"):
        ScoreEpisodes(SyncVectorEnv([lambda: GaugeEnv(SLIDE)]))


def test_training_leaves_scores_out():
    envs = make(SLIDE, score=False)
    envs.reset(seed=0)
    assert "score" not in run_to_end(envs)[-1][4]


@pytest.mark.parametrize(
    ("name", "mode", "autoreset"),
    [
        (SLIDE, "sync", AutoresetMode.NEXT_STEP),
        (TILTED, "sync", AutoresetMode.SAME_STEP),
        (SLIDE, "async", AutoresetMode.SAME_STEP),
        pytest.param(TILTED, "async", AutoresetMode.NEXT_STEP, marks=SLOW),
    ],
)
def test_separate_environments_score_themselves(name, mode, autoreset):
    options = {"autoreset_mode": autoreset}
    envs = make(name, vectorization_mode=mode, vector_kwargs=options)
    envs.reset(seed=0)
    infos = run_to_end(envs)[-1][4]
    if autoreset is AutoresetMode.SAME_STEP:
        infos = infos["final_info"]
    assert infos["_score"].all()
    assert infos["score"][0].rmse > 0.0
    envs.close()
