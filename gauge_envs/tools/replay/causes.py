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
from scipy.interpolate import make_interp_spline
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

DELAYS_S = (-0.01, 0.005, 0.01, 0.02, 0.03, 0.045, 0.06, 0.09, 0.13, 0.18)
"""Delays from which the fit starts: the error has several minima over the delay."""
EFFORTS = (0.12, 0.2, 0.35, 0.5, 0.7, 0.9, 1.3)
"""Effort limits from which the fit starts, over the torque that the model needs in the log."""
CONTACTS = (-0.85, -0.7, -0.55, -0.4, -0.2, 0.5, 1.5, 4.0)
"""Changes of friction and of the time constant of contacts, over the present value."""
STEPS = (0.25, 0.5, 2.0, 2.5, 4.0, 5.0)
"""Physics steps that are tried, over the present one."""
REPEATS = (2, 3, 4)
MAX_TIMESTEP_S = 0.02
STOPS = (0.0, -0.02, 0.02)
"""Places of a stop from which the fit starts, beyond the extreme of the motion [rad or m]."""
LOAD_SAMPLES = 300
FAR = 40.0
"""Bound of a number of the fit, in units of its scale."""
MIN_FACTOR = 1e-3
"""Smallest value, over the present or typical one, of values that stay above zero."""


@dataclass(frozen=True)
class Group:
    """Values of a cause that change together: `base + scale * (selection @ numbers)`.

    Attributes:
        label: `all` for a common number, `each` for a number a value, the text of an option without numbers.
        selection: Which number moves each value, shape [K, p].
        base: Values where all numbers are zero, shape [K].
    """

    label: str
    selection: FloatArray
    base: FloatArray


@dataclass(frozen=True)
class Cause:
    """One candidate.

    Attributes:
        name: As `delay`.
        unit: Unit of the values.
        parameters: Names of the values, as joints.
        present: Values of the model as it is, shape [K].
        scale: Change of each value for a number of 1, shape [K].
        fields: Arrays that take the values.
        groups: What is fitted.
        is_positive: Whether values stay above zero.
        starts: Numbers from which the fit starts where the error is not smooth at the present value.
    """

    name: str
    unit: str
    parameters: Sequence[str]
    present: FloatArray
    scale: FloatArray
    fields: Sequence[Field]
    groups: Sequence[Group]
    is_positive: bool = True
    starts: Sequence[float] = ()

    def values(self, group: Group, numbers: FloatArray) -> FloatArray:
        """Return all values for numbers of shape [p]."""
        return group.base + self.scale * (group.selection @ numbers)

    def changed(self, setup: Setup, group: Group, numbers: FloatArray) -> Setup:
        """Return a changed copy of a setup."""
        after = copy.deepcopy(setup)
        values = self.values(group, numbers)
        for path, index, factor in self.fields:
            attrgetter(path)(after)[index] = (np.transpose(factor) * values).T
        after.model.opt.timestep = after.timing[0]
        after.model.body_mass += after.payload - setup.payload
        mujoco.mj_setConst(after.model, mujoco.MjData(after.model))
        return after

    def lower(self, group: Group) -> FloatArray:
        """Return the smallest numbers of a group, shape [p]."""
        smallest = MIN_FACTOR - group.base / self.scale if self.is_positive else -FAR
        return (group.selection * np.c_[smallest]).max(
            axis=0, initial=-FAR, where=group.selection > 0.0
        )


def _row(
    setup: Setup,
    name: str,
    unit: str,
    parameters: Sequence[str],
    typical: ArrayLike,
    *fields: Field,
    **others: Any,
) -> Cause:
    """Return a cause.

    Args:
        setup: The model.
        name: Name of the cause.
        unit: Unit of the values.
        parameters: Names of the values.
        typical: Size that matters; the unit of the numbers is this or the present value.
        fields: Path, index and factor of the arrays of the setup that take the values.
        others: `origin`, values where the numbers are zero, which are the present ones by default; `indices`, the
            values of each group, which is each value alone by default; `together`, the further groups; attributes of
            the cause that differ.
    """
    count = len(parameters)
    if "present" not in others:
        path, index, factor = fields[0]
        others["present"] = attrgetter(path)(setup)[index] / factor
    present = others["present"]
    scale = np.maximum(np.broadcast_to(typical, count), 1e-6)
    if others.get("is_positive", True) and "origin" not in others:
        scale = np.where(present > 0.2 * scale, present, scale)
    origin, eye = others.pop("origin", present), np.eye(count)
    selections = [("", eye[:, index]) for index in others.pop("indices", np.c_[:count])]
    together = others.pop("together", ("all", "each"))
    if count > 1:
        every = {"all": eye.sum(axis=1, keepdims=True), "each": eye}
        selections += [(label, every[label]) for label in together]
    groups = [
        Group(label, selection, np.where(selection.any(axis=1), origin, present))
        for label, selection in selections
    ]
    defaults = {"scale": scale, "fields": fields, "groups": groups}
    return Cause(name, unit, parameters, **(defaults | others))


