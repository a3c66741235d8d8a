"""The causes that can make a model and a log part: a row each, with values, bounds and change."""

import copy
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from gauge_envs.tools.replay.log import FloatArray, best_columns
from gauge_envs.tools.replay.model import IntArray, Replayer, Setup

STEPS = (0.25, 0.5, 2.0, 2.5, 4.0, 5.0)
"""Physics steps that are tried, over the present one."""
REPEATS = (2, 3, 4)
MAX_TIMESTEP_S = 0.02
LOAD_SAMPLES = 300
FAR = 40.0
"""Bound of a number of the fit, in units of its scale."""
ZERO = "zero"
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

    @property
    def size(self) -> int:
        """Number of numbers, p."""
        return self.selection.shape[1]


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
        groups: What is fitted; each value alone by default.
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
    groups: Sequence[ParameterGroup] = ()
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
            return np.full(group.size, -self.far)
        smallest = MIN_FACTOR - self.zero / self.scale
        by_number = np.where(group.selection.T > 0.0, smallest, -FAR)
        return by_number.max(axis=1, initial=-FAR)


def _field_cause(
    setup: Setup,
    field: Callable[[Setup], FloatArray],
    rows: Any,
    sign: float = 1.0,
    **fields: Any,
) -> Cause:
    """Return a cause whose values are elements of an array of a setup, times a sign.

    Args:
        setup: The present setup.
        field: Returns the array of a setup.
        rows: Index of the elements.
        sign: Sign of the elements in the array.
        **fields: Fields of `Cause`; `apply` writes the elements by default.
    """

    def assign(changed: Setup, values: FloatArray) -> None:
        table = field(changed)
        table[rows] = np.reshape(sign * values, table[rows].shape)

    fields.setdefault("apply", assign)
    return Cause(present=sign * field(setup)[rows].ravel(), **fields)


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
    driven = np.flatnonzero(np.append(setup.is_driven, False)[replayer.actuator])
    causes = [
        _zero(replayer, setup, driven),
        *_losses(replayer, setup, load, speed),
        _stops(replayer, setup),
        *_bodies(setup),
        *_timing(setup),
    ]
    if len(driven):
        causes += _drives(replayer, setup, driven, load[driven], speed.max())
        causes += _order(replayer, setup, driven)
    return causes + _contacts() * is_touching


def _zero(replayer: Replayer, setup: Setup, driven: IntArray) -> Cause:
    """Return the zero of the joints in positions and commands."""
    ids = replayer.actuator
    servos = driven[setup.model.actuator_biasprm[ids[driven], 1] != 0.0]

    def set_zero(changed: Setup, values: FloatArray) -> None:
        changed.zero[:] = values
        changed.offset[ids[servos]] += values[servos]

    return Cause(
        name=ZERO,
        unit="rad",
        parameters=replayer.log.joints,
        present=setup.zero,
        typical=1.0,
        apply=set_zero,
        is_positive=False,
        starts=(-1.6, -1.0, -0.5, -0.2, 0.2, 0.5, 1.0, 1.6),
        origin=0.0,
        far=np.pi,
    )


def _losses(
    replayer: Replayer, setup: Setup, load: FloatArray, speed: FloatArray
) -> list[Cause]:
    """Return armature, dry friction and damping of the joints."""
    model, dofs = setup.model, replayer.dof
    joint_cause = partial(
        _field_cause,
        setup,
        rows=dofs,
        parameters=replayer.log.joints,
        groups=groups_of(len(dofs), "all", "each"),
    )
    return [
        joint_cause(
            lambda changed: changed.model.dof_armature,
            name="armature",
            unit="kg m^2",
            typical=0.3 * model.dof_M0[dofs],
        ),
        joint_cause(
            lambda changed: changed.model.dof_frictionloss,
            name="dry friction",
            unit="N m",
            typical=0.1 * load,
        ),
        joint_cause(
            lambda changed: changed.model.dof_damping,
            name="damping",
            unit="N m s/rad",
            typical=0.3 * load / speed,
        ),
    ]


def _stops(replayer: Replayer, setup: Setup) -> Cause:
    """Return the limits of the joints; the fit starts near the extremes of the motion."""
    joints, ids = replayer.log.joints, replayer.joint
    lower, upper = [0], [1]
    return _field_cause(
        setup,
        lambda changed: changed.model.jnt_range,
        (ids, np.array([lower, upper])),
        name="joint limit",
        unit="rad",
        parameters=[
            f"{joint} {side}" for side in ("lower", "upper") for joint in joints
        ],
        typical=0.05,
        is_positive=False,
        starts=(-0.4, 0.4),
        origin=np.percentile(replayer.log.position, (2.0, 98.0), axis=0).ravel(),
    )


