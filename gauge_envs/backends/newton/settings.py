"""Numerical settings of the Newton backend: the presets, and which preset a scene gets.

Newton has many solvers, and each has its own settings. A preset names its solver; it is picked from what the scene
contains, never from how well it scores.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from pydantic import Field

from gauge_envs.backends.newton.stability import longest_timestep_s
from gauge_envs.backends.settings import SteppedSettings, resolve_settings
from gauge_envs.backends.shared.attachments import bonded_rows
from gauge_envs.scene import Cloth, Motion, Rod, Rope, Scene, SoftBody

__all__ = [
    "PRESETS",
    "SettingsLines",
    "SettingsMPM",
    "SettingsMuJoCoWarp",
    "SettingsNewton",
    "SettingsVBD",
    "settings_for",
]


class SettingsNewton(SteppedSettings):
    """Settings that every solver has.

    Attributes:
        solver: Newton's name of the solver.
        device: Where it runs: `cpu`, `cuda:0`, ...
    """

    solver: str
    device: str = "cpu"


class SettingsMuJoCoWarp(SettingsNewton):
    """Settings of Newton's MuJoCo solver, MuJoCo Warp in single precision.

    Attributes:
        integrator: Its name of the integrator.
        cone: Friction cone.
        impratio: Ratio of frictional to normal constraint impedance; above 1 it keeps resting bodies from creeping.
        iterations: Cap on solver iterations.
        line_search_iterations: Cap on iterations of each line search.
        tolerance: Solver tolerance.
        sustained_solref: Time constant [s] and damping ratio of sustained contacts.
        sustained_solimp: Impedance of sustained contacts: d0, dwidth, width [m].
        impact_stiffness: Dimensionless stiffness s of impacts, as in the MuJoCo backend: the direct solref of a pair is
            (-s/h^2, -(1+e)/h). Newton's own `restitution` has no effect in this solver.
        impact_solimp: Impedance of impacts; constant in depth, since the rebound would depend on depth otherwise.
        newton_material: Leave stiffness, damping and friction gain of contacts at Newton's own values, whatever the
            four settings above say; the scene's restitution then has no effect.
    """

    solver: Literal["SolverMuJoCo"] = "SolverMuJoCo"
    integrator: Literal["euler", "rk4", "implicitfast"] = "implicitfast"
    cone: Literal["pyramidal", "elliptic"] = "elliptic"
    impratio: float = Field(default=10.0, gt=0.0)
    iterations: int = Field(default=100, ge=1)
    line_search_iterations: int = Field(default=50, ge=1)
    tolerance: float = Field(default=1e-8, ge=0.0)
    sustained_solref: tuple[float, float] = (0.005, 1.0)
    sustained_solimp: tuple[float, float, float] = (0.95, 0.95, 0.001)
    impact_stiffness: float = Field(default=0.002, gt=0.0)
    impact_solimp: tuple[float, float, float] = (0.99, 0.99, 0.001)
    newton_material: bool = False


class SettingsVBD(SettingsNewton):
    """Settings of Newton's vertex block descent, for cloth and soft bodies.

    Attributes:
        iterations: Descents over all vertices in a step. What is left of the error is a stiffness that is too low.
        starts_from_acceleration: Start each step where the last one's acceleration leads, and not in free fall as
            Newton does. The equations are the same, but a third of the iterations are enough; with Newton's own start
            a hanging strip of rayon stretches by 22 % too much at 1440 Hz and 5 iterations.
        cloth_cell_m: Wanted edge length of a cloth's cells.
        soft_cell_m: Largest edge length of a soft body's cells, each of five tetrahedra. At 12.5 mm, a quarter of the
            benchmark's foam, a bar is 1 % too stiff in tension, 14 % in shear and 28 % in torsion.
        stretch_damping_n_s_per_m: Viscosity of a cloth's membrane, Newton's `tri_kd`. Its default, 10, is that of a
            cloth in honey; the implicit step damps enough.
        bend_damping_n_s: Viscosity of a cloth's hinges, Newton's `edge_kd`.
        soft_damping_s: Viscosity of a soft body, as the time by which it multiplies the rate of strain.
        soft_rigid_ratio: A block this many times as stiff as the softest that it is bonded to in a row, and in no grip,
            is a rigid body: elastic, it would hardly move for a hundred times the steps. The row bends less by the
            ratio's inverse. Infinity makes all elastic.
        soft_contact_radius_m: Distance from a node of a soft body at which what touches it is held.
        contact_per_stretch: Penalty of a cloth's contacts over its stretch stiffness: stiff enough that the cloth
            yields before it sinks in, by 0.04 mm where a probe stretches it by 2 %, and soft enough for few iterations.
        soft_contact_stiffness_n_per_m: Penalty of a soft body's contacts. At 1e3 a cube sinks in by millimetres, at 1e5
            nodes at its edge are thrown aside.
        contact_damping_n_s_per_m: Damping of contacts. Newton counts it to the normal force but not to the load of
            friction, so a cube on a slope slides too far with it.
        contact_gap_m: Distance from a shape at which a contact is found; more than anything goes in a step.
        full_surface: Let edges and faces of a mesh collide with shapes, and not its vertices alone: needed where
            something is narrower than the cells, or rests on the cloth.
        friction_speed_m_per_s: Speed of sliding from which friction is Coulomb's; below, it falls to zero.
        self_contact_thickness_m: Distance at which surfaces start to push each other apart.
        self_contact_reach_m: Further distance at which pairs are found. Newton cuts every motion in a step to 0.425 of
            both together.
    """

    solver: Literal["SolverVBD"] = "SolverVBD"
    iterations: int = Field(default=3, ge=1)
    starts_from_acceleration: bool = True
    cloth_cell_m: float = Field(default=0.025, gt=0.0)
    soft_cell_m: float = Field(default=0.0125, gt=0.0)
    stretch_damping_n_s_per_m: float = Field(default=0.0, ge=0.0)
    bend_damping_n_s: float = Field(default=0.0, ge=0.0)
    soft_damping_s: float = Field(default=0.0, ge=0.0)
    soft_rigid_ratio: float = Field(default=50.0, gt=1.0)
    soft_contact_radius_m: float = Field(default=0.001, gt=0.0)
    soft_contact_stiffness_n_per_m: float = Field(default=1e4, gt=0.0)
    contact_per_stretch: float = Field(default=5.0, gt=0.0)
    contact_damping_n_s_per_m: float = Field(default=0.0, ge=0.0)
    contact_gap_m: float = Field(default=0.002, gt=0.0)
    full_surface: bool = False
    friction_speed_m_per_s: float = Field(default=1e-4, gt=0.0)
    self_contact_thickness_m: float = Field(default=0.002, gt=0.0)
    self_contact_reach_m: float = Field(default=0.008, gt=0.0)


class SettingsLines(SettingsNewton):
    """Settings of Newton's vertex block descent for ropes and rods, which are chains of rigid bodies there.

    Attributes:
        iterations: Descents over all bodies in a step.
        rod_segments: Segments of a rod; a load at its end bends it by 1 part in 2 n^2 too much.
        rod_damping_s: Viscosity of a rod in bending and twist, as the time by which it multiplies its rate.
        rope_segment_m: Wanted length of a rope's segments.
        rod_joint_stiffness_n_per_m: Largest springs that hold the ends of a rod's segments together, lengthwise and
            across; E A over the length of a segment where that is less. Stiffer ones need more digits than single
            precision has, and more iterations.
        rope_strain: Stretch of a rope by its weight and that of the heaviest body at its ends. Springs that are stiffer
            than loads ask for make noise in single precision, which adds to friction: a rope of 5 g with springs of
            1e5 N/m slides down a slope of 30 degrees with a friction of 0.5 for 0.3.
        contact_depth_m: Depth to which the same weight sinks in at a single contact; the same noise limits it.
        contact_damping_n_s_per_m: Damping of a contact that closes.
        friction_speed_m_per_s: Speed of sliding that Newton takes as small when it linearizes friction.
    """

    solver: Literal["SolverVBD"] = "SolverVBD"
    iterations: int = Field(default=40, ge=1)
    rod_segments: int = Field(default=8, ge=2)
    rod_damping_s: float = Field(default=0.0, ge=0.0)
    rope_segment_m: float = Field(default=0.01, gt=0.0)
    rod_joint_stiffness_n_per_m: float = Field(default=2e5, gt=0.0)
    rope_strain: float = Field(default=1e-3, gt=0.0)
    contact_depth_m: float = Field(default=1.5e-6, gt=0.0)
    contact_damping_n_s_per_m: float = Field(default=0.0, ge=0.0)
    friction_speed_m_per_s: float = Field(default=1e-4, gt=0.0)


class SettingsMPM(SettingsNewton):
    """Settings of Newton's implicit material point method, for soft bodies.

    Attributes:
        voxel_m: Wanted edge of a voxel; the one nearby that puts grid planes where the grips end is used, since a
            gripped point makes all of its voxel rigid.
        points_per_voxel_edge: Material points along the edge of a voxel.
        iterations: Cap on the iterations of the stress solver.
        tolerance: Residual at which it stops.
        integration_scheme: `gimp`, points that fill their cell: stress within 1 to 5 % of theory, but a twist of 90
            degrees diverges. `pic`, points: survives it, and hides motion inside a voxel.
        soft_damping_s: Relaxation time of the elastic stress, Newton's `mpm:damping`.
    """

    solver: Literal["SolverImplicitMPM"] = "SolverImplicitMPM"
    voxel_m: float = Field(default=0.018, gt=0.0)
    points_per_voxel_edge: int = Field(default=2, ge=1)
    iterations: int = Field(default=250, ge=1)
    tolerance: float = Field(default=1e-4, gt=0.0)
    integration_scheme: Literal["gimp", "pic"] = "gimp"
    soft_damping_s: float = Field(default=0.0, ge=0.0)


PRESETS: dict[str, SettingsNewton] = {
    # Chosen on closed forms, not on scores. The angular momentum of a tumbling brick drifts by 0.7 % in half a second,
    # in proportion to the step. A carried body creeps by omega^2 r times half the contact's time constant, as in
    # MuJoCo; a shorter one lets sliding cubes hop higher.
    "rigid": SettingsMuJoCoWarp(preset="rigid", timestep_s=1 / 3600),
    # Newton as it comes, at the rate of the paper's rigid runs; only masses, shapes and friction are the scene's.
    "out_of_box": SettingsMuJoCoWarp(
        preset="out_of_box", timestep_s=1 / 180, cone="pyramidal", impratio=1.0, newton_material=True
    ),
    "impact_chain": SettingsMuJoCoWarp(
        preset="impact_chain", timestep_s=1 / 9000, impact_solimp=(0.9999, 0.9999, 0.001)
    ),
    "contact_free": SettingsMuJoCoWarp(preset="contact_free", timestep_s=1 / 1800, integrator="rk4"),
    # Cloth. Chosen by convergence: over 2 s of a fling, paths are within 0.4 mm of those with twice the rate and three
    # times the iterations, and elastic extensions within 1 % of theory.
    "cloth": SettingsVBD(preset="cloth", timestep_s=1 / 1440),
    # Something narrow pushes into the cloth: several contacts of a face share its load, and friction needs more
    # iterations to come right.
    "cloth_probed": SettingsVBD(preset="cloth_probed", timestep_s=1 / 1440, iterations=5, full_surface=True),
    # Bodies rest on the cloth: with 3, 5 and 10 iterations their friction is 12, 5 and 0.4 % too low.
    "cloth_loaded": SettingsVBD(preset="cloth_loaded", timestep_s=1 / 1440, iterations=10, full_surface=True),
    "cloth_fine": SettingsVBD(preset="cloth_fine", timestep_s=1 / 2880, iterations=10),
    # The paper's rate with Newton's own start of a step.
    "cloth_180hz": SettingsVBD(preset="cloth_180hz", timestep_s=1 / 180, iterations=10, starts_from_acceleration=False),
    # Foam. Short steps with few iterations: at the same cost, 900 Hz with 10 leaves five times the error.
    "soft": SettingsVBD(
        preset="soft",
        timestep_s=1 / 3600,
        starts_from_acceleration=False,
        full_surface=True,
        contact_gap_m=0.005,
    ),
    "soft_fine": SettingsVBD(
        preset="soft_fine",
        timestep_s=1 / 3600,
        iterations=6,
        starts_from_acceleration=False,
        soft_cell_m=0.0125 / 1.5,
        full_surface=True,
        contact_gap_m=0.005,
    ),
    # Bonded blocks, of which some may touch what others pass through: vertices alone collide. A row of foam and rubber
    # swings at 2.50 Hz with these, at 2.59 with cells of 12.5 mm, at 2.53 with half the step and at 2.49 with that and
    # cells of 6.25 mm. Steps below 0.1 ms are no better: single precision then damps it.
    "soft_row": SettingsVBD(
        preset="soft_row",
        timestep_s=1 / 3600,
        starts_from_acceleration=False,
        soft_cell_m=0.0125 / 1.5,
        contact_gap_m=0.005,
    ),
    # Single precision limits a rod: springs ten times as stiff, or steps a quarter as long, come near to the last digit
    # of its places. The iterations are what a rod of 1 GPa needs; one of 10 MPa is the same within 0.1 % with 10.
    "rod": SettingsLines(preset="rod", timestep_s=1 / 3600),
    # With a ball of 60 times the rope's weight a swing from level gains 0.4 % of its energy; with half of the
    # iterations 1 %, and with a third of the strain at half the rate 9 %.
    "rope": SettingsLines(preset="rope", timestep_s=1 / 7200, iterations=20, contact_depth_m=3e-5),
    # The paper's solver for foam, at a fifth of its rate of 900 Hz, and at all of it: 20 and 70 s a simulated second.
    "mpm": SettingsMPM(preset="mpm", timestep_s=1 / 180),
    "mpm_full": SettingsMPM(preset="mpm_full", timestep_s=1 / 900),
}


def _preset_name(scene: Scene) -> str:
    if any(isinstance(body, Cloth) for body in scene.deformables):
        return _cloth_preset(scene)
    if any(isinstance(body, SoftBody) for body in scene.deformables):
        return "soft_row" if any(len(row) > 1 for row in bonded_rows(scene)) else "soft"
    if any(isinstance(body, Rope) for body in scene.deformables):
        return "rope"
    if any(isinstance(body, Rod) for body in scene.deformables):
        return "rod"
    if not scene.contacts:
        return "contact_free"
    return "impact_chain" if scene.has_impact_chain else "rigid"


def _cloth_preset(scene: Scene) -> str:
    cloths = {body.name for body in scene.deformables if isinstance(body, Cloth)}
    seams = {attachment.to for attachment in scene.attachments}
    touched = (
        {name for c in scene.contacts if cloths & {*c.first, *c.second} for name in (*c.first, *c.second)}
        - cloths
        - seams
    )
    bodies = [scene.body(name) for name in touched]
    if any(body.motion is Motion.DYNAMIC for body in bodies):
        return "cloth_loaded"
    cell_m = SettingsVBD.model_fields["cloth_cell_m"].default
    narrow = any(
        float(np.ptp(b.shape.corners_m, axis=0).min()) < cell_m for b in bodies if b.motion is Motion.KINEMATIC
    )
    return "cloth_probed" if narrow else "cloth"


def settings_for(scene: Scene, changes: Mapping[str, Any] | None = None) -> SettingsNewton:
    """Settings of a scene: its preset, with a user's changes put in.

    A stiff and light fabric needs shorter steps than its preset's for the same iterations: the step is halved until
    they are enough, unless the changes say how long it is.

    Raises:
        UnknownNameError: No such preset.
        ParameterError: No such setting, or an impossible value.
    """
    settings = resolve_settings("Newton", PRESETS, preset=_preset_name(scene), changes=changes)
    if isinstance(settings, SettingsVBD) and settings.starts_from_acceleration and "timestep_s" not in (changes or {}):
        cloths = [body for body in scene.deformables if isinstance(body, Cloth)]
        longest_s = min(
            (longest_timestep_s(c, cell_m=settings.cloth_cell_m, iterations=settings.iterations) for c in cloths),
            default=settings.timestep_s,
        )
        while settings.timestep_s > longest_s:
            settings = settings.model_copy(update={"timestep_s": 0.5 * settings.timestep_s})
    return settings
