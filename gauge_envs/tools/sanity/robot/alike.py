"""Judge whether what a robot states of each joint and link is of the size of its others."""

from collections.abc import Iterator, Sequence

import numpy as np

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.phenomena.base import facts
from gauge_envs.tools.sanity.robot.copies import quantities
from gauge_envs.tools.sanity.robot.finding import (
    Finding,
    also,
    body_name,
    joint_name,
    row,
)
from gauge_envs.tools.sanity.robot.joints import (
    driven_dofs,
    joint_inertias,
    largest_weights_nm,
)
from gauge_envs.tools.sanity.robot.mass_rows import extent, is_link
from gauge_envs.tools.sanity.robot.robot import Robot

FACTS = facts("robot_alike")
"""Quantities, what they grow with from part to part, their largest factor, and the limits of the middle joint."""

FEW_PARTS = 4
"""Joints or links from which on a middle one says what the others are."""

FEW_WITHOUT = 0.2
"""Share of joints without damping up to which they have lost it; of dry friction, makers leave some out."""


def factors(values: FloatArray, scales: Sequence[FloatArray]) -> FloatArray:
    """Return by which factor each value is off the middle one, below 1 for a smaller one; NaN where it is not finite.

    It is the factor nearest to 1 of those of the values alone and over each scale, and 1 where these disagree.

    Args:
        values: Values of the parts of a robot, shape [count].
        scales: What the values grow with from part to part, shape [count] each.
    """
    several = []
    for scale in (np.ones(len(values)), *scales):
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = np.log(values) - np.log(scale)
        logs[~np.isfinite(logs)] = np.nan
        if np.isfinite(logs).sum() >= FEW_PARTS:
            several.append(logs - np.nanmedian(logs))
    if not several:
        return np.full(len(values), np.nan)
    every = np.array(several)
    above = np.fmin.reduce(every).clip(min=0.0)
    below = np.fmax.reduce(every).clip(max=0.0)
    found: FloatArray = np.exp(above + below)
    return found


def _drives(robot: Robot) -> tuple[list[str], dict[str, FloatArray]]:
    """Return the names and the quantities of driven hinges with limits: wheels and bases have other motors."""
    model = robot.model
    is_limited = model.jnt_limited[model.dof_jntid] != 0
    dofs = [dof for dof in driven_dofs(robot) if is_limited[dof]]
    known = quantities(robot) | {
        "inertia": joint_inertias(robot),
        "limb": joint_inertias(robot) - model.dof_armature,
        "weight": largest_weights_nm(robot),
    }
    names = [joint_name(robot, dof) for dof in dofs]
    named = {*FACTS["drives"], "inertia", "limb", "weight", "spring"}
    return names, {name: known[name][dofs] for name in named}


def middles(robot: Robot) -> Iterator[tuple[str, float]]:
    """Yield numbers of the middle joint that have limits, where enough joints have them."""
    _, known = _drives(robot)
    kp = np.where(known["kp"] > 0.0, known["kp"], np.nan)
    several = {
        "natural frequency [Hz]": np.sqrt(kp / known["inertia"]) / (2.0 * np.pi),
        "damping over kp [s]": known["damping"] / kp,
        "armature over limb": known["armature"] / known["limb"],
    }
    for name, values in several.items():
        stated = values[values > 0.0]
        if len(stated) >= FEW_PARTS:
            yield name, float(np.median(stated))


def _links(robot: Robot) -> tuple[list[str], dict[str, FloatArray]]:
    """Return the names and the quantities of links whose shape is known."""
    model = robot.model
    rooms = {body: extent(robot, body) for body in robot.bodies}
    bodies = [
        body
        for body, (room_m3, _, far_m) in rooms.items()
        if is_link(robot, body) and room_m3 > 0.0 and far_m > 0.0
    ]
    mass_kg = model.body_mass[bodies]
    geom_m3 = np.array([rooms[body][0] for body in bodies])
    volume_m3 = np.array([max(rooms[body][:2]) for body in bodies])
    reach_m = np.array([rooms[body][2] for body in bodies])
    return [body_name(robot, body) for body in bodies], {
        "mass": mass_kg,
        "inertia": model.body_inertia[bodies].sum(axis=1),
        "volume": volume_m3,
        "geom": geom_m3,
        "rod": mass_kg * reach_m**2,
        "cube": mass_kg * volume_m3 ** (2 / 3),
        "bulk": mass_kg ** (5 / 3),
    }


def unlike(robot: Robot) -> Iterator[tuple[str, str, float, float]]:
    """Yield a quantity, a joint or link, by which factor it is off the middle one, and the largest one that is usual.

    The factor is 0 where it alone has none.
    """
    for (names, known), grows in (
        (_drives(robot), FACTS["drives"]),
        (_links(robot), FACTS["links"]),
    ):
        for quantity, stated in grows.items():
            values = known[quantity]
            if len(values) < FEW_PARTS:
                continue
            several = factors(values, [known[scale] for scale in stated["grows_with"]])
            without = values == 0.0
            if quantity == "damping" and without.mean() <= FEW_WITHOUT:
                several = np.where(without, 0.0, several)
            for name, factor in zip(names, several.tolist(), strict=True):
                if np.isfinite(factor):
                    yield quantity, name, factor, stated["factor"]
    names, known = _drives(robot)
    springs = known["spring"]
    is_rare = 2 * np.count_nonzero(springs) < len(springs)
    is_odd = (springs > 0.0) & ((known["kp"] > 0.0) | is_rare)
    for place in np.flatnonzero(is_odd).tolist():
        yield "spring", names[place], np.inf, 1.0


@row("robot-alike")
def _alike(robot: Robot) -> Finding:
    parts: dict[str, float] = {}
    words: dict[str, str] = {}
    advices: dict[str, str] = {}
    for quantity, name, factor, largest in unlike(robot):
        part = f"{quantity} of {name}"
        off = factor if factor > 1.0 else 1.0 / max(factor, 1e-12)
        parts[part] = off / largest if factor else np.inf
        side = f"{factor:.2g} times" if factor > 1.0 else f"1/{off:.2g} of"
        words[part] = f"{part} is {side} the middle one" if factor else f"no {part}"
        if quantity == "spring":
            words[part] = f"a {part}, beside its motor"
    for name, value in middles(robot):
        low, high = FACTS["middle"][name]
        part = f"{name} of the middle joint"
        parts[part] = max(low / value, value / high)
        words[part] = f"{part} is {value:.2g}, not {low:g} to {high:g}"
        advices[part] = "kp in Nm/rad, kv in Nm s/rad, armature in kg m^2"
    if not parts:
        return Finding(
            declined=f"fewer than {FEW_PARTS} links, or hinges with a motor and limits"
        )
    worst = max(parts, key=parts.__getitem__)
    is_off = parts[worst] > 1.0
    return Finding(
        value=parts[worst],
        parts=parts,
        remark=words[worst] + also(parts, worst, 1.0) if is_off else "",
        advice=advices.get(
            worst, f"is {worst} in the unit of the others, and that of its part?"
        ),
    )
