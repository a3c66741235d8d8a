"""MJCF files of scenes: reader of files that replace a scene, and writer for other tools."""

from gauge_envs.tools.mjcf.writer import (
    DRIVER_COLUMNS,
    DRIVER_PREFIX,
    NUMBER,
    expanded,
    scene_mjcf_text,
)

__all__ = ["DRIVER_COLUMNS", "DRIVER_PREFIX", "NUMBER", "expanded", "scene_mjcf_text"]
