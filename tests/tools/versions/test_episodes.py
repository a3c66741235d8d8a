"""Compare episodes on two sides: motions of an experiment, and returns of a policy."""

import json
from functools import cache

import numpy as np
import pytest
from planted_models import side

from gauge_envs.errors import ParameterError
from gauge_envs.tools.versions import environments, episodes
from gauge_envs.tools.versions.episodes import compare_motions, compare_returns
from gauge_envs.tools.versions.schema import VersionsVerdict
from gauge_envs.tools.versions.subject import compares_motions, read_sides


def pair(*texts):
    return [side for text in texts for side in read_sides(str(text))]


def test_engines_are_compared_as_motions():
    sides = pair("mujoco", "pybullet")
    assert compares_motions("SlopeSlider-2-wood", sides)
    comparison, scores = compare_motions("SlopeSlider-2-wood", *sides, seed=0)
    assert comparison.verdict is VersionsVerdict.DIFFERENT
    assert comparison.largest > 10.0 * comparison.noise
    assert comparison.first_s < 0.1 < comparison.largest_s
    # The scores do not differ: the paths are within 0.3 mm.
    assert (comparison.right, len(scores.configurations)) == ("", 2)


def test_a_release_of_an_engine_does_not_differ_from_itself(tmp_path, monkeypatch):
    """The environment of the release is empty, so both sides run the installed engine."""
    (tmp_path / "site-packages").mkdir()
    monkeypatch.setattr(environments, "make_environment", lambda requirement: tmp_path)
    sides = pair("pybullet==3.2.7", "pybullet")
    comparison, _ = compare_motions("BouncingBall-rubber", *sides, seed=0)
    assert (comparison.verdict, comparison.largest) == (VersionsVerdict.SAME, 0.0)
    assert comparison.noise > 0.0


@cache
def dropped():
    """Return the result of one episode."""
    task = {"title": "", "subject": "BouncingBall-rubber", "seed": 0}
    (output,) = environments.work("simulate", task, read_sides("mujoco"))
    return json.loads(str(output["results"][0]))


@pytest.mark.parametrize(
    ("share", "verdict"),
    [(5.0, VersionsVerdict.SAME), (20.0, VersionsVerdict.DIFFERENT)],
)
def test_a_difference_of_less_than_ten_times_the_noise_is_no_difference(
    monkeypatch, share, verdict
):
    """Both sides shift by 1e-3 mm with the jitter; one side shifts by a multiple of that."""
    result = dropped()

    def shifted(shift_mm):
        samples = np.array(result["trajectory"]["samples"])
        trajectory = result["trajectory"] | {"samples": (samples + shift_mm).tolist()}
        return json.dumps(result | {"trajectory": trajectory})

    sides = [
        {"results": np.array([shifted(shift), shifted(shift + 1e-3)])}
        for shift in (0.0, 1e-3 * share)
    ]
    monkeypatch.setattr(episodes, "work", lambda *arguments: sides)
    comparison, _ = compare_motions(
        "BouncingBall-rubber", *pair("mujoco", "mujoco:gravity=1"), seed=0
    )
    assert comparison.verdict is verdict
    assert comparison.noise == pytest.approx(1e-3, rel=1e-6)
    assert comparison.largest == pytest.approx(1e-3 * share, rel=1e-6)


POLICY = """
import gymnasium


class Counter(gymnasium.Env):
    observation_space = action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))

    def __init__(self):
        import mujoco
        self.model = mujoco.MjModel.from_xml_string("<mujoco/>")

    def reset(self, seed=None, options=None):
        self.offset, self.steps = float(seed), 0
        return self.observation_space.low, {}

    def step(self, action):
        self.steps += 1
        reward = float(action[0]) + self.offset - self.model.opt.timestep
        return action, reward, self.steps == 3, False, {}


def policy():
    return lambda observation: observation + 2.0
"""


@pytest.mark.parametrize("policy", ["played:policy", "actions.npy"])
def test_returns_of_a_policy_are_compared_seed_by_seed(tmp_path, monkeypatch, policy):
    """Three steps of reward action + seed - time step: the sides differ by 0.003 in each episode."""
    (tmp_path / "played.py").write_text(POLICY)
    np.save(tmp_path / "actions.npy", np.array([[0.5], [0.25], [0.125]]))
    monkeypatch.chdir(tmp_path)
    sides = [side("old"), side("new", timestep=0.003)]
    options = {"policy": policy, "seed": 5}
    comparison = compare_returns("played:Counter", *sides, seeds=3, **options)
    # The policy adds 2 to an observation of -1, then to its own actions.
    actions = 0.875 if policy == "actions.npy" else 1.0 + 3.0 + 5.0
    expected = 3 * 6.0 + actions - 0.006
    assert comparison.returns[0] == pytest.approx(expected, abs=1e-6)
    assert comparison.change.value == pytest.approx(-0.003)
    assert comparison.verdict is VersionsVerdict.DIFFERENT
    equal = compare_returns("played:Counter", sides[0], sides[0], seeds=2, **options)
    assert (equal.verdict, equal.change.value) == (VersionsVerdict.SAME, 0.0)


def test_the_change_of_a_return_has_students_interval(monkeypatch):
    """Student's t of changes 1, 2, 3: 4.303 / sqrt(3)."""
    outputs = [
        {"version": "", "returns": np.array(returns)}
        for returns in ([5.0, 0.0, 7.0], [6.0, 2.0, 10.0])
    ]
    monkeypatch.setattr(episodes, "work", lambda *arguments: outputs)
    options = {"policy": "a.npy", "seeds": 3, "seed": 0}
    comparison = compare_returns("Hopper-v5", side("old"), side("new"), **options)
    assert (comparison.returns, comparison.change.value) == ((4.0, 6.0), 2.0)
    half_width = comparison.change.value - comparison.change.low
    assert half_width == pytest.approx(4.3027 / 3.0**0.5, rel=1e-4)
    assert comparison.verdict is VersionsVerdict.SAME


@pytest.mark.parametrize(
    ("engine", "policy", "message"),
    [
        ("newton", "a.npy", "compares releases of MuJoCo"),
        ("mujoco", "word", "--policy word: expected"),
    ],
)
def test_a_wrong_policy_is_an_error(engine, policy, message):
    options = {"policy": policy, "seeds": 1, "seed": 0}
    with pytest.raises(ParameterError, match=message):
        compare_returns("Hopper-v5", *pair("mujoco", engine), **options)
