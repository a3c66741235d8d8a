"""Scene files of the suite: USD layers. `gauge_envs.registry.scene_files` gives this module to the core."""

from gauge_envs.tools.usd.reader import UsdScene as UsdScene, read_points as read_points, read_usd as read_scene
from gauge_envs.tools.usd.writer import to_usd as write_scene

__all__ = ["UsdScene", "read_points", "read_scene", "write_scene"]
