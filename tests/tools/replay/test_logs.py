"""Flaws of logs are named and handled; files that cannot be used say why."""

import json
from pathlib import Path

import numpy as np
import pytest
from places import ROOT
from planted_arm import SERVO, record, written_otherwise
from scipy.linalg import expm
from scipy.spatial.transform import Rotation
from texts import fenced

from gauge_envs.errors import GaugeError
from gauge_envs.tools.replay import ReplayVerdict, read_log, read_map, replay

EXAMPLE = ROOT / "examples" / "replay"


def saved(folder, log, **changes):
    """A log with changed columns."""
    file = folder / "changed.npz"
    np.savez(file, **{**dict(np.load(log)), **changes})
    return file


def flawed(columns, flaw):
    """Columns with a flaw, and the words that name it."""
    time_s, position, rng = columns["t"], columns["q"].copy(), np.random.default_rng(1)
    if flaw == "zeros":
        position[40::40] = 0.0
        return {"q": position}, "9 lost samples, written as 0,"
    if flaw == "numbers":
        position[1::2] = np.nan
        return {"q": position}, "rows without a number of position are left out: 200"
    if flaw == "wraps":
        return {"q": np.mod(position, 2.0 * np.pi)}, "angles modulo 2 pi"
    if flaw == "jitter":
        return {
            "t": time_s + rng.uniform(0.0, 0.006, len(time_s))
        }, "samples are taken as regular"
    if flaw == "unit":
        return {"dq": np.rad2deg(columns["dq"])}, "velocities are in deg/s"
    if flaw == "factor":
        return {"dq": columns["dq"] * [1.0, 0.5]}, "velocity of elbow is 0."
    if flaw == "late":
        return {"dq": np.roll(columns["dq"], 1, axis=0)}, "velocities are a row late"
    if flaw == "spikes":
        position[30::60, 0] += 0.4
        return {"q": position}, "7 spikes are left out"
    repeated = {
        key: np.repeat(columns[key], 5, axis=0) for key in ("q", "dq", "target")
    }
    return {
        "t": np.arange(5 * len(time_s)) * 0.004,
        **repeated,
    }, "positions are held for 5 rows"


@pytest.mark.parametrize(
    "flaw",
    ["zeros", "numbers", "wraps", "jitter", "unit", "factor", "late", "spikes", "held"],
)
def test_a_flaw_is_named_and_makes_no_cause(tmp_path, flaw):
    log, model = record(tmp_path)
    changes, words = flawed(dict(np.load(log)), flaw)
    file = saved(tmp_path, log, **changes)
    assert any(words in text for text in read_log(file).mistakes)
    assert replay(file, model).verdict is ReplayVerdict.NOISE


