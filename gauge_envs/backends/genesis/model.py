"""A scene in Genesis: its rigid bodies as one entity, and the parts of its deformable bodies."""

from math import comb
from typing import Any

from gauge_envs.backends.genesis.document import body_label, document, layers_of_bodies
from gauge_envs.backends.genesis.engine import engine, patient_build
from gauge_envs.backends.genesis.parts import DeformablePart
from gauge_envs.backends.genesis.settings import SettingsGenesis
from gauge_envs.scene import Motion, Scene

PAIR_LIMIT = 150
"""Genesis's default for the number of pairs of shapes that can touch at a time."""

DISTANCE_CELL_M = 5e-4
"""Edge of the cells of a body's distance field [m], of which Genesis makes at most 128 along an edge."""

NEIGHBOURS = 8
"""Pairs that each convex piece of a scene with many bodies may form at a time. Genesis raises an error beyond it."""


def build_model(
    scene: Scene,
    settings: SettingsGenesis,
    world_count: int,
    part: DeformablePart | None,
) -> tuple[Any, dict[str, Any]]:
    """Build a Genesis scene.

    Args:
        scene: The scene.
        settings: Numerical settings.
        world_count: Number of Genesis's environments.
        part: The deformable bodies; None in a rigid scene.

    Returns:
        The `gs.Scene`, whose reset restores the initial state of the deformable bodies; and Genesis's links of the
        moving bodies, by name.
    """
    gs = engine()
    turns = any(contact.torsion_m or contact.rolling_m for contact in scene.contacts)
    if turns:
        # The key of Genesis 1.4's cache of MJCF geoms lacks both: a scene would get the values of an earlier scene.
        gs.utils.cache.clear_caches()
    with patient_build():
        model = gs.Scene(
            show_viewer=False,
            sim_options=gs.options.SimOptions(
                dt=settings.timestep_s, gravity=(0.0, 0.0, -scene.gravity_m_per_s2)
            ),
            rigid_options=_rigid_options(scene, settings, turns),
            **part.scene_options() if part else {},
        )
        entity = _add_bodies(model, scene, settings, part) if scene.bodies else None
        if part is not None:
            part.add(model)
        model.build(n_envs=world_count)
        if part is not None:
            part.finish(model)
            model.reset(model.get_state())
    links = {
        body.name: entity.get_link(body_label(index))
        for index, body in enumerate(scene.bodies)
        if entity is not None and body.motion is not Motion.FIXED
    }
    return model, links


def _add_bodies(
    model: Any, scene: Scene, settings: SettingsGenesis, part: DeformablePart | None
) -> Any:
    gs = engine()
    coupled, margin_m = (part.touches(), part.touch_margin_m()) if part else ({}, 0.0)
    return model.add_entity(
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
