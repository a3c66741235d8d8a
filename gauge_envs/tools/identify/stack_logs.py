"""Logs of other programs: datasets of LeRobot, bags of ROS 2, and trajectories of `mujoco.sysid`.

Each states commands that stay until the next one, as `logs.Log` has them.
"""

from __future__ import annotations

import importlib
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from gauge_envs.errors import AssetError, MissingExtraError, needs_extra
from gauge_envs.files import child_refusal, json_document, read_regular
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.identify import parquet_child
from gauge_envs.tools.identify.logs import (
    MOST_LOG_BYTES,
    Log,
    checked,
    npz_of_log,
    read_log,
)

UNITS = {"rad": 1.0, "deg": float(np.pi / 180.0)}
"""Units of angles in datasets that state none, in rad."""
JOINT_STATE = "sensor_msgs/msg/JointState"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
CONTROL = "_ctrl"
"""What `mujoco.sysid` adds to the name of an actuator."""
MOST_VALUES = 5_000_000
"""Largest count of values of a Parquet file: 12 joints at 50 Hz for two hours have fewer than these."""
BAG_SUFFIXES = (".mcap", ".db3")
SENSED = {
    int(mujoco.mjtSensor.mjSENS_JOINTPOS): "position",
    int(mujoco.mjtSensor.mjSENS_JOINTVEL): "rate",
}


def read_logs(
    path: Path, model: mujoco.MjSpec | None = None, unit: str | None = None
) -> list[Log]:
    """Return the logs of a file or a folder.

    Args:
        path: A log as `logs.read_log` reads it; the folder of a LeRobot dataset, version 3, each of whose episodes is a
            log; a bag of ROS 2 (its folder, or an MCAP file); or an NPZ file of `mujoco.sysid.SystemTrajectory`.
        model: Model of the robot, whose sensors and actuators tell which columns of `mujoco.sysid` are which joint.
        unit: Unit of the angles of a LeRobot dataset, `rad` or `deg`.

    Raises:
        AssetError: The file is none of these, or lacks what a log needs.
        MissingExtraError: What reads it is not installed.
    """
    if (path / "meta" / "info.json").is_file():
        return list(_lerobot(path, unit))
    if unit is not None:
        raise AssetError(path, "--angle-unit", "only a LeRobot dataset states no unit")
    if (path / "metadata.yaml").is_file() or path.suffix in BAG_SUFFIXES:
        return [_bag(path)]
    if path.suffix == ".parquet":
        reason = (
            "give the folder of the dataset: meta/info.json has the names of the joints"
        )
        raise AssetError(path, "", reason)
    if path.suffix == ".npz" and path.is_file():
        data = npz_of_log(path)
        if "sensordata_data" in data:
            return [_trajectory(path, data, model)]
    return [read_log(path)]


# --- LeRobot ---------------------------------------------------------------------------------------------------------


def _lerobot(path: Path, unit: str | None) -> Iterator[Log]:
    """Yield the episodes of a dataset: `observation.state` is measured, `action` is commanded at the same frame."""
    with needs_extra("datasets of LeRobot", "logs"):
        importlib.import_module("pyarrow")
    if unit not in UNITS:
        raise AssetError(
            path,
            "--angle-unit",
            "LeRobot states no unit of angles: give --angle-unit deg or rad. Angles that were normalized to -100 "
            "to 100, its default for SO-100 and SO-101, and a gripper from 0 to 100 are neither: record with "
            "use_degrees=true, and leave the gripper out with --joints",
        )
    info = _lerobot_info(path / "meta" / "info.json")
    if not str(info.get("codebase_version", "")).startswith("v3"):
        version = info.get("codebase_version", "no version")
        raise AssetError(
            path, "codebase_version", f"{version}: version 3 is read; convert it"
        )
    state, action = "observation.state", "action"
    names = []
    for feature in (state, action):
        if feature not in info["features"]:
            raise AssetError(path, feature, "the dataset has no such feature")
        stated: Any = info["features"][feature].get("names") or []
        if isinstance(stated, dict):
            stated = [one for group in stated.values() for one in group]
        names.append([str(one).removesuffix(".pos") for one in stated])
    if not names[0] or names[0] != names[1]:
        reason = f"its joints are {', '.join(names[1]) or 'without names'}, those of {state} {', '.join(names[0])}"
        raise AssetError(path, action, f"{reason}: a log needs the same for both")
    files = sorted((path / "data").glob("*/*.parquet"))
    if not files:
        raise AssetError(path, "data", "there is no file data/*/*.parquet")
    columns = ["episode_index", "timestamp", state, action]
    tables = [_parquet_columns(one, columns) for one in files]
    whole = {name: np.concatenate([one[name] for one in tables]) for name in columns}
    for episode in np.unique(whole["episode_index"]):
        rows = whole["episode_index"] == episode
        yield checked(
            path,
            Log(
                f"{path}, episode {episode:.0f}",
                whole["timestamp"][rows],
                UNITS[unit] * whole[state][rows],
                UNITS[unit] * whole[action][rows],
                joints=tuple(names[0]),
            ),
        )


