"""Every id through the same checks, and each misuse its error."""

import warnings

import gymnasium
import numpy as np
import pytest
import scipy.optimize
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import FlattenObservation
from places import RIGID, one_of_a_kind

import gauge_envs
from gauge_envs.errors import NoRewardWarning
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.control.tasks import control_tasks

SHORT = tuple(
    name
    for name in RIGID
    if name.split("-")[0] not in ("Pendulum", "NewtonsCradle", "WallBreaking")
)


def test_75_ids_in_22_families_are_registered():
    # Control tasks and experiments beyond the benchmark are extra.
    beyond = {variant.id for variant in gauge_envs.beyond_variants()}
    extra = {*(task.id for task in control_tasks()), *beyond}
    ids = [
        key
        for key in gymnasium.registry
        if key.startswith("GAUGE/") and key not in extra
    ]
    assert len(ids) == 75
    assert len({variant.family for variant in gauge_envs.variants()}) == 22
    assert {variant.id for variant in gauge_envs.variants()} == set(ids)
    assert len(RIGID) == 30
    assert "GAUGE/CubeToss-acrylic" in beyond
    assert beyond <= set(gymnasium.registry)


def kind_of(name):
    """What the spaces of an id depend on: its task of control, or what is observed and whether it is driven."""
    if "-Limit-" in name:
        return name.split("-")[0]
    experiment = gauge_envs.load_experiment(name)
    return experiment.score.observable, bool(experiment.scene.drivers)


ALL = (
    *(variant.name for variant in gauge_envs.variants()),
    *(task.name for task in control_tasks()),
)
checked_ids = pytest.mark.parametrize("name", one_of_a_kind(ALL, kind_of))


@pytest.fixture
def no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # A reference that ends before the episode is no fault of the environment.
        warnings.simplefilter("ignore", NoRewardWarning)
        yield


@checked_ids
@pytest.mark.usefixtures("no_warnings")
def test_gymnasiums_checker_passes(name):
    env = gymnasium.make(f"GAUGE/{name}", disable_env_checker=True)
    check_env(env.unwrapped, skip_render_check=True)


@checked_ids
@pytest.mark.usefixtures("no_warnings")
def test_stable_baselines_checker_passes_with_flat_observations(name):
    checker = pytest.importorskip(
        "stable_baselines3.common.env_checker", reason="extra 'rl' is not installed"
    )
    checker.check_env(FlattenObservation(gymnasium.make(f"GAUGE/{name}")))


@pytest.mark.parametrize(
    "name",
    one_of_a_kind(
        (one.name for one in gauge_envs.variants() if one.name not in RIGID), kind_of
    ),
)
def test_every_deformable_id_steps_inside_its_spaces(name):
    env = gymnasium.make(f"GAUGE/{name}").unwrapped
    observation, _ = env.reset(seed=0)
    action = (
        0
        if isinstance(env.action_space, gymnasium.spaces.Discrete)
        else np.zeros(env.action_space.shape)
    )
    assert observation in env.observation_space
    if "markers" in observation:
        # Markers stand for nodes that lie nearer than 1 cm, and each for another.
        distance = np.linalg.norm(
            observation["markers"] - env.experiment.scene.markers.positions_m, axis=1
        )
        assert distance.max() < 0.01
        assert len(np.unique(observation["markers"], axis=0)) == len(
            observation["markers"]
        )
    observation, reward, terminated, _, info = env.step(action)
    assert observation in env.observation_space
    assert np.isfinite(observation["observable"]).all()
    assert not terminated
    assert (reward == 0.0) == (info["reference"] == "none")


@pytest.mark.parametrize("proxy", ["node", "material"])
def test_foam_markers_follow_the_grip(proxy, rollout):
    # The law needs no fine mesh.
    env, trajectory, _ = rollout(
        "FoamStretching-soft", marker_proxy=proxy, settings={"cell_m": 0.05}
    )
    moved = trajectory.markers_m[-1] - trajectory.markers_m[0]
    height = (
        trajectory.markers_m[0, :, 2]
        - env.experiment.scene.body("base-1").pose.position_m[2]
    )
    # Between the grips, 12.85 mm inside the foam's ends, the stretch of 9.23 mm is nearly even.
    share = (height - 0.012 - 0.01285) / (0.2 - 2 * 0.01285)
    driven = env.experiment.scene.drivers[0].motions[0].value(1e3)
    assert moved[:, 2] == pytest.approx(driven * share, abs=3e-4)


@pytest.mark.parametrize(
    "name",
    [
        "StickStack-soft",
        "CantileverBeam-soft",
        "FoamBending-soft",
        "TextileBending-satin",
    ],
)
def test_material_points_start_at_the_markers(name):
    env = gymnasium.make(f"GAUGE/{name}", marker_proxy="material")
    observation, _ = env.reset(seed=0)
    markers = env.unwrapped.experiment.scene.markers.positions_m
    assert observation["markers"] == pytest.approx(np.asarray(markers), abs=1e-6)
    over = False
    for _ in range(3):
        observation, *_, over, _ = env.step(
            np.zeros(env.action_space.shape) if env.action_space.shape else 0
        )
    assert not over
    assert np.isfinite(observation["markers"]).all()


