"""A scene in Genesis: its rigid bodies as one entity, and the parts of its deformable bodies."""

from __future__ import annotations

import gc
from collections.abc import Sequence
from dataclasses import dataclass
from math import comb
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.genesis.document import body_label, document, layers_of_bodies
from gauge_envs.backends.genesis.engine import EngineLease, engine, patient
from gauge_envs.backends.genesis.foam_settings import SettingsFEM, SettingsMPM
from gauge_envs.backends.genesis.parts import DeformablePart
from gauge_envs.backends.genesis.pbd_settings import SettingsPBD
from gauge_envs.backends.genesis.settings import SettingsGenesis
from gauge_envs.backends.shared.rigid import world_hinges
from gauge_envs.scene import Motion, Scene

PAIR_LIMIT = 150
"""Genesis's default for the number of pairs of shapes that can touch at a time."""

DISTANCE_CELL_M = 5e-4
"""Edge of the cells of a body's distance field [m], of which Genesis makes at most 128 along an edge."""

NEIGHBOURS = 8
"""Pairs that each convex piece of a scene with many bodies may form at a time. Genesis raises an error beyond it."""


@dataclass(frozen=True)
class Place:
    """Where a moving body stands in the rigid solver's arrays.

    Attributes:
        link: Index of its link.
        coordinates: Its first coordinate.
        freedoms: Its first degree of freedom.
        is_hinged: Whether it has a hinge's one coordinate, and not a free body's seven.
    """

    link: int
    coordinates: int
    freedoms: int
    is_hinged: bool


@dataclass(eq=False)
class Model:
    """A built Genesis scene.

    Attributes:
        key: Everything that determines it; scenes with the same key differ in start poses only.
        lease: Claim on the engine.
        scene: The `gs.Scene`.
        solver: Its rigid solver.
        places: Places of the moving bodies, by name.
        parts: Parts of the deformable bodies.
        fresh: State of the rigid solver after the build; None without rigid bodies.
        world_count: Number of environments.
    """

    key: tuple[Any, ...]
    lease: EngineLease
    scene: Any
    solver: Any
    places: dict[str, Place]
    parts: list[DeformablePart]
    fresh: Any
    world_count: int

    def destroy(self) -> None:
        """Free the Genesis scene."""
        if self.scene is not None:
            self.scene.destroy()
            self.scene = self.solver = self.fresh = None
            self.parts = []
            self.lease.release()


_IDLE: list[Model] = []
"""The last model that was returned, which the next simulation of such a scene uses again."""


def model_key(scene: Scene, settings: SettingsGenesis, world_count: int = 1) -> tuple[Any, ...]:
    """Return what determines the model of a rigid scene."""
    names = tuple(body.name for body in scene.bodies)
    return (document(scene, settings), names, settings, scene.gravity_m_per_s2, world_count)


def borrow_model(scene: Scene, settings: SettingsGenesis, world_count: int = 1) -> Model:
    """Return a model of a scene, the one that was last returned if it fits."""
    key = model_key(scene, settings, world_count)
    if not scene.deformables and _IDLE and _IDLE[0].key == key:
        return _IDLE.pop()
    forget_models()
    return _new_model(scene, settings, key, world_count)


def return_model(model: Model) -> None:
    """Keep a model for the next simulation of such a scene, and free the one that was kept before."""
    forget_models()
    if model.parts:
        model.destroy()
    elif model.scene is not None:
        _IDLE.append(model)


def forget_models() -> None:
    """Free the model that is kept."""
    while _IDLE:
        _IDLE.pop().destroy()
    gc.collect()


