"""Settings of joints from logs: least squares over an engine's own simulation, with 95 % intervals.

Stage 1 fits short parts of the logs, each from its own start, so that a wrong period cannot slip by a whole swing.
Stage 2 goes on with long parts; the starts of joints without servos are then unknowns too. What stage 2 leaves
open of servos is then set to what the scene states, one number of a joint at a time, and the rest is fitted again.

The residuals are not white: what a model leaves out lasts. Their noise is a white part and one that decays by the same
share in each sample. Residual maximum likelihood (Patterson and Thompson, Biometrika 58, 1971) finds both: it counts
out what the unknowns take up of the noise. In Student's quantile N samples count as N / (1 + 2 sum of the correlation).
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from mujoco import MjSpec
from numpy.typing import NDArray
from scipy.linalg import matmul_toeplitz
from scipy.optimize import OptimizeResult, least_squares, minimize
from scipy.signal import lfilter
from scipy.special import expit
from scipy.stats import t as student

from gauge_envs.backends.base import Backend, Feature, scene_support
from gauge_envs.backends.settings import with_drive_interval
from gauge_envs.errors import ParameterError, UnsupportedSceneError
from gauge_envs.runs.rollout import DivergedError
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import DRIVE_INTERVAL_S
from gauge_envs.tools.identify.baselines import baselines
from gauge_envs.tools.identify.logs import Log
from gauge_envs.tools.identify.mujoco_joints import (
    ModelJoints,
    joint_names,
    joints_of_model,
    joints_of_scene,
)
from gauge_envs.tools.identify.rig import (
    DYNAMICS,
    LIMIT,
    OFFSET,
    SERVO,
    Machine,
    SceneJoints,
    Terms,
    check_joints,
    with_terms,
)
from gauge_envs.tools.identify.servo_laws import (
    DIRECTED,
    DIRECTED_STRIBECK,
    IN_ONE,
    LOAD,
    LOAD_STRIBECK,
    QUADRATIC_LOAD,
    SERVO_FRICTION,
    STRIBECK,
    TERMS,
)
from gauge_envs.tools.identify.snippets import snippet_lines
from gauge_envs.tools.identify.spread import (
    NORMAL_95,
    pattern,
    sensor_noise_rad,
    spread_of,
)

FREE_PARTS_S, SERVO_PARTS_S = (0.6, np.inf), (5.0, 20.0)
"""Longest part of a log in both stages [s]; a servo forgets its start."""
FIRST_STAGE_S = 15.0
"""About how much of the logs stage 1 uses, evenly spread [s]: it seeks the neighbourhood alone."""
ZERO = "0 is in the interval"
SCALE = "only ratios of torques are told: a weight or a known armature would tell their scale"
NEAR, CLOSE, SERVO_CLOSE, SHORT_STEPS = 1e-2, 1e-4, 1e-3, 8
"""Relative change at which a stage ends: the first, the second, that of servos; most steps of the first."""
STARTS, DEADBAND_RAD = 3, 0.01
"""Number of stiffnesses from which a servo's fit starts; angle within which dry friction holds it in one more start."""
FIRST_DAMPING, EASE, TRIES, MOST_STEPS = 1e-2, 5.0, 4, 40
"""Damping of the first step of a joint, its factor after a step, trials of a step, and most steps."""
LOST_RAD = 10.0
"""Error of a simulation that diverges [rad], so that the search turns back."""
LASTING = (0.0, 2.0, 4.0)
"""Logits of the decay from which the search for the noise starts."""
FEWEST = 10.0
"""Samples that at least count in the quantile: noise that lasts longer is known from its shocks."""
STEP, DELAY_STEP = 1e-3, 0.1
"""Step of the differences, over the size of a parameter; engines follow commands in intervals of 5.6 ms."""
SENSELESS, UNBOUNDED = 1e-9, 1e3
"""Change of all angles [rad] per scaled unknown below which logs do not depend on it; its uncertainty then."""
PLAUSIBLE = 2.0
"""Distance, over half of the interval, up to which a fit with what the scene states is tried."""
AS_WELL, REFIT_STEPS = 1.01, 8
"""Error over that of the best fit up to which a fit with fewer numbers follows logs as well, and its most steps."""
SHARES = ((1.0, 0.01), (1.0, 1.0), (0.3, 1.0), (0.3, 3.0), (0.1, 3.0))
"""Factors of dry friction, and of new terms of friction, from which the fit of a law starts; first nearly none."""
LAW_STEPS = 15
"""Most steps of the fit of a law to one log, which starts from a fit to all of them."""
AS_GOOD = 1.05
"""Error over that of the law that predicts best, up to which a law with fewer terms is as good."""
FEWEST_FILES = 2
"""Number of files whose spread is too uncertain to leave a number out."""
ZERO_NEXT = "0 is in the interval of the next file"
TRADE = 0.9
"""Correlation from which two numbers are printed as a group."""
QUADRATIC = DYNAMICS[3]
LAWS = {
    "dry": (DYNAMICS[0], DYNAMICS[2]),
    "viscous": (DYNAMICS[1], DYNAMICS[2]),
    "dry and viscous": DYNAMICS[:3],
    "dry and quadratic": (DYNAMICS[0], DYNAMICS[2], QUADRATIC),
    "dry, viscous and quadratic": DYNAMICS,
}
"""Names that are identified in each law of friction of a joint without a servo."""
SERVO_NAMES = (DYNAMICS[0], DYNAMICS[2], *SERVO)
"""What is identified of a servo unless names are given; kv holds the viscous friction of its joint."""
ALIKE = 0.98
"""Correlation from which the data does not tell two parameters apart."""

Start = tuple[FloatArray, FloatArray]


