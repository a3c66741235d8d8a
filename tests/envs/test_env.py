"""Environments: observations in SI units, rewards by z, actions on recorded motion, and divergence.

Expected numbers are closed forms (free fall, prescribed rotation) or hand calculations with documented formulas.
"""

import copy
import pickle
import shutil
import threading
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from episodes import run_to_end
from gymnasium import wrappers
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from opengl import needs_opengl
from places import ROOT

import gauge_envs
from gauge_envs import GaugeEnv, LogScore, ScoreEpisode, load_experiment
from gauge_envs.backends import backend
from gauge_envs.backends.shared.resampled import in_intervals
from gauge_envs.envs import arguments
from gauge_envs.envs.limits import diverged_bodies, diverged_nodes
from gauge_envs.envs.reward import Reward
from gauge_envs.errors import (
    ActionError,
    BackendError,
    EpisodeError,
    GaugeError,
    NoRewardWarning,
)
from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind

G = 9.80665
SLIDE, TILTED = "SlopeSlider-2-wood", "SlopeSlider-3-metal"
TURNTABLE, BALL = "Turntable-1-wood", "BouncingBall-rubber"
SILENT = "GAUGE/RotatingBall-satin"


def make(name, **options):
    return gymnasium.make(f"GAUGE/{name}", **options).unwrapped


# --- observation, action, reward ---


def test_a_falling_ball_is_observed_in_si_units():
    env = make(BALL)
    start, _ = env.reset(seed=0)
    observation = [env.step(0)[0] for _ in range(5)][-1]
    fall_s = 5 / 30
    ball = observation["bodies"][0]
    assert observation["time"] == pytest.approx([fall_s])
    assert ball[9] == pytest.approx(-G * fall_s, rel=1e-6)
    fallen_m = start["bodies"][0, 2] - ball[2]
    assert fallen_m == pytest.approx(0.5 * G * fall_s**2, rel=1e-3)
    assert observation["observable"] == pytest.approx(1e3 * ball[:3])
    trajectory = env.trajectory()
    assert trajectory.times_s == pytest.approx(np.arange(31) / 180)
    assert np.array_equal(trajectory.frames, trajectory.samples[::6])


def test_a_zero_action_replays_the_recorded_motion_and_other_actions_add_to_it():
    env = make(TURNTABLE)
    angles = []
    for action in (0.0, 1.0, 0.0):
        env.reset(seed=0)
        for _ in range(10):
            observation, *_ = env.step(np.array([action]))
        w, z = observation["driver"][0, [3, 6]]
        angles.append(2 * np.arctan2(z, w))
    (motion,) = env.experiment.scene.drivers[0].motions
    recorded = motion.value(10 / 30)
    added = motion.residual_rate * 10 / 30
    # The third episode forgets the actions of the second.
    expected = [recorded, recorded + added, recorded]
    assert angles == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("name", [TURNTABLE, "StickStack-soft"])
def test_the_recorded_motion_is_a_sequence_of_actions(name):
    """With `drivers="action"` a body rests without actions, and the recorded motion has the higher reward."""
    recorded = make(name)
    (motion,) = recorded.experiment.scene.drivers[0].motions
    env = make(name, drivers="action")
    (acted,) = env.experiment.scene.drivers[0].motions
    recorded.reset(seed=0)
    for _ in range(16):
        expected, *_ = recorded.step(np.zeros(1))
    rewards = []
    for is_still in (True, False):
        start, info = env.reset(seed=0)
        rewards.append(0.0)
        for frame in range(16):
            change = motion.value((frame + 1) / 30) - motion.value(frame / 30)
            action = 0.0 if is_still else 30 * change / acted.residual_rate
            observation, reward, *_ = env.step(np.array([action]))
            rewards[-1] += reward
        target = start if is_still else expected
        pose = pytest.approx(target["driver"][0, :7], abs=2e-6)
        assert observation["driver"][0, :7] == pose
    assert rewards[0] < 2.0 * rewards[1] < 0.0
    assert info["drivers"] == "action"


