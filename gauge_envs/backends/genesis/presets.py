"""Presets of the Genesis backend, and the choice of one for a scene.

The content of a scene determines its preset; scores have no influence.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gauge_envs.backends.genesis.document import is_frictionless
from gauge_envs.backends.genesis.foam_settings import SOFT_PRESETS, soft_presets
from gauge_envs.backends.genesis.pbd_settings import pbd_presets
from gauge_envs.backends.genesis.settings import PRESETS, SettingsGenesis
from gauge_envs.backends.settings import resolve_settings
from gauge_envs.backends.shared.spring_damper import impact_speed_m_per_s
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Cloth, ContactMode, Scene, SoftBody

FRICTIONLESS_IMPRATIO = 1e-9
"""Ratio of frictional to normal impedance in scenes without friction. Signorini contacts keep their normal force."""

STACK_BODIES = 20
"""Number of dynamic bodies from which on a rigid scene has the preset `stack`."""


def presets_for(scene: Scene) -> Mapping[str, SettingsGenesis]:
    """Return the presets of a scene by name. Scenes with deformable bodies have presets of their solvers."""
    if any(isinstance(body, Cloth) for body in scene.deformables):
        return pbd_presets(scene)
    if any(isinstance(body, SoftBody) for body in scene.deformables):
        return soft_presets(scene)
    return {"default": SettingsGenesis(preset="default", timestep_s=1 / 1800)} if scene.deformables else PRESETS


def settings_for(scene: Scene, changes: Mapping[str, Any] | None = None) -> SettingsGenesis:
    """Return the settings of a scene: its preset with a user's changes."""
    presets = presets_for(scene)
    if isinstance(changes, Mapping):
        _check_kind(changes.get("preset"), presets)
    settings = resolve_settings("Genesis", presets, preset=_preset_name(scene), changes=changes)
    if settings.impact_speed_m_per_s is None:
        settings = settings.model_copy(update={"impact_speed_m_per_s": float(f"{impact_speed_m_per_s(scene):.2g}")})
    if "impratio" not in (changes or {}) and settings.friction_cone == "elliptic" and is_frictionless(scene):
        return settings.model_copy(update={"impratio": FRICTIONLESS_IMPRATIO})
    return settings


def _check_kind(name: object, presets: Mapping[str, SettingsGenesis]) -> None:
    """Raise an error if a preset exists, but only for scenes of another kind."""
    if name in presets:
        return
    for kind, others in (("rigid bodies alone", tuple(PRESETS)), ("soft bodies", SOFT_PRESETS)):
        if name in others:
            raise UnsupportedSceneError(
                f"Genesis preset {name!r} is for scenes with {kind}; presets of this scene: {', '.join(presets)}"
            )


def _preset_name(scene: Scene) -> str:
    if scene.deformables:
        return "default"
    if not scene.contacts:
        return "contact_free"
    if len(scene.dynamic_bodies) >= STACK_BODIES:
        return "stack"
    if scene.has_impact_chain:
        return "impact_chain"
    return "impact" if all(contact.mode is ContactMode.IMPACT for contact in scene.contacts) else "default"
