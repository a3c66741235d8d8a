"""Numerical settings of the Drake backend: its presets and the choice of a preset for a scene.

The content of a scene determines its preset; scores have no influence. The presets are in
`presets.toml`, each with the reasons for its numbers, measured on closed forms.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field

from gauge_envs.backends.settings import (
    STACK_BODY_COUNT,
    SteppedSettings,
    load_presets,
    resolve_settings,
)
from gauge_envs.backends.shared.spring_damper import impact_speed_m_per_s
from gauge_envs.scene import (
    Box,
    ContactMode,
    ConvexUnion,
    Cylinder,
    Motion,
    Plane,
    Scene,
    Sphere,
)


class SettingsDrake(SteppedSettings):
    """Settings of one Drake simulation.

    A *rate* is the natural frequency of two bodies on their contact spring times the time step. It fixes the stiffness
    of point contact, and the modulus of hydroelastic contact on the largest face of a body.

    Attributes:
        approximation: Discrete approximation of contact, under Drake's name. `tamsi`, `similar` and `lagged` have
            Hunt-Crossley dissipation; `sap` has a linear one.
        contact_model: `hydroelastic` gives flat faces a contact surface, and spheres a contact point. `point` gives a
            pair of shapes one contact point, and each corner of a polyhedron another.
        surface: Representation of hydroelastic contact surfaces. `triangle` has more contact points than `polygon`,
            Drake's default.
        drake_material: Use Drake's defaults for all contact constants except friction. Contacts are then points
            without points at corners, and the scene's restitution has no effect.
        sustained_rate: Rate of sustained contacts.
        sustained_dissipation_s_per_m: Hunt-Crossley dissipation of sustained contacts. The outgoing speed is at most
            its inverse.
        sustained_relaxation_steps: Relaxation time of sustained contacts in steps, for `sap`.
        impact_rate: Rate of impacts. It is reduced where the time integration alone dissipates more than the
            restitution of the contact.
        impact_speed_m_per_s: Normal speed at which impacts have the scene's restitution, for Hunt-Crossley dissipation.
            None gives the largest speed of the scene's falls, initial states and prescribed motions. Slower impacts
            rebound more.
        stiction_speed_m_per_s: Sliding speed below which friction decreases to zero; bodies at rest creep with less.
        near_rigid_threshold: Drake's bound on the stiffness of `sap`.
        driven_mass_ratio: Mass of a driven body over that of all dynamic bodies. Its velocity is written in each step,
            so that contacts slow it within one step only. With a larger mass, Drake's solver neglects the light bodies.
        tether_rate: Natural frequency of a body on its taut string times the time step. The string is a spring with
            critical damping that this package applies in each step.
    """

    approximation: Literal["tamsi", "sap", "similar", "lagged"] = "lagged"
    contact_model: Literal["point", "hydroelastic"] = "hydroelastic"
    surface: Literal["polygon", "triangle"] = "triangle"
    drake_material: bool = False
    sustained_rate: float = Field(default=1.0, gt=0.0, le=100.0)
    sustained_dissipation_s_per_m: float = Field(default=20.0, ge=0.0)
    sustained_relaxation_steps: float = Field(default=1.0, ge=0.0)
    impact_rate: float = Field(default=0.1, ge=1e-3, le=1.0)
    impact_speed_m_per_s: float | None = Field(default=None, gt=0.0)
    stiction_speed_m_per_s: float = Field(default=1e-4, gt=0.0)
    near_rigid_threshold: float = Field(default=1.0, ge=0.0)
    driven_mass_ratio: float = Field(default=1e3, ge=1.0, le=1e9)
    tether_rate: float = Field(default=0.2, gt=0.0, le=1.0)


PRESETS = load_presets(SettingsDrake, __file__)


def settings_for(
    scene: Scene, changes: Mapping[str, Any] | None = None
) -> SettingsDrake:
    """Return the settings of a scene: its preset with a user's changes."""
    settings = resolve_settings(
        "Drake", PRESETS, preset=_preset_name(scene), changes=changes
    )
    speed = settings.impact_speed_m_per_s or impact_speed_m_per_s(scene)
    return settings.model_copy(update={"impact_speed_m_per_s": speed})


def _preset_name(scene: Scene) -> str:
    if not scene.contacts:
        return "contact_free"
    if len(scene.dynamic_bodies) >= STACK_BODY_COUNT:
        return "stack"
    shapes = [body.shape for body in scene.dynamic_bodies]
    if all(isinstance(shape, Sphere) for shape in shapes):
        modes = {contact.mode for contact in scene.contacts}
        if scene.has_impact_chain:
            return "impact_chain"
        return "impact" if ContactMode.IMPACT in modes else "default"
    if any(isinstance(shape, Cylinder) for shape in shapes):
        return "rolling"
    return "corners" if _strikes_planes_alone(scene) else "default"


def _strikes_planes_alone(scene: Scene) -> bool:
    """Return whether every contact is an impact of dynamic polyhedra on planes."""
    for contact in scene.contacts:
        for pair in scene.colliding_pairs(contact):
            bodies = [scene.body(name) for name in pair]
            has_plane = any(isinstance(body.shape, Plane) for body in bodies)
            has_polyhedron = any(
                isinstance(body.shape, Box | ConvexUnion)
                and body.motion is Motion.DYNAMIC
                for body in bodies
            )
            is_impact = contact.mode is ContactMode.IMPACT
            if not (is_impact and has_plane and has_polyhedron):
                return False
    return True