def test_the_reward_is_minus_the_mean_of_abs_z():
    env = make(SLIDE)
    env.reset(seed=0)
    rewards = [env.step(0)[1] for _ in range(18)]
    band = env.band
    deviation = band.project(env.trajectory().frames) - band.mean
    z = deviation[:, 0] / band.sigma[:, 0]
    expected = np.where(band.measured, -np.abs(z), 0.0)[1:]
    assert rewards == pytest.approx(expected)
    assert min(rewards) < -0.1


def test_rewards_by_hand():
    """z is 2 / 4 and 6 / 3; the bounded reward divides both by the size of the motion, 10 / sqrt(2) mm."""
    band = Band(
        kind=Kind.NUMERICAL,
        unit="mm",
        coordinates=("x", "y"),
        projection=np.eye(2),
        mean=np.array([[0.0, 0.0], [10.0, 10.0]]),
        sigma=np.full((2, 2), 1.0),
        uncertainty=np.array([[1.0, 1.0], [4.0, 3.0]]),
        measured=np.array([True, True]),
        source="by hand",
    )
    g = np.array([[12.0, 4.0], [10.0, 10.0]])
    none = np.zeros((2, 0, 3))
    assert Reward(band, False).of(1, g, none) == pytest.approx([-1.25, 0.0])
    z = 0.5 * (2.0 + 6.0) / np.sqrt(50.0)
    assert Reward(band, True).of(1, g, none) == pytest.approx([-z / (1.0 + z), 0.0])


def test_a_bouncing_ball_with_measured_constants_is_nearer_than_any_trial():
    scores = {}
    sets = {
        "published": "published",
        "restitution": {"ball.restitution": 0.736925},
        "measured": "measured",
    }
    for name, parameters in sets.items():
        env = gymnasium.make(f"GAUGE/{BALL}", parameters=parameters)
        scores[name] = run_to_end(env)[1]["score"]
    assert scores["published"].time_offset_s == pytest.approx(0.056, abs=0.005)
    assert scores["restitution"].like_reality == "no"
    assert scores["measured"].distance < 0.1 * scores["measured"].real_limit
    assert scores["measured"].rmse_aligned_normalized <= 0.3


@pytest.mark.parametrize("step_s", [0.004, 0.02])
def test_between_steps_a_fall_has_the_error_of_eulers_method(step_s):
    """Steps of Euler's method lie on a parabola; between them the error is at most g h^2 / 8."""
    scene = load_experiment(BALL).scene
    settings = {"preset": "out_of_box", "timestep_s": step_s}
    settings["drive_interval_s"] = step_s
    fall = in_intervals(backend("mujoco").build(scene, settings), scene)
    start_m = fall.body_states(["ball"])[0, 0, 2]
    errors_m = []
    for sample in range(1, 37):
        fall.advance(1 / 180)
        time_s = sample / 180
        expected_m = start_m - 0.5 * G * time_s * (time_s + step_s)
        errors_m.append(fall.body_states(["ball"])[0, 0, 2] - expected_m)
    limit_m = G * step_s**2 / 8.0
    assert 0.8 * limit_m < max(np.abs(errors_m)) < limit_m + 1e-9
    # 18 intervals are 0.1 s, a whole number of steps.
    assert abs(errors_m[17]) < 1e-9


def test_eight_threads_with_their_own_environment_give_the_same_numbers():
    def frames(name):
        env = make(name)
        run_to_end(env)
        return env.trajectory().samples.tolist()

    names = [SLIDE, BALL]
    alone = [frames(name) for name in names]
    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(frames, names * 4)) == alone * 4


# --- divergence ---


