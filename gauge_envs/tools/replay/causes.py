"""The causes that can make a model and a log part: a row each, with values, bounds, change, and lines to paste."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import make_interp_spline
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
STOPS = (0.0, -0.02, 0.02)
"""Places of a stop from which the fit starts, beyond the extreme of the motion [rad or m]."""
LOAD_SAMPLES = 300
FAR = 40.0
"""Bound of a number of the fit, in units of its scale."""
MIN_FACTOR = 1e-3
"""Smallest value, over the present or typical one, of values that stay above zero."""


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
        apply: Changes a setup to values of shape [K].
        groups: What is fitted.
        is_positive: Whether values stay above zero.
        starts: Numbers from which the fit starts where the error is not smooth at the present value.
    """

    name: str
    unit: str
    parameters: Sequence[str]
    present: FloatArray
    origin: FloatArray
    scale: FloatArray
    apply: Change
    groups: Sequence[Group]
    is_positive: bool = True
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

    def lower(self, group: Group) -> FloatArray:
        """Return the smallest numbers of a group, shape [p]."""
        if not self.is_positive:
            return np.full(group.size, -FAR)
        lower = MIN_FACTOR - (self.origin / self.scale)[group.index]
        return lower.max(keepdims=True) if group.is_shared else lower


def _assign(*fields: Field) -> Change:
    """Return a change of fields of a setup: the entries of each take a factor times the values."""

    def apply(setup: Setup, values: FloatArray) -> None:
        for path, index, factor in fields:
            attrgetter(path)(setup)[index] = (np.transpose(factor) * values).T

    return apply


def _groups(labels: Sequence[str]) -> list[Group]:
    """Return a group for each value."""
    return [Group(label, np.array([k])) for k, label in enumerate(labels)]


def _row(
    setup: Setup,
    name: str,
    unit: str,
    parameters: Sequence[str],
    typical: ArrayLike,
    *fields: Field,
    **others: Any,
) -> Cause:
    """Return a row; by default values are free, alone, or share a number, whose zero is the present value.

    Args:
        setup: The model.
        name: Name of the cause.
        unit: Unit of the values.
        parameters: Names of the values.
        typical: Size that matters; the unit of the numbers is this or the present value.
        fields: Fields of the setup that take the values, the first one of which has the present values.
        others: Attributes of the cause that differ.
    """
    count = len(parameters)
    groups, every = _groups(parameters), np.arange(count)
    if count > 1:
        groups += [Group("all", every, is_shared=True), Group("each", every)]
    if "present" not in others:
        path, index, factor = fields[0]
        others["present"] = attrgetter(path)(setup)[index] / factor
    present = others["present"]
    scale = np.maximum(np.broadcast_to(typical, count), 1e-6)
    if others.get("is_positive", True):
        scale = np.where(present > 0.2 * scale, present, scale)
    defaults = {
        "origin": present,
        "scale": scale,
        "apply": _assign(*fields),
        "groups": groups,
    }
    return Cause(name, unit, parameters, **(defaults | others))


def candidates(replayer: Replayer, setup: Setup) -> list[Cause]:
    """Return the causes that a model and a log allow."""
    log, model, places = replayer.log, setup.model, replayer.places
    samples = np.linspace(0, len(log.time_s) - 1, LOAD_SAMPLES).astype(int)
    conditions, torques = replayer.conditions(setup, samples)
    # Torques and speeds of the joints that the log often has.
    load = np.maximum(np.percentile(np.abs(torques), 95, axis=0), 1e-4)
    speed = np.maximum(np.percentile(np.abs(log.velocity), 95, axis=0), 1e-3)
    # In newer versions damping is a polynomial, whose first coefficient is the linear one.
    dofs = places.dof
    damping = dofs if model.dof_damping.ndim == 1 else (dofs, 0)
    armature, viscous = 0.3 * model.dof_M0[dofs], 0.3 * load / speed
    rows = [
        _row(
            setup,
            "armature",
            "kg m^2",
            log.joints,
            armature,
            ("model.dof_armature", dofs, 1.0),
        ),
        _row(
            setup,
            "dry friction",
            "N m",
            log.joints,
            0.1 * load,
            ("model.dof_frictionloss", dofs, 1.0),
        ),
        _row(
            setup,
            "damping",
            "N m s/rad",
            log.joints,
            viscous,
            ("model.dof_damping", damping, 1.0),
        ),
        *_bodies(setup),
        _stops(replayer, setup),
        _time(replayer, setup),
    ]
    driven = np.flatnonzero(np.append(setup.source, -1)[places.actuator] >= 0)
    if len(driven):
        rows += _drives(replayer, setup, driven, load[driven], speed.max())
    if (conditions == "contact").any():
        rows += _contacts(setup)
    return [row for row in rows if row.groups]


