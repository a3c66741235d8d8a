"""The causes that can make a model and a log part: a row each, with values, bounds, change, and lines to paste."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment

from gauge_envs.tools.replay.log import FloatArray
from gauge_envs.tools.replay.model import IntArray, Replayer, Setup

Field = tuple[str, Any, Any]
"""Path and index of an array of a setup, and its entries for values of 1."""

SNIPPETS = {
    "kp": {
        "MJCF": '<position joint="{name}" kp="{value:.4g}"/>',
        "Isaac Lab": "stiffness={numbers}",
        "mjlab": "stiffness={numbers}",
        "Playground": "m.actuator({name!r}).gainprm[0] = {value:.4g}; m.actuator({name!r}).biasprm[1] = -{value:.4g}",
    },
    "kd": {
        "MJCF": '<position joint="{name}" kv="{value:.4g}"/>',
        "Isaac Lab": "damping={numbers}",
        "mjlab": "damping={numbers}",
        "Playground": "m.actuator({name!r}).biasprm[2] = -{value:.4g}",
    },
    "effort limit": {
        "MJCF": '<position joint="{name}" forcerange="-{value:.4g} {value:.4g}"/>',
        "Isaac Lab": "effort_limit_sim={numbers}",
        "mjlab": "effort_limit={numbers}",
        "Playground": "m.actuator({name!r}).forcerange[:] = -{value:.4g}, {value:.4g}",
    },
    "armature": {
        "MJCF": '<joint name="{name}" armature="{value:.4g}"/>',
        "Isaac Lab": "armature={numbers}",
        "mjlab": "armature={numbers}",
        "Playground": "m.joint({name!r}).armature[:] = {value:.4g}",
    },
    "dry friction": {
        "MJCF": '<joint name="{name}" frictionloss="{value:.4g}"/>',
        "Isaac Lab": "friction={numbers}",
        "mjlab": "frictionloss={numbers}",
        "Playground": "m.joint({name!r}).frictionloss[:] = {value:.4g}",
    },
    "damping": {
        "MJCF": '<joint name="{name}" damping="{value:.4g}"/>',
        "Isaac Lab": "damping={numbers}",
        "mjlab": "damping={numbers}",
        "Playground": "m.joint({name!r}).damping[0] = {value:.4g}",
    },
    "action scale": {
        "Isaac Lab": "JointPositionActionCfg: scale={numbers}",
        "mjlab": "JointPositionActionCfg: scale={numbers}",
        "Playground": "action_scale of {name} = {value:.4g}",
    },
    "action offset": {
        "Isaac Lab": "JointPositionActionCfg: offset={numbers}",
        "mjlab": "JointPositionActionCfg: offset={numbers}",
    },
    "delay": {
        "MJCF": '<position delay="{value:.4g}" nsample="{samples}"/>',
        "Isaac Lab": "DelayedPDActuatorCfg(min_delay={steps}, max_delay={steps})",
        "mjlab": "BuiltinPositionActuatorCfg(delay_min_lag={steps}, delay_max_lag={steps})",
    },
    "gravity or tilt": {
        "MJCF": '<option gravity="{together}"/>',
        "Playground": "m.opt.gravity[:] = {together}",
    },
    "mass or centre of a link": {"MJCF": "<inertial .../> of {name}: {value:.4g}"},
    "payload": {
        "MJCF": '<geom type="sphere" size="0.01" mass="{value:.4g}"/> in the body {name}'
    },
    "joint limit": {"MJCF": '<joint range="..."/>: {name} {value:.4g}'},
    "floor friction": {
        "MJCF": '<geom friction="..."/>: first number times {value:.4g}'
    },
    "contact softness": {
        "MJCF": '<geom solref="..."/>: first number times {value:.4g}'
    },
}
"""Line to paste for a value of each cause, by stack. In Playground m is `self._mj_model`."""

DELAY_S = 0.02
"""Delay that matters."""
DELAYS = (-0.5, 0.25, 0.5, 1.0, 1.5, 2.25, 3.0, 4.5, 6.5, 9.0)
"""Delays from which the fit starts, over the one that matters: the error has several minima over the delay."""
EFFORTS = (0.15, 0.35, 0.65, 1.0)
"""Effort limits from which the fit starts, over the torque that the model needs in the log."""
CONTACTS = (-0.85, -0.7, -0.55, -0.4, -0.2, 0.5, 1.5, 4.0)
"""Changes of friction and of the time constant of contacts, over the present value."""
STEPS = (0.25, 0.5, 2.0, 2.5, 4.0, 5.0)
"""Physics steps that are tried, over the present one."""
REPEATS = (2, 3, 4)
MAX_TIMESTEP_S = 0.02
STOP = 0.05
"""Change of a stop that matters [rad or m]."""
STOPS = (-0.4, 0.4)
"""Places of a stop from which the fit starts, beyond the extreme of the motion, over the change that matters."""
LOAD_SAMPLES = 300
FAR = 40.0
"""Bound of a number of the fit, in units of its scale."""
MIN_SCALE = 1e-6
"""Scale of values that stay above zero and are zero now."""
MIN_FACTOR = 1e-3
"""Smallest value, over the present or typical one, of values that stay above zero."""


@dataclass(frozen=True)
class Group:
    """Values of a cause that change together.

    Attributes:
        label: `all` for a common number, `each` for several numbers, the text of an option without numbers.
        selection: Which number moves each value, shape [K, p].
    """

    label: str
    selection: FloatArray


@dataclass(frozen=True)
class Cause:
    """One candidate.

    Attributes:
        name: As `delay`.
        unit: Unit of the values.
        parameters: Names of the values, as joints; empty for an option.
        present: Values of the model as it is, shape [K].
        origin: Values where the numbers are zero, shape [K].
        scale: Change of each value for a number of 1, shape [K].
        minimum: Smallest values, shape [K].
        fields: Arrays that take the values.
        groups: What is fitted.
        starts: Numbers from which the fit starts where the error is not smooth at the present value.
    """

    name: str
    unit: str
    parameters: Sequence[str]
    present: FloatArray
    origin: FloatArray
    scale: FloatArray
    minimum: FloatArray
    fields: Sequence[Field]
    groups: Sequence[Group]
    starts: Sequence[float] = ()

    def values(self, group: Group, numbers: FloatArray) -> FloatArray:
        """Return all values for numbers of shape [p]."""
        is_moved = group.selection.any(axis=1)
        base = np.where(is_moved, self.origin, self.present)
        return base + self.scale * (group.selection @ numbers)

    def changed(self, setup: Setup, group: Group, numbers: FloatArray) -> Setup:
        """Return a changed copy of a setup."""
        after = copy.deepcopy(setup)
        values = self.values(group, numbers)
        for path, index, factor in self.fields:
            attrgetter(path)(after)[index] = factor * values
        after.model.opt.timestep = after.step_s[0]
        after.model.body_mass += after.payload - setup.payload
        mujoco.mj_setConst(after.model, mujoco.MjData(after.model))
        return after

    def lower(self, group: Group) -> FloatArray:
        """Return the smallest numbers of a group, shape [p]."""
        smallest = (self.minimum - self.origin) / self.scale
        by_number = np.where(group.selection.T > 0.0, smallest, -FAR)
        return np.maximum(by_number.max(axis=1), -FAR)


def candidates(replayer: Replayer, setup: Setup) -> list[Cause]:
    """Return the causes that a model and a log allow."""
    log, model, joints = replayer.log, setup.model, replayer.log.joints
    samples = np.linspace(0, len(log.time_s) - 1, LOAD_SAMPLES).astype(int)
    conditions, torques = replayer.conditions(setup, samples)
    # Torques and speeds of the joints that the log often has.
    load = np.maximum(np.percentile(np.abs(torques), 95, axis=0), 1e-4)
    speed = np.maximum(np.percentile(np.abs(log.velocity), 95, axis=0), 1e-3)
    inertia, rate = 0.3 * model.dof_M0[replayer.dof], 0.3 * load / speed
    armature = ("model.dof_armature", replayer.dof, 1.0)
    friction = ("model.dof_frictionloss", replayer.dof, 1.0)
    damping = ("model.dof_damping", replayer.dof, 1.0)
    sides = [f"{joint} {side}" for side in ("lower", "upper") for joint in joints]
    places = np.tile(replayer.joint, 2), np.repeat((0, 1), len(joints))
    extremes = np.percentile(log.position, (2.0, 98.0), axis=0).ravel()
    rows = [
        _row(setup, "armature", "kg m^2", joints, inertia, armature),
        _row(setup, "dry friction", "N m", joints, 0.1 * load, friction),
        _row(setup, "damping", "N m s/rad", joints, rate, damping),
        *_bodies(setup),
        _row(
            setup,
            "joint limit",
            "rad",
            sides,
            STOP,
            ("model.jnt_range", places, 1.0),
            start=(extremes, STOPS),
            selections=_alone(len(sides)),
            is_positive=False,
        ),
        *_timing(setup),
    ]
    driven = np.flatnonzero(np.append(setup.is_driven, False)[replayer.actuator])
    if len(driven):
        rows += _drives(replayer, setup, driven, load[driven], speed.max())
    if (conditions == "contact").any():
        rows += _contacts(setup)
    return rows


def _row(
    setup: Setup,
    name: str,
    unit: str,
    parameters: Sequence[str],
    typical: ArrayLike,
    *fields: Field,
    start: tuple[ArrayLike, Sequence[float]] | None = None,
    selections: Sequence[FloatArray] = (),
    is_positive: bool = True,
) -> Cause:
    """Return a cause whose values are fitted.

    Args:
        setup: The model.
        name: Name of the cause.
        unit: Unit of the values.
        parameters: Names of the values.
        typical: Change that matters. It is the scale of small values, of values that may be negative, and of causes
            with starts; others have their present value as the scale.
        *fields: Path, index and factor of the arrays of the setup that take the values.
        start: Values where the numbers are zero, and numbers from which the fit starts; by default the present values
            and a single start.
        selections: Selections of the groups. By default, each value alone, all with one number, and all with a number
            each.
        is_positive: Whether values stay above zero.
    """
    path, index, factor = fields[0]
    present = attrgetter(path)(setup)[index] / factor
    scale = np.full(len(present), typical)
    if is_positive and not start:
        scale = np.where(present > 0.2 * scale, present, scale)
    origin, starts = start or (present, ())
    minimum = scale * (MIN_FACTOR if is_positive else -np.inf)
    groups = [
        Group("all" if selection.shape[1] == 1 else "each", selection)
        for selection in selections or _selections(len(present))
    ]
    origin = np.full(len(present), origin)
    return Cause(
        name, unit, parameters, present, origin, scale, minimum, fields, groups, starts
    )


def _alone(count: int, size: int = 1) -> list[FloatArray]:
    """Return the selections of each value, or of `size` neighbours with a number each, alone."""
    return np.split(np.eye(count), count // size, axis=1)


def _selections(count: int) -> list[FloatArray]:
    """Return the selections of each value alone, of all by one number, and of all by a number each."""
    together = [np.ones((count, 1)), np.eye(count)] if count > 1 else []
    return _alone(count) + together


def _option(name: str, label: str, path: str, index: Any, values: ArrayLike) -> Cause:
    """Return a cause without numbers, which gives values to an array."""
    one, group = np.ones(1), Group(label, np.zeros((1, 0)))
    return Cause(name, "", (), one, one, one, one, [(path, index, values)], [group])


def _bodies(setup: Setup) -> list[Cause]:
    """Return gravity, mass and centre of each link that moves, and a load on the first one and on each end."""
    model = setup.model
    bodies = np.flatnonzero((model.body_weldid > 0) & (model.body_mass > 0.0))
    names = [model.body(body).name or f"body {body}" for body in bodies]
    count = len(names)
    mass, inertia = model.body_mass[bodies], model.body_inertia[bodies].T
    size = np.maximum(np.sqrt(inertia.sum(axis=0) / mass), 0.01)
    ends = np.union1d(0, np.flatnonzero(~np.isin(bodies, model.body_parentid[bodies])))
    # A payload may be heavier than the link that carries it.
    load = 0.02 * model.body_mass.sum()
    # A tilt of the base turns gravity.
    eye = np.eye(3)
    tilts = [eye[:, 2:], eye[:, :2], eye]
    axes = np.repeat(bodies, 3), np.tile(range(3), count)
    masses = ("model.body_mass", bodies, 1.0)
    inertias = ("model.body_inertia", (bodies, np.c_[:3]), inertia / mass)
    link = "mass or centre of a link"
    return [
        _row(
            setup,
            "gravity or tilt",
            "m/s^2",
            ["gravity x", "gravity y", "gravity z"],
            1.0,
            ("model.opt.gravity", np.s_[:], 1.0),
            selections=tilts,
            is_positive=False,
        ),
        _row(
            setup,
            link,
            "kg",
            names,
            MIN_SCALE,
            masses,
            inertias,
            selections=_selections(count)[: count + 1],
        ),
        _row(
            setup,
            link,
            "m",
            [f"{name} {axis}" for name in names for axis in "xyz"],
            np.repeat(size, 3),
            ("model.body_ipos", axes, 1.0),
            selections=_alone(3 * count, 3),
            is_positive=False,
        ),
        _row(
            setup,
            "payload",
            "kg",
            [names[end] for end in ends],
            load,
            ("payload", bodies[ends], 1.0),
            selections=_alone(len(ends)),
        ),
    ]


def _drives(
    replayer: Replayer, setup: Setup, driven: IntArray, load: FloatArray, speed: float
) -> list[Cause]:
    """Return gains, effort limit, and scale, offset, order and delay of the commands of driven joints."""
    model, ids = setup.model, replayer.actuator[driven]
    names = [replayer.log.joints[joint] for joint in driven]
    upper = ("model.actuator_forcerange", (ids, 1), 1.0)
    lower = ("model.actuator_forcerange", (ids, 0), -1.0)
    gain = ("model.actuator_gainprm", (ids, 0), 1.0)
    stiffness = ("model.actuator_biasprm", (ids, 1), -1.0)
    damping = ("model.actuator_biasprm", (ids, 2), -1.0)
    scale, offset = ("scale", ids, 1.0), ("offset", ids, 1.0)
    delay, start = ("delay_s", [0], 1.0), (0.0, DELAYS)
    is_servo = model.actuator_biasprm[ids, 1].any()
    unit, shift = ("rad", 0.05) if is_servo else ("N m", 0.1 * load)
    rows = [
        _row(
            setup,
            "effort limit",
            "N m",
            names,
            load,
            upper,
            lower,
            start=(0.0, EFFORTS),
        ),
        _row(setup, "action scale", "", names, MIN_SCALE, scale),
        _row(setup, "action offset", unit, names, shift, offset, is_positive=False),
        _row(
            setup,
            "delay",
            "s",
            ["delay"],
            DELAY_S,
            delay,
            start=start,
            is_positive=False,
        ),
        *_order(replayer, setup, driven),
    ]
    if is_servo:
        rate = 0.3 * load / speed
        rows.append(_row(setup, "kp", "N m/rad", names, MIN_SCALE, stiffness, gain))
        rows.append(_row(setup, "kd", "N m s/rad", names, rate, damping))
    return rows


def _order(replayer: Replayer, setup: Setup, driven: IntArray) -> list[Cause]:
    """Return the order and signs of the commands that correlate best with the motion, if they are new."""
    log, ids = replayer.log, replayer.actuator[driven]
    rows = np.searchsorted(setup.command_time_s, log.time_s, "right") - 1
    motion = log.position.T
    if log.command_kind == "tau":
        motion = np.gradient(log.velocity.T, log.time_s, axis=1)
    series = np.vstack([motion[driven], setup.command.T[np.ix_(ids, rows)]])
    # A constant has no correlation; the trend avoids a division by zero.
    match = np.corrcoef(series + 1e-9 * np.arange(len(rows)))[: len(ids), len(ids) :]
    order = linear_sum_assignment(np.abs(match), maximize=True)[1]
    signs = np.sign(match[range(len(ids)), order])
    label = ", ".join(
        f"{log.joints[joint]} follows {'' if sign > 0.0 else 'minus '}{log.joints[other]}"
        for joint, other, sign in zip(driven, driven[order], signs, strict=True)
        if other != joint or sign < 0.0
    )
    mixed = signs * setup.command[:, ids[order]]
    option = _option("joint order", label, "command", np.s_[:, ids], mixed)
    return [option] if label else []


def _timing(setup: Setup) -> list[Cause]:
    """Return other physics steps, and controllers that take only each n-th change of the command."""
    name, every = "step and decimation", np.s_[:]
    rows = []
    for step_s in setup.step_s * STEPS:
        if step_s <= MAX_TIMESTEP_S:
            label = f"physics step of {1e3 * step_s:.3g} ms"
            rows.append(_option(name, label, "step_s", every, step_s))
    if not setup.is_driven.any():
        return rows
    is_new = np.diff(setup.command, axis=0).any(axis=1)
    changes, samples = np.flatnonzero(is_new) + 1, np.arange(len(setup.command))
    for n in REPEATS:
        for k in range(n):
            # The first command holds until the first one that the controller takes.
            taken = np.append(0, changes[k::n])
            latest = taken[np.searchsorted(taken, samples, "right") - 1]
            label = f"only each {n}. command is used, from number {k + 1} on"
            held = setup.command[latest]
            rows.append(_option(name, label, "command", every, held))
    return rows


def _contacts(setup: Setup) -> list[Cause]:
    """Return friction and softness of all contacts, as factors."""
    columns = {
        "floor friction": {"model.geom_friction": 1, "model.pair_friction": 2},
        "contact softness": {"model.geom_solref": 1, "model.pair_solref": 1},
    }
    one, groups = np.ones(1), [Group("all", np.eye(1))]
    rows = []
    for name, counts in columns.items():
        fields = [
            (path, np.s_[:, :count], attrgetter(path)(setup)[:, :count])
            for path, count in counts.items()
        ]
        least = MIN_FACTOR * one
        row = Cause(
            name, "", ["factor"], one, one, one, least, fields, groups, CONTACTS
        )
        rows.append(row)
    return rows
