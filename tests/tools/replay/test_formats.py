"""Each format is read from a small true file, which the format's own library wrote."""

import json
import re
import sqlite3
import sys
from contextlib import closing

import numpy as np
import pytest

from gauge_envs.errors import FileError, GaugeError
from gauge_envs.tools.replay import ReplayVerdict, read_log, read_map, replay
from gauge_envs.tools.replay.log import COLUMN_NAMES, QUANTITIES, LogMap
from gauge_envs.tools.replay.readers import DEFINITIONS

TIME_S = 0.02 * np.arange(60)
ANGLES = np.sin(np.outer(TIME_S, (2.0, 3.0)))
RATES = np.cos(np.outer(TIME_S, (2.0, 3.0))) * (2.0, 3.0)
NAMES = ["pan", "lift"]
OTHER_NAMES = sorted(QUANTITIES.keys() - COLUMN_NAMES)
STAMP_NS = 1_700_000_000_123_456_789 + np.round(1e9 * TIME_S).astype(int)


def is_the_motion(log, count=60):
    """Whether a log has the angles, rates and names above."""
    assert log.joints == tuple(NAMES)
    assert np.allclose(np.diff(log.time_s), 0.02, atol=1e-6)
    assert np.allclose(log.position, ANGLES[:count], atol=1e-6)


def lerobot(folder, episodes=2):
    """A LeRobot v3 data set: all episodes in one file, whose times begin again."""
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    file = folder / "set" / "data" / "chunk-000" / "file-000.parquet"
    file.parent.mkdir(parents=True)
    degrees = np.rad2deg(np.vstack([ANGLES] * episodes)).astype(np.float32)
    table = {
        "observation.state": list(degrees),
        "action": list(degrees),
        "timestamp": np.tile(TIME_S, episodes).astype(np.float32),
        "episode_index": np.repeat(range(episodes), len(TIME_S)),
        "frame_index": np.tile(range(len(TIME_S)), episodes),
    }
    parquet.write_table(pyarrow.table(table), file)
    names = [f"{name}.pos" for name in NAMES]
    features = {"observation.state": {"dtype": "float32", "names": names}}
    info = {"codebase_version": "v3.0", "fps": 50, "features": features}
    (folder / "set" / "meta").mkdir()
    (folder / "set" / "meta" / "info.json").write_text(json.dumps(info))
    return file


def test_a_lerobot_data_set_is_read(tmp_path):
    file = lerobot(tmp_path)
    mapped = LogMap(command="target", unit="deg")
    both = read_log(tmp_path / "set", mapped=mapped)
    assert both.command_names == both.joints == tuple(NAMES)
    # The slopes leave out three samples at each end.
    assert len(both.time_s) == 2 * 60 - 6
    assert np.diff(both.time_s).max() == pytest.approx(0.2, rel=1e-3)
    assert np.diff(both.time_s).min() > 0.0
    alone = read_log(file, mapped=mapped.model_copy(update={"episodes": [1]}))
    assert np.allclose(alone.position, ANGLES[3:-3], atol=1e-6)


def test_an_episode_of_isaac_lab_is_read(tmp_path):
    """States are recorded after each action, so that the first one stands in `initial_state`."""
    h5py = pytest.importorskip("h5py")
    file = tmp_path / "dataset.hdf5"
    pose = np.hstack([0.0 * ANGLES, 0.0 * ANGLES, [[0.5, 1.0, 0.0]] * 60])[:, :7]
    state = {"joint_position": ANGLES, "joint_velocity": RATES, "root_pose": pose}
    state["root_velocity"] = np.zeros((60, 6))
    with h5py.File(file, "w") as content:
        data = content.create_group("data")
        sim = {"dt": 0.005, "decimation": 4}
        data.attrs["env_args"] = json.dumps({"env_name": "own", "sim_args": sim})
        demo = data.create_group("demo_0")
        demo["actions"] = ANGLES[:-1]
        for name, values in state.items():
            place = f"articulation/robot/{name}"
            demo[f"initial_state/{place}"] = values[:1]
            demo[f"states/{place}"] = values[1:]
    log = read_log(file, NAMES, LogMap(command="target"))
    is_the_motion(log, 59)
    assert np.allclose(log.velocity, RATES[:-1])
    assert np.allclose(log.command, log.position)
    assert log.time_s[1] == pytest.approx(0.02)
    assert log.base_pose.size == 0


