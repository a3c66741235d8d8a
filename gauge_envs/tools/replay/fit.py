"""Fits of the causes: share of the error that each explains on pieces of the log that the fit has not seen."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import least_squares, lsq_linear
from scipy.stats import t as student, wilcoxon

from gauge_envs.tools.replay.causes import FAR, Cause, Group
from gauge_envs.tools.replay.log import FloatArray
from gauge_envs.tools.replay.model import Replayer, Setup
from gauge_envs.tools.replay.schema import Verdict

HORIZON_S = 0.25
PIECES = 28
EXPLAINS = 0.9
"""Share of the error from which on a cause is named."""
NEAR, MAX_LEFT, MAX_LEFT_TOGETHER = 0.5, 8.0, 2.0
"""Excess error, the mean squared error over that of the noise minus 1, at most: to need no second cause; of a cause
that is named; of several causes that are named."""
MAX_WORSE = 4.0
"""Promised error, over the smallest, of a fit that is refined where another one reaches the noise."""
LEADS = 5.0
"""How many times the others must leave of the error, where a fit leaves more than that."""
BETTER = 0.4
"""Error that several causes may leave, over that of one less."""
WITHIN_NOISE = 1.3
"""Mean squared error over that of the noise, below which nothing is left to explain."""
PARAMETER_COST = 0.01
"""Part of the error that one more number of a fit must remove."""
MAX_GROUPS = 2
"""Number of groups of each cause that are fitted."""
MAX_ALONE, MAX_FURTHER, MAX_BASES = 8, 5, 2
"""Number of fits that are refined: alone, and on top of others; and of such bases."""
MAX_CALLS = 20
"""Number of predictions of a fit."""
MAX_ROUNDS, MAX_LEADING = 2, 2
"""Number of times that the best fit propagates the noise, and of the best fits whose slopes are computed anew."""
SERVO = ("delay", "kp", "armature", "damping")
"""Causes that are fitted together where two are not enough: the constants of a servo."""
MAX_SERVO = 12
"""Numbers of such a fit."""
PROBE, MIN_PROBED = 0.05, 0.2
"""Step of finite differences, over a number of the fit, and the smallest such number."""
MAX_SHARPENED, MIN_GAIN = 3, 0.9
"""Number of times that the slopes of a fit are computed, and error after such a round over that before that ends them."""
MIN_SECANT = 0.01
"""Smallest step that updates the slopes: contacts make the residuals rough."""
PARTS = (1.0, 0.4)
"""Parts of the step of the linear model that are tried."""
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
        """Mean squared error over that of the noise, of pieces that the fit has not seen; before, the promised one."""
        if self.held_out.size:
            return float(np.mean(self.held_out**2))
        return self.promised

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
            return replace(self, promised=float(np.mean(self.train**2)))
        slopes = self.slopes.reshape(self.train.size, -1)
        lower = np.clip(self.lower - self.numbers, -self.reach, -1e-9)
        upper = np.clip(FAR - self.numbers, 1e-9, self.reach)
        solution = lsq_linear(slopes, -self.train.ravel(), (lower, upper))
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

    def following(self, fit: Fit) -> Problem | None:
        """Return the problem where a fit propagates the noise; None if its training errors are less likely then."""
        setup = self.changed(fit)
        further = copy.copy(self)
        further.whiteners = self._whitened(setup)
        columns = self.replayer.predict(setup, self._halves[0])
        columns = columns.reshape(len(columns), -1, 1)
        # Twice the negative logarithm of the likelihood, by residual.
        surprises = [
            np.mean((white @ columns) ** 2)
            - 2.0 * np.mean(np.log(np.diagonal(white, axis1=1, axis2=2)))
            for white in (self.whiteners[0], further.whiteners[0])
        ]
        if surprises[1] > surprises[0]:
            return None
        further.before = further.judged(self.before)
        return further

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
    """Return the changes of the residuals by each group of a cause, one a start.

    The changes of single values add up, as far as the residuals are linear. A cause without starts begins at zero.
    """
    before, count = problem.before, len(cause.parameters)

    def change(group: Group, numbers: FloatArray) -> FloatArray:
        fit = replace(before, terms=((cause, group),))
        return problem.trained(fit, numbers).train - before.train

    if not count:
        changes = [change(group, EMPTY) for group in cause.groups]
        return [
            replace(before, terms=((cause, group),), train=moved)
            for group, moved in zip(cause.groups, changes, strict=True)
        ]
    grid = np.sort(cause.starts or (0.0, PROBE))
    singles = cause.groups[:count]
    moved = np.zeros((len(grid), *before.train.shape, count))
    if not cause.starts:
        singles = [Group("", unit[:, None], cause.present) for unit in np.eye(count)]
    for row, number in enumerate(grid):
        if cause.starts or number:
            columns = [change(single, np.array([number])) for single in singles]
            moved[row] = np.stack(columns, axis=-1)
    slopes = np.gradient(moved, grid, axis=0)
    spacing = np.gradient(grid)
    fits = []
    for row in range(len(grid) if cause.starts else 1):
        for group in cause.groups:
            number = np.full(group.selection.shape[1], grid[row])
            fit = Fit(
                terms=((cause, group),),
                numbers=number,
                train=moved[row] @ group.selection.sum(axis=1),
                slopes=slopes[row] @ group.selection,
                reach=np.full(len(number), spacing[row] if cause.starts else np.inf),
            )
            fits.append(fit)
    return fits


def _refined(problem: Problem, fit: Fit) -> Fit:
    """Return a fit after least squares of all its numbers together, with all its residuals.

    Each prediction updates the slopes (Broyden, 1965, Mathematics of Computation 19, p. 577): J += (dr - J dx) dx^T / dx^2.
    """
    if not len(fit.numbers):
        return problem.judged(fit)
    lower = fit.lower
    last = fit

    def residuals(numbers: FloatArray) -> FloatArray:
        nonlocal last
        after = problem.trained(last, numbers)
        step = numbers - last.numbers
        if np.abs(step).max() > MIN_SECANT:
            gap = after.train - last.train - last.slopes @ step
            slopes = last.slopes + gap[..., None] * step / (step @ step)
            after = replace(after, slopes=slopes)
        last = after
        return after.train.ravel()

    numbers = [
        np.clip(fit.numbers + part * fit.step, lower + 1e-9, FAR - 1e-9)
        for part in PARTS
    ]
    start = min(numbers, key=lambda each: float(np.sum(residuals(each) ** 2)))
    solution = least_squares(
        residuals,
        start,
        lambda _: last.slopes.reshape(-1, len(start)),
        bounds=(lower, FAR),
        x_scale=np.maximum(np.abs(start), 0.05),
        ftol=1e-3,
        xtol=1e-4,
        max_nfev=MAX_CALLS,
    )
    free = np.full(len(start), np.inf)
    after = replace(last, numbers=solution.x, reach=free)
    return problem.judged(after)


def _sharpened(problem: Problem, fit: Fit) -> Fit:
    """Return a fit with slopes computed anew, refined until it improves no more, and with intervals."""
    if not len(fit.numbers):
        return fit
    for _ in range(MAX_SHARPENED):
        # Contacts make the residuals rough: smaller steps show their roughness in place of their slope.
        steps = PROBE * np.maximum(np.abs(fit.numbers), MIN_PROBED)
        trained = [problem.trained(fit, fit.numbers + step) for step in np.diag(steps)]
        moved = np.stack([each.train for each in trained], axis=-1)
        slopes = (moved - fit.train[..., None]) / steps
        again = _refined(problem, replace(fit, slopes=slopes).linear())
        before, after = (np.mean(each.train**2) for each in (fit, again))
        if after < before:
            fit = again
        if after > MIN_GAIN * before:
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
    problem: Problem, base: Fit, changes: Sequence[Fit], count: int
) -> tuple[list[Fit], list[Fit]]:
    """Return the refined fits with each further cause, the best first, and the other ones.

    At most `count` fits are refined, and after one that reaches the noise only those that come near to it.
    """
    by_cause: dict[str, list[Fit]] = {}
    promising = [base.plus(change).linear() for change in changes]
    for fit in sorted(promising, key=problem.cost):
        by_cause.setdefault(fit.names[-1], []).append(fit)
    few = [fit for fits in by_cause.values() for fit in fits[:MAX_GROUPS]]
    few.sort(key=problem.cost)
    refined: list[Fit] = []
    limit = np.inf
    for fit in few:
        if len(refined) == count or fit.promised > limit:
            break
        refined.append(_refined(problem, fit))
        if problem.left(refined[-1]) < NEAR:
            limit = MAX_WORSE * few[0].promised
    return _best_by_cause(problem, refined), few[len(refined) :]


def _best_by_cause(problem: Problem, fits: Sequence[Fit]) -> list[Fit]:
    """Return the best fit of each last cause, the best first."""
    best: dict[str, Fit] = {}
    for fit in sorted(fits, key=problem.cost):
        best.setdefault(fit.names[-1], fit)
    return list(best.values())


def _fits_alone(problem: Problem, changes: Sequence[Fit]) -> tuple[Problem, list[Fit]]:
    """Return the best fit of each cause alone, the best first, and the problem that they solve.

    A cause may change how the noise propagates: feet that slip keep a velocity that feet that stick lose. So the best
    fit propagates the noise, if it reaches the noise then.
    """
    fits, others = best_fits(problem, problem.before, changes, MAX_ALONE)
    stepped = [
        replace(
            fit, numbers=fit.numbers + fit.step if len(fit.numbers) else fit.numbers
        )
        for fit in others
    ]
    sharp = [_sharpened(problem, fit) for fit in fits[:MAX_LEADING]]
    fits = _best_by_cause(
        problem, sharp + fits[MAX_LEADING:] + [problem.judged(fit) for fit in stepped]
    )
    followed, leaders = problem, fits
    for _ in range(MAX_ROUNDS):
        if followed.left(leaders[0]) < NEAR:
            break
        further = followed.following(leaders[0])
        if further is None:
            break
        followed = further
        cause = leaders[0].terms[0][0]
        again, _ = best_fits(
            followed, followed.before, trials(followed, cause), MAX_GROUPS
        )
        again = [_sharpened(followed, again[0])]
        again += [followed.judged(fit) for fit in leaders]
        leaders = _best_by_cause(followed, again)
    reaches_noise = followed.left(leaders[0]) < NEAR
    return (followed, leaders) if reaches_noise else (problem, fits)


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


def _are_alike(problem: Problem, best: Fit, other: Fit) -> bool:
    """Say whether the pieces that no fit has seen cannot tell two fits apart (signed ranks, 5 %)."""
    if problem.share(other) < 0.5 * problem.share(best):
        return False
    gap = np.mean(other.held_out**2 - best.held_out**2, axis=1)
    is_equal = np.abs(gap).max() < 1e-3 * (problem.before.error - problem.floor)
    return bool(is_equal or wilcoxon(gap, alternative="greater").pvalue > 0.05)


def _servo(problem: Problem, causes: Sequence[Cause], fits: Sequence[Fit]) -> list[Fit]:
    """Return the constants of a few servos fitted together; nothing for many servos, or without any."""
    by_name = {cause.name: cause for cause in causes}
    if "kp" not in by_name or len(by_name["kp"].parameters) * len(SERVO) > MAX_SERVO:
        return []
    fit = next(fit for fit in fits if fit.names == ["delay"])
    groups = [by_name[name].groups[-1] for name in SERVO[1:]]
    terms = zip([by_name[name] for name in SERVO[1:]], groups, strict=True)
    zeros = np.concatenate(
        [0.0 * by_name[name].lower(by_name[name].groups[-1]) for name in SERVO[1:]]
    )
    fit = replace(
        fit, terms=(*fit.terms, *terms), numbers=np.append(fit.numbers, zeros)
    )
    fit = replace(fit, reach=np.full(len(fit.numbers), np.inf))
    return [_sharpened(problem, problem.judged(fit))]


def _several(
    problem: Problem,
    causes: Sequence[Cause],
    changes: Sequence[Fit],
    fits: Sequence[Fit],
    bases: Sequence[Fit],
) -> Fit:
    """Return the pair of causes, or the constants of a servo, that explain most."""
    together: list[Fit] = []
    for base in bases:
        others = [fit for fit in changes if fit.names != base.names]
        together += best_fits(problem, base, others, MAX_FURTHER)[0]
        best = min(together, key=problem.cost)
        if problem.left(best) < NEAR:
            return _sharpened(problem, best)
    best = min(together, key=problem.cost)
    together += [_sharpened(problem, best), *_servo(problem, causes, fits)]
    return min(together, key=problem.cost)


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
    problem, fits = _fits_alone(problem, changes)
    alike = [fit.names[0] for fit in fits[1:] if _are_alike(problem, fits[0], fit)]
    several = None
    if problem.left(fits[0]) > NEAR:
        advance("several together")
        bases = [fit for fit in fits if fit.names[0] not in alike][:MAX_BASES]
        several = _several(problem, causes, changes, fits, bases)
    verdict = _verdict(problem, fits, several)
    change = fits[0] if several is None or verdict is Verdict.CAUSE else several
    return Explanation(problem, verdict, fits, alike, several, change)