def candidates(replayer: Replayer, setup: Setup) -> list[Cause]:
    """Return the causes that a model and a log allow."""
    log, model, dofs = replayer.log, setup.model, replayer.dof
    samples = np.linspace(0, len(log.time_s) - 1, LOAD_SAMPLES).astype(int)
    conditions, torques = replayer.conditions(setup, samples)
    # Torques and speeds of the joints that the log often has.
    load = np.maximum(np.percentile(np.abs(torques), 95, axis=0), 1e-4)
    speed = np.maximum(np.percentile(np.abs(log.velocity), 95, axis=0), 1e-3)
    # In newer versions damping is a polynomial, whose first coefficient is the linear one.
    damping = dofs if model.dof_damping.ndim == 1 else (dofs, 0)
    rows = [
        _row(setup, name, unit, log.joints, typical, (f"model.dof_{field}", index, 1.0))
        for name, unit, typical, field, index in (
            ("armature", "kg m^2", 0.3 * model.dof_M0[dofs], "armature", dofs),
            ("dry friction", "N m", 0.1 * load, "frictionloss", dofs),
            ("damping", "N m s/rad", 0.3 * load / speed, "damping", damping),
        )
    ]
    rows += [*_bodies(setup), _stops(replayer, setup), _time(replayer, setup)]
    driven = np.flatnonzero(np.append(setup.is_driven, False)[replayer.actuator])
    if len(driven):
        rows += _drives(replayer, setup, driven, load[driven], speed.max())
    if (conditions == "contact").any():
        rows += _contacts(setup)
    return [row for row in rows if row.groups]


def _drives(
    replayer: Replayer, setup: Setup, driven: IntArray, load: FloatArray, speed: float
) -> list[Cause]:
    """Return gains, effort limit, and scale, offset, order and delay of the commands of driven joints."""
    model, ids = setup.model, replayer.actuator[driven]
    names = [replayer.log.joints[joint] for joint in driven]
    gear = np.abs(model.actuator_gear[ids, 0])
    limit, law = "model.actuator_forcerange", "model.actuator_biasprm"
    limits = (limit, (ids, 1), 1.0 / gear), (limit, (ids, 0), -1.0 / gear)
    gain = ("model.actuator_gainprm", (ids, 0), 1.0 / gear**2)
    stiffness, damping = (
        (law, (ids, 1), -1.0 / gear**2),
        (law, (ids, 2), -1.0 / gear**2),
    )
    is_servo = model.actuator_biasprm[ids, 1].any()
    unit, offset = ("rad", 0.05) if is_servo else ("N m", 0.1 * load)
    scales, offsets, delay = (
        ("scale", ids, 1.0),
        ("offset", ids, 1.0),
        ("delay_s", [0], 1.0),
    )
    rows = [
        _row(
            setup,
            "effort limit",
            "N m",
            names,
            load,
            *limits,
            origin=0.0 * load,
            starts=EFFORTS,
        ),
        _row(setup, "action scale", "", names, 0.0, scales),
        _row(setup, "action offset", unit, names, offset, offsets, is_positive=False),
        _row(
            setup,
            "delay",
            "s",
            ["delay"],
            1.0,
            delay,
            is_positive=False,
            starts=DELAYS_S,
        ),
        _orders(replayer, setup, driven),
    ]
    if is_servo:
        rows.append(_row(setup, "kp", "N m/rad", names, 0.0, stiffness, gain))
        rows.append(_row(setup, "kd", "N m s/rad", names, 0.3 * load / speed, damping))
    return rows


def _orders(replayer: Replayer, setup: Setup, driven: IntArray) -> Cause:
    """Return the order and signs of the commands that correlate best with the motion."""
    log, ids = replayer.log, replayer.actuator[driven]
    names = [log.joints[joint] for joint in driven]
    count = len(names)
    command = make_interp_spline(setup.command_time_s, setup.command, k=1)(log.time_s)
    motion = log.position.T[driven]
    if log.command_kind == "tau":
        motion = np.gradient(log.velocity.T[driven], log.time_s, axis=1)
    # A constant has no correlation; the trend avoids a division by zero.
    series = np.vstack([motion, command.T[ids]]) + 1e-9 * np.arange(len(log.time_s))
    match = np.corrcoef(series)[:count, count:]
    order = linear_sum_assignment(-np.abs(match))[1]
    signs = np.sign(match[range(count), order])
    mixing = np.eye(count)[:, order] * signs
    label = ", ".join(
        f"{names[k]} follows {'' if signs[k] > 0.0 else 'minus '}{names[order[k]]}"
        for k in np.flatnonzero(np.diag(mixing) != 1.0)
    )

    mixed = ("mixing", (np.repeat(ids, count), np.tile(ids, count)), 1.0)
    option = Group(label, np.zeros((count**2, 0)), mixing.ravel())
    present = np.eye(count).ravel()
    groups = [option] if label else []
    return Cause("joint order", "", (), present, present**0, [mixed], groups)


