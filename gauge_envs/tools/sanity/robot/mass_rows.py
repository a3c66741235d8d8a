"""Judge the masses and inertias that a model states."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import mujoco
import numpy as np

from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.tools.sanity.robot.joints import Case, reaches_m, root_of, worst_case
from gauge_envs.tools.sanity.robot.mujoco_feet import geom_name
from gauge_envs.tools.sanity.robot.robot import Robot, once
from gauge_envs.tools.sanity.rows import Finding, NotApplicableError, row

LEAD_KG_PER_M3, OSMIUM_KG_PER_M3 = 12_000.0, 22_600.0
"""Density of lead and of the densest metal [kg/m^3]: no link of a robot is denser than the first."""

POINT_KG_PER_M3 = 10.0 * OSMIUM_KG_PER_M3
"""Density of a geom whose mass is stated, from which on it stands for no idealized point mass [kg/m^3]."""

TRIANGLE = 1e-3
"""Part by which the largest moment of inertia may exceed the sum of the others: that of rounded numbers."""

SINGLE = 3.0
"""Size of a body without joints over that of its geoms."""

LEAST_SHARE = 1e-3
"""Share of the robot's mass below which nothing depends on the inertia of a link."""

UNSTATED_KG_PER_M3 = 1000.0
"""Density of a geom that states none [kg/m^3]."""

DRAWN_TWICE = 0.05
"""Mass of drawn geoms on colliding ones over that of their bodies without them."""


@row(
    "robot-mass",
    title="density, inertia or mass of a body, over that of a real body",
    unit="1",
    interval=(0.0, 1.0),
    source="lead 12,000 and osmium 22,600 kg/m^3; a ball of osmium has the least inertia of its mass; no mass is "
    "farther away than the robot reaches; what is drawn and collides weighs once",
    consequence="The policy learns forces and speeds that belong to another robot.",
)
def mass(robot: Robot) -> Finding:
    """Return the body whose mass properties are farthest beyond those of a real body."""
    if not robot.bodies:
        raise NotApplicableError("no body of the model moves")
    cases = [case for body in robot.bodies for case in _body_cases(robot, body)]
    return worst_case([*cases, *_stated_inertias(robot), *_drawn_twice(robot)])


def _name(robot: Robot, body: int) -> str:
    return robot.model.body(body).name or f"body {body}"


def _body_cases(robot: Robot, body: int) -> Iterator[Case]:
    model, name, place = robot.model, _name(robot, body), ("body", body)
    mass_kg = float(model.body_mass[body])
    tree_kg = float(model.body_subtreemass[root_of(model, body)])
    if mass_kg <= 0.0 or mass_kg < LEAST_SHARE * tree_kg:
        return
    is_robot = int(model.body_treeid[body]) in robot.driven_trees
    for density, limit in _densities(robot, body):
        text = f"{name} weighs {mass_kg:.3g} kg: {density:.3g} kg/m^3, denser than any "
        text += "link" if limit == LEAD_KG_PER_M3 else "metal"
        yield Case(density / limit, place, name, f"{text} ({limit:g})", not is_robot)
    moments = np.sort(model.body_inertia[body])
    trace = float(moments.sum())
    radius_m = (3.0 * mass_kg / (4.0 * np.pi * OSMIUM_KG_PER_M3)) ** (1.0 / 3.0)
    # Of all bodies of a mass and a largest density a ball has the least trace of inertia, 3 * 0.4 m r^2.
    least = 1.2 * mass_kg * radius_m**2
    # Geoms of a toy may stand for point masses.
    if body not in _weighing(robot):
        text = f"{name} of {mass_kg:.3g} kg has inertias of {moments.mean():.2g} kg m^2, smaller than a ball of osmium"
        text += f" of this mass ({least / 3.0:.2g})"
        yield Case(least / max(trace, 1e-300), place, name, text)
    root = root_of(model, body)
    reach_m = float(reaches_m(robot)[root])
    # The geom of a single body may hold the place of a larger shape.
    reach_m *= 1.0 if int(model.tree_bodynum[model.body_treeid[body]]) > 1 else SINGLE
    if reach_m > 0.0:
        gyration_m, away_m = (
            float(np.sqrt(0.5 * trace / mass_kg)),
            length_of(model.body_ipos[body]),
        )
        text = f"{name} of {mass_kg:.3g} kg gyrates with {gyration_m:.3g} m, the robot reaches {reach_m:.2g} m"
        yield Case(gyration_m / reach_m, place, name, text)
        text = f"{name} has its centre of mass {away_m:.3g} m from its origin; the robot reaches {reach_m:.2g} m"
        yield Case(0.5 * away_m / reach_m, place, name, text)
    yield from _triangle(name, body, moments)


