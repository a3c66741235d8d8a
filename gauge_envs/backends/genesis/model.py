"""A scene in Genesis: its rigid bodies as one entity, and the parts of its deformable bodies."""

import gc
from dataclasses import dataclass
from math import comb
from typing import Any

import numpy as np

from gauge_envs.backends.genesis.document import body_label, document, layers_of_bodies
from gauge_envs.backends.genesis.engine import EngineLease, engine, patient
from gauge_envs.backends.genesis.parts import DeformablePart
from gauge_envs.backends.genesis.settings import (
    SettingsFEM,
    SettingsGenesis,
    SettingsMPM,
    SettingsPBD,
)
from gauge_envs.backends.settings import check_kept
from gauge_envs.scene import Motion, Scene
from gauge_envs.scene.geometry import FloatArray

PAIR_LIMIT = 150
"""Genesis's default for the number of pairs of shapes that can touch at a time."""

DISTANCE_CELL_M = 5e-4
"""Edge of the cells of a body's distance field [m], of which Genesis makes at most 128 along an edge."""

NEIGHBOURS = 8
"""Pairs that each convex piece of a scene with many bodies may form at a time. Genesis raises an error beyond it."""


@dataclass(eq=False)
class Model:
    """A built Genesis scene.

    Attributes:
        key: Everything that determines it; scenes with the same key differ in start poses only.
        lease: Claim on the engine.
        scene: The `gs.Scene`.
        solver: Its rigid solver.
        links: Genesis's links of the moving bodies, by name.
        part: The deformable bodies; None in a rigid scene.
        fresh: State of the rigid solver after the build; None without rigid bodies.
    """

    key: tuple[Any, ...]
    lease: EngineLease
    scene: Any
    solver: Any
    links: dict[str, Any]
    part: DeformablePart | None
    fresh: Any

    def destroy(self) -> None:
        """Free the Genesis scene."""
        if self.scene is not None:
            self.scene.destroy()
            self.scene = self.solver = self.fresh = self.part = None
            self.lease.release()


_IDLE: list[Model] = []
"""The last model that was returned, which the next simulation of such a scene uses again."""


def model_key(
    scene: Scene, settings: SettingsGenesis, world_count: int = 1
) -> tuple[Any, ...]:
    """Return what determines the model of a rigid scene."""
    names = tuple(body.name for body in scene.bodies)
    return (
        document(scene, settings),
        names,
        settings,
        scene.gravity_m_per_s2,
        world_count,
    )


def borrow_model(
    scene: Scene, settings: SettingsGenesis, world_count: int = 1
) -> Model:
    """Return a model of a scene, the one that was last returned if it fits."""
    key = model_key(scene, settings, world_count)
    if not scene.deformables and _IDLE and _IDLE[0].key == key:
        return _IDLE.pop()
    forget_models()
    return _new_model(scene, settings, key, world_count)


def return_model(model: Model) -> None:
    """Keep a model for the next simulation of such a scene, and free the one that was kept before."""
    forget_models()
    if model.part is not None:
        model.destroy()
    elif model.scene is not None:
        _IDLE.append(model)


def forget_models() -> None:
    """Free the model that is kept."""
    while _IDLE:
        _IDLE.pop().destroy()
    gc.collect()


def _new_model(
    scene: Scene, settings: SettingsGenesis, key: tuple[Any, ...], world_count: int
) -> Model:
    lease = EngineLease(settings.precision)
    gs = engine()
    part = _part(scene, settings)
    of_contacts = [(one.torsion_m, one.rolling_m) for one in scene.contacts]
    turning = dict(
        zip(
            ("torsion_m", "rolling_m"),
            np.max([(0.0, 0.0), *of_contacts], axis=0).tolist(),
            strict=True,
        )
    )
    if any(turning.values()):
        # The key of Genesis 1.4's cache of MJCF geoms lacks these two: a scene would get those of an earlier one.
        gs.utils.cache.clear_caches()
    with patient("building a scene"):
        built = gs.Scene(
            show_viewer=False,
            sim_options=gs.options.SimOptions(
                dt=settings.timestep_s, gravity=(0.0, 0.0, -scene.gravity_m_per_s2)
            ),
            rigid_options=_rigid_options(scene, settings, any(turning.values())),
            **part.scene_options() if part else {},
        )
        entity = _add_bodies(built, scene, settings, part)
        if part is not None:
            part.add(built)
        built.build(n_envs=world_count)
        if part is not None:
            part.finish(built)
    solver = built.sim.rigid_solver
    if solver.is_active and solver.constraint_solver is not None:
        inner = solver.constraint_solver
        kept = {
            "tolerance": inner.tolerance,
            "line_search_iterations": inner.ls_iterations,
            "timestep_s": built.sim.dt,
        }
        check_kept("Genesis", settings.model_dump(), kept)
    if any(turning.values()):
        read = (solver.get_geoms_friction_torsional, solver.get_geoms_friction_rolling)
        check_kept(
            "Genesis",
            turning,
            {name: float(one().max()) for name, one in zip(turning, read, strict=True)},
        )
    return Model(
        key=key,
        lease=lease,
        scene=built,
        solver=solver,
        links={
            body.name: entity.get_link(body_label(index))
            for index, body in enumerate(scene.bodies)
            if body.motion is not Motion.FIXED
        },
        part=part,
        fresh=solver.__getstate__() if solver.is_active else None,
    )


