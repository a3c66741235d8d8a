"""Least squares of the numbers of joints: residuals of simulated parts of logs, their slopes, steps and covariance.

In Student's quantile N samples count as N / (1 + 2 sum of the correlation); see `noise`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import matmul_toeplitz
from scipy.optimize import OptimizeResult, least_squares
from scipy.stats import t as student

from gauge_envs.runs.rollout import DivergedError
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.identify.logs import Log
from gauge_envs.tools.identify.noise import lasting_noise
from gauge_envs.tools.identify.rig import DYNAMICS, OFFSET, SERVO, Machine, Terms

NEAR, CLOSE, SERVO_CLOSE, SHORT_STEPS = 1e-2, 1e-4, 1e-3, 8
"""Relative change at which a stage ends: the first, the second, that of servos; most steps of the first."""

STARTS, DEADBAND_RAD = 3, 0.01
"""Number of stiffnesses from which a servo's fit starts; angle within which dry friction holds it in one more start."""

FIRST_DAMPING, EASE, TRIES, MOST_STEPS = 1e-2, 5.0, 4, 40
"""Damping of the first step of a joint, its factor after a step, trials of a step, and most steps."""

LOST_RAD = 10.0
"""Error of a simulation that diverges [rad], so that the search turns back."""

FEWEST = 10.0
"""Samples that at least count in the quantile: noise that lasts longer is known from its shocks."""

STEP, DELAY_STEP = 1e-3, 0.1
"""Step of the differences, over the size of a parameter; engines follow commands in intervals of 5.6 ms."""

SENSELESS, UNBOUNDED = 1e-9, 1e3
"""Change of all angles [rad] per scaled unknown below which logs do not depend on it; its uncertainty then."""

SHARES = ((1.0, 0.01), (1.0, 1.0), (0.3, 1.0), (0.3, 3.0), (0.1, 3.0))
"""Factors of dry friction, and of new terms of friction, from which the fit of a law starts; first nearly none."""

Start = tuple[FloatArray, FloatArray]


@dataclass
class Problem:
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
        """Number of joints."""
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
            x_scale="jac",
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
        # The pseudoinverse gives 0 to an unknown that changes nothing; rounding may leave less than 0.
        is_senseless = np.abs(jacobian).max(axis=0) < SENSELESS
        nothing = np.flatnonzero(is_senseless | (np.diag(covariance) < 0.0))
        covariance[nothing, nothing] = UNBOUNDED**2
        return covariance

    def _noise_of(
        self,
        parts: Sequence[NDArray[np.intp]],
        jacobian: FloatArray,
        residuals: FloatArray,
    ) -> tuple[float, float, float]:
        """Return the noise of one joint, from the rows of its residuals in each part; see `lasting_noise`."""
        inside = np.concatenate(parts)
        left, singular_values, _ = np.linalg.svd(jacobian[inside], full_matrices=False)
        explained = left[:, singular_values > 1e-12 * singular_values[0]]
        table = np.column_stack([explained, residuals[inside]])
        ends = np.cumsum([len(part) for part in parts])
        return lasting_noise(np.split(table, ends[:-1]))
