"""Least squares of the numbers of joints: residuals of simulated parts of logs, their slopes, steps and covariance.

In Student's quantile N samples count as N / (1 + 2 sum of the correlation); see `noise`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.linalg import matmul_toeplitz
from scipy.special import stdtrit

from gauge_envs.runs.rollout import DivergedError
from gauge_envs.scene.geometry import BoolArray, FloatArray, IntArray
from gauge_envs.tools.identify.logs import Log
from gauge_envs.tools.identify.noise import lasting_noise
from gauge_envs.tools.identify.rig import DYNAMICS, LIMIT, OFFSET, SERVO, Machine, Terms

NEAR, CLOSE, SERVO_CLOSE, SHORT_STEPS = 1e-2, 1e-4, 1e-3, 8
"""Relative change at which a stage ends: the first, the second, that of servos; most steps of the first."""

STARTS, ARM_STARTS, DEADBAND_RAD = 5, 3, 0.01
"""Number of stiffnesses from which the fit of a servo starts, and of the servos of an arm, whose fit takes minutes;
angle within which dry friction holds it in one more start.
"""

FIRST_DAMPING, LEAST_DAMPING, EASE, MOST_STEPS = 1e-2, 1e-9, 5.0, 40
"""Damping of the first step of a joint, the least, its factor after a step, and most steps."""

TRIES, SERVO_TRIES = 4, 10
"""Trials of a step, each with more damping: small steps of swings end where errors jump."""

LEAST_LIMIT, MOST_GROWTH = 0.5, 4.0
"""Least torque limit of a servo after a step, and most of any number, over that before it."""

LOST_RAD = 10.0
"""Error of a simulation that diverges [rad], so that the search turns back."""

FEWEST = 10.0
"""Samples that at least count in the quantile: noise that lasts longer is known from its shocks."""

STEPS, DELAY_STEP = (1e-2, 1e-3), 0.1
"""Steps of the differences, over the size of a parameter; engines follow commands in intervals of 5.6 ms.

