"""Scenes -> one Newton model and the loop that steps it: what each solver takes."""

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
from gauge_envs.backends.newton.mpm import LoopMPM, add_soft_mpm, fitted_voxel_m
from gauge_envs.backends.newton.mujoco import LoopMuJoCo, add_contacts, shape_config
from gauge_envs.backends.newton.rigid import RigidIndex, add_bodies, keep_apart
from gauge_envs.backends.newton.settings import (
    SettingsLines,
    SettingsMPM,
    SettingsMuJoCoWarp,
    SettingsNewton,
    SettingsVBD,
)
from gauge_envs.backends.newton.soft import add_block_shapes, add_soft
from gauge_envs.backends.newton.stepper import Stepper
from gauge_envs.backends.newton.surface import surface_contacts
from gauge_envs.backends.newton.vbd import LoopVBD, Pin, SelfContact, apply_contacts, passing_pairs
from gauge_envs.backends.shared.attachments import bonded_rows, rigid_attachments
from gauge_envs.errors import ParameterError
from gauge_envs.scene import GRAVITY_M_PER_S2, Cloth, Motion, Pose, Rod, Rope, Scene

__all__ = [
    "WorldLayout",
    "Part",
    "build_model",
]

Vector = tuple[float, float, float]


class Part(Protocol):
    """A deformable body in a model, or several that are bonded."""

    @property
    def pins(self) -> tuple[Pin, ...]:
        """Particles that moving bodies hold."""

    def nodes(self, state: newton.State) -> NDArray[np.float64]:
        """World positions of the nodes in a state [m], shape [node_count, 3]."""

    def track(self, points_m: NDArray[np.float64]) -> Callable[[newton.State], NDArray[np.float64]] | None:
        """Reader of material points, given by where they are at the start; None where nodes must do."""


@dataclass(frozen=True, kw_only=True)
class WorldLayout:
    """Where one copy of a scene is in a model.

    Attributes:
        rigid: Its rigid bodies.
        origin_m: World point that is the origin of the model. Near what is stiff, single precision has more digits:
            springs of 1e5 N/m at 1 m from it have forces to 6 mN, and at 0.1 m to 0.7 mN.
        parts: Its deformable bodies, by name; bonded ones share a part.
        rows: Rows of the part's nodes that are a body's own, by name, where a part has several bodies.
        passing: Particles and shapes that do not collide although others of either do, shape [pair_count, 2].
    """

    rigid: RigidIndex
    origin_m: Vector = (0.0, 0.0, 0.0)
    parts: dict[str, Part] = field(default_factory=dict)
    rows: dict[str, NDArray[np.intp]] = field(default_factory=dict)
    passing: NDArray[np.intp] = field(default_factory=lambda: np.zeros((0, 2), dtype=np.intp))

    def nodes(self, name: str, state: newton.State) -> NDArray[np.float64]:
        """World positions of a deformable body's nodes in a state [m], shape [node_count, 3]."""
        nodes = self.parts[name].nodes(state) + self.origin_m
        return nodes[self.rows[name]] if name in self.rows else nodes


def build_model(scenes: Sequence[Scene], settings: SettingsNewton) -> tuple[Stepper, list[WorldLayout]]:
    """Put scenes into one model, a world each, and record the step of its solver.

    Args:
        scenes: One or more, alike but for the poses at the start.
        settings: Settings of the solver; their type picks it.

    Returns:
        The loop, standing at the start, and the copies in the order of the scenes.

    Raises:
        ParameterError: The preset is for other bodies than the scene has, or its settings cannot be stable.
    """
    _check_preset(scenes[0], settings)
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -scenes[0].gravity_m_per_s2))
    add = _scene_adder(builder, scenes[0], settings)
    copies = []
    for scene in scenes:
        if len(scenes) > 1:
            builder.begin_world()
        copies.append(add(scene))
        if len(scenes) > 1:
            builder.end_world()
    passing = np.concatenate([copy.passing for copy in copies])
    if len(passing):
        # One that collides with nothing and is in no element, for LoopVBD.
        builder.add_particle(pos=(0.0, 0.0, 0.0), vel=(0.0, 0.0, 0.0), mass=0.0, flags=0)
    if isinstance(settings, SettingsVBD | SettingsLines):
        builder.color(include_bending=True)
    model = builder.finalize(device=settings.device)
    driven = [
        copy.rigid.bodies[body.name]
        for scene, copy in zip(scenes, copies, strict=True)
        for body in scene.bodies
        if body.motion is Motion.KINEMATIC
    ]
    pins = [pin for copy in copies for part in _distinct(copy.parts) for pin in part.pins]
    loop = _loop(model, scenes[0], settings, driven=driven, pins=pins, passing=passing)
    loop.record()
    return loop, copies


