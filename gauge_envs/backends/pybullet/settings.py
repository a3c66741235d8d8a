"""Numerical settings of the PyBullet backend: its presets and the choice of a preset for a scene.

The content of a scene determines its preset; scores have no influence. A comment at each preset gives the rationale of
its numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field

from gauge_envs.backends.settings import SteppedSettings, resolve_settings
from gauge_envs.scene import ContactMode, Scene

__all__ = ["PRESETS", "SettingsPyBullet", "settings_for"]


class SettingsPyBullet(SteppedSettings):
    """Settings of one PyBullet simulation. The defaults are those of preset `contact`.

    Attributes:
        units_per_m: Bullet's units of length in one metre. Its margins, slop and thresholds are absolute numbers for
            bodies of about one unit.
        solver: Constraint solver: sequential impulses, or one of Bullet's solvers of a linear complementarity problem.
        solver_iterations: Largest number of iterations of the solver in one step.
        residual_threshold: Squared residual at which the solver stops before its last iteration.
        erp: Share of a joint's position error that one step corrects.
        contact_erp: Share of a penetration that one step corrects.
        friction_erp: Share of a slip that one step corrects, used with `friction_anchors`.
        global_cfm: Softness of all constraints.
        warm_starting: Share of the last step's contact impulses with which the solver starts.
        cone_friction: Couple the two directions of friction in a cone; otherwise each one has its own limit.
        friction_anchors: Hold a resting contact at its first point.
        split_impulse: Penetrations that are corrected without a change of velocity: all, only those deeper than 0.04
            units, or none. Bodies in reduced coordinates, on joints or driven, are always corrected by velocity.
        rebound_threshold: Speed of approach in units per second below which nothing rebounds.
        contact_slop: Penetration in units that is not corrected.
        late_impacts: Start an impact when the bodies overlap. Otherwise Bullet brakes them shortly before they touch,
            and restitution then acts on the braked speed.
        collision_margin: Collision margin of convex hulls in units; they are larger than the scene's solids by it.
        planes: Shape of planes: Bullet's plane, or a box larger than the scene, on which more contact points are found.
        polyhedral_features: Collide boxes and convex hulls face by face, with all contact points at once.
        reduced_coordinates: Simulate free bodies by Featherstone's algorithm, as PyBullet does by default.
        island_size: Smallest number of constraints that the solver takes together.
        linear_damping: Share of the velocity that a body loses in 1 s.
        angular_damping: Share of the angular velocity that a body loses in 1 s.
        sleeping: Stop simulating bodies at rest.
    """

    units_per_m: float = Field(default=100.0, gt=0.0)
    solver: Literal["sequential_impulse", "projected_gauss_seidel", "dantzig"] = "sequential_impulse"
    solver_iterations: int = Field(default=50, ge=1)
    residual_threshold: float = Field(default=0.0, ge=0.0)
    erp: float = Field(default=0.2, ge=0.0, le=1.0)
    contact_erp: float = Field(default=0.2, ge=0.0, le=1.0)
    friction_erp: float = Field(default=0.2, ge=0.0, le=1.0)
    global_cfm: float = Field(default=0.0, ge=0.0)
    warm_starting: float = Field(default=0.1, ge=0.0, le=1.0)
    cone_friction: bool = True
    friction_anchors: bool = False
    split_impulse: Literal["all", "deep", "none"] = "all"
    rebound_threshold: float = Field(default=0.0, ge=0.0)
    contact_slop: float = Field(default=1e-5, ge=0.0)
    late_impacts: bool = True
    collision_margin: float = Field(default=0.001, ge=0.0)
    planes: Literal["box", "plane"] = "box"
    polyhedral_features: bool = True
    reduced_coordinates: bool = False
    island_size: int = Field(default=1, ge=0)
    linear_damping: float = Field(default=0.0, ge=0.0, le=1.0)
    angular_damping: float = Field(default=0.0, ge=0.0, le=1.0)
    sleeping: bool = False


PRESETS: dict[str, SettingsPyBullet] = {
    "contact": SettingsPyBullet(preset="contact", timestep_s=1 / 1800),
    "out_of_box": SettingsPyBullet(
        preset="out_of_box",
        timestep_s=1 / 180,
        units_per_m=1.0,
        residual_threshold=1e-7,
        contact_erp=0.08,
        split_impulse="deep",
        planes="plane",
        rebound_threshold=0.2,
        late_impacts=False,
        polyhedral_features=False,
        reduced_coordinates=True,
        linear_damping=0.04,
        angular_damping=0.04,
    ),
}


def settings_for(scene: Scene, changes: Mapping[str, Any] | None = None) -> SettingsPyBullet:
    """Return the settings for a scene, with a user's changes; see `resolve_settings`."""
    return resolve_settings("pybullet", PRESETS, preset="contact", changes=changes)