@pytest.mark.parametrize(("unit", "per_s"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
@pytest.mark.parametrize("start_s", [0.0, 1.7e9])
@pytest.mark.parametrize(
    ("lead_s", "lost"), [(0.0, 0), (0.0, 3), (-0.3, 0), (0.05, 0), (0.2, 5)]
)
def test_commands_keep_their_time_in_every_unit(
    tmp_path, unit, per_s, start_s, lead_s, lost
):
    """Commands start before or after the samples, of which the first may be lost."""
    log, _ = record(tmp_path)
    columns = dict(np.load(log))
    columns["q"][:lost] = np.nan
    clock = columns["t"]
    columns["command_t"] = clock + lead_s
    seconds = read_log(saved(tmp_path, log, **columns))
    for name in ("t", "command_t"):
        columns[name] = per_s * (columns[name] + start_s)
    found = read_log(saved(tmp_path, log, **columns))
    assert f"times are in {unit}" in "".join(found.mistakes)
    late_s, known_s = (
        each.command_time_s - each.time_s[0] for each in (found, seconds)
    )
    np.testing.assert_allclose(late_s, known_s, atol=2e-6)


def test_true_velocities_of_a_fast_motion_raise_no_warning(tmp_path):
    """At 50 Hz, central differences of positions show a motion of 8 Hz 16 % too slow."""
    log, _ = record(tmp_path)
    time_s = np.load(log)["t"]
    rate, phase = 2.0 * np.pi * 8.0, np.array([0.0, 1.0])
    angles = rate * time_s[:, None] + phase
    fast = saved(tmp_path, log, q=0.1 * np.sin(angles), dq=0.1 * rate * np.cos(angles))
    assert not any("velocities are" in text for text in read_log(fast).mistakes)


@pytest.mark.parametrize("writing", ["clock", "unit", "order", "mirror", "half"])
@pytest.mark.parametrize("flaw", ["", "factor", "late", "spikes", "zeros"])
def test_mistakes_do_not_hang_on_how_a_log_is_written(tmp_path, flaw, writing):
    log, _ = record(tmp_path)
    columns = dict(np.load(log))
    changes, words = flawed(columns, flaw) if flaw else ({}, "")
    columns |= changes
    changes, mapped = written_otherwise(columns, writing)
    found = read_log(saved(tmp_path, log, **columns | changes), mapped=mapped).mistakes
    assert len(found) == bool(flaw)
    assert words.lstrip("0123456789") in "".join(found)


def servo_at_10_hz(rate):
    """Exact samples of a servo that gets a target every 0.1 s, with critical damping, and its targets."""
    time_s = np.arange(0.0, 24.0, 0.1)
    target = np.sin(3.0 * time_s) + 0.5 * np.sin(7.3 * time_s + 1.0)
    law = expm(0.1 * np.array([[0.0, 1.0], [-(rate**2), -2.0 * rate]]))
    states = [np.zeros(2)]
    for goal in target[:-1]:
        rest = np.array([goal, 0.0])
        states.append(rest + law @ (states[-1] - rest))
    position, velocity = np.transpose(states)
    return {
        "t": time_s,
        "q_joint": position,
        "dq_joint": velocity,
        "target_joint": target,
    }


@pytest.mark.parametrize("rate", [5.0, 12.0, 25.0, 40.0])
@pytest.mark.parametrize("factor", [1.0, 0.5, 3.0])
def test_a_log_at_10_hz_tells_a_factor_from_a_motion_between_two_samples(
    tmp_path, rate, factor
):
    """A servo of 25 rad/s has much lower velocities at a new target than before it; the slopes cannot judge them."""
    columns = servo_at_10_hz(rate)
    columns["dq_joint"] = factor * columns["dq_joint"]
    np.savez(tmp_path / "log.npz", **columns)
    found = "".join(read_log(tmp_path / "log.npz").mistakes)
    is_judged = factor != 1.0 and rate < 20.0
    assert ("times the slope" in found) == is_judged == bool(found)


@pytest.mark.parametrize("rate_hz", [10, 50, 200])
def test_a_bounce_is_no_spike(tmp_path, rate_hz):
    time_s = np.arange(0.0, 1200.0 / rate_hz, 1.0 / rate_hz)
    turn = 1.7 * time_s
    bounce, speed = np.abs(np.sin(turn)), 1.7 * np.cos(turn) * np.sign(np.sin(turn))
    bounce += 0.3 * (np.sin(0.4 * turn) > 0.9)
    np.savez(tmp_path / "log.npz", t=time_s, q_joint=bounce, dq_joint=speed)
    assert not read_log(tmp_path / "log.npz").mistakes
    if rate_hz == 10:
        return
    bounce[100::97] += 1.5
    np.savez(tmp_path / "log.npz", t=time_s, q_joint=bounce, dq_joint=speed)
    assert "12 spikes" in read_log(tmp_path / "log.npz").mistakes[0]


@pytest.mark.slow
def test_a_log_whose_command_never_changes_is_explained(tmp_path):
    log, model = record(tmp_path, robot=SERVO)
    held = saved(tmp_path, log, target=np.full((400, 1), 0.1))
    assert replay(held, model).verdict is not ReplayVerdict.NOISE


def test_noise_of_each_joint_is_estimated_and_makes_no_cause(tmp_path):
    log, model = record(tmp_path)
    assert read_log(log).position_noise == pytest.approx(5e-4, rel=0.25)
    position = np.load(log)["q"]
    loud = position + np.random.default_rng(1).normal(0.0, 0.02, position.shape)
    assert replay(saved(tmp_path, log, q=loud), model).verdict is ReplayVerdict.NOISE


def test_names_signs_order_and_units_come_from_header_and_map(tmp_path):
    log, model = record(tmp_path)
    columns = dict(np.load(log))
    position, velocity, target = (
        np.rad2deg(columns[name]) * [-1, 1] for name in ("q", "dq", "target")
    )
    rows = np.column_stack([columns["t"], position, velocity[:, ::-1], target])
    file, map_file = tmp_path / "log.csv", tmp_path / "map.toml"
    header = "t,q_a,q_b,dq_b,dq_a,action_a,action_b"
    np.savetxt(file, rows, delimiter=",", header=header, comments="")
    map_file.write_text(
        'unit = "deg"\ncommand = "target"\n'
        '[joints.shoulder]\nlog = "a"\nsign = -1\n[joints.elbow]\nlog = "b"\n'
    )
    assert replay(file, model, mapped=read_map(map_file)).verdict is ReplayVerdict.NOISE


def test_conventions_of_the_base_are_decided_by_its_motion(tmp_path):
    time_s = np.arange(0.0, 4.0, 0.01)
    angles = np.sin(np.outer(time_s, (1.0, 1.7, 2.3)))
    velocity = np.gradient(angles, time_s, axis=0)
    turn = Rotation.from_euler("xyz", angles)
    body_rate = (turn[:-1].inv() * turn[1:]).as_rotvec() / 0.01
    body_rate = np.vstack([body_rate, body_rate[-1:]])
    quaternion = turn.as_quat(scalar_first=True)
    last = np.roll(quaternion, -1, axis=1)
    in_world, in_body = turn.apply(body_rate), turn.inv().apply(velocity)
    for pose, linear, angular, texts in (
        (quaternion, velocity, body_rate, []),
        (quaternion, velocity, in_world, ["is in the world frame"]),
        (quaternion, in_body, body_rate, ["base_linvel is in the body frame"]),
        (last, velocity, body_rate, ["is x y z w"]),
        (last, velocity, in_world, ["is x y z w", "is in the world frame"]),
        (quaternion, velocity, 0.0 * angles, ["not show", "do not fit the pose"]),
    ):
        base = {"base_pos": angles, "base_quat": pose}
        base |= {"base_linvel": linear, "base_angvel": angular}
        np.savez(tmp_path / "base.npz", t=time_s, q=angles, dq=velocity, **base)
        log = read_log(tmp_path / "base.npz")
        found = [text for text in log.findings + log.mistakes if "base" in text]
        assert all(words in text for words, text in zip(texts, found, strict=True))
        assert np.allclose(log.base_pose[:, 3:], quaternion)
        assert np.allclose(log.base_twist, np.hstack([velocity, body_rate]), atol=1e-6)
        again = read_log(tmp_path / "base.npz", mapped=log.mapped)
        assert not any("is turned" in text for text in again.mistakes)


def test_a_frame_that_explains_no_more_is_not_named(tmp_path):
    """A trot turns the trunk by 30 mrad: its angular velocities are almost the same in both frames."""
    rng = np.random.default_rng(0)
    time_s = np.arange(0.0, 8.0, 0.02)
    phase = np.outer(time_s, (13.0, 26.0, 6.5)) + np.array([0.0, 1.0, 2.0])
    angles, rates = 0.03 * np.sin(phase), 0.03 * np.cos(phase) * (13.0, 26.0, 6.5)
    rates = rates + 0.05 * rng.normal(size=rates.shape)
    base = {"base_pos": angles, "base_linvel": rates, "base_angvel": rates}
    turn = Rotation.from_euler("xyz", angles).as_quat(scalar_first=True)
    np.savez(tmp_path / "l.npz", t=time_s, q=angles, dq=rates, base_quat=turn, **base)
    assert not read_log(tmp_path / "l.npz").mistakes


def test_the_map_that_a_check_finds_makes_it_silent(tmp_path):
    log, _ = record(tmp_path)
    velocity = np.load(log)["dq"]
    file = saved(tmp_path, log, dq=velocity[:, ::-1] * [0.5, -3.0])
    found = read_log(file)
    words = ["are exchanged", "opposite sign", "times the slope", "times the slope"]
    assert all(word in text for word, text in zip(words, found.mistakes, strict=True))
    again = read_log(file, mapped=found.mapped)
    assert not again.mistakes
    assert np.allclose(again.velocity, found.velocity, rtol=1e-3)


def test_the_longest_name_of_a_column_counts(tmp_path):
    """`command_rad_hip` is the command of `hip`, not of a joint `rad_hip`."""
    file = tmp_path / "log.csv"
    rows = [f"{0.02 * k},{0.01 * k},{0.02 * k}" for k in range(30)]
    file.write_text("\n".join(["time_s,position_rad_hip,command_rad_hip", *rows]))
    log = read_log(file)
    assert (log.joints, log.command_kind) == (("hip",), "target")
    assert log.command_names == ("hip",)


def test_the_recorder_of_the_page_writes_a_log_of_gymnasium(tmp_path):
    import gymnasium as gym

    space: dict = {}
    exec(fenced(ROOT / "docs" / "replay.md", "python")[0], space)
    env = gym.make("InvertedPendulum-v5", reset_noise_scale=0.1).unwrapped
    env.reset(seed=0)
    recorder = space["Recorder"](["slider", "hinge"])
    rng = np.random.default_rng(0)
    for _ in range(60):
        control = rng.uniform(-0.3, 0.3, 1)
        recorder.add(env.data.time, q=env.data.qpos, dq=env.data.qvel, ctrl=control)
        env.do_simulation(control, env.frame_skip)
    recorder.save(tmp_path / "log.npz")
    assert (
        replay(tmp_path / "log.npz", Path(env.fullpath)).verdict is ReplayVerdict.NOISE
    )


FREE = '<worldbody><body><freejoint/><geom size="0.1"/></body>'
DRIVE = '<position joint="elbow" kp="20" kv="0.8"/>'


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"joints": ["shoulder", "wrist"]}, "wrist: the model has no such joint"),
        ({"joints": ["elbow", "elbow"]}, "q: a second column of elbow"),
        ({"t": -0.02 * np.arange(400)}, "the next time is -0.02 s later"),
        ({"q": np.zeros((399, 2))}, "a column has 399 rows, but there are 400 times"),
        ({"q": np.full((400, 2), np.nan)}, "position: 0 rows with numbers"),
        ({"q": np.full((400, 2), "x")}, "not numbers in q: .*'x'"),
        ({"map": "[joints.wrist]"}, "--map: wrist: the log has no such joint"),
        ({"map": 'command = "tau"'}, "tau: no such column"),
        ({"model": ("<worldbody>", FREE)}, "the base of the model is free"),
        ({"model": (DRIVE, "")}, "target elbow: no actuator of the model drives it"),
    ],
)
def test_what_cannot_be_used_is_named_with_its_place(tmp_path, changes, words):
    log, model = record(tmp_path)
    map_file = tmp_path / "map.toml"
    map_file.write_text(changes.pop("map", ""))
    model.write_text(model.read_text().replace(*changes.pop("model", ("", ""))))
    with pytest.raises(GaugeError, match=words):
        replay(saved(tmp_path, log, **changes), model, mapped=read_map(map_file))