def _check_preset(scene: Scene, settings: SettingsNewton) -> None:
    has_cloth = any(isinstance(body, Cloth) for body in scene.deformables)
    has_lines = any(isinstance(body, Rope | Rod) for body in scene.deformables)
    fits = {
        SettingsMuJoCoWarp: not scene.deformables,
        SettingsVBD: bool(scene.deformables) and not has_lines,
        SettingsLines: has_lines and all(isinstance(body, Rope | Rod) for body in scene.deformables),
        SettingsMPM: bool(scene.deformables) and not has_cloth and not has_lines,
    }
    if not fits[type(settings)]:
        kinds = sorted({type(body).__name__ for body in scene.deformables}) or ["rigid bodies alone"]
        raise ParameterError(
            f"Newton preset {settings.preset!r} is for {settings.solver}, which does not take {', '.join(kinds)} here"
        )


def _scene_adder(
    builder: newton.ModelBuilder, scene: Scene, settings: SettingsNewton
) -> Callable[[Scene], WorldLayout]:
    """What puts one copy of a scene into a builder; prepares the builder for it."""
    if isinstance(settings, SettingsMuJoCoWarp):
        SolverMuJoCo.register_custom_attributes(builder)
        return lambda copy: _add_rigid_scene(builder, copy, settings)
    if isinstance(settings, SettingsMPM):
        SolverImplicitMPM.register_custom_attributes(builder)
        spacing_m = _voxel_m(scene, settings) / settings.points_per_voxel_edge
        return lambda copy: _add_mpm_scene(builder, copy, settings, spacing_m)
    if isinstance(settings, SettingsLines):
        return lambda copy: _add_line_scene(builder, copy, settings)
    assert isinstance(settings, SettingsVBD)
    return lambda copy: _add_vbd_scene(builder, copy, settings)


def _add_rigid_scene(builder: newton.ModelBuilder, scene: Scene, settings: SettingsMuJoCoWarp) -> WorldLayout:
    rigid = add_bodies(builder, scene, config=shape_config(), has_prisms=True)
    add_contacts(builder, scene, rigid, settings)
    return WorldLayout(rigid=rigid)


def _add_vbd_scene(builder: newton.ModelBuilder, scene: Scene, settings: SettingsVBD) -> WorldLayout:
    config = newton.ModelBuilder.ShapeConfig(density=0.0)
    rigid = add_bodies(builder, scene, config=config)
    copy = WorldLayout(rigid=rigid)
    particles: dict[str, NDArray[np.intp]] = {}
    for body in scene.deformables:
        if isinstance(body, Cloth):
            cloth = add_cloth(
                builder,
                body,
                glued=rigid_attachments(scene, body.name),
                bodies=rigid.bodies,
                cell_m=settings.cloth_cell_m,
                stretch_damping_n_s_per_m=settings.stretch_damping_n_s_per_m,
                bend_damping_n_s=settings.bend_damping_n_s,
            )
            copy.parts[body.name] = cloth
            particles[body.name] = np.arange(cloth.particles.start, cloth.particles.stop)
    for row in bonded_rows(scene):
        soft = add_soft(
            builder,
            row,
            glued={body.name: rigid_attachments(scene, body.name) for body in row},
            indices=rigid.bodies,
            cell_m=settings.soft_cell_m,
            damping_s=settings.soft_damping_s,
            contact_radius_m=settings.soft_contact_radius_m,
            rigid_ratio=settings.soft_rigid_ratio,
        )
        for name in soft.names:
            copy.parts[name], copy.rows[name] = soft, soft.block_nodes(name)
            particles[name] = soft.block_particles(name)
        rigid.shapes.update(add_block_shapes(builder, soft, contact_radius_m=settings.soft_contact_radius_m))
    contacts = surface_contacts(scene, per_body=not settings.full_surface)
    apply_contacts(contacts, builder, rigid.shapes)
    keep_apart(builder, scene, rigid)
    return replace(copy, passing=passing_pairs(contacts, particles, rigid.shapes))


