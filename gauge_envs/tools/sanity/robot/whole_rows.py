"""Judge the robot as a whole: its size, masses that count twice, its medium, and friction that resists turning."""

import warnings
from dataclasses import replace

import mujoco
import numpy as np

from gauge_envs.backends.mujoco.model_settings import COLUMNS
from gauge_envs.pages.text import vector_text
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.tools.sanity.robot.finding import (
    Finding,
    body_name,
    limits_of,
    row,
)
from gauge_envs.tools.sanity.robot.ground_rows import (
    fingers,
    geoms_of,
    pair_name,
)
from gauge_envs.tools.sanity.robot.mass_rows import box_corners, size_m
from gauge_envs.tools.sanity.robot.mujoco_feet import (
    first_moving_body,
    geom_name,
)
from gauge_envs.tools.sanity.robot.robot import Robot, joints_of_motors

UNSTATED_KG_PER_M3 = 1000.0
"""Density of a geom that states none [kg/m^3]."""

SAME_PLACE = 0.3
"""Overlap of the boxes around two sets of geoms, over the box around both, from which on they show the same part."""

VISCOUS_LENGTH_M = 0.1
"""Size of a link, by which the viscosity of a medium becomes a pressure at 1 m/s [m]."""

LEAST_TIP_M = 0.0025
"""Size below which a geom is a point of a larger pad; MuJoCo's default torsional friction of 5 mm fits it [m]."""

MOST_TORSION_M = 0.1
"""Torsional or rolling friction from which on, beyond the sliding one, the three are in another order [m]."""


@row("robot-size")
def _size(robot: Robot) -> Finding:
    if not robot.bodies:
        return Finding(declined="the model has no robot")
    diagonal_m = size_m(robot)
    if not diagonal_m:
        return Finding(declined="the robot has no shape")
    unit = "millimetres" if diagonal_m > 1.0 else "kilometres"
    return Finding(
        value=diagonal_m,
        remark=f"{robot.mass_kg:.3g} kg",
        advice=f"lengths in metres, not in {unit}: `pos`, `size`, `fromto` and the `scale` of meshes",
    )


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
        advice='mass="0" for visual geoms, or <compiler inertiagrouprange> of the others',
        changes={f"geom_mass[{geom}]": 0.0 for geom in counted},
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


@row("robot-medium")
def _medium(robot: Robot) -> Finding:
    model, option = robot.model, robot.model.opt
    wind = length_of(option.wind)
    pressure_pa = 0.5 * float(option.density) * (1.0 + wind) ** 2
    pressure_pa += float(option.viscosity) / VISCOUS_LENGTH_M
    root = first_moving_body(model, robot.bodies[0]) if robot.bodies else 0
    first = int(model.body_jntadr[root])
    joints = set(range(first, first + int(model.body_jntnum[root])))
    is_fixed = bool(joints & set(joints_of_motors(model).tolist()))
    swims = robot.standing is None and not is_fixed
    medium = f"density {option.density:g} kg/m^3, viscosity {option.viscosity:g} Pa s"
    return Finding(
        value=pressure_pa,
        remark=f"{medium}, wind {wind:g} m/s" if pressure_pa else "",
        advice='<option density="0" viscosity="0" wind="0 0 0"/>, or those of air: 1.2 and 0.000018',
        changes={"density": 0.0, "viscosity": 0.0, "wind": np.zeros(3)},
        advisory="a robot that neither stands nor is driven from a fixed base swims or flies"
        if swims
        else "",
    )


@row("robot-torsion")
def _torsion(robot: Robot) -> Finding:
    model, pairs = robot.model, robot.pairs
    _, largest = limits_of("robot-torsion")
    friction = model.geom_friction
    is_turned = friction[:, 1:].max(axis=1) > np.maximum(friction[:, 0], MOST_TORSION_M)
    is_turned &= np.isin(model.geom_bodyid, robot.bodies)
    turned = [g for g in np.unique(pairs.geoms).tolist() if is_turned[g]]
    if turned:
        several = [geom_name(model, geom) for geom in turned]
        return Finding(
            value=2.0 * largest,
            parts=dict.fromkeys(several, 2.0 * largest),
            remark=f"{several[0]}: friction {vector_text(friction[turned[0]])}, as in another order",
            advice=f"friction (sliding, torsional, rolling) of {', '.join(several[:3])}",
        )
    rows = robot.foot_rows
    if not rows:
        tips = {geom for body in fingers(robot) for geom in geoms_of(robot, body)}
        touching = [bool(tips & set(two)) for two in pairs.geoms.tolist()]
        rows = np.flatnonzero(touching).tolist()
    if not rows:
        return Finding(declined="no foot and no finger of the robot can touch")
    levers: dict[str, float] = {}
    changes: dict[str, FloatArray] = {}
    worst, found = -1.0, Finding()
    for number in rows:
        condim = int(pairs.constants[number, 0])
        friction = pairs.constants[number, COLUMNS["friction"]]
        torsion_m = float(friction[2]) if condim >= 4 else 0.0
        rolling_m = float(friction[3:].max()) if condim >= 6 else 0.0
        two = pairs.geoms[number].tolist()
        parts = [geom for geom in two if int(model.geom_bodyid[geom]) in robot.bodies]
        reach_m = min(float(model.geom_rbound[geom]) or np.inf for geom in parts or two)
        reach_m = max(reach_m, LEAST_TIP_M)
        lever = max(torsion_m, rolling_m) / max(reach_m, 1e-6)
        names = pair_name(robot, number)
        levers[names] = lever
        if lever > largest:
            # The larger friction of two geoms counts.
            fair = np.array([friction[0], 0.005, 0.0001])
            changes |= {f"geom_friction[{geom}]": fair for geom in two}
        if lever > worst:
            worst = lever
            kind = "torsional" if torsion_m >= rolling_m else "rolling"
            found = Finding(
                value=lever,
                parts=levers,
                remark=f"{names}: {kind} friction {max(torsion_m, rolling_m):g} m on {1e3 * reach_m:.3g} mm",
                advice=f'friction="{friction[0]:g} 0.005 0.0001" for {names}'
                + (" and pairs like it" if len(rows) > 1 else ""),
            )
    return replace(found, changes=changes)
