"""What the policy sees is compared with the state, term by term."""

import sys

import numpy as np
import pytest
from planted_arm import record
from scipy.spatial.transform import Rotation

from gauge_envs.errors import FileError, GaugeError
from gauge_envs.tools.replay import ReplayVerdict, read_log, read_map, replay
from gauge_envs.tools.replay.log import ControlMap, LogMap
from gauge_envs.tools.replay.observation import (
    check_policy,
    compare_commands,
    load_policy,
)

TERMS = ["base_angvel", "projected_gravity", "joint_pos", "joint_vel", "command 2"]
HOME = np.array([0.2, -0.4])


def base_log(folder, change):
    """A log of a base that turns, whose observation has a mistake, and its map."""
    time_s = np.arange(0.0, 6.0, 0.02)
    angles = np.sin(np.outer(time_s, (1.0, 1.7, 2.3)))
    turn = Rotation.from_euler("xyz", angles)
    rate = (turn[:-1].inv() * turn[1:]).as_rotvec() / 0.02
    rate = np.vstack([rate, rate[-1:]])
    phase = np.outer(time_s, (2.1, 3.3))
    joints, speed = np.sin(phase), np.cos(phase) * (2.1, 3.3)
    terms = {
        "base_angvel": rate,
        "projected_gravity": turn.inv().apply((0.0, 0.0, -1.0)),
        "joint_pos": joints - HOME,
        "joint_vel": 0.05 * speed,
        "command": np.zeros((len(time_s), 2)),
    }
    change(terms, turn, joints)
    file = folder / "policy.npz"
    np.savez(
        file,
        t=time_s,
        q=joints,
        dq=speed,
        base_pos=angles,
        base_quat=turn.as_quat(scalar_first=True),
        base_angvel=rate,
        base_linvel=np.gradient(angles, time_s, axis=0),
        obs=np.hstack(list(terms.values())),
    )
    return file, LogMap(observation=TERMS, observation_scale={"joint_vel": 0.05})


def nothing(terms, turn, joints):
    pass


def order_of_quaternion(terms, turn, joints):
    wrong = Rotation.from_quat(turn.as_quat(), scalar_first=True)
    terms["projected_gravity"] = wrong.inv().apply((0.0, 0.0, -1.0))


def world(terms, turn, joints):
    terms["base_angvel"] = turn.apply(terms["base_angvel"])


def twice(terms, turn, joints):
    terms["base_angvel"] = turn.inv().apply(terms["base_angvel"])


def scale(terms, turn, joints):
    terms["joint_vel"] = 2.0 * terms["joint_vel"]


def pose(terms, turn, joints):
    terms["joint_pos"] = joints


def columns(terms, turn, joints):
    terms["joint_pos"] = terms["joint_pos"][:, ::-1]


def late(terms, turn, joints):
    terms["joint_pos"] = np.roll(terms["joint_pos"], 2, axis=0)


def clip(terms, turn, joints):
    terms["joint_vel"] = terms["joint_vel"].clip(-0.05, 0.05)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (nothing, ""),
        (order_of_quaternion, "quaternion x y z w read as w x y z"),
        (world, "base_angvel in the world frame"),
        (twice, "base_angvel turned into the body frame twice"),
        (scale, "joint_vel with 2 times its scale"),
        (pose, "joint_pos without minus the default pose"),
        (columns, "joint_pos with columns in the order 1 0"),
        (late, "joint_pos 2 samples late"),
        (clip, "joint_vel clipped at 0.05"),
    ],
)
def test_a_mistake_of_an_observation_is_named(tmp_path, change, words):
    file, mapped = base_log(tmp_path, change)
    found = list(check_policy(read_log(file, mapped=mapped), HOME))
    assert len(found) == bool(words)
    assert words in "".join(found)


WEIGHTS = np.random.default_rng(3).normal(size=(12, 2))
WEIGHTS[10:] = 0.1 * np.eye(2)


def write_policy(file):
    """A linear policy in ONNX, for a batch of one."""
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    from onnx import helper, numpy_helper

    number = onnx.TensorProto.FLOAT
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["obs", "weights"], ["action"])],
        "policy",
        [helper.make_tensor_value_info("obs", number, [1, 12])],
        [helper.make_tensor_value_info("action", number, [1, 2])],
        [numpy_helper.from_array(WEIGHTS.astype(np.float32), "weights")],
    )
    opset = [helper.make_opsetid("", 13)]
    onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=8), file)


