"""Conversion of scenes to one Newton model and its stepper, for each of Newton's solvers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import newton
import numpy as np
from newton.solvers import SolverImplicitMPM, SolverMuJoCo
from numpy.typing import NDArray

from gauge_envs.backends.newton.cloth import add_cloth
from gauge_envs.backends.newton.line import add_line
from gauge_envs.backends.newton.mpm import SoftPartMPM, StepperMPM, add_soft_mpm, fitted_voxel_m
from gauge_envs.backends.newton.mujoco import StepperMuJoCo, add_contacts, shape_config
from gauge_envs.backends.newton.pins import Pin
from gauge_envs.backends.newton.rigid import RigidIndex, add_bodies, keep_apart
from gauge_envs.backends.newton.settings import (
    CLOTH_CELL_M,
    ROD_SEGMENTS,
    ROPE_CELL_M,
    SOFT_CELL_M,
    VOXEL_M,
    SettingsLines,
    SettingsMPM,
    SettingsMuJoCoWarp,
    SettingsNewton,
    SettingsVBD,
)
from gauge_envs.backends.newton.soft import SoftPartNewton, add_block_shapes, add_soft
from gauge_envs.backends.newton.stepper import Stepper
from gauge_envs.backends.newton.surface import surface_contacts
from gauge_envs.backends.newton.vbd import SelfContact, StepperVBD, apply_contacts, passing_pairs
from gauge_envs.backends.shared.attachments import (
    RigidAttachment,
    attachments_by_body,
    bonded_soft_bodies,
    rigid_attachments,
)
from gauge_envs.scene import GRAVITY_M_PER_S2, Cloth, Motion, Pose, Rod, Rope, Scene, Vector
from gauge_envs.scene.geometry import vector


class Part(Protocol):
    """A deformable body or a soft row in a model."""

    @property
    def pins(self) -> tuple[Pin, ...]:
        """Particles that kinematic bodies hold."""

    def nodes(self, state: newton.State) -> NDArray[np.float64]:
        """Return the world positions of the nodes in a state [m], shape [node_count, 3]."""

    def track(self, points_m: NDArray[np.float64]) -> Callable[[newton.State], NDArray[np.float64]] | None:
        """Return a reader of material points, given by their start positions, or None if nodes are interpolated."""


@dataclass(frozen=True, kw_only=True)
class WorldLayout:
    """Location of one scene in a model.

    Attributes:
        rigid: Indices of its rigid bodies.
        origin_m: World position of the model's origin [m]. Single precision has more digits close to the origin: a
            spring of 1e5 N/m resolves forces to 6 mN at 1 m, and to 0.7 mN at 0.1 m.
        parts: Its deformable bodies, by name; bonded soft bodies share a part.
        node_indices: Indices of a body's nodes among those of its part, by name, if the part is a soft row.
        passing: Pairs of a particle and a shape that are excluded from collision, shape [pair_count, 2].
    """

    rigid: RigidIndex
    origin_m: Vector = (0.0, 0.0, 0.0)
    parts: dict[str, Part] = field(default_factory=dict)
    node_indices: dict[str, NDArray[np.intp]] = field(default_factory=dict)
    passing: NDArray[np.intp] = field(default_factory=lambda: np.zeros((0, 2), dtype=np.intp))

    def nodes(self, name: str, state: newton.State) -> NDArray[np.float64]:
        """Return the world positions of a deformable body's nodes in a state [m], shape [node_count, 3]."""
        nodes = self.parts[name].nodes(state) + self.origin_m
        return nodes[self.node_indices[name]] if name in self.node_indices else nodes

    def add_soft(self, soft: SoftPartNewton | SoftPartMPM) -> None:
        """Register a soft body or a soft row under the names of its bodies."""
        for name in soft.names:
            self.parts[name], self.node_indices[name] = soft, soft.block_nodes(name)