@dataclass(frozen=True, kw_only=True)
class Setting:
    """Identified number of one joint.

    Attributes:
        joint: Number of the joint in the log.
        joint_name: Its name.
        name: Field of `JointDynamics` or `Servo`.
        value: Its value, in the unit of its name.
        low, high: 95 % interval of the least squares over all logs; of an offset alone it may be below 0.
        std: Its standard error.
        of_files: Values of fits to each log alone.
        of_files_std: Their standard errors.
        next_low, next_high: 95 % interval of the value of the next file; None without a second file.
        between: Standard deviation between files, beyond the uncertainty of each.
        is_known: Whether it was given.
        unknown: Why the data does not determine it, or "".
        pasted: Its value in the lines to paste, where undetermined numbers are as the scene states; None is left out.
    """

    joint: int
    joint_name: str
    name: str
    value: float
    low: float
    high: float
    unknown: str = ""
    pasted: float | None = None
    std: float = 0.0
    of_files: tuple[float, ...] = ()
    of_files_std: tuple[float, ...] = ()
    next_low: float | None = None
    next_high: float | None = None
    between: float | None = None
    is_known: bool = False


@dataclass(frozen=True, kw_only=True)
class Law:
    """How well a law of friction follows logs, each fitted alone.

    Attributes:
        name: Name of the law.
        fitted_rad: Root mean square error of the fits [rad], each from its fitted start.
        held_out_rad: That of predictions of the other logs, from their recorded starts [rad].
        is_as_good: Whether the logs do not tell it from the law that predicts best.
    """

    name: str
    fitted_rad: float
    held_out_rad: float
    is_as_good: bool = False


