"""Fits of causes: numbers, residuals on pieces of the log that they have seen and have not, and intervals.

`studies/replay` counts right answers on planted faults with the numbers here and in `search`. An error is a mean
squared residual over that of the noise: 1 for a right model. The excess is the error minus that of a perfect model.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import OptimizeResult, least_squares, lsq_linear
from scipy.stats import t as student

from gauge_envs.tools.replay.causes import Cause, ParameterGroup, change_setup
from gauge_envs.tools.replay.log import FloatArray
from gauge_envs.tools.replay.model import IntArray, Replayer, Setup

NO_NUMBERS = np.zeros(0)

PIECE_S = 0.25
"""Length of the predictions that are fitted first [s]."""
PIECE_COUNT = 28
"""Number of these pieces; every other one is held out."""
SCREENING_COUNT = 4
"""Number of the fitted pieces that screen the causes, from small to large errors."""
SCREENING_DOFS = 3
"""Degrees of freedom up to which all of them do."""
VALUE_S = 1.0
VALUE_COUNT = 20
"""Length and number of the pieces that give the values of the fit that is named, or of constants."""
LONG_COUNT = 4
"""Number of the long pieces by which the best fits are judged."""
MAX_LONG_S = 3.0
"""Length of the longest of them."""
ODD_ERROR = 25.0
"""Error of a piece over the median one from which on it is odd."""
MAX_ODD = 0.1
"""Largest fraction of the pieces that are left out as odd."""
MAX_EXCESS_OF_SEVERAL = 2.0
"""Largest excess of several causes that are named."""
MAX_GROWTH = 2.0
"""Largest excess of a fit on longer pieces, over that on short ones; and of a cause that the log cannot tell from the
best one, over that of this one."""
MIN_SEEN = 0.5
"""Smallest error of the model on longer pieces, over that on short ones."""
NEAR_NOISE = 0.5
"""Excess up to which no second cause is fitted, and a fit counts as one that reached the noise."""
NUMBER_COST = 0.01
"""Part of the error that one more number of a fit must remove."""
MAX_POLISHED = 3
"""Number of the best fits that get measured slopes and intervals."""
MIN_HOPE = 0.5
"""Share below which a fit is not judged by longer pieces, and no further base is tried for pairs."""
MAX_PREDICTIONS = 20
"""Largest number of predictions of one least-squares fit."""
MAX_STEPS = 130_000
"""Number of physics steps that the noise of long pieces may cost; that of the pieces that give values may cost twice
as many. Above, the pieces are shorter."""
MIN_GAIN = 0.002
"""Relative decrease of the training error below which least squares ends."""
MIN_STEP = 1e-3
"""Relative step of the numbers below which least squares ends."""
SLOPE_STEP = 0.1
"""Step of finite differences. Contacts make the residuals rough, and smaller steps measure that roughness."""


def _no_numbers() -> FloatArray:
    return NO_NUMBERS


class Interval(NamedTuple):
    """Values of a cause, shape [K], with the ends of their 95 % intervals, NaN where there are none."""

    cause: Cause
    group: ParameterGroup
    fitted: FloatArray
    low: FloatArray
    high: FloatArray


@dataclass(frozen=True, eq=False, kw_only=True)
class Fit:
    """Causes that are fitted together; none for the model as it is.

    Attributes:
        terms: Cause and group of each.
        numbers: All numbers of the fit, shape [p].
        training: Whitened residuals of the pieces that the fit sees, shape [P, T D]; of those that screen before
            `Problem.predict`.
        slopes: Change per number on the pieces that screen, shape [R, T D, p].
        reach: How far the linear model of the residuals is used, shape [p].
        linear_error: Mean squared training error at the optimum of the linear model.
        held_out: Residuals of the other pieces; empty before `Problem.predict`.
        half_width: Half of the 95 % interval of each number, where it was computed.
    """

    terms: tuple[tuple[Cause, ParameterGroup], ...] = ()
    numbers: FloatArray = field(default_factory=_no_numbers)
    training: FloatArray = field(default_factory=_no_numbers)
    slopes: FloatArray = field(default_factory=_no_numbers)
    reach: FloatArray = field(default_factory=_no_numbers)
    linear_error: float = np.inf
    held_out: FloatArray = field(default_factory=_no_numbers)
    half_width: FloatArray | None = None

    @property
    def names(self) -> list[str]:
        """Names of the causes."""
        return [cause.name for cause, _ in self.terms]

    @property
    def label(self) -> str:
        """Names of the causes in one text."""
        return " and ".join(self.names)

    @property
    def error(self) -> float:
        """Mean squared error over that of the noise on held-out pieces; the linear one before `Problem.predict`."""
        if self.held_out.size:
            return float(np.mean(self.held_out**2))
        return self.linear_error

    @property
    def room(self) -> tuple[FloatArray, FloatArray]:
        """Largest change of each number down and up, shape [p].

        A present value may be below the smallest one that is fitted, as no friction.
        """
        smallest = [cause.lower(group) for cause, group in self.terms]
        largest = [np.full(group.size, cause.far) for cause, group in self.terms]
        lower, upper = (
            np.concatenate([NO_NUMBERS, *each]) - self.numbers
            for each in (smallest, largest)
        )
        return np.minimum(lower, 0.0), np.maximum(upper, 1e-9)

    def change(self, setup: Setup) -> Setup:
        """Return a setup with the values of the fit."""
        changes = [(each.cause, each.fitted) for each in self.intervals()]
        return change_setup(setup, changes)

    def shown_setup(self, setup: Setup) -> Setup:
        """Return a setup with the values that are printed: four digits, and the present one inside an interval."""
        changes = []
        for cause, _group, fitted, low, high in self.intervals():
            rounded = np.array([float(f"{value:.4g}") for value in fitted])
            is_equal = (low <= cause.present) & (high >= cause.present)
            changes.append((cause, np.where(is_equal, cause.present, rounded)))
        return change_setup(setup, changes)

    def intervals(self) -> Iterator[Interval]:
        """Yield the values of each cause, with their 95 % intervals."""
        half = np.nan * self.numbers if self.half_width is None else self.half_width
        trials = np.array([self.numbers, self.numbers - half, self.numbers + half])
        begin = 0
        for cause, group in self.terms:
            rows = trials[:, begin : begin + group.size]
            begin += group.size
            fitted, low, high = (cause.values(group, numbers) for numbers in rows)
            yield Interval(cause, group, fitted, low, high)

    def linearize(self) -> Fit:
        """Return the fit at the optimum of its linear model."""
        if not len(self.numbers):
            return replace(self, linear_error=float(np.mean(self.training**2)))
        columns = np.dstack([self.slopes, -self.training])
        # The orthogonal factor changes no residual norm.
        flat = columns.reshape(self.training.size, -1)
        triangle = np.asarray(np.linalg.qr(flat, mode="r"))
        lower, upper = self.room
        bounds = np.maximum(lower, -self.reach), np.minimum(upper, self.reach)
        solution = lsq_linear(triangle[:, :-1], triangle[:, -1], bounds)
        linear_error = 2.0 * solution.cost / self.training.size
        numbers = self.numbers + solution.x
        return replace(self, numbers=numbers, linear_error=linear_error)


class Problem:
    """Whitened residuals of a log: independent, with standard deviation 1, if the model is right.

    Args:
        replayer: Predicts the log.
        setup: What the user gave.
        noisy: What propagates the noise, if it is another setup.
        piece_s, count: Length and number of the pieces.
        floor: Error over noise of a perfect model: 1, or that of the first of two logs.

    Attributes:
        pieces: Samples of all pieces, shape [P, 1 + T].
        whiteners: What makes the deviations of each half independent, shape [P, T D, T D].
        before: The model as it is.
        screening: Which of the fitted pieces screen the causes, shape [R].
    """

    def __init__(
        self,
        replayer: Replayer,
        setup: Setup,
        *,
        noisy: Setup | None = None,
        piece_s: float = PIECE_S,
        count: int = PIECE_COUNT,
        floor: float = 1.0,
    ) -> None:
        self.replayer, self.setup, self.floor = replayer, setup, floor
        self.weight, self.piece_s = 1.0, piece_s
        self.pieces = replayer.pieces(piece_s, count)
        self._halves = [self.pieces[::2], self.pieces[1::2]]
        self._covariances = [
            replayer.covariance(noisy or setup, half) for half in self._halves
        ]
        self.whiteners = [_whitener(each) for each in self._covariances]
        self.before = self.predict(Fit())
        errors = np.mean(self.before.training**2, axis=1)
        fraction = SCREENING_DOFS / len(replayer.dofs)
        few = max(SCREENING_COUNT, round(fraction * len(errors)))
        places = np.linspace(0, len(errors) - 1, min(few, len(errors)))
        self.screening = np.sort(np.argsort(errors)[places.round().astype(int)])
        self._halves.append(self._halves[0][self.screening])
        self.whiteners.append(self.whiteners[0][self.screening])
        no_slopes = np.zeros((*self.whiteners[2].shape[:2], 0))
        self.before = replace(self.before, slopes=no_slopes)

    def lengthened(self, fit: Fit) -> tuple[Problem, Fit]:
        """Return the problem with the longest pieces that a fit predicts, and with its noise; and the fit there.

        A cause may change how the noise propagates: feet that slip keep a velocity, and feet that stick lose it. The
        problem itself is returned if the fit predicts no pieces, or if their noise hides the error of the model.
        """
        if self.share(fit) < MIN_HOPE:
            return self, fit
        noisy, count = fit.change(self.setup), LONG_COUNT
        length_s = min(
            self.replayer.longest_s() / count,
            MAX_LONG_S,
            self.max_total_s() / count,
        )
        # The pieces are few: hardly longer ones say less than the many short ones.
        while length_s > 2.0 * PIECE_S and self.floor == 1.0:
            problem = Problem(
                self.replayer, self.setup, noisy=noisy, piece_s=length_s, count=count
            )
            is_seen = problem.before.error > MIN_SEEN * self.before.error
            problem.weight = self.excess(self.before) / problem.excess(problem.before)
            (long,) = problem.judged([fit], [fit.label])
            # A chaotic motion is missed more and more.
            limit = MAX_GROWTH * max(self.excess(fit), 0.0) + NEAR_NOISE
            if is_seen and problem.excess(long) < limit:
                return problem, long
            length_s *= 0.5
        return self, fit

    def for_values(self, fit: Fit) -> Problem:
        """Return the problem whose pieces give the values of a fit; no longer than those that judge it."""
        count = VALUE_COUNT
        length_s = min(VALUE_S, 2.0 * self.max_total_s() / count)
        return Problem(
            self.replayer,
            self.setup,
            noisy=fit.change(self.setup),
            piece_s=min(self.piece_s, max(length_s, PIECE_S)),
            count=count,
            floor=self.floor,
        )

    def weighted_by(self, fit: Fit) -> Problem:
        """Return the problem whose residuals count less where a fit misses more than the noise.

        What it misses is the covariance over time of each degree of freedom, over all pieces, less that of the noise.
        """
        setup = fit.change(self.setup)
        pieces = np.concatenate(self._halves[:2])
        missed = self.replayer.predict(setup, pieces)
        _, times, dofs = missed.shape
        noise = np.mean(np.concatenate(self._covariances), axis=0)
        noise = noise.reshape(times, dofs, times, dofs)
        total = np.zeros_like(noise)
        for dof in range(dofs):
            both = missed[..., dof].T @ missed[..., dof] / len(missed)
            sizes, axes = np.linalg.eigh(both - noise[:, dof, :, dof])
            total[:, dof, :, dof] = axes * np.maximum(sizes, 0.0) @ axes.T
        problem = copy.copy(self)
        problem.whiteners = [
            _whitener(each + total.reshape(each.shape[1:]))
            for each in self._covariances
        ]
        return problem

    def max_total_s(self) -> float:
        """Return the length of all pieces together whose noise costs `max_steps`."""
        steps = MAX_STEPS / self.replayer.noise_predictions
        return steps * self.setup.step_s

    def judged(self, fits: Sequence[Fit], names: Sequence[str]) -> list[Fit]:
        """Return fits of other pieces with the residuals of these, the best first.

        A few rivals that may be as good as the first one are fitted again where they miss the noise. Of those that
        reach it, the one with the fewest numbers is the best.
        """
        found = []
        for index, fit in enumerate(fits):
            judged = self.predict(fit)
            is_rival = fit.label in names
            is_far = judged.error > self.floor * (1.0 + NEAR_NOISE)
            is_few = index < MAX_POLISHED
            if is_rival and is_few and is_far and len(fit.numbers):
                again = self.minimize(judged, measure=True)
                judged = min(judged, again, key=self.cost)
            found.append(judged)

        def rank(fit: Fit) -> tuple[float, int, float]:
            excess = max(self.excess(fit), NEAR_NOISE)
            return excess, len(fit.numbers), self.cost(fit)

        return sorted(found, key=rank)

    def still_equal(self, fits: Sequence[Fit], names: Sequence[str]) -> list[str]:
        """Return the names whose fits on these pieces are as good as the first one."""
        limit = MAX_GROWTH * max(self.excess(fits[0]), 0.0) + MAX_EXCESS_OF_SEVERAL
        found = {fit.label: fit for fit in fits[1:]}
        return [
            name for name in names if name in found and self.excess(found[name]) < limit
        ]

    def odd_pieces(self, fit: Fit) -> IntArray:
        """Return the few pieces that a fit misses by far more than the others, shape [K, 1 + T]."""
        pieces = np.concatenate(self._halves[:2])
        errors = np.concatenate(
            [np.mean(each**2, axis=1) for each in (fit.training, fit.held_out)]
        )
        is_odd = errors > ODD_ERROR * max(np.median(errors), self.floor)
        return pieces[is_odd & (is_odd.mean() < MAX_ODD)]

    def residuals(self, fit: Fit, half: int) -> FloatArray:
        """Return the whitened residuals of a half, shape [P, T D]: training, held out or screening (2)."""
        setup = fit.change(self.setup)
        deviation = self.replayer.predict(setup, self._halves[half])
        columns = deviation.reshape(len(deviation), -1, 1)
        return (self.whiteners[half] @ columns)[..., 0]

    def predict(self, fit: Fit) -> Fit:
        """Return a fit with all its residuals."""
        training, held_out = (self.residuals(fit, half) for half in (0, 1))
        return replace(fit, training=training, held_out=held_out)

    def minimize(self, fit: Fit, *, measure: bool) -> Fit:
        """Return a fit at the least squares of the pieces that screen, with all its residuals.

        Args:
            fit: Where it begins.
            measure: Whether the slopes are measured by finite differences at each step; else those of the fit are used.
        """
        count = len(fit.numbers)
        slopes = None if measure else fit.slopes.reshape(-1, count)
        found = least_residuals(fit, [(self, 2)], slopes)
        slopes = found.jac.reshape(*self.whiteners[2].shape[:2], count)
        reach = np.full(count, np.inf)
        return self.predict(replace(fit, numbers=found.x, slopes=slopes, reach=reach))

    def excess(self, fit: Fit) -> float:
        """Return the error beyond that of a perfect model, over it.

        Long pieces have the excess that short ones have with the same share.
        """
        return self.weight * (fit.error / self.floor - 1.0)

    def share(self, fit: Fit) -> float:
        """Return the share of the excess that a fit explains."""
        return 1.0 - self.excess(fit) / max(self.excess(self.before), 1e-9)

    def cost(self, fit: Fit) -> float:
        """Return the error of a fit, and what its numbers must bring."""
        return fit.error * (1.0 + NUMBER_COST * len(fit.numbers))


def _whitener(covariance: FloatArray) -> FloatArray:
    """Return what makes deviations independent, with variances of 1, for each covariance."""
    return np.linalg.inv(np.linalg.cholesky(covariance))


def least_residuals(
    fit: Fit,
    halves: Sequence[tuple[Problem, int]],
    slopes: FloatArray | None = None,
) -> OptimizeResult:
    """Return the least squares of the residuals of halves of problems, from the numbers of a fit on.

    The slopes are measured by finite differences at each step, or given, shape [R, p].
    """
    latest = NO_NUMBERS, NO_NUMBERS

    def residuals(change: FloatArray) -> FloatArray:
        moved = replace(fit, numbers=fit.numbers + change)
        rows = [problem.residuals(moved, half) for problem, half in halves]
        return np.concatenate([row.ravel() for row in rows])

    def remembered(change: FloatArray) -> FloatArray:
        nonlocal latest
        if not np.array_equal(change, latest[0]):
            latest = change.copy(), residuals(change)
        return latest[1]

    def measured(change: FloatArray) -> FloatArray:
        steps = SLOPE_STEP * np.eye(len(change))
        moved = [residuals(change + step) - remembered(change) for step in steps]
        return np.transpose(moved) / SLOPE_STEP

    # The first step of least squares is as large as what it begins with, or 1 for zeros: a change, and no number.
    start = np.zeros(len(fit.numbers))
    found = least_squares(
        remembered,
        start,
        measured if slopes is None else lambda _: slopes,
        bounds=fit.room,
        method="dogbox",
        ftol=MIN_GAIN,
        xtol=MIN_STEP,
        max_nfev=MAX_PREDICTIONS,
    )
    found.x += fit.numbers
    return found


def all_halves(problems: Iterable[Problem]) -> list[tuple[Problem, int]]:
    """Return the fitted and the held-out half of each problem."""
    return [(problem, half) for problem in problems for half in (0, 1)]


def fit_values(fit: Fit, problems: Sequence[Problem]) -> Fit:
    """Return a fit with the numbers that all pieces of problems give together, and their 95 % intervals.

    What the given fit misses weights the residuals: `Problem.weighted_by`. The sandwich A^-1 B A^-1 sums the gradients
    by pieces, so that correlated residuals and the spread over the pieces both widen an interval. The residuals of the
    fit remain those of the training and the held-out pieces.
    """
    if not len(fit.numbers):
        return fit
    halves = all_halves([problem.weighted_by(fit) for problem in problems])
    found = least_residuals(fit, halves)
    # Numbers of pieces, and of residuals of each.
    shapes = [problem.whiteners[half].shape[:2] for problem, half in halves]
    sizes = np.concatenate([np.full(*shape) for shape in shapes])
    begin = np.cumsum(sizes) - sizes
    gradients = np.add.reduceat(found.jac * found.fun[:, None], begin)
    inverse = np.linalg.pinv(found.jac.T @ found.jac)
    pieces, count = gradients.shape
    freedom = max(pieces - count, 1)
    spread = inverse @ gradients.T @ gradients @ inverse * pieces / freedom
    # The noise, and what is left as if it were noise, give the narrowest interval.
    variance = np.maximum(np.diag(spread), np.abs(np.diag(inverse)))
    half_width = student.ppf(0.975, freedom) * np.sqrt(variance)
    return replace(fit, numbers=found.x, half_width=half_width)
