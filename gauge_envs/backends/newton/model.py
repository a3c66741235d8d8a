"""Conversion of scenes to one Newton model and its stepper, for each of Newton's solvers.

The modules of a solver are imported where a scene needs it: those of VBD and of the material point method take a
sixth of the time of a first rigid scene.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import newton
import numpy as np
from newton.solvers import SolverMuJoCo
from numpy.typing import NDArray

from gauge_envs.backends.newton.contacts import SurfaceContacts, surface_contacts
from gauge_envs.backends.newton.line import add_line
from gauge_envs.backends.newton.mujoco_stepper import StepperMuJoCo
from gauge_envs.backends.newton.parts import Part, add_cloth, add_soft
from gauge_envs.backends.newton.rigid import (
    RigidIndex,
    Solids,
    add_bodies,
    add_contacts,
    add_strings,
    keep_apart,
    shape_config,
)
from gauge_envs.backends.newton.settings import (
    SettingsLines,
    SettingsMPM,
    SettingsMuJoCoWarp,
    SettingsNewton,
    SettingsVBD,
)
from gauge_envs.backends.newton.stepper import Stepper
from gauge_envs.backends.shared.attachments import rigid_attachments
from gauge_envs.backends.shared.soft_rows import soft_rows
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Cloth,
    Motion,
    Pose,
    Rod,
    Rope,
    Scene,
    Vector,
)
from gauge_envs.scene.geometry import vector


@dataclass(frozen=True, kw_only=True)
class WorldLayout:
    """Location of one scene in a model.

    Attributes:
        rigid: Indices of its rigid bodies.
        origin_m: World position of the model's origin [m]. Single precision has more digits close to the origin: a
            spring of 1e5 N/m resolves forces to 6 mN at 1 m, and to 0.7 mN at 0.1 m.
        parts: Its deformable bodies, by name; bonded soft bodies share a part.
        passing: Pairs of a particle and a shape that are excluded from collision, shape [pair_count, 2].
    """

    rigid: RigidIndex
    origin_m: Vector = (0.0, 0.0, 0.0)
    parts: dict[str, Part] = field(default_factory=dict)
    passing: NDArray[np.intp] = field(
        default_factory=lambda: np.zeros((0, 2), dtype=np.intp)
    )

    def nodes(self, name: str, state: newton.State) -> NDArray[np.float64]:
        """Return the world positions of a deformable body's nodes in a state [m], shape [node_count, 3]."""
        part = self.parts[name]
        nodes = part.nodes(state) + self.origin_m
        return nodes[part.node_indices[name]] if name in part.node_indices else nodes


def build_model(
    scenes: Sequence[Scene], settings: SettingsNewton
) -> tuple[Stepper, list[WorldLayout]]:
    """Build one model with a world for each scene, and record the step of its solver.

    Args:
        scenes: One or more scenes that differ only in their start poses and velocities.
        settings: Settings of the solver; their type selects the solver.

    Returns:
        The stepper at the start, and the layouts in the order of the scenes.
    """
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -scenes[0].gravity_m_per_s2))
    voxel_m = 0.0
    if isinstance(settings, SettingsMuJoCoWarp):
        SolverMuJoCo.register_custom_attributes(builder)
    elif isinstance(settings, SettingsMPM):
        from newton.solvers import SolverImplicitMPM

        from gauge_envs.backends.newton.mpm import fitted_voxel_m

        SolverImplicitMPM.register_custom_attributes(builder)
        # All soft rows share one grid, fitted to the grips of the first one.
        voxel_m = fitted_voxel_m(soft_rows(scenes[0])[0], settings)
    layouts = []
    for scene in scenes:
        if len(scenes) > 1:
            builder.begin_world()
        layouts.append(_add_scene(builder, scene, settings, voxel_m))
        if len(scenes) > 1:
            builder.end_world()
    passing = np.concatenate([layout.passing for layout in layouts])
    if len(passing):
        # StepperVBD needs an inactive particle that replaces those of excluded pairs.
        builder.add_particle(
            pos=(0.0, 0.0, 0.0), vel=(0.0, 0.0, 0.0), mass=0.0, flags=0
        )
    if isinstance(settings, SettingsVBD | SettingsLines):
        builder.color(include_bending=True)
    model = builder.finalize(device=settings.device)
    driven = [
        layout.rigid.bodies[body.name]
        for scene, layout in zip(scenes, layouts, strict=True)
        for body in scene.bodies
        if body.motion is Motion.KINEMATIC
    ]
    pins = [
        pin
        for layout in layouts
        for part in dict.fromkeys(layout.parts.values())
        for pin in part.pins
    ]
    if isinstance(settings, SettingsMuJoCoWarp):
        stepper: Stepper = StepperMuJoCo(model, driven=driven, settings=settings)
    elif isinstance(settings, SettingsMPM):
        from gauge_envs.backends.newton.mpm import StepperMPM

        stepper = StepperMPM(
            model, driven=driven, pins=pins, voxel_m=voxel_m, settings=settings
        )
    else:
        assert isinstance(settings, SettingsVBD | SettingsLines)
        from gauge_envs.backends.newton.vbd import StepperVBD

        stepper = StepperVBD(
            model,
            driven=driven,
            settings=settings,
            pins=pins,
            contacts=surface_contacts(scenes[0], per_body=_collides_per_body(settings)),
            contact_stiffness_n_per_m=_contact_stiffness_n_per_m(scenes[0], settings),
            passing=passing,
        )
    stepper.record()
    return stepper, layouts