def _drives(
    replayer: Replayer, setup: Setup, driven: IntArray, load: FloatArray, speed: float
) -> list[Cause]:
    """Return gains, effort limit, and scale, offset, order and delay of the commands of driven joints."""
    log, model, ids = replayer.log, setup.model, replayer.places.actuator[driven]
    names = [log.joints[joint] for joint in driven]
    gear = np.abs(model.actuator_gear[ids, 0])
    limit, gain, law = (
        "model.actuator_forcerange",
        "model.actuator_gainprm",
        "model.actuator_biasprm",
    )
    limits = (limit, (ids, 1), 1.0 / gear), (limit, (ids, 0), -1.0 / gear)
    stiffness = (law, (ids, 1), -1.0 / gear**2), (gain, (ids, 0), 1.0 / gear**2)
    damping = (law, (ids, 2), -1.0 / gear**2)
    zero = {"origin": 0.0 * load, "scale": load}
    is_servo = model.actuator_biasprm[ids, 1].any()
    unit, offset = ("rad", 0.05) if is_servo else ("N m", 0.1 * load)
    rows = [
        _row(
            setup, "effort limit", "N m", names, load, *limits, **zero, starts=EFFORTS
        ),
        _row(setup, "action scale", "", names, 0.0, ("scale", ids, 1.0)),
        _row(
            setup,
            "action offset",
            unit,
            names,
            offset,
            ("offset", ids, 1.0),
            is_positive=False,
        ),
        _row(
            setup,
            "delay",
            "s",
            ["delay"],
            1.0,
            ("delay_s", [0], 1.0),
            is_positive=False,
            starts=DELAYS_S,
        ),
        _orders(replayer, setup, driven),
    ]
    if is_servo:
        rows.append(_row(setup, "kp", "N m/rad", names, 0.0, *stiffness))
        rows.append(_row(setup, "kd", "N m s/rad", names, 0.3 * load / speed, damping))
    return rows


def _options(options: Mapping[str, ArrayLike]) -> list[Group]:
    """Return a group for each label and its values."""
    return [
        Group(label, np.zeros(0, int), option=np.ravel(each))
        for label, each in options.items()
    ]


