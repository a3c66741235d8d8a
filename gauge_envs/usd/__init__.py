"""Scene <-> USD: a layer that any USD tool opens, and the way back, also from layers that somebody else wrote."""

from gauge_envs.usd.reader import UsdScene, read_points, read_usd
from gauge_envs.usd.writer import SOURCE, scene_to_usd, usd_text, write_usd

__all__ = ["SOURCE", "UsdScene", "read_points", "read_usd", "scene_to_usd", "usd_text", "write_usd"]
