"""Read logs: each format gives titles and values of columns, and the titles say what they are."""

import csv
import json
import re
import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from functools import cache
from itertools import zip_longest
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from gauge_envs.errors import FileError
from gauge_envs.names import first_names
from gauge_envs.optional import needs_extra
from gauge_envs.reading import content_of, faults_of, reading
from gauge_envs.text import csv_text, json_document
from gauge_envs.tools.replay.checks import check_log
from gauge_envs.tools.replay.log import (
    COLUMN_NAMES,
    COMMANDS,
    QUANTITIES,
    FloatArray,
    Log,
    LogMap,
)

Table: TypeAlias = dict[str, FloatArray]
"""Columns of a quantity by joint."""
Columns: TypeAlias = list[tuple[str, Any]]
"""Titles and values of a file."""

LONGEST_FIRST = sorted(QUANTITIES, key=len, reverse=True)
COLUMN = re.compile(
    rf"({'|'.join(map(re.escape, LONGEST_FIRST))})(?:[._/:\[](.*?)\]?)?"
)
"""Title of a column: `q_des` is a name, and not the joint `des` of `q`."""

OF_JOINTS = (*COMMANDS, "position", "velocity")
"""Quantities with a column a joint."""

EPISODE_GAP = 10.0
"""Interval between two episodes, over that of the samples; no prediction crosses it."""

JOINT_STATE = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
NUMBERS = """MultiArrayLayout layout
float64[] data
================================================================================
MSG: std_msgs/MultiArrayLayout
MultiArrayDimension[] dim
uint32 data_offset
================================================================================
MSG: std_msgs/MultiArrayDimension
string label
uint32 size
uint32 stride
"""
DEFINITIONS = {
    "sensor_msgs/msg/JointState": JOINT_STATE,
    "std_msgs/msg/Float64MultiArray": NUMBERS,
}
"""Messages of ROS 2 that are read; older bags do not contain their definitions."""
MESSAGES = (
    "select name, type, timestamp, data from messages join topics on topic_id = topics.id "
    "order by timestamp"
)


# --- formats ---------------------------------------------------------------------------------------------------------


def _read_npz(file: Path, mapped: LogMap) -> Columns:
    with np.load(file) as archive:
        return [*archive.items()]


def _read_csv(file: Path, mapped: LogMap) -> Columns:
    rows = csv.reader(csv_text(content_of(file)))
    return [
        (title.strip("# "), [cell.strip() or "nan" for cell in cells])
        for title, *cells in zip_longest(*rows, fillvalue="")
    ]


def _read_parquet(file: Path, mapped: LogMap) -> Columns:
    """Read a file, or all files of a LeRobot data set, whose folder has the names of the joints."""
    with needs_extra("reading Parquet", "data"):
        from pyarrow import parquet
    data = parquet.ParquetDataset(file / "data" if file.is_dir() else file)
    titles = [name for name in data.schema.names if _meaning(name, mapped, ())]
    columns = [*data.read(titles).to_pydict().items()]
    root = file if file.is_dir() else file.absolute().parents[2]
    info = root / "meta" / "info.json"
    if info.is_file():
        features = json_document(info.read_bytes())["features"]
        names = features["observation.state"].get("names") or ()
        columns.append(("joints", [name.removesuffix(".pos") for name in names]))
    return columns


def _read_hdf5(file: Path, mapped: LogMap) -> Columns:
    """Read the episodes that Isaac Lab records."""
    with needs_extra("reading HDF5", "logs"):
        import h5py
    with h5py.File(file) as content:
        data = content["data"]
        facts = json.loads(data.attrs.get("env_args", "{}")).get("sim_args", {})
        step_s = facts.get("dt", 0.0) * facts.get("decimation", 0) or mapped.interval_s
        if not step_s:
            reason = "the file has no step; add interval_s to --map"
            raise FileError(file, "env_args", reason)
        names = sorted(data, key=lambda name: int(name.rpartition("_")[2]))
        parts = [_episode(data[name], k, step_s) for k, name in enumerate(names)]
    return [
        (title, np.concatenate([part[title] for part in parts])) for title in parts[0]
    ]


def _episode(demo: Any, index: int, step_s: float) -> dict[str, Any]:
    """Return an episode; its file has the state after each action, and the one before the first apart."""
    robots, starts = demo["states/articulation"], demo["initial_state/articulation"]
    robot = "robot" if "robot" in robots else next(iter(robots))
    first, after = starts[robot], robots[robot]
    state = {key: np.vstack([first[key], after[key][:-1]]) for key in after}
    actions = demo["actions"][:]
    columns = {"q": state["joint_position"], "dq": state["joint_velocity"]}
    columns |= {"action": actions, "t": step_s * np.arange(len(actions))}
    if np.ptp(state["root_pose"], axis=0).any():
        columns["base_pos"], columns["base_quat"] = np.split(state["root_pose"], [3], 1)
        columns["base_linvel"], columns["base_angvel"] = np.hsplit(
            state["root_velocity"], 2
        )
    return columns | {"episode": np.full(len(actions), index)}