def _add_line_scene(builder: newton.ModelBuilder, scene: Scene, settings: SettingsLines) -> WorldLayout:
    lines = [body for body in scene.deformables if isinstance(body, Rope | Rod)]
    x, y, z = np.mean([line.pose.position_m for line in lines], axis=0).tolist()
    near = _moved(scene, (-x, -y, -z))
    rigid = add_bodies(builder, near, config=newton.ModelBuilder.ShapeConfig(density=0.0))
    copy = WorldLayout(rigid=rigid, origin_m=(x, y, z))
    for line in (body for body in near.deformables if isinstance(body, Rope | Rod)):
        part = copy.parts[line.name] = add_line(
            builder,
            line,
            glued=rigid_attachments(near, line.name),
            bodies=rigid.bodies,
            segments=_segment_count(line, settings),
            joint_stiffness_n_per_m=_joint_stiffness_n_per_m(scene, line, settings),
            damping_s=settings.rod_damping_s,
            touches_itself=any({line.name} <= {*c.first} & {*c.second} for c in scene.contacts),
        )
        rigid.shapes[line.name] = list(part.shapes)
    apply_contacts(surface_contacts(scene), builder, rigid.shapes)
    keep_apart(builder, scene, rigid)
    return copy


def _segment_count(line: Rope | Rod, settings: SettingsLines) -> int:
    return settings.rod_segments if isinstance(line, Rod) else max(2, round(line.length_m / settings.rope_segment_m))


def _joint_stiffness_n_per_m(scene: Scene, line: Rope | Rod, settings: SettingsLines) -> float:
    if isinstance(line, Rod):
        return settings.rod_joint_stiffness_n_per_m
    return _load_n(scene, line) * _segment_count(line, settings) / (settings.rope_strain * line.length_m)


def _load_n(scene: Scene, line: Rope | Rod) -> float:
    """Weight of a line and of the heaviest dynamic body at its ends, whatever the gravity of the scene [N]."""
    glued = {attachment.to for attachment in scene.attachments if attachment.deformable == line.name}
    heaviest_kg = max((body.mass_kg for body in scene.dynamic_bodies if body.name in glued), default=0.0)
    return GRAVITY_M_PER_S2 * (line.mass_kg + heaviest_kg)


def _moved(scene: Scene, way_m: Vector) -> Scene:
    """The scene's bodies and joints elsewhere."""

    def moved(pose: Pose) -> Pose:
        return replace(pose, position_m=shifted(pose.position_m))

    def shifted(point_m: Vector) -> Vector:
        x, y, z = (np.asarray(point_m) + way_m).tolist()
        return x, y, z

    return replace(
        scene,
        bodies=tuple(replace(body, pose=moved(body.pose)) for body in scene.bodies),
        deformables=tuple(replace(body, pose=moved(body.pose)) for body in scene.deformables),
        joints=tuple(replace(joint, anchor_m=shifted(joint.anchor_m)) for joint in scene.joints),
    )


def _add_mpm_scene(builder: newton.ModelBuilder, scene: Scene, settings: SettingsMPM, spacing_m: float) -> WorldLayout:
    rigid = add_bodies(builder, scene, config=newton.ModelBuilder.ShapeConfig(density=0.0))
    copy = WorldLayout(rigid=rigid)
    for row in bonded_rows(scene):
        soft = add_soft_mpm(
            builder,
            row,
            glued={body.name: rigid_attachments(scene, body.name) for body in row},
            indices=rigid.bodies,
            spacing_m=spacing_m,
            damping_s=settings.soft_damping_s,
        )
        for name in soft.names:
            copy.parts[name], copy.rows[name] = soft, soft.block_nodes(name)
    apply_contacts(surface_contacts(scene), builder, rigid.shapes)
    return copy


def _voxel_m(scene: Scene, settings: SettingsMPM) -> float:
    """Edge of a voxel that suits the grips of the first row [m]; one grid serves all."""
    row = bonded_rows(scene)[0]
    return fitted_voxel_m(
        row,
        glued={body.name: rigid_attachments(scene, body.name) for body in row},
        voxel_m=settings.voxel_m,
        points_per_voxel_edge=settings.points_per_voxel_edge,
    )


def _distinct(parts: dict[str, Part]) -> Iterator[Part]:
    return iter({id(part): part for part in parts.values()}.values())


def _loop(
    model: newton.Model,
    scene: Scene,
    settings: SettingsNewton,
    *,
    driven: Sequence[int],
    pins: Sequence[Pin],
    passing: NDArray[np.intp],
) -> Stepper:
    if isinstance(settings, SettingsMuJoCoWarp):
        return LoopMuJoCo(model, driven=driven, settings=settings)
    given: dict[str, Any] = {"driven": driven, "pins": pins, "timestep_s": settings.timestep_s}
    if isinstance(settings, SettingsMPM):
        return LoopMPM(
            model,
            voxel_m=_voxel_m(scene, settings),
            iterations=settings.iterations,
            tolerance=settings.tolerance,
            integration_scheme=settings.integration_scheme,
            **given,
        )
    if isinstance(settings, SettingsLines):
        return LoopVBD(
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
    return LoopVBD(
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
