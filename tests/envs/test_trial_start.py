"""Option `trial` of a reset: positions and velocities of an imported trial."""

from functools import partial

import gymnasium
import numpy as np
import pytest
from approval import refused_calls
from dataset_writer import body_asset, trial_content, write_trial
from episodes import run_to_end
from scipy.spatial.transform import Rotation

from gauge_envs import load_experiment
from gauge_envs.envs.trial_start import trial_states
from gauge_envs.errors import ParameterError
from gauge_envs.runs.episodes import episode_result
from gauge_envs.scene.contact_faces import face_normal
from gauge_envs.scene.states import nominal_states, row_of
from gauge_envs.tools.dataset.importer import import_trials
from gauge_envs.tools.dataset.layout import find_trials

SLIDE, BALL, SWING = "SlopeSlider-2-wood", "BouncingBall-rubber", "Pendulum-metal"


@pytest.fixture
def imported(tmp_path, monkeypatch):
    """Imports trials of a variant, whose recorded body has the positions [mm] that a function gives to each trial."""
    monkeypatch.setenv("GAUGE_DATA_DIR", str(tmp_path / "data"))

    def run(name, positions_mm, rotations=lambda *_: None):
        experiment = load_experiment(name)
        times_s = np.arange(experiment.frame_count + 12)[:, None] / 30
        for number in range(3):
            positions = positions_mm(number, times_s)
            # An import leaves out equal trials; their starts stay the same.
            positions[5:] += 0.01 * number
            assets = {
                body: body_asset(positions, rotations(number, times_s))
                for body in experiment.recorded
            }
            write_trial(tmp_path, name, number + 1, trial_content(assets))
        (one,) = import_trials(find_trials(tmp_path, only=(name,)))
        assert one.used == 3

    return run


def start_of(name):
    experiment = load_experiment(name)
    return np.array(experiment.scene.body(experiment.recorded[0]).pose.position_m)


def started(name, trial):
    """Return the initial state of the recorded body of a trial, shape [13], and the nominal one."""
    experiment = load_experiment(name)
    row = row_of(experiment.scene, experiment.recorded[0])
    return trial_states(experiment, trial)[row], nominal_states(experiment.scene)[row]


def rotation_of(state):
    return Rotation.from_quat(state[3:7], scalar_first=True)


def thrown(number, times_s):
    """A ball that is thrown with (0.1 number, 0, 0.4) m/s, from a place that depends on the number."""
    start = np.add(start_of(BALL), (0.0, 2e-3 * number, 1e-3))
    path = (
        start
        + times_s * [0.1 * number, 0.0, 0.4]
        - 0.5 * 9.80665 * times_s**2 * [0.0, 0.0, 1.0]
    )
    return 1e3 * np.maximum(path, [-10.0, -10.0, 0.05])


@pytest.mark.parametrize("trial", [0, 2])
def test_a_ball_starts_and_flies_as_its_trial(trial, imported):
    imported(BALL, thrown)
    env = gymnasium.make(f"GAUGE/{BALL}")
    observation, _ = env.reset(seed=0, options={"trial": trial})
    expected = [
        *np.add(start_of(BALL), (0.0, 2e-3 * trial, 1e-3)),
        0.1 * trial,
        0.0,
        0.4,
    ]
    # A constant acceleration does not bias the velocity.
    assert observation["bodies"][0, [0, 1, 2, 7, 8, 9]] == pytest.approx(
        expected, abs=1e-9
    )
    for _ in range(4):
        observation, *_ = env.step(0)
    recorded = 1e-3 * thrown(trial, np.array([[4 / 30]]))[0]
    assert observation["bodies"][0, :3] == pytest.approx(recorded, abs=1e-4)


def test_a_reset_without_the_option_returns_to_the_calibrated_start(imported):
    imported(BALL, thrown)
    env = gymnasium.make(f"GAUGE/{BALL}")
    first, _ = env.reset(seed=0)
    env.reset(seed=0, options={"trial": 1})
    again, _ = env.reset(seed=0)
    np.testing.assert_array_equal(first["bodies"], again["bodies"])


def test_a_result_states_the_trial(imported):
    imported(BALL, thrown)
    env = gymnasium.make(f"GAUGE/{BALL}")
    _, info = run_to_end(env, options={"trial": 1})
    assert episode_result(env, info).jitter == {"trial": 1}


def test_worlds_start_from_the_trial(imported):
    imported(BALL, thrown)
    envs = gymnasium.make_vec(f"GAUGE/{BALL}", num_envs=2)
    observations, _ = envs.reset(seed=0, options={"trial": 2})
    assert observations["bodies"][:, 0, 7] == pytest.approx([0.2, 0.2])


def test_a_cube_moves_and_slides_on_its_face(imported):
    off_m, speed = np.array([1e-3, 2e-3, 3e-3]), np.array([0.2, 0.1, 0.3])
    imported(
        SLIDE, lambda _, times_s: 1e3 * (start_of(SLIDE) + off_m + times_s * speed)
    )
    normal = face_normal(load_experiment(SLIDE).scene.body("cube").pose)
    cube, nominal = started(SLIDE, 0)
    expected = nominal.copy()
    expected[:3] += off_m - (off_m @ normal) * normal
    expected[7:10] = speed - (speed @ normal) * normal
    assert cube == pytest.approx(expected, abs=1e-9)


