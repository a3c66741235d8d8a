"""Presets of the Genesis backend, and the choice of one for a scene.

The content of a scene determines its preset; scores have no influence.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gauge_envs.backends.genesis.deformables import deformable_presets
from gauge_envs.backends.genesis.settings import SettingsGenesis
from gauge_envs.backends.settings import resolve_settings
from gauge_envs.scene import Scene

__all__ = ["RIGID_PRESETS", "presets_for", "settings_for"]

STACK_BODIES = 20
"""Number of dynamic bodies from which on a rigid scene has the preset `stack`."""

OUT_OF_BOX = SettingsGenesis(
    preset="out_of_box",
    timestep_s=1 / 180,
    precision=32,
    iterations=25,
    tolerance=1e-5,
    friction_cone="pyramidal",
    contact_resolution="convex",
    impratio=1.0,
    pruning_tolerance=0.02,
    # Twice the step: Genesis raises its default of 0.01 s to it.
    sustained_timeconst_s=2 / 180,
    sustained_impedance=(0.9, 0.95, 0.001),
    impact_steps=None,
)

RIGID_PRESETS: dict[str, SettingsGenesis] = {
    "default": SettingsGenesis(preset="default", timestep_s=1 / 9000),
    "stack": SettingsGenesis(preset="stack", timestep_s=1 / 900),
    # Genesis's defaults at the rate of the paper's rigid runs; only masses, shapes and friction come from the scene.
    "out_of_box": OUT_OF_BOX,
    # The paper states 180 Hz, and that all settings but the physical parameters are defaults.
    "paper": OUT_OF_BOX.model_copy(update={"preset": "paper"}),
}


def presets_for(scene: Scene) -> Mapping[str, SettingsGenesis]:
    """Return the presets of a scene by name. Scenes with deformable bodies have presets of their solvers."""
    return deformable_presets(scene) if scene.deformables else RIGID_PRESETS


def settings_for(scene: Scene, changes: Mapping[str, Any] | None = None) -> SettingsGenesis:
    """Return the settings of a scene: its preset with a user's changes.

    Raises:
        UnknownNameError: The preset does not exist.
        ParameterError: A setting does not exist or has an invalid value.
    """
    preset = "stack" if len(scene.dynamic_bodies) >= STACK_BODIES and not scene.deformables else "default"
    return resolve_settings("Genesis", presets_for(scene), preset=preset, changes=changes)
