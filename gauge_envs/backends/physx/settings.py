"""Numerical settings of the PhysX backend and their presets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from gauge_envs.backends.settings import Native, SteppedSettings, resolve_settings
from gauge_envs.scene import Scene

STACK_BODIES = 20
"""Number of dynamic bodies from which on a scene has the preset `stack`."""


class SettingsPhysX(SteppedSettings):
    """Settings of PhysX that SAPIEN exposes, and how this backend builds hinges and sustained contacts.

    Attributes:
        solver: `TGS` (temporal Gauss-Seidel, which divides a step among its position iterations) or `PGS` (projected
            Gauss-Seidel).
        position_iterations: Position iterations of each body, 1 to 255. PhysX takes the largest count among bodies that
            touch.
        velocity_iterations: Velocity iterations of each body, 0 to 255. They compute rebounds.
        bounce_threshold_m_per_s: Speed of approach below which a contact does not rebound.
        contact_offset_m: Distance at which a shape begins to make contacts; that of a pair is the sum of both.
        rest_offset_m: Distance at which a shape comes to rest; that of a pair is the sum of both.
        friction_every_iteration: Solve friction in each position iteration, and not in the last ones only.
        persistent_manifolds: Keep contact points from step to step (PCM) instead of new ones in each step.
        enhanced_determinism: Make the result of a scene independent of what else is far away in it.
        continuous_detection: Sweep fast bodies along their path. SAPIEN sets the flag of the scene only, not that of
            its bodies.
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
        hinges: `articulation` (reduced coordinates: the hinge cannot open) or `joint` (maximal coordinates: a
            constraint that the solver iterates).
        sustained_restitution: Give sustained contacts the scene's restitution too, instead of 0.
    """

    solver: Literal["TGS", "PGS"] = "TGS"
    position_iterations: Annotated[int, Native("solver_position_iterations")] = Field(default=10, ge=1, le=255)
    velocity_iterations: Annotated[int, Native("solver_velocity_iterations")] = Field(default=1, ge=0, le=255)
    bounce_threshold_m_per_s: Annotated[float, Native("bounce_threshold")] = Field(default=0.02, ge=0.0)
    contact_offset_m: Annotated[float, Native("contact_offset")] = Field(default=0.01, gt=0.0, le=1.0)
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


ISAAC = SettingsPhysX(
    preset="isaac",
    # Isaac Lab's own step is 1/60 s, which does not divide the 1/180 s of environments.
    timestep_s=1 / 180,
    # isaaclab/sim/simulation_cfg.py, PhysxCfg: solver_type 1, bounce_threshold_velocity 0.5, enable_ccd and
    # enable_enhanced_determinism off, friction_offset_threshold 0.04 and friction_correlation_distance 0.025, which
    # follow from a length scale of 1. An actor's iterations are clamped to 1..255 and 0..255.
    solver="TGS",
    bounce_threshold_m_per_s=0.5,
    continuous_detection=False,
    enhanced_determinism=False,
    tolerance_length_m=1.0,
    tolerance_speed_m_per_s=10.0,
    # omni/schema/source/physxSchema/schema.usda of NVIDIA-Omniverse/PhysX, which holds for what RigidBodyPropertiesCfg
    # leaves at None: PhysxRigidBodyAPI and PhysxSceneAPI (collisionSystem PCM).
    position_iterations=16,
    velocity_iterations=1,
    linear_damping_per_s=0.0,
    angular_damping_per_s=0.05,
    max_linear_velocity_m_per_s=1e16,
    max_angular_velocity_rad_per_s=100.0,
    max_depenetration_velocity_m_per_s=3.0,
    sleep_threshold_m2_per_s2=5e-5,
    persistent_manifolds=True,
    # PhysxCollisionAPI: no rest offset. Isaac Sim derives the contact offset of a shape from its extent, and gives
    # planes 0.02 m.
    rest_offset_m=0.0,
    contact_offset_m=0.02,
    patch_radius_m=0.0,
    min_patch_radius_m=0.0,
    # omni.physx/plugins/PhysXScene.cpp does not set PhysX's flag for it.
    friction_every_iteration=False,
    # A hinge of UsdPhysics outside an articulation.
    hinges="joint",
    sustained_restitution=True,
)

PRESETS: dict[str, SettingsPhysX] = {
    # Chosen on closed forms, not on scores. At 1/1800 s a slide on 30 degrees is within 0.002 % of g (sin - mu cos),
    # rebounds of 0.577 are within 0.2 %, a pendulum from 90 degrees gains 0.14 % of its energy in 100 s, a tumbling
    # brick turns wrongly by 2.0 degrees in half a second, and a carried cube creeps by 0.1 micrometres. At 1/180 s
    # these are 0.001 %, 1 %, 1.6 %, 19 degrees and 2.5 micrometres. At 1/3600 s the brick is at 0.9 degrees, but
    # single precision lets the carried cube creep by 13 micrometres, and at 1/9000 s by 85. TGS with 10 iterations:
    # PGS rebounds 8 to 15 % wrong at 1/180 s. The bounce threshold is four times the speed that a resting body gains
    # in a step, 5 mm/s. PhysX's angular damping and caps on speed are no physics of the scenes, and a body that falls
    # asleep stops, so all are off. Articulations keep hinges closed to 0.1 micrometres.
    "default": SettingsPhysX(preset="default", timestep_s=1 / 1800),
    # Many bodies: half the steps. A pile sinks by 0.2 micrometres, and a rebound of 0.5 is 0.4 % high.
    "stack": SettingsPhysX(preset="stack", timestep_s=1 / 900),
    # SAPIEN 3.0.3's values for what the scene does not state, at the rate of the paper's rigid runs.
    "out_of_box": SettingsPhysX(
        preset="out_of_box",
        timestep_s=1 / 180,
        bounce_threshold_m_per_s=2.0,
        angular_damping_per_s=0.05,
        link_linear_damping_per_s=0.05,
        max_angular_velocity_rad_per_s=100.0,
        sleep_threshold_m2_per_s2=0.005,
        hinges="joint",
        sustained_restitution=True,
    ),
    "isaac": ISAAC,
    # The paper states Isaac Sim 6.0 at 180 Hz, and that all settings but the physical parameters are defaults. The
    # schema's bounce threshold is 0.
    "paper": ISAAC.model_copy(update={"preset": "paper", "bounce_threshold_m_per_s": 0.0}),
}


def settings_for(scene: Scene, changes: Mapping[str, Any] | None = None) -> SettingsPhysX:
    """Return the settings of a scene: its preset with a user's changes."""
    preset = "stack" if len(scene.dynamic_bodies) >= STACK_BODIES else "default"
    return resolve_settings("PhysX", PRESETS, preset=preset, changes=changes)
