"""Check the masses and inertias of a model."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import mujoco
import numpy as np

from gauge_envs.scene.geometry import length_of
from gauge_envs.tools.sanity.model_checks.check import (
    Case,
    Finding,
    model_check,
    worst_case,
)
from gauge_envs.tools.sanity.robot.robot import (
    Robot,
    chain_of,
    geom_name,
    name_of,
    reaches_m,
    root_of,
)
from gauge_envs.tools.sanity.verdict import NotApplicableError

LEAD_KG_PER_M3, OSMIUM_KG_PER_M3 = 12_000.0, 22_600.0
"""Density of lead and of the densest metal [kg/m^3]: no link of a robot is denser than the first."""

POINT_KG_PER_M3 = 1e6
"""Density of a geom with a given mass above which it is no idealized point mass [kg/m^3].

A link of 1000 kg/m^3 has this density when its mass is in grams.
"""

TRIANGLE = 1e-3
"""Share by which the largest moment of inertia may exceed the sum of the others, because of rounding."""

SINGLE = 3.0
"""Largest size of a body without joints over the size of its geoms."""

MIN_SHARE = 1e-3
"""Share of the robot's mass below which nothing depends on the inertia of a link."""

DEFAULT_KG_PER_M3 = 1000.0
"""Default density of a geom [kg/m^3]."""

DRAWN_TWICE = 0.05
"""Largest mass of drawn geoms on colliding ones over the mass of their bodies without them."""


@model_check(
    "robot-mass",
    title="density, inertia or mass, over that of real bodies",
    interval=(0.0, 1.0),
    source="lead 12,000 and osmium 22,600 kg/m^3; a ball of osmium has the least inertia of its mass; no mass is "
    "farther away than the robot reaches; what is drawn and collides weighs once",
    consequence="The policy learns forces and speeds of another robot.",
)
def mass(robot: Robot) -> Finding:
    """Return the body whose mass properties most exceed those of a real body."""
    if not robot.bodies:
        raise NotApplicableError("no body of the model moves")
    by_id = {body.id: body for body in robot.spec.bodies} if robot.spec else {}
    cases = (
        case
        for body in robot.bodies
        for case in _body_cases(robot, body, by_id.get(body))
    )
    return worst_case([*cases, *_drawn_twice(robot)])


def is_overweight(robot: Robot, body: int) -> bool:
    """Return whether a body carries one whose mass fails this check."""
    model, ratios = robot.model, mass.finding(robot).parts
    return any(
        ratios.get(name_of(model, "body", carried), 0.0) > 1.0
        for carried in robot.bodies
        if body in chain_of(model, carried)
    )


