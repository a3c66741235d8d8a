"""Judge the masses, inertias and sizes that a model states."""

import warnings
from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from gauge_envs.scene import Vector
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.tools.sanity.robot.finding import (
    Finding,
    body_name,
    limits_of,
    row,
)
from gauge_envs.tools.sanity.robot.ground_rows import geoms_of
from gauge_envs.tools.sanity.robot.joints import placed_bodies, start
from gauge_envs.tools.sanity.robot.robot import Robot, once

SIGNS = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T
"""Signs of the corners of a box, shape [8, 3]."""

FAR_CENTRE = 0.5
"""Distance of a centre of mass from the box around its link, over the diagonal of the box, beyond which it is wrong.

It is 0 in 36 of 38 models of makers, and 0.26 in the Tiago of robosuite.
"""

AT_ORIGIN = 0.15
"""Distance of the middle of a link from its origin over its size from which on its centre of mass is elsewhere too."""

MASSLESS_KG = 1e-5
"""Mass up to which a body is a frame that carries no link; makers give such frames 1e-8 to 1e-6 kg [kg]."""

PART_SHARE = 0.01
"""Share of the mass of a link up to which a body that is fixed to it is a part whose mass the link states."""

UNSTATED_KG_PER_M3 = 1000.0
"""Density of a geom that states none [kg/m^3]."""

SAME_PLACE = 0.3
"""Overlap of the boxes around two sets of geoms, over the box around both, from which on they show the same part."""


def extent(robot: Robot, body: int) -> Vector:
    """Return the largest volume of a geom of a body, that of their hull [m^3], and the reach from its centre [m].

    Joints of the next links belong to the hull. All are NaN for a body whose shape is not known.
    """
    model, geoms = robot.model, geoms_of(robot, body)
    if not geoms:
        return (np.nan,) * 3
    largest = float(8.0 * model.geom_aabb[geoms, 3:].prod(axis=1).max())
    every = _points(robot, body)
    try:
        hull = float(ConvexHull(every).volume)
    except QhullError:
        hull = largest
    reach = np.linalg.norm(every - model.body_ipos[body], axis=1).max()
    return largest, hull, float(reach)


def box_corners(model: mujoco.MjModel, geoms: Sequence[int]) -> FloatArray:
    """Return the corners of the boxes around geoms of one body, in its frame [m], shape [8 geom_count, 3]."""
    corners = [np.zeros((0, 3))]
    for geom in geoms:
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
        box = model.geom_aabb[geom, :3] + SIGNS * model.geom_aabb[geom, 3:]
        corners.append(model.geom_pos[geom] + box @ turn.reshape(3, 3).T)
    return np.vstack(corners)


@once
def _points(robot: Robot, body: int) -> FloatArray:
    """Return the corners of the boxes around the geoms of a body, its joints and those of the next bodies [m]."""
    model = robot.model
    children = [b for b in robot.bodies if int(model.body_parentid[b]) == body]
    joints = model.jnt_pos[model.jnt_bodyid == body]
    corners = box_corners(model, geoms_of(robot, body))
    return np.vstack([corners, model.body_pos[children], joints])


@once
def size_m(robot: Robot) -> float:
    """Return the diagonal of the box around a robot where it starts [m]; 0 without one."""
    data = start(robot)
    places = [np.zeros((0, 3))]
    for body in robot.bodies:
        turn = data.xmat[body].reshape(3, 3)
        places.append(data.xpos[body] + _points(robot, body) @ turn.T)
    every = np.vstack(places)
    return length_of(np.ptp(every, axis=0)) if len(every) else 0.0


def _box(robot: Robot, body: int) -> tuple[FloatArray, FloatArray]:
    """Return the lower and the upper corner of the box around a link, in its frame [m], shape [3] each."""
    points = _points(robot, body)
    return points.min(axis=0), points.max(axis=0)


@row("robot-density")
def _density(robot: Robot) -> Finding:
    model, worst = robot.model, 0.0
    found = Finding(declined="the shape of no link is known")
    densities: dict[str, float] = {}
    for body in robot.bodies:
        mass_kg = float(model.body_mass[body])
        density, ratio = _link_density(robot, body)
        if not density:
            continue
        if _is_placeholder(robot, body):
            continue
        name = body_name(robot, body)
        densities[name] = density
        if found.declined or ratio > worst:
            worst = ratio
            remark = f"{name} with {mass_kg:.3g} kg of {robot.mass_kg:.3g} kg"
            found = Finding(value=density, remark=remark)
    return replace(found, parts=densities)