@pytest.mark.parametrize("name", one_of_a_kind(SHORT))
def test_an_episode_has_the_published_frames_and_repeats_bit_for_bit(name, rollout):
    # Neither depends on the step.
    settings = {"timestep_s": 1 / 900}
    env, trajectory, info = rollout(name, settings=settings)
    assert len(trajectory.frames) == env.experiment.frame_count
    assert len(trajectory.times_s) == 6 * (env.experiment.frame_count - 1) + 1
    assert trajectory.frames == pytest.approx(trajectory.samples[::6])
    assert info["frame"] == env.experiment.frame_count - 1
    assert "diverged" not in info
    assert isinstance(info["score"], gauge_envs.Score)
    again = rollout(name, settings=settings)[1]
    assert np.array_equal(trajectory.samples, again.samples)
    assert np.array_equal(trajectory.bodies, again.bodies)


@pytest.mark.parametrize("name", RIGID)
def test_episode_starts_from_the_published_pose(name):
    env = gymnasium.make(f"GAUGE/{name}")
    observation, info = env.reset(seed=0)
    scene = env.unwrapped.experiment.scene
    recorded = env.unwrapped.experiment.recorded
    expected = np.array([scene.body(body).pose.position_m for body in recorded])
    assert observation["observable"] == pytest.approx(1e3 * expected.ravel(), abs=1e-6)
    assert observation["bodies"][:, 7:] == pytest.approx(0.0, abs=1e-12)
    assert observation["time"] == pytest.approx([0.0])
    band = env.unwrapped.band
    assert info["reference"] == (band.kind if band else "none")


def test_reward_is_minus_the_mean_abs_z(rollout):
    env = gymnasium.make("GAUGE/SlopeSlider-2-wood")
    env.reset(seed=0)
    rewards = [env.step(0)[1] for _ in range(18)]
    band = env.unwrapped.band
    z = (band.project(env.unwrapped.trajectory().frames) - band.mean)[
        :, 0
    ] / band.sigma[:, 0]
    expected = np.where(band.measured, -np.abs(z), 0.0)[1:]
    assert rewards == pytest.approx(expected)
    assert min(rewards) < -0.1


def total_reward(env, action_of):
    """Return the sum and the least of the rewards of an episode; `action_of` returns the action of a step."""
    env.reset(seed=0)
    rewards, is_over = [], False
    while not is_over:
        _, reward, terminated, truncated, _ = env.step(action_of())
        rewards.append(reward)
        is_over = terminated or truncated
    return sum(rewards), min(rewards)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["FoamBending-soft", "TextileFlinging-oxford"])
def test_rewards_of_deformable_bodies_are_bounded_and_a_search_climbs_them(name):
    env = gymnasium.make(f"GAUGE/{name}", settings={"preset": "training"}).unwrapped
    shape, random = env.action_space.shape, np.random.default_rng(3)

    def constant(value):
        return total_reward(env, lambda: np.full(shape, value))

    found = scipy.optimize.minimize_scalar(
        lambda value: -constant(value)[0],
        bounds=(-1.0, 1.0),
        method="bounded",
        options={"maxiter": 8},
    )
    nothing = constant(0.0)
    at_random = total_reward(env, lambda: random.uniform(-1.0, 1.0, shape))
    ends = [constant(1.0), constant(-1.0)]
    # The recorded motion is the solved one, so the best constant action is near 0, and pays as much.
    assert abs(found.x) < 0.1
    best = max(nothing[0], -found.fun)
    assert best >= nothing[0] > at_random[0] > max(total for total, _ in ends)
    assert -found.fun > at_random[0]
    assert min(least for _, least in [nothing, at_random, *ends]) > -1.0


def test_reward_is_zero_without_a_reference():
    env = gymnasium.make("GAUGE/RopeWinding-rubber")
    _, info = env.reset(seed=0)
    assert info["reference"] == "none"
    assert env.step(np.zeros(env.action_space.shape))[1] == 0.0


def test_observation_is_si_and_consistent_with_the_motion():
    env = gymnasium.make("GAUGE/BouncingBall-rubber")
    env.reset(seed=0)
    observation = [env.step(0)[0] for _ in range(5)][-1]
    fall_s = 5 / 30
    assert observation["time"] == pytest.approx([fall_s])
    assert observation["bodies"][0, 9] == pytest.approx(
        -GRAVITY_M_PER_S2 * fall_s, rel=1e-6
    )
    assert observation["observable"][2] == pytest.approx(
        1e3 * observation["bodies"][0, 2]
    )
    assert 0.451023 - observation["bodies"][0, 2] == pytest.approx(
        0.5 * GRAVITY_M_PER_S2 * fall_s**2, rel=1e-3
    )