@pytest.mark.slow
def test_the_real_pendulum_needs_armature_and_losses(gauge):
    log, model = EXAMPLE / "double_pendulum_day1.npz", EXAMPLE / "double_pendulum.xml"
    line = replay(log, model).line
    found = {
        (each.cause, value.parameter): value.fitted
        for each in line.several
        for value in each.values
    }
    assert line.verdict is ReplayVerdict.SEVERAL
    assert [each.cause for each in line.named] == ["armature", "dry friction"]
    assert line.trial.after < 0.1 * line.trial.before
    assert 0.002 < found["armature", "elbow"] < 0.008
    assert line.named[0].share > 0.995
    assert "times the noise is left" in line.sentence
    second = EXAMPLE / "double_pendulum_day4.npz"
    fitted = EXAMPLE / "double_pendulum_fitted.xml"
    shown = gauge(
        "replay",
        log,
        "--against",
        second,
        "--model",
        fitted,
        "--json",
    )
    rows = {row["joint"]: row for row in json.loads(shown.stdout)["joints"]}
    assert rows["elbow"]["repeat_rms"] == pytest.approx(0.040, abs=0.002)
    assert rows["elbow"]["predictions"][2]["rms"] < 0.06


def test_a_log_in_parquet_is_read(tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    time_s = np.arange(0.0, 1.0, 0.02)
    table = {"t": time_s, "q_hip": np.sin(time_s), "dq_hip": np.cos(time_s)}
    parquet.write_table(pyarrow.table(table), tmp_path / "log.parquet")
    log = read_log(tmp_path / "log.parquet")
    assert log.joints == ("hip",)
    assert np.allclose(log.position[:, 0], np.sin(time_s))