def _is_placeholder(robot: Robot, body: int) -> bool:
    """Return whether the geoms of a link hold the place of its shape: it is light, and denser than its material."""
    is_light = robot.model.body_mass[body] < _middle_kg(robot)
    return is_light and _link_density(robot, body)[0] > limits_of("robot-density")[1]


@once
def _middle_kg(robot: Robot) -> float:
    """Return the mass of the middle link [kg]; 0 without one."""
    links = [body for body in robot.bodies if is_link(robot, body)]
    return float(np.median([0.0, *robot.model.body_mass[links]]))


def is_link(robot: Robot, body: int) -> bool:
    """Return whether a body has a mass of its own: it is no frame, and no part of a link that states its mass."""
    model = robot.model
    mass_kg = float(model.body_mass[body])
    link_kg = model.body_mass[model.body_weldid == model.body_weldid[body]].sum()
    is_fixed = model.body_weldid[body] != body
    is_part = is_fixed and mass_kg < PART_SHARE * link_kg
    return mass_kg > MASSLESS_KG and not is_part


def _link_density(robot: Robot, body: int) -> tuple[float, float]:
    """Return the density of a link [kg/m^3], and by how much it is outside the limits; 0 and 0 if it is not known."""
    mass_kg = float(robot.model.body_mass[body])
    geom_m3, hull_m3, _ = extent(robot, body)
    if not (is_link(robot, body) and geom_m3 > 0.0):
        return 0.0, 0.0
    low, high = limits_of("robot-density")
    # The largest density that its largest geom allows, and the least one in the room around all of them [kg/m^3].
    dense, thin = mass_kg / geom_m3, mass_kg / max(hull_m3, geom_m3)
    if dense < low and (mesh_m3 := _hull_m3(robot, body)):
        # The box around a mesh can be mostly empty, as that of a drone.
        dense = mass_kg / mesh_m3
    density = dense if dense < low else max(thin, low)
    return density, max(low / dense, thin / high)


def _hull_m3(robot: Robot, body: int) -> float:
    """Return the volume of the hull of a body's meshes [m^3]; 0 without one."""
    model, points = robot.model, [np.zeros((0, 3))]
    for geom in geoms_of(robot, body):
        mesh = int(model.geom_dataid[geom])
        if model.geom_type[geom] != int(mujoco.mjtGeom.mjGEOM_MESH):
            continue
        first, turn = int(model.mesh_vertadr[mesh]), np.zeros(9)
        corners = model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])]
        mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
        points.append(model.geom_pos[geom] + corners @ turn.reshape(3, 3).T)
    try:
        return float(ConvexHull(np.vstack(points)).volume)
    except (QhullError, ValueError):
        return 0.0


@row("robot-inertia")
def _inertia(robot: Robot) -> Finding:
    low, high = limits_of("robot-inertia")
    found, worst = Finding(declined="the shape of no link is known"), 0.0
    shares: dict[str, float] = {}
    far: list[tuple[float, str, float, float]] = []
    at_origin: list[str] = []
    # Of a screen or a frame beside it nothing depends.
    least_kg = 1e-5 * robot.mass_kg
    # Shapes of a link may lack a part of it, but no part reaches farther than the robot.
    half_m = 0.5 * size_m(robot)
    placed = placed_bodies(robot.model)
    for body in robot.bodies:
        if body in placed:
            continue
        mass_kg, reach_m = float(robot.model.body_mass[body]), extent(robot, body)[2]
        is_heavy = mass_kg > least_kg and is_link(robot, body)
        if not (is_heavy and reach_m > 0.0) or _is_placeholder(robot, body):
            continue
        low_m, high_m = _box(robot, body)
        centre_m = robot.model.body_ipos[body]
        beyond_m = np.maximum(np.maximum(low_m - centre_m, centre_m - high_m), 0.0)
        away_m = length_of(beyond_m)
        diagonal_m = max(length_of(high_m - low_m), 1e-9)
        name = body_name(robot, body)
        middle_m = length_of(0.5 * (low_m + high_m))
        if middle_m > AT_ORIGIN * diagonal_m and not centre_m.any():
            at_origin.append(name)
        if away_m > FAR_CENTRE * diagonal_m:
            far.append((away_m / diagonal_m, name, away_m, diagonal_m))
        inertia = robot.model.body_inertia[body]
        # The sum of the principal moments is twice the mass times the square of the polar radius of gyration.
        radius_m = float(np.sqrt(0.5 * inertia.sum() / mass_kg))
        shares[name] = radius_m / reach_m
        ratio = max(low * reach_m / max(radius_m, 1e-12), radius_m / reach_m / high)
        if ratio > worst:
            worst = ratio
            found = Finding(
                value=radius_m / reach_m,
                remark=f"{name} of {mass_kg:.3g} kg: gyrates with {radius_m:.3g} m, and reaches {reach_m:.3g} m",
                is_usual=radius_m < half_m,
            )
    if far:
        _, name, away_m, diagonal_m = max(far)
        return Finding(
            value=np.inf,
            parts=shares | {f"centre of mass of {one}": np.inf for _, one, *_ in far},
            remark=f"centre of mass of {name}: {away_m:.3g} m outside of a link of {diagonal_m:.2g} m",
            is_usual=away_m < half_m,
        )
    if 2 * len(at_origin) > len(shares):
        return Finding(
            value=np.inf,
            parts=shares | {f"centre of mass of {one}": np.inf for one in at_origin},
            remark=f"the centres of mass of {len(at_origin)} of {len(shares)} links are the origins of their bodies, "
            "and their shapes lie beside them",
            is_usual=True,
        )
    return replace(found, parts=shares)


