"""Conversion of a scene to a Newton model of several worlds and its stepper, for each of Newton's solvers."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import newton
import numpy as np
from newton.solvers import SolverImplicitMPM, SolverMuJoCo

from gauge_envs.backends.newton.contacts import SurfaceContacts, surface_contacts
from gauge_envs.backends.newton.line import add_line
from gauge_envs.backends.newton.mpm import StepperMPM, add_soft_mpm, fitted_voxel_m
from gauge_envs.backends.newton.mujoco_stepper import StepperMuJoCo
from gauge_envs.backends.newton.parts import PartNewton, PinNewton, add_cloth, add_soft
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
    SettingsImplicitMPM,
    SettingsLines,
    SettingsMuJoCoWarp,
    SettingsNewton,
    SettingsVBD,
)
from gauge_envs.backends.newton.stepper import Stepper
from gauge_envs.backends.newton.vbd import StepperVBD
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
from gauge_envs.scene.geometry import IntArray, vector


@dataclass(frozen=True, kw_only=True)
class WorldLayout:
    """Location of a scene in each world of a model.

    Attributes:
        rigid: Indices of its rigid bodies.
        origin_m: World position of the model's origin [m]. Single precision has more digits close to the origin: a
            spring of 1e5 N/m resolves forces to 6 mN at 1 m, and to 0.7 mN at 0.1 m.
        parts: Its deformable bodies, by name; bonded soft bodies share a part.
    """

    rigid: RigidIndex
    origin_m: Vector = (0.0, 0.0, 0.0)
    parts: dict[str, PartNewton] = field(default_factory=dict)

    @property
    def pins(self) -> list[PinNewton]:
        """Particles that are attached to kinematic bodies."""
        return [pin for part in dict.fromkeys(self.parts.values()) for pin in part.pins]


NewStepper = Callable[..., Stepper]
"""Function of a finalized model and `driven`, the indices of the kinematic bodies."""


def build_model(
    scene: Scene, world_count: int, settings: SettingsNewton
) -> tuple[Stepper, WorldLayout]:
    """Build one model with equal worlds, and record the step of its solver.

    Args:
        scene: The scene.
        world_count: Number of worlds.
        settings: Settings of the solver; their type selects the solver.

    Returns:
        The stepper at a start without velocities, and the layout of each world.
    """
    gravity = (0.0, 0.0, -scene.gravity_m_per_s2)
    world = newton.ModelBuilder(gravity=gravity)
    if isinstance(settings, SettingsMuJoCoWarp):
        layout, new_stepper = _add_rigid_scene(world, scene, settings)
    elif isinstance(settings, SettingsImplicitMPM):
        layout, new_stepper = _add_mpm_scene(world, scene, settings)
    elif isinstance(settings, SettingsLines):
        layout, new_stepper = _add_line_scene(world, scene, settings)
    else:
        assert isinstance(settings, SettingsVBD)
        layout, new_stepper = _add_particle_scene(world, scene, settings)
    builder = world
    if world_count > 1:
        builder = newton.ModelBuilder(gravity=gravity)
        builder.replicate(world, world_count)
    if settings.solver == "SolverVBD":
        # Replicated colours would have another order in each world, and so another rounding.
        builder.color(include_bending=True)
    driven = [
        layout.rigid.bodies[body.name]
        for body in scene.bodies
        if body.motion is Motion.KINEMATIC
    ]
    stepper = new_stepper(builder.finalize(device=settings.device), driven=driven)
    stepper.record()
    return stepper, layout


def _add_rigid_scene(
    builder: newton.ModelBuilder, scene: Scene, settings: SettingsMuJoCoWarp
) -> tuple[WorldLayout, NewStepper]:
    SolverMuJoCo.register_custom_attributes(builder)
    solids: Solids = "meshes" if settings.meshes else "prisms"
    rigid = add_bodies(builder, scene, config=shape_config(), solids=solids)
    add_contacts(builder, scene, rigid, settings, solids)
    add_strings(builder, scene, rigid, settings)
    return WorldLayout(rigid=rigid), partial(StepperMuJoCo, settings=settings)


def _add_mpm_scene(
    builder: newton.ModelBuilder, scene: Scene, settings: SettingsImplicitMPM
) -> tuple[WorldLayout, NewStepper]:
    SolverImplicitMPM.register_custom_attributes(builder)
    layout = WorldLayout(rigid=_add_massless_shapes(builder, scene))
    rows = soft_rows(scene)
    # All soft rows share one grid, fitted to the grips of the first one.
    voxel_m = fitted_voxel_m(rows[0], settings)
    for row in rows:
        soft = add_soft_mpm(
            builder,
            row,
            indices=layout.rigid.bodies,
            spacing_m=voxel_m / settings.points_per_voxel_edge,
            damping_s=settings.soft_damping_s,
        )
        layout.parts.update(dict.fromkeys(soft.names, soft))
    _apply_contacts(surface_contacts(scene), builder, layout.rigid.shapes)
    return layout, partial(
        StepperMPM, pins=layout.pins, voxel_m=voxel_m, settings=settings
    )


def _add_particle_scene(
    builder: newton.ModelBuilder, scene: Scene, settings: SettingsVBD
) -> tuple[WorldLayout, NewStepper]:
    """Add a scene with cloth and soft bodies for vertex block descent."""
    rigid = _add_massless_shapes(builder, scene)
    layout = WorldLayout(rigid=rigid)
    particles: dict[str, IntArray] = {}
    cloths = [body for body in scene.deformables if isinstance(body, Cloth)]
    for body in cloths:
        cloth = add_cloth(
            builder,
            body,
            attachments=rigid_attachments(scene, body.name),
            bodies=rigid.bodies,
            settings=settings,
        )
        layout.parts[body.name] = cloth
        particles[body.name] = np.arange(cloth.particles.start, cloth.particles.stop)
    for row in soft_rows(scene):
        soft = add_soft(builder, row, indices=rigid.bodies, settings=settings)
        layout.parts.update(dict.fromkeys(soft.names, soft))
        particles |= {name: soft.block_particles(name) for name in soft.names}
        margin_m = settings.soft_contact_radius_m
        rigid.shapes.update(soft.add_block_shapes(builder, margin_m))
    contacts = surface_contacts(scene)
    _apply_contacts(contacts, builder, rigid.shapes)
    keep_apart(builder, scene, rigid)
    passing = _passing_pairs(contacts, particles, rigid.shapes)
    if len(passing):
        # StepperVBD needs an inactive particle, which replaces the particles of excluded pairs.
        builder.add_particle(
            pos=(0.0, 0.0, 0.0), vel=(0.0, 0.0, 0.0), mass=0.0, flags=0
        )
    stiffnesses = (
        settings.contact_per_stretch * cloth.stretch_stiffness_n_per_m
        for cloth in cloths
    )
    return layout, partial(
        StepperVBD,
        settings=settings,
        pins=layout.pins,
        contacts=contacts,
        contact_stiffness_n_per_m=max(
            stiffnesses, default=settings.soft_contact_stiffness_n_per_m
        ),
        passing=passing,
    )


def _add_line_scene(
    builder: newton.ModelBuilder, scene: Scene, settings: SettingsLines
) -> tuple[WorldLayout, NewStepper]:
    lines = [body for body in scene.deformables if isinstance(body, Rope | Rod)]
    origin_m = np.mean([line.pose.position_m for line in lines], axis=0)

    def near(pose: Pose) -> Pose:
        return replace(pose, position_m=vector(pose.position_m - origin_m))

    bodies = tuple(replace(body, pose=near(body.pose)) for body in scene.bodies)
    near_scene = replace(scene, bodies=bodies)
    rigid = _add_massless_shapes(builder, near_scene)
    layout = WorldLayout(rigid=rigid, origin_m=vector(origin_m))
    loads_n = {line.name: _load_n(scene, line) for line in lines}
    for line in lines:
        part = layout.parts[line.name] = add_line(
            builder,
            replace(line, pose=near(line.pose)),
            attachments=rigid_attachments(near_scene, line.name),
            bodies=rigid.bodies,
            settings=settings,
            load_n=loads_n[line.name],
            touches_itself=any(
                line.name in c.first and line.name in c.second for c in scene.contacts
            ),
        )
        rigid.shapes[line.name] = list(part.shapes)
    contacts = surface_contacts(scene)
    _apply_contacts(contacts, builder, rigid.shapes)
    keep_apart(builder, scene, rigid)
    return layout, partial(
        StepperVBD,
        settings=settings,
        contacts=contacts,
        contact_stiffness_n_per_m=max(loads_n.values()) / settings.contact_depth_m,
    )


def _add_massless_shapes(builder: newton.ModelBuilder, scene: Scene) -> RigidIndex:
    config = newton.ModelBuilder.ShapeConfig(density=0.0)
    return add_bodies(builder, scene, config=config)


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


def _apply_contacts(
    contacts: SurfaceContacts,
    builder: newton.ModelBuilder,
    shapes: Mapping[str, Sequence[int]],
) -> None:
    """Write the friction and the collision flags of shapes, given by name of their rigid body, to a builder."""
    flag = int(newton.ShapeFlags.COLLIDE_PARTICLES)
    for name, indices in shapes.items():
        for shape in indices:
            if name in contacts.shape_friction:
                builder.shape_material_mu[shape] = contacts.shape_friction[name]
            builder.shape_flags[shape] &= ~flag
            if name in contacts.touched:
                builder.shape_flags[shape] |= flag


def _passing_pairs(
    contacts: SurfaceContacts,
    particles: Mapping[str, IntArray],
    shapes: Mapping[str, Sequence[int]],
) -> IntArray:
    """Return the pairs of a particle and a shape that are excluded from collision.

    Args:
        contacts: Collision partners of the scene.
        particles: Indices of each body's particles, by name. A particle on a bonded face belongs to both bodies
            and collides if either of them does.
        shapes: Indices of the shapes of each rigid body, by name.

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
