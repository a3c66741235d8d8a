"""Settings of joints from logs: friction, armature and gains of any engine, with intervals."""

from typing import TYPE_CHECKING

from gauge_envs.tools import door

if TYPE_CHECKING:
    from gauge_envs.tools.identify.fit import Identified, Setting, identify
    from gauge_envs.tools.identify.logs import Log, read_log
    from gauge_envs.tools.identify.rig import one_joint

__all__ = ["Identified", "Log", "Setting", "identify", "one_joint", "read_log"]

if not TYPE_CHECKING:  # With it, a type checker would accept any name.
    __getattr__ = door(__name__, "fit", "logs", "rig")