def _read_bag(file: Path, mapped: LogMap) -> Columns:
    """Read the joint states of a bag of ROS 2, and the commands whose topic the map names."""
    named = {"position": "/joint_states"} | mapped.columns
    topics = {quantity: str(topic) for quantity, topic in named.items()}
    rows: dict[str, list[tuple[float, Any]]] = {}
    for topic, kind, time_ns, content in _bag_messages(file):
        if kind in DEFINITIONS:
            rows.setdefault(topic, []).append((1e-9 * time_ns, _decoder(kind)(content)))
    for topic in topics.values():
        if topic not in rows:
            reason = f"no messages; the file has {first_names([*rows])}: name the topics in [columns] of --map"
            raise FileError(file, topic, reason)
    is_stamped = all(hasattr(rows[topic][0][1], "header") for topic in topics.values())
    columns: Columns = []
    for quantity, topic in topics.items():
        columns += _topic_columns(quantity, rows[topic], is_stamped)
    return columns


def _bag_messages(file: Path) -> Iterator[tuple[str, str, int, bytes]]:
    """Yield topic, type, time of recording and content of each message."""
    parts = [*file.glob("*.mcap"), *file.glob("*.db3")] if file.is_dir() else [file]
    for part in sorted(parts):
        if part.suffix == ".db3":
            place = f"{part.absolute().as_uri()}?mode=ro"
            with closing(sqlite3.connect(place, uri=True)) as base:
                yield from base.execute(MESSAGES)
            continue
        with needs_extra("reading MCAP", "logs"):
            from mcap.reader import make_reader
        with part.open("rb") as stream:
            for schema, channel, message in make_reader(stream).iter_messages():
                kind = schema.name if schema else ""
                yield channel.topic, kind, message.log_time, message.data


@cache
def _decoder(kind: str) -> Any:
    with needs_extra("reading bags of ROS 2", "logs"):
        from mcap.records import Schema
        from mcap_ros2.decoder import DecoderFactory
    schema = Schema(1, DEFINITIONS[kind].encode(), "ros2msg", kind)
    return DecoderFactory().decoder_for("cdr", schema)


def _topic_columns(
    quantity: str, rows: Sequence[tuple[float, Any]], is_stamped: bool
) -> Iterator[tuple[str, Any]]:
    """Yield the columns of a topic; messages of other joints than the first one has are left out.

    Times are stamps where all topics have them, else those of the recorder.
    """
    names = getattr(rows[0][1], "name", None)
    rows = [row for row in rows if getattr(row[1], "name", None) == names]
    is_state = quantity == "position"
    stamps = [row[1].header.stamp for row in rows] if is_stamped else ()
    times = [stamp.sec + 1e-9 * stamp.nanosec for stamp in stamps]
    yield "time" if is_state else "command_time", times or [row[0] for row in rows]
    if not names:
        yield quantity, [[*row[1].data] for row in rows]
        return
    field = "effort" if quantity == "tau" else "position"
    for kind, key in ((quantity, field), *[("velocity", "velocity")] * is_state):
        table = np.array([[*getattr(row[1], key)] for row in rows])
        for name, column in zip(names, table.T, strict=False):
            yield f"{kind}[{name}]", column


READERS: dict[str, Callable[[Path, LogMap], Columns]] = {
    ".npz": _read_npz,
    ".parquet": _read_parquet,
    ".hdf5": _read_hdf5,
    ".h5": _read_hdf5,
    ".mcap": _read_bag,
    ".db3": _read_bag,
}
"""Reader by suffix; other files are CSV."""


# --- columns ---------------------------------------------------------------------------------------------------------


