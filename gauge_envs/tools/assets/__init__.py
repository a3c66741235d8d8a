"""Scenes of the experiments as USD, MJCF, URDF and OBJ files for other tools."""

from typing import TYPE_CHECKING

from gauge_envs.tools import door

if TYPE_CHECKING:
    from gauge_envs.tools.assets.export import SOURCE
    from gauge_envs.tools.assets.urdf import BodyFile, body_files

__all__ = ["SOURCE", "BodyFile", "body_files"]

if not TYPE_CHECKING:  # With it, a type checker would accept any name.
    __getattr__ = door(__name__, "export", "urdf")