def _parquet_columns(file: Path, names: list[str]) -> dict[str, FloatArray]:
    """Return columns of numbers of a Parquet file, each of shape [row_count, ...]."""
    try:
        content = read_regular(file, MOST_LOG_BYTES)
        script = Path(parquet_child.__file__)
        refusal = child_refusal(script, str(MOST_VALUES), *names, content=content)
        if refusal is not None:
            raise ValueError(refusal)
        found = parquet_child.columns(content, names, MOST_VALUES)
        return {name: np.asarray(found[name], np.float64) for name in names}
    except Exception as error:  # A table may hold anything but numbers.
        raise AssetError(file, "", f"cannot be read: {error}") from None


def _lerobot_info(file: Path) -> dict[str, Any]:
    try:
        info = json_document(read_regular(file, MOST_LOG_BYTES))
    except (OSError, ValueError) as error:
        raise AssetError(file, "", f"cannot be read: {error}") from None
    if not isinstance(info, dict) or not isinstance(info.get("features"), dict):
        raise AssetError(file, "features", "expected an object with features")
    return info


# --- ROS 2 -----------------------------------------------------------------------------------------------------------


def _bag(path: Path) -> Log:
    """Return the log of a bag: joint states, and the commands of the one topic that names joints."""
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise MissingExtraError("bags of ROS 2", "logs", error) from None
    try:
        # Definitions of messages that the bag does not hold.
        store = get_typestore(Stores.ROS2_HUMBLE)
        with AnyReader([path], default_typestore=store) as bag:
            topics = {one.topic: str(one.msgtype) for one in bag.connections}
            measured = [one for one in topics if one.endswith("joint_states")]
            commanded = [
                one
                for one, kind in topics.items()
                if one not in measured and kind in (JOINT_STATE, TRAJECTORY)
            ]
            listed = ", ".join(f"{one} ({kind})" for one, kind in topics.items())
            if len(measured) != 1 or topics[measured[0]] != JOINT_STATE:
                reason = f"one topic joint_states of {JOINT_STATE} is needed; it has {listed}"
                raise AssetError(path, "joint_states", reason)
            if len(commanded) != 1:
                kinds = f"{JOINT_STATE} or {TRAJECTORY}"
                reason = f"one topic of commands that names joints is needed, {kinds}; it has {listed}"
                raise AssetError(path, "commands", reason)
            rows: dict[str, list[tuple[float, Any]]] = {measured[0]: [], commanded[0]: []}  # fmt: skip
            wanted = [one for one in bag.connections if one.topic in rows]
            for connection, received_ns, raw in bag.messages(wanted):
                message: Any = bag.deserialize(raw, connection.msgtype)
                stamp = message.header.stamp
                stamped_s = stamp.sec + 1e-9 * stamp.nanosec
                time_s = stamped_s or 1e-9 * received_ns
                rows[connection.topic].append((time_s, message))
    except (AnyReaderError, OSError) as error:
        raise AssetError(path, "bag", f"cannot be read: {error}") from None
    states, commands = rows[measured[0]], rows[commanded[0]]
    if not states or not commands:
        raise AssetError(path, "bag", "it has no joint states, or no commands")
    first: Any = commands[0][1]
    is_state = topics[commanded[0]] == JOINT_STATE
    names = tuple(first.name if is_state else first.joint_names)
    command_times_s = np.array([time_s for time_s, _ in commands])
    targets = np.array(
        [
            _ordered(path, one.name, one.position, names)
            if is_state
            else _ordered(path, one.joint_names, one.points[0].positions, names)
            for _, one in commands
        ]
    )
    times_s = np.array([time_s for time_s, _ in states])
    angles = np.array(
        [_ordered(path, one.name, one.position, names) for _, one in states]
    )
    # What was measured before the first command has none.
    known = times_s >= command_times_s[0]
    latest = np.searchsorted(command_times_s, times_s[known], side="right") - 1
    log = Log(
        str(path),
        times_s[known] - times_s[known][0],
        angles[known],
        targets[latest],
        joints=names,
    )
    return checked(path, log)