@row("robot-visual-mass")
def _visual_mass(robot: Robot) -> Finding:
    spec, model = robot.spec, robot.model
    if spec is None or not robot.bodies:
        return Finding(declined="the geoms that give a body its mass are not known")
    can_collide = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    in_pairs = {*model.pair_geom1.tolist(), *model.pair_geom2.tolist()}
    bare = spec.copy()
    drawn: dict[int, list[int]] = {}
    for body in robot.bodies:
        geoms = geoms_of(robot, body)
        solid = [geom for geom in geoms if can_collide[geom] or geom in in_pairs]
        visual = [geom for geom in geoms if geom not in solid]
        if solid and visual and _overlap(model, solid, visual) > SAME_PLACE:
            drawn[body] = visual
    numbers = {geom for geoms in drawn.values() for geom in geoms}
    for geom, original in zip(bare.geoms, spec.geoms, strict=True):
        if original.id in numbers:
            geom.mass = 0.0
    try:
        with warnings.catch_warnings():
            # What the compiler warns of was said as the model was read.
            warnings.simplefilter("ignore")
            masses = bare.compile().body_mass
    except ValueError:
        return Finding(declined="bodies have the mass of their visual geoms alone")
    extra_kg = {
        body: float(model.body_mass[body] - masses[body])
        for body in drawn
        if model.body_mass[body] - masses[body] > 1e-6 and masses[body] > 0.0
    }
    counted = {geom for body in extra_kg for geom in drawn[body]}
    total_kg = robot.mass_kg
    names = ", ".join(body_name(robot, body) for body in list(extra_kg)[:3])
    stated_kg = total_kg - sum(extra_kg.values())
    return Finding(
        value=sum(extra_kg.values()) / stated_kg,
        parts={body_name(robot, body): kg / stated_kg for body, kg in extra_kg.items()},
        remark=f"{total_kg:.3g} kg for {stated_kg:.3g} kg, in {names}"
        if extra_kg
        else "",
        is_usual=all(_is_meant(geom) for geom in spec.geoms if geom.id in counted),
    )


def _is_meant(geom: mujoco.MjsGeom) -> bool:
    """Return whether a drawn geom can be a part with its own mass: it states one, or a density, or is no mesh."""
    is_stated = np.isfinite(geom.mass) or geom.density != UNSTATED_KG_PER_M3
    return bool(is_stated or geom.type != mujoco.mjtGeom.mjGEOM_MESH)


def _overlap(model: mujoco.MjModel, first: list[int], second: list[int]) -> float:
    """Return the volume that the boxes around two sets of geoms of a body share, over that of the box around both."""
    corners, others = box_corners(model, first), box_corners(model, second)
    low, high = corners.min(axis=0), corners.max(axis=0)
    other_low, other_high = others.min(axis=0), others.max(axis=0)
    shared = np.clip(np.minimum(high, other_high) - np.maximum(low, other_low), 0, None)
    around = np.maximum(high, other_high) - np.minimum(low, other_low)
    return float(shared.prod() / max(around.prod(), 1e-18))