def _triangle(name: str, body: int, moments: FloatArray) -> Iterator[Case]:
    """Yield moments of inertia in rising order [kg m^2] the last of which is larger than the sum of the others."""
    first, second, third = moments.tolist()
    excess = third / max(first + second, 1e-300) / (1.0 + TRIANGLE)
    if third > 0.0:
        text = f"{name} has inertias {first:.3g}, {second:.3g} and {third:.3g} kg m^2: "
        text += "one is above the sum of the others"
        yield Case(excess, ("body", body), name, text)


@once
def _weighing(robot: Robot) -> dict[int, list[mujoco.MjsGeom]]:
    """Return the geoms of each body that give it its mass; bodies that state theirs are left out."""
    geoms: dict[int, list[mujoco.MjsGeom]] = {}
    for body in () if robot.spec is None else robot.spec.bodies:
        if not body.explicitinertial:
            geoms[body.id] = list(body.geoms)
    return geoms


def _densities(robot: Robot, body: int) -> Iterator[tuple[float, float]]:
    """Yield the density of geoms that give a body its mass, and its limit [kg/m^3].

    Geoms of a body that states its mass itself may hold the place of its shape.
    """
    model = robot.model
    is_link = int(model.tree_bodynum[model.body_treeid[body]]) > 1
    for geom in _weighing(robot).get(body, []):
        box_m3 = 8.0 * float(model.geom_aabb[geom.id, 3:].prod())
        if not np.isfinite(geom.mass):
            yield float(geom.density), LEAD_KG_PER_M3 if is_link else OSMIUM_KG_PER_M3
        elif is_link and box_m3:
            yield float(geom.mass) / box_m3, POINT_KG_PER_M3


def _stated_inertias(robot: Robot) -> Iterator[Case]:
    """Yield inertias of a file that no body has, and which the compiler balances."""
    for described in () if robot.spec is None else robot.spec.bodies:
        if described.id in robot.bodies and described.explicitinertial:
            yield from _triangle(
                _name(robot, described.id),
                described.id,
                np.sort(np.abs(described.inertia)),
            )


# --- drawn twice -----------------------------------------------------------------------------------------------------


def _drawn_twice(robot: Robot) -> Iterator[Case]:
    """Yield bodies whose mass counts a part twice: once for the geom that collides, and once for its mesh as drawn."""
    spec, model = robot.spec, robot.model
    if spec is None:
        return
    solid = (model.geom_contype | model.geom_conaffinity) != 0
    solid[[*model.pair_geom1.tolist(), *model.pair_geom2.tolist()]] = True
    doubled: dict[int, list[int]] = {}
    for body, geoms in _weighing(robot).items():
        felt = [geom.id for geom in geoms if solid[geom.id]]
        for geom in geoms:
            # A drawn part that states its mass or density is meant to weigh, unless it is the twin of a solid one.
            is_silent = (
                not np.isfinite(geom.mass) and geom.density == UNSTATED_KG_PER_M3
            )
            within = 0.5 if is_silent else 0.01
            is_drawn = not solid[geom.id] and body in robot.bodies
            if is_drawn and any(
                _is_alike(model, geom.id, other, within) for other in felt
            ):
                doubled.setdefault(body, []).append(geom.id)
    if not doubled:
        return
    silent = {geom for several in doubled.values() for geom in several}
    bare = spec.copy()
    for geom, original in zip(bare.geoms, spec.geoms, strict=True):
        if original.id in silent:
            geom.mass = 0.0
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            masses = bare.compile().body_mass
    except ValueError:
        return
    for body, several in doubled.items():
        extra_kg = float(model.body_mass[body] - masses[body])
        text = (
            f"{_name(robot, body)} weighs {model.body_mass[body]:.3g} kg, {extra_kg:.3g} of which is "
            f"{geom_name(model, several[0])}, which is drawn where others collide"
        )
        yield Case(
            extra_kg / max(float(masses[body]), 1e-9) / DRAWN_TWICE,
            ("body", body),
            _name(robot, body),
            text,
        )


def _is_alike(model: mujoco.MjModel, drawn: int, solid: int, within: float) -> bool:
    """Return whether two geoms of a body differ in size and place by less than a part of their size."""
    size_m = float(model.geom_rbound[solid])
    apart_m = length_of(model.geom_pos[drawn] - model.geom_pos[solid])
    return max(apart_m, abs(float(model.geom_rbound[drawn]) - size_m)) < within * size_m
