"""Policies between two settings of MuJoCo, against closed forms: a pushed block, and the step of a servo."""

import json
import sys
import types

import gymnasium
import numpy as np
import pytest
from test_policies import write_onnx

from gauge_envs.errors import ParameterError
from gauge_envs.tools.transfer.settings_replay import (
    ModelEnv,
    apply_settings,
    make_env,
    replay_settings,
)

G = 9.81
FORCE_N, MASS_KG, CONTROL_S, DURATION_S = 5.0, 1.0, 0.02, 1.0
BLOCK = f"""<mujoco><option timestep="0.002" cone="elliptic" impratio="100"/><worldbody>
  <geom name="board" type="plane" size="5 5 1" friction="0.2"/>
  <body name="block" pos="0 0 0.05">
    <joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
    <geom type="box" size="0.05 0.05 0.05" mass="{MASS_KG}" friction="0.2"/></body></worldbody>
  <actuator><motor joint="x"/></actuator></mujoco>"""
KP, KV, INERTIA, STEP_S = 20.0, 0.4, 0.1, 0.002
SERVO = f"""<mujoco><option timestep="{STEP_S}" integrator="Euler" gravity="0 0 0"/><worldbody><body><joint name="q"/>
  <inertial pos="0 0 0" mass="1" diaginertia="{INERTIA} {INERTIA} {INERTIA}"/></body></worldbody>
  <actuator><position joint="q" kp="{KP}" kv="{KV}"/></actuator></mujoco>"""


def travelled(model, data):
    return float(data.qvel[0]) * CONTROL_S, bool(data.qpos[0] > 1.0)


def angle(model, data):
    return float(data.qpos[0])


def replayed(tmp_path, xml, reward, action, test, *, seeds=3):
    path = tmp_path / "model.xml"
    path.write_text(xml)

    def make():
        return ModelEnv(path, reward, control_s=CONTROL_S, duration_s=DURATION_S)

    policies = {"scripted": lambda _: np.array([action])}
    return replay_settings("model.xml", make, policies, {}, test, seeds=seeds)


def distance_m(friction):
    return 0.5 * (FORCE_N / MASS_KG - friction * G) * DURATION_S**2


def test_a_pushed_block_keeps_what_coulomb_leaves(tmp_path):
    """The reward is the distance, (F/m - mu g) t^2 / 2; the episode adds half a control interval of the last speed."""
    report = replayed(tmp_path, BLOCK, travelled, FORCE_N, {"geom:*.friction": "0.4"})
    assert report.test.kept is not None
    assert report.test.kept.value == pytest.approx(
        distance_m(0.4) / distance_m(0.2), rel=0.02
    )
    assert report.training.reward.value == pytest.approx(distance_m(0.2), rel=0.04)
    assert report.falls


def test_success_has_an_exact_interval(tmp_path):
    """A metre is passed with friction 0.2 alone. Of 0 in n the interval ends at 1 - 0.025^(1/n)."""
    report = replayed(tmp_path, BLOCK, travelled, FORCE_N, {"geom:block.friction": "0.4"})  # fmt: skip
    trained, tested = report.training.success, report.test.success
    assert trained is not None and tested is not None
    assert (trained.value, tested.value) == (1.0, 0.0)
    assert tested.high == pytest.approx(1.0 - 0.025 ** (1 / 3))
    assert trained.low == pytest.approx(0.025 ** (1 / 3))


@pytest.mark.parametrize("step_s", [0.001, 0.01])
def test_the_step_of_a_servo_follows_the_recurrence_of_its_time_step(tmp_path, step_s):
    """Euler's step: v += h (kp (1 - q) - kv v) / I, then q += h v. The time between actions stays."""
    report = replayed(tmp_path, SERVO, angle, 1.0, {"timestep": str(step_s)})

    def total(h):
        q = v = paid = 0.0
        for _ in range(round(DURATION_S / CONTROL_S)):
            for _ in range(round(CONTROL_S / h)):
                v += h * (KP * (1.0 - q) - KV * v) / INERTIA
                q += h * v
            paid += q
        return paid

    # The start has rates of 1 mrad/s.
    assert report.training.reward.value == pytest.approx(total(STEP_S), abs=0.02)
    assert report.test.reward.value == pytest.approx(total(step_s), abs=0.02)
    assert report.test.change.value == pytest.approx(total(step_s) - total(STEP_S), abs=0.005)  # fmt: skip
    assert abs(total(step_s) - total(STEP_S)) > 0.02


def test_a_gymnasium_id_is_replayed_and_the_same_settings_keep_all(gauge, monkeypatch):
    module = types.ModuleType("scripted_ant")
    module.act = lambda _: np.full(3, 0.1)  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "scripted_ant", module)
    words = ["transfer", "settings", "scripted_ant:act", "--trust", "--env=Hopper-v5", "--seeds=2"]  # fmt: skip
    same = gauge(*words, "--set=impratio=1")
    assert "Keeps 100 % [100, 100]" in " ".join(same.stdout.split())
    other = gauge(*words, "--set=gravity=0 0 -20", "--fail-below=99", "--json")
    assert other.exit_code == 1


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("imprato", "10", "no option of MuJoCo"),
        ("cone", "round", "known are pyramidal, elliptic"),
        ("impratio", "much", "expected 1 to 1 numbers"),
        ("timestep", "0.003", "no multiple of the time step"),
        ("geom:foot.friction", "1", "no geom of the model has such a name"),
        ("geom:*.colour", "1", "expected KIND:PATTERN.attribute"),
    ],
)
def test_wrong_settings_are_explained(tmp_path, name, text, reason):
    with pytest.raises(ParameterError, match=reason):
        replayed(tmp_path, BLOCK, travelled, FORCE_N, {name: text})