def _bodies(setup: Setup) -> list[Cause]:
    """Return gravity, mass and centre of each link that moves, and a load on the first one and on each end."""
    model = setup.model
    bodies = np.flatnonzero((model.body_weldid > 0) & (model.body_mass > 0.0))
    names = [model.body(int(body)).name or f"body {body}" for body in bodies]
    mass, inertia = model.body_mass[bodies], model.body_inertia[bodies]
    size = np.maximum(np.sqrt(inertia.sum(axis=1) / mass), 0.01)
    masses = ("model.body_mass", bodies, 1.0)
    inertias = ("model.body_inertia", bodies, inertia / mass[:, None])
    axes = np.arange(3 * len(bodies)).reshape(-1, 3)
    centre = ("model.body_ipos", (np.repeat(bodies, 3), axes.ravel() % 3), 1.0)
    is_end = ~np.isin(bodies, model.body_parentid[bodies])
    is_end[:1] = True
    ends = np.array(names)[is_end].tolist()

    down = ("model.opt.gravity", np.s_[:], 1.0)
    directions = [f"gravity {axis}" for axis in "xyz"]
    link, free = "mass or centre of a link", {"together": (), "is_positive": False}
    places = [f"{name} {axis}" for name in names for axis in "xyz"]
    # A tilt of the base turns gravity.
    tilts = [2], [0, 1], [0, 1, 2]
    # The scale is 2 % of the mass of the robot, because a payload may be heavier than the link that carries it.
    load = 0.02 * model.body_mass.sum()
    return [
        _row(
            setup,
            "gravity or tilt",
            "m/s^2",
            directions,
            1.0,
            down,
            indices=tilts,
            **free,
        ),
        _row(setup, link, "kg", names, 0.0, masses, inertias, together=["all"]),
        _row(
            setup,
            link,
            "m",
            places,
            np.repeat(size, 3),
            centre,
            indices=[*axes],
            **free,
        ),
        _row(
            setup,
            "payload",
            "kg",
            ends,
            load,
            ("payload", bodies[is_end], 1.0),
            together=(),
        ),
    ]


def _time(replayer: Replayer, setup: Setup) -> Cause:
    """Return the physics step and the decimation."""
    step_s = float(setup.model.opt.timestep)
    options = [
        (f"physics step of {1e3 * factor * step_s:.3g} ms", (factor * step_s, 1, 0))
        for factor in STEPS
        if factor * step_s <= MAX_TIMESTEP_S
    ]
    options += [
        (f"only each {n}. command is used, from number {k + 1} on", (step_s, n, k))
        for n in (REPEATS if replayer.log.command_kind else ())
        for k in range(n)
    ]
    groups = [Group(label, np.zeros((3, 0)), np.array(each)) for label, each in options]
    timing = ("timing", np.s_[:], 1.0)
    present = setup.timing
    return Cause("step and decimation", "", (), present, present**0, [timing], groups)


def _stops(replayer: Replayer, setup: Setup) -> Cause:
    """Return the stops of the joints, which the fit starts near the extremes of the motion."""
    log, ids = replayer.log, replayer.joint
    names = [f"{name} {side}" for side in ("lower", "upper") for name in log.joints]
    stop = ("model.jnt_range", (np.tile(ids, 2), np.repeat((0, 1), len(ids))), 1.0)
    extremes = np.percentile(log.position, (2.0, 98.0), axis=0).ravel()
    return _row(
        setup,
        "joint limit",
        "rad",
        names,
        1.0,
        stop,
        origin=extremes,
        together=(),
        is_positive=False,
        starts=STOPS,
    )


def _contacts(setup: Setup) -> list[Cause]:
    """Return friction and softness of all contacts, as factors."""

    def row(name: str, *places: tuple[str, Any]) -> Cause:
        fields = [(path, at, attrgetter(path)(setup)[at].copy()) for path, at in places]
        factor = {"present": np.ones(1), "starts": CONTACTS}
        return _row(setup, name, "", ["factor"], 1.0, *fields, **factor)

    first, sliding = np.s_[:, 0], np.s_[:, :2]
    friction = ("model.geom_friction", first), ("model.pair_friction", sliding)
    softness = ("model.geom_solref", first), ("model.pair_solref", first)
    return [row("floor friction", *friction), row("contact softness", *softness)]
