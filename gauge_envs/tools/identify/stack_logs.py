"""Logs of other programs: datasets of LeRobot, bags of ROS 2, and trajectories of `mujoco.sysid`.

Each states commands that stay until the next one, as `logs.Log` has them.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from gauge_envs.errors import AssetError, needs_extra
from gauge_envs.files import (
    MEGABYTE,
    NUMBERS,
    check_regular,
    child_output,
    json_document,
    npz_arrays,
    read_regular,
)
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.identify import bag_child, parquet_child
from gauge_envs.tools.identify.logs import (
    COMMAND,
    MOST_LOG_BYTES,
    NAMES,
    POSITION,
    Log,
    checked,
    npz_of_log,
    read_log,
)

UNITS = {"rad": 1.0, "deg": float(np.pi / 180.0)}
"""Units of angles, in rad."""
TURN_RAD = float(2.0 * np.pi)
"""Largest angle without a unit."""
CONTROL = "_ctrl"
"""What `mujoco.sysid` adds to the name of an actuator."""
MOST_VALUES = 5_000_000
"""Largest count of values of a Parquet file or a bag: 12 joints at 50 Hz for two hours have fewer than these."""
MOST_BAG_BYTES = 2000 * MEGABYTE
"""Largest size of the files of a bag, which may have pictures beside the joints."""
BAG_CPU_S = 30
"""Longest processor time of reading a bag [s]."""
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
        unit: Unit of the angles, `rad` or `deg`: LeRobot states none, and other files that of their columns.

    Raises:
        AssetError: The file is none of these, or lacks what a log needs, or its angles reach beyond a turn, as degrees
            do, and no unit is given.
        MissingExtraError: What reads it is not installed.
    """
    logs = _logs_in(path, model, unit)
    for log in logs:
        reach_rad = float(np.abs(log.position_rad).max())
        if unit is None and reach_rad > TURN_RAD:
            raise AssetError(
                path,
                POSITION,
                f"it reaches {reach_rad:.3g} rad, {reach_rad / TURN_RAD:.2g} turns: give --angle-unit deg if these are "
                "degrees, or rad if the joint turns so far",
            )
    return [log.times(UNITS[unit]) for log in logs] if unit else logs


def _logs_in(path: Path, model: mujoco.MjSpec | None, unit: str | None) -> list[Log]:
    if (path / "meta" / "info.json").is_file():
        return list(_lerobot(path, unit))
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
            try:
                return [_trajectory(path, data, model)]
            except AssetError:
                raise
            except (LookupError, TypeError, ValueError, AttributeError) as error:
                reason = f"no trajectory of mujoco.sysid: {error!r}"
                raise AssetError(path, "", reason) from None
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
    names = [_joint_names(path, info["features"], one) for one in (state, action)]
    if not names[0] or names[0] != names[1]:
        reason = f"its joints are {', '.join(names[1]) or 'without names'}, those of {state} {', '.join(names[0])}"
        raise AssetError(path, action, f"{reason}: a log needs the same for both")
    files = sorted((path / "data").glob("*/*.parquet"))
    if not files:
        raise AssetError(path, "data", "there is no file data/*/*.parquet")
    columns = ["episode_index", "timestamp", state, action]
    tables = [_parquet_columns(one, columns) for one in files]
    try:
        whole = {
            name: np.concatenate([one[name] for one in tables]) for name in columns
        }
    except ValueError as error:
        raise AssetError(path, "data", f"shapes of its files differ: {error}") from None
    for episode in np.unique(whole["episode_index"]):
        rows = whole["episode_index"] == episode
        yield checked(
            path,
            Log(
                f"{path}, episode {episode:.0f}",
                whole["timestamp"][rows],
                whole[state][rows],
                whole[action][rows],
                joints=tuple(names[0]),
            ),
        )


def _joint_names(path: Path, features: dict[str, Any], feature: str) -> list[str]:
    """Return the names of the joints of a feature, which may be in groups."""
    if not isinstance(features.get(feature), dict):
        raise AssetError(path, feature, "the dataset has no such feature")
    stated = features[feature].get("names") or []
    groups = stated.values() if isinstance(stated, dict) else [stated]
    if not all(isinstance(group, list) for group in groups):
        raise AssetError(path, feature, "names is no list")
    return [str(one).removesuffix(".pos") for group in groups for one in group]


def _parquet_columns(file: Path, names: list[str]) -> dict[str, FloatArray]:
    """Return columns of numbers of a Parquet file, each of shape [row_count, ...]."""
    script = Path(parquet_child.__file__)
    try:
        content = read_regular(file, MOST_LOG_BYTES)
        printed = child_output(script, str(MOST_VALUES), *names, content=content)
        return npz_arrays(printed, names, MOST_LOG_BYTES)
    except (OSError, ValueError) as error:
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
    script = Path(bag_child.__file__)
    parts = [path]
    if (path / "metadata.yaml").is_file():
        parts = [one for one in path.iterdir() if not one.is_dir()]
    try:
        check_regular(parts, MOST_BAG_BYTES)
        with needs_extra("bags of ROS 2", "logs"):
            importlib.import_module("rosbags")
        printed = child_output(script, str(path), str(MOST_VALUES), cpu_s=BAG_CPU_S)
        names = ("time_s", POSITION, COMMAND, NAMES)
        arrays = npz_arrays(printed, names, MOST_LOG_BYTES, kinds=NUMBERS + "U")
    except (OSError, ValueError) as error:
        raise AssetError(path, "bag", f"cannot be read: {error}") from None
    times_s, angles, commands, joints = (arrays[name] for name in names)
    log = Log(str(path), times_s, angles, commands, joints=tuple(map(str, joints)))
    return checked(path, log)


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
    stated = str(data.get(f"{part}_signal_mapping", "{}"))
    mapping = json_document(stated.encode())
    return {name: values[:, rows[0]] for name, (_, rows) in mapping.items()}
