"""Compare episodes on two sides: motions of an experiment, and returns of a policy."""

import sysconfig
from pathlib import Path

import numpy as np
import pytest
from planted_models import side

from gauge_envs.errors import ParameterError
from gauge_envs.scene.jitter import Jitter
from gauge_envs.tools.versions import environments, episodes
from gauge_envs.tools.versions.episodes import compare_motions, compare_returns
from gauge_envs.tools.versions.schema import Verdict
from gauge_envs.tools.versions.subject import compares_motions, read_sides


def pair(*texts):
    return [side for text in texts for side in read_sides(str(text))]


def test_engines_are_compared_as_motions():
    sides = pair("mujoco", "pybullet")
    assert compares_motions("SlopeSlider-2-wood", sides)
    comparison, scores = compare_motions("SlopeSlider-2-wood", *sides, seed=0)
    assert comparison.verdict is Verdict.DIFFERENT
    assert comparison.difference > 10.0 * comparison.noise
    assert comparison.first_s < 0.1
    # The scores do not differ: the paths are within 0.3 mm.
    assert (comparison.right, len(scores.configurations)) == ("", 2)


def test_a_release_of_an_engine_runs_in_a_process_that_imports_it(
    tmp_path, monkeypatch
):
    """The environment of the release is empty, so both sides run the installed engine."""
    monkeypatch.setattr(environments, "make_environment", lambda requirement: tmp_path)
    sides = pair("pybullet==3.2.7", "pybullet")
    comparison, _ = compare_motions("BouncingBall-rubber", *sides, seed=0)
    assert (comparison.verdict, comparison.largest) == (Verdict.IDENTICAL, 0.0)
    assert comparison.noise > 0.0


@pytest.mark.parametrize(
    ("shift", "verdict"), [(0.01, Verdict.SAME), (1.0, Verdict.DIFFERENT)]
)
def test_a_shift_as_small_as_the_jitter_is_noise(monkeypatch, shift, verdict):
    """The shift is in mm, and the jitter is 0.01 mm."""
    jitter = Jitter(position_m=1e-5, angle_rad=0.0)
    monkeypatch.setattr(episodes, "JITTER", jitter)
    run = episodes._run

    def shifted(subject, side, *options):
        result = run(subject, side, *options)
        if side.settings:
            result.trajectory.samples[:, 0] += shift
        return result

    monkeypatch.setattr(episodes, "_run", shifted)
    # This setting has its default value and only distinguishes the sides.
    sides = pair("mujoco", "mujoco:integrator=implicitfast")
    comparison, _ = compare_motions("BouncingBall-rubber", *sides, seed=0)
    assert comparison.verdict is verdict


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
        return action, reward, self.steps == 3, False, {"is_success": action[0] > 1.0}


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
    is_scripted = policy == "actions.npy"
    comparison = compare_returns("played:Counter", *sides, seeds=3, **options)
    # The policy adds 2 to an observation of -1, then to its own actions.
    actions = 0.875 if is_scripted else 1.0 + 3.0 + 5.0
    assert comparison.returns[0].value == pytest.approx(
        3 * 6.0 + actions - 0.006, abs=1e-6
    )
    assert comparison.change.value == pytest.approx(-0.003)
    assert comparison.verdict is Verdict.DIFFERENT
    assert [share.value for share in comparison.success] == [float(not is_scripted)] * 2
    # Student's t of returns that differ by 3 from seed to seed: 4.303 x 3 / sqrt(3).
    half_width = comparison.returns[0].value - comparison.returns[0].low
    assert half_width == pytest.approx(4.3027 * 3.0**0.5, rel=1e-4)
    equal = compare_returns("played:Counter", sides[0], sides[0], seeds=2, **options)
    assert equal.verdict is Verdict.IDENTICAL


def test_a_missing_policy_is_an_error():
    sides = pair("mujoco", "mujoco")
    with pytest.raises(ParameterError, match=r"--policy absent.npy: expected"):
        compare_returns("Hopper-v5", *sides, policy="absent.npy", seeds=1, seed=0)


def test_packages_of_a_release_precede_packages_of_the_user(tmp_path, monkeypatch):
    monkeypatch.setattr(environments, "make_environment", lambda requirement: tmp_path)
    base = {"base": str(tmp_path), "platbase": str(tmp_path)}
    package = Path(sysconfig.get_path("platlib", "venv", base)) / "mujoco"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("__version__ = '0.0'")
    (release,) = read_sides("mujoco==3.3.0")
    code = f"import mujoco, typer; open({str(tmp_path / 'seen')!r}, 'w').write(mujoco.__version__)"
    environments.run_python(release, ["-c", code], "it")
    assert (tmp_path / "seen").read_text() == "0.0"
