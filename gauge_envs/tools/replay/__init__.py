"""Replay of a log by a model: where they differ, which cause explains it, and the line to paste."""

from gauge_envs.tools.replay.log import Log, LogMap, read_log, read_map
from gauge_envs.tools.replay.report import Replay, replay
from gauge_envs.tools.replay.schema import ReplayLine, Verdict

__all__ = [
    "Log",
    "LogMap",
    "Replay",
    "ReplayLine",
    "Verdict",
    "read_log",
    "read_map",
    "replay",
]