@pytest.mark.parametrize(
    ("column", "limit", "reason"),
    [
        (1, 100.0, "second is more than 100 m from the origin"),
        (8, 50.0, "second moves faster than 50 m/s"),
        (12, 1e4, "second spins faster than 10000 rad/s"),
        (4, np.inf, "the state of second is not finite"),
    ],
)
def test_a_body_beyond_a_limit_has_diverged_in_its_world(column, limit, reason):
    at_rest = np.array([0.0, 0.0, 1.0, 1.0, *[0.0] * 9])
    states = np.tile(at_rest, (3, 2, 1))
    within = 0.999 * limit if np.isfinite(limit) else 1.0
    states[:, 1, column] = [within, -1.001 * limit, 0.0]
    assert diverged_bodies(["first", "second"], states) == {1: reason}


def test_a_deformable_body_may_span_three_times_its_start():
    corners = np.indices((2, 2, 2)).reshape(3, -1).T * 0.1
    far = corners + 100.0 * np.eye(3)[1]
    broken = np.full_like(corners, np.nan)
    nodes_m = np.stack([2.997 * corners, 3.003 * corners, far, broken])
    reasons = diverged_nodes("foam", nodes_m, np.sqrt(3.0) * 0.1)
    assert sorted(reasons) == [1, 2, 3]
    assert "3 times" in reasons[1]
    assert "100 m" in reasons[2]
    assert "not finite" in reasons[3]


@pytest.mark.parametrize(
    ("speed", "reason"),
    [(500.0, "ball moves faster than 50 m/s"), (np.nan, "MuJoCo found a velocity")],
)
def test_divergence_terminates_with_its_reason_and_without_a_score(speed, reason):
    env = gymnasium.make(f"GAUGE/{BALL}")
    env.reset(seed=0)
    env.unwrapped.rollout.simulation.data.qvel[0] = speed
    *_, terminated, truncated, info = env.step(0)
    assert terminated and not truncated
    assert reason in info["diverged"]
    assert info["score"].rmse is None
    with pytest.raises(EpisodeError, match="the episode is over, call reset"):
        env.step(0)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (lambda states: states.tolist(), "a list of shape"),
        (lambda states: states[..., :12], r"shape \(1, 1, 12\)"),
        (lambda states: 2.0 * states, "'cube' at the start, .*unit quaternion"),
        (lambda states: np.nan * states, "nan.* for 'cube' at the start"),
    ],
)
def test_wrong_states_of_an_engine_raise_an_error(fault, message, monkeypatch):
    kind = type(make(SLIDE).rollout.simulation)
    states = kind.body_states
    monkeypatch.setattr(
        kind, "body_states", lambda self, names: fault(states(self, names))
    )
    with pytest.raises(BackendError, match=rf"body_states returned .*{message}"):
        make(SLIDE)


# --- mistakes of the caller ---


@pytest.mark.parametrize("maker", [gymnasium.make, gymnasium.make_vec])
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"backend": "mujocoo"}, "unknown backend 'mujocoo'; did you mean mujoco"),
        ({"backend": "isaac"}, "'isaac'; Isaac Sim .*, see docs/engines/isaac_sim.md"),
        ({"parameters": "fitted"}, "no parameter set 'fitted'"),
        ({"settings": "fast"}, "settings is 'fast', expected a mapping"),
        ({"marker_proxy": "nearest"}, "choose 'material' or 'node'"),
        ({"render_mode": "ansi"}, "choose None or .*'rgb_array'"),
        ({"backnd": "newton"}, "unknown argument of .* 'backnd'; did you mean backend"),
    ],
)
def test_make_and_make_vec_name_wrong_arguments(maker, changes, message):
    with pytest.raises(GaugeError, match=message):
        maker(f"GAUGE/{SLIDE}", **changes)


@pytest.mark.parametrize("name", ["Funnel-satin", "RopeWinding-rubber"])
@pytest.mark.usefixtures("rigid_only")
def test_make_raises_an_error_for_an_unsupported_id(name):
    message = "backend 'mujoco' cannot build it: .*; no other backend"
    with pytest.raises(GaugeError, match=message):
        make(name)


