"""The causes that can make a model and a log part: a row each, with values, bounds and change."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import mujoco
import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment

from gauge_envs.tools.replay.log import FloatArray
from gauge_envs.tools.replay.model import IntArray, Replayer, Setup

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
ZERO = "zero"
ZEROS = (-1.6, -1.0, -0.5, -0.2, 0.2, 0.5, 1.0, 1.6)
"""Zeros of a joint from which the fit starts [rad or m]."""
GRAVITY = 9.81
"""Bound of a change of gravity [m/s^2]: it never points up."""
INSIDE = 2.0
"""Bound of a shift of a centre, over the radius of gyration of its link: it stays inside."""
MIN_SCALE = 1e-6
"""Scale of values that stay above zero and are zero now."""
MIN_FACTOR = 1e-3
"""Smallest value, over the present or typical one, of values that stay above zero."""


@dataclass(frozen=True)
class ParameterGroup:
    """Values of a cause that change together.

    Attributes:
        label: `one` for a single value, `all` for a common number, `each` for several numbers, the text of an option
            without numbers.
        selection: Which number moves each value, shape [K, p].
    """

    label: str
    selection: FloatArray


def groups_of_one(count: int, size: int = 1) -> list[ParameterGroup]:
    """Return a group of each value, or of `size` neighbours with a number each."""
    label = "one" if size == 1 else "each"
    selections = np.split(np.eye(count), count // size, axis=1)
    return [ParameterGroup(label, selection) for selection in selections]


def groups_of_one_and_all(count: int) -> list[ParameterGroup]:
    """Return a group of each value, and one of all by a common number."""
    groups = groups_of_one(count)
    if count > 1:
        groups.append(ParameterGroup("all", np.ones((count, 1))))
    return groups


def all_groups(count: int) -> list[ParameterGroup]:
    """Return a group of each value, one of all by a common number, and one of all by a number each."""
    groups = groups_of_one_and_all(count)
    if count > 1:
        groups.append(ParameterGroup("each", np.eye(count)))
    return groups


@dataclass(frozen=True, kw_only=True)
class Cause:
    """One candidate: values of a setup that may be wrong, `zero + scale * numbers`.

    Attributes:
        name: As `delay`.
        unit: Unit of the values.
        parameters: Names of the values, as joints; empty for an option.
        present: Values of the model as it is, shape [K].
        typical: Change that matters, shape [K] or a number.
        apply: Gives the values to a setup.
        groups: What is fitted.
        is_positive: Whether the values stay above zero.
        starts: Numbers from which the fit starts where the error is not smooth at the present value.
        origin: Values where the numbers are zero; by default the present ones.
        far: Bound of the numbers.
    """

    name: str
    unit: str = ""
    parameters: Sequence[str] = ()
    present: FloatArray
    typical: ArrayLike
    apply: Callable[[Setup, FloatArray], None]
    groups: Sequence[ParameterGroup]
    is_positive: bool = True
    starts: Sequence[float] = ()
    origin: ArrayLike | None = None
    far: float = FAR

    @property
    def zero(self) -> FloatArray:
        """Values where the numbers are zero, shape [K]."""
        if self.origin is None:
            return self.present
        return np.full(len(self.present), self.origin)

    @property
    def scale(self) -> FloatArray:
        """Change of each value for a number of 1, shape [K]."""
        typical = np.full(len(self.present), self.typical)
        if self.starts or not self.is_positive:
            return typical
        return np.where(self.present > 0.2 * typical, self.present, typical)

    def values(self, group: ParameterGroup, numbers: FloatArray) -> FloatArray:
        """Return all values for numbers of shape [p]."""
        is_moved = group.selection.any(axis=1)
        base = np.where(is_moved, self.zero, self.present)
        return base + self.scale * (group.selection @ numbers)

    def lower(self, group: ParameterGroup) -> FloatArray:
        """Return the smallest numbers of a group, shape [p]."""
        if not self.is_positive:
            return np.full(group.selection.shape[1], -self.far)
        smallest = MIN_FACTOR - self.zero / self.scale
        by_number = np.where(group.selection.T > 0.0, smallest, -FAR)
        return by_number.max(axis=1, initial=-FAR)


def change_setup(setup: Setup, changes: Iterable[tuple[Cause, FloatArray]]) -> Setup:
    """Return a copy of a setup with the values of causes."""
    after = copy.deepcopy(setup)
    for cause, values in changes:
        cause.apply(after, values)
    mujoco.mj_setConst(after.model, mujoco.MjData(after.model))
    return after


def candidates(replayer: Replayer, setup: Setup) -> list[Cause]:
    """Return the causes that a model and a log allow."""
    log = replayer.log
    samples = np.linspace(0, len(log.time_s) - 1, LOAD_SAMPLES).astype(int)
    torques, is_touching = replayer.torques(setup, samples)
    # Torques and speeds of the joints that the log often has.
    load = np.maximum(np.percentile(np.abs(torques), 95, axis=0), 1e-4)
    speed = np.maximum(np.percentile(np.abs(log.velocity), 95, axis=0), 1e-3)
    causes = [
        _zero(replayer, setup),
        *_losses(replayer, setup, load, speed),
        *_bodies(setup),
        _stops(replayer, setup),
        *_timing(setup),
    ]
    driven = np.flatnonzero(np.append(setup.is_driven, False)[replayer.actuator])
    if len(driven):
        causes += _commands(replayer, setup, driven, load[driven])
        if setup.model.actuator_biasprm[replayer.actuator[driven], 1].any():
            causes += _gains(replayer, setup, driven, 0.3 * load[driven] / speed.max())
    if is_touching:
        causes += _contacts(setup)
    return causes


def _zero(replayer: Replayer, setup: Setup) -> Cause:
    """Return the zero of the joints of the log, in positions and commands."""
    names, ids = replayer.log.joints, replayer.actuator
    driven = np.flatnonzero(np.append(setup.is_driven, False)[ids])
    driven = driven[setup.model.actuator_biasprm[ids[driven], 1] != 0.0]

    def set_zero(changed: Setup, values: FloatArray) -> None:
        changed.zero[:] = values
        changed.offset[ids[driven]] += values[driven]

    return Cause(
        name=ZERO,
        unit="rad",
        parameters=names,
        present=setup.zero,
        typical=1.0,
        apply=set_zero,
        groups=groups_of_one(len(names)),
        is_positive=False,
        starts=ZEROS,
        origin=0.0,
        far=np.pi,
    )


def _losses(
    replayer: Replayer, setup: Setup, load: FloatArray, speed: FloatArray
) -> list[Cause]:
    """Return armature, dry friction and damping of the joints."""
    joints, dofs, model = replayer.log.joints, replayer.dof, setup.model
    groups = all_groups(len(joints))

    rows = (
        ("armature", "kg m^2", "dof_armature", 0.3 * model.dof_M0[dofs]),
        ("dry friction", "N m", "dof_frictionloss", 0.1 * load),
        ("damping", "N m s/rad", "dof_damping", 0.3 * load / speed),
    )
    return [
        Cause(
            name=name,
            unit=unit,
            parameters=joints,
            present=getattr(model, field)[dofs],
            typical=typical,
            apply=partial(_set_field, field, dofs),
            groups=groups,
        )
        for name, unit, field, typical in rows
    ]


def _set_field(field: str, rows: IntArray, changed: Setup, values: FloatArray) -> None:
    """Give values to a field of the model."""
    getattr(changed.model, field)[rows] = values


def _bodies(setup: Setup) -> list[Cause]:
    """Return gravity, mass and centre of each link that moves, and a load on the first one and on each end."""
    model = setup.model
    bodies = np.flatnonzero((model.body_weldid > 0) & (model.body_mass > 0.0))
    names = [model.body(body).name or f"body {body}" for body in bodies]
    count = len(names)
    mass, inertia = model.body_mass[bodies], model.body_inertia[bodies]
    size = np.maximum(np.sqrt(inertia.sum(axis=1) / mass), 0.01)
    axes = np.repeat(bodies, 3), np.tile(range(3), count)
    ends = np.union1d(0, np.flatnonzero(~np.isin(bodies, model.body_parentid[bodies])))
    # A tilt of the base turns gravity.
    tilts = [
        ParameterGroup("one", np.eye(3)[:, 2:]),
        ParameterGroup("each", np.eye(3)[:, :2]),
        ParameterGroup("each", np.eye(3)),
    ]

    def set_gravity(changed: Setup, values: FloatArray) -> None:
        changed.model.opt.gravity[:] = values

    def set_mass(changed: Setup, values: FloatArray) -> None:
        # Another cause may have added a payload.
        changed.model.body_mass[bodies] += values - mass
        changed.model.body_inertia[bodies] = inertia * (values / mass)[:, None]

    def set_center(changed: Setup, values: FloatArray) -> None:
        changed.model.body_ipos[axes] = values

    def add_payload(changed: Setup, values: FloatArray) -> None:
        changed.model.body_mass[bodies[ends]] += values

    return [
        Cause(
            name="gravity or tilt",
            unit="m/s^2",
            parameters=["gravity x", "gravity y", "gravity z"],
            present=model.opt.gravity.copy(),
            typical=1.0,
            apply=set_gravity,
            groups=tilts,
            is_positive=False,
            far=GRAVITY,
        ),
        Cause(
            name="mass or centre of a link",
            unit="kg",
            parameters=names,
            present=mass,
            typical=MIN_SCALE,
            apply=set_mass,
            groups=groups_of_one_and_all(count),
        ),
        Cause(
            name="mass or centre of a link",
            unit="m",
            parameters=[f"{name} {axis}" for name in names for axis in "xyz"],
            present=model.body_ipos[axes],
            typical=np.repeat(size, 3),
            apply=set_center,
            groups=groups_of_one(3 * count, 3),
            is_positive=False,
            far=INSIDE,
        ),
        Cause(
            name="payload",
            unit="kg",
            parameters=[names[end] for end in ends],
            present=np.zeros(len(ends)),
            # A payload may be heavier than the link that carries it.
            typical=0.02 * model.body_mass.sum(),
            apply=add_payload,
            groups=groups_of_one(len(ends)),
        ),
    ]


def _stops(replayer: Replayer, setup: Setup) -> Cause:
    """Return the limits of the joints."""
    joints = replayer.log.joints
    places = np.tile(replayer.joint, 2), np.repeat((0, 1), len(joints))

    def set_range(changed: Setup, values: FloatArray) -> None:
        changed.model.jnt_range[places] = values

    return Cause(
        name="joint limit",
        unit="rad",
        parameters=[
            f"{joint} {side}" for side in ("lower", "upper") for joint in joints
        ],
        present=setup.model.jnt_range[places],
        typical=STOP,
        apply=set_range,
        groups=groups_of_one(2 * len(joints)),
        is_positive=False,
        starts=STOPS,
        origin=np.percentile(replayer.log.position, (2.0, 98.0), axis=0).ravel(),
    )


def _commands(
    replayer: Replayer, setup: Setup, driven: IntArray, load: FloatArray
) -> list[Cause]:
    """Return effort limit of driven joints, and scale, offset, delay and order of their commands."""
    model, ids = setup.model, replayer.actuator[driven]
    names = [replayer.log.joints[joint] for joint in driven]
    groups = all_groups(len(names))
    is_servo = model.actuator_biasprm[ids, 1].any()

    def set_limit(changed: Setup, values: FloatArray) -> None:
        changed.model.actuator_forcerange[ids] = np.column_stack([-values, values])

    def set_scale(changed: Setup, values: FloatArray) -> None:
        changed.scale[ids] = values

    def set_offset(changed: Setup, values: FloatArray) -> None:
        changed.offset[ids] = values

    def set_delay(changed: Setup, values: FloatArray) -> None:
        changed.delay_s = float(values[0])

    return [
        Cause(
            name="effort limit",
            unit="N m",
            parameters=names,
            present=model.actuator_forcerange[ids, 1],
            typical=load,
            apply=set_limit,
            groups=groups,
            starts=EFFORTS,
            origin=0.0,
        ),
        Cause(
            name="action scale",
            parameters=names,
            present=setup.scale[ids],
            typical=MIN_SCALE,
            apply=set_scale,
            groups=groups,
        ),
        Cause(
            name="action offset",
            unit="rad" if is_servo else "N m",
            parameters=names,
            present=setup.offset[ids],
            typical=0.05 if is_servo else 0.1 * load,
            apply=set_offset,
            groups=groups,
            is_positive=False,
        ),
        Cause(
            name="delay",
            unit="s",
            parameters=["delay"],
            present=np.array([setup.delay_s]),
            typical=DELAY_S,
            apply=set_delay,
            groups=groups_of_one(1),
            is_positive=False,
            starts=DELAYS,
            origin=0.0,
        ),
        *_order(replayer, setup, driven),
    ]


def _gains(
    replayer: Replayer, setup: Setup, driven: IntArray, rate: FloatArray
) -> list[Cause]:
    """Return the gains of driven joints."""
    model, ids = setup.model, replayer.actuator[driven]
    names = [replayer.log.joints[joint] for joint in driven]
    groups = all_groups(len(names))

    def set_stiffness(changed: Setup, values: FloatArray) -> None:
        changed.model.actuator_gainprm[ids, 0] = values
        changed.model.actuator_biasprm[ids, 1] = -values

    def set_damping(changed: Setup, values: FloatArray) -> None:
        changed.model.actuator_biasprm[ids, 2] = -values

    return [
        Cause(
            name="kp",
            unit="N m/rad",
            parameters=names,
            present=-model.actuator_biasprm[ids, 1],
            typical=MIN_SCALE,
            apply=set_stiffness,
            groups=groups,
        ),
        Cause(
            name="kd",
            unit="N m s/rad",
            parameters=names,
            present=-model.actuator_biasprm[ids, 2],
            typical=rate,
            apply=set_damping,
            groups=groups,
        ),
    ]


def _option(name: str, label: str, apply: Callable[[Setup], None]) -> Cause:
    """Return a cause without numbers."""
    nothing = np.zeros(0)
    return Cause(
        name=name,
        present=nothing,
        typical=nothing,
        apply=lambda changed, _: apply(changed),
        groups=[ParameterGroup(label, np.zeros((0, 0)))],
    )


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
    texts = []
    for joint, other, sign in zip(driven, driven[order], signs, strict=True):
        if other != joint or sign < 0.0:
            minus = "minus " if sign < 0.0 else ""
            texts.append(f"{log.joints[joint]} follows {minus}{log.joints[other]}")
    if not texts:
        return []
    label, others = ", ".join(texts), ids[order]

    def set_command(changed: Setup) -> None:
        changed.command[:, ids] = signs * setup.command[:, others]

    def set_all(changed: Setup) -> None:
        set_command(changed)
        changed.scale[ids] = setup.scale[others]
        changed.offset[ids] = signs * setup.offset[others]

    # The default pose that was added, and the scale, may be those of the other joint.
    with_pose = f"{label}, with its default pose"
    return [
        _option("joint order", label, set_command),
        _option("joint order", with_pose, set_all),
    ]


def _timing(setup: Setup) -> list[Cause]:
    """Return other physics steps, and controllers that take only each n-th change of the command."""
    steps_s = setup.step_s * np.array(STEPS)
    causes = [_step(step_s) for step_s in steps_s if step_s <= MAX_TIMESTEP_S]
    if setup.is_driven.any():
        causes += [_held(setup, n, k) for n in REPEATS for k in range(n)]
    return causes


def _step(step_s: float) -> Cause:
    """Return another physics step."""

    def set_step(changed: Setup) -> None:
        changed.model.opt.timestep = step_s

    label = f"physics step of {1e3 * step_s:.3g} ms"
    return _option("step and decimation", label, set_step)


def _held(setup: Setup, n: int, k: int) -> Cause:
    """Return a controller that takes only each n-th change of the command, from change k on."""
    is_new = np.diff(setup.command, axis=0).any(axis=1)
    changes = np.flatnonzero(is_new) + 1
    # The first command holds until the first one that the controller takes.
    taken = np.append(0, changes[k::n])
    latest = np.searchsorted(taken, np.arange(len(setup.command)), "right") - 1
    held = setup.command[taken[latest]]

    def set_command(changed: Setup) -> None:
        changed.command[:] = held

    label = f"only each {n}. command is used, from number {k + 1} on"
    return _option("step and decimation", label, set_command)


def _contacts(setup: Setup) -> list[Cause]:
    """Return friction and softness of all contacts, as factors."""

    def scale_friction(changed: Setup, factor: FloatArray) -> None:
        changed.model.geom_friction[:, :1] *= factor
        changed.model.pair_friction[:, :2] *= factor

    def scale_time_constant(changed: Setup, factor: FloatArray) -> None:
        changed.model.geom_solref[:, :1] *= factor
        changed.model.pair_solref[:, :1] *= factor

    changes = {
        "floor friction": scale_friction,
        "contact softness": scale_time_constant,
    }
    return [
        Cause(
            name=name,
            parameters=["factor"],
            present=np.ones(1),
            typical=1.0,
            apply=apply,
            groups=groups_of_one(1),
            starts=CONTACTS,
        )
        for name, apply in changes.items()
    ]
