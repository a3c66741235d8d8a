"""Whole motions and returns of a policy on two sides."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from planted import side

from gauge_envs.errors import ParameterError
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import write_result
from gauge_envs.tools.versions import worker
from gauge_envs.tools.versions.model import Verdict
from gauge_envs.tools.versions.motions import compare_motions
from gauge_envs.tools.versions.returns import compare_returns
from gauge_envs.tools.versions.sides import are_motions, read_side


def test_engines_and_settings_of_an_experiment_are_compared_as_motions(tmp_path):
    sides = [read_side(text)[0] for text in ("mujoco", "pybullet")]
    assert are_motions("SlopeSlider-2-wood", sides)
    found, scores = compare_motions("SlopeSlider-2-wood", *sides, seed=0)
    assert found.verdict is Verdict.DIFFERENT
    assert found.difference > 10.0 * found.noise
    assert found.first_s < 0.1
    # No score tells both apart: their paths are within 0.3 mm.
    assert (found.right, len(scores.configurations)) == ("", 2)


def test_a_result_file_is_the_motion_of_its_own_run(tmp_path):
    result = run_episode(RunRequest("BouncingBall-rubber"))
    file = tmp_path / "there.json"
    write_result(result, file)
    sides = [read_side(text)[0] for text in (str(file), "mujoco")]
    found, _ = compare_motions("BouncingBall-rubber", *sides, seed=0)
    assert (found.verdict, found.largest) == (Verdict.IDENTICAL, 0.0)
    # What chaos makes of nothing is within the noise, and a millimetre at the start is not.
    for shift_mm, verdict in ((1e-9, Verdict.SAME), (1.0, Verdict.DIFFERENT)):
        stated = json.loads(file.read_text(encoding="utf-8"))
        for sample in stated["trajectory"]["samples"]:
            sample[0] += shift_mm
        moved = tmp_path / "moved.json"
        moved.write_text(json.dumps(stated), encoding="utf-8")
        sides[1] = read_side(str(moved))[0]
        found, _ = compare_motions("BouncingBall-rubber", *sides, seed=0)
        assert found.verdict is verdict
    with pytest.raises(ParameterError, match="is a result of GAUGE/BouncingBall"):
        compare_motions("SlopeSlider-2-wood", *sides, seed=0)


@pytest.mark.parametrize(
    ("subject", "texts", "told"),
    [
        ("SlopeSlider-2-wood", ("mujoco==3.3.0", "newton"), "releases are compared"),
        ("scene.xml", ("mujoco", "newton"), "on an id of this suite"),
        ("scene.xml", ("mujoco", "mujoco:preset=training"), "on an id of this suite"),
    ],
)
def test_sides_that_cannot_be_compared(subject, texts, told):
    sides = []
    for text in texts:
        settings = dict([text.partition(":")[2].split("=")]) if ":" in text else {}
        sides.append(read_side(text, settings)[0])
    with pytest.raises(ParameterError, match=told):
        are_motions(subject, sides)


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


@pytest.mark.parametrize(
    "is_scripted", [False, pytest.param(True, marks=pytest.mark.slow)]
)
def test_returns_of_a_policy_are_compared_seed_by_seed(
    tmp_path, monkeypatch, is_scripted
):
    """Three steps of reward action + seed - time step: the sides differ by 0.003 in each episode."""
    (tmp_path / "played.py").write_text(POLICY, encoding="utf-8")
    np.save(tmp_path / "actions.npy", np.array([[0.5], [0.25]]))
    monkeypatch.chdir(tmp_path)
    policy = "actions.npy" if is_scripted else "played:policy"
    sides = [side("old"), side("new", timestep=0.003)]
    found = compare_returns(
        "played:Counter", *sides, policy=policy, seeds=3, seed=5, say=print
    )
    # The policy adds 2 to an observation of -1, then of its own actions.
    first = 1.0 if is_scripted else 1.0 + 3.0 + 5.0
    assert found.returns[0].value == pytest.approx(3 * 6.0 + first - 0.006, abs=1e-6)
    assert found.change.value == pytest.approx(-0.003)
    assert found.verdict is Verdict.DIFFERENT
    assert [one.value for one in found.success] == [float(not is_scripted)] * 2
    assert found.returns[0].low < found.returns[0].value - 3.0
    again = compare_returns(
        "played:Counter", *sides[:1] * 2, policy=policy, seeds=2, seed=5, say=print
    )
    assert again.verdict is Verdict.IDENTICAL


@pytest.mark.parametrize("policy", ["word", "absent.npy"])
def test_what_is_no_policy(policy):
    wanted = {"policy": policy, "seeds": 1, "seed": 0, "say": print}
    with pytest.raises(ParameterError, match=rf"--policy {policy}"):
        compare_returns("Hopper-v5", side("old"), side("new"), **wanted)


def test_a_release_is_imported_in_place_of_the_installed_one(tmp_path):
    """The folder of a release has precedence for MuJoCo alone."""
    for name in ("mujoco", "typer"):
        (tmp_path / f"{name}.py").write_text("__version__ = '0.0'", encoding="utf-8")
    code = (
        f"import sys; sys.path.insert(0, {str(Path(worker.__file__).parent)!r})\n"
        "from episodes_worker import use_release\n"
        f"use_release({{'release': {str(tmp_path)!r}, 'has_numpy': False}})\n"
        "import mujoco, typer; print(mujoco.__version__, typer.__version__)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    release, typer_version = done.stdout.split()
    assert release == "0.0"
    assert typer_version != "0.0"