def test_calls_out_of_order_raise_an_error():
    env = GaugeEnv(SLIDE, render_mode="rgb_array")
    for call in (lambda: env.step(0), env.render, env.trajectory):
        with pytest.raises(EpisodeError, match="reset"):
            call()
    env.reset(seed=0)
    env.close()
    env.close()
    for call in (lambda: env.step(0), env.render, env.reset, env.score):
        with pytest.raises(EpisodeError, match="after close; make the environment"):
            call()


UNIQUE = [
    lambda: gymnasium.make(f"GAUGE/{SLIDE}"),
    lambda: gymnasium.make_vec(f"GAUGE/{SLIDE}", num_envs=2),
    lambda: gymnasium.make("GAUGE/SlopeSlider-Limit-wood"),
]
"""An environment of each class."""


@pytest.mark.parametrize("build", UNIQUE)
@pytest.mark.parametrize("copied", [pickle.dumps, copy.copy, copy.deepcopy])
def test_an_environment_cannot_be_copied(build, copied):
    with pytest.raises(GaugeError, match="cannot be copied or pickled: make it again"):
        copied(build().unwrapped)


@pytest.mark.parametrize("build", UNIQUE)
def test_two_threads_in_one_environment_get_an_error(build):
    """Each call of the second thread falls into a call of the first one, or between two."""
    # A wrapper closes its environment when nobody holds it.
    wrapped = build()
    env = wrapped.unwrapped
    inside, outside = threading.Event(), threading.Event()
    advance = env.rollout.simulation.advance

    def slow(seconds):
        inside.set()
        outside.wait(60.0)
        advance(seconds)

    env.rollout.simulation.advance = slow
    env.reset(seed=0)
    action = np.zeros(env.action_space.shape, env.action_space.dtype)
    with ThreadPoolExecutor(1) as other:
        step = other.submit(env.step, action)
        assert inside.wait(60.0)
        for call in (env.reset, lambda: env.step(action), env.render, env.close):
            with pytest.raises(EpisodeError, match="make one for each thread"):
                call()
        outside.set()
        step.result()
    env.step(action)
    env.close()


@pytest.mark.parametrize(
    ("name", "actions"),
    [
        (SLIDE, [1, "0", None, 0.5, np.zeros(2), np.nan]),
        (TURNTABLE, [[np.nan], [1.001], [-1.001], np.zeros(2), 0.0, "left", None]),
    ],
)
def test_a_wrong_action_is_an_error_and_changes_nothing(name, actions):
    env = make(name)
    env.reset(seed=0)
    for action in actions:
        with pytest.raises(ActionError, match=f"GAUGE/{name}: action"):
            env.step(action)
    if name == TURNTABLE:
        message = r"has shape \(\), expected \(1,\), as \[0\.0\]"
        with pytest.raises(ActionError, match=message):
            env.step(0.0)
    zero = np.zeros(env.action_space.shape, env.action_space.dtype)
    assert env.step(zero)[4]["frame"] == 1


# --- what Gymnasium does with an environment ---


def test_a_spec_as_json_rebuilds_the_run():
    env = gymnasium.make(
        "GAUGE/FoamStretching-soft",
        parameters={"foam.young_modulus_pa": 50000.0},
        settings={"timestep_s": 1 / 3600},
        marker_proxy="node",
        render_mode="rgb_array",
        width=80,
    )
    again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    ours, theirs = env.unwrapped, again.unwrapped
    assert theirs.arguments == ours.arguments
    assert theirs.experiment == ours.experiment
    assert theirs.rollout.simulation.settings["timestep_s"] == 1 / 3600
    assert (theirs.render_mode, theirs.spec.kwargs["width"]) == ("rgb_array", 80)