def _new_model(scene: Scene, settings: SettingsGenesis, key: tuple[Any, ...], world_count: int) -> Model:
    lease = EngineLease(settings.precision)
    gs = engine()
    parts = _parts(scene, settings)
    with patient("building a scene"):
        options: dict[str, Any] = {}
        for part in parts:
            options |= part.scene_options()
        built = gs.Scene(
            show_viewer=False,
            sim_options=gs.options.SimOptions(dt=settings.timestep_s, gravity=(0.0, 0.0, -scene.gravity_m_per_s2)),
            rigid_options=_rigid_options(scene, settings),
            **options,
        )
        entity = _add_bodies(built, scene, settings, parts)
        for part in parts:
            part.add(built)
        built.build(n_envs=world_count)
        for part in parts:
            part.finish(built)
    solver = built.sim.rigid_solver
    return Model(
        key=key,
        lease=lease,
        scene=built,
        solver=solver,
        places=_places(scene, entity),
        parts=parts,
        fresh=solver.__getstate__() if solver.is_active else None,
        world_count=world_count,
    )


def _parts(scene: Scene, settings: SettingsGenesis) -> list[DeformablePart]:
    """Return the parts of the deformable bodies of a scene; none for a rigid scene."""
    if isinstance(settings, SettingsPBD):
        from gauge_envs.backends.genesis.cloth import ClothPart

        return [ClothPart(scene, settings)]
    if isinstance(settings, SettingsFEM):
        from gauge_envs.backends.genesis.foam import FEMPart

        return [FEMPart(scene, settings)]
    if isinstance(settings, SettingsMPM):
        from gauge_envs.backends.genesis.foam import MPMPart

        return [MPMPart(scene, settings)]
    return []


def _add_bodies(built: Any, scene: Scene, settings: SettingsGenesis, parts: Sequence[DeformablePart]) -> Any:
    gs = engine()
    coupled: dict[str, float] = {}
    for part in parts:
        coupled |= part.touches()
    margin_m = max((part.touch_margin_m() for part in parts), default=0.0)
    if not scene.bodies:
        return None
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


def _rigid_options(scene: Scene, settings: SettingsGenesis) -> Any:
    gs = engine()
    collides = bool(layers_of_bodies(scene, settings)) or bool(scene.deformables)
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
        contact_pruning_tolerance=settings.pruning_tolerance,
        enable_multi_contact=settings.multi_contact,
        box_box_detection=settings.box_box_detection,
        use_gjk_collision=settings.gjk,
        max_collision_pairs=_pair_count(scene, settings),
    )


def _pair_count(scene: Scene, settings: SettingsGenesis) -> int:
    """Return how many pairs of pieces may touch at a time."""
    pieces = {body.name: len(getattr(body.shape, "pieces_m", (None,))) for body in scene.bodies}
    count = sum(pieces[name] for name in layers_of_bodies(scene, settings))
    return max(PAIR_LIMIT, min(comb(count, 2), NEIGHBOURS * count))


def _places(scene: Scene, entity: Any) -> dict[str, Place]:
    hinged = world_hinges(scene)
    places = {}
    for index, body in enumerate(scene.bodies):
        if body.motion is Motion.FIXED:
            continue
        link = entity.get_link(body_label(index))
        places[body.name] = Place(
            link=link.idx, coordinates=link.q_start, freedoms=link.dof_start, is_hinged=body.name in hinged
        )
    return places


def start_coordinates(scene: Scene, model: Model) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return coordinates and velocities of the rigid solver at a scene's start, shapes [q_count] and [dof_count]."""
    coordinates = np.zeros(model.solver.n_qs)
    velocities = np.zeros(model.solver.n_dofs)
    hinges = world_hinges(scene)
    for name, place in model.places.items():
        body = scene.body(name)
        angular = np.asarray(body.angular_velocity_rad_per_s)
        if place.is_hinged:
            velocities[place.freedoms] = angular @ np.asarray(hinges[name].axis)
            continue
        coordinates[place.coordinates : place.coordinates + 7] = [*body.pose.position_m, *body.pose.quaternion]
        # Genesis's angular velocity is in the body frame.
        velocities[place.freedoms : place.freedoms + 6] = [
            *body.linear_velocity_m_per_s,
            *body.pose.rotation.inv().apply(angular),
        ]
    return coordinates, velocities
