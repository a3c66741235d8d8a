"""MJCF files of scenes: reader of files that replace a scene, and writer for other tools."""

from gauge_envs.backends.mujoco.mjcf.writer import scene_mjcf_text

__all__ = ["scene_mjcf_text"]