@needs_opengl
def test_the_checker_of_gymnasium_passes_with_pictures(monkeypatch):
    env = make(SLIDE, render_mode="rgb_array", width=80, height=60)
    # A window needs a display.
    modes = [mode for mode in env.metadata["render_modes"] if mode != "human"]
    monkeypatch.setitem(type(env).metadata, "render_modes", modes)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env)


@pytest.mark.parametrize(
    "layer", [wrappers.FlattenObservation, wrappers.RecordEpisodeStatistics]
)
def test_wrappers_go_before_and_after_the_score(layer):
    outside = layer(gymnasium.make(f"GAUGE/{TILTED}"))
    inside = ScoreEpisode(layer(GaugeEnv(TILTED)))
    scores = [run_to_end(env)[1]["score"] for env in (outside, inside)]
    assert scores[0] == scores[1]
    assert scores[0].kind == "recording"


def test_an_episode_that_is_cut_short_has_no_score():
    info = run_to_end(gymnasium.make(f"GAUGE/{SLIDE}", max_episode_steps=5))[1]
    assert info["frame"] == 5
    assert "score" not in info


class Writer:
    """Part of TensorBoard's `SummaryWriter` that `LogScore` uses."""

    def __init__(self):
        self.scalars = []

    def add_scalar(self, tag, scalar_value, global_step):
        self.scalars.append((global_step, tag, scalar_value))


def test_scores_are_sent_to_tensorboard_and_to_functions_like_wandb_log():
    writer, calls = Writer(), []
    env = LogScore(gymnasium.make(f"GAUGE/{SLIDE}"), writer)
    env = LogScore(env, lambda values, step: calls.append((step, values)))
    for _ in range(2):
        _, info = run_to_end(env)
    assert [step for step, _ in calls] == [18, 36]
    assert calls[1][1]["score/rmse_aligned"] == info["score"].rmse_aligned
    assert "score/over_uncertainty" not in calls[1][1]
    sent = [
        (step, name, value) for step, values in calls for name, value in values.items()
    ]
    assert writer.scalars == sent


# --- the warning of an environment without a reward ---


def warnings_of(*ids, maker=gymnasium.make, category=NoRewardWarning, **options):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for name in ids:
            maker(name, **options)
    return [warning for warning in caught if warning.category is category]


def test_an_id_without_a_reward_warns_once_at_the_line_of_the_caller(
    monkeypatch, tmp_path
):
    monkeypatch.setattr(arguments, "_warned", set())
    (first,) = warnings_of(SILENT, SILENT, f"GAUGE/{SLIDE}", f"GAUGE/{TURNTABLE}")
    assert Path(first.filename) == Path(__file__)
    assert "import its real trials with 'gauge data import'" in str(first.message)
    (vector,) = warnings_of(
        "GAUGE/WallBreaking-wood", maker=gymnasium.make_vec, num_envs=2
    )
    assert Path(vector.filename) == Path(__file__)
    changes = {"textile.areal_density_kg_per_m2": 0.2}
    (changed,) = warnings_of("GAUGE/TextileFlinging-satin", parameters=changes)
    assert "no score: the numerical reference" in str(changed.message)
    assert "the cause is textile.areal_density_kg_per_m2" in str(changed.message)
    shutil.copy(ROOT / "examples" / "own_experiment" / "crate.toml", tmp_path)
    monkeypatch.setenv("GAUGE_TASKS", str(tmp_path / "crate.toml"))
    gauge_envs.register_all()
    (users,) = warnings_of("GAUGE/CrateSlide-pine")
    del gymnasium.registry["GAUGE/CrateSlide-pine"]
    (idle,) = warnings_of(
        *[f"GAUGE/{SLIDE}"] * 2,
        category=UserWarning,
        parameters={"cube.restitution": 0.5},
    )
    assert "restitution has no effect" in str(idle.message)
    assert "Put CrateSlide-pine.band.toml and .npz next to" in str(users.message)
