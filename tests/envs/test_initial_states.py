"""Initial states of episodes: nominal, with noise of a seed, or of a recorded trial; independent of earlier episodes.

Expected states are samples of `gauge_envs.scene.jitter`, recorded data, and synthetic trials of known velocity and
spin.
"""

from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from dataset_writer import body_asset, trial_content, write_trial
from episodes import run_to_end
from gymnasium.vector import SyncVectorEnv
from scipy.spatial.transform import Rotation

from gauge_envs import GaugeEnv, Jitter, load_experiment, reference_band
from gauge_envs.envs import trial_start
from gauge_envs.envs.trial_start import trial_states
from gauge_envs.errors import ParameterError
from gauge_envs.references.single_shot import single_shots
from gauge_envs.runs.episodes import episode_result, run_episodes
from gauge_envs.runs.request import RunRequest
from gauge_envs.scene.contact_faces import face_normal
from gauge_envs.scene.jitter import perturbed_states
from gauge_envs.scene.states import nominal_states, row_of
from gauge_envs.tools.dataset.importer import import_trials
from gauge_envs.tools.dataset.layout import find_trials

SLIDE, BALL, SWING = "SlopeSlider-2-wood", "BouncingBall-rubber", "Pendulum-metal"
TOSS = "CubeToss-acrylic"
NOMINAL_MM = 1e3 * np.array(load_experiment(SLIDE).scene.body("cube").pose.position_m)


def make(name=SLIDE, **options):
    return gym.make(f"GAUGE/{name}", **options)


def start_mm(env, **reset):
    return env.reset(**reset)[0]["observable"]


def start_m(name):
    experiment = load_experiment(name)
    return np.array(experiment.scene.body(experiment.recorded[0]).pose.position_m)


def initial_places(envs, count, **reset):
    """Return g(t) at the starts of consecutive episodes of synchronous worlds, shape [count, N, 3]."""
    places = [start_mm(envs, **reset)]
    action = np.zeros(envs.action_space.shape, envs.action_space.dtype)
    over = False
    while len(places) < count:
        observations, _, _, truncations, _ = envs.step(action)
        if over:
            places.append(observations["observable"].copy())
        over = truncations.all()
    return np.array(places)


# --- noise ---


@pytest.mark.parametrize(
    ("arguments", "options"), [({}, {"jitter": True}), ({"jitter": "real"}, None)]
)
def test_noise_depends_on_the_seed_before_and_after_an_autoreset(arguments, options):
    reset = {"seed": 4, "options": options}
    native = gym.make_vec(f"GAUGE/{SLIDE}", num_envs=3, **arguments)
    places = initial_places(native, 3, **reset)
    distance_mm = np.linalg.norm(places - NOMINAL_MM, axis=-1)
    assert (distance_mm > 1e-3).all() and (distance_mm < 6.0).all()
    assert len(np.unique(places.reshape(-1, 3).round(6), axis=0)) == 9
    for seed, start in zip((4, 5, 6), places[0], strict=True):
        states = perturbed_states(load_experiment(SLIDE).scene, Jitter(), seed=seed)
        assert start == pytest.approx(1e3 * states[0, :3])
    single = SyncVectorEnv([lambda: make(**arguments)] * 3)
    assert initial_places(single, 3, **reset) == pytest.approx(places)
    # A reset with a seed discards the option, but not the argument.
    again = start_mm(native, seed=4)
    assert np.allclose(again, NOMINAL_MM, atol=1e-6) == (options is not None)


def test_seeds_follow_the_rules_of_gymnasium():
    env = make(jitter="real")
    first, again = (
        [start_mm(env, seed=2), *(start_mm(env) for _ in range(3))] for _ in "12"
    )
    assert len(np.unique(np.round(first, 6), axis=0)) == 4
    assert np.array_equal(first, again)
    assert not np.allclose(start_mm(make(jitter="real")), first[0])


def test_an_option_disables_the_argument_until_the_next_seed():
    env = make(jitter={"position_m": 0.002, "angle_rad": 0.0})
    assert not np.allclose(start_mm(env, seed=0), NOMINAL_MM, atol=1e-3)
    assert start_mm(env, options={"jitter": False}) == pytest.approx(NOMINAL_MM)
    assert start_mm(env) == pytest.approx(NOMINAL_MM)
    assert not np.allclose(start_mm(env, seed=0), NOMINAL_MM, atol=1e-3)
    assert not np.allclose(start_mm(env, options={}), NOMINAL_MM, atol=1e-3)


