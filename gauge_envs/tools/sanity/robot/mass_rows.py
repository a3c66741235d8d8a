"""Judge the masses, inertias and sizes that a model states."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from gauge_envs.scene import GRAVITY_M_PER_S2, Vector
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.tools.sanity.robot.finding import (
    Finding,
    body_name,
    limits_of,
    row,
)
from gauge_envs.tools.sanity.robot.ground_rows import geoms_of
from gauge_envs.tools.sanity.robot.joints import placed_bodies, start
from gauge_envs.tools.sanity.robot.mujoco_feet import geom_name, shortened
from gauge_envs.tools.sanity.robot.robot import Robot, once

SIGNS = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T
"""Signs of the corners of a box, shape [8, 3]."""

FAR_CENTRE = 0.5
"""Distance of a centre of mass from the box around its link, over the diagonal of the box, beyond which it is wrong.

It is 0 in 36 of 38 models of makers, and 0.26 in the Tiago of robosuite.
"""

AT_ORIGIN = 0.15
"""Distance of the middle of a link from its origin over its size from which on its centre of mass is elsewhere too."""

UNIT_ERRORS = {
    1e3: "a density in g/cm^3 or a mass in tonnes",
    1e-3: "a mass in grams",
    1e6: "a mass in kt",
}

MASSLESS_KG = 1e-5
"""Mass up to which a body is a frame that carries no link; makers give such frames 1e-8 to 1e-6 kg [kg]."""

PART_SHARE = 0.01
"""Share of the mass of a link up to which a body that is fixed to it is a part whose mass the link states."""

SAME_KG = 0.02
"""Difference of a mass from the stated one, over it, up to which they are the same."""

GRAMS_KG_PER_M3 = (0.1, 25.0)
"""Stated densities that are in g/cm^3; foams have 30 and more [kg/m^3]."""

UNIT_WITHIN = 35.0
"""Factor within which a density in another unit is that of water."""


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
    changes: dict[str, Any] = {}
    of_placeholders: dict[str, Any] = {}
    densities: dict[str, float] = {}
    low, high = limits_of("robot-density")
    for body in robot.bodies:
        mass_kg = float(model.body_mass[body])
        density, ratio = _link_density(robot, body)
        if not density:
            continue
        is_placeholder = _is_placeholder(robot, body)
        name = body_name(robot, body)
        factor = min(UNIT_ERRORS, key=lambda one: abs(np.log(1000.0 / density / one)))
        remark = f"{name} with {mass_kg:.3g} kg of {robot.mass_kg:.3g} kg"
        is_unit = abs(np.log(1000.0 / density / factor)) < np.log(UNIT_WITHIN)
        # The room around a link may be empty, but nothing makes a part denser.
        is_unit &= density * factor <= high
        if ratio > 1.0 and is_unit:
            remark += f": {UNIT_ERRORS[factor]}?"
            several = of_placeholders if is_placeholder else changes
            several[f"body_mass[{body}]"] = model.body_mass[body] * factor
            several[f"body_inertia[{body}]"] = model.body_inertia[body] * factor
        if is_placeholder:
            continue
        densities[name] = density
        if found.declined or ratio > worst:
            worst = ratio
            links = f"{name} and links like it"
            advice = f"give {links} the mass and inertia of the real part"
            if is_unit:
                advice = f"multiply mass and inertia, or the density, of {links} by {factor:g}"
            if density < low:
                geom = max(geoms_of(robot, body), key=lambda g: model.geom_rbound[g])
                advice += f", or give {geom_name(model, geom)} its size"
            found = Finding(value=density, remark=remark, advice=advice)
    if densities and not any(low <= one <= high for one in densities.values()):
        # All links are in another unit, and so are light ones.
        changes |= of_placeholders
    found = replace(found, changes=changes, parts=densities)
    if worst <= 1.0 and (light := _thin_geoms(robot)):
        return light
    return found


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


def _thin_geoms(robot: Robot) -> Finding | None:
    """Return geoms of objects with a density in g/cm^3, that touch; None without any."""
    if robot.spec is None:
        return None
    touching = {*np.unique(robot.pairs.geoms).tolist()}
    lowest, highest = GRAMS_KG_PER_M3
    # Links of the robot are judged by their mass.
    touching -= {geom for body in robot.bodies for geom in geoms_of(robot, body)}
    thin = [
        geom
        for geom in robot.spec.geoms
        if geom.id in touching and lowest <= geom.density <= highest
    ]
    if not thin:
        return None
    names = ", ".join(shortened([geom_name(robot.model, geom.id) for geom in thin]))
    density = float(thin[0].density)
    return Finding(
        value=density,
        parts={geom_name(robot.model, geom.id): float(geom.density) for geom in thin},
        remark=f"{names} with a density of {density:g} kg/m^3: is it in g/cm^3?",
        advice=f'density="{1e3 * density:g}" for {names}',
    )


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


def _from_geoms(robot: Robot) -> Finding | None:
    """Return the links whose stated mass the compiler replaces by that of their geoms; None without any."""
    spec = robot.spec
    from_geoms = int(mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE)
    if spec is None or int(spec.compiler.inertiafromgeom) != from_geoms:
        return None
    stating = {body.id: body.mass for body in spec.bodies if body.explicitinertial}
    stated_kg = sum(stating.values())
    total_kg = float(robot.model.body_mass[[*stating]].sum())
    if abs(total_kg - stated_kg) <= SAME_KG * stated_kg:
        return None
    return Finding(
        value=max(total_kg, stated_kg) / stated_kg,
        remark=f"{len(stating)} links have the mass of their geoms, {total_kg:.3g} kg, in place of the stated "
        f"{stated_kg:.3g} kg: inertiafromgeom",
        advice='<compiler inertiafromgeom="auto"/>',
    )


@row("robot-bound")
def _bound(robot: Robot) -> Finding:
    if found := _from_geoms(robot):
        return found
    spec = robot.spec
    if spec is None or not (spec.compiler.boundmass or spec.compiler.boundinertia):
        return Finding(declined="the model states neither boundmass nor boundinertia")
    bare = spec.copy()
    bare.compiler.boundmass = bare.compiler.boundinertia = 0.0
    try:
        model = bare.compile()
    except ValueError:
        return Finding(declined="without them a body has no mass: MuJoCo needs them")
    stated_kg = model.body_mass[robot.bodies]
    total_kg = float(stated_kg.sum())
    inertias = robot.model.body_inertia[robot.bodies].max(axis=1)
    stated_inertias = model.body_inertia[robot.bodies].max(axis=1)
    is_raised = inertias > 1.02 * stated_inertias
    raised = np.asarray(robot.bodies)[is_raised].tolist()
    weight = float(stated_kg[is_raised].sum()) / total_kg
    names = ", ".join(body_name(robot, body) for body in raised[:3])
    remark = f"{len(raised)} links have more inertia than their geoms or their inertial element state: {names}"
    return Finding(
        value=max(robot.mass_kg / total_kg - 1.0, weight),
        parts={body_name(robot, body): 1.0 for body in raised},
        remark=remark if raised else "",
        advice='<compiler boundmass="0" boundinertia="0"/>',
        changes={"compiler_boundmass": 0.0, "compiler_boundinertia": 0.0},
    )


@row("robot-gravcomp")
def _gravcomp(robot: Robot) -> Finding:
    model = robot.model
    lifted = [body for body in robot.bodies if model.body_gravcomp[body]]
    heavy = [body for body in robot.bodies if model.body_mass[body] > MASSLESS_KG]
    # A controller carries all that one link of a fixed base carries.
    beyond = [b for b in heavy if b not in lifted and model.body_parentid[b] in lifted]
    is_arm = not beyond and len(lifted) != 1
    if not robot.is_floating and (is_arm or len(lifted) == len(heavy)):
        return Finding(declined="a controller of a fixed base may carry its arm")
    share = float(
        (model.body_gravcomp * model.body_mass)[robot.bodies].sum() / robot.mass_kg
    )
    names = ", ".join(shortened([body_name(robot, body) for body in lifted]))
    weight_n = robot.mass_kg * GRAVITY_M_PER_S2
    return Finding(
        value=abs(share),
        parts={
            body_name(robot, body): abs(float(model.body_gravcomp[body]))
            for body in lifted
        },
        remark=f"{share * weight_n:.3g} N of {weight_n:.3g} N, of {names}"
        if lifted
        else "",
        advice=f'gravcomp="0" for {names}',
        changes={f"body_gravcomp[{body}]": 0.0 for body in lifted},
        is_usual=not robot.is_floating,
    )


@row("robot-inertia")
def _inertia(robot: Robot) -> Finding:
    low, high = limits_of("robot-inertia")
    found, worst, changes = Finding(declined="the shape of no link is known"), 0.0, {}
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
        share = (0.5 * reach_m / max(radius_m, 1e-9)) ** 2
        ratio = max(low * reach_m / max(radius_m, 1e-12), radius_m / reach_m / high)
        if ratio > 1.0:
            changes[f"body_inertia[{body}]"] = inertia * share
        if ratio > worst:
            worst = ratio
            found = Finding(
                value=radius_m / reach_m,
                remark=f"{name} of {mass_kg:.3g} kg: gyrates with {radius_m:.3g} m, and reaches {reach_m:.3g} m",
                advice=f"give {name} the inertia of its geoms, about {share:.2g} of the stated one",
                is_usual=radius_m < half_m,
            )
    if far:
        _, name, away_m, diagonal_m = max(far)
        return Finding(
            value=np.inf,
            parts=shares | {f"centre of mass of {one}": np.inf for _, one, *_ in far},
            remark=f"centre of mass of {name}: {away_m:.3g} m outside of a link of {diagonal_m:.2g} m",
            advice=f"the centre of mass of {name} in the frame of its body, in metres",
            is_usual=away_m < half_m,
        )
    if 2 * len(at_origin) > len(shares):
        return Finding(
            value=np.inf,
            parts=shares | {f"centre of mass of {one}": np.inf for one in at_origin},
            remark=f"the centres of mass of {len(at_origin)} of {len(shares)} links are the origins of their bodies, "
            "and their shapes lie beside them",
            advice="the `pos` of each `inertial`, from the data of its part",
            is_usual=True,
        )
    return replace(found, changes=changes, parts=shares)
