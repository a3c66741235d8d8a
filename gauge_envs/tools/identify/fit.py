"""Settings of joints from logs: least squares over an engine's own simulation, with 95 % intervals.

Stage 1 fits short parts of the logs, each from its own start, so that a wrong period cannot slip by a whole swing.
Stage 2 goes on with long parts; the starts of joints without servos are then unknowns too.

The residuals are not white: what a model leaves out lasts. Their noise is a white part and one that decays by the same
share in each sample. Residual maximum likelihood (Patterson and Thompson, Biometrika 58, 1971) finds both: it counts
out what the unknowns take up of the noise. In Student's quantile N samples count as N / (1 + 2 sum of the correlation).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import matmul_toeplitz
from scipy.optimize import least_squares, minimize
from scipy.signal import lfilter
from scipy.special import expit
from scipy.stats import t as student

from gauge_envs.backends.base import Backend, scene_support
from gauge_envs.errors import ParameterError, UnsupportedSceneError
from gauge_envs.runs.rollout import DivergedError
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.meshes import body_mass_properties
from gauge_envs.tools.identify.logs import Log
from gauge_envs.tools.identify.rig import (
    DYNAMICS,
    SERVO,
    Terms,
    check_joints,
    numbers,
    simulated,
    with_terms,
)

FREE_PARTS_S, SERVO_PARTS_S = (0.6, np.inf), (5.0, 20.0)
"""Longest part of a log in both stages [s]; a servo forgets its start."""
LOST_RAD = 10.0
"""Error of a simulation that diverges [rad], so that the search turns back."""
LASTING = (0.0, 2.0, 4.0)
"""Logits of the decay from which the search for the noise starts."""
FEWEST = 10.0
"""Samples that at least count in the quantile: noise that lasts longer is known from its shocks."""
STEP, DELAY_STEP = 1e-3, 0.1
"""Step of the differences, over the size of a parameter; engines follow commands in intervals of 5.6 ms."""
ALIKE = 0.98
"""Correlation from which the data does not tell two parameters apart."""

Start = tuple[FloatArray, FloatArray]


@dataclass(frozen=True, kw_only=True)
class Setting:
    """Identified number of one joint.

    Attributes:
        joint: Number of the joint in the log.
        name: Field of `JointDynamics` or `Servo`.
        value: Its value, in the unit of its name.
        low, high: 95 % interval; not below 0.
        unknown: Why the data does not determine it, or "".
    """

    joint: int
    name: str
    value: float
    low: float
    high: float
    unknown: str = ""


@dataclass(frozen=True, kw_only=True)
class Identified:
    """What logs say about joints in an engine.

    Attributes:
        engine: Name of the engine.
        settings: The identified numbers, by joint.
        joints: All numbers of each joint by name, also those that the scene states; 0 is none.
        error_rad: Root mean square error of each log that was fitted [rad], by its name, shape [J] each.
        held_out_rad: The same of logs that were not.
        motion_rad: Standard deviation of the measured angles of each log [rad].
        simulations: Number of simulated parts of logs.
    """

    engine: str
    settings: tuple[Setting, ...]
    joints: Sequence[Mapping[str, float]]
    error_rad: Mapping[str, FloatArray]
    held_out_rad: Mapping[str, FloatArray] = field(default_factory=dict)
    motion_rad: Mapping[str, FloatArray] = field(default_factory=dict)
    simulations: int = 0

    @property
    def lost(self) -> list[str]:
        """Names of the fitted logs of which the error is above a third of the motion, and above 0.01 rad."""
        motion = self.motion_rad
        return [
            name
            for name, error in self.error_rad.items()
            if (error > np.maximum(motion[name] / 3.0, 0.01)).any()
        ]


@dataclass
class _Problem:
    """Residuals of parts of logs as a function of scaled unknowns.

    Attributes:
        starts: Start of each part. Free starts are unknowns, which come behind the numbers of the joints.
    """

    engine: Backend
    scene: Scene
    settings: Mapping[str, Any] | None
    parts: list[Log]
    starts: list[Start]
    names: tuple[str, ...]
    sizes: FloatArray
    zero: bool
    free_starts: bool
    simulations: int = 0

    @property
    def joints(self) -> int:
        return len(self.scene.hinges)

    @property
    def kinds(self) -> int:
        """Number of unknowns of a joint in all parts: its numbers, and the log's angle at rest."""
        return len(self.names) + self.zero

    def unknowns(
        self, scaled: FloatArray
    ) -> tuple[list[Terms], FloatArray, FloatArray]:
        """Return numbers of each joint, angles at rest [J], and changes of the starts, shape [part_count, 2, J]."""
        of_joints = scaled[: self.kinds * self.joints].reshape(self.kinds, self.joints)
        values = of_joints[: len(self.names)] * self.sizes
        terms: list[Terms] = [
            dict(zip(self.names, column.tolist(), strict=True)) for column in values.T
        ]
        moved = (
            scaled[of_joints.size :].reshape(-1, 2, self.joints)
            if self.free_starts
            else None
        )
        still = np.zeros((len(self.parts), 2, self.joints))
        return (
            terms,
            of_joints[-1] if self.zero else np.zeros(self.joints),
            still if moved is None else moved,
        )

    def errors(
        self, scaled: FloatArray, *, may_diverge: bool = False
    ) -> list[FloatArray]:
        """Return simulated less measured angles of each part [rad], shape [N, J] each."""
        terms, zero, moved = self.unknowns(scaled)
        self.simulations += len(self.parts)
        errors = []
        for part, start, shift in zip(self.parts, self.starts, moved, strict=True):
            begin = (start[0] - zero + shift[0], start[1] + shift[1])
            try:
                angles = zero + simulated(
                    self.engine, self.scene, part, terms, begin, self.settings
                )
                errors.append(angles - part.position_rad)
            except DivergedError:
                if not may_diverge:
                    raise
                errors.append(np.full(part.position_rad.shape, LOST_RAD))
        return errors

    def residuals(self, scaled: FloatArray) -> FloatArray:
        """Return simulated less measured angles [rad], those of all samples of a part and joint together."""
        return np.concatenate(
            [errors.T.ravel() for errors in self.errors(scaled, may_diverge=True)]
        )

    def jacobian(self, scaled: FloatArray) -> FloatArray:
        """Return forward differences. One number of all joints changes at once: that of one moves the others little."""
        before = self.residuals(scaled)
        jacobian = np.zeros((before.size, scaled.size))
        rows, first_start = self._rows(), self.kinds * self.joints
        for kind in range(self.kinds):
            columns = kind * self.joints + np.arange(self.joints)
            step = DELAY_STEP if self.names[kind : kind + 1] == ("delay_s",) else STEP
            change = self._changed(scaled, columns, before, step)
            for joint, column in enumerate(columns):
                inside = rows[:, 1] == joint
                jacobian[inside, column] = change[inside]
        for kind in range(2 if self.free_starts else 0):
            places = (
                first_start
                + np.arange(len(self.parts) * 2 * self.joints).reshape(
                    -1, 2, self.joints
                )[:, kind]
            )
            change = self._changed(scaled, places.ravel(), before, STEP)
            for number, joint in np.ndindex(places.shape):
                inside = (rows == (number, joint)).all(axis=1)
                jacobian[inside, places[number, joint]] = change[inside]
        return jacobian

    def _changed(
        self,
        scaled: FloatArray,
        columns: NDArray[np.intp],
        before: FloatArray,
        step: float,
    ) -> FloatArray:
        moved = scaled.copy()
        moved[columns] += step
        return (self.residuals(moved) - before) / step

    def _rows(self) -> NDArray[np.intp]:
        """Return number of the part and of the joint of each residual, shape [residual_count, 2]."""
        return np.concatenate(
            [
                np.full((len(part.times_s), 2), (number, joint))
                for number, part in enumerate(self.parts)
                for joint in range(self.joints)
            ]
        )

    def best_start(self) -> FloatArray:
        """Return the first guesses: of seven stiffnesses of a servo, and two angles at rest, what follows best."""
        guesses = []
        middle = float(
            np.mean(np.concatenate([part.position_rad for part in self.parts]))
        )
        for scale in (
            (1.0, 0.03, 0.1, 0.3, 3.0, 10.0, 30.0) if SERVO[0] in self.names else (1.0,)
        ):
            joint_guess = [
                {SERVO[0]: scale, SERVO[1]: np.sqrt(scale)}.get(name, 1.0)
                for name in self.names
            ]
            guesses += [
                np.repeat([*joint_guess, *zero], self.joints)
                for zero in ([[0.0], [middle]] if self.zero else [[]])
            ]
        return min(guesses, key=lambda guess: float((self.residuals(guess) ** 2).sum()))

    def solved(
        self, first: FloatArray, tolerance: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return the unknowns of the least squares, and their covariance."""
        low = np.full(first.size, -np.inf)
        low[: len(self.names) * self.joints] = 0.0
        found = least_squares(
            self.residuals,
            np.maximum(first, low + 1e-6),
            self.jacobian,
            bounds=(low, np.inf),
            xtol=tolerance,
            ftol=tolerance,
        )
        self._check_margin(found.x)
        return found.x, self._covariance(found.jac, found.fun)

    def _check_margin(self, scaled: FloatArray) -> None:
        """Raise `DivergedError` if the engine diverges with numbers that are a tenth larger, and say a shorter step."""
        larger, count = scaled.copy(), len(self.names) * self.joints
        larger[:count] *= 1.1
        if (
            max(np.abs(one).max() for one in self.errors(larger, may_diverge=True))
            < LOST_RAD
        ):
            return
        step_s = float(
            self.engine.build(self.scene, self.settings).settings["timestep_s"]
        )
        advice = (
            f"also with a step of {step_s / 64:.6g} s: choose another engine or preset"
        )
        for shorter_s in step_s / 2.0 ** np.arange(1, 7):
            other = replace(
                self, settings={**(self.settings or {}), "timestep_s": shorter_s}
            )
            if (
                max(np.abs(one).max() for one in other.errors(larger, may_diverge=True))
                < LOST_RAD
            ):
                advice = f"give timestep_s={shorter_s:.6g} or less; it is {step_s:.6g}"
                break
        raise DivergedError(
            f"{self.engine.name} diverges close to the best settings: {advice}"
        )

    def _covariance(self, jacobian: FloatArray, residuals: FloatArray) -> FloatArray:
        """Return the covariance of the unknowns under lasting noise, shape [unknown_count, unknown_count].

        Least squares gives (J'J)^-1 J' C J (J'J)^-1 for residuals of covariance C (Aitken 1935). The noise of a joint
        is stationary in each part of a log, so that C is a Toeplitz matrix there, and 0 between parts.
        """
        rows = self._rows()
        inverse = np.linalg.pinv(jacobian.T @ jacobian)
        middle = np.zeros_like(inverse)
        for joint in range(self.joints):
            parts = [
                np.flatnonzero((rows == (number, joint)).all(axis=1))
                for number in range(len(self.parts))
            ]
            variance, neighbours, decay = self._noise_of(parts, jacobian, residuals)
            # N samples count as N / (1 + 2 sum of the correlation), a geometric series.
            correlation = neighbours / max(variance * (1.0 - decay), 1e-300)
            count = sum(len(part) for part in parts) / (1.0 + 2.0 * correlation)
            wider = student.ppf(0.975, max(count, FEWEST)) / 1.96
            for part in parts:
                lags = np.arange(len(part) - 1)
                covariance = np.concatenate([[variance], neighbours * decay**lags])
                sensitivity = jacobian[part]
                middle += (
                    sensitivity.T @ matmul_toeplitz(covariance, sensitivity) * wider**2
                )
        return np.asarray(inverse @ middle @ inverse)

    def _noise_of(
        self,
        parts: Sequence[NDArray[np.intp]],
        jacobian: FloatArray,
        residuals: FloatArray,
    ) -> tuple[float, float, float]:
        """Return the noise of one joint, from the rows of its residuals in each part; see `_noise`."""
        inside = np.concatenate(parts)
        left, singular_values, _ = np.linalg.svd(jacobian[inside], full_matrices=False)
        explained = left[:, singular_values > 1e-12 * singular_values[0]]
        table = np.column_stack([explained, residuals[inside]])
        ends = np.cumsum([len(part) for part in parts])
        return _noise(np.split(table, ends[:-1]))


def _noise(parts: Sequence[FloatArray]) -> tuple[float, float, float]:
    """Return the noise of residuals by residual maximum likelihood.

    Args:
        parts: Of each part of a log columns that span what the unknowns can change, and the residuals.

    Returns:
        Its variance, the covariance of neighbouring samples, and the share of it that each further sample keeps.
    """

    def whitened(logits: FloatArray) -> tuple[float, float, float, float]:
        """Return the two numbers of the process, the sum of its squared shocks, and what is to be minimized."""
        decay = min(float(expit(logits[0])), 1.0 - 1e-6)
        forgotten = decay * float(expit(logits[1]))
        table = np.concatenate(
            [lfilter([1.0, -decay], [1.0, -forgotten], part, axis=0) for part in parts]
        )
        turned, corner = np.linalg.qr(table[:, :-1])
        power = max(
            float(table[:, -1] @ table[:, -1] - ((turned.T @ table[:, -1]) ** 2).sum()),
            1e-300,
        )
        freedom = len(table) - len(corner)
        shock = power / freedom
        return (
            decay,
            forgotten,
            shock,
            freedom * np.log(shock) + 2.0 * np.log(np.abs(np.diag(corner))).sum(),
        )

    found = [
        minimize(lambda logits: whitened(logits)[3], [first, 0.0], method="Nelder-Mead")
        for first in LASTING
    ]
    decay, forgotten, shock, _ = whitened(min(found, key=lambda one: float(one.fun)).x)
    apart = shock * (decay - forgotten) / (1.0 - decay**2)
    return shock + apart * (decay - forgotten), apart * (1.0 - decay * forgotten), decay


def identify(
    engine: Backend,
    scene: Scene,
    logs: Sequence[Log],
    names: Sequence[str],
    *,
    held_out: Sequence[Log] = (),
    part_s: float | None = None,
    settings: Mapping[str, Any] | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Identified:
    """Return the settings of joints with which an engine follows logs best.

    Args:
        engine: The engine.
        scene: A scene in which each hinge is at angle 0; its hinges are the joints of the logs, in its order.
        logs: Logs to fit.
        names: Numbers to identify, fields of `JointDynamics` and `Servo`.
        held_out: Logs that are only predicted, with the identified numbers.
        part_s: Longest part of a log in stage 2 [s]; None is 20 s for servos and the whole log for others.
        settings: Numerical settings of the engine.
        progress: Called with what is being done.

    Raises:
        ParameterError: The logs do not fit the scene or each other, or a name is unknown.
        UnsupportedSceneError: The engine does not build such a joint.
        DivergedError: The engine diverges with the best settings, or close to them.
    """
    servo = logs[0].command_rad is not None
    for log in (*logs, *held_out):
        check_joints(scene, log)
        if (log.command_rad is not None) != servo:
            raise ParameterError(
                f"{log.name}: all logs must state commands of servos, or none"
            )
    for name in names:
        if name not in (*DYNAMICS, *SERVO) or (name in SERVO[:2] and not servo):
            known = ", ".join((*DYNAMICS, *SERVO) if servo else (*DYNAMICS, "delay_s"))
            raise ParameterError(f"{name}: no number of such a joint; known: {known}")
    terms = guessed(scene, names)
    built = with_terms(scene, terms, logs[0], np.zeros(len(scene.hinges)))
    support = scene_support(engine, built)
    if not support:
        raise UnsupportedSceneError(
            f"backend {engine.name!r}: {'; '.join(support.missing)}"
        )
    sizes = np.array([[one[name] for one in terms] for name in names])
    problem = partial(
        _Problem,
        engine,
        scene,
        settings,
        names=tuple(names),
        sizes=sizes,
        zero=len(scene.hinges) == 1 and not servo,
    )
    stages = []
    first_s, long_s = SERVO_PARTS_S if servo else FREE_PARTS_S
    part_s = part_s or long_s
    for log in logs:
        apart_s = float(np.median(np.diff(log.times_s)))
        if 10.0 * apart_s > first_s:
            reason = f"samples are {apart_s:.3g} s apart, and at least 10 in {first_s:g} s are needed"
            raise ParameterError(f"{log.name}: {reason}; time_s is in seconds")
    for longest_s, free in ((first_s, False), (part_s, not servo)):
        parts = [
            part
            for log in logs
            for part in log.pieces(longest_s)
            if len(part.times_s) >= 10
        ]
        stages.append(
            problem(parts, [part.start() for part in parts], free_starts=free)
        )
    short, long = stages
    unknowns = short.best_start()
    progress(f"{len(short.parts)} short parts of {len(logs)} logs")
    unknowns, _ = short.solved(unknowns, 1e-2)
    progress(f"{len(long.parts)} long parts")
    if long.free_starts:
        unknowns = np.concatenate(
            [unknowns, np.zeros(2 * len(long.parts) * len(scene.hinges))]
        )
    unknowns, covariance = long.solved(unknowns, 1e-4)
    found = _settings(long, unknowns, covariance)
    return Identified(
        engine=engine.name,
        settings=found,
        joints=numbers(
            with_terms(
                scene, long.unknowns(unknowns)[0], logs[0], np.zeros(long.joints)
            )
        ),
        error_rad=_errors(long, unknowns),
        held_out_rad=_held_out(problem, held_out, part_s, long, unknowns)
        if held_out
        else {},
        motion_rad={
            log.name: log.position_rad.std(axis=0) for log in (*logs, *held_out)
        },
        simulations=short.simulations + long.simulations,
    )


def guessed(scene: Scene, names: Sequence[str]) -> list[Terms]:
    """Return first guesses and sizes of numbers: what the scene states, or from all moving bodies at its first hinge.

    One size does for all joints of an arm: the search starts from seven stiffnesses, and its steps are relative.
    """
    bodies, anchor_m = scene.dynamic_bodies, scene.hinges[0].anchor_m
    load = [
        (body, np.linalg.norm(np.subtract(body.pose.position_m, anchor_m)))
        for body in bodies
    ]
    about_centres = sum(
        float(np.trace(body_mass_properties(body)[1])) / 3.0 for body in bodies
    )
    inertia = about_centres + sum(
        body.mass_kg * float(arm_m) ** 2 for body, arm_m in load
    )
    weight = max(
        scene.gravity_m_per_s2
        * sum(body.mass_kg * float(arm_m) for body, arm_m in load),
        40.0 * inertia,
    )
    rate = float(np.sqrt(weight / inertia))
    guesses = {
        "dry_friction_n_m": 0.01 * weight,
        "viscous_friction_n_m_s_per_rad": 0.02 * weight / rate,
        "armature_kg_m2": 0.1 * inertia,
        "kp_n_m_per_rad": 10.0 * weight,
        "kv_n_m_s_per_rad": weight / rate,
        "delay_s": 0.02,
    }
    return [
        {name: known[name] or guesses[name] for name in names}
        for known in numbers(scene)
    ]


def _settings(
    problem: _Problem, unknowns: FloatArray, covariance: FloatArray
) -> tuple[Setting, ...]:
    std = np.sqrt(np.diag(covariance))
    found = []
    for joint in range(problem.joints):
        columns = [kind * problem.joints + joint for kind in range(len(problem.names))]
        block = covariance[np.ix_(columns, columns)]
        sizes = np.sqrt(np.diag(block))
        alike = block / np.maximum(np.outer(sizes, sizes), 1e-300)
        torques = [kind for kind, name in enumerate(problem.names) if name != SERVO[2]]
        is_scale = len(torques) > 2 and bool(
            (alike[np.ix_(torques, torques)] > ALIKE).all()
        )
        for kind, name in enumerate(problem.names):
            value, half = unknowns[columns[kind]], 1.96 * std[columns[kind]]
            twins = [
                other
                for k, other in enumerate(problem.names)
                if k != kind and abs(alike[kind, k]) > ALIKE
            ]
            unknown = (
                f"goes with {' and '.join(twins)}"
                if twins and half > 0.1 * value
                else ""
            )
            if is_scale and unknown and kind in torques:
                unknown = "only ratios of torques are told: a weight or a known armature would tell their scale"
            if not unknown and half >= value:
                unknown = "0 is in the interval"
            size = problem.sizes[kind, joint]
            low, high = max(value - half, 0.0) * size, (value + half) * size
            found.append(
                Setting(
                    joint=joint,
                    name=name,
                    value=value * size,
                    low=low,
                    high=high,
                    unknown=unknown,
                )
            )
    return tuple(found)


def _errors(problem: _Problem, unknowns: FloatArray) -> dict[str, FloatArray]:
    """Return the root mean square error of each log [rad], over its parts."""
    squares: dict[str, list[FloatArray]] = {}
    for errors, part in zip(problem.errors(unknowns), problem.parts, strict=True):
        squares.setdefault(part.name.split(", part ")[0], []).append(errors**2)
    return {
        name: np.sqrt(np.concatenate(parts).mean(axis=0))
        for name, parts in squares.items()
    }


def _held_out(
    problem: Callable[..., _Problem],
    logs: Sequence[Log],
    longest_s: float,
    fitted: _Problem,
    unknowns: FloatArray,
) -> dict[str, FloatArray]:
    """Return the errors of other logs [rad], in parts of at most a length, as those that are fitted.

    Each part has a start of its own, which is fitted where the joint has no servo.
    """
    of_joints = unknowns[: fitted.kinds * fitted.joints]
    errors: dict[str, FloatArray] = {}
    for log in logs:
        parts = list(log.pieces(longest_s))
        other = problem(
            parts, [part.start() for part in parts], free_starts=fitted.free_starts
        )
        if not fitted.free_starts:
            errors |= _errors(other, of_joints)
            continue
        starts = least_squares(
            lambda starts, one=other: one.residuals(
                np.concatenate([of_joints, starts])
            ),
            np.zeros(2 * len(parts) * fitted.joints),
            diff_step=STEP,
            x_scale=0.01,
            xtol=1e-5,
        ).x
        errors |= _errors(other, np.concatenate([of_joints, starts]))
    return errors
