"""Reads a bag of ROS 2 in a child process, as rosbags has no limits, and prints its log as an NPZ.

Arguments: the bag, a folder or a file, and the largest count of values. `files.child_output` runs it. Types of messages
are those of ROS 2: rosbags would make code of the definitions in a bag.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

REFUSED = 3
"""Exit code of a refusal; `files.CHILD_REFUSED`."""
JOINT_STATE = "sensor_msgs/msg/JointState"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"


def log_of_bag(path: Path, largest_count: int) -> dict[str, Any]:
    """Return the arrays of a log: joint states, and the commands of the one topic that names joints."""
    from rosbags import rosbag2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with rosbag2.Reader(path) as bag:
        topics = {one.topic: one.msgtype for one in bag.connections}
        measured = [one for one in topics if one.endswith("joint_states")]
        commanded = [
            one
            for one, kind in topics.items()
            if one not in measured and kind in (JOINT_STATE, TRAJECTORY)
        ]
        listed = ", ".join(f"{one} ({kind})" for one, kind in topics.items())
        if len(measured) != 1 or topics[measured[0]] != JOINT_STATE:
            raise ValueError(
                f"one topic joint_states of {JOINT_STATE} is needed; it has {listed}"
            )
        if len(commanded) != 1:
            kinds = f"{JOINT_STATE} or {TRAJECTORY}"
            raise ValueError(
                f"one topic of commands that names joints is needed, {kinds}; it has {listed}"
            )
        rows: dict[str, list[tuple[float, dict[str, float]]]]
        rows = {measured[0]: [], commanded[0]: []}
        count = 0
        wanted = [one for one in bag.connections if one.topic in rows]
        for connection, received_ns, raw in bag.messages(wanted):
            message: Any = store.deserialize_cdr(raw, connection.msgtype)
            stamp = message.header.stamp
            stamped_s = stamp.sec + 1e-9 * stamp.nanosec
            angles = _angles(message, connection.msgtype)
            rows[connection.topic].append((stamped_s or 1e-9 * received_ns, angles))
            count += 1 + len(angles)
            if count > largest_count:
                raise ValueError(f"it has more than {largest_count} values")
    states, commands = rows[measured[0]], rows[commanded[0]]
    if not states or not commands:
        raise ValueError("it has no joint states, or no commands")
    names = tuple(commands[0][1])
    command_times_s = np.array([time_s for time_s, _ in commands])
    targets = np.array([_ordered(one, names) for _, one in commands])
    times_s = np.array([time_s for time_s, _ in states])
    positions = np.array([_ordered(one, names) for _, one in states])
    # What was measured before the first command has none.
    known = times_s >= command_times_s[0]
    latest = np.searchsorted(command_times_s, times_s[known], side="right") - 1
    return {
        "time_s": times_s[known] - times_s[known][:1],
        "position_rad": positions[known],
        "command_rad": targets[latest],
        "joints": np.array(names),
    }


def _angles(message: Any, kind: str) -> dict[str, float]:
    """Return the angles of a message by the names of its joints."""
    if kind == JOINT_STATE:
        return dict(zip(message.name, message.position, strict=True))
    return dict(zip(message.joint_names, message.points[0].positions, strict=True))


def _ordered(angles: dict[str, float], names: Sequence[str]) -> list[float]:
    """Return the angles of joints in the order of names."""
    if missing := [one for one in names if one not in angles]:
        known = ", ".join(angles)
        raise ValueError(f"{missing[0]}: a message lacks this joint; it has {known}")
    return [float(angles[one]) for one in names]


if __name__ == "__main__":
    try:
        arrays = log_of_bag(Path(sys.argv[1]), int(sys.argv[2]))
        np.savez(sys.stdout.buffer, **arrays)
    except Exception as error:  # rosbags raises many types for a damaged file.
        print(ascii(str(error))[1:-1] or type(error).__name__)
        sys.exit(REFUSED)