@pytest.mark.parametrize(
    ("is_logged", "change", "words"),
    [
        (True, nothing, ""),
        (True, late, "The policy sees joint_pos 2 samples late."),
        (False, nothing, ""),
        (False, world, "differs from the policy: with base_angvel in the world frame."),
    ],
)
def test_the_action_is_that_of_the_policy_file(tmp_path, is_logged, change, words):
    """Without the observation in the log, the rebuilt one with each mistake is tried."""
    write_policy(tmp_path / "policy.onnx")
    file, mapped = base_log(tmp_path, change)
    columns = dict(np.load(file))
    columns["action"] = columns["obs"] @ WEIGHTS
    if not is_logged:
        columns["action"] = columns.pop("obs")[:, :10] @ WEIGHTS[:10]
        terms = {"observation": [*TERMS[:-1], "last_action"]}
        columns["action"] = with_last_action(columns["action"])
        mapped = mapped.model_copy(update=terms)
    np.savez(file, **columns)
    policy = load_policy(tmp_path / "policy.onnx")
    log = read_log(file, mapped=mapped)
    found = list(check_policy(log, HOME, policy))
    assert len(found) == bool(words)
    assert words in "".join(found)


def with_last_action(actions):
    """The actions of a policy that sees its last one."""
    actions = actions.copy()
    for row in range(1, len(actions)):
        actions[row] += 0.1 * actions[row - 1]
    return actions


def test_a_policy_that_cannot_be_run_is_named(tmp_path, monkeypatch):
    (tmp_path / "policy.onnx").write_bytes(b"no policy")
    (tmp_path / "policy.pt").write_bytes(b"")
    for name, module, extra in (
        ("policy.onnx", "onnxruntime", "logs"),
        ("policy.pt", "torch", "rl"),
    ):
        monkeypatch.setitem(sys.modules, module, None)
        with pytest.raises(GaugeError, match=rf"needs {module}.*\[{extra}\]"):
            load_policy(tmp_path / name)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda action, angles: HOME + 0.5 * action, ""),
        (lambda action, angles: 0.5 * action, "without the default pose"),
        (lambda action, angles: angles + 0.5 * action, "added to the present pose"),
        (lambda action, angles: HOME + 0.25 * action, "with 0.5 times its scale"),
        (lambda action, angles: HOME + 0.5 * action[:, ::-1], "in the order 1 0"),
        (lambda action, angles: HOME + np.roll(0.5 * action, 1, axis=0), "late"),
    ],
)
def test_a_target_that_is_not_the_action_is_named(tmp_path, change, words):
    file, mapped = base_log(tmp_path, nothing)
    columns = dict(np.load(file))
    action = np.sin(np.outer(columns["t"], (4.1, 5.3)))
    columns |= {"action": action, "target": change(action, columns["q"])}
    np.savez(file, **columns)
    control = ControlMap(action_scale=0.5)
    mapped = mapped.model_copy(update={"command": "target", "control": control})
    found = list(check_policy(read_log(file, mapped=mapped), HOME))
    assert len(found) == bool(words)
    assert words in "".join(found)


@pytest.mark.parametrize(
    ("order", "words"), [((0, 1), ""), ((1, 0), "columns in the order 1 0")]
)
def test_commands_of_two_logs_are_compared_at_the_same_state(tmp_path, order, words):
    """Both logs walk on one circle of states, with other phases."""
    logs = []
    for name, phase in (("works.npz", 0.0), ("fails.npz", 0.3)):
        time_s = np.arange(0.0, 12.0, 0.02)
        angles = 3.0 * time_s[:, None] + phase + np.array([0.0, 1.0])
        command = np.cos(angles) + 0.3 * np.sin(2.0 * angles)
        command = command[:, order] if phase else command
        columns = {"q": np.sin(angles), "dq": 3.0 * np.cos(angles), "target": command}
        np.savez(tmp_path / name, t=time_s, **columns)
        logs.append(read_log(tmp_path / name))
    found = list(compare_commands(*logs))
    assert len(found) == bool(words)
    assert words in "".join(found)


def test_terms_that_do_not_fit_are_named(tmp_path):
    file, mapped = base_log(tmp_path, nothing)
    log = read_log(file, mapped=mapped)
    for terms, words in (
        ([*TERMS, "joint_pos"], "the terms have 14 columns, obs has 12"),
        (["joint_torque"], "no such term"),
    ):
        log.mapped = LogMap(observation=terms)
        with pytest.raises(FileError, match=words):
            list(check_policy(log, HOME))


def test_the_policy_is_named_where_the_physics_agrees(tmp_path):
    log, model = record(tmp_path)
    columns = dict(np.load(log))
    np.savez(log, **columns, obs=columns["dq"][:, ::-1])
    file = tmp_path / "map.toml"
    file.write_text('observation = ["joint_vel"]')
    line = replay(log, model, mapped=read_map(file)).line
    assert line.verdict is ReplayVerdict.POLICY
    assert line.sentence.startswith("The policy sees joint_vel with columns in the")