@dataclass(frozen=True, kw_only=True)
class Identified:
    """What logs say about joints in an engine.

    Attributes:
        engine: Name of the engine.
        settings: The identified numbers, by joint.
        joints: All numbers of each joint by name, also those that the scene states; 0 is none.
        names: Names of the joints.
        lines: Lines to paste.
        stack_lines: Those of a training stack.
        error_rad: Root mean square error of each log that was fitted [rad], by its name, shape [J] each.
        held_out_rad: The same of logs that were not, each from its recorded start.
        motion_rad: Standard deviation of the measured angles of each log [rad].
        plain_rad: Errors of plain laws without a model [rad], by log and law, shape [J] each; see `baselines`.
        noise_rad: Noise of the sensor, from what is left of a fit [rad], shape [J].
        patterns: What is left of each fitted log looks like: words by joint.
        trades: Sentences about numbers that the logs hardly tell apart.
        laws: Laws of friction that were compared, the chosen one first.
        files: Number of logs that were fitted.
        is_replayed: Whether the errors are those of the pasted lines in plain MuJoCo, each log from its recorded start.
        simulations: Number of simulated parts of logs.
    """

    engine: str
    settings: tuple[Setting, ...]
    joints: Sequence[Mapping[str, float]]
    error_rad: Mapping[str, FloatArray]
    names: tuple[str, ...] = ()
    lines: str = ""
    stack_lines: str = ""
    held_out_rad: Mapping[str, FloatArray] = field(default_factory=dict)
    motion_rad: Mapping[str, FloatArray] = field(default_factory=dict)
    plain_rad: Mapping[str, Mapping[str, FloatArray]] = field(default_factory=dict)
    noise_rad: FloatArray = field(default_factory=lambda: np.zeros(0))
    patterns: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    trades: tuple[str, ...] = ()
    laws: tuple[Law, ...] = ()
    files: int = 1
    is_replayed: bool = False
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
        fixed: Values of numbers that are no unknowns, NaN for the others, shape [name_count, J].
    """

    machine: Machine
    parts: list[Log]
    starts: list[Start]
    names: tuple[str, ...]
    sizes: FloatArray
    zero: bool
    free_starts: bool
    fixed: FloatArray
    simulations: int = 0
    _last: tuple[FloatArray, FloatArray] = (np.zeros(0), np.zeros(0))

    @property
    def joints(self) -> int:
        return len(self.machine.stated)

    @property
    def kinds(self) -> int:
        """Number of unknowns of a joint in all parts: its numbers, and the log's angle at rest."""
        return len(self.names) + self.zero

    @property
    def shifts(self) -> FloatArray:
        """Unknowns at which numbers are 0, shape [name_count, 1]; none is negative, though an offset may be."""
        return np.array([[float(name == OFFSET)] for name in self.names])

    def unknowns(
        self, scaled: FloatArray
    ) -> tuple[list[Terms], FloatArray, FloatArray]:
        """Return numbers of each joint, angles at rest [J], and changes of the starts, shape [part_count, 2, J]."""
        of_joints = scaled[: self.kinds * self.joints].reshape(self.kinds, self.joints)
        values = (of_joints[: len(self.names)] - self.shifts) * self.sizes
        values = np.where(np.isnan(self.fixed), values, self.fixed)
        terms: list[Terms] = [
            dict(zip(self.names, column.tolist(), strict=True)) for column in values.T
        ]
        moved = np.zeros((len(self.parts), 2, self.joints))
        if self.free_starts:
            moved = scaled[of_joints.size :].reshape(moved.shape)
        return terms, of_joints[-1] if self.zero else np.zeros(self.joints), moved

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
                angles = zero + self.machine.angles(part, terms, begin)
                errors.append(angles - part.position_rad)
            except DivergedError:
                if not may_diverge:
                    raise
                errors.append(np.full(part.position_rad.shape, LOST_RAD))
        return errors

    def squares(self, scaled: FloatArray) -> FloatArray:
        """Return the sum of the squared errors of each joint [rad^2], shape [J]."""
        errors = self.errors(scaled, may_diverge=True)
        return np.asarray(sum((one**2).sum(axis=0) for one in errors))

    def diverges(self, scaled: FloatArray) -> bool:
        """Return whether the engine diverges in a part."""
        errors = self.errors(scaled, may_diverge=True)
        return bool(max(np.abs(one).max() for one in errors) >= LOST_RAD)

    def residuals(self, scaled: FloatArray) -> FloatArray:
        """Return simulated less measured angles [rad], those of all samples of a part and joint together."""
        errors = self.errors(scaled, may_diverge=True)
        residuals = np.concatenate([one.T.ravel() for one in errors])
        self._last = scaled.copy(), residuals
        return residuals

    def jacobian(self, scaled: FloatArray) -> FloatArray:
        """Return forward differences. One number of all joints changes at once: that of one moves the others little."""
        before = self._last[1]
        if not np.array_equal(self._last[0], scaled):
            before = self.residuals(scaled)
        jacobian = np.zeros((before.size, scaled.size))
        rows, first_start = self._rows(), self.kinds * self.joints
        for kind in range(self.kinds):
            columns = kind * self.joints + np.arange(self.joints)
            is_free = np.full(self.joints, True)
            if kind < len(self.names):
                is_free = np.isnan(self.fixed[kind])
            if not is_free.any():
                continue
            step = DELAY_STEP if self.names[kind : kind + 1] == ("delay_s",) else STEP
            change = self._changed(scaled, columns, before, step)
            for joint in np.flatnonzero(is_free):
                inside = rows[:, 1] == joint
                jacobian[inside, columns[joint]] = change[inside]
        for kind in range(2 if self.free_starts else 0):
            every = np.arange(first_start, scaled.size)
            places = every.reshape(-1, 2, self.joints)[:, kind]
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
        counts = [len(part.times_s) for part in self.parts]
        pairs = np.array(list(np.ndindex(len(self.parts), self.joints)))
        return pairs.repeat(np.repeat(counts, self.joints), axis=0)

    def first_guesses(self) -> list[FloatArray]:
        """Return first guesses: seven stiffnesses of a servo, or two angles at rest of a free joint."""
        guesses = []
        angles_rad = np.concatenate([part.position_rad for part in self.parts])
        middle = float(angles_rad.mean())
        scales = (1.0, 0.03, 0.1, 0.3, 3.0, 10.0, 30.0)
        damped = SERVO[1] if SERVO[1] in self.names else DYNAMICS[1]
        for scale in scales if SERVO[0] in self.names else scales[:1]:
            joint_guess = [
                {SERVO[0]: scale, damped: np.sqrt(scale)}.get(name, 1.0)
                for name in self.names
            ]
            guesses += [
                np.repeat([*joint_guess, *zero], self.joints)
                for zero in ([[0.0], [middle]] if self.zero else [[]])
            ]
        return guesses

    def neighbourhood(self) -> FloatArray:
        """Return the unknowns of a few steps of least squares from the best of the first guesses.

        A servo's errors have several minima: with a stiffness that is far too large, and without dry friction. So the
        search starts from three stiffnesses, and from the best of these once more with a play by dry friction of
        `DEADBAND_RAD`. As joints of an arm hardly move each other, each has the start that follows it best.
        """
        guesses = self._ranked(self.first_guesses())
        if SERVO[0] not in self.names:
            return self._least_squares(guesses[0], NEAR).x
        tried = [
            self._least_squares(one, NEAR, SHORT_STEPS).x for one in guesses[:STARTS]
        ]
        best = self._ranked(tried)[0]
        if DYNAMICS[0] in self.names:
            rubbing = best.reshape(self.kinds, self.joints).copy()
            dry, kp = (self.names.index(name) for name in (DYNAMICS[0], SERVO[0]))
            stiffness = rubbing[kp] * self.sizes[kp]
            rubbing[dry] = DEADBAND_RAD * stiffness / self.sizes[dry]
            other = self._least_squares(rubbing.ravel(), NEAR, SHORT_STEPS).x
            best = self._ranked([best, other])[0]
        return best

    def shared_out(self, first: FloatArray, new: NDArray[np.bool_]) -> FloatArray:
        """Return the best start of new terms of friction, which take over a share of the dry friction.

        Args:
            first: Unknowns of the joints.
            new: Which of the names are such terms, shape [name_count].
        """
        dry = self.names.index(DYNAMICS[0])
        starts = []
        for of_dry, of_new in SHARES:
            table = first.reshape(self.kinds, self.joints).copy()
            table[dry] *= of_dry
            table[: new.size][new] *= of_new
            starts.append(table.ravel())
        return self._ranked(starts)[0]

    def _ranked(self, unknowns: Sequence[FloatArray]) -> list[FloatArray]:
        """Return unknowns of which each joint has its best in the first, its second best in the second, and so on."""
        order = np.argsort([self.squares(one) for one in unknowns], axis=0)
        table = np.array([one.reshape(-1, self.joints) for one in unknowns])
        ranked = np.take_along_axis(table, order[:, None, :], axis=0)
        return [one.ravel() for one in ranked]

    def solved(
        self, first: FloatArray, tolerance: float, most: int | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the unknowns of the least squares after at most so many steps, and their covariance."""
        found = self._least_squares(first, tolerance, most)
        self._check_margin(found.x)
        return found.x, self._covariance(found.jac, found.fun)

    def _least_squares(
        self, first: FloatArray, tolerance: float, most: int | None = None
    ) -> OptimizeResult:
        if self.joints > 1 and SERVO[0] in self.names:
            return self._joint_by_joint(first, tolerance, most or MOST_STEPS)
        low = np.full(first.size, -np.inf)
        low[: len(self.names) * self.joints] = 0.0
        return least_squares(
            self.residuals,
            np.maximum(first, low + 1e-6),
            self.jacobian,
            bounds=(low, np.inf),
            xtol=tolerance,
            ftol=tolerance,
            max_nfev=most,
        )

    def _joint_by_joint(
        self, first: FloatArray, tolerance: float, most: int
    ) -> OptimizeResult:
        """Return the least squares of servos that hardly move each other: a step and a damping for each of them.

        The method is that of Levenberg and Marquardt (SIAM J. Appl. Math. 11, 1963). A number that would be negative is
        0.
        """
        joint_of_row = self._rows()[:, 1]
        table = np.maximum(first, 1e-6).reshape(self.kinds, self.joints)
        residuals = self.residuals(table.ravel())
        squares = np.bincount(joint_of_row, residuals**2)
        damping = np.full(self.joints, FIRST_DAMPING)
        jacobian = self.jacobian(table.ravel())
        for _ in range(most):
            before, waiting = squares, set(range(self.joints))
            for _ in range(TRIES):
                moved = table.copy()
                for joint in waiting:
                    moved[:, joint] += self._step(
                        joint, table, jacobian, residuals, damping[joint]
                    )
                moved = np.maximum(moved, 0.0)
                errors = self.residuals(moved.ravel())
                found = np.bincount(joint_of_row, errors**2)
                better = {joint for joint in waiting if found[joint] < squares[joint]}
                for joint in better:
                    table[:, joint] = moved[:, joint]
                    damping[joint] /= EASE
                waiting -= better
                if not waiting:
                    break
                damping[list(waiting)] *= EASE
            residuals = self.residuals(table.ravel())
            squares = np.bincount(joint_of_row, residuals**2)
            jacobian = self.jacobian(table.ravel())
            if (before - squares <= tolerance * before).all():
                break
        return OptimizeResult(x=table.ravel(), jac=jacobian, fun=residuals)

    def _step(
        self,
        joint: int,
        table: FloatArray,
        jacobian: FloatArray,
        residuals: FloatArray,
        damping: float,
    ) -> FloatArray:
        """Return the damped step of the unknowns of a joint, shape [kind_count]."""
        rows = self._rows()[:, 1] == joint
        slopes = jacobian[rows][:, np.arange(self.kinds) * self.joints + joint]
        normal, gradient = slopes.T @ slopes, slopes.T @ residuals[rows]
        # Numbers that are known, without effect, or 0 and would fall further, stay.
        free = (np.diag(normal) > 0.0) & ~((table[:, joint] <= 0.0) & (gradient > 0.0))
        step = np.zeros(self.kinds)
        inner = normal[np.ix_(free, free)]
        inner = inner + damping * np.diag(np.diag(inner))
        step[free] = -np.linalg.solve(inner, gradient[free])
        return step

    def _check_margin(self, scaled: FloatArray) -> None:
        """Raise `DivergedError` if the engine diverges with numbers that are a tenth larger, and say a shorter step."""
        larger, count = scaled.copy(), len(self.names) * self.joints
        larger[:count] *= 1.1
        if not self.diverges(larger):
            return
        step_s = self.machine.timestep_s
        advice = (
            f"also with a step of {step_s / 64:.6g} s: choose another engine or preset"
        )
        for shorter_s in step_s / 2.0 ** np.arange(1, 7):
            other = replace(self, machine=self.machine.with_step(float(shorter_s)))
            if not other.diverges(larger):
                advice = (
                    f"give --set timestep_s={shorter_s:.6g} or less; it is {step_s:.6g}"
                )
                break
        raise DivergedError(
            f"{self.machine.name} diverges close to the best settings: {advice}"
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
        covariance = np.asarray(inverse @ middle @ inverse)
        # The pseudoinverse gives 0 to an unknown that changes nothing.
        nothing = np.flatnonzero(np.abs(jacobian).max(axis=0) < SENSELESS)
        covariance[nothing, nothing] = UNBOUNDED**2
        return covariance

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


def _factor(table: FloatArray) -> FloatArray:
    """Return the triangular factor of a table; that of its Gram matrix is faster, but squares small numbers away."""
    try:
        return np.asarray(np.linalg.cholesky(table.T @ table))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.qr(table, mode="r"))


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
        # The factor ends with the length of the residual that the other columns leave.
        diagonal = np.abs(np.diag(_factor(table)))
        power = max(float(diagonal[-1] ** 2), 1e-300)
        freedom = len(table) - len(diagonal) + 1
        shock = power / freedom
        return (
            decay,
            forgotten,
            shock,
            freedom * np.log(shock) + 2.0 * np.log(diagonal[:-1]).sum(),
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
    scene: Scene | MjSpec,
    logs: Sequence[Log],
    names: Sequence[str] | None = None,
    *,
    known: Mapping[str, float] | None = None,
    held_out: Sequence[Log] = (),
    load_error: float = 0.0,
    part_s: float | None = None,
    settings: Mapping[str, Any] | None = None,
    stack: str | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Identified:
    """Return the settings of joints with which an engine follows logs best.

    Args:
        engine: The engine.
        scene: A scene in which each hinge is at angle 0; its hinges are the joints of the logs, in its order. Or an
            MJCF model, whose joints have the names of the logs'; joints that no log names keep their pose.
        logs: Logs to fit.
        names: Numbers to identify, fields of `JointDynamics` and `Servo`, and laws of `servo_laws.TERMS` to compare;
            None compares the laws of friction of a swing.
        known: Numbers of all joints that are not identified, as from a bench.
        held_out: Logs that are only predicted, with the identified numbers.
        load_error: Standard uncertainty of the loads, over their masses and inertias. Torques are known in proportion
            to them, so that each interval of one is wider by as much.
        part_s: Longest part of a log in stage 2 [s]; None is 20 s for servos and the whole log for others.
        settings: Numerical settings of the engine.
        stack: Training stack of the lines to paste, a table of snippets.toml; None is the engine.
        progress: Called with what is being done.

    Raises:
        ParameterError: The logs do not fit the scene or each other, or a name is unknown.
        UnsupportedSceneError: The engine does not build such a joint.
        DivergedError: The engine diverges with the best settings, or close to them.
    """
    servo = logs[0].command_rad is not None
    known = known or {}
    laws_names = {
        law: [*(one for one in terms if one not in known), *known]
        for law, terms in _asked_laws(engine, servo, names).items()
    }
    # The richest law starts the others; that of a servo ends in minima from a first guess.
    first = list(laws_names.values())[0 if servo else -1] if laws_names else names
    names = [*(one for one in first or SERVO_NAMES if one not in known), *known]
    everything = {one for terms in laws_names.values() for one in terms}
    _check_request(scene, [*logs, *held_out], [*names, *everything])
    machine = _machine(engine, scene, logs[0], names, settings or {})
    fitted = partial(_fitted, machine, part_s=part_s, known=known)
    laws: tuple[Law, ...] = ()
    # Where laws are compared, the first fit only starts the others.
    close = NEAR if laws_names else None
    fit = fitted(logs, names, close=close, progress=progress)
    alone: list[_Fit] = []
    if laws_names:
        laws, alone = _compared(fitted, logs, laws_names, fit, progress)
        # Halves of one log are no files.
        alone = alone if len(logs) > 1 else []
        fit = fitted(logs, laws_names[laws[0].name], first=fit, progress=progress)
    elif len(logs) > 1:
        progress("each log alone")
        alone = [fitted([log], names, first=fit) for log in logs]
    long, unknowns = fit.problem, fit.unknowns
    count = long.joints
    fitted_settings = _settings(long, unknowns, fit.covariance)
    found = _with_load_error(
        _between_files(fitted_settings, alone, load_error), load_error
    )
    joint_words = joint_names(logs[0], count)
    if isinstance(machine, ModelJoints):
        joint_words = machine.joints
    left_out: list[dict[str, str]] = [{} for _ in range(count)]
    if servo:
        left_out, unknowns = _without_open(long, found, unknowns, progress)
    values = [
        {name: value + 0.0 for name, value in {**stated, **given}.items()}
        for stated, given in zip(
            machine.stated, long.unknowns(unknowns)[0], strict=True
        )
    ]
    marked = [
        {one.name: one.unknown for one in found if one.joint == joint and one.unknown}
        for joint in range(count)
    ]
    printed = partial(
        snippet_lines,
        names=joint_words,
        joints=values,
        left_out=left_out,
        marked=marked,
        timestep_s=machine.timestep_s,
    )
    lines = printed(engine.name)
    is_replayed = isinstance(machine, ModelJoints) and servo
    if isinstance(machine, ModelJoints) and is_replayed:
        error_rad = machine.replayed(lines, values, logs)
        held_out_rad = machine.replayed(lines, values, held_out)
    else:
        error_rad = _errors(long, unknowns)
        predicted = replace(fit, unknowns=unknowns).predicted
        held_out_rad = {
            log.name: np.sqrt((predicted(log) ** 2).mean(axis=0)) for log in held_out
        }
    return Identified(
        engine=engine.name,
        settings=tuple(
            replace(
                one,
                joint_name=joint_words[one.joint],
                pasted=None
                if one.name in left_out[one.joint]
                else values[one.joint][one.name],
            )
            for one in found
        ),
        joints=values,
        names=joint_words,
        lines=lines,
        stack_lines=printed(stack) if stack else "",
        error_rad=error_rad,
        held_out_rad=held_out_rad,
        motion_rad={
            log.name: log.position_rad.std(axis=0) for log in (*logs, *held_out)
        },
        plain_rad=baselines(logs, held_out),
        noise_rad=_noise_rad(long, unknowns),
        patterns=_patterns(long, unknowns),
        trades=_trades(long, fit.covariance, joint_words),
        laws=laws,
        files=len(logs),
        is_replayed=is_replayed,
        simulations=fit.simulations,
    )


def _asked_laws(
    engine: Backend, servo: bool, names: Sequence[str] | None
) -> dict[str, tuple[str, ...]]:
    """Return the names of each law of friction that is to be compared, or none where names alone are to be fitted.

    Raises:
        UnsupportedSceneError: The engine does not set friction anew in each step.
    """
    if names is None and not servo:
        return {
            law: terms
            for law, terms in LAWS.items()
            if QUADRATIC not in terms or Feature.QUADRATIC_FRICTION in engine.features
        }
    asked = [one for one in names or () if one in TERMS]
    changing = [one for one in names or () if one in (*SERVO_FRICTION, *TERMS)]
    if changing and engine.name != "mujoco":
        raise UnsupportedSceneError(
            f"backend {engine.name!r}: {', '.join(changing)}: friction by rate and load is set anew before each step, "
            "which is done in plain MuJoCo alone"
        )
    rest = [one for one in names or () if one not in TERMS]
    base = SERVO_NAMES if servo else DYNAMICS[:3]
    return {law: tuple(dict.fromkeys([*base, *TERMS[law], *rest])) for law in asked}


@dataclass(frozen=True)
class _Fit:
    """Least squares of logs: the problem of stage 2, its unknowns and their covariance."""

    problem: _Problem
    unknowns: FloatArray
    covariance: FloatArray
    simulations: int = 0

    def predicted(self, log: Log) -> FloatArray:
        """Return simulated less measured angles of a log from its recorded start [rad], shape [N, J]."""
        terms, zero, _ = self.problem.unknowns(self.unknowns)
        angles, rates = log.start()
        try:
            simulated = self.problem.machine.angles(log, terms, (angles - zero, rates))
        except DivergedError:
            return np.full(log.position_rad.shape, LOST_RAD)
        return zero + simulated - log.position_rad


def _fitted(
    machine: Machine,
    logs: Sequence[Log],
    names: Sequence[str],
    *,
    part_s: float | None,
    known: Mapping[str, float],
    first: _Fit | None = None,
    close: float | None = None,
    steps: int | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> _Fit:
    """Fit numbers to logs, in two stages, or in the second alone from another fit; known numbers stay."""
    servo = logs[0].command_rad is not None
    terms = guessed(machine, names, known)
    sizes = np.array([[one[name] for one in terms] for name in names])
    fixed = np.full(sizes.shape, np.nan)
    for name, value in known.items():
        fixed[names.index(name)] = value
    problem = partial(
        _Problem,
        machine,
        names=tuple(names),
        sizes=sizes,
        zero=len(terms) == 1 and not servo,
        fixed=fixed,
    )
    first_s, long_s = SERVO_PARTS_S if servo else FREE_PARTS_S
    short, long = _stages(problem, logs, first_s, part_s or long_s)
    if first is None:
        progress(f"{len(short.parts)} short parts of {len(logs)} logs")
        unknowns = short.neighbourhood()
    else:
        before = first.problem
        rows = dict(zip(before.names, _rows_of(first), strict=False))
        rows |= {name: rows[one] for name, one in IN_ONE.items() if one in rows}
        guess = [rows.get(name, np.ones(long.joints)) for name in names]
        if long.zero:
            guess.append(_rows_of(first)[-1])
        unknowns = np.concatenate(guess)
        terms_of_law = {*SERVO_FRICTION} - {*STRIBECK[1:]}
        new = [name in terms_of_law and name not in rows for name in names]
        if any(new):
            unknowns = long.shared_out(unknowns, np.array(new))
    progress(f"{len(long.parts)} long parts")
    if long.free_starts:
        starts = np.zeros(2 * len(long.parts) * len(terms))
        unknowns = np.concatenate([unknowns, starts])
    close = close or (SERVO_CLOSE if servo else CLOSE)
    unknowns, covariance = long.solved(unknowns, close, steps)
    return _Fit(long, unknowns, covariance, short.simulations + long.simulations)


def _rows_of(fit: _Fit) -> FloatArray:
    """Return the unknowns of joints, shape [kind_count, J]."""
    problem = fit.problem
    return fit.unknowns[: problem.kinds * problem.joints].reshape(
        problem.kinds, problem.joints
    )


def _compared(
    fitted: Callable[..., _Fit],
    logs: Sequence[Log],
    laws: Mapping[str, Sequence[str]],
    fit: _Fit,
    progress: Callable[[str], None],
) -> tuple[tuple[Law, ...], list[_Fit]]:
    """Fit each law to each log alone, and predict the others from their recorded starts.

    Of one log, the halves stand for logs. A law of servo benches starts from the best fit of a law that it contains.

    Returns:
        The laws, the chosen one first, and its fits. It has the fewest terms of those that fit as well as the law that
        predicts best, and predict worse by at most 5 % or a standard error of the mean logarithm of their ratio (after
        Breiman et al., Classification and Regression Trees, 1984).
    """
    parts = list(logs)
    if len(parts) == 1:
        parts = list(logs[0].pieces(0.5 * logs[0].duration_s + 1e-9))
    compared: dict[str, tuple[Law, list[_Fit], FloatArray]] = {}
    for name, names in laws.items():
        progress(f"law {name}")
        simpler = [
            fits
            for other, (_, fits, _) in compared.items()
            if _contains(names, laws[other])
        ]
        alone = [
            fitted(
                [log],
                names,
                first=min((fits[row] for fits in simpler), key=_misfit, default=fit),
                steps=LAW_STEPS,
            )
            for row, log in enumerate(parts)
        ]
        left = [one.problem.residuals(one.unknowns) for one in alone]
        missed = np.array(
            [
                np.sqrt((one.predicted(log) ** 2).mean())
                for fitted_to, one in zip(parts, alone, strict=True)
                for log in parts
                if log is not fitted_to
            ]
        )
        law = Law(
            name=name,
            fitted_rad=float(np.sqrt(np.mean([(one**2).mean() for one in left]))),
            held_out_rad=float(np.sqrt((missed**2).mean())),
        )
        compared[name] = law, alone, missed

    best = min(compared, key=lambda law: compared[law][0].held_out_rad)

    def is_as_good(name: str) -> bool:
        law, _, missed = compared[name]
        ratio = np.log(missed / compared[best][2])
        standard_error = ratio.std(ddof=1) / np.sqrt(ratio.size)
        predicts = ratio.mean() <= max(standard_error, np.log(AS_GOOD))
        return bool(
            predicts and law.fitted_rad <= AS_GOOD * compared[best][0].fitted_rad
        )

    for name, (law, alone, missed) in compared.items():
        alike = name == best or is_as_good(name)
        compared[name] = replace(law, is_as_good=alike), alone, missed
    chosen = min(
        (name for name, (law, *_) in compared.items() if law.is_as_good),
        key=lambda name: (len(laws[name]), compared[name][0].held_out_rad),
    )
    others = sorted(
        (law for name, (law, *_) in compared.items() if name != chosen),
        key=lambda law: law.held_out_rad,
    )
    return (compared[chosen][0], *others), compared[chosen][1]


def _contains(names: Sequence[str], simpler: Sequence[str]) -> bool:
    """Return whether a law of servo benches has all numbers of a simpler one, or those that are one there."""
    known = {*names} | {IN_ONE[name] for name in names if name in IN_ONE}
    return bool(known & {*SERVO_FRICTION}) and {*simpler} < known


def _misfit(fit: _Fit) -> float:
    """Return the sum of the squared errors [rad^2]."""
    return float(fit.problem.squares(fit.unknowns).sum())


def _with_load_error(
    settings: Sequence[Setting], load_error: float
) -> tuple[Setting, ...]:
    """Return settings whose interval of least squares holds the uncertainty of the load too."""
    found = []
    for one in settings:
        if one.is_known or one.name in (SERVO[2], OFFSET):
            found.append(one)
            continue
        half = np.hypot(one.high - one.value, NORMAL_95 * load_error * one.value)
        found.append(
            replace(one, low=max(one.value - half, 0.0), high=one.value + half)
        )
    return tuple(found)


def _between_files(
    settings: Sequence[Setting], alone: Sequence[_Fit], load_error: float
) -> tuple[Setting, ...]:
    """Return settings with the spread of the fits to single logs; those whose next value may be 0 are undetermined."""
    if not alone:
        return tuple(settings)
    files = [_settings(one.problem, one.unknowns, one.covariance) for one in alone]
    found = []
    for row, one in enumerate(settings):
        values = np.array([file[row].value for file in files])
        stds = np.array([file[row].std for file in files])
        if one.is_known or not np.isfinite(stds).all():
            found.append(one)
            continue
        is_torque = one.name not in (SERVO[2], OFFSET)
        least = -np.inf if one.name == OFFSET else 0.0
        spread = spread_of(values, stds, load_error if is_torque else 0.0, least)
        unknown = one.unknown
        is_open = spread.low <= 0.0 <= spread.high and len(alone) > FEWEST_FILES
        if not unknown and is_open and one.name != SERVO[2]:
            unknown = ZERO_NEXT
        found.append(
            replace(
                one,
                of_files=tuple(values.tolist()),
                of_files_std=tuple(stds.tolist()),
                next_low=spread.low,
                next_high=spread.high,
                between=spread.between,
                unknown=unknown,
            )
        )
    return tuple(found)


def _noise_rad(problem: _Problem, unknowns: FloatArray) -> FloatArray:
    """Return the sensor's noise of each joint, the median of the parts [rad], shape [J]."""
    errors = problem.errors(unknowns)
    return np.median(
        [[sensor_noise_rad(column) for column in one.T] for one in errors], axis=0
    )


def _patterns(problem: _Problem, unknowns: FloatArray) -> dict[str, tuple[str, ...]]:
    """Return what the residual of each log looks like, by joint; of several parts the first."""
    found: dict[str, tuple[str, ...]] = {}
    for errors, part in zip(problem.errors(unknowns), problem.parts, strict=True):
        looks = tuple(
            pattern(part.times_s, angles, column)
            for angles, column in zip(
                (part.position_rad + errors).T, errors.T, strict=True
            )
        )
        found.setdefault(part.name.split(", part ")[0], looks)
    return found


def _correlations(problem: _Problem, covariance: FloatArray, joint: int) -> FloatArray:
    """Return the correlations of the numbers of a joint, shape [name_count, name_count]."""
    columns = np.arange(len(problem.names)) * problem.joints + joint
    block = covariance[np.ix_(columns, columns)]
    sizes = np.sqrt(np.diag(block))
    return np.asarray(block / np.maximum(np.outer(sizes, sizes), 1e-300))


def _trades(
    problem: _Problem, covariance: FloatArray, joints: Sequence[str]
) -> tuple[str, ...]:
    """Return which numbers of a joint the logs hardly tell apart: a sentence for each pair."""
    found = []
    for joint, word in enumerate(joints):
        alike = _correlations(problem, covariance, joint)
        for first, second in zip(*np.triu_indices(len(alike), 1), strict=True):
            if abs(alike[first, second]) > TRADE:
                pair = f"{problem.names[first]} and {problem.names[second]}"
                found.append(
                    f"{word}: {pair} trade, correlation {alike[first, second]:.2f}"
                )
    return tuple(found)


def _check_request(
    scene: Scene | MjSpec, logs: Sequence[Log], names: Sequence[str]
) -> None:
    """Raise `ParameterError` unless all logs are of the joints of the scene, and all names of their numbers."""
    servo = logs[0].command_rad is not None
    for log in logs:
        if isinstance(scene, Scene):
            check_joints(scene, log)
        if log.joints != logs[0].joints:
            raise ParameterError(
                f"{log.name} has the joints {', '.join(log.joints) or 'without names'}, and {logs[0].name} "
                f"{', '.join(logs[0].joints) or 'without names'}: all logs need the same, in the same order"
            )
        if (log.command_rad is not None) != servo:
            raise ParameterError(
                f"{log.name}: all logs must state commands of servos, or none"
            )
    for name in names:
        known = [*DYNAMICS, *SERVO, LIMIT, OFFSET] if servo else [*DYNAMICS, "delay_s"]
        if name not in (*known, *SERVO_FRICTION):
            raise ParameterError(
                f"{name}: no number of such a joint; known: {', '.join(known)}, and the laws {', '.join(TERMS)}"
            )


def _stages(
    problem: Callable[..., _Problem],
    logs: Sequence[Log],
    first_s: float,
    long_s: float,
) -> tuple[_Problem, _Problem]:
    """Return the problems of both stages: short parts of logs, and long ones."""
    servo = logs[0].command_rad is not None
    for log in logs:
        apart_s = float(np.median(np.diff(log.times_s)))
        if 10.0 * apart_s > first_s:
            reason = f"samples are {apart_s:.3g} s apart, and at least 10 in {first_s:g} s are needed"
            raise ParameterError(f"{log.name}: {reason}; time_s is in seconds")
    short, long = (
        [part for log in logs for part in log.pieces(most_s) if len(part.times_s) >= 10]
        for most_s in (first_s, long_s)
    )
    short = short[:: max(1, round(len(short) * first_s / FIRST_STAGE_S))]
    return (
        problem(short, [part.start() for part in short], free_starts=False),
        problem(long, [part.start() for part in long], free_starts=not servo),
    )


def _without_open(
    problem: _Problem,
    found: Sequence[Setting],
    unknowns: FloatArray,
    progress: Callable[[str], None],
) -> tuple[list[dict[str, str]], FloatArray]:
    """Set what is not determined to what the scene states, and fit the rest, where that follows the logs as well.

    Two numbers that go with each other may both be needed: those stay, and are marked. But an armature that is not
    determined is never fitted, as a policy meets it in contact.

    Returns:
        Names of the numbers of each joint that are as stated, with the reason, and the unknowns.
    """
    left_out: list[dict[str, str]] = [{} for _ in range(problem.joints)]
    tried: set[tuple[int, str]] = set()
    remaining, best = found, problem.squares(unknowns)
    while candidates := _to_leave_out(problem, remaining, tried):
        before = problem.fixed.copy()
        for one in candidates:
            tried.add((one.joint, one.name))
            place = problem.names.index(one.name), one.joint
            problem.fixed[place] = problem.machine.stated[one.joint][one.name]
        progress(f"without {', '.join(sorted({one.name for one in candidates}))}")
        other, covariance = problem.solved(unknowns, SERVO_CLOSE, REFIT_STEPS)
        squares = problem.squares(other)
        worse = [
            one
            for one in candidates
            if one.name != DYNAMICS[2]
            and squares[one.joint] > AS_WELL**2 * best[one.joint]
        ]
        if worse:
            # The others of this round are tried again in the next, with what worse follows the logs as it was.
            problem.fixed[:] = before
            tried -= {(one.joint, one.name) for one in candidates if one not in worse}
            continue
        for one in candidates:
            left_out[one.joint][one.name] = one.unknown
            if one.name == DYNAMICS[2]:
                best[one.joint] = squares[one.joint]
        unknowns, remaining = other, _settings(problem, other, covariance)
    for one in remaining:
        if one.unknown == ZERO and one.name == SERVO[0]:
            left_out[one.joint][one.name] = one.unknown
    return left_out, unknowns


def _machine(
    engine: Backend,
    scene: Scene | MjSpec,
    log: Log,
    names: Sequence[str],
    settings: Mapping[str, Any],
) -> Machine:
    """Return the joints of a scene or a model on an engine."""
    if not isinstance(scene, Scene):
        if engine.name != "mujoco":
            raise ParameterError(
                f"an MJCF model is simulated by mujoco: leave --backend {engine.name} out, or name a USD layer"
            )
        return joints_of_model(scene, log, settings)
    check_joints(scene, log)
    hinges = len(scene.hinges)
    known = SceneJoints(engine, scene, settings)
    built = with_terms(scene, guessed(known, names, {}), log, np.zeros(hinges))
    support = scene_support(engine, built)
    if not support:
        raise UnsupportedSceneError(
            f"backend {engine.name!r}: {'; '.join(support.missing)}"
        )
    if engine.name != "mujoco":
        return known
    given = with_drive_interval(settings, DRIVE_INTERVAL_S)
    simulation = engine.build(built, given or None)
    try:
        spec = simulation.spec  # type: ignore[attr-defined]
        return joints_of_scene(scene, spec, log, known.stated, settings)
    finally:
        simulation.close()


def _to_leave_out(
    problem: _Problem, settings: Sequence[Setting], tried: Collection[tuple[int, str]]
) -> list[Setting]:
    """Return of each joint the number that is determined least, if any is not determined.

    Where only ratios are told, the armature goes first: the inertia of the load then gives the scale. A servo is none
    without kp, which `_without_open` judges last. A law of friction predicts as a whole, and stays so.
    """

    def openness(one: Setting) -> tuple[bool, float]:
        is_armature = one.unknown == SCALE and one.name == DYNAMICS[2]
        return is_armature, (one.high - one.low) / max(abs(one.value), 1e-300)

    found = []
    for joint in sorted({one.joint for one in settings}):
        candidates = [
            one
            for one in settings
            if one.joint == joint
            and one.unknown
            and one.name not in (SERVO[0], *SERVO_FRICTION)
            and (joint, one.name) not in tried
            and (
                one.name == DYNAMICS[2]
                or abs(one.value - problem.machine.stated[joint][one.name])
                < PLAUSIBLE * (one.high - one.value)
            )
        ]
        if candidates:
            found.append(max(candidates, key=openness))
    return found


def guessed(
    machine: Machine, names: Sequence[str], known: Mapping[str, float]
) -> list[dict[str, float]]:
    """Return first guesses and sizes of numbers: what the scene states, or by the size of its loads.

    One size does for all joints of an arm: the search starts from seven stiffnesses, and its steps are relative.
    """
    inertia, load = machine.size()
    inertia += known.get(DYNAMICS[2], 0.0)
    weight = max(load, 40.0 * inertia)
    rate = float(np.sqrt(weight / inertia))
    # Without kv, the joint's viscous friction is all that damps a servo.
    damps = SERVO[0] in names and SERVO[1] not in names
    guesses = {
        "dry_friction_n_m": 0.01 * weight,
        "viscous_friction_n_m_s_per_rad": (1.0 if damps else 0.02) * weight / rate,
        "armature_kg_m2": 0.1 * inertia,
        QUADRATIC: 0.02 * weight / rate**2,
        "kp_n_m_per_rad": 10.0 * weight,
        "kv_n_m_s_per_rad": weight / rate,
        "delay_s": 0.02,
        LIMIT: weight,
        OFFSET: 0.5,
        **dict(zip(STRIBECK, (0.01 * weight, 0.2, 1.0), strict=True)),
        **dict.fromkeys((LOAD, *DIRECTED), 0.05),
        **dict.fromkeys((LOAD_STRIBECK, *DIRECTED_STRIBECK), 0.05),
        **dict.fromkeys(QUADRATIC_LOAD, 0.05 / weight),
    }
    return [
        {name: known[name] or guesses[name] for name in names}
        for known in machine.stated
    ]


def _settings(
    problem: _Problem, unknowns: FloatArray, covariance: FloatArray
) -> tuple[Setting, ...]:
    std = np.sqrt(np.diag(covariance))
    found = []
    for joint in range(problem.joints):
        alike = _correlations(problem, covariance, joint)
        torques = [kind for kind, name in enumerate(problem.names) if name != SERVO[2]]
        is_scale = len(torques) > 2 and bool(
            (alike[np.ix_(torques, torques)] > ALIKE).all()
        )
        for kind, name in enumerate(problem.names):
            column = kind * problem.joints + joint
            value = unknowns[column] - problem.shifts[kind, 0]
            half = NORMAL_95 * std[column]
            twins = [
                other
                for k, other in enumerate(problem.names)
                if k != kind and abs(alike[kind, k]) > ALIKE
            ]
            unknown = (
                f"goes with {' and '.join(twins)}"
                if twins and half > 0.1 * abs(value)
                else ""
            )
            if is_scale and unknown and kind in torques:
                unknown = SCALE
            is_known = not np.isnan(problem.fixed[kind, joint])
            if is_known:
                unknown, half = "", 0.0
                value = problem.fixed[kind, joint] / problem.sizes[kind, joint]
            elif not unknown and half >= abs(value):
                unknown = ZERO
            size = problem.sizes[kind, joint]
            low, high = (value - half) * size, (value + half) * size
            low = low if name == OFFSET else max(low, 0.0)
            found.append(
                Setting(
                    joint=joint,
                    joint_name="",
                    name=name,
                    value=value * size,
                    low=low,
                    high=high,
                    std=std[column] * size,
                    is_known=is_known,
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
