"""The causes that can make a model and a log part: a row each, with values, bounds and change."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from typing import Any, TypeAlias

import mujoco
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from gauge_envs.tools.replay.log import FloatArray, best_columns
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
TILTS = (0.16, 0.16)
"""Tilts of the base that matter [rad]; their bound is a right angle."""
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


def groups_of(count: int, *labels: str) -> list[ParameterGroup]:
    """Return a group of each value; with `all` one of a common number, with `each` one of a number each."""
    groups = [ParameterGroup("one", column[:, None]) for column in np.eye(count)]
    several = {"all": np.ones((count, 1)), "each": np.eye(count)}
    if count > 1:
        groups += [ParameterGroup(label, several[label]) for label in labels]
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


Entry: TypeAlias = tuple[str, Any, float]
"""Path of an array of a setup, rows of it, and the sign of the values there."""


def _cause(setup: Setup, *entries: Entry, **fields: Any) -> Cause:
    """Return a cause whose values are entries of arrays of a setup; the first ones are the present values."""
    path, index, sign = entries[0]
    present = sign * attrgetter(path)(setup)[index]
    return Cause(present=present, apply=partial(_set_entries, entries), **fields)


def _set_entries(entries: Sequence[Entry], changed: Setup, values: FloatArray) -> None:
    """Give values to entries of arrays of a setup."""
    for path, index, sign in entries:
        attrgetter(path)(changed)[index] = sign * values


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
    drives = np.append(setup.is_driven, False)[replayer.actuator]
    causes = [
        *_joints(replayer, setup, load, speed),
        *_bodies(setup),
        *_timing(setup),
    ]
    if drives.any():
        causes += _drives(replayer, setup, np.flatnonzero(drives), load, speed.max())
    return causes + _contacts() * is_touching


def _joints(
    replayer: Replayer, setup: Setup, load: FloatArray, speed: FloatArray
) -> list[Cause]:
    """Return armature, dry friction, damping and limits of the joints, and their zero in positions and commands."""
    names, dofs, ids = replayer.log.joints, replayer.dof, replayer.actuator
    count = len(names)
    driven = np.flatnonzero(np.append(setup.is_driven, False)[ids])
    driven = driven[setup.model.actuator_biasprm[ids[driven], 1] != 0.0]
    limits = np.tile(replayer.joint, 2), np.repeat((0, 1), count)

    def set_zero(changed: Setup, values: FloatArray) -> None:
        changed.zero[:] = values
        changed.offset[ids[driven]] += values[driven]

    zero = Cause(
        name=ZERO,
        unit="rad",
        parameters=names,
        present=setup.zero,
        typical=1.0,
        apply=set_zero,
        groups=groups_of(count),
        is_positive=False,
        starts=ZEROS,
        origin=0.0,
        far=np.pi,
    )
    rows = (
        ("armature", "kg m^2", "dof_armature", 0.3 * setup.model.dof_M0[dofs]),
        ("dry friction", "N m", "dof_frictionloss", 0.1 * load),
        ("damping", "N m s/rad", "dof_damping", 0.3 * load / speed),
    )
    losses = [
        _cause(
            setup,
            (f"model.{field}", dofs, 1.0),
            name=name,
            unit=unit,
            parameters=names,
            typical=typical,
            groups=groups_of(count, "all", "each"),
        )
        for name, unit, field, typical in rows
    ]
    stops = _cause(
        setup,
        ("model.jnt_range", limits, 1.0),
        name="joint limit",
        unit="rad",
        parameters=[
            f"{joint} {side}" for side in ("lower", "upper") for joint in names
        ],
        typical=STOP,
        groups=groups_of(2 * count),
        is_positive=False,
        starts=STOPS,
        origin=np.percentile(replayer.log.position, (2.0, 98.0), axis=0).ravel(),
    )
    return [zero, *losses, stops]


def _set_gravity(changed: Setup, values: FloatArray) -> None:
    """Give gravity its strength, and turn it as a tilt of the base does."""
    gravity = changed.model.opt.gravity
    gravity[2] = values[0]
    gravity[:] = Rotation.from_rotvec([*values[1:], 0.0]).apply(gravity)


def _bodies(setup: Setup) -> list[Cause]:
    """Return gravity, mass and centre of each link that moves, and a load on the first one and on each end."""
    model = setup.model
    bodies = np.flatnonzero((model.body_weldid > 0) & (model.body_mass > 0.0))
    names = [model.body(body).name or f"body {body}" for body in bodies]
    count = len(names)
    mass, inertia = model.body_mass[bodies], model.body_inertia[bodies]
    size = np.maximum(np.sqrt(inertia.sum(axis=1) / mass), 0.01)
    ends = np.union1d(0, np.flatnonzero(~np.isin(bodies, model.body_parentid[bodies])))

    def set_mass(changed: Setup, values: FloatArray) -> None:
        # Another cause may have added a payload.
        changed.model.body_mass[bodies] += values - mass
        changed.model.body_inertia[bodies] = inertia * (values / mass)[:, None]

    def add_payload(changed: Setup, values: FloatArray) -> None:
        changed.model.body_mass[bodies[ends]] += values

    gravity = Cause(
        name="gravity or tilt",
        unit="m/s^2, rad",
        parameters=["gravity z", "tilt x", "tilt y"],
        present=np.array([model.opt.gravity[2], 0.0, 0.0]),
        typical=(1.0, *TILTS),
        apply=_set_gravity,
        groups=[
            ParameterGroup("one", np.eye(3)[:, :1]),
            ParameterGroup("each", np.eye(3)[:, 1:]),
            ParameterGroup("each", np.eye(3)),
        ],
        is_positive=False,
        far=GRAVITY,
    )
    masses = Cause(
        name="mass or centre of a link",
        unit="kg",
        parameters=names,
        present=mass,
        typical=MIN_SCALE,
        apply=set_mass,
        groups=groups_of(count, "all"),
    )
    centres = _cause(
        setup,
        ("model.body_ipos", (np.repeat(bodies, 3), np.tile(range(3), count)), 1.0),
        name="mass or centre of a link",
        unit="m",
        parameters=[f"{name} {axis}" for name in names for axis in "xyz"],
        typical=np.repeat(size, 3),
        groups=[
            ParameterGroup("each", columns)
            for columns in np.split(np.eye(3 * count), count, axis=1)
        ],
        is_positive=False,
        far=INSIDE,
    )
    payload = Cause(
        name="payload",
        unit="kg",
        parameters=[names[end] for end in ends],
        present=np.zeros(len(ends)),
        # A payload may be heavier than the link that carries it.
        typical=0.02 * model.body_mass.sum(),
        apply=add_payload,
        groups=groups_of(len(ends)),
    )
    return [gravity, masses, centres, payload]


def _drives(
    replayer: Replayer, setup: Setup, driven: IntArray, load: FloatArray, speed: float
) -> list[Cause]:
    """Return gains and effort limit of driven joints, and scale, offset, delay and order of their commands."""
    ids, bias = replayer.actuator[driven], "model.actuator_biasprm"
    load, is_servo = load[driven], setup.model.actuator_biasprm[ids, 1].any()
    limits: dict[str, Any] = {"starts": EFFORTS, "origin": 0.0}
    rows: list[tuple[str, str, Any, Sequence[Entry], dict[str, Any]]] = [
        (
            "effort limit",
            "N m",
            load,
            [
                ("model.actuator_forcerange", (ids, 1), 1.0),
                ("model.actuator_forcerange", (ids, 0), -1.0),
            ],
            limits,
        ),
        ("action scale", "", MIN_SCALE, [("scale", ids, 1.0)], {}),
        (
            "action offset",
            "rad" if is_servo else "N m",
            0.05 if is_servo else 0.1 * load,
            [("offset", ids, 1.0)],
            {"is_positive": False},
        ),
    ]
    if is_servo:
        stiffness = [(bias, (ids, 1), -1.0), ("model.actuator_gainprm", (ids, 0), 1.0)]
        rows += [
            ("kp", "N m/rad", MIN_SCALE, stiffness, {}),
            ("kd", "N m s/rad", 0.3 * load / speed, [(bias, (ids, 2), -1.0)], {}),
        ]
    causes = [
        _cause(
            setup,
            *entries,
            name=name,
            unit=unit,
            parameters=[replayer.log.joints[joint] for joint in driven],
            typical=typical,
            groups=groups_of(len(ids), "all", "each"),
            **more,
        )
        for name, unit, typical, entries, more in rows
    ]
    delay = _cause(
        setup,
        ("delay_s", slice(None), 1.0),
        name="delay",
        unit="s",
        parameters=["delay"],
        typical=DELAY_S,
        groups=groups_of(1),
        is_positive=False,
        starts=DELAYS,
        origin=0.0,
    )
    return [*causes, delay, *_order(replayer, setup, driven)]


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
    motion = log.position
    if log.command_kind == "tau":
        motion = np.gradient(log.velocity, log.time_s, axis=0)
    commands = setup.command[log.held_rows()][:, ids]
    order, match = best_columns(motion[:, driven], commands)
    signs = np.sign(match[range(len(ids)), order])
    texts = [
        f"{log.joints[joint]} follows {'minus ' * bool(sign < 0.0)}{log.joints[other]}"
        for joint, other, sign in zip(driven, driven[order], signs, strict=True)
        if other != joint or sign < 0.0
    ]
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
    changes = 1 + np.flatnonzero(np.diff(setup.command, axis=0).any(axis=1))
    # The first command holds until the first one that the controller takes.
    taken = np.append(0, changes[k::n])
    latest = np.searchsorted(taken, np.arange(len(setup.command)), "right") - 1

    def set_command(changed: Setup) -> None:
        changed.command[:] = setup.command[taken[latest]]

    label = f"only each {n}. command is used, from number {k + 1} on"
    return _option("step and decimation", label, set_command)


def _contacts() -> list[Cause]:
    """Return friction and softness of all contacts, as factors."""
    columns = {
        "floor friction": {"geom_friction": 1, "pair_friction": 2},
        "contact softness": {"geom_solref": 1, "pair_solref": 1},
    }

    def scale(counts: Mapping[str, int], changed: Setup, factor: FloatArray) -> None:
        for field, count in counts.items():
            getattr(changed.model, field)[:, :count] *= factor

    return [
        Cause(
            name=name,
            parameters=["factor"],
            present=np.ones(1),
            typical=1.0,
            apply=partial(scale, counts),
            groups=groups_of(1),
            starts=CONTACTS,
        )
        for name, counts in columns.items()
    ]
