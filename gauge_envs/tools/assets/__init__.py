"""Scenes of the experiments as USD, MJCF, URDF and OBJ files for other tools."""

from typing import TYPE_CHECKING

from gauge_envs.registry import door

if TYPE_CHECKING:
    from gauge_envs.tools.assets.export import SOURCE as SOURCE
    from gauge_envs.tools.assets.urdf import BodyFile as BodyFile, body_files as body_files
else:
    __getattr__, __all__ = door(__name__)