def _add_scene(
    builder: newton.ModelBuilder, scene: Scene, settings: SettingsNewton, voxel_m: float
) -> WorldLayout:
    if isinstance(settings, SettingsLines):
        return _add_line_scene(builder, scene, settings)
    if isinstance(settings, SettingsMuJoCoWarp):
        solids: Solids = "meshes" if settings.meshes else "prisms"
        rigid = add_bodies(builder, scene, config=shape_config(), solids=solids)
        add_contacts(builder, scene, rigid, settings, solids)
        add_strings(builder, scene, rigid, settings)
        return WorldLayout(rigid=rigid)
    layout = WorldLayout(
        rigid=add_bodies(
            builder, scene, config=newton.ModelBuilder.ShapeConfig(density=0.0)
        )
    )
    if isinstance(settings, SettingsVBD):
        return _with_particles(builder, scene, settings, layout)
    assert isinstance(settings, SettingsMPM)
    from gauge_envs.backends.newton.mpm import add_soft_mpm

    spacing_m = voxel_m / settings.points_per_voxel_edge
    for row in soft_rows(scene):
        soft = add_soft_mpm(
            builder,
            row,
            indices=layout.rigid.bodies,
            spacing_m=spacing_m,
            damping_s=settings.soft_damping_s,
        )
        layout.parts.update(dict.fromkeys(soft.names, soft))
    _apply_contacts(surface_contacts(scene), builder, layout.rigid.shapes)
    return layout


def _with_particles(
    builder: newton.ModelBuilder,
    scene: Scene,
    settings: SettingsVBD,
    layout: WorldLayout,
) -> WorldLayout:
    """Add cloth and soft bodies for vertex block descent to a scene whose rigid bodies exist."""
    rigid = layout.rigid
    particles: dict[str, NDArray[np.intp]] = {}
    for body in scene.deformables:
        if isinstance(body, Cloth):
            attachments = rigid_attachments(scene, body.name)
            cloth = add_cloth(
                builder,
                body,
                attachments=attachments,
                bodies=rigid.bodies,
                settings=settings,
            )
            layout.parts[body.name] = cloth
            particles[body.name] = np.arange(
                cloth.particles.start, cloth.particles.stop
            )
    for soft_row in soft_rows(scene):
        soft = add_soft(builder, soft_row, indices=rigid.bodies, settings=settings)
        layout.parts.update(dict.fromkeys(soft.names, soft))
        particles |= {name: soft.block_particles(name) for name in soft.names}
        rigid.shapes.update(
            soft.add_block_shapes(builder, settings.soft_contact_radius_m)
        )
    contacts = surface_contacts(scene, per_body=_collides_per_body(settings))
    _apply_contacts(contacts, builder, rigid.shapes)
    keep_apart(builder, scene, rigid)
    return replace(layout, passing=_passing_pairs(contacts, particles, rigid.shapes))


