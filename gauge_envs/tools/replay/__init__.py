"""Replay of a log by a model: where they differ, which cause explains it, and the line to paste."""

from gauge_envs.tools.replay.log import Log, LogMap, read_map
from gauge_envs.tools.replay.readers import read_log
from gauge_envs.tools.replay.report import ReplayResult, replay
from gauge_envs.tools.replay.schema import ExplanationLine, ReplayVerdict

__all__ = [
    "ExplanationLine",
    "Log",
    "LogMap",
    "ReplayResult",
    "ReplayVerdict",
    "read_log",
    "read_map",
    "replay",
]
