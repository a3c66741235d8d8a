"""Fits of the causes: share of the error that each explains on pieces of the log that the fit has not seen."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

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
"""Error before least squares, over the smallest, of a fit that is refined where another one reaches the noise."""
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
MAX_FEW = 12
MAX_CALLS, MAX_LARGE_CALLS = 25, 8
"""Calls of least squares for a few numbers, and for many."""
MAX_ALONE, MAX_FURTHER, MAX_POOL, MAX_BASES = 8, 3, 5, 2
"""Number of fits that are refined: alone, on top of others, and again those that are best alone; and of such bases."""
SAME_LAW = {"kd": "damping", "damping": "kd"}
"""Causes that are one law while the torque stays below its limit."""
MAX_ROUNDS, MAX_LEADING = 2, 2
"""Number of times that the best fit propagates the noise, and of the best fits that are refined twice."""
SERVO = ("delay", "kp", "armature", "damping")
"""Causes that are fitted together where two are not enough: the constants of a servo."""
PROBE, MIN_PROBED = 0.05, 0.2
"""Step of finite differences, over a number of the fit, and the smallest such number."""
EMPTY = np.zeros(0)
MAX_WHITE = 1e4


@dataclass(frozen=True, eq=False)
class Fit:
    """Causes that are fitted together; none for the model as it is.

    Attributes:
        terms: Cause and group of each.
        numbers: All numbers of the fit, shape [p].
        train: Whitened residuals of the pieces that the fit sees, shape [P, T D].
        held_out: The same of the other pieces; empty before `Problem.judged`.
        promised: Mean squared training error that a linear model promises.
        half_width: Half of the 95 % interval of each number, where it was computed.
    """

    terms: tuple[tuple[Cause, Group], ...]
    numbers: FloatArray
    train: FloatArray
    held_out: FloatArray
    promised: float = np.inf
    half_width: FloatArray | None = None

    @property
    def names(self) -> list[str]:
        """Names of the causes."""
        return [cause.name for cause, _ in self.terms]

    @property
    def error(self) -> float:
        """Mean squared error over that of the noise, of pieces that the fit has not seen, or of the others before."""
        if self.held_out.size:
            return float(np.mean(self.held_out**2))
        return min(float(np.mean(self.train**2)), self.promised)

    def parts(
        self, numbers: FloatArray
    ) -> Iterator[tuple[tuple[Cause, Group], FloatArray]]:
        """Return each term with its numbers."""
        sizes = [group.selection.shape[1] for _, group in self.terms]
        parts = np.split(numbers, np.cumsum(sizes)[:-1])
        return zip(self.terms, parts, strict=False)

    def with_term(self, cause: Cause, group: Group, numbers: FloatArray) -> Fit:
        """Return a fit with one more cause. Its residuals are not yet computed: they are those of this fit."""
        terms = (*self.terms, (cause, group))
        after = np.append(self.numbers, numbers)
        return Fit(terms, after, self.train, self.train[:0])


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
        self.before = self.judged(Fit((), EMPTY, EMPTY, EMPTY))

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

    def trained(self, fit: Fit) -> Fit:
        """Return a fit with its residuals of the training pieces."""
        train = self._residuals(self.changed(fit), 0)
        return replace(fit, train=train, held_out=train[:0])

    def judged(self, fit: Fit) -> Fit:
        """Return a fit with all its residuals."""
        held_out = self._residuals(self.changed(fit), 1)
        return replace(self.trained(fit), held_out=held_out)

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


def _slopes(problem: Problem, base: Fit, cause: Cause) -> FloatArray:
    """Return the change of the training residuals per number of a further cause, shape [P, T D, K]."""
    count = len(cause.parameters)
    every = Group("each", np.eye(count), cause.present)
    moved = [
        problem.trained(base.with_term(cause, every, probe)).train
        for probe in PROBE * np.eye(count)
    ]
    return (np.stack(moved, axis=-1) - base.train[..., None]) / PROBE


def _trials(problem: Problem, base: Fit, cause: Cause) -> list[Fit]:
    """Return the best fits with a further cause before least squares, one a group.

    A smooth cause steps to the optimum of the linear model of the residuals, or 0.4 of the way; other causes take the
    best of several starts.
    """
    is_smooth = len(cause.parameters) > 0 and not cause.starts
    slopes = _slopes(problem, base, cause) if is_smooth else EMPTY
    trials = []
    for group in cause.groups:
        lower = cause.lower(group)
        starts = [np.maximum(start, lower) for start in cause.starts] or [lower]
        promised = np.inf
        if is_smooth:
            columns = (slopes @ group.selection).reshape(-1, len(lower))
            solution = lsq_linear(columns, -base.train.ravel(), bounds=(lower, FAR))
            starts = [solution.x, 0.4 * solution.x]
            promised = 2.0 * solution.cost / base.train.size
        fits = [base.with_term(cause, group, start) for start in starts]
        trials.append([replace(fit, promised=promised) for fit in fits])
    if is_smooth:
        trials = sorted(trials, key=lambda fits: problem.cost(fits[0]))[:MAX_GROUPS]
    best = [
        min(map(problem.trained, fits), key=lambda fit: float(np.mean(fit.train**2)))
        for fits in trials
    ]
    return sorted(best, key=problem.cost)[:MAX_GROUPS]


def _refined(problem: Problem, fit: Fit) -> Fit:
    """Return a fit after least squares of all its numbers together, with all its residuals."""
    if not len(fit.numbers):
        return problem.judged(fit)
    lower = np.concatenate([cause.lower(group) for cause, group in fit.terms])
    start = np.clip(fit.numbers, lower + 1e-9, FAR - 1e-9)

    def residuals(numbers: FloatArray) -> FloatArray:
        return problem.trained(replace(fit, numbers=numbers)).train.ravel()

    def jacobian(numbers: FloatArray) -> FloatArray:
        # Contacts make the residuals rough: smaller steps show their roughness in place of their slope.
        steps = np.diag(PROBE * np.maximum(np.abs(numbers), MIN_PROBED))
        before = residuals(numbers)
        moved = [residuals(numbers + step) - before for step in steps]
        return np.transpose(moved) / steps.diagonal()

    solution = least_squares(
        residuals,
        start,
        jacobian,
        bounds=(lower, FAR),
        x_scale=np.maximum(np.abs(start), 0.05),
        ftol=1e-3,
        xtol=1e-4,
        max_nfev=MAX_CALLS if len(start) < MAX_FEW else MAX_LARGE_CALLS,
    )
    after = problem.judged(replace(fit, numbers=solution.x))
    slopes = solution.jac.reshape(*after.train.shape, -1)
    return replace(after, half_width=_half_width(slopes, after.train))


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
    problem: Problem,
    base: Fit,
    causes: Sequence[Cause],
    count: int,
    advance: Callable[[str], None] = lambda _: None,
) -> list[Fit]:
    """Return the best fit with each further cause, the best first.

    At most `count` fits are refined, and after one that reaches the noise only those that come near to it.
    """
    trials: list[Fit] = []
    for cause in causes:
        advance(cause.name)
        trials += _trials(problem, base, cause)
    trials.sort(key=problem.cost)
    fits: list[Fit] = []
    limit = np.inf
    for trial in trials:
        if len(fits) < count and trial.error < limit:
            fit = _refined(problem, trial)
            if problem.left(fit) < NEAR:
                limit = MAX_WORSE * trials[0].error
        else:
            fit = problem.judged(trial)
        fits.append(fit)
    return _best_by_cause(problem, fits)


def _best_by_cause(problem: Problem, fits: Sequence[Fit]) -> list[Fit]:
    """Return the best fit of each last cause, the best first."""
    best: dict[str, Fit] = {}
    for fit in sorted(fits, key=problem.cost):
        best.setdefault(fit.names[-1], fit)
    return list(best.values())


def _fits_alone(
    problem: Problem, causes: Sequence[Cause], advance: Callable[[str], None]
) -> tuple[Problem, list[Fit]]:
    """Return the best fit of each cause alone, the best first, and the problem that they solve.

    A cause may change how the noise propagates: feet that slip keep a velocity that feet that stick lose. So the best
    fit propagates the noise, if it reaches the noise then.
    """
    fits = best_fits(problem, problem.before, causes, MAX_ALONE, advance)
    if problem.left(fits[0]) > NEAR:
        refined = [_refined(problem, fit) for fit in fits[:MAX_LEADING]]
        fits = _best_by_cause(problem, refined + fits)
    followed, leaders = problem, fits
    for _ in range(MAX_ROUNDS):
        if followed.left(leaders[0]) < NEAR:
            break
        further = followed.following(leaders[0])
        if further is None:
            break
        followed = further
        cause = leaders[0].terms[0][0]
        again = best_fits(followed, followed.before, [cause], MAX_GROUPS)
        again += [followed.judged(fit) for fit in leaders]
        leaders = _best_by_cause(followed, again)
    reaches_noise = followed.left(leaders[0]) < NEAR
    return (followed, leaders) if reaches_noise else (problem, fits)


def _same_law(problem: Problem, causes: Sequence[Cause], fit: Fit) -> list[Fit]:
    """Return a fit of the cause with the same law and the same values, if there is one."""
    (cause, group), numbers = next(fit.parts(fit.numbers))
    changes = cause.values(group, numbers) - cause.present
    by_name = dict(zip(cause.parameters, changes, strict=False))
    fits = []
    for other in causes:
        if SAME_LAW.get(cause.name) == other.name:
            values = np.array([by_name.get(name, 0.0) for name in other.parameters])
            each = other.groups[-1]
            start = np.maximum(values / other.scale, other.lower(each))
            alone = problem.before.with_term(other, each, start)
            fits.append(problem.judged(alone))
    return fits


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
    if "kp" not in by_name or len(by_name["kp"].parameters) * len(SERVO) > MAX_FEW:
        return []
    fit = next(fit for fit in fits if fit.names == ["delay"])
    for name in SERVO[1:]:
        group = by_name[name].groups[-1]
        fit = fit.with_term(by_name[name], group, 0.0 * by_name[name].lower(group))
    return [_refined(problem, fit)]


def _several(
    problem: Problem, causes: Sequence[Cause], fits: Sequence[Fit], bases: Sequence[Fit]
) -> Fit:
    """Return the pair of causes, or the constants of a servo, that explain most.

    A cause that explains little on top of another one may still explain much with it, so the best ones alone are tried
    too.
    """
    together: list[Fit] = []
    for base in bases:
        others = [cause for cause in causes if cause.name not in base.names]
        together += best_fits(problem, base, others, MAX_FURTHER)
        for fit in fits[:MAX_POOL]:
            if fit.names != base.names:
                cause, group = fit.terms[0]
                shorter = fit.numbers if cause.starts else 0.3 * fit.numbers
                pair = base.with_term(cause, group, shorter)
                together.append(_refined(problem, pair))
        best = min(together, key=lambda fit: fit.error)
        if problem.left(best) < NEAR:
            return best
    together += _servo(problem, causes, fits)
    return min(together, key=lambda fit: fit.error)


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
    problem, fits = _fits_alone(problem, causes, advance)
    others = [*_same_law(problem, causes, fits[0]), *fits[1:]]
    alike = [fit.names[0] for fit in others if _are_alike(problem, fits[0], fit)]
    alike = list(dict.fromkeys(alike))
    several = None
    if problem.left(fits[0]) > NEAR:
        advance("several together")
        bases = [fit for fit in fits if fit.names[0] not in alike][:MAX_BASES]
        several = _several(problem, causes, fits, bases)
    verdict = _verdict(problem, fits, several)
    change = fits[0] if several is None or verdict is Verdict.CAUSE else several
    return Explanation(problem, verdict, fits, alike, several, change)
