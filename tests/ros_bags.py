"""Bags of ROS 2 with states and commands of two joints."""

import numpy as np
import pytest

from gauge_envs.tools.identify.bag_child import JOINT_STATE, TRAJECTORY

COUNT = 40
TIMES_S = 0.02 * np.arange(COUNT)
ANGLES = np.stack([np.sin(TIMES_S), np.cos(3.0 * TIMES_S)], axis=1)
COMMANDS = np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, (4, 2)), 10, axis=0)


def bag_of(folder, commands=TRAJECTORY, storage="sqlite3"):
    """A bag of states of b and a at 50 Hz, and of a command of a and b each 0.2 s, a millisecond before the state."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    plugin = rosbag2.StoragePlugin[storage.upper()]
    with rosbag2.Writer(folder, version=9, storage_plugin=plugin) as bag:
        states = bag.add_connection("/joint_states", JOINT_STATE, typestore=store)
        targets = bag.add_connection("/arm/command", commands, typestore=store)

        def header(time_s):
            stamp_ns = round(1e9 * (1000.0 + time_s))
            time = types["builtin_interfaces/msg/Time"](
                sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9
            )
            return stamp_ns, types["std_msgs/msg/Header"](stamp=time, frame_id="")

        def write(connection, stamp_ns, message):
            raw = store.serialize_cdr(message, connection.msgtype)
            bag.write(connection, stamp_ns, raw)

        def state(stamp, names, values):
            none = np.zeros(0)
            return types[JOINT_STATE](
                header=stamp, name=names, position=values, velocity=none, effort=none
            )

        # A state before the first command has none, and is left out.
        write(states, header(-0.02)[0], state(header(-0.02)[1], ["b", "a"], ANGLES[0]))
        for row, time_s in enumerate(TIMES_S):
            if row % 10 == 0:
                stamp_ns, stamp = header(time_s - 0.001)
                if commands == JOINT_STATE:
                    message = state(stamp, ["a", "b"], COMMANDS[row])
                else:
                    zero = types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0)
                    none = np.zeros(0)
                    point = types["trajectory_msgs/msg/JointTrajectoryPoint"](
                        positions=COMMANDS[row], velocities=none, accelerations=none, effort=none, time_from_start=zero
                    )  # fmt: skip
                    message = types[TRAJECTORY](
                        header=stamp, joint_names=["a", "b"], points=[point]
                    )
                write(targets, stamp_ns, message)
            stamp_ns, stamp = header(time_s)
            write(states, stamp_ns, state(stamp, ["b", "a"], ANGLES[row, ::-1].copy()))
    return folder
