"""Static rules: what the file states and MuJoCo does not do."""

from collections.abc import Iterator

import mujoco
import numpy as np

from gauge_envs.backends.mujoco.contact_table import COLUMNS, PairKind, can_move
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.model_checks.check import Fault, rule
from gauge_envs.tools.sanity.robot.robot import (
    Robot,
    free_objects,
    geom_name,
    name_of,
    switched_off,
)

# --- contacts --------------------------------------------------------------------------------------------------------

LOST_FRICTION = 2.0
"""Friction of a contact over the smaller one that a geom states, from which on the latter is said to be lost."""

DEFAULT_FRICTION = 1.0


@rule(
    "stated-friction",
    title="stated friction that is not used",
    source="MuJoCo takes the greater friction of two geoms of equal priority, other engines the mean or product",
    consequence="What should slip grips: give the geom priority, or the contact a pair.",
)
def friction(robot: Robot) -> Iterator[Fault]:
    """Yield geoms whose stated friction loses against a greater one in each contact with what is fixed."""
    model, pairs = robot.model, robot.pairs
    if switched_off(model, "contact"):
        return
    used = pairs.constants[:, 1] * (pairs.constants[:, 0] > 1)
    stated = model.geom_friction[:, 0]
    fixed = np.flatnonzero(pairs.kinds < PairKind.MOVING)
    for side in (0, 1):
        geoms = pairs.geoms[fixed, side]
        lost = used[fixed] >= LOST_FRICTION * np.maximum(stated[geoms], 1e-3)
        lost &= stated[geoms] < DEFAULT_FRICTION
        for row, geom in zip(fixed[lost], geoms[lost], strict=True):
            other = pairs.geoms[row, 1 - side]
            name, ratio = geom_name(model, geom), used[row] / stated[geom]
            met = f"{used[row]:g} on {geom_name(model, other)}"
            text = f"{name} states friction {stated[geom]:g}; its contact has {met}"
            yield Fault(("geom", int(geom)), name, text, ratio, change=("priority", 1))


def _constraints(robot: Robot) -> Iterator[tuple[str, int, FloatArray]]:
    """Yield kind, id and constants of geoms that can collide, explicit pairs, equalities and limits that are on."""
    model = robot.model
    elements = (
        ("geom", "geom", "contact", np.unique(robot.pairs.geoms)),
        ("pair", "pair", "contact", np.arange(model.npair)),
        ("equality", "eq", "equality", np.arange(model.neq)),
        ("joint", "jnt", "limit", np.flatnonzero(model.jnt_limited)),
    )
    for kind, prefix, feature, numbers in elements:
        arrays = [getattr(model, f"{prefix}_{key}") for key in ("solref", "solimp")]
        if not switched_off(model, feature):
            for number in numbers.tolist():
                yield kind, number, np.hstack([array[number] for array in arrays])


@rule(
    "stated-solref",
    title="time constants below two steps",
    source="MuJoCo raises the time constant of a constraint to two steps, unless refsafe is off",
    consequence="Contacts are softer than the file says.",
)
def solref(robot: Robot) -> Iterator[Fault]:
    """Yield elements whose time constant MuJoCo raises by more than a tenth."""
    model = robot.model
    least_s = 2.0 * model.opt.timestep
    if switched_off(model, "refsafe"):
        return
    for kind, number, constants in _constraints(robot):
        if 0.0 < constants[0] < least_s / 1.1:
            name = name_of(model, kind, number)
            text = f"a step of {500 * least_s:g} ms raises solref of {name} from {constants[0]:.3g} to {least_s:g} s"
            yield Fault((kind, number), name, text, least_s / constants[0])


MAX_IMPEDANCE = 0.9999
"""Largest impedance of MuJoCo, to which it clips solimp."""


@rule(
    "stated-solimp",
    title="impedance that falls with depth",
    source="MuJoCo: solimp is dmin, dmax, width, midpoint, power; dmin is at most dmax",
    consequence="A contact gets softer the deeper it is.",
)
def solimp(robot: Robot) -> Iterator[Fault]:
    """Yield elements whose impedance at the surface exceeds that in the depth."""
    for kind, number, constants in _constraints(robot):
        low, high = np.minimum(constants[2:4], MAX_IMPEDANCE).tolist()
        if low > high:
            name = name_of(robot.model, kind, number)
            text = f"{name} has solimp {low:g} at the surface and {high:g} in the depth: exchange the two"
            right = "solimp", [high, low, *constants[4:]]
            yield Fault((kind, number), name, text, low / max(high, 1e-9), change=right)


MAX_MARGIN_M = 0.002
"""Distance at which contacts may act [m]: the clearance of a printed joint."""