def _bodies(setup: Setup) -> list[Cause]:
    """Return gravity, mass and centre of each link that moves, and a load on the first one and on each end."""
    model = setup.model
    bodies = np.flatnonzero((model.body_weldid > 0) & (model.body_mass > 0.0))
    names = [model.body(body).name or f"body {body}" for body in bodies]
    count = len(names)
    mass, inertia = model.body_mass[bodies], model.body_inertia[bodies]
    size = np.maximum(np.sqrt(inertia.sum(axis=1) / mass), 0.01)
    ends = np.union1d(0, np.flatnonzero(~np.isin(bodies, model.body_parentid[bodies])))

    def set_gravity(changed: Setup, values: FloatArray) -> None:
        vector = changed.model.opt.gravity
        vector[2] = values[0]
        vector[:] = Rotation.from_rotvec([*values[1:], 0.0]).apply(vector)

    def set_mass(changed: Setup, values: FloatArray) -> None:
        # Another cause may have added a payload.
        changed.model.body_mass[bodies] += values - mass
        changed.model.body_inertia[bodies] = inertia * (values / mass)[:, None]

    def add_payload(changed: Setup, values: FloatArray) -> None:
        changed.model.body_mass[bodies[ends]] += values

    return [
        Cause(
            name="gravity or tilt",
            unit="",
            parameters=[
                "the world along z [m/s^2]",
                "the world about x [rad]",
                "the world about y [rad]",
            ],
            present=np.array([model.opt.gravity[2], 0.0, 0.0]),
            typical=(1.0, 0.16, 0.16),
            apply=set_gravity,
            groups=[
                ParameterGroup("one", np.eye(3)[:, :1]),
                ParameterGroup("each", np.eye(3)[:, 1:]),
                ParameterGroup("each", np.eye(3)),
            ],
            is_positive=False,
            # Gravity never points up, and a tilt is at most a right angle.
            far=9.81,
        ),
        Cause(
            name="mass or centre of a link",
            unit="kg",
            parameters=names,
            present=mass,
            typical=MIN_SCALE,
            apply=set_mass,
            groups=groups_of(count, "all"),
        ),
        _field_cause(
            setup,
            lambda changed: changed.model.body_ipos,
            bodies,
            name="mass or centre of a link",
            unit="m",
            parameters=[f"{name} {axis}" for name in names for axis in "xyz"],
            typical=np.repeat(size, 3),
            groups=[
                ParameterGroup("each", columns)
                for columns in np.split(np.eye(3 * count), count, axis=1)
            ],
            is_positive=False,
            # A centre stays inside of its link, whose radius of gyration is the scale.
            far=2.0,
        ),
        Cause(
            name="payload",
            unit="kg",
            parameters=[names[end] for end in ends],
            present=np.zeros(len(ends)),
            # A payload may be heavier than the link that carries it.
            typical=0.02 * model.body_mass.sum(),
            apply=add_payload,
        ),
    ]


def _drives(
    replayer: Replayer, setup: Setup, driven: IntArray, load: FloatArray, speed: float
) -> list[Cause]:
    """Return gains and effort limit of driven joints, and scale, offset and delay of their commands."""
    ids, model = replayer.actuator[driven], setup.model
    is_servo = bool(model.actuator_biasprm[ids, 1].any())
    joint_cause = partial(
        _field_cause,
        setup,
        parameters=[replayer.log.joints[joint] for joint in driven],
        groups=groups_of(len(ids), "all", "each"),
    )

    def set_effort(changed: Setup, values: FloatArray) -> None:
        changed.model.actuator_forcerange[ids] = np.transpose([-values, values])

    def set_stiffness(changed: Setup, values: FloatArray) -> None:
        changed.model.actuator_biasprm[ids, 1] = -values
        changed.model.actuator_gainprm[ids, 0] = values

    causes = [
        joint_cause(
            lambda changed: changed.model.actuator_forcerange,
            (ids, 1),
            name="effort limit",
            unit="N m",
            # The torque that the model needs in the log.
            typical=load,
            apply=set_effort,
            starts=(0.15, 0.35, 0.65, 1.0),
            origin=0.0,
        ),
        joint_cause(
            lambda changed: changed.scale, ids, name="action scale", typical=MIN_SCALE
        ),
        joint_cause(
            lambda changed: changed.offset,
            ids,
            name="action offset",
            unit="rad" if is_servo else "N m",
            typical=0.05 if is_servo else 0.1 * load,
            is_positive=False,
        ),
        _field_cause(
            setup,
            lambda changed: changed.delay_s,
            [0],
            name="delay",
            unit="s",
            parameters=["delay"],
            typical=0.02,
            is_positive=False,
            # The error has several minima over the delay.
            starts=(-0.5, 0.25, 0.5, 1.0, 1.5, 2.25, 3.0, 4.5, 6.5, 9.0),
            origin=0.0,
        ),
    ]
    if is_servo:
        causes += [
            joint_cause(
                lambda changed: changed.model.actuator_biasprm,
                (ids, 1),
                -1.0,
                name="kp",
                unit="N m/rad",
                typical=MIN_SCALE,
                apply=set_stiffness,
            ),
            joint_cause(
                lambda changed: changed.model.actuator_biasprm,
                (ids, 2),
                -1.0,
                name="kd",
                unit="N m s/rad",
                typical=0.3 * load / speed,
            ),
        ]
    return causes


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

    def scale_friction(changed: Setup, factor: FloatArray) -> None:
        changed.model.geom_friction[:, :1] *= factor
        changed.model.pair_friction[:, :2] *= factor

    def scale_softness(changed: Setup, factor: FloatArray) -> None:
        changed.model.geom_solref[:, :1] *= factor
        changed.model.pair_solref[:, :1] *= factor

    setters = {"floor friction": scale_friction, "contact softness": scale_softness}
    return [
        Cause(
            name=name,
            parameters=["factor"],
            present=np.ones(1),
            typical=1.0,
            apply=apply,
            starts=(-0.85, -0.7, -0.55, -0.4, -0.2, 0.5, 1.5, 4.0),
        )
        for name, apply in setters.items()
    ]
