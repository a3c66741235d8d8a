"""Scene files of the suite: USD layers.

`gauge_envs.registry.scene_files` gives this module to the core.
"""

from gauge_envs.tools.usd.reader import read_usd as read_scene
from gauge_envs.tools.usd.writer import to_usd as write_scene

__all__ = [
    "read_scene",
    "write_scene",
]