@rule(
    "stated-margin",
    title="contacts that act at a distance",
    source="MuJoCo: a contact acts from its margin on, the sum of those of two geoms; a gap only detects it earlier",
    consequence="Bodies float above what they rest on.",
)
def margin(robot: Robot) -> Iterator[Fault]:
    """Yield moving geoms that touch what is fixed before they meet it."""
    model, pairs = robot.model, robot.pairs
    if switched_off(model, "contact"):
        return
    ahead_m = pairs.constants[:, COLUMNS["margin"]][:, 0]
    is_ahead = (ahead_m > MAX_MARGIN_M) & (pairs.kinds < PairKind.MOVING)
    for row in np.flatnonzero(is_ahead):
        other, geom = sorted(
            pairs.geoms[row].tolist(), key=model.geom_bodyid.__getitem__
        )
        name, ratio = geom_name(model, geom), ahead_m[row] / MAX_MARGIN_M
        text = f"{name} stops {1e3 * ahead_m[row]:.4g} mm ahead of {geom_name(model, other)}, by its margin"
        for wider in filter(model.geom_margin.__getitem__, (other, geom)):
            place = "geom", wider
            yield Fault(
                ("geom", geom), name, text, ratio, change=("margin", 0.0), changed=place
            )


TORSION, ROLLING = 0.005, 0.0001
"""Default torsional and rolling friction of a geom [m]."""

FLAT = (int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_MESH))
"""Types of geoms that do not roll."""


@rule(
    "stated-rolling",
    title="friction that condim ignores",
    source="MuJoCo: sliding friction acts with condim 3 and more, torsional with 4 and 6, rolling with 6",
    consequence="What should stop slides, turns or rolls on.",
)
def rolling(robot: Robot) -> Iterator[Fault]:
    """Yield geoms and pairs with friction that their condim ignores: of geoms, rolling counts for round free bodies."""
    model, condims = robot.model, _condims(robot)
    if switched_off(model, "contact"):
        return
    stated, moves = model.geom_friction, can_move(model)
    rolls = np.isin(model.geom_bodyid, free_objects(model))
    rolls &= ~np.isin(
        model.geom_bodyid, model.geom_bodyid[np.isin(model.geom_type, FLAT)]
    )
    slides = moves & (stated[:, 0] > 0.0)
    ignored = {
        "sliding": (0, slides & (stated[:, 0] != DEFAULT_FRICTION) & (condims == 1)),
        "rolling": (2, rolls & (stated[:, 2] > 2.0 * ROLLING) & (condims < 6)),
        "torsional": (1, moves & (stated[:, 1] > 10.0 * TORSION) & (condims < 4)),
    }
    for word, (column, is_ignored) in ignored.items():
        for geom in np.flatnonzero(is_ignored & (condims > 0)).tolist():
            name = geom_name(model, geom)
            text = f"{name} states {word} friction {stated[geom, column]:g}, which condim {condims[geom]:g} ignores"
            right = "condim", {"sliding": 3, "rolling": 6, "torsional": 4}[word]
            yield Fault(("geom", geom), name, text, change=right)
    for pair in np.flatnonzero(model.pair_dim < 6).tolist():
        value_m, condim = model.pair_friction[pair, 3:].max(), model.pair_dim[pair]
        if value_m > 2.0 * ROLLING:
            text = f"pair {pair} states rolling friction {value_m:g}, which condim {condim} ignores"
            yield Fault(("pair", pair), f"pair {pair}", text)


def _condims(robot: Robot) -> FloatArray:
    """Return the largest condim of the contacts of each geom, shape [ngeom]."""
    condims = np.zeros(robot.model.ngeom)
    np.maximum.at(condims, robot.pairs.geoms, robot.pairs.constants[:, :1])
    return condims


# --- actuators and gravity compensation ------------------------------------------------------------------------------


@rule(
    "stated-gear",
    title="actuators without effect",
    source="MuJoCo: the force of an actuator is gain times control, times gear",
    consequence="The joint does not follow its commands.",
)
def gear(robot: Robot) -> Iterator[Fault]:
    """Yield actuators with a gear, a gain without a bias, or a range of forces of zero."""
    model = robot.model
    is_fixed = model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED
    is_idle = ~model.actuator_gear.any(axis=1)
    is_idle |= is_fixed & ~np.hstack(
        [model.actuator_gainprm, model.actuator_biasprm]
    ).any(axis=1)
    is_idle |= (model.actuator_forcelimited != 0) & ~model.actuator_forcerange.any(
        axis=1
    )
    for number in np.flatnonzero(is_idle).tolist():
        name = name_of(model, "actuator", number)
        text = f"actuator {name} makes no force: gear {model.actuator_gear[number, 0]:g}, gain "
        text += f"{model.actuator_gainprm[number, 0]:g}"
        yield Fault(("actuator", number), name, text)


FLOATING = 0.5
"""Share of a robot's weight that nothing may carry: the arm of a mobile robot may be balanced."""


@rule(
    "stated-gravcomp",
    title="gravity compensation of a robot that stands",
    source="a robot on feet carries its weight",
    consequence="The robot floats.",
)
def gravcomp(robot: Robot) -> Iterator[Fault]:
    """Yield standing robots most of whose weight gravity does not pull."""
    model, carried = robot.model, robot.model.body_gravcomp > 0.0
    weight = model.body_mass[robot.bodies]
    share = float(weight @ model.body_gravcomp[robot.bodies] / max(weight.sum(), 1e-12))
    if robot.standing and share > FLOATING:
        body = next(body for body in robot.bodies if carried[body])
        name = name_of(model, "body", body)
        text = f"{name} has gravcomp {model.body_gravcomp[body]:g}: nothing carries {share:.0%} of the robot's weight"
        yield Fault(("body", body), name, text, share, share > 0.9, ("gravcomp", 0.0))