Where dry friction stops a swing half a period later, errors jump: fits of small steps alone end there.
"""

SENSELESS, UNBOUNDED = 1e-9, 1e3
"""Change of all angles [rad] per scaled unknown below which logs do not depend on it; its uncertainty then."""

SHARES = ((1.0, 0.01), (1.0, 1.0), (0.3, 1.0), (0.3, 3.0), (0.1, 3.0))
"""Factors of dry friction, and of new terms of friction, from which the fit of a law starts; first nearly none."""

ROUNDING = 1e-6
"""Singular value of scaled differences, over the largest, below which it is rounding."""

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

    def has_parts_of(self, other: Self) -> bool:
        """Return whether another problem has the same parts of the same logs."""
        here, there = (
            [(part.name, part.times_s[0], part.times_s[-1]) for part in one.parts]
            for one in (self, other)
        )
        return here == there

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
        given = np.append(scaled, self.fixed)
        if np.array_equal(self._last[0], given, equal_nan=True):
            return self._last[1]
        errors = self.errors(scaled, may_diverge=True)
        residuals = np.concatenate([one.T.ravel() for one in errors])
        self._last = given, residuals
        return residuals

    def jacobian(self, scaled: FloatArray, step: float = STEPS[-1]) -> FloatArray:
        """Return forward differences. One number of all joints changes at once: that of one moves the others little."""
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
            is_delay = self.names[kind : kind + 1] == ("delay_s",)
            change = self._changed(
                scaled, columns, before, DELAY_STEP if is_delay else step
            )
            for joint in np.flatnonzero(is_free):
                inside = rows[:, 1] == joint
                jacobian[inside, columns[joint]] = change[inside]
        for kind in range(2 if self.free_starts else 0):
            every = np.arange(first_start, scaled.size)
            places = every.reshape(-1, 2, self.joints)[:, kind]
            change = self._changed(scaled, places.ravel(), before, step)
            for number, joint in np.ndindex(places.shape):
                inside = (rows == (number, joint)).all(axis=1)
                jacobian[inside, places[number, joint]] = change[inside]
        return jacobian

    def _changed(
        self,
        scaled: FloatArray,
        columns: IntArray,
        before: FloatArray,
        step: float,
    ) -> FloatArray:
        moved = scaled.copy()
        moved[columns] += step
        return (self.residuals(moved) - before) / step

    def _rows(self) -> IntArray:
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
        search starts from several stiffnesses, and from the best of these once more with a play by dry friction of
        `DEADBAND_RAD`. As joints of an arm hardly move each other, each has the start that follows it best.
        """
        guesses = self._ranked(self.first_guesses())
        if SERVO[0] not in self.names:
            return self.solved(guesses[0], NEAR)
        starts = STARTS if self.joints == 1 else ARM_STARTS
        tried = [self.solved(one, NEAR, SHORT_STEPS) for one in guesses[:starts]]
        best = self._ranked(tried)[0]
        if DYNAMICS[0] in self.names:
            rubbing = best.reshape(self.kinds, self.joints).copy()
            dry, kp = (self.names.index(name) for name in (DYNAMICS[0], SERVO[0]))
            stiffness = rubbing[kp] * self.sizes[kp]
            rubbing[dry] = DEADBAND_RAD * stiffness / self.sizes[dry]
            other = self.solved(rubbing.ravel(), NEAR, SHORT_STEPS)
            best = self._ranked([best, other])[0]
        return best

    def shared_out(self, first: FloatArray, new: BoolArray) -> FloatArray:
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
        self, first: FloatArray, tolerance: float, step_count: int = MOST_STEPS
    ) -> FloatArray:
        """Return the unknowns of the least squares after Marquardt (SIAM J. Appl. Math. 11, 1963).

        Servos hardly move each other, so that each has a step and a damping of its own; other joints have one together.
        """
        owners = np.arange(self.joints)
        differences = [STEPS[-1]]
        tries = SERVO_TRIES
        if SERVO[0] not in self.names:
            owners[:] = 0
            tries = TRIES
            differences = list(STEPS)
        owner_of_row = owners[self._rows()[:, 1]]
        owner_of_unknown = np.resize(owners, first.size)
        lowest = np.full(first.size, -np.inf)
        lowest[: len(self.names) * self.joints] = 0.0
        scaled = np.maximum(first, lowest + 1e-6)
        damping = np.full(owners.max() + 1, FIRST_DAMPING)
        residuals = self.residuals(scaled)
        is_limit = np.repeat([name == LIMIT for name in self.names], self.joints)
        limits = np.flatnonzero(is_limit)
        for _ in range(step_count):
            # Below a limit that holds a servo still, no other number tells anything: a step stays near.
            lowest[limits] = LEAST_LIMIT * scaled[limits]
            highest = np.where(
                np.isfinite(lowest), MOST_GROWTH * np.maximum(scaled, 1.0), np.inf
            )
            jacobian = self.jacobian(scaled, differences[0])
            before = squares = np.bincount(owner_of_row, residuals**2)
            waiting = np.full(damping.size, True)
            for _ in range(tries):
                moved = scaled.copy()
                for owner in np.flatnonzero(waiting):
                    rows, columns = owner_of_row == owner, owner_of_unknown == owner
                    moved[columns] = _damped_step(
                        scaled[columns],
                        lowest[columns],
                        highest[columns],
                        jacobian[np.ix_(rows, columns)],
                        residuals[rows],
                        float(damping[owner]),
                    )
                found = np.bincount(owner_of_row, self.residuals(moved) ** 2)
                better = waiting & (found < squares)
                scaled = np.where(better[owner_of_unknown], moved, scaled)
                waiting &= ~better
                damping[better] = np.maximum(damping[better] / EASE, LEAST_DAMPING)
                damping[waiting] *= EASE
                if not waiting.any():
                    break
            residuals = self.residuals(scaled)
            squares = np.bincount(owner_of_row, residuals**2)
            is_coarse = len(differences) > 1
            least_change = max(tolerance, SERVO_CLOSE) if is_coarse else tolerance
            if (before - squares <= least_change * before).all():
                if not is_coarse:
                    break
                del differences[0]
        return scaled

    def check_margin(self, scaled: FloatArray) -> None:
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

    def covariance(self, scaled: FloatArray) -> FloatArray:
        """Return the covariance of the unknowns under lasting noise, shape [unknown_count, unknown_count].

        Least squares gives (J'J)^-1 J' C J (J'J)^-1 for residuals of covariance C (Aitken 1935). The noise of a joint
        is stationary in each part of a log, so that C is a Toeplitz matrix there, and 0 between parts.
        """
        jacobian, residuals = self.jacobian(scaled), self.residuals(scaled)
        rows = self._rows()
        if LIMIT in self.names and self.joints > 1:
            # Where no torque reaches a limit, limits of other joints would seem to be its effect.
            first = self.names.index(LIMIT) * self.joints
            for joint in range(self.joints):
                column, inside = first + joint, rows[:, 1] == joint
                alone = self._changed(scaled, np.array([column]), residuals, STEPS[-1])
                jacobian[inside, column] = alone[inside]
        inverse, untold = _inverse(jacobian)
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
            wider = stdtrit(max(count, FEWEST), 0.975) / 1.96
            for part in parts:
                lags = np.arange(len(part) - 1)
                covariance = np.concatenate([[variance], neighbours * decay**lags])
                sensitivity = jacobian[part]
                middle += (
                    sensitivity.T @ matmul_toeplitz(covariance, sensitivity) * wider**2
                )
        covariance = inverse @ middle @ inverse + UNBOUNDED**2 * untold.T @ untold
        # Rounding may leave less than 0.
        nothing = np.flatnonzero(np.diag(covariance) < 0.0)
        covariance[nothing, nothing] = UNBOUNDED**2
        return np.asarray(covariance)

    def _noise_of(
        self,
        parts: Sequence[IntArray],
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


def _inverse(jacobian: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the inverse of J'J where the logs tell something, and unit directions in which they tell nothing.

    A pseudoinverse alone gives these directions no variance, as if the logs determined them.

    Returns:
        The inverse, shape [unknown_count, unknown_count], and the directions, shape [untold_count, unknown_count].
    """
    is_senseless = np.abs(jacobian).max(axis=0) < SENSELESS
    sizes = np.where(is_senseless, 1.0, np.linalg.norm(jacobian, axis=0))
    scaled = np.where(is_senseless, 0.0, jacobian / sizes)
    _, values, directions = np.linalg.svd(scaled, full_matrices=False)
    is_told = values > ROUNDING * values[0]
    told = directions[is_told] / values[is_told, None] / sizes
    untold = directions[~is_told] / sizes
    return told.T @ told, untold / np.linalg.norm(untold, axis=1, keepdims=True)


def _damped_step(
    values: FloatArray,
    lowest: FloatArray,
    highest: FloatArray,
    jacobian: FloatArray,
    residuals: FloatArray,
    damping: float,
) -> FloatArray:
    """Return unknowns after a damped step, none below its lowest: the rest is solved again beside those that reach it.

    Args:
        values: The unknowns, shape [unknown_count].
        lowest: Their lowest values.
        highest: Their highest values, at which a step is cut.
        jacobian: Slopes of the residuals, shape [residual_count, unknown_count].
        residuals: The residuals.
        damping: Share of the squared slopes that is added to them.
    """
    normal = jacobian.T @ jacobian
    gradient = jacobian.T @ residuals
    sizes = np.diag(normal)
    # Numbers without effect stay, also where rounding seems to be one, as of the angle at rest without gravity.
    free = np.abs(jacobian).max(axis=0) > SENSELESS
    step = np.zeros(values.size)
    while free.any():
        damped = normal[np.ix_(free, free)] + damping * np.diag(sizes[free])
        others = normal[np.ix_(free, ~free)] @ step[~free]
        step[free] = -np.linalg.solve(damped, gradient[free] + others)
        below = free & (values + step < lowest)
        if not below.any():
            break
        step[below] = lowest[below] - values[below]
        free &= ~below
    return np.clip(values + step, lowest, highest)
