"""Numerical settings of the PhysX backend and their presets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field, model_validator

from gauge_envs.backends.settings import (
    SteppedSettings,
    load_presets,
    resolve_settings,
)
from gauge_envs.scene import Scene

STACK_BODIES = 20
"""Smallest number of dynamic bodies of a scene with the preset `stack`."""


class SettingsPhysX(SteppedSettings):
    """Settings of PhysX that SAPIEN exposes, and how this backend builds hinges and sustained contacts.

    Attributes:
        solver: `TGS` (temporal Gauss-Seidel, which divides a step among its position iterations) or `PGS` (projected
            Gauss-Seidel).
        position_iterations: Position iterations of each body, 1 to 255. PhysX takes the largest count among bodies that
            touch.
        velocity_iterations: Velocity iterations of each body, 0 to 255. They compute rebounds.
        bounce_threshold_m_per_s: Speed of approach below which a contact does not rebound.
        contact_offset_m: Distance at which a shape begins to make contacts; a pair has the sum of both distances.
        rest_offset_m: Distance at which a shape comes to rest; a pair has the sum of both distances.
        friction_every_iteration: Solve friction in each position iteration, and not in the last ones only.
        persistent_manifolds: Keep contact points from step to step (PCM) instead of new ones in each step.
        enhanced_determinism: Make the result of a scene independent of distant bodies in it.
        continuous_detection: Sweep fast bodies along their path. SAPIEN sets the flag of the scene only, not the flags
            of its bodies.
        patch_radius_m: Radius of a contact patch that resists spin about the normal; 0 is no torsional friction.
        min_patch_radius_m: Smallest radius of that patch.
        linear_damping_per_s: Rate at which linear velocity decays.
        angular_damping_per_s: Rate at which angular velocity decays.
        link_linear_damping_per_s: Rate that is added for links of articulations. SAPIEN starts links with 0.05, and
            other bodies with 0.
        max_linear_velocity_m_per_s: Largest linear speed; faster bodies are slowed down.
        max_angular_velocity_rad_per_s: Largest angular speed; faster bodies are slowed down.
        max_depenetration_velocity_m_per_s: Largest speed with which overlapping bodies are pushed apart.
        sleep_threshold_m2_per_s2: Kinetic energy per mass below which a body may fall asleep; 0 keeps it awake.
        tolerance_length_m: Length scale of the engine. SAPIEN leaves PhysX's friction offset threshold at 0.04 and its
            friction correlation distance at 0.025 of it.
        tolerance_speed_m_per_s: Speed scale of the engine.
        hinges: `articulation` (reduced coordinates: the hinge cannot open) or `joint` (maximal coordinates:
            constraints that the solver iterates).
        sustained_restitution: Give sustained contacts the scene's restitution too, instead of 0.
    """

    solver: Literal["TGS", "PGS"] = "TGS"
    position_iterations: int = Field(default=10, ge=1, le=255)
    velocity_iterations: int = Field(default=1, ge=0, le=255)
    bounce_threshold_m_per_s: float = Field(default=0.02, ge=0.0)
    contact_offset_m: float = Field(default=0.01, gt=0.0, le=1.0)
    rest_offset_m: float = Field(default=0.0, ge=-0.1, le=1.0)
    friction_every_iteration: bool = True
    persistent_manifolds: bool = True
    enhanced_determinism: bool = False
    continuous_detection: bool = False
    patch_radius_m: float = Field(default=0.0, ge=0.0, le=1.0)
    min_patch_radius_m: float = Field(default=0.0, ge=0.0, le=1.0)
    linear_damping_per_s: float = Field(default=0.0, ge=0.0)
    angular_damping_per_s: float = Field(default=0.0, ge=0.0)
    link_linear_damping_per_s: float = Field(default=0.0, ge=0.0)
    max_linear_velocity_m_per_s: float = Field(default=1e16, gt=0.0, le=1e16)
    max_angular_velocity_rad_per_s: float = Field(default=1e6, gt=0.0, le=1e16)
    max_depenetration_velocity_m_per_s: float = Field(default=1e32, gt=0.0, le=1e32)
    sleep_threshold_m2_per_s2: float = Field(default=0.0, ge=0.0)
    tolerance_length_m: float = Field(default=0.1, gt=0.0, le=1e3)
    tolerance_speed_m_per_s: float = Field(default=0.2, gt=0.0, le=1e5)
    hinges: Literal["articulation", "joint"] = "articulation"
    sustained_restitution: bool = False

    @model_validator(mode="after")
    def _offsets_are_ordered(self) -> SettingsPhysX:
        if self.contact_offset_m <= self.rest_offset_m:
            raise ValueError("contact_offset_m must be larger than rest_offset_m")
        return self


PRESETS = load_presets(SettingsPhysX, __file__)


def settings_for(
    scene: Scene, changes: Mapping[str, Any] | None = None
) -> SettingsPhysX:
    """Return the settings of a scene: its preset with a user's changes."""
    preset = "stack" if len(scene.dynamic_bodies) >= STACK_BODIES else "default"
    return resolve_settings("PhysX", PRESETS, preset=preset, changes=changes)
