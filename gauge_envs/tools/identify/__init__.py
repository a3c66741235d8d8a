"""Settings of joints from logs: friction, armature and gains of any engine, with intervals."""

from typing import TYPE_CHECKING

from gauge_envs.registry import door

if TYPE_CHECKING:
    from gauge_envs.tools.identify.fit import identify as identify
    from gauge_envs.tools.identify.identified import (
        Identified as Identified,
        Setting as Setting,
    )
    from gauge_envs.tools.identify.logs import Log as Log, read_log as read_log
    from gauge_envs.tools.identify.model_files import read_mjcf as read_mjcf
    from gauge_envs.tools.identify.rig import one_joint as one_joint
else:
    __getattr__, __all__ = door(__name__)