def build_model(scenes: Sequence[Scene], settings: SettingsNewton) -> tuple[Stepper, list[WorldLayout]]:
    """Build one model with a world for each scene, and record the step of its solver.

    Args:
        scenes: One or more scenes that differ only in their start poses and velocities.
        settings: Settings of the solver; their type selects the solver.

    Returns:
        The stepper at the start, and the layouts in the order of the scenes.
    """
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -scenes[0].gravity_m_per_s2))
    add = _scene_adder(builder, scenes[0], settings)
    layouts = []
    for scene in scenes:
        if len(scenes) > 1:
            builder.begin_world()
        layouts.append(add(scene))
        if len(scenes) > 1:
            builder.end_world()
    passing = np.concatenate([layout.passing for layout in layouts])
    if len(passing):
        # StepperVBD needs an inactive particle that replaces those of excluded pairs.
        builder.add_particle(pos=(0.0, 0.0, 0.0), vel=(0.0, 0.0, 0.0), mass=0.0, flags=0)
    if isinstance(settings, SettingsVBD | SettingsLines):
        builder.color(include_bending=True)
    model = builder.finalize(device=settings.device)
    driven = [
        layout.rigid.bodies[body.name]
        for scene, layout in zip(scenes, layouts, strict=True)
        for body in scene.bodies
        if body.motion is Motion.KINEMATIC
    ]
    pins = [pin for layout in layouts for part in _distinct(layout.parts) for pin in part.pins]
    stepper = _stepper(model, scenes[0], settings, driven=driven, pins=pins, passing=passing)
    stepper.record()
    return stepper, layouts


def _scene_adder(
    builder: newton.ModelBuilder, scene: Scene, settings: SettingsNewton
) -> Callable[[Scene], WorldLayout]:
    """Prepare a builder for a solver and return the function that adds a scene to the builder."""
    if isinstance(settings, SettingsMuJoCoWarp):
        SolverMuJoCo.register_custom_attributes(builder)
        return lambda added: _add_rigid_scene(builder, added, settings)
    if isinstance(settings, SettingsMPM):
        SolverImplicitMPM.register_custom_attributes(builder)
        spacing_m = _voxel_m(scene, settings) / settings.points_per_voxel_edge
        return lambda added: _add_mpm_scene(builder, added, settings, spacing_m)
    if isinstance(settings, SettingsLines):
        return lambda added: _add_line_scene(builder, added, settings)
    assert isinstance(settings, SettingsVBD)
    return lambda added: _add_vbd_scene(builder, added, settings)


def _add_rigid_scene(builder: newton.ModelBuilder, scene: Scene, settings: SettingsMuJoCoWarp) -> WorldLayout:
    rigid = add_bodies(builder, scene, config=shape_config(), solids="meshes" if settings.meshes else "prisms")
    add_contacts(builder, scene, rigid, settings)
    return WorldLayout(rigid=rigid)


def _add_vbd_scene(builder: newton.ModelBuilder, scene: Scene, settings: SettingsVBD) -> WorldLayout:
    rigid = add_bodies(builder, scene, config=newton.ModelBuilder.ShapeConfig(density=0.0))
    layout = WorldLayout(rigid=rigid)
    attachments = attachments_by_body(scene, scene.deformables)
    particles: dict[str, NDArray[np.intp]] = {}
    for body in scene.deformables:
        if isinstance(body, Cloth):
            cloth = add_cloth(
                builder,
                body,
                attachments=attachments[body.name],
                bodies=rigid.bodies,
                cell_m=settings.cell_m or CLOTH_CELL_M,
                stretch_damping_n_s_per_m=settings.stretch_damping_n_s_per_m,
                bend_damping_n_s=settings.bend_damping_n_s,
            )
            layout.parts[body.name] = cloth
            particles[body.name] = np.arange(cloth.particles.start, cloth.particles.stop)
    for bodies in bonded_soft_bodies(scene):
        soft = add_soft(
            builder,
            bodies,
            attachments=attachments,
            indices=rigid.bodies,
            cell_m=settings.cell_m or SOFT_CELL_M,
            damping_s=settings.soft_damping_s,
            contact_radius_m=settings.soft_contact_radius_m,
            rigid_ratio=settings.soft_rigid_ratio,
        )
        layout.add_soft(soft)
        particles |= {name: soft.block_particles(name) for name in soft.names}
        rigid.shapes.update(add_block_shapes(builder, soft, contact_radius_m=settings.soft_contact_radius_m))
    contacts = surface_contacts(scene, per_body=not settings.full_surface)
    apply_contacts(contacts, builder, rigid.shapes)
    keep_apart(builder, scene, rigid)
    return replace(layout, passing=passing_pairs(contacts, particles, rigid.shapes))