def test_elements_are_changed_by_name(tmp_path):
    path = tmp_path / "servo.xml"
    path.write_text(SERVO)
    env = ModelEnv(path, angle, control_s=CONTROL_S, duration_s=DURATION_S)
    changes = {"joint:q.armature": "0.3", "actuator:*.kp": "7", "cone": "elliptic"}
    apply_settings(env, changes)
    assert env.model.dof_armature.tolist() == [0.3]
    assert env.model.actuator_gainprm[0, 0] == 7.0
    assert env.model.actuator_biasprm[0, :3].tolist() == [0.0, -7.0, -KV]
    assert env.model.opt.cone == 1
    path.write_text(BLOCK)
    env = ModelEnv(path, angle, control_s=CONTROL_S, duration_s=DURATION_S)
    apply_settings(env, {"geom:*.friction": "0.4"})
    assert env.model.geom_friction[:, 0].tolist() == [0.4, 0.4]


def test_what_is_needed_is_said(tmp_path):
    options = {"reward": None, "control_s": None, "duration_s": None}
    with pytest.raises(ParameterError, match="give --reward, --control, --duration"):
        make_env("robot.xml", trust=True, **options)
    with pytest.raises(ParameterError, match="Install the package that registers it"):
        make_env("NoSuchRobot-v0", trust=True, **options)
    with pytest.raises(ParameterError, match="add --trust"):
        make_env("my_robot:make", trust=False, **options)
    with pytest.raises(ParameterError, match="has no MuJoCo model"):
        apply_settings(gymnasium.make("Pendulum-v1"), {"impratio": "10"})


def shares(gauge, policy, env, setting, *options):
    """Return what the command says that a policy keeps, and its reward with the settings of the training."""
    words = ["transfer", "settings", str(policy), f"--env={env}", f"--set={setting}"]
    said = gauge(*words, "--seeds=2", "--trust", "--json", "--fail-below=0", *options)
    assert said.exit_code == 0, said.stderr
    (line,) = [json.loads(one) for one in said.stdout.splitlines()]
    return line["test"]["kept"]["value"], line["training"]["reward"]["value"]


@pytest.mark.slow
def test_an_onnx_policy_on_a_model_file_keeps_what_its_network_keeps(
    gauge, tmp_path, monkeypatch
):
    """The network is 0.1 times the sum of the observation, on a servo whose gain is halved."""
    module = types.ModuleType("servo_reward")
    module.angle = lambda model, data: 1.0 + float(data.qpos[0])
    monkeypatch.setitem(sys.modules, "servo_reward", module)
    file = tmp_path / "servo.xml"
    bent = SERVO.replace('name="q"', 'name="q" ref="57.3"')
    file.write_text(bent.replace(f'kv="{KV}"', 'kv="4"'))
    policy = write_onnx(tmp_path / "policy.onnx", 2)
    task = {"control_s": CONTROL_S, "duration_s": DURATION_S}
    kept, reward = shares(
        gauge, policy, file, "actuator:*.kp=10", "--reward=servo_reward:angle",
        f"--control={CONTROL_S}", f"--duration={DURATION_S}",
    )  # fmt: skip
    expected = replay_settings(
        "servo", lambda: ModelEnv(file, module.angle, **task),
        {"linear": lambda seen: np.array([0.1 * seen.sum()])}, {}, {"actuator:*.kp": "10"}, seeds=2,
    )  # fmt: skip
    assert kept == pytest.approx(expected.test.kept.value, rel=1e-6)
    assert reward == pytest.approx(expected.training.reward.value, rel=1e-6)
    assert abs(kept - 1.0) > 1e-3


@pytest.mark.slow
def test_a_trained_policy_of_sb3_keeps_what_it_keeps_in_its_own_package(
    gauge, tmp_path
):
    sb3 = pytest.importorskip("stable_baselines3", reason="extra 'rl' is not installed")
    learner = sb3.PPO(
        "MlpPolicy", gymnasium.make("Hopper-v5"), n_steps=256, seed=0, device="cpu"
    )
    learner.learn(512)
    learner.save(tmp_path / "policy.zip")
    setting = {"gravity": "0 0 -15"}
    kept, reward = shares(gauge, tmp_path / "policy.zip", "Hopper-v5", "gravity=0 0 -15")  # fmt: skip
    expected = replay_settings(
        "Hopper-v5", lambda: gymnasium.make("Hopper-v5"),
        {"ppo": lambda seen: learner.predict(seen, deterministic=True)[0]}, {}, setting, seeds=2,
    )  # fmt: skip
    assert kept == pytest.approx(expected.test.kept.value, rel=1e-3)
    assert reward == pytest.approx(expected.training.reward.value, rel=1e-3)
    assert abs(kept - 1.0) > 1e-3
