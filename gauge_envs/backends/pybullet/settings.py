"""Numerical settings of the PyBullet backend: its presets and the choice of a preset for a scene.

The content of a scene determines its preset; scores have no influence. The presets are in
`presets.toml`, each with the reasons for its numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import ceil, log2, sqrt
from typing import Any, Literal

from pydantic import Field, ValidationInfo, field_validator

from gauge_envs.backends.pybullet.contacts import colliding_pairs
from gauge_envs.backends.settings import (
    STACK_BODY_COUNT,
    SteppedSettings,
    load_presets,
    resolve_settings,
)
from gauge_envs.backends.shared.cells import CellSize, check_cells
from gauge_envs.backends.shared.soft_rows import lame_constants
from gauge_envs.scene import ContactMode, Scene, SoftBody

SOFT_CELL_M = 1.0 / 60.0
"""Default edge of the cells of a soft body, of six tetrahedra each [m]."""

STABLE_SHARE = 0.6
"""Largest step of soft bodies over the time of a wave through a tetrahedron.

Foam at rest is stable at 0.7 and diverges at 1.1. Compressed tetrahedra need shorter steps.
"""

NODE_LIMIT = 20_000
"""Largest number of nodes of a soft body; larger ones take minutes for a simulated second."""

SEGMENT_LIMIT = 27
"""Largest number of segments of a rope. PyBullet holds 128 coordinates of a chain, and a segment has 4."""


class SettingsPyBullet(SteppedSettings):
    """Settings of one PyBullet simulation. The defaults are the preset `contact`.

    Lengths and speeds named in units are in Bullet's unit of length, which `units_per_m` defines.

    Attributes:
        units_per_m: Bullet's units of length in one metre. Its margins, slop and thresholds are absolute numbers for
            bodies of about one unit: convex hulls are larger than the scene's solids by a margin of 0.001 units.
        solver_iterations: Largest number of iterations of the solver in one step.
        residual_threshold: Squared residual at which the solver stops before its last iteration.
        erp: Share of a position error of a joint's limit, such as a string's length, that one step corrects.
        contact_erp: Share of a penetration that one step corrects.
        friction_erp: Share of a slip that one step corrects, used with `friction_anchors`.
        global_cfm: Softness of all constraints.
        warm_starting: Share of the last step's contact impulses with which the solver starts.
        cone_friction: Couple the two directions of friction in a cone; otherwise each has its own limit. Bullet does
            this in contacts with a body in reduced coordinates. Fixed and driven bodies therefore use them if two or
            more touch one dynamic body without a rebound.
        friction_anchors: Hold a resting contact at its first point.
        split_impulse: Penetrations that are corrected without a change of velocity: all, only those deeper than 0.04
            units, or none. Bodies in reduced coordinates, on joints or driven, are always corrected by velocity.
        rebound_threshold: Speed of approach in units per second below which bodies do not rebound.
        contact_slop: Penetration in units that is not corrected.
        contact_stiffness_n_per_m: Stiffness of the contacts of dynamic bodies, Bullet's `contactStiffness`; None for
            rigid contacts. Each contact point is such a spring. It needs `contact_damping_n_s_per_m` and
            `split_impulse` `none`. Bullet adds a rebound by restitution to the rebound of the spring.
        contact_damping_n_s_per_m: Damping of the same springs, Bullet's `contactDamping`.
        late_impacts: Start an impact when the bodies overlap. Otherwise Bullet brakes them shortly before they touch,
            and restitution then acts on the braked speed.
        planes: Shape of planes: Bullet's plane, or a box of 16 m, on which more contact points are found.
        polyhedral_features: Collide boxes and convex hulls face by face, with all contact points at once.
        reduced_coordinates: Simulate free bodies by Featherstone's algorithm, as PyBullet does by default.
        island_size: Smallest number of constraints that the solver takes together.
        linear_damping: Bullet's damping of velocities; a body loses about this share in 1 s.
        angular_damping: Bullet's damping of angular velocities; a body loses about this share in 1 s.
        sleeping: Stop simulating bodies at rest.
        cell_m: Desired edge of the cells of a soft body, of six tetrahedra each, and length of the segments of a rope
            [m]. None gives cells of 16.7 mm and segments of 12.5 mm, longer ones for a rope of more than 0.34 m. A rope
            has at most 27 segments, because PyBullet holds 128 coordinates of a chain.
    """

    units_per_m: float = Field(default=100.0, gt=0.0)
    solver_iterations: int = Field(default=50, ge=1)
    residual_threshold: float = Field(default=0.0, ge=0.0)
    erp: float = Field(default=0.2, ge=0.0, le=1.0)
    contact_erp: float = Field(default=0.2, ge=0.0, le=1.0)
    friction_erp: float = Field(default=0.2, ge=0.0, le=1.0)
    global_cfm: float = Field(default=0.0, ge=0.0)
    warm_starting: float = Field(default=1.0, ge=0.0, le=1.0)
    cone_friction: bool = True
    friction_anchors: bool = False
    split_impulse: Literal["all", "deep", "none"] = "all"
    rebound_threshold: float = Field(default=0.0, ge=0.0)
    contact_slop: float = Field(default=1e-5, ge=0.0)
    contact_stiffness_n_per_m: float | None = Field(default=None, gt=0.0)
    contact_damping_n_s_per_m: float | None = Field(default=None, gt=0.0)
    late_impacts: bool = True
    planes: Literal["box", "plane"] = "box"
    polyhedral_features: bool = True
    reduced_coordinates: bool = False
    island_size: int = Field(default=1, ge=0)
    linear_damping: float = Field(default=0.0, ge=0.0, le=1.0)
    angular_damping: float = Field(default=0.0, ge=0.0, le=1.0)
    sleeping: bool = False
    cell_m: CellSize = None

    @field_validator("contact_damping_n_s_per_m")
    @classmethod
    def _springs_act(cls, damping: float | None, info: ValidationInfo) -> float | None:
        # An invalid stiffness or split impulse is not in the data; its own error is reported first.
        stiffness = info.data.get("contact_stiffness_n_per_m")
        if "contact_stiffness_n_per_m" in info.data and (damping is None) != (
            stiffness is None
        ):
            raise ValueError(
                "contact_stiffness_n_per_m and this must be given together"
            )
        if stiffness is not None and info.data.get("split_impulse", "none") != "none":
            raise ValueError(
                "split_impulse must be 'none' with it: split impulses exert no force"
            )
        return damping


PRESETS = load_presets(SettingsPyBullet, __file__)


def settings_for(
    scene: Scene, changes: Mapping[str, Any] | None = None
) -> SettingsPyBullet:
    """Return the settings for a scene, with a user's changes; see `resolve_settings`."""
    preset = _preset_for(scene)
    settings = resolve_settings("pybullet", PRESETS, preset=preset, changes=changes)
    if settings.preset == "soft" and "timestep_s" not in (changes or {}):
        limit_s = STABLE_SHARE * _wave_time_s(scene, settings.cell_m or SOFT_CELL_M)
        halvings = max(0, ceil(log2(settings.timestep_s / limit_s)))
        settings = settings.model_copy(
            update={"timestep_s": settings.timestep_s / 2**halvings}
        )
    if settings.cell_m is not None:
        limit = NODE_LIMIT if scene.has(SoftBody) else SEGMENT_LIMIT + 1
        check_cells("pybullet", scene, settings.cell_m, node_limit=limit)
    return settings


def _preset_for(scene: Scene) -> str:
    if len(scene.dynamic_bodies) >= STACK_BODY_COUNT:
        return "stack"
    if scene.has(SoftBody):
        return "soft"
    if scene.deformables:
        return "rope"
    jointed = {joint.body for joint in scene.joints}
    for contact, pair in colliding_pairs(scene):
        if contact.mode is ContactMode.IMPACT and jointed & set(pair):
            return "joint_impact"
    return "contact"


def _wave_time_s(scene: Scene, cell_m: float) -> float:
    """Return the shortest time of a pressure wave through a tetrahedron of a soft body [s].

    The height of a tetrahedron is the edge of its cell over the square root of 2.
    """
    speeds = []
    for body in scene.deformables:
        if isinstance(body, SoftBody):
            shear_pa, lame_pa = lame_constants(body)
            modulus_pa = lame_pa + 2.0 * shear_pa
            speeds.append(sqrt(modulus_pa * body.shape.volume_m3 / body.mass_kg))
    return cell_m / (sqrt(2.0) * max(speeds, default=1.0))