def _add_line_scene(builder: newton.ModelBuilder, scene: Scene, settings: SettingsLines) -> WorldLayout:
    lines = [body for body in scene.deformables if isinstance(body, Rope | Rod)]
    x, y, z = origin_m = vector(np.mean([line.pose.position_m for line in lines], axis=0))
    near = _moved(scene, (-x, -y, -z))
    rigid = add_bodies(builder, near, config=newton.ModelBuilder.ShapeConfig(density=0.0))
    layout = WorldLayout(rigid=rigid, origin_m=origin_m)
    for line in (body for body in near.deformables if isinstance(body, Rope | Rod)):
        attachments = rigid_attachments(near, line.name)
        part = layout.parts[line.name] = add_line(
            builder,
            line,
            attachments=attachments,
            bodies=rigid.bodies,
            segments=_segment_count(line, attachments, settings),
            joint_stiffness_n_per_m=_joint_stiffness_n_per_m(scene, line, settings),
            damping_s=settings.rod_damping_s,
            touches_itself=any({line.name} <= {*c.first} & {*c.second} for c in scene.contacts),
        )
        rigid.shapes[line.name] = list(part.shapes)
    apply_contacts(surface_contacts(scene), builder, rigid.shapes)
    keep_apart(builder, scene, rigid)
    return layout


def _segment_count(line: Rope | Rod, attachments: Sequence[RigidAttachment], settings: SettingsLines) -> int:
    """Return the number of segments outside the grips."""
    if isinstance(line, Rope):
        return max(2, round(line.length_m / (settings.cell_m or ROPE_CELL_M)))
    if settings.cell_m is None:
        return ROD_SEGMENTS
    free_m = line.length_m - sum(attachment.region.depth_m for attachment in attachments)
    return max(2, round(free_m / settings.cell_m))


def _joint_stiffness_n_per_m(scene: Scene, line: Rope | Rod, settings: SettingsLines) -> float:
    if isinstance(line, Rod):
        return settings.rod_joint_stiffness_n_per_m
    return _load_n(scene, line) * _segment_count(line, (), settings) / (settings.rope_strain * line.length_m)


def _load_n(scene: Scene, line: Rope | Rod) -> float:
    """Return the weight of a line and of the heaviest dynamic body at its ends, at standard gravity [N]."""
    attached = {attachment.to for attachment in scene.attachments if attachment.deformable == line.name}
    heaviest_kg = max((body.mass_kg for body in scene.dynamic_bodies if body.name in attached), default=0.0)
    return GRAVITY_M_PER_S2 * (line.mass_kg + heaviest_kg)


def _moved(scene: Scene, displacement_m: Vector) -> Scene:
    """Return the scene with displaced bodies and joints."""

    def moved(pose: Pose) -> Pose:
        return replace(pose, position_m=shifted(pose.position_m))

    def shifted(point_m: Vector) -> Vector:
        return vector(np.asarray(point_m) + displacement_m)

    return replace(
        scene,
        bodies=tuple(replace(body, pose=moved(body.pose)) for body in scene.bodies),
        deformables=tuple(replace(body, pose=moved(body.pose)) for body in scene.deformables),
        joints=tuple(replace(joint, anchor_m=shifted(joint.anchor_m)) for joint in scene.joints),
        body_hinges=tuple(replace(hinge, anchor_m=shifted(hinge.anchor_m)) for hinge in scene.body_hinges),
    )