def read_log(
    file: Path, names: Sequence[str] = (), mapped: LogMap | None = None
) -> Log:
    """Return a log, checked, with its flaws named.

    Args:
        file: CSV, NPZ, Parquet, HDF5 of Isaac Lab, MCAP or a bag of ROS 2, or the folder of a LeRobot data set.
        names: Joints of the model, which name the columns of a file without names.
        mapped: Names, signs and units that differ.

    Raises:
        FileError: The file has no time or no positions, its columns do not fit each other, or the map does not fit it.
        MissingExtraError: The package that reads this format is not installed.
    """
    mapped = mapped or LogMap()
    columns = _columns_of(file, mapped)
    titles = dict(columns)
    order = mapped.order or [str(name) for name in titles.get("joints", ())]
    found = _by_joint(file, columns, order or names, mapped)
    if mapped.interval_s and not found["time"]:
        rows = len(next(iter(found["position"].values()), ()))
        found["time"] = {"": mapped.interval_s * np.arange(float(rows))}
    actions = found["action"]
    kind: str = mapped.command or next((k for k in COMMANDS if found[k]), "")
    # The map may say that actions are commands of another kind.
    commands = found.get(kind) or actions
    has = found | {kind: commands, "": True}
    for quantity in ("time", "position", kind, *mapped.columns):
        if not has.get(quantity):
            words = " ".join(COLUMN_NAMES[quantity])
            reason = f"no such column ({words}); the file has {first_names([*titles])}: name it in [columns] of --map"
            raise FileError(file, quantity, reason)
    mapped.check_joints(found["position"] | commands)
    joints, rates = tuple(found["position"]), found["velocity"]
    found["velocity"] = {name: rates[name] for name in joints if name in rates}
    time_s = _time_of(found)
    command_time_s = next(iter(found["command_time"].values()), time_s)

    def table(*parts: Table, times_s: FloatArray = time_s) -> FloatArray:
        values = [column for part in parts for column in part.values()]
        for column in values:
            if len(column) != len(times_s):
                reason = f"a column has {len(column)} rows, but there are {len(times_s)} times"
                raise FileError(file, None, reason)
        return np.reshape(values, (len(values), len(times_s))).T

    log = Log(
        name=file.name,
        joints=joints,
        time_s=time_s,
        position=table(found["position"]),
        velocity=table(found["velocity"]),
        command=table(commands, times_s=command_time_s),
        command_kind=kind,
        command_names=tuple(commands),
        command_time_s=command_time_s,
        base_pose=table(found["base_position"], found["base_quaternion"]),
        base_twist=table(found["base_linear_velocity"], found["base_angular_velocity"]),
        observation=table(found["policy_observation"]),
        action=table(actions if command_time_s is time_s else {}),
        mapped=mapped,
    )
    if not order and any(QUANTITIES.get(title) == "position" for title in titles):
        log.findings.append("columns without names are taken in the order of the model")
    check_log(log)
    return log


def _columns_of(file: Path, mapped: LogMap) -> Columns:
    """Return the columns of a file or folder."""
    reader = READERS.get(file.suffix, _read_csv)
    if file.is_dir():
        reader = _read_parquet if (file / "meta").is_dir() else _read_bag
    # Bags and data sets may be too large to be read at once.
    is_large = file.is_dir() or reader in (_read_bag, _read_hdf5)
    opened = faults_of if is_large else reading
    with opened(file, FileError, "a CSV, NPZ, Parquet, HDF5 or MCAP file"):
        return reader(file, mapped)


def _time_of(found: Mapping[str, Table]) -> FloatArray:
    """Return the times; stamps of ROS have seconds and nanoseconds, and an episode goes on after the one before."""
    times = found["time"]
    time_s = times.get("sec", next(iter(times.values())))
    time_s = time_s + 1e-9 * times.get("nanosec", 0.0)
    for episode in found["episode"].values():
        steps = np.diff(time_s, prepend=time_s[0])
        is_first = np.diff(episode, prepend=episode[0]) != 0.0
        steps[is_first] = EPISODE_GAP * np.median(steps)
        time_s = time_s[0] + np.cumsum(steps)
    return time_s


def _meaning(
    title: str, mapped: LogMap, names: Sequence[str]
) -> tuple[str, str | None] | None:
    """Return the quantity and joint of a title, which the map may name; None for a column that is not used."""
    for quantity, given in mapped.columns.items():
        if title == given:
            return quantity, None
        if isinstance(given, list) and title in given:
            index = given.index(title)
            is_joint = quantity in OF_JOINTS and index < len(names)
            return quantity, names[index] if is_joint else str(index)
    match = COLUMN.fullmatch(title)
    return (QUANTITIES[match[1]], match[2]) if match else None


def _by_joint(
    file: Path, columns: Columns, names: Sequence[str], mapped: LogMap
) -> dict[str, Table]:
    """Return the columns of each quantity by joint; `names` are the joints of an array that has all of them."""
    found: dict[str, Table] = {quantity: {} for quantity in COLUMN_NAMES}
    for title, cells in columns:
        meaning = _meaning(title, mapped, names)
        if not meaning:
            continue
        quantity, joint = meaning
        with faults_of(file, FileError, f"numbers in {title}"):
            values = np.atleast_2d(np.array(cells, dtype=float).T)
        is_named = len(names) == len(values) and quantity in OF_JOINTS
        labels = names if is_named else map(str, range(len(values)))
        model_names = {mapped.title(name, quantity): name for name in mapped.joints}
        # The map says what an action is.
        kind = mapped.command or quantity if quantity == "action" else quantity
        for label, column in zip(labels, values, strict=True):
            name = model_names.get(joint or label, joint or label)
            if name in found[quantity]:
                reason = f"a second column of {name}; rename one"
                raise FileError(file, title, reason)
            found[quantity][name] = mapped.converted(name, kind, column)
    if mapped.episodes and found["episode"]:
        (episode,) = found["episode"].values()
        is_chosen = np.isin(episode, mapped.episodes)
        for table in found.values():
            table.update({name: column[is_chosen] for name, column in table.items()})
    return found
