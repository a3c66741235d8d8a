"""Conversion between scenes and USD layers, including layers that other tools wrote."""

from typing import TYPE_CHECKING

from gauge_envs.registry import lazy_names

if TYPE_CHECKING:
    from gauge_envs.formats.usd.isaac_fabric import (
        surface_constants as surface_constants,
    )
    from gauge_envs.formats.usd.layer import record_follower as record_follower
    from gauge_envs.formats.usd.reader import (
        UsdScene as UsdScene,
        from_usd as from_usd,
        read_usd as read_usd,
    )
    from gauge_envs.formats.usd.target import write as write
    from gauge_envs.formats.usd.writer import (
        scene_stage as scene_stage,
        to_usd as to_usd,
    )
else:
    __getattr__, __all__ = lazy_names(
        __name__,
        {
            ".isaac_fabric": ["surface_constants"],
            ".layer": ["record_follower"],
            ".reader": ["UsdScene", "from_usd", "read_usd"],
            ".target": ["write"],
            ".writer": ["scene_stage", "to_usd"],
        },
        extra="usd",
    )
