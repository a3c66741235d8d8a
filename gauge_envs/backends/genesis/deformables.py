"""Deformable bodies of a scene: which are supported, their presets, and their parts of the Genesis scene."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from gauge_envs.backends.genesis.parts import DeformablePart
from gauge_envs.backends.genesis.settings import SettingsGenesis
from gauge_envs.scene import Scene

__all__ = ["deformable_parts", "deformable_presets", "unsupported_deformables"]


def deformable_presets(scene: Scene) -> Mapping[str, SettingsGenesis]:
    """Return the presets of a scene with deformable bodies, by name; one of them is `default`."""
    return {"default": SettingsGenesis(preset="default", timestep_s=1 / 1800)}


def unsupported_deformables(scene: Scene, settings: SettingsGenesis) -> Iterator[str]:
    """Yield one sentence for each kind of unsupported feature of the deformable bodies of a scene."""
    if scene.deformables:
        others = len(scene.deformables) - 1
        more = f" (and {others} more)" if others else ""
        yield f"{scene.deformables[0].name!r}{more} is deformable: this backend builds rigid bodies only"


def deformable_parts(scene: Scene, settings: SettingsGenesis) -> list[DeformablePart]:
    """Return the parts of the deformable bodies of a scene; none for a rigid scene."""
    return []
