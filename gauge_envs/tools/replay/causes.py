"""The causes that can make a model and a log part: each is a list of values, their bounds, and a changed setup."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import linear_sum_assignment

from gauge_envs.tools.replay.log import FloatArray
from gauge_envs.tools.replay.model import IntArray, Setup, effort_limits
from gauge_envs.tools.replay.predict import Replayer

Change = Callable[[Setup, FloatArray], Setup]
Alternative = tuple[str, Callable[[Setup], Setup]]

DELAYS_S = (-0.01, 0.005, 0.01, 0.02, 0.03, 0.045, 0.06, 0.09, 0.13, 0.18)
"""Delays from which the fit starts: the error has several minima over the delay."""
EFFORTS = (0.3, 0.5, 0.7, 0.9, 1.3)
"""Effort limits from which the fit starts, over the torque that the model needs in the log."""
CONTACTS = (-0.7, -0.4, 0.5, 1.5, 4.0)
"""Changes of friction and of the time constant of contacts, over the present value."""
CLOCKS = (0.5, 0.8, 0.9, 1.1, 1.25, 2.0)
STEPS = (0.25, 0.5, 2.0, 2.5, 4.0, 5.0)
REPEATS = (2, 3, 4)
MAX_TIMESTEP_S = 0.02
MAX_MOVES = 6
"""Number of swapped and mirrored joints that are tried."""
MIN_DWELL = 0.05
"""Fraction of the samples at an extreme of a joint from which on it may be a stop."""
MAX_DELAY_S = 0.4
LOAD_SAMPLES = 300
UNLIMITED = 1e3
"""Angle of a stop that is none [rad]."""
NEVER = 100.0
"""Effort limit, over the torque that the model needs, that no motion reaches."""


@dataclass(frozen=True)
class Group:
    """Values that change together.

    Attributes:
        label: What changes, as the name of a joint; `all` for a common factor, `each` for a number a joint.
        directions: Change of each value of the cause per number of the fit, shape [K, p].
    """

    label: str
    directions: FloatArray


@dataclass(frozen=True)
class Cause:
    """One candidate. Value k of the model is `zero[k] + unit[k] * x[k]`, where the fit moves the numbers x.

    Attributes:
        name: As `delay`.
        measure: Unit of the values.
        parameters: Names of the values, as joints.
        zero, unit: See above, shape [K].
        present: Numbers of the model as it is, shape [K].
        lower, upper: Bounds of the numbers, shape [K].
        apply: Returns a changed copy of a setup for values of shape [K].
        groups: What is fitted.
        starts: Numbers from which the fit starts where the error is not smooth at the present value.
        alternatives: Changes without a number, by label.
    """

    name: str
    measure: str
    parameters: tuple[str, ...]
    zero: FloatArray
    unit: FloatArray
    present: FloatArray
    lower: FloatArray
    upper: FloatArray
    apply: Change
    groups: tuple[Group, ...]
    starts: tuple[float, ...] = ()
    alternatives: tuple[Alternative, ...] = ()

    def values(self, numbers: FloatArray) -> FloatArray:
        """Return the values for numbers of shape [K]."""
        return self.zero + self.unit * numbers

    def numbers(self, directions: FloatArray, moved: FloatArray) -> FloatArray:
        """Return the numbers of all values, shape [K]; those that a group does not move stay as they are."""
        is_moved = directions.any(axis=1) & bool(self.starts)
        return np.where(is_moved, 0.0, self.present) + directions @ moved

    def changed(self, setup: Setup, numbers: FloatArray) -> Setup:
        """Return a changed copy of a setup."""
        return self.apply(setup, self.values(numbers))


class Candidates:
    """The causes that a model and a log allow.

    Args:
        replayer: Predicts the log.
        setup: The model as it is.

    Attributes:
        torque, speed: 95th percentiles of each joint in the log, shape [J].
        demand: 95th percentile of the torque of each actuator, shape [nu].
        inertia: Diagonal of the mass matrix of each joint, shape [J].
    """

    def __init__(self, replayer: Replayer, setup: Setup) -> None:
        self.log, self.places, self.has_base = (
            replayer.log,
            replayer.places,
            replayer.has_base,
        )
        self.setup, self.model = setup, setup.model
        samples = np.linspace(0, len(self.log.time_s) - 1, LOAD_SAMPLES).astype(int)
        conditions, torques = replayer.conditions(setup, samples)
        self.has_contact = bool((conditions == "contact").any())
        data = mujoco.MjData(self.model)
        data.qpos[:] = replayer.qpos[samples[LOAD_SAMPLES // 2]]
        mujoco.mj_forward(self.model, data)
        inertia = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, data, inertia)
        dofs = self.places.dof
        is_driven = self.places.actuator >= 0
        torque = np.abs(data.qfrc_bias[dofs])
        often = np.percentile(np.abs(torques), 95, axis=0)
        torque[is_driven] = often[self.places.actuator[is_driven]]
        self.torque, self.inertia = np.maximum(torque, 1e-4), np.diag(inertia)[dofs]
        self.demand = np.maximum(often, 1e-6)
        self.speed = np.maximum(
            np.percentile(np.abs(self.log.velocity), 95, axis=0), 1e-3
        )

    def causes(self) -> list[Cause]:
        """Return the candidates."""
        found = [
            *self._joint_causes(),
            self._gravity(),
            *self._mass_causes(),
            self._limits(),
            self._time(),
        ]
        if (self.setup.source >= 0).any():
            found += self._drive_causes()
        if self.has_contact:
            found += self._contact_causes()
        return [cause for cause in found if cause.groups or cause.alternatives]

    # --- drives and joints -------------------------------------------------------------------------------------------

    def _joint_causes(self) -> list[Cause]:
        """Return armature, dry friction and damping of the joints."""
        viscous = 0.3 * self.torque / self.speed
        fields = {
            "armature": ("kg m^2", "dof_armature", 0.3 * self.inertia),
            "dry friction": ("N m", "dof_frictionloss", 0.1 * self.torque),
            "damping": ("N m s/rad", "dof_damping", viscous),
        }
        found = []
        for name, (measure, field, typical) in fields.items():
            # In newer versions damping is a polynomial, whose first coefficient is the linear one.
            is_plain = getattr(self.model, field).ndim == 1
            index = self.places.dof if is_plain else (self.places.dof, 0)
            present = getattr(self.model, field)[index]
            apply = _assign((field, index, 1.0))
            found.append(
                _positive(name, measure, self.log.joints, present, typical, apply)
            )
        return found

    def _drive_causes(self) -> list[Cause]:
        """Return gains, effort limit, and scale, offset, order and delay of the commands."""
        model, setup = self.model, self.setup
        ids = np.flatnonzero(setup.source >= 0)
        joints = model.actuator_trnid[ids, 0]
        names = [model.joint(int(joint)).name for joint in joints]
        gear, demand = model.actuator_gear[ids, 0], self.demand[ids]
        is_servo = model.actuator_biasprm[ids, 1].any()
        limits = _assign(
            ("actuator_forcerange", (ids, 0), -1.0 / np.abs(gear)),
            ("actuator_forcerange", (ids, 1), 1.0 / np.abs(gear)),
            actuator_forcelimited=(ids, 1),
            jnt_actfrclimited=(joints, 0),
        )
        effort = _cause("effort limit", "N m", names, 0.0 * demand, demand, limits)
        effort = replace(
            effort,
            present=np.minimum(effort_limits(model)[ids] / demand, NEVER),
            lower=np.full(len(ids), 0.02),
            groups=effort.groups[: len(ids) + 1],
            starts=EFFORTS,
        )

        def set_commands(field: str) -> Change:
            def apply(before: Setup, values: FloatArray) -> Setup:
                array = getattr(before, field).copy()
                array[ids] = values
                return replace(before, **{field: array})

            return apply

        def delayed(before: Setup, values: FloatArray) -> Setup:
            return replace(before, delay_s=float(values[0]))

        scale, offset = setup.scale[ids], setup.offset[ids]
        unit = np.full(len(ids), 0.05) if is_servo else 0.1 * demand
        zero, none = np.zeros(1), np.zeros(0)
        delay = _cause("delay", "s", ["delay"], zero, zero + 1.0, delayed)
        earliest_s = zero - 2.0 * self.log.command_interval_s
        order = _cause("joint order", "", [], none, none, delayed)
        return [
            *(self._gains(ids, names) if is_servo else []),
            effort,
            _positive(
                "action scale", "", names, scale, 0.0 * scale, set_commands("scale")
            ),
            _cause(
                "action offset",
                "rad" if is_servo else "N m",
                names,
                offset,
                unit,
                set_commands("offset"),
            ),
            replace(delay, lower=earliest_s, upper=zero + MAX_DELAY_S, starts=DELAYS_S),
            replace(order, alternatives=self._orders()),
        ]

    def _gains(self, ids: IntArray, names: Sequence[str]) -> list[Cause]:
        """Return stiffness and damping of servos, at the joint."""
        squared = self.model.actuator_gear[ids, 0] ** 2
        stiffness, damping = (
            -self.model.actuator_biasprm[ids, k] * squared for k in (1, 2)
        )
        typical = 0.3 * self.demand[ids] / self.speed.max()
        set_stiffness = _assign(
            ("actuator_gainprm", (ids, 0), 1.0 / squared),
            ("actuator_biasprm", (ids, 1), -1.0 / squared),
        )
        set_damping = _assign(("actuator_biasprm", (ids, 2), -1.0 / squared))
        return [
            _positive(
                "kp", "N m/rad", names, stiffness, 0.0 * stiffness, set_stiffness
            ),
            _positive("kd", "N m s/rad", names, damping, typical, set_damping),
        ]

    def _orders(self) -> tuple[Alternative, ...]:
        """Return the orders and signs of the commands that their correlation with the motion suggests."""
        log, setup = self.log, self.setup
        driven = [
            j
            for j, a in enumerate(self.places.actuator)
            if a >= 0 and setup.source[a] >= 0
        ]
        actuators = self.places.actuator[driven]
        names = [log.joints[j] for j in driven]
        count = len(names)
        columns = log.command.T[setup.source[actuators]]
        commands = np.array(
            [np.interp(log.time_s, log.command_time_s, column) for column in columns]
        )
        motion = log.position.T[driven]
        if log.command_kind == "tau":
            motion = np.gradient(log.velocity.T[driven], log.time_s, axis=1)
        # A constant has no correlation; the trend avoids a division by zero.
        trend = 1e-9 * np.arange(len(log.time_s))
        match = np.corrcoef(motion + trend, commands + trend)[:count, count:]
        same, plus = np.arange(count), np.ones(count)
        moves: list[tuple[float, str, IntArray, FloatArray]] = []
        for i in range(count):
            moves.append(
                (
                    -2.0 * match[i, i],
                    f"{names[i]} mirrored",
                    same,
                    np.where(same == i, -1.0, 1.0),
                )
            )
            for j in range(i):
                order = same.copy()
                order[[i, j]] = j, i
                gain = match[i, j] + match[j, i] - match[i, i] - match[j, j]
                moves.append((gain, f"{names[j]} and {names[i]} swapped", order, plus))
        moves = sorted(moves, key=lambda move: -move[0])[:MAX_MOVES]
        best = linear_sum_assignment(-np.abs(match))[1]
        signs = np.where(match[same, best] < 0.0, -1.0, 1.0)
        label = ", ".join(
            f"{names[i]} follows {names[best[i]]}" for i in same if best[i] != i
        )
        if label:
            moves += [
                (0.0, label, best, plus),
                (0.0, f"{label}, with signs", best, signs),
            ]

        def reordered(order: IntArray, sign: FloatArray) -> Callable[[Setup], Setup]:
            def apply(before: Setup) -> Setup:
                source, signs, origin = (
                    before.source.copy(),
                    before.sign.copy(),
                    before.origin.copy(),
                )
                source[actuators] = setup.source[actuators[order]]
                origin[actuators] = setup.origin[actuators[order]]
                signs[actuators] = sign
                return replace(before, source=source, sign=signs, origin=origin)

            return apply

        return tuple((label, reordered(order, sign)) for _, label, order, sign in moves)

    # --- bodies, time and the world ----------------------------------------------------------------------------------

    def _gravity(self) -> Cause:
        """Return size and direction of gravity; a tilt of the base is the same."""

        def apply(before: Setup, values: FloatArray) -> Setup:
            after = before.with_model()
            after.model.opt.gravity[:] = values
            return after

        names = ("gravity x", "gravity y", "gravity z")
        axes = np.eye(3)
        cause = _cause(
            "gravity or tilt",
            "m/s^2",
            names,
            np.array(self.model.opt.gravity),
            np.ones(3),
            apply,
        )
        groups = (
            Group("size", axes[:, 2:]),
            Group("tilt", axes[:, :2]),
            Group("size and tilt", axes),
        )
        return replace(cause, groups=groups)

    def _mass_causes(self) -> list[Cause]:
        """Return mass and centre of each link, and a load on the base and on each end."""
        model = self.model
        moved = set(model.jnt_bodyid[self.places.joint].tolist())
        if self.has_base:
            moved.add(int(model.jnt_bodyid[0]))
        for body in range(1, model.nbody):
            if int(model.body_parentid[body]) in moved:
                moved.add(body)
        bodies = np.array(
            [body for body in sorted(moved) if model.body_mass[body] > 0.0]
        )
        names = [model.body(int(body)).name or f"body {body}" for body in bodies]
        count = len(bodies)
        mass, inertia = model.body_mass[bodies], model.body_inertia[bodies]
        size = np.maximum(np.sqrt(inertia.sum(axis=1) / mass), 0.01)

        def set_links(before: Setup, values: FloatArray) -> Setup:
            after = before.with_model()
            after.model.body_inertia[bodies] = (
                inertia * (values[:count] / mass)[:, None]
            )
            after.model.body_ipos[bodies] = values[count:].reshape(-1, 3)
            return _assign(("body_mass", bodies, 1.0))(after, values[:count])

        axes = np.eye(4 * count)
        groups = [Group("all masses", axes[:, :count].sum(axis=1, keepdims=True))]
        for index, name in enumerate(names):
            first = count + 3 * index
            groups.append(Group(f"mass of {name}", axes[:, [index]]))
            groups.append(Group(f"centre of {name}", axes[:, first : first + 3]))
        links = _cause(
            "mass or centre of a link",
            "kg, m",
            [*names, *(f"{name} {axis}" for name in names for axis in "xyz")],
            np.concatenate([mass, model.body_ipos[bodies].ravel()]),
            np.concatenate([mass, np.repeat(size, 3)]),
            set_links,
        )
        lower = np.repeat([-0.95, -3.0], [count, 3 * count])
        parents = model.body_parentid[bodies].tolist()
        is_end = np.array(
            [k == 0 or int(body) not in parents for k, body in enumerate(bodies)]
        )
        ends, carried = bodies[is_end], mass[is_end]

        def set_loads(before: Setup, values: FloatArray) -> Setup:
            return _assign(("body_mass", ends, 1.0))(before, carried + values)

        loaded = [name for name, end in zip(names, is_end, strict=True) if end]
        loads = _positive(
            "payload", "kg", loaded, 0.0 * carried, 0.2 * carried, set_loads
        )
        return [
            replace(links, lower=lower, groups=tuple(groups)),
            replace(loads, groups=loads.groups[: len(loaded)]),
        ]

    def _time(self) -> Cause:
        """Return the physics step, the decimation, and the clock of the log."""

        def stepped(step_s: float) -> Callable[[Setup], Setup]:
            def apply(before: Setup) -> Setup:
                after = before.with_model()
                after.model.opt.timestep = step_s
                return after

            return apply

        def repeated(repeat: int, phase: int) -> Callable[[Setup], Setup]:
            return lambda before: replace(before, repeat=repeat, phase=phase)

        def clocked(before: Setup, values: FloatArray) -> Setup:
            return replace(before, clock=float(values[0]))

        steps_s = [factor * self.model.opt.timestep for factor in STEPS]
        options = [
            (f"physics step of {1e3 * s:.3g} ms", stepped(s))
            for s in steps_s
            if s <= MAX_TIMESTEP_S
        ]
        for repeat in REPEATS if self.log.command_kind else ():
            label = f"only each {repeat}. command is used"
            options += [(label, repeated(repeat, phase)) for phase in range(repeat)]
        one = np.ones(1)
        cause = _cause("step and decimation", "s/s", ["clock"], 0.0 * one, one, clocked)
        timed = replace(cause, present=one, starts=CLOCKS, alternatives=tuple(options))
        return replace(timed, lower=0.2 * one, upper=5.0 * one)

    def _limits(self) -> Cause:
        """Return the stops of joints that dwell at an extreme of their motion, or pass the stop of the model."""
        log, model = self.log, self.model
        names, places, extremes, present = [], [], [], []
        for name, joint, column, noise in zip(
            log.joints,
            self.places.joint,
            log.position[log.valid].T,
            log.position_noise,
            strict=True,
        ):
            near = 4.0 * noise + 0.01 * np.ptp(column)
            bounds = (
                model.jnt_range[joint]
                if model.jnt_limited[joint]
                else (-UNLIMITED, UNLIMITED)
            )
            for side, sign in enumerate((-1.0, 1.0)):
                extreme = np.percentile(sign * column, 98.0)
                dwells = (
                    np.mean(sign * column > extreme - near) > MIN_DWELL
                    and np.ptp(column) > 10.0 * noise
                )
                if dwells or extreme > sign * bounds[side] + near:
                    names.append(f"{name} {('lower', 'upper')[side]}")
                    places.append((joint, side))
                    extremes.append(sign * extreme)
                    present.append(bounds[side])

        def apply(before: Setup, values: FloatArray) -> Setup:
            after = before.with_model()
            for (joint, side), value in zip(places, values, strict=True):
                if not after.model.jnt_limited[joint]:
                    after.model.jnt_limited[joint] = 1
                    after.model.jnt_range[joint] = -UNLIMITED, UNLIMITED
                after.model.jnt_range[joint, side] = value
            return after

        zero, far = np.array(extremes), np.full(len(names), 2.0 * UNLIMITED)
        cause = _cause("joint limit", "rad", names, zero, np.ones(len(names)), apply)
        bounds = {"present": np.array(present) - zero, "lower": -far, "upper": far}
        return replace(
            cause,
            groups=cause.groups[: len(names)],
            starts=(0.0, -0.02, 0.02),
            **bounds,
        )

    def _contact_causes(self) -> list[Cause]:
        """Return friction and softness of all contacts, as factors."""
        fields = {
            "floor friction": (
                ("geom_friction", np.s_[:, 0]),
                ("pair_friction", np.s_[:, :2]),
            ),
            "contact softness": (
                ("geom_solref", np.s_[:, 0]),
                ("pair_solref", np.s_[:, 0]),
            ),
        }
        one, found = np.ones(1), []
        for name, places in fields.items():
            present = [
                (field, index, getattr(self.model, field)[index].copy())
                for field, index in places
            ]
            cause = _positive(name, "", ["factor"], one, 0.0 * one, _assign(*present))
            found.append(replace(cause, starts=CONTACTS))
        return found


def _cause(
    name: str,
    measure: str,
    parameters: Sequence[str],
    present: FloatArray,
    unit: FloatArray,
    apply: Change,
) -> Cause:
    """Return a cause whose number 0 is the present value; all values are free, alone, or share a number."""
    count = len(parameters)
    groups = [Group(each, np.eye(count)[:, [k]]) for k, each in enumerate(parameters)]
    if count > 1:
        groups += [Group("all", np.ones((count, 1))), Group("each", np.eye(count))]
    zeros, far = np.zeros(count), np.full(count, 40.0)
    return Cause(
        name,
        measure,
        tuple(parameters),
        present,
        unit,
        zeros,
        -far,
        far,
        apply,
        tuple(groups),
    )


def _positive(
    name: str,
    measure: str,
    parameters: Sequence[str],
    present: FloatArray,
    typical: FloatArray,
    apply: Change,
) -> Cause:
    """Return a cause whose values stay positive; its numbers are fractions of the present or of a typical value."""
    unit = np.where(present > 0.2 * typical, present, typical)
    return replace(
        _cause(name, measure, parameters, present, unit, apply), lower=-present / unit
    )


def _assign(*fields: tuple[str, Any, Any], **constants: tuple[Any, Any]) -> Change:
    """Return a change of the model: fields take a factor times the values.

    Args:
        fields: Name, index and factor of each field.
        constants: Index and value of further fields.
    """

    def apply(before: Setup, values: FloatArray) -> Setup:
        after = before.with_model()
        for field, index, factor in fields:
            getattr(after.model, field)[index] = factor * values
        for field, (index, value) in constants.items():
            getattr(after.model, field)[index] = value
        mujoco.mj_setConst(after.model, mujoco.MjData(after.model))
        return after

    return apply