def joint_state(position, velocity, stamp_ns):
    stamp = {"sec": int(stamp_ns // 10**9), "nanosec": int(stamp_ns % 10**9)}
    return {
        "header": {"stamp": stamp, "frame_id": ""},
        "name": NAMES,
        "position": [*position],
        "velocity": [*velocity],
        "effort": [],
    }


def write_mcap(file):
    """A bag of joint states, and of commands that have no names and no stamps."""
    pytest.importorskip("mcap_ros2")
    from mcap_ros2.writer import Writer

    with file.open("wb") as stream:
        writer = Writer(stream)
        states, numbers = (
            writer.register_msgdef(kind, text) for kind, text in DEFINITIONS.items()
        )
        layout = {"dim": [], "data_offset": 0}
        for row, rate, stamp in zip(ANGLES, RATES, STAMP_NS, strict=True):
            now = int(stamp)
            state = joint_state(row, rate, stamp)
            writer.write_message("/joint_states", states, state, log_time=now)
            command = {"layout": layout, "data": [*row]}
            writer.write_message("/servo/commands", numbers, command, log_time=now)
        writer.finish()


@pytest.mark.parametrize("is_folder", [False, True])
def test_joint_states_of_mcap_are_read(tmp_path, is_folder):
    file = tmp_path / "bag_0.mcap"
    write_mcap(file)
    mapped = LogMap(columns={"target": "/servo/commands"}, order=NAMES)
    log = read_log(tmp_path if is_folder else file, mapped=mapped)
    is_the_motion(log)
    assert np.allclose(log.velocity, RATES)
    assert (log.command_kind, log.command_names) == ("target", tuple(NAMES))
    with pytest.raises(GaugeError, match="/arm: no messages; the file has /joint_sta"):
        read_log(file, mapped=LogMap(columns={"position": "/arm"}))


def test_joint_states_of_a_bag_in_sqlite_are_read(tmp_path):
    """The tables are those of rosbag2; the messages are the same as in MCAP."""
    write_mcap(tmp_path / "bag.mcap")
    from mcap.reader import make_reader

    with closing(sqlite3.connect(tmp_path / "bag.db3")) as base:
        base.executescript(
            "create table topics(id integer primary key, name text, type text,"
            " serialization_format text, offered_qos_profiles text);"
            "create table messages(id integer primary key, topic_id integer,"
            " timestamp integer, data blob);"
        )
        with (tmp_path / "bag.mcap").open("rb") as stream:
            for schema, channel, message in make_reader(stream).iter_messages():
                topic = (channel.id, channel.topic, schema.name, "cdr", "")
                base.execute("insert or ignore into topics values (?,?,?,?,?)", topic)
                row = (channel.id, message.log_time, message.data)
                base.execute("insert into messages values (null,?,?,?)", row)
        base.commit()
    is_the_motion(read_log(tmp_path / "bag.db3"))


def test_a_table_with_other_names_is_read_by_the_map(tmp_path):
    file, map_file = tmp_path / "log.csv", tmp_path / "map.toml"
    rows = np.column_stack([STAMP_NS - STAMP_NS[0], ANGLES, RATES, ANGLES])
    header = "rosbagTimestamp,m1/angle,m2/angle,m1/speed,m2/speed,goal_1,goal_2"
    np.savetxt(file, rows, delimiter=",", header=header, comments="", fmt="%.9g")
    map_file.write_text(
        'order = ["pan", "lift"]\n[columns]\ntime = "rosbagTimestamp"\n'
        'position = ["m1/angle", "m2/angle"]\nvelocity = ["m1/speed", "m2/speed"]\n'
        'target = ["goal_1", "goal_2"]\n'
    )
    log = read_log(file, mapped=read_map(map_file))
    is_the_motion(log)
    assert log.command_kind == "target"
    assert "times are in ns: they are converted" in log.mistakes
    with pytest.raises(GaugeError, match=r"time: no such column .*has rosbag"):
        read_log(file, mapped=LogMap(columns={"time": "stamp"}))


@pytest.mark.parametrize(
    ("key", "hint"),
    [
        *((name, f"write {QUANTITIES[name]}") for name in OTHER_NAMES),
        ("joints", "known: action, .* position, "),
        ("Velocity", "did you mean velocity"),
        ("positon", "did you mean position"),
        ("", "did you mean"),
    ],
)
def test_a_map_names_titles_of_known_quantities_alone(tmp_path, key, hint):
    map_file = tmp_path / "map.toml"
    map_file.write_text(f'[columns]\n"{key}" = "stamp"\n')
    text = rf"map\.toml: columns: '{re.escape(key)}' is no quantity of a log; {hint}"
    with pytest.raises(FileError, match=text):
        read_map(map_file)


def test_stamps_of_ros_have_seconds_and_nanoseconds(tmp_path):
    file = tmp_path / "log.csv"
    parts = STAMP_NS // 10**9, STAMP_NS % 10**9
    rows = np.column_stack([*parts, ANGLES])
    header = "header.stamp.sec,header.stamp.nanosec,position.pan,position.lift"
    np.savetxt(file, rows, delimiter=",", header=header, comments="", fmt="%.12g")
    assert np.diff(read_log(file).time_s) == pytest.approx(0.02, rel=1e-4)


@pytest.mark.parametrize(
    ("name", "module"), [("a.hdf5", "h5py"), ("a.mcap", "mcap.reader")]
)
def test_a_missing_library_is_named_with_its_extra(tmp_path, monkeypatch, name, module):
    (tmp_path / name).write_bytes(b"")
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(GaugeError, match=r"not installed: pip install .*\[logs\]"):
        read_log(tmp_path / name)


URDF = """
<robot name="pendulum">
  <link name="world"/>
  <link name="rod">
    <inertial>
      <origin xyz="0 0 -0.2"/><mass value="0.5"/>
      <inertia ixx="0.01" iyy="0.01" izz="0.001" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="pivot" type="continuous">
    <parent link="world"/><child link="rod"/><axis xyz="0 1 0"/>
  </joint>
</robot>
"""


def test_a_urdf_is_driven_by_the_gains_of_the_map(tmp_path):
    """A servo holds the pendulum: m g c sin(q) = kp (target - q)."""
    model, log = tmp_path / "pendulum.urdf", tmp_path / "log.npz"
    model.write_text(URDF)
    kp, kd, step_s = 4.0, 0.2, 2e-3
    inertia = 0.01 + 0.5 * 0.2**2
    angle = speed = 0.0
    rows = []
    for step in range(round(6.0 / step_s)):
        target = 0.4 * np.sin(8e-3 * step) + 0.2 * np.sin(18e-3 * step)
        if step % 10 == 0:
            held = target
            rows.append((step * step_s, angle, speed, held))
        torque = kp * (held - angle) - kd * speed - 0.5 * 9.81 * 0.2 * np.sin(angle)
        speed += step_s * torque / inertia
        angle += step_s * speed
    time_s, position, rate, targets = np.transpose(rows)
    noise = np.random.default_rng(0).normal(size=(2, len(rows)))
    position, rate = position + 5e-4 * noise[0], rate + 1e-2 * noise[1]
    np.savez(log, t=time_s, q_pivot=position, dq_pivot=rate, target_pivot=targets)
    mapped = LogMap.model_validate({"control": {"kp": kp, "kd": kd}})
    assert replay(log, model, mapped=mapped).verdict is ReplayVerdict.NOISE