@pytest.mark.parametrize(
    "name",
    [
        SLIDE,
        SWING,
        "RotatingBall-rayon",
        pytest.param("WallBreaking-wood", marks=pytest.mark.slow),
        pytest.param("TableclothPulling-wood", marks=pytest.mark.slow),
    ],
)
def test_an_episode_depends_on_its_seed_and_not_on_earlier_episodes(name):
    noise = Jitter(velocity_m_per_s=0.01, angular_velocity_rad_per_s=0.01)
    used, new = GaugeEnv(name, jitter=noise), GaugeEnv(name, jitter=noise)
    used.reset(seed=5)
    used.step(used.action_space.sample())
    for env in (used, new):
        env.reset(seed=6)
        action = np.full(env.action_space.shape, 0.3, env.action_space.dtype)
        for _ in range(4):
            env.step(action)
    first, second = used.trajectory(), new.trajectory()
    np.testing.assert_allclose(first.samples, second.samples, rtol=0.0, atol=1e-9)
    scene = used.experiment.scene
    states = perturbed_states(scene, noise, seed=6)
    recorded = [row_of(scene, body) for body in used.experiment.recorded]
    np.testing.assert_allclose(first.bodies[0], states[recorded], atol=1e-9)
    assert np.abs(states - nominal_states(scene)).max() > 1e-5


@pytest.mark.parametrize(
    ("name", "jitter", "message"),
    [
        (SLIDE, "realistic", "expected 'real', True, False or a gauge_envs.Jitter"),
        (SLIDE, {"position": 0.001}, "did you mean position_m"),
        (SLIDE, {"position_m": -0.001}, "give a finite number of 0 or more"),
        ("CantileverBeam-soft", True, "moves no body"),
    ],
)
def test_impossible_noise_raises_an_error(name, jitter, message):
    with pytest.raises(ParameterError, match=message):
        make(name, jitter=jitter)


# --- bundled single-trial recordings ---


def test_a_toss_starts_as_measured_and_is_scored_against_its_own_trial():
    shots = single_shots(TOSS)
    env = make(TOSS)
    for trial in (41, 5):
        observation, info = env.reset(options={"trial": trial})
        shot, state = shots.shot(trial), observation["bodies"][0]
        assert info["trial"] == trial
        assert state[:3] == pytest.approx(shot.positions_m[0], abs=1e-9)
        assert state[7:] == pytest.approx(shot.start[7:], abs=1e-9)
        assert abs(state[3:7] @ shot.quaternions[0]) == pytest.approx(1.0, abs=1e-12)
    truncated = False
    while not truncated:
        *_, truncated, info = env.step(0)
    recorded_mm = 1e3 * shots.shot(5).positions_at(np.arange(31) / 30.0)
    frames_mm = env.unwrapped.trajectory().frames
    errors_mm = np.linalg.norm(frames_mm - recorded_mm, axis=1)
    assert info["score"].rmse == pytest.approx(np.sqrt(np.mean(errors_mm**2)))
    assert 2.0 < info["score"].rmse < 20.0


def test_the_seed_selects_the_trial_also_in_runs_and_worlds():
    env = make(TOSS)
    assert env.reset(seed=475)[1]["trial"] == 1
    assert env.reset()[1]["trial"] == 0
    results = run_episodes(RunRequest(TOSS, seed=3, repeats=2))
    assert [result.jitter for result in results] == [{"trial": 3}, {"trial": 4}]
    worlds = gym.make_vec(f"GAUGE/{TOSS}", num_envs=2)
    _, infos = worlds.reset(seed=3)
    assert infos["trial"].tolist() == [3, 4]
    with pytest.raises(ParameterError, match="trial 499 does not exist"):
        env.reset(options={"trial": 499})


def test_a_toss_with_an_overridden_start_has_no_reference():
    moved = load_experiment(TOSS, {"cube.position_m": (0.0, 0.0, 0.5)})
    assert reference_band(moved) is None
    assert reference_band(load_experiment(TOSS, {"cube.friction": 0.3})) is not None