YAWS_DEG, TILT_DEG = (-3.0, 1.0, 2.0), 4.0
"""Orientation of three trials about the normal, from their mean, and about an axis in the face, alternating."""

FRAME = Rotation.from_euler("xyz", (20.0, -70.0, 130.0), degrees=True)
"""Body frame of the motion capture, relative to that of the scene."""


def spinning(name, spin):
    """Orientations that start at a yaw and a tilt of each trial, and rotate with a spin, in the body frame `FRAME`."""
    pose = load_experiment(name).scene.body(load_experiment(name).recorded[0]).pose
    normal = face_normal(pose)
    across = np.cross(normal, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)

    def rotations(number, times_s):
        start = Rotation.from_rotvec(np.radians(YAWS_DEG[number]) * normal)
        start = (
            Rotation.from_rotvec(np.radians(TILT_DEG * (number - 1)) * across) * start
        )
        return Rotation.from_rotvec(times_s * spin) * start * pose.rotation * FRAME

    return rotations


def test_a_cube_starts_with_the_yaw_and_the_spin_of_its_trial(imported):
    normal = face_normal(load_experiment(SLIDE).scene.body("cube").pose)

    def resting(_, times_s):
        return 1e3 * np.broadcast_to(start_of(SLIDE), (len(times_s), 3)).copy()

    imported(SLIDE, resting, spinning(SLIDE, np.array([0.4, -0.3, 2.0])))
    for number, yaw in enumerate(YAWS_DEG):
        cube, nominal = started(SLIDE, number)
        rotation = (rotation_of(cube) * rotation_of(nominal).inv()).as_rotvec()
        # The mean of three rotations by a few degrees is not exactly the mean of their angles.
        assert np.degrees(rotation) == pytest.approx(yaw * normal, abs=0.01)
        spin = np.array([0.4, -0.3, 2.0]) @ normal * normal
        assert cube[10:] == pytest.approx(spin, abs=1e-9)


def test_a_ball_starts_with_the_spin_of_its_trial(imported):
    spin = np.array([3.0, -5.0, 7.0])
    imported(BALL, thrown, spinning(BALL, spin))
    env = gymnasium.make(f"GAUGE/{BALL}")
    observation, _ = env.reset(seed=0, options={"trial": 2})
    assert observation["bodies"][0, 10:13] == pytest.approx(spin, abs=1e-6)


def test_trials_without_orientations_keep_that_of_the_scene(
    tmp_path, imported, monkeypatch
):
    monkeypatch.setattr(
        "test_trial_start.body_asset",
        lambda positions, _: dict(zip("xyz", positions.T.tolist(), strict=True)),
    )
    imported(SLIDE, lambda _, times_s: 1e3 * (start_of(SLIDE) + 0.1 * times_s))
    cube, nominal = started(SLIDE, 1)
    assert cube[3:7] == pytest.approx(nominal[3:7], abs=1e-12)
    assert not cube[10:].any()


def test_a_pendulum_rotates_about_its_hinge(imported):
    before = load_experiment(SWING).scene
    hinge, ball = before.joints[0], before.body("ball")
    arm = np.subtract(ball.pose.position_m, hinge.anchor_m)
    axis = np.asarray(hinge.axis)

    def swinging(_, times_s):
        angles = 0.01 + 0.3 * times_s
        return 1e3 * (
            hinge.anchor_m + np.cos(angles) * arm + np.sin(angles) * np.cross(axis, arm)
        )

    imported(SWING, swinging)
    found, nominal = started(SWING, 1)
    turned = (rotation_of(found) * rotation_of(nominal).inv()).as_rotvec()
    assert turned == pytest.approx(0.01 * axis, abs=1e-9)
    # Three frames give the rate up to the third power of the angle between frames.
    assert found[10:] == pytest.approx(0.3 * axis, abs=1e-4)


REFUSED = (
    {"trial": 3},
    {"trial": -1},
    {"trial": 1.0},
    {"trial": True},
    {"trial": 1, "jitter": True},
    {"start": 1},
)


def test_what_is_no_trial_is_refused(imported, approved):
    imported(BALL, thrown)
    env = gymnasium.make(f"GAUGE/{BALL}")
    calls = {str(one): partial(env.reset, options=one) for one in REFUSED}
    calls["nothing imported"] = partial(
        gymnasium.make(f"GAUGE/{SLIDE}").reset, options={"trial": 0}
    )
    approved("envs/trials", refused_calls(ParameterError, calls))


def test_markers_and_gaps_are_refused(tmp_path, monkeypatch, imported):
    def gap(number, times_s):
        positions = thrown(number, times_s)
        positions[1 if number == 1 else 9] = np.nan
        return positions

    imported(BALL, gap)
    ball, nominal = started(BALL, 0)
    assert not np.array_equal(ball, nominal)
    with pytest.raises(
        ParameterError, match="trial 1 was not measured in all of its first 3 frames"
    ):
        started(BALL, 1)
    with pytest.raises(ParameterError, match="observes line_curvature"):
        trial_states(load_experiment("TextileBending-rayon"), 0)