def test_zero_action_replays_the_recorded_motion_and_others_add_to_it():
    env = gymnasium.make("GAUGE/Turntable-1-wood")
    angles = []
    for action in (0.0, 1.0):
        env.reset(seed=0)
        for _ in range(10):
            observation, *_ = env.step(np.array([action]))
        w, z = observation["driver"][0, 3], observation["driver"][0, 6]
        angles.append(2 * np.arctan2(z, w))
    motion = env.unwrapped.experiment.scene.drivers[0].motions[0]
    assert angles[0] == pytest.approx(motion.value(10 / 30), abs=1e-6)
    assert angles[1] - angles[0] == pytest.approx(
        motion.residual_rate * 10 / 30, abs=1e-6
    )


@pytest.mark.parametrize("name", ["Turntable-1-wood", "StickStack-soft"])
def test_the_recorded_motion_is_a_sequence_of_actions(name):
    """With `drivers="action"` a body rests without actions, and the recorded motion is the better policy."""
    recorded = gymnasium.make(f"GAUGE/{name}").unwrapped
    (motion,) = recorded.experiment.scene.drivers[0].motions
    env = gymnasium.make(f"GAUGE/{name}", drivers="action")
    (acted,) = env.unwrapped.experiment.scene.drivers[0].motions
    recorded.reset(seed=0)
    earned = []
    for is_still in (True, False):
        start, info = env.reset(seed=0)
        earned.append(0.0)
        for frame in range(16):
            change = motion.value((frame + 1) / 30) - motion.value(frame / 30)
            action = 0.0 if is_still else 30 * change / acted.residual_rate
            observation, reward, *_, info = env.step(np.array([action]))
            earned[-1] += reward
        if is_still:
            still = pytest.approx(start["driver"][0, :7], abs=2e-6)
            assert observation["driver"][0, :7] == still
    for _ in range(16):
        expected, *_ = recorded.step(np.zeros(1))
    assert observation["driver"][0, :7] == pytest.approx(
        expected["driver"][0, :7], abs=2e-6
    )
    assert earned[0] < 2.0 * earned[1] < 0.0
    assert info["drivers"] == "action"
    np.testing.assert_array_equal(env.unwrapped.band.mean, recorded.band.mean)


def test_reset_forgets_earlier_actions():
    env = gymnasium.make("GAUGE/Turntable-1-wood")
    runs = []
    for warm_up in (False, True):
        if warm_up:
            env.reset(seed=0)
            for _ in range(5):
                env.step(np.array([1.0]))
        env.reset(seed=0)
        for _ in range(5):
            env.step(np.array([0.0]))
        runs.append(env.unwrapped.trajectory().samples)
    assert np.array_equal(*runs)


def test_law_bands_carry_the_body():
    env = gymnasium.make("GAUGE/Turntable-1-metal").unwrapped
    plate = env.experiment.scene.body("plate").pose.position_m
    arm = np.hypot(*(1e-3 * env.band.mean[:, :2] - plate[:2]).T)
    assert arm == pytest.approx(arm[0])
    assert env.band.kind == "analytic"
    holds = gymnasium.make("GAUGE/SlopeSlider-1-metal").unwrapped.band.mean
    assert np.ptp(holds, axis=0) == pytest.approx(0.0, abs=1e-9)


def test_scores_against_real_trials(rollout):
    limits = {"wood": (0.45, 0.95), "plastic": (0.92, 1.10), "metal": (0.80, 0.78)}
    for material, (rmse, dtw) in limits.items():
        score = rollout(f"SlopeSlider-2-{material}")[2]["score"]
        assert score.kind == "trials"
        assert score.rmse_normalized <= rmse
        assert score.dtw_normalized <= dtw


def test_bouncing_ball_error_is_release_restitution_and_height(rollout):
    calibrated = rollout("BouncingBall-rubber")[2]["score"]
    effective = rollout("BouncingBall-rubber", parameters="effective")[2]["score"]
    recorded = rollout("BouncingBall-rubber", parameters="recorded")[2]["score"]
    assert calibrated.rmse_normalized <= 14.5
    assert calibrated.time_offset_s == pytest.approx(0.056, abs=0.005)
    assert calibrated.rmse_aligned < 0.55 * calibrated.rmse
    assert effective.rmse_aligned <= 7.4
    # Nearer to the mean than any real trial.
    assert recorded.rmse_aligned_normalized <= 0.3
    assert (
        recorded.percentile,
        effective.percentile,
    ) == (0.0, 100.0)


def test_slower_body_is_scored_as_slower(rollout):
    signed = [
        rollout("SlopeSlider-2-wood", parameters={"cube.friction": mu})[2][
            "score"
        ].signed_error[0]
        for mu in (0.2, 0.4)
    ]
    assert signed[0] > 0.0 > signed[1]
