"""What the policy sees is compared with the state, term by term."""

import numpy as np
import pytest
from planted_arm import record
from scipy.spatial.transform import Rotation

from gauge_envs.errors import FileError
from gauge_envs.tools.replay import ReplayVerdict, read_log, read_map, replay
from gauge_envs.tools.replay.log import LogMap
from gauge_envs.tools.replay.observation import check_policy

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
        (order_of_quaternion, "numbers x y z w of the quaternion"),
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
    found = list(check_policy(read_log(file, mapped=mapped), mapped, HOME))
    assert len(found) == bool(words)
    assert words in "".join(found)


def test_terms_that_do_not_fit_are_named(tmp_path):
    file, mapped = base_log(tmp_path, nothing)
    log = read_log(file, mapped=mapped)
    for terms, words in (
        ([*TERMS, "joint_pos"], "the terms have 14 columns, obs has 12"),
        (["joint_torque"], "no such term"),
    ):
        with pytest.raises(FileError, match=words):
            list(check_policy(log, LogMap(observation=terms), HOME))


def test_the_policy_is_named_where_the_physics_agrees(tmp_path):
    log, model = record(tmp_path)
    columns = dict(np.load(log))
    np.savez(log, **columns, obs=columns["dq"][:, ::-1])
    file = tmp_path / "map.toml"
    file.write_text('observation = ["joint_vel"]')
    line = replay(log, model, mapped=read_map(file)).line
    assert line.verdict is ReplayVerdict.POLICY
    assert line.sentence.startswith("The policy sees joint_vel with columns in the")
