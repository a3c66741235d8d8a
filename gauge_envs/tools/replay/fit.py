"""Fits of the causes: share of the error that each explains on pieces of the log that the fit has not seen."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from scipy.optimize import lsq_linear
from scipy.stats import t as student, wilcoxon

from gauge_envs.tools.replay.causes import FAR, Cause, Group
from gauge_envs.tools.replay.log import FloatArray
from gauge_envs.tools.replay.model import Replayer, Setup
from gauge_envs.tools.replay.schema import Verdict

HORIZON_S = 0.25
PIECES = 28
EXPLAINS = 0.9
"""Smallest share of the error that a named cause explains."""
ENOUGH = 0.99
"""Share that one cause explains, above which a second one is fitted only if much more than the noise remains."""
NEAR = 0.5
"""Excess error up to which no second cause is fitted: the mean squared error over that of the noise, minus 1."""
MAX_LEFT = 8.0
"""Largest excess error of a cause that is named."""
MAX_LEFT_TOGETHER = 2.0
"""Largest excess error of several causes that are named, and of one that explains enough."""
MAX_WORSE = 4.0
"""Largest promised error of a fit that is refined, over that of a fit that reached the noise."""
LEADS = 5.0
"""Smallest error of every other cause, over that of a named cause that leaves more than `MAX_LEFT`."""
BETTER = 0.4
"""Largest error of several causes that are named, over that of one cause."""
WITHIN_NOISE = 1.3
"""Mean squared error over that of the noise, below which nothing is left to explain."""
PARAMETER_COST = 0.01
"""Part of the error that one more number of a fit must remove."""
MAX_GROUPS = 2
"""Number of groups of each cause that are fitted."""
MAX_ALONE, MAX_TOGETHER = 8, 8
"""Number of fits of one cause, and of two causes, that are refined."""
MAX_BASES = 8
"""Number of fits of one cause to which a second cause is added."""
MAX_STEPS = 20
"""Largest number of steps of least squares."""
MAX_ROUNDS = 2
"""Number of times that the best fit propagates the noise."""
MAX_LEADING = 2
"""Number of the best fits that get new slopes and intervals."""
SERVO = ("delay", "kp", "armature", "damping")
"""Causes that are fitted together where two are not enough: the constants of a servo."""
MAX_SERVO = 12
"""Largest number of constants of servos that are fitted together."""
PROBE = 0.1
"""Step of finite differences. Contacts make the residuals rough, and smaller steps measure that roughness."""
MAX_SHARPENED = 3
"""Largest number of times that the slopes of a fit are computed anew."""
MIN_GAIN = 0.9
"""Error after new slopes, over the error before, above which they are not computed again."""
MIN_PROMISED = 0.998
"""Promised error over the present error, above which least squares ends."""
SHORTER = 0.3
"""Length of a step, over that of the step before it that failed."""
MIN_REACH = 1e-9
EMPTY = np.zeros(0)
MAX_WHITE = 1e4


@dataclass(frozen=True, eq=False)
class Fit:
    """Causes that are fitted together; none for the model as it is.

    Attributes:
        terms: Cause and group of each.
        numbers: All numbers of the fit, shape [p].
        train: Whitened residuals of the pieces that the fit sees, shape [P, T D].
        slopes: Their change per number, shape [P, T D, p].
        reach: How far the linear model of the residuals is used, shape [p].
        step: Change of the numbers to the optimum of the linear model, shape [p].
        promised: Mean squared training error there.
        held_out: Residuals of the other pieces; empty before `Problem.judged`.
        half_width: Half of the 95 % interval of each number, where it was computed.
    """

    terms: tuple[tuple[Cause, Group], ...]
    numbers: FloatArray
    train: FloatArray
    slopes: FloatArray
    reach: FloatArray
    step: FloatArray = field(default_factory=lambda: EMPTY)
    promised: float = np.inf
    held_out: FloatArray = field(default_factory=lambda: EMPTY)
    half_width: FloatArray | None = None

    @property
    def names(self) -> list[str]:
        """Names of the causes."""
        return [cause.name for cause, _ in self.terms]

    @property
    def error(self) -> float:
        """Mean squared error over that of the noise on held-out pieces; the promised one before `Problem.judged`."""
        if self.held_out.size:
            return float(np.mean(self.held_out**2))
        return self.promised

    @property
    def misfit(self) -> float:
        """Mean squared training error."""
        return float(np.mean(self.train**2))

    @property
    def lower(self) -> FloatArray:
        """Smallest numbers, shape [p]."""
        smallest = [cause.lower(group) for cause, group in self.terms]
        return np.concatenate([EMPTY, *smallest])

    def parts(
        self, numbers: FloatArray
    ) -> Iterator[tuple[tuple[Cause, Group], FloatArray]]:
        """Return each term with its numbers."""
        sizes = [group.selection.shape[1] for _, group in self.terms]
        parts = np.split(numbers, np.cumsum(sizes)[:-1])
        return zip(self.terms, parts, strict=False)

    def plus(self, other: Fit) -> Fit:
        """Return a fit with the terms of another one, whose residuals are a change."""
        return Fit(
            terms=self.terms + other.terms,
            numbers=np.append(self.numbers, other.numbers),
            train=self.train + other.train,
            slopes=np.concatenate([self.slopes, other.slopes], axis=-1),
            reach=np.append(self.reach, other.reach),
        )

    def linear(self) -> Fit:
        """Return the fit with the step to the optimum of its linear model."""
        if not len(self.numbers):
            return replace(self, promised=self.misfit)
        columns = np.dstack([self.slopes, -self.train]).reshape(self.train.size, -1)
        # The orthogonal factor changes no residual norm.
        triangle = np.asarray(np.linalg.qr(columns, mode="r"))
        lower = np.clip(self.lower - self.numbers, -self.reach, 0.0)
        upper = np.clip(FAR - self.numbers, MIN_REACH, self.reach)
        solution = lsq_linear(triangle[:, :-1], triangle[:, -1], (lower, upper))
        promised = 2.0 * solution.cost / self.train.size
        return replace(self, step=solution.x, promised=promised)


class Problem:
    """Whitened residuals of a log: independent, with standard deviation 1, if the model is right.

    Args:
        replayer: Predicts the log.
        setup: What the user gave; the noise is propagated by it.

    Attributes:
        whiteners: What makes the deviations of each half independent, shape [P, T D, T D].
        before: The model as it is.
        floor: Error over noise of a perfect model: 1, or that of the first of two logs.
    """

    def __init__(self, replayer: Replayer, setup: Setup) -> None:
        self.replayer, self.setup = replayer, setup
        pieces = replayer.pieces(HORIZON_S, PIECES)
        self._halves = pieces[::2], pieces[1::2]
        self.floor = 1.0
        self.whiteners = self._whitened(setup)
        none = Fit((), EMPTY, EMPTY, np.zeros((*self.whiteners[0].shape[:2], 0)), EMPTY)
        self.before = self.judged(none)

    def _whitened(self, setup: Setup) -> list[FloatArray]:
        """Return what makes the deviations of each half independent, where a setup propagates the noise."""
        covariances = [self.replayer.covariance(setup, half) for half in self._halves]
        return [np.linalg.inv(np.linalg.cholesky(each)) for each in covariances]

    def following(self, fit: Fit) -> Problem:
        """Return the problem where a fit propagates the noise."""
        further = copy.copy(self)
        further.whiteners = self._whitened(self.changed(fit))
        further.before = further.judged(self.before)
        return further

    def surprise(self, fit: Fit) -> float:
        """Return twice the negative logarithm of the likelihood of the training errors, by residual."""
        precision = np.diagonal(self.whiteners[0], axis1=1, axis2=2)
        return fit.misfit - 2.0 * float(np.mean(np.log(precision)))

    def changed(self, fit: Fit) -> Setup:
        """Return the setup of a fit."""
        setup = self.setup
        for (cause, group), numbers in fit.parts(fit.numbers):
            setup = cause.changed(setup, group, numbers)
        return setup

    def _residuals(self, setup: Setup, half: int) -> FloatArray:
        deviation = self.replayer.predict(setup, self._halves[half])
        columns = deviation.reshape(len(deviation), -1, 1)
        white = (self.whiteners[half] @ columns)[..., 0]
        return np.clip(white, -MAX_WHITE, MAX_WHITE)

    def trained(self, fit: Fit, numbers: FloatArray) -> Fit:
        """Return a fit with other numbers, and its residuals of the training pieces."""
        after = replace(fit, numbers=numbers, held_out=EMPTY)
        return replace(after, train=self._residuals(self.changed(after), 0))

    def judged(self, fit: Fit) -> Fit:
        """Return a fit with all its residuals."""
        held_out = self._residuals(self.changed(fit), 1)
        return replace(self.trained(fit, fit.numbers), held_out=held_out)

    def left(self, fit: Fit) -> float:
        """Return the error beyond the noise that a fit leaves, over that of the noise."""
        return fit.error / self.floor - 1.0

    def share(self, fit: Fit) -> float:
        """Return the share of the error beyond the noise that a fit explains."""
        beyond = max(self.before.error - self.floor, 1e-9)
        return 1.0 - (fit.error - self.floor) / beyond

    def cost(self, fit: Fit) -> float:
        """Return the error of a fit, and what its numbers must bring."""
        return fit.error * (1.0 + PARAMETER_COST * len(fit.numbers))


def trials(problem: Problem, cause: Cause) -> list[Fit]:
    """Return the change of the residuals by each group of a cause, one for each start.

    A cause without starts begins at the present values. The changes of single values are added, as for linear
    residuals.
    """
    before, count = problem.before, len(cause.parameters)

    def change(group: Group, number: float) -> FloatArray:
        numbers = np.full(group.selection.shape[1], number)
        fit = replace(before, terms=((cause, group),))
        return problem.trained(fit, numbers).train - before.train

    if not count:
        (group,) = cause.groups
        return [replace(before, terms=((cause, group),), train=change(group, 0.0))]
    singles = [Group("", unit[:, None]) for unit in np.eye(count)]
    grid = np.sort(cause.starts or (0.0, PROBE))
    moved = np.zeros((len(grid), *before.train.shape, count))
    fits = []
    for row, column in np.ndindex(len(grid), count):
        if cause.starts or row:
            moved[row, ..., column] = change(singles[column], float(grid[row]))
    slopes, spacing = np.gradient(moved, grid, axis=0), np.gradient(grid)
    for row, group in product(range(len(cause.starts) or 1), cause.groups):
        picks, ones = group.selection, np.ones(group.selection.shape[1])
        fit = Fit(
            terms=((cause, group),),
            numbers=grid[row] * ones,
            train=moved[row] @ picks.sum(axis=1),
            slopes=slopes[row] @ picks,
            reach=(spacing[row] if cause.starts else np.inf) * ones,
        )
        fits.append(fit)
    return fits


def _refined(problem: Problem, fit: Fit) -> Fit:
    """Return a fit after steps to the optimum of its linear model, with all its residuals.

    Each prediction updates the slopes (Broyden 1965, Mathematics of Computation 19, 577): J += (dr - J dx) dx^T / dx^2.
    """
    fit = problem.trained(fit, fit.numbers).linear()
    for _ in range(MAX_STEPS):
        if fit.promised > MIN_PROMISED * fit.misfit:
            break
        step = fit.step
        after = problem.trained(fit, fit.numbers + step)
        gap = after.train - fit.train - fit.slopes @ step
        slopes = fit.slopes + gap[..., None] * step / (step @ step)
        if after.misfit < fit.misfit:
            fit = replace(after, slopes=slopes, reach=2.0 * fit.reach)
        else:
            fit = replace(fit, slopes=slopes, reach=SHORTER * np.abs(step) + MIN_REACH)
        fit = fit.linear()
    return problem.judged(replace(fit, reach=np.full(len(fit.numbers), np.inf)))


def _sharpened(problem: Problem, fit: Fit) -> Fit:
    """Return a fit after new slopes and further least squares, until they bring little, with intervals."""
    if not len(fit.numbers):
        return fit
    for _ in range(MAX_SHARPENED):
        steps = PROBE * np.eye(len(fit.numbers))
        trained = [problem.trained(fit, fit.numbers + step) for step in steps]
        moved = np.stack([each.train for each in trained], axis=-1)
        slopes = (moved - fit.train[..., None]) / PROBE
        before = fit.misfit
        fit = _refined(problem, replace(fit, slopes=slopes))
        if fit.misfit > MIN_GAIN * before:
            break
    return replace(fit, half_width=_half_width(slopes, fit.train))


def _half_width(slopes: FloatArray, residuals: FloatArray) -> FloatArray:
    """Return half of the 95 % interval of each number, shape [p].

    The sandwich A^-1 B A^-1 sums the gradients by pieces, so that correlated residuals and the spread over the pieces
    both widen it.

    Args:
        slopes: Change of the residuals per number, shape [P, T D, p].
        residuals: Training residuals, shape [P, T D].
    """
    inverse = np.linalg.pinv(np.einsum("pri,prj->ij", slopes, slopes))
    gradients = np.einsum("pri,pr->pi", slopes, residuals)
    pieces, count = gradients.shape
    freedom = max(pieces - count, 1)
    spread = inverse @ gradients.T @ gradients @ inverse * pieces / freedom
    # The noise alone gives the narrowest interval.
    variance = np.maximum(np.diag(spread), np.abs(np.diag(inverse)))
    return student.ppf(0.975, freedom) * np.sqrt(variance)


def best_fits(
    problem: Problem, bases: Sequence[Fit], changes: Sequence[Fit], count: int
) -> list[Fit]:
    """Return the best fit of each further cause on top of each base, the best first.

    At most `count` fits are refined, and after one that reaches the noise only those that come near to it.
    """
    promising = [
        base.plus(change).linear()
        for base, change in product(bases, changes)
        if change.names != base.names
    ]
    limit = np.inf
    fits: list[Fit] = []
    for fit in _few_by_cause(problem, promising, MAX_GROUPS):
        if len(fits) < count and fit.promised < limit:
            after = _refined(problem, fit)
            if problem.left(after) < NEAR:
                limit = min(limit, MAX_WORSE * fit.promised)
        else:
            after = problem.judged(replace(fit, numbers=fit.numbers + fit.step))
        fits.append(after)
    fits.sort(key=problem.cost)
    fits[:MAX_LEADING] = [_sharpened(problem, fit) for fit in fits[:MAX_LEADING]]
    return sorted(fits, key=problem.cost)


def _few_by_cause(problem: Problem, fits: Sequence[Fit], count: int) -> list[Fit]:
    """Return at most `count` fits of each set of causes, one a group, sorted by cost."""
    few: dict[tuple[str, ...], dict[str, Fit]] = {}
    for fit in sorted(fits, key=problem.cost):
        groups = few.setdefault(tuple(sorted(fit.names)), {})
        labels = ", ".join(group.label for _, group in fit.terms)
        if len(groups) < count:
            groups.setdefault(labels, fit)
    flat = [fit for groups in few.values() for fit in groups.values()]
    return sorted(flat, key=problem.cost)


def _followed(problem: Problem, fits: list[Fit]) -> tuple[Problem, list[Fit]]:
    """Return the problem whose noise the best fit propagates, with its fits; the given ones if that does not help.

    A cause may change how the noise propagates: feet that slip keep a velocity, and feet that stick lose it. The best
    fit therefore propagates the noise if it then reaches the noise and its training errors become likelier.
    """
    best = fits[0]
    for _ in range(MAX_ROUNDS):
        followed = problem.following(best)
        changes = trials(followed, best.terms[0][0])
        best = best_fits(followed, [followed.before], changes, MAX_GROUPS)[0]
        is_likelier = followed.surprise(best) < problem.surprise(fits[0])
        if is_likelier and followed.left(best) < NEAR:
            others = [followed.judged(fit) for fit in fits]
            return followed, sorted([best, *others], key=followed.cost)
    return problem, fits


@dataclass(frozen=True)
class Explanation:
    """What explains a log.

    Attributes:
        problem: The log, with the noise that the best fit propagates.
        verdict: What explains the difference.
        fits: Best fit of each cause, the best first; none if the model predicts the log within its noise.
        alike: Names of the causes that the log cannot tell from the first.
        several: Causes that are fitted together; None where one is enough.
        change: The fit that the verdict is about: one cause, or else several if there are.
    """

    problem: Problem
    verdict: Verdict = Verdict.NOISE
    fits: Sequence[Fit] = ()
    alike: Sequence[str] = ()
    several: Fit | None = None
    change: Fit | None = None


def _alike(problem: Problem, fits: Sequence[Fit]) -> list[str]:
    """Return the causes that the held-out pieces cannot tell from the first one (signed ranks, 5 %)."""
    best, *others = fits
    small = 1e-3 * (problem.before.error - problem.floor)
    alike = []
    for fit in others:
        gap = np.mean(fit.held_out**2 - best.held_out**2, axis=1)
        is_equal = np.abs(gap).max() < small
        if problem.share(fit) > 0.5 * problem.share(best) and (
            is_equal or wilcoxon(gap, alternative="greater").pvalue > 0.05
        ):
            alike.append(" and ".join(fit.names))
    return alike


def _servo(problem: Problem, fits: Sequence[Fit], changes: Sequence[Fit]) -> list[Fit]:
    """Return the constants of all servos fitted together from the best delay; nothing for many servos or none."""
    alone = {fit.names[0]: fit for fit in reversed(fits)}
    # The last group of a cause has a number each.
    each = {fit.names[0]: fit for fit in changes}
    if not each.keys() >= {*SERVO}:
        return []
    first, *others = SERVO
    servo = alone[first]
    for name in others:
        servo = servo.plus(each[name])
    if len(servo.numbers) > MAX_SERVO:
        return []
    return [_sharpened(problem, problem.judged(servo))]


def _verdict(problem: Problem, fits: Sequence[Fit], several: Fit | None) -> Verdict:
    """Return what explains the difference.

    Several causes are named if they explain it far better than one; one cause if it explains it to the noise, or far
    better than any other one.
    """
    left, share = problem.left(fits[0]), problem.share(fits[0])
    if (
        several
        and problem.share(several) > EXPLAINS
        and problem.left(several) < min(MAX_LEFT_TOGETHER, BETTER * left)
    ):
        return Verdict.SEVERAL
    leads = all(1.0 - problem.share(fit) > LEADS * (1.0 - share) for fit in fits[1:])
    if share > EXPLAINS and (leads or left < MAX_LEFT):
        return Verdict.CAUSE
    return Verdict.NOTHING


def explain(
    problem: Problem, causes: Sequence[Cause], advance: Callable[[str], None]
) -> Explanation:
    """Return what explains the deviation of a log from the model: each cause alone, then several."""
    if problem.before.error < WITHIN_NOISE * problem.floor:
        return Explanation(problem)
    changes: list[Fit] = []
    for cause in causes:
        advance(cause.name)
        changes += trials(problem, cause)
    fits = best_fits(problem, [problem.before], changes, MAX_ALONE)
    if problem.left(fits[0]) > NEAR:
        problem, fits = _followed(problem, fits)
    alone = _few_by_cause(problem, fits, 1)
    alike = _alike(problem, alone)
    together: list[Fit] = []
    explains_enough = problem.share(alone[0]) > ENOUGH
    if problem.left(alone[0]) > (MAX_LEFT_TOGETHER if explains_enough else NEAR):
        advance("several together")
        bases = [fit for fit in fits if fit.names[0] not in alike]
        together = best_fits(problem, bases[:MAX_BASES], changes, MAX_TOGETHER)
        if problem.left(together[0]) > NEAR:
            together += _servo(problem, fits, changes)
        together = _few_by_cause(problem, together, 1)
    several = next(iter(together), None)
    verdict = _verdict(problem, alone, several)
    if verdict is Verdict.SEVERAL:
        alike = _alike(problem, together)
    change = alone[0] if several is None or verdict is Verdict.CAUSE else several
    return Explanation(problem, verdict, alone, alike, several, change)
