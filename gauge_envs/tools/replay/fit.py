"""Fits of causes: numbers, residuals on pieces of the log that they have seen and have not, and intervals."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import OptimizeResult, least_squares, lsq_linear

from gauge_envs.scoring.interval import student_t
from gauge_envs.tools.replay.causes import Cause, ParameterGroup, change_setup
from gauge_envs.tools.replay.log import FloatArray
from gauge_envs.tools.replay.model import IntArray, Replayer, Setup

NO_NUMBERS = np.zeros(0)


@dataclass(frozen=True, kw_only=True)
class Thresholds:
    """What decides which causes are fitted, and which are named.

    `studies/replay` counts right answers with these numbers on planted faults. An error is a mean squared residual over
    that of the noise: 1 for a right model. The excess is the error minus that of a perfect model.

    Attributes:
        piece_s: Length of the predictions that are fitted first [s].
        piece_count: Number of these pieces; every other one is held out.
        screening_count: Number of the fitted pieces that screen the causes, from small to large errors.
        screening_dofs: Degrees of freedom up to which all of them do.
        value_s, value_count: Length and number of the pieces that give the values of the fit that is named, or of
            constants.
        long_count: Number of the long pieces by which the best fits are judged.
        max_long_s: Length of the longest of them.
        max_noise_error: Error below which nothing is left to explain.
        max_misfit: Logarithm of the error over that of constant velocity or no motion, below which a model is no worse.
        odd_error: Error of a piece over the median one from which on it is odd.
        max_odd: Largest fraction of the pieces that are left out as odd.
        min_share: Smallest share of the excess that a named cause explains, near the noise.
        min_claim: The same farther from the noise: a cause outside of the list often looks like one of it by 98 %.
        min_part: Smallest share of a cause that is named in part.
        about_as_good: Excess of losses and armature over the smallest one, up to which they are preferred.
        max_excess: Largest excess of a named cause, unless it leads.
        min_lead: Excess of every other cause over that of a cause that leads.
        max_excess_of_several: Largest excess of several causes that are named.
        max_ratio_of_several: Largest excess of several causes that are named, over that of the best single cause.
        enough_share: Share of one cause above which a second one is fitted only above `max_excess_of_several`.
        equal_gap: Difference of errors over the excess of the model, up to which causes are equal in each piece.
        min_share_of_equal: Smallest share of a cause that the log cannot tell from the best one, over that of this one.
        significance: Probability of a signed-rank test below which a cause is worse than the best one.
        max_growth: Largest excess of a fit on longer pieces, over that on short ones; and of a cause that the log
            cannot tell from the best one, over that of this one.
        min_seen: Smallest error of the model on longer pieces, over that on short ones.
        min_lead_of_convention: Difference of misfits [nat] from which on causes explain a log better than another
            convention.
        min_correlation: Correlation of the commands from which on a second log is a repeat of the first.
        max_width: Half of the 95 % interval of a constant, over its value or the typical one, up to which the logs
            determine it: with a standard error above its value, it predicts worse than the present value.
        near_noise: Excess up to which no second cause is fitted, and a fit counts as one that reached the noise.
        number_cost: Part of the error that one more number of a fit must remove.
        max_groups: Number of groups of each cause that are fitted.
        max_refined: Number of fits of one cause, and of two, that are refined.
        max_worse: Largest linear error of a fit that is refined, over that of a fit that reached the noise.
        max_polished: Number of the best fits that get measured slopes and intervals.
        max_bases: Number of fits of one cause to which a second one is added.
        min_hope: Share below which a fit is not judged by longer pieces, and no further base is tried for pairs.
        min_second: Relative decrease of the error that a cause must bring alone to be fitted as a second one.
        max_predictions: Largest number of predictions of one least-squares fit.
        max_steps: Number of physics steps that the noise of long pieces may cost; that of the pieces that give values
            may cost twice as many. Above, the pieces are shorter.
        min_gain: Relative decrease of the training error below which least squares ends.
        min_step: Relative step of the numbers below which least squares ends.
        slope_step: Step of finite differences. Contacts make the residuals rough, and smaller steps measure that
            roughness.
    """

    piece_s: float = 0.25
    piece_count: int = 28
    screening_count: int = 4
    screening_dofs: int = 3
    value_s: float = 1.0
    value_count: int = 20
    long_count: int = 4
    max_long_s: float = 3.0
    max_noise_error: float = 1.3
    max_misfit: float = 0.4
    odd_error: float = 25.0
    max_odd: float = 0.1
    min_share: float = 0.9
    min_claim: float = 0.995
    min_part: float = 0.85
    about_as_good: float = 1.5
    max_excess: float = 8.0
    min_lead: float = 5.0
    max_excess_of_several: float = 2.0
    max_ratio_of_several: float = 0.4
    enough_share: float = 0.99
    equal_gap: float = 1e-3
    min_share_of_equal: float = 0.5
    significance: float = 0.05
    max_growth: float = 2.0
    min_seen: float = 0.5
    min_lead_of_convention: float = 0.5
    min_correlation: float = 0.99
    max_width: float = 2.0
    near_noise: float = 0.5
    number_cost: float = 0.01
    max_groups: int = 3
    max_refined: int = 10
    max_worse: float = 4.0
    max_polished: int = 3
    max_bases: int = 2
    min_hope: float = 0.5
    min_second: float = 0.02
    max_predictions: int = 20
    max_steps: int = 130_000
    min_gain: float = 0.002
    min_step: float = 1e-3
    slope_step: float = 0.1


THRESHOLDS = Thresholds()


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
        piece_s: float = THRESHOLDS.piece_s,
        count: int = THRESHOLDS.piece_count,
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
        fraction = THRESHOLDS.screening_dofs / len(replayer.dofs)
        few = max(THRESHOLDS.screening_count, round(fraction * len(errors)))
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
        if self.share(fit) < THRESHOLDS.min_hope:
            return self, fit
        noisy, count = fit.change(self.setup), THRESHOLDS.long_count
        length_s = min(
            self.replayer.longest_s() / count,
            THRESHOLDS.max_long_s,
            self.max_total_s() / count,
        )
        # The pieces are few: hardly longer ones say less than the many short ones.
        while length_s > 2.0 * THRESHOLDS.piece_s and self.floor == 1.0:
            problem = Problem(
                self.replayer, self.setup, noisy=noisy, piece_s=length_s, count=count
            )
            is_seen = problem.before.error > THRESHOLDS.min_seen * self.before.error
            problem.weight = self.excess(self.before) / problem.excess(problem.before)
            (long,) = problem.judged([fit], [fit.label])
            # A chaotic motion is missed more and more.
            limit = (
                THRESHOLDS.max_growth * max(self.excess(fit), 0.0)
                + THRESHOLDS.near_noise
            )
            if is_seen and problem.excess(long) < limit:
                return problem, long
            length_s *= 0.5
        return self, fit

    def for_values(self, fit: Fit) -> Problem:
        """Return the problem whose pieces give the values of a fit; no longer than those that judge it."""
        count = THRESHOLDS.value_count
        length_s = min(THRESHOLDS.value_s, 2.0 * self.max_total_s() / count)
        return Problem(
            self.replayer,
            self.setup,
            noisy=fit.change(self.setup),
            piece_s=min(self.piece_s, max(length_s, THRESHOLDS.piece_s)),
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
        steps = THRESHOLDS.max_steps / self.replayer.noise_predictions
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
            is_far = judged.error > self.floor * (1.0 + THRESHOLDS.near_noise)
            is_few = index < THRESHOLDS.max_polished
            if is_rival and is_few and is_far and len(fit.numbers):
                again = self.minimize(judged, measure=True)
                judged = min(judged, again, key=self.cost)
            found.append(judged)

        def rank(fit: Fit) -> tuple[float, int, float]:
            excess = max(self.excess(fit), THRESHOLDS.near_noise)
            return excess, len(fit.numbers), self.cost(fit)

        return sorted(found, key=rank)

    def still_equal(self, fits: Sequence[Fit], names: Sequence[str]) -> list[str]:
        """Return the names whose fits on these pieces are as good as the first one."""
        limit = (
            THRESHOLDS.max_growth * max(self.excess(fits[0]), 0.0)
            + THRESHOLDS.max_excess_of_several
        )
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
        is_odd = errors > THRESHOLDS.odd_error * max(np.median(errors), self.floor)
        return pieces[is_odd & (is_odd.mean() < THRESHOLDS.max_odd)]

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
        return fit.error * (1.0 + THRESHOLDS.number_cost * len(fit.numbers))


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
        steps = THRESHOLDS.slope_step * np.eye(len(change))
        moved = [residuals(change + step) - remembered(change) for step in steps]
        return np.transpose(moved) / THRESHOLDS.slope_step

    # The first step of least squares is as large as what it begins with, or 1 for zeros: a change, and no number.
    start = np.zeros(len(fit.numbers))
    found = least_squares(
        remembered,
        start,
        measured if slopes is None else lambda _: slopes,
        bounds=fit.room,
        method="dogbox",
        ftol=THRESHOLDS.min_gain,
        xtol=THRESHOLDS.min_step,
        max_nfev=THRESHOLDS.max_predictions,
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
    half_width = student_t(freedom) * np.sqrt(variance)
    return replace(fit, numbers=found.x, half_width=half_width)