def _orders(replayer: Replayer, setup: Setup, driven: IntArray) -> Cause:
    """Return each joint mirrored, and the order and signs of the commands that correlate best with the motion."""
    log = replayer.log
    ids = replayer.places.actuator[driven]
    names = [log.joints[joint] for joint in driven]
    count = len(names)
    command = make_interp_spline(log.command_time_s, log.command, k=1)(log.time_s)
    commands = command.T[setup.source[ids]]
    motion = log.position.T[driven]
    if log.command_kind == "tau":
        motion = np.gradient(log.velocity.T[driven], log.time_s, axis=1)
    # A constant has no correlation; the trend avoids a division by zero.
    trend = 1e-9 * np.arange(len(log.time_s))
    match = np.corrcoef(motion + trend, commands + trend)[:count, count:]
    same = np.arange(count)
    order = linear_sum_assignment(-np.abs(match))[1]
    options = {
        f"{name} mirrored": (same, 1 - 2 * (same == k)) for k, name in enumerate(names)
    }
    label = ", ".join(
        f"{names[k]} follows {names[order[k]]}" for k in same[order != same]
    )
    if label:
        signs = np.sign(match[same, order])
        options |= {label: (order, same**0), f"{label}, with signs": (order, signs)}

    def apply(after: Setup, values: FloatArray) -> None:
        taken = ids[values[:count].astype(int)]
        after.source[ids], after.origin[ids] = setup.source[taken], setup.origin[taken]
        after.sign[ids] = values[count:]

    return _row(
        setup,
        "joint order",
        "",
        (),
        0.0,
        present=same[:0],
        apply=apply,
        groups=_options(options),
    )


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
    centres = [
        Group(f"centre of {name}", each) for name, each in zip(names, axes, strict=True)
    ]
    links = [Group("all masses", np.arange(len(bodies)), is_shared=True)]
    links += _groups([f"mass of {name}" for name in names])
    is_end = ~np.isin(bodies, model.body_parentid[bodies])
    is_end[:1] = True
    loaded = [name for name, each in zip(names, is_end, strict=True) if each]

    def carry(after: Setup, values: FloatArray) -> None:
        after.model.body_mass[bodies[is_end]] = mass[is_end] + values

    # A tilt of the base turns gravity.
    moves = {"size": [2], "tilt": [0, 1], "size and tilt": [0, 1, 2]}
    turns = [Group(label, np.array(each)) for label, each in moves.items()]
    down = ("model.opt.gravity", np.s_[:], 1.0)
    link, free = "mass or centre of a link", {"is_positive": False}
    places = [f"{name} {axis}" for name in names for axis in "xyz"]
    return [
        _row(
            setup,
            "gravity or tilt",
            "m/s^2",
            [f"gravity {axis}" for axis in "xyz"],
            1.0,
            down,
            groups=turns,
            **free,
        ),
        _row(setup, link, "kg", names, 0.0, masses, inertias, groups=links),
        _row(
            setup, link, "m", places, np.repeat(size, 3), centre, groups=centres, **free
        ),
        _row(
            setup,
            "payload",
            "kg",
            loaded,
            0.2 * mass[is_end],
            present=0.0 * mass[is_end],
            apply=carry,
            groups=_groups(loaded),
        ),
    ]


def _time(replayer: Replayer, setup: Setup) -> Cause:
    """Return the physics step, the decimation, and the clock of the log."""

    def apply(after: Setup, values: FloatArray) -> None:
        after.clock[0], after.model.opt.timestep = values[:2]
        after.repeat, after.phase = values[2:].astype(int)

    step_s = float(setup.model.opt.timestep)
    options = {}
    for trial_s in step_s * np.array(STEPS):
        if trial_s <= MAX_TIMESTEP_S:
            options[f"physics step of {1e3 * trial_s:.3g} ms"] = (1.0, trial_s, 1, 0)
    for repeat in REPEATS if replayer.log.command_kind else ():
        for phase in range(repeat):
            label = f"only each {repeat}. command is used, from number {phase + 1} on"
            options[label] = (1.0, step_s, repeat, phase)
    present, origin = np.array([1.0, step_s, 1.0, 0.0]), np.zeros(4)
    groups = [*_groups(["clock"]), *_options(options)]
    parameters = ("clock", "step", "repeat", "phase")
    return _row(
        setup,
        "step and decimation",
        "s/s",
        parameters,
        1.0,
        present=present,
        origin=origin,
        apply=apply,
        groups=groups,
        starts=CLOCKS,
    )


def _stops(replayer: Replayer, setup: Setup) -> Cause:
    """Return the stops of the joints, which the fit starts near the extremes of the motion."""
    log, ids = replayer.log, replayer.places.joint
    names = [f"{name} {side}" for side in ("lower", "upper") for name in log.joints]
    stop = ("model.jnt_range", (np.tile(ids, 2), np.repeat((0, 1), len(ids))), 1.0)
    extremes = np.percentile(log.position[log.valid], (2.0, 98.0), axis=0)
    others = {"groups": _groups(names), "is_positive": False, "starts": STOPS}
    return _row(
        setup, "joint limit", "rad", names, 1.0, stop, origin=extremes.ravel(), **others
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
                setup,
                name,
                "",
                ["factor"],
                1.0,
                *fields,
                present=np.ones(1),
                starts=CONTACTS,
            )
        )
    return rows