# --- imported trials ---


@pytest.fixture
def imported(tmp_path, monkeypatch):
    """Import three trials; functions return positions [mm] and rotations for the trial number and times [s]."""
    monkeypatch.setenv("GAUGE_DATA_DIR", str(tmp_path / "data"))

    def run(name, positions_mm, rotations=lambda *_: None):
        experiment = load_experiment(name)
        times_s = np.arange(experiment.frame_count + 12)[:, None] / 30
        for number in range(3):
            positions = positions_mm(number, times_s)
            # An import skips equal trials.
            positions[5:] += 0.01 * number
            asset = body_asset(positions, rotations(number, times_s))
            content = trial_content(dict.fromkeys(experiment.recorded, asset))
            write_trial(tmp_path, name, number + 1, content)
        # The motions do not follow the reference.
        layout = find_trials(tmp_path, only=(name,))
        (variant,) = import_trials(layout, keep=True)
        assert variant.used == 3

    return run


def states_of_trial(name, trial):
    """Return the initial state of the recorded body in a trial, shape [13], and its nominal state."""
    experiment = load_experiment(name)
    row = row_of(experiment.scene, experiment.recorded[0])
    return trial_states(experiment, trial)[row], nominal_states(experiment.scene)[row]


def turned(state, nominal):
    """Return the rotation vector from one state to another [rad]."""
    after = Rotation.from_quat(state[3:7], scalar_first=True)
    before = Rotation.from_quat(nominal[3:7], scalar_first=True)
    return (after * before.inv()).as_rotvec()


def thrown(number, times_s):
    """Return the path of a ball that is thrown with (0.1 number, 0, 0.4) m/s [mm]."""
    start = np.add(start_m(BALL), (0.0, 2e-3 * number, 1e-3))
    velocity = np.array([0.1 * number, 0.0, 0.4])
    path = start + times_s * velocity - 0.5 * 9.80665 * times_s**2 * np.eye(3)[2]
    return 1e3 * np.maximum(path, [-10.0, -10.0, 0.05])


FRAME = Rotation.from_euler("xyz", (20.0, -70.0, 130.0), degrees=True)
"""Body frame of the motion capture, relative to that of the scene."""


def test_a_ball_starts_as_in_its_trial(imported):
    spin = np.array([3.0, -5.0, 7.0])
    imported(
        BALL, thrown, lambda _, times_s: Rotation.from_rotvec(times_s * spin) * FRAME
    )
    env = make(BALL)
    nominal, _ = env.reset(seed=0)
    observation, _ = env.reset(seed=0, options={"trial": 2})
    ball = observation["bodies"][0]
    position_m = np.add(start_m(BALL), (0.0, 4e-3, 1e-3))
    # A constant acceleration does not bias the velocity.
    assert ball[:3] == pytest.approx(position_m, abs=1e-9)
    assert ball[7:10] == pytest.approx([0.2, 0.0, 0.4], abs=1e-9)
    assert ball[10:] == pytest.approx(spin, abs=1e-6)
    for _ in range(4):
        observation, *_ = env.step(0)
    recorded_m = 1e-3 * thrown(2, np.array([[4 / 30]]))[0]
    assert observation["bodies"][0, :3] == pytest.approx(recorded_m, abs=1e-4)
    again, _ = env.reset(seed=0)
    np.testing.assert_array_equal(nominal["bodies"], again["bodies"])
    _, info = run_to_end(env, options={"trial": 1})
    assert episode_result(env, info).jitter == {"trial": 1}


@pytest.mark.parametrize("reference", ["bundled", "imported"])
@pytest.mark.parametrize("name", [BALL, SLIDE])
def test_a_trial_of_an_import_gives_the_start_and_not_the_reference(
    imported, name, reference
):
    velocity_mm_per_s = np.array([3.0, 0.0, 0.0])
    imported(name, lambda _, times_s: 1e3 * start_m(name) + times_s * velocity_mm_per_s)
    env = make(name, reference=reference)
    env.reset()
    mean = env.unwrapped.band.mean
    for trial in range(3):
        _, info = run_to_end(env, options={"trial": trial})
        assert env.unwrapped.band.mean is mean
        assert info["trial"] == trial and info["score"].rmse > 0.0
    with pytest.raises(ParameterError, match="trial 3 does not exist"):
        env.reset(options={"trial": 3})