def _part(scene: Scene, settings: SettingsGenesis) -> DeformablePart | None:
    """Return the deformable bodies of a scene; None for a rigid scene."""
    if isinstance(settings, SettingsPBD):
        from gauge_envs.backends.genesis.cloth import ClothPart

        return ClothPart(scene, settings)
    if isinstance(settings, SettingsFEM):
        from gauge_envs.backends.genesis.foam import FEMPart

        return FEMPart(scene, settings)
    if isinstance(settings, SettingsMPM):
        from gauge_envs.backends.genesis.foam import MPMPart

        return MPMPart(scene, settings)
    return None


def _add_bodies(
    built: Any, scene: Scene, settings: SettingsGenesis, part: DeformablePart | None
) -> Any:
    if not scene.bodies:
        return None
    gs = engine()
    coupled, margin_m = (part.touches(), part.touch_margin_m()) if part else ({}, 0.0)
    return built.add_entity(
        gs.morphs.MJCF(
            file=document(scene, settings, coupled, margin_m),
            align=False,
            decimate=False,
            convexify=True,
            # Genesis would give each hinge the inertia of a motor.
            default_armature=None,
        ),
        # Particles read the distance to a body from a grid.
        material=gs.materials.Rigid(sdf_cell_size=DISTANCE_CELL_M) if coupled else None,
        surface=gs.surfaces.Default(),
    )


def _rigid_options(scene: Scene, settings: SettingsGenesis, turns: bool) -> Any:
    gs = engine()
    layers = layers_of_bodies(scene, settings)
    collides = bool(layers) or bool(scene.deformables)
    pieces = sum(
        len(getattr(scene.body(name).shape, "pieces_m", (None,))) for name in layers
    )
    return gs.options.RigidOptions(
        # Scenes without contact then advance in fewer kernels.
        enable_collision=collides,
        disable_constraint=not collides,
        integrator=getattr(gs.integrator, settings.integrator),
        constraint_solver=getattr(gs.constraint_solver, settings.constraint_solver),
        iterations=settings.iterations,
        tolerance=settings.tolerance,
        ls_iterations=settings.line_search_iterations,
        ls_tolerance=settings.line_search_tolerance,
        noslip_iterations=settings.noslip_iterations,
        friction_cone=getattr(gs.friction_cone, settings.friction_cone),
        contact_resolution=getattr(gs.contact_resolution, settings.contact_resolution),
        impratio=settings.impratio,
        # One set of kernels serves both: a coefficient of 0 has no effect.
        enable_torsional_friction=turns,
        enable_rolling_friction=turns,
        contact_pruning_tolerance=settings.pruning_tolerance,
        enable_multi_contact=settings.multi_contact,
        box_box_detection=settings.box_box_detection,
        use_gjk_collision=settings.gjk,
        max_collision_pairs=max(PAIR_LIMIT, min(comb(pieces, 2), NEIGHBOURS * pieces)),
    )


def start_coordinates(scene: Scene, model: Model) -> tuple[FloatArray, FloatArray]:
    """Return coordinates and velocities of the rigid solver at a scene's start, shapes [q_count] and [dof_count]."""
    coordinates = np.zeros(model.solver.n_qs)
    velocities = np.zeros(model.solver.n_dofs)
    for name, link in model.links.items():
        body = scene.body(name)
        angular = np.asarray(body.angular_velocity_rad_per_s)
        if name in scene.hinges:
            velocities[link.dof_start] = angular @ scene.hinges[name].axis
            continue
        coordinates[link.q_start : link.q_start + 7] = [
            *body.pose.position_m,
            *body.pose.quaternion,
        ]
        # Genesis's angular velocity is in the body frame.
        turned = body.pose.rotation.inv().apply(angular)
        velocities[link.dof_start : link.dof_start + 6] = [
            *body.linear_velocity_m_per_s,
            *turned,
        ]
    return coordinates, velocities