def _body_cases(
    robot: Robot, body: int, described: mujoco.MjsBody | None
) -> Iterator[Case]:
    """Yield the mass properties of a body, and those of its file, which the compiler balances."""
    model, name, place = robot.model, name_of(robot.model, "body", body), ("body", body)
    mass_kg, root = model.body_mass[body], root_of(model, body)
    inertias, weighs = [model.body_inertia[body]], described is not None
    if described is not None and described.explicitinertial:
        inertias, weighs = [*inertias, described.inertia], False
    for moments in inertias:
        first, second, third = np.sort(np.abs(moments)).tolist()
        if third:
            excess = third / max(first + second, 1e-300) / (1.0 + TRIANGLE)
            text = f"{name} has inertias {first:.3g}, {second:.3g} and {third:.3g} kg m^2: one exceeds the others' sum"
            yield Case(excess, place, name, text)
    if mass_kg <= 0.0 or mass_kg < MIN_SHARE * model.body_subtreemass[root]:
        return
    is_robot = int(model.body_treeid[body]) in robot.driven_trees
    is_link = int(model.tree_bodynum[model.body_treeid[body]]) > 1
    for geom in described.geoms if described is not None and weighs else ():
        # Geoms of a body with a mass of its own may stand for another shape.
        density, limit = geom.density, LEAD_KG_PER_M3 if is_link else OSMIUM_KG_PER_M3
        if np.isfinite(geom.mass):
            box_m3 = 8.0 * model.geom_aabb[geom.id, 3:].prod()
            density, limit = geom.mass / (box_m3 or np.inf), POINT_KG_PER_M3
        if is_link or not np.isfinite(geom.mass):
            kind = "link" if limit == LEAD_KG_PER_M3 else "metal"
            text = f"{name} weighs {mass_kg:.3g} kg: {density:.3g} kg/m^3, denser than any {kind} ({limit:g})"
            yield Case(density / limit, place, name, text, not is_robot)
    trace = model.body_inertia[body].sum()
    # Of all bodies of a mass and a largest density, a ball has the smallest trace of inertia, 3 * 0.4 m r^2.
    # Geoms of a toy may stand for point masses.
    if not weighs:
        radius_m = np.cbrt(3.0 * mass_kg / (4.0 * np.pi * OSMIUM_KG_PER_M3))
        minimum = 1.2 * mass_kg * radius_m**2
        text = f"{name} of {mass_kg:.3g} kg has inertias of {trace / 3.0:.2g} kg m^2, "
        text += f"smaller than a ball of osmium ({minimum / 3.0:.2g})"
        yield Case(minimum / max(trace, 1e-300), place, name, text)
    # The geom of a single body may stand for a larger shape.
    reach_m = reaches_m(robot)[root] * (1.0 if is_link else SINGLE)
    if reach_m > 0.0:
        gyration_m = np.sqrt(0.5 * trace / mass_kg)
        text = f"{name} of {mass_kg:.3g} kg gyrates with {gyration_m:.3g} m, the robot reaches {reach_m:.2g} m"
        yield Case(gyration_m / reach_m, place, name, text)
        away_m = length_of(model.body_ipos[body])
        text = f"{name} has its centre of mass {away_m:.3g} m away, the robot reaches {reach_m:.2g} m"
        yield Case(0.5 * away_m / reach_m, place, name, text)


# --- drawn twice -----------------------------------------------------------------------------------------------------


def _drawn_twice(robot: Robot) -> Iterator[Case]:
    """Yield bodies whose mass counts a part twice: for the geom that collides, and for its drawn mesh."""
    spec, model = robot.spec, robot.model
    if spec is None:
        return
    solid = (model.geom_contype | model.geom_conaffinity) != 0
    solid[[*model.pair_geom1.tolist(), *model.pair_geom2.tolist()]] = True
    bare, doubled = spec.copy(), dict[int, int]()
    for copied, geom in zip(bare.geoms, spec.geoms, strict=True):
        body = int(model.geom_bodyid[geom.id])
        twins = solid & (model.geom_bodyid == body)
        if solid[geom.id] or body not in robot.bodies or geom.parent.explicitinertial:
            continue
        sizes_m = model.geom_rbound[twins]
        apart_m = np.linalg.norm(
            model.geom_pos[geom.id] - model.geom_pos[twins], axis=1
        )
        larger_m = np.abs(model.geom_rbound[geom.id] - sizes_m)
        # A drawn part with a given mass or density is meant to weigh, unless it is the twin of a solid part.
        is_silent = not np.isfinite(geom.mass) and geom.density == DEFAULT_KG_PER_M3
        within_m = (0.5 if is_silent else 0.01) * sizes_m
        if (np.maximum(apart_m, larger_m) < within_m).any():
            copied.mass = 0.0
            doubled.setdefault(body, geom.id)
    if not doubled:
        return
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            masses = bare.compile().body_mass
    except ValueError:
        return
    for body, drawn in doubled.items():
        name, extra_kg = (
            name_of(model, "body", body),
            model.body_mass[body] - masses[body],
        )
        text = f"{name} weighs {model.body_mass[body]:.3g} kg: {geom_name(model, drawn)}, which is drawn, adds "
        text += f"{extra_kg:.3g}"
        ratio = extra_kg / max(masses[body], 1e-9) / DRAWN_TWICE
        yield Case(ratio, ("body", body), name, text)
