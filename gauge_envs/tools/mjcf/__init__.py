"""MJCF files of scenes: read in place of a scene, and written for other tools."""

from typing import TYPE_CHECKING

from gauge_envs.registry import lazy_names

if TYPE_CHECKING:
    from gauge_envs.tools.mjcf.drivers import (
        DRIVER_COLUMNS as DRIVER_COLUMNS,
        DRIVER_PREFIX as DRIVER_PREFIX,
    )
    from gauge_envs.tools.mjcf.writer import (
        NUMBER as NUMBER,
        expanded as expanded,
        scene_mjcf_text as scene_mjcf_text,
    )
else:
    __getattr__, __all__ = lazy_names(
        __name__,
        {
            ".drivers": ["DRIVER_COLUMNS", "DRIVER_PREFIX"],
            ".writer": ["NUMBER", "expanded", "scene_mjcf_text"],
        },
    )