def _add_mpm_scene(builder: newton.ModelBuilder, scene: Scene, settings: SettingsMPM, spacing_m: float) -> WorldLayout:
    rigid = add_bodies(builder, scene, config=newton.ModelBuilder.ShapeConfig(density=0.0))
    layout = WorldLayout(rigid=rigid)
    for bodies in bonded_soft_bodies(scene):
        soft = add_soft_mpm(
            builder,
            bodies,
            attachments=attachments_by_body(scene, bodies),
            indices=rigid.bodies,
            spacing_m=spacing_m,
            damping_s=settings.soft_damping_s,
        )
        layout.add_soft(soft)
    apply_contacts(surface_contacts(scene), builder, rigid.shapes)
    return layout


def _voxel_m(scene: Scene, settings: SettingsMPM) -> float:
    """Return the edge of the voxels [m], fitted to the grips of the first soft row; all rows share one grid."""
    bodies = bonded_soft_bodies(scene)[0]
    return fitted_voxel_m(
        bodies,
        attachments=attachments_by_body(scene, bodies),
        voxel_m=settings.cell_m or VOXEL_M,
        points_per_voxel_edge=settings.points_per_voxel_edge,
    )


def _distinct(parts: dict[str, Part]) -> Iterator[Part]:
    return iter({id(part): part for part in parts.values()}.values())


def _stepper(
    model: newton.Model,
    scene: Scene,
    settings: SettingsNewton,
    *,
    driven: Sequence[int],
    pins: Sequence[Pin],
    passing: NDArray[np.intp],
) -> Stepper:
    if isinstance(settings, SettingsMuJoCoWarp):
        return StepperMuJoCo(model, driven=driven, settings=settings)
    given: dict[str, Any] = {"driven": driven, "pins": pins, "timestep_s": settings.timestep_s}
    if isinstance(settings, SettingsMPM):
        return StepperMPM(
            model,
            voxel_m=_voxel_m(scene, settings),
            iterations=settings.iterations,
            tolerance=settings.tolerance,
            integration_scheme=settings.integration_scheme,
            **given,
        )
    if isinstance(settings, SettingsLines):
        return StepperVBD(
            model,
            iterations=settings.iterations,
            contacts=surface_contacts(scene),
            contact_stiffness_n_per_m=max(
                _load_n(scene, line) / settings.contact_depth_m
                for line in scene.deformables
                if isinstance(line, Rope | Rod)
            ),
            contact_damping_n_s_per_m=settings.contact_damping_n_s_per_m,
            friction_speed_m_per_s=settings.friction_speed_m_per_s,
            **given,
        )
    assert isinstance(settings, SettingsVBD)
    cloths = [body for body in scene.deformables if isinstance(body, Cloth)]
    return StepperVBD(
        model,
        iterations=settings.iterations,
        predict=settings.starts_from_acceleration,
        contacts=surface_contacts(scene, per_body=not settings.full_surface),
        contact_stiffness_n_per_m=max(
            (settings.contact_per_stretch * cloth.stretch_stiffness_n_per_m for cloth in cloths),
            default=settings.soft_contact_stiffness_n_per_m,
        ),
        contact_damping_n_s_per_m=settings.contact_damping_n_s_per_m,
        contact_gap_m=settings.contact_gap_m,
        full_surface=settings.full_surface,
        passing=passing,
        friction_speed_m_per_s=settings.friction_speed_m_per_s,
        self_contact=SelfContact(thickness_m=settings.self_contact_thickness_m, reach_m=settings.self_contact_reach_m),
        **given,
    )
