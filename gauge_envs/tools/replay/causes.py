"""The causes that can make a model and a log part: a row each, with values, bounds, change, and lines to paste."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment

from gauge_envs.tools.replay.log import FloatArray
from gauge_envs.tools.replay.model import IntArray, Setup
from gauge_envs.tools.replay.predict import Replayer

Change = Callable[[Setup, FloatArray], None]
Field = tuple[str, Any, Any]

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
CONTACTS = (-0.7, -0.4, 0.5, 1.5, 4.0)
"""Changes of friction and of the time constant of contacts, over the present value."""
CLOCKS = (0.5, 0.8, 0.9, 1.1, 1.25, 2.0)
STEPS = (0.25, 0.5, 2.0, 2.5, 4.0, 5.0)
"""Physics steps that are tried, over the present one."""
REPEATS = (2, 3, 4)
MAX_TIMESTEP_S = 0.02
MAX_MOVES = 6
"""Number of swapped and mirrored joints that are tried."""
MIN_DWELL = 0.05
"""Fraction of the samples at an extreme of a joint from which on it may be a stop."""
MAX_DELAY_S = 0.4
LOAD_SAMPLES = 300
FAR = 40.0
"""Bound of a number of the fit, in units of its scale."""


@dataclass(frozen=True)
class Group:
    """Values that change together.

    Attributes:
        label: What changes, as the name of a joint; `all` for a common number, `each` for a number a joint.
        index: Values that change, shape [p].
        is_shared: Whether one number moves all of them.
        option: All values, where nothing is fitted, shape [K].
    """

    label: str
    index: IntArray
    is_shared: bool = False
    option: FloatArray | None = None

    @property
    def size(self) -> int:
        """Count of the numbers of the fit."""
        return 1 if self.is_shared else len(self.index)


@dataclass(frozen=True)
class Cause:
    """One candidate. A value that moves is `origin + scale * x`, where the fit moves the number x.

    Attributes:
        name: As `delay`.
        unit: Unit of the values.
        parameters: Names of the values, as joints.
        present: Values of the model as it is, shape [K].
        origin, scale: See above, shape [K].
        lower, upper: Bounds of the numbers, shape [K].
        apply: Changes a setup to values of shape [K].
        groups: What is fitted.
        starts: Numbers from which the fit starts where the error is not smooth at the present value.
    """

    name: str
    unit: str
    parameters: Sequence[str]
    present: FloatArray
    origin: FloatArray
    scale: FloatArray
    lower: FloatArray
    upper: FloatArray
    apply: Change
    groups: Sequence[Group]
    starts: Sequence[float] = ()

    def values(self, group: Group, numbers: FloatArray) -> FloatArray:
        """Return all values for numbers of shape [p]."""
        if group.option is not None:
            return group.option
        values, moved = self.present.copy(), group.index
        values[moved] = self.origin[moved] + self.scale[moved] * numbers
        return values

    def changed(self, setup: Setup, group: Group, numbers: FloatArray) -> Setup:
        """Return a changed copy of a setup."""
        after = copy.deepcopy(setup)
        self.apply(after, self.values(group, numbers))
        mujoco.mj_setConst(after.model, mujoco.MjData(after.model))
        return after

    def bounds(self, group: Group) -> tuple[FloatArray, FloatArray]:
        """Return the bounds of the numbers of a group."""
        lower, upper = self.lower[group.index], self.upper[group.index]
        if group.is_shared:
            return lower.max(keepdims=True), upper.min(keepdims=True)
        return lower, upper


def _assign(*fields: Field) -> Change:
    """Return a change of fields of a setup: the entries of each take a factor times the values."""

    def apply(setup: Setup, values: FloatArray) -> None:
        for path, index, factor in fields:
            attrgetter(path)(setup)[index] = factor * values

    return apply


def _groups(labels: Sequence[str]) -> list[Group]:
    """Return a group for each value."""
    return [Group(label, np.array([k])) for k, label in enumerate(labels)]


def _row(
    name: str,
    unit: str,
    parameters: Sequence[str],
    present: ArrayLike,
    typical: ArrayLike,
    apply: Change,
    **others: Any,
) -> Cause:
    """Return a row; by default values are free, alone, or share a number, whose zero is the present value.

    Args:
        name: Name of the cause.
        unit: Unit of the values.
        parameters: Names of the values.
        present: Values of the model.
        typical: Change that matters, the unit of the numbers.
        apply: Changes a setup.
        others: Further attributes of the cause.
    """
    count = len(parameters)
    present, scale = (np.broadcast_to(each, count) * 1.0 for each in (present, typical))
    groups, every = _groups(parameters), np.arange(count)
    if count > 1:
        groups += [Group("all", every, is_shared=True), Group("each", every)]
    far = np.full(count, FAR)
    defaults = {"origin": present, "lower": -far, "upper": far, "groups": groups}
    return Cause(
        name,
        unit,
        parameters,
        present,
        scale=scale,
        apply=apply,
        **{**defaults, **others},
    )


def _positive(
    setup: Setup,
    name: str,
    unit: str,
    parameters: Sequence[str],
    typical: ArrayLike,
    *fields: Field,
    **others: Any,
) -> Cause:
    """Return a row of fields whose values stay positive; its numbers are fractions of the present or typical value."""
    path, index, factor = fields[0]
    present = attrgetter(path)(setup)[index] / factor
    scale = np.where(present > 0.2 * np.asarray(typical), present, typical)
    others = {"lower": -present / scale, **others}
    return _row(name, unit, parameters, present, scale, _assign(*fields), **others)


def candidates(replayer: Replayer, setup: Setup) -> list[Cause]:
    """Return the causes that a model and a log allow."""
    log = replayer.log
    samples = np.linspace(0, len(log.time_s) - 1, LOAD_SAMPLES).astype(int)
    conditions, torques = replayer.conditions(setup, samples)
    load = np.maximum(np.percentile(np.abs(torques), 95, axis=0), 1e-4)
    rows = [
        *_joints(replayer, setup, load),
        *_drives(replayer, setup, load),
        *_bodies(setup.model),
        _stops(replayer, setup.model),
        _time(replayer, setup),
    ]
    if (conditions == "contact").any():
        rows += _contacts(setup)
    return [row for row in rows if row.groups]


def _joints(replayer: Replayer, setup: Setup, load: FloatArray) -> list[Cause]:
    """Return armature, dry friction and damping of the joints."""
    log, model, dofs = replayer.log, setup.model, replayer.places.dof
    speed = np.maximum(np.percentile(np.abs(log.velocity), 95, axis=0), 1e-3)
    # In newer versions damping is a polynomial, whose first coefficient is the linear one.
    damping = dofs if model.dof_damping.ndim == 1 else (dofs, 0)
    table = (
        ("armature", "kg m^2", 0.3 * model.dof_M0[dofs], "model.dof_armature", dofs),
        ("dry friction", "N m", 0.1 * load, "model.dof_frictionloss", dofs),
        ("damping", "N m s/rad", 0.3 * load / speed, "model.dof_damping", damping),
    )
    return [
        _positive(setup, name, unit, log.joints, typical, (path, index, 1.0))
        for name, unit, typical, path, index in table
    ]


def _drives(replayer: Replayer, setup: Setup, load: FloatArray) -> list[Cause]:
    """Return gains, effort limit, and scale, offset, order and delay of the commands."""
    log, model, places = replayer.log, setup.model, replayer.places
    sources = np.append(setup.source, -1)[places.actuator]
    driven = np.flatnonzero(sources >= 0)
    if not len(driven):
        return []
    ids = places.actuator[driven]
    names = [log.joints[joint] for joint in driven]
    load, gear = load[driven], model.actuator_gear[ids, 0]
    speed = max(np.percentile(np.abs(log.velocity), 95, axis=0).max(), 1e-3)
    per_joint = 1.0 / gear**2
    effort = (
        ("model.actuator_forcerange", (ids, 1), 1.0 / np.abs(gear)),
        ("model.actuator_forcerange", (ids, 0), -1.0 / np.abs(gear)),
    )
    kp = (
        ("model.actuator_gainprm", (ids, 0), per_joint),
        ("model.actuator_biasprm", (ids, 1), -per_joint),
    )
    kd = ("model.actuator_biasprm", (ids, 2), -per_joint)
    is_servo = model.actuator_biasprm[ids, 1].any()
    unit, offset = ("rad", 0.05) if is_servo else ("N m", 0.1 * load)
    earliest_s = np.array([-2.0 * log.command_interval_s])
    rows = [
        _row(
            "effort limit",
            "N m",
            names,
            model.actuator_forcerange[ids, 1] * np.abs(gear),
            load,
            _assign(*effort),
            origin=0.0 * load,
            lower=np.full(len(ids), 0.02),
            starts=EFFORTS,
        ),
        _positive(setup, "action scale", "", names, 0.0, ("scale", ids, 1.0)),
        _row(
            "action offset",
            unit,
            names,
            setup.offset[ids],
            offset,
            _assign(("offset", ids, 1.0)),
        ),
        _row(
            "delay",
            "s",
            ["delay"],
            0.0,
            1.0,
            _assign(("delay_s", [0], 1.0)),
            lower=earliest_s,
            upper=MAX_DELAY_S * np.ones(1),
            starts=DELAYS_S,
        ),
        _orders(replayer, setup, driven),
    ]
    if is_servo:
        rows += [
            _positive(setup, "kp", "N m/rad", names, 0.0, *kp),
            _positive(setup, "kd", "N m s/rad", names, 0.3 * load / speed, kd),
        ]
    return rows


def _orders(replayer: Replayer, setup: Setup, driven: IntArray) -> Cause:
    """Return each joint mirrored, and the order and signs of the commands that correlate best with the motion."""
    log = replayer.log
    ids = replayer.places.actuator[driven]
    names = [log.joints[joint] for joint in driven]
    count = len(names)
    commands = [
        np.interp(log.time_s, log.command_time_s, log.command[:, k])
        for k in setup.source[ids]
    ]
    motion = log.position.T[driven]
    if log.command_kind == "tau":
        motion = np.gradient(log.velocity.T[driven], log.time_s, axis=1)
    # A constant has no correlation; the trend avoids a division by zero.
    trend = 1e-9 * np.arange(len(log.time_s))
    match = np.corrcoef(motion + trend, commands + trend)[:count, count:]
    same = np.arange(count)
    order = linear_sum_assignment(-np.abs(match))[1]
    signs = np.sign(match[same, order])
    options = {
        f"{name} mirrored": (same, 1.0 - 2.0 * row)
        for name, row in zip(names, np.eye(count), strict=True)
    }
    label = ", ".join(
        f"{names[i]} follows {names[order[i]]}" for i in same[order != same]
    )
    if label:
        options |= {label: (order, same**0), f"{label}, with signs": (order, signs)}

    def apply(after: Setup, values: FloatArray) -> None:
        taken = ids[values[:count].astype(int)]
        after.source[ids], after.origin[ids] = setup.source[taken], setup.origin[taken]
        after.sign[ids] = values[count:]

    groups = [
        Group(label, same[:0], option=np.concatenate(each))
        for label, each in options.items()
    ]
    return _row("joint order", "", (), 0.0, 0.0, apply, groups=groups)


def _bodies(model: mujoco.MjModel) -> list[Cause]:
    """Return gravity, mass and centre of each link that moves, and a load on the first one and on each end."""
    bodies = np.flatnonzero((model.body_weldid > 0) & (model.body_mass > 0.0))
    names = [model.body(int(body)).name or f"body {body}" for body in bodies]
    mass, inertia = model.body_mass[bodies], model.body_inertia[bodies]
    fields = [("model.body_mass", bodies, 1.0)]
    fields += [
        ("model.body_inertia", (bodies, axis), inertia[:, axis] / mass)
        for axis in range(3)
    ]
    every = np.arange(len(bodies))
    masses = [
        Group("all masses", every, is_shared=True),
        *_groups([f"mass of {name}" for name in names]),
    ]
    centre = (
        "model.body_ipos",
        (np.repeat(bodies, 3), np.tile(np.arange(3), len(bodies))),
        1.0,
    )
    centres = [
        Group(f"centre of {name}", 3 * k + np.arange(3)) for k, name in enumerate(names)
    ]
    axes = [f"{name} {axis}" for name in names for axis in "xyz"]
    size = np.maximum(np.sqrt(inertia.sum(axis=1) / mass), 0.01)
    is_end = ~np.isin(bodies, model.body_parentid[bodies])
    is_end[:1] = True
    ends, carried = bodies[is_end], mass[is_end]
    loaded = [names[k] for k in np.flatnonzero(is_end)]

    def load(after: Setup, values: FloatArray) -> None:
        after.model.body_mass[ends] = carried + values

    # A tilt of the base turns gravity.
    moves = {"size": [2], "tilt": [0, 1], "size and tilt": [0, 1, 2]}
    turns = [Group(label, np.array(each)) for label, each in moves.items()]
    gravity = [f"gravity {axis}" for axis in "xyz"]
    down = _assign(("model.opt.gravity", np.s_[:], 1.0))
    link = "mass or centre of a link"
    return [
        _row(
            "gravity or tilt",
            "m/s^2",
            gravity,
            model.opt.gravity,
            1.0,
            down,
            groups=turns,
        ),
        _row(
            link,
            "kg",
            names,
            mass,
            mass,
            _assign(*fields),
            lower=-0.95 + 0.0 * mass,
            groups=masses,
        ),
        _row(
            link,
            "m",
            axes,
            model.body_ipos[bodies].ravel(),
            np.repeat(size, 3),
            _assign(centre),
            lower=np.full(len(axes), -3.0),
            groups=centres,
        ),
        _row(
            "payload",
            "kg",
            loaded,
            0.0,
            0.2 * carried,
            load,
            lower=0.0 * carried,
            groups=_groups(loaded),
        ),
    ]


def _time(replayer: Replayer, setup: Setup) -> Cause:
    """Return the physics step, the decimation, and the clock of the log."""

    def apply(after: Setup, values: FloatArray) -> None:
        after.model.opt.timestep, after.clock[0] = values[:2]
        after.repeat, after.phase = values[2:].astype(int)

    step_s = float(setup.model.opt.timestep)
    options = {
        f"physics step of {1e3 * factor * step_s:.3g} ms": (factor * step_s, 1.0, 1, 0)
        for factor in STEPS
        if factor * step_s <= MAX_TIMESTEP_S
    }
    for repeat in REPEATS if replayer.log.command_kind else ():
        for phase in range(repeat):
            label = f"only each {repeat}. command is used, from number {phase + 1} on"
            options[label] = (step_s, 1.0, repeat, phase)
    groups = [Group("clock", np.array([1]))]
    groups += [
        Group(label, np.zeros(0, int), option=np.array(each))
        for label, each in options.items()
    ]
    parameters = ("step", "clock", "repeat", "phase")
    present = (step_s, 1.0, 1.0, 0.0)
    bounds = {"origin": np.zeros(4), "lower": np.full(4, 0.2), "upper": np.full(4, 5.0)}
    return _row(
        "step and decimation",
        "s/s",
        parameters,
        present,
        1.0,
        apply,
        groups=groups,
        starts=CLOCKS,
        **bounds,
    )


def _stops(replayer: Replayer, model: mujoco.MjModel) -> Cause:
    """Return the stops of joints that dwell at an extreme of their motion, or pass the stop of the model."""
    log, ids = replayer.log, replayer.places.joint
    position = log.position[log.valid]
    motion = np.ptp(position, axis=0)
    near = 4.0 * log.position_noise + 0.01 * motion
    sign = np.array([[-1.0], [1.0]])
    # Shape [2, J]: the lower and the upper side.
    extremes = np.percentile(position, (2.0, 98.0), axis=0)
    present = model.jnt_range[ids].T
    is_near = sign[..., None] * (position - extremes[:, None]) > -near
    dwells = (is_near.mean(axis=1) > MIN_DWELL) & (motion > 10.0 * log.position_noise)
    chosen = np.nonzero(dwells | (sign * (extremes - present) > near))
    names = [
        f"{log.joints[joint]} {('lower', 'upper')[side]}"
        for side, joint in zip(*chosen, strict=True)
    ]
    stop = _assign(("model.jnt_range", (ids[chosen[1]], chosen[0]), 1.0))
    return _row(
        "joint limit",
        "rad",
        names,
        present[chosen],
        1.0,
        stop,
        origin=extremes[chosen],
        groups=_groups(names),
        starts=(0.0, -0.02, 0.02),
    )


def _contacts(setup: Setup) -> list[Cause]:
    """Return friction and softness of all contacts, as factors."""
    table = {
        "floor friction": (
            ("model.geom_friction", np.s_[:, 0]),
            ("model.pair_friction", np.s_[:, :2]),
        ),
        "contact softness": (
            ("model.geom_solref", np.s_[:, 0]),
            ("model.pair_solref", np.s_[:, 0]),
        ),
    }
    rows = []
    for name, entries in table.items():
        fields = [
            (path, index, attrgetter(path)(setup)[index].copy())
            for path, index in entries
        ]
        rows.append(
            _row(
                name,
                "",
                ["factor"],
                1.0,
                1.0,
                _assign(*fields),
                lower=-np.ones(1),
                starts=CONTACTS,
            )
        )
    return rows