def _ordered(
    path: Path, given: Sequence[str], values: Sequence[float], names: Sequence[str]
) -> list[float]:
    """Return the values of joints in the order of names."""
    by_name = dict(zip(given, values, strict=True))
    if missing := [one for one in names if one not in by_name]:
        raise AssetError(
            path, missing[0], f"a message lacks this joint; it has {', '.join(given)}"
        )
    return [float(by_name[one]) for one in names]


# --- mujoco.sysid ----------------------------------------------------------------------------------------------------


def _trajectory(path: Path, data: dict[str, Any], spec: mujoco.MjSpec | None) -> Log:
    """Return the log of a `SystemTrajectory`: its joint sensors, and the controls of the actuators of their joints."""
    if spec is None:
        raise AssetError(
            path, "--scene", "a file of mujoco.sysid has no joints: give its MJCF"
        )
    model = spec.compile()
    sensed: dict[str, dict[str, FloatArray]] = {"position": {}, "rate": {}}
    columns = _columns(data, "sensordata")
    for sensor in range(model.nsensor):
        kind = SENSED.get(int(model.sensor_type[sensor]))
        name = model.sensor(sensor).name
        if kind and name in columns:
            joint = model.joint(int(model.sensor_objid[sensor])).name
            sensed[kind][joint] = columns[name]
    controls = {
        name.removesuffix(CONTROL): values
        for name, values in _columns(data, "control").items()
    }
    commands = {
        model.joint(int(model.actuator_trnid[motor, 0])).name: (motor, controls[name])
        for motor in range(model.nu)
        if (name := model.actuator(motor).name) in controls
        and model.actuator_trntype[motor] == mujoco.mjtTrn.mjTRN_JOINT
    }
    joints = tuple(one for one in sensed["position"] if one in commands)
    if not joints:
        reason = "no joint has a jointpos sensor and an actuator of this model in the file; it has "
        raise AssetError(path, "", reason + ", ".join((*columns, *controls)))
    is_servo = [bool(model.actuator_biasprm[commands[one][0], 1]) for one in joints]
    if len(set(is_servo)) > 1:
        raise AssetError(path, "", "it has servos and motors: fit them apart")
    times_s = np.asarray(data["sensordata_times"], np.float64)
    given_s = np.asarray(data["control_times"], np.float64)
    latest = np.maximum(np.searchsorted(given_s, times_s, side="right") - 1, 0)
    given = np.stack([commands[one][1][latest] for one in joints], axis=1)
    rates = None
    if all(one in sensed["rate"] for one in joints):
        rates = np.stack([sensed["rate"][one] for one in joints], axis=1)
    log = Log(
        str(path),
        times_s,
        np.stack([sensed["position"][one] for one in joints], axis=1),
        given if is_servo[0] else None,
        None if is_servo[0] else given,
        joints,
        rates,
    )
    return checked(path, log)


def _columns(data: dict[str, Any], part: str) -> dict[str, FloatArray]:
    """Return the columns of a time series by their names, which a JSON text maps to types and indices."""
    values = np.asarray(data[f"{part}_data"], np.float64)
    mapping = json.loads(str(data.get(f"{part}_signal_mapping", "{}")))
    return {name: values[:, rows[0]] for name, (_, rows) in mapping.items()}
