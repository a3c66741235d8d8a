"""Replay of a log by a model: where they differ, which cause explains it, and the line to paste."""

from typing import TYPE_CHECKING

from gauge_envs.registry import lazy_names

if TYPE_CHECKING:
    from gauge_envs.tools.replay.log import (
        Log as Log,
        LogMap as LogMap,
        read_log as read_log,
        read_map as read_map,
    )
    from gauge_envs.tools.replay.report import Replay as Replay, replay as replay
    from gauge_envs.tools.replay.schema import (
        ReplayLine as ReplayLine,
        Verdict as Verdict,
    )
else:
    __getattr__, __all__ = lazy_names(
        __name__,
        {
            ".log": ["Log", "LogMap", "read_log", "read_map"],
            ".report": ["Replay", "replay"],
            ".schema": ["ReplayLine", "Verdict"],
        },
    )