def _add_line_scene(
    builder: newton.ModelBuilder, scene: Scene, settings: SettingsLines
) -> WorldLayout:
    lines = [body for body in scene.deformables if isinstance(body, Rope | Rod)]
    x, y, z = origin_m = vector(
        np.mean([line.pose.position_m for line in lines], axis=0)
    )
    near = _moved(scene, (-x, -y, -z))
    rigid = add_bodies(
        builder, near, config=newton.ModelBuilder.ShapeConfig(density=0.0)
    )
    layout = WorldLayout(rigid=rigid, origin_m=origin_m)
    for line in (body for body in near.deformables if isinstance(body, Rope | Rod)):
        part = layout.parts[line.name] = add_line(
            builder,
            line,
            attachments=rigid_attachments(near, line.name),
            bodies=rigid.bodies,
            settings=settings,
            load_n=_load_n(scene, line),
            touches_itself=any(
                {line.name} <= {*c.first} & {*c.second} for c in scene.contacts
            ),
        )
        rigid.shapes[line.name] = list(part.shapes)
    _apply_contacts(surface_contacts(scene), builder, rigid.shapes)
    keep_apart(builder, scene, rigid)
    return layout


def _load_n(scene: Scene, line: Rope | Rod) -> float:
    """Return the weight of a line and of the heaviest dynamic body at its ends, at standard gravity [N]."""
    attached = {
        attachment.to
        for attachment in scene.attachments
        if attachment.deformable == line.name
    }
    heaviest_kg = max(
        (body.mass_kg for body in scene.dynamic_bodies if body.name in attached),
        default=0.0,
    )
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
        deformables=tuple(
            replace(body, pose=moved(body.pose)) for body in scene.deformables
        ),
        joints=tuple(
            replace(joint, anchor_m=shifted(joint.anchor_m)) for joint in scene.joints
        ),
    )


def _apply_contacts(
    contacts: SurfaceContacts,
    builder: newton.ModelBuilder,
    shapes: Mapping[str, Sequence[int]],
) -> None:
    """Write the friction and the collision flags of shapes, given by name of their rigid body, to a builder."""
    for name, indices in shapes.items():
        for shape in indices:
            if name in contacts.shape_friction:
                builder.shape_material_mu[shape] = contacts.shape_friction[name]
            flag = int(newton.ShapeFlags.COLLIDE_PARTICLES)
            flags = int(builder.shape_flags[shape]) & ~flag
            builder.shape_flags[shape] = (
                flags | flag if name in contacts.touched else flags
            )


def _passing_pairs(
    contacts: SurfaceContacts,
    particles: Mapping[str, NDArray[np.intp]],
    shapes: Mapping[str, Sequence[int]],
) -> NDArray[np.intp]:
    """Return the pairs of a particle and a shape that are excluded from collision.

    Args:
        contacts: Collision partners of the scene.
        particles: Model indices of each body's particles, by name. A particle on a bonded face belongs to both bodies
            and collides if either of them does.
        shapes: Model indices of the shapes of each rigid body, by name.

    Returns:
        Index of the particle and of the shape of each pair, shape [pair_count, 2].
    """
    pairs = [np.zeros((0, 2), dtype=np.intp)]
    for rigid, through in contacts.passed.items():
        colliding = [
            indices for name, indices in particles.items() if name not in through
        ]
        free = np.setdiff1d(
            np.concatenate([particles[name] for name in through]),
            np.concatenate(colliding),
        )
        pairs.extend(
            np.column_stack([free, np.full_like(free, shape)])
            for shape in shapes[rigid]
        )
    return np.concatenate(pairs)


def _collides_per_body(settings: SettingsVBD | SettingsLines) -> bool:
    """Return whether each body made of particles can collide with other bodies than the rest."""
    return isinstance(settings, SettingsVBD) and not settings.full_surface


def _contact_stiffness_n_per_m(
    scene: Scene, settings: SettingsVBD | SettingsLines
) -> float:
    if isinstance(settings, SettingsLines):
        lines = [body for body in scene.deformables if isinstance(body, Rope | Rod)]
        return max(_load_n(scene, line) / settings.contact_depth_m for line in lines)
    cloths = [body for body in scene.deformables if isinstance(body, Cloth)]
    stiffnesses = (
        settings.contact_per_stretch * cloth.stretch_stiffness_n_per_m
        for cloth in cloths
    )
    return max(stiffnesses, default=settings.soft_contact_stiffness_n_per_m)