def test_a_cube_moves_and_rotates_only_on_its_face(imported):
    """Trials are also tilted; only translations in the face and rotations about its normal remain."""
    offset_m, speed = np.array([1e-3, 2e-3, 3e-3]), np.array([0.2, 0.1, 0.3])
    spin = np.array([0.4, -0.3, 2.0])
    yaws_deg = (-3.0, 1.0, 2.0)
    pose = load_experiment(SLIDE).scene.body("cube").pose
    normal = face_normal(pose)
    across = np.cross(normal, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)

    def rotations(number, times_s):
        yaw = Rotation.from_rotvec(np.radians(yaws_deg[number]) * normal)
        tilt = Rotation.from_rotvec(np.radians(4.0 * (number - 1)) * across)
        return Rotation.from_rotvec(times_s * spin) * tilt * yaw * pose.rotation * FRAME

    imported(
        SLIDE,
        lambda _, times_s: 1e3 * (start_m(SLIDE) + offset_m + times_s * speed),
        rotations,
    )
    for number, yaw_deg in enumerate(yaws_deg):
        cube, nominal = states_of_trial(SLIDE, number)
        in_face_m = offset_m - (offset_m @ normal) * normal
        assert cube[:3] - nominal[:3] == pytest.approx(in_face_m, abs=1e-9)
        in_face = speed - (speed @ normal) * normal
        assert cube[7:10] == pytest.approx(in_face, abs=1e-9)
        # The mean of three rotations by a few degrees is not exactly the mean of their angles.
        rotation_deg = np.degrees(turned(cube, nominal))
        assert rotation_deg == pytest.approx(yaw_deg * normal, abs=0.01)
        assert cube[10:] == pytest.approx(spin @ normal * normal, abs=1e-9)


def test_a_pendulum_rotates_about_its_hinge(monkeypatch):
    scene = load_experiment(SWING).scene
    hinge = scene.joints[0]
    arm_m = np.subtract(scene.body("ball").pose.position_m, hinge.anchor_m)
    axis = np.asarray(hinge.axis)
    angles = 0.01 + 0.3 * np.arange(3)[:, None] / 30
    swung_m = np.cos(angles) * arm_m + np.sin(angles) * np.cross(axis, arm_m)
    band = SimpleNamespace(trials=1e3 * (hinge.anchor_m + swung_m)[None])
    variant = SimpleNamespace(band=band, start_quaternions=None)
    monkeypatch.setattr(trial_start, "load_imported", lambda name: variant)
    ball, nominal = states_of_trial(SWING, 0)
    assert turned(ball, nominal) == pytest.approx(0.01 * axis, abs=1e-9)
    # Three frames give the rate with an error of the third power of the angle between frames.
    assert ball[10:] == pytest.approx(0.3 * axis, abs=1e-4)
    rotated_arm_m = np.subtract(ball[:3], hinge.anchor_m)
    expected = np.cross(ball[10:], rotated_arm_m)
    assert ball[7:10] == pytest.approx(expected, abs=1e-9)


def test_an_impossible_trial_raises_an_error(imported):
    def gap(number, times_s):
        positions = thrown(number, times_s)
        positions[1 if number == 1 else 9] = np.nan
        return positions

    imported(BALL, gap)
    env = make(BALL)
    for options, message in (
        ({"trial": 3}, "trial 3 does not exist: choose 0 to 2"),
        ({"trial": -1}, "trial -1 does not exist"),
        ({"trial": True}, "expected the number of a trial"),
        ({"trial": 1}, "not measured in all of its first 3 frames"),
        ({"trial": 0, "jitter": True}, "both set the start"),
        ({"start": 1}, "only the options 'jitter' and 'trial', got 'start'"),
    ):
        with pytest.raises(ParameterError, match=message):
            env.reset(options=options)
    env.reset(options={"trial": 0})
    with pytest.raises(ParameterError, match="none were imported"):
        make(SLIDE).reset(options={"trial": 0})
    with pytest.raises(ParameterError, match="observes line_curvature"):
        trial_states(load_experiment("TextileBending-rayon"), 0)
