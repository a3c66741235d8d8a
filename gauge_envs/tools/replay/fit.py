"""Fits of the causes: share of the error that each explains on pieces of the log that the fit has not seen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import least_squares, lsq_linear
from scipy.stats import t as student, wilcoxon

from gauge_envs.tools.replay.causes import FAR, Cause, Group
from gauge_envs.tools.replay.log import FloatArray
from gauge_envs.tools.replay.model import Setup
from gauge_envs.tools.replay.predict import Replayer
from gauge_envs.tools.replay.schema import Verdict

HORIZON_S = 0.25
PIECES = 28
EXPLAINS = 0.9
"""Share of the error from which on a cause is named."""
NEAR, MAX_LEFT = 1.5, 8.0
"""Error beyond the noise, over that of the noise: of a fit that needs no second cause, and of one that is a result."""
LEADS = 5.0
"""How many times the others must leave of the error, where a fit leaves more than that."""
BETTER = 0.75
"""Error that several causes may leave, over that of one less."""
WITHIN_NOISE = 1.3
"""Mean squared error over that of the noise, below which nothing is left to explain."""
PARAMETER_COST = 0.0005
"""Share that one more number of a fit must bring."""
MAX_GROUPS = 2
"""Number of groups of each cause that are fitted."""
MAX_FEW = 12
MAX_CALLS, MAX_LARGE_CALLS = 25, 6
"""Calls of least squares for a few numbers, and for many."""
SERVO = ("delay", "kp", "armature", "damping")
"""Causes that are fitted together where two are not enough: the constants of a servo."""
MAX_ALONE, MAX_FURTHER, MAX_POOL, MAX_BASES = 8, 3, 5, 2
"""Number of fits that are refined: alone, on top of others, and again those that are best alone; and of such bases."""
MAX_SEVERAL = 4
"""Number of causes that are named together."""
PROBE = 0.05
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

    terms: tuple[tuple[Cause, Group], ...] = ()
    numbers: FloatArray = field(default_factory=lambda: np.zeros(0))
    train: FloatArray = field(default_factory=lambda: np.zeros(0))
    held_out: FloatArray = field(default_factory=lambda: np.zeros(0))
    promised: float = np.inf
    half_width: FloatArray | None = None

    @property
    def names(self) -> list[str]:
        """Names of the causes."""
        return [cause.name for cause, _ in self.terms]

    @property
    def residuals(self) -> FloatArray:
        """Residuals of all pieces that were predicted, shape [P, T D]."""
        if self.held_out.size:
            return np.concatenate([self.train, self.held_out])
        return self.train

    @property
    def error(self) -> float:
        """Mean squared error over that of the noise, of pieces that the fit has not seen, or of the others before."""
        if self.held_out.size:
            return float(np.mean(self.held_out**2))
        trained = float(np.mean(self.train**2)) if self.train.size else np.inf
        return min(trained, self.promised)

    def parts(self, numbers: FloatArray) -> list[FloatArray]:
        """Return the numbers of each term."""
        sizes = [group.size for _, group in self.terms]
        return np.split(numbers, np.cumsum(sizes)[:-1])

    def with_term(self, cause: Cause, group: Group, numbers: FloatArray) -> Fit:
        """Return a fit with one more cause, without residuals."""
        terms = (*self.terms, (cause, group))
        return Fit(terms, np.append(self.numbers, numbers))


class Problem:
    """Whitened residuals of a log: independent, with standard deviation 1, if the model is right.

    Args:
        replayer: Predicts the log.
        setup: What the user gave; the noise is propagated by it.

    Attributes:
        before: The model as it is.
        floor: Error over noise of a perfect model: 1, or that of the first of two logs.
    """

    def __init__(self, replayer: Replayer, setup: Setup) -> None:
        self.replayer, self.setup = replayer, setup
        pieces = replayer.pieces(HORIZON_S, PIECES)
        self._pieces, self._whiteners = [], []
        for first in (0, 1):
            half = pieces[first::2]
            covariance = replayer.covariance(setup, half)
            self._pieces.append(half)
            self._whiteners.append(np.linalg.inv(np.linalg.cholesky(covariance)))
        self.floor = 1.0
        self.before = self.judged(Fit())

    def changed(self, fit: Fit) -> Setup:
        """Return the setup of a fit."""
        setup = self.setup
        for (cause, group), part in zip(
            fit.terms, fit.parts(fit.numbers), strict=False
        ):
            setup = cause.changed(setup, group, part)
        return setup

    def _residuals(self, setup: Setup, half: int) -> FloatArray:
        deviation = self.replayer.predict(setup, self._pieces[half])
        columns = deviation.reshape(len(deviation), -1, 1)
        white = (self._whiteners[half] @ columns)[..., 0]
        return np.clip(white, -MAX_WHITE, MAX_WHITE)

    def trained(self, fit: Fit) -> Fit:
        """Return a fit with its residuals of the training pieces."""
        train = self._residuals(self.changed(fit), 0)
        return replace(fit, train=train, held_out=np.zeros(0))

    def judged(self, fit: Fit) -> Fit:
        """Return a fit with all its residuals."""
        setup = self.changed(fit)
        train, held_out = (self._residuals(setup, half) for half in (0, 1))
        return replace(fit, train=train, held_out=held_out)

    def left(self, fit: Fit) -> float:
        """Return the error beyond the noise that a fit leaves, over that of the noise."""
        return fit.error / self.floor - 1.0

    def share(self, fit: Fit) -> float:
        """Return the share of the error beyond the noise that a fit explains."""
        beyond = max(self.before.error - self.floor, 1e-9)
        return 1.0 - (fit.error - self.floor) / beyond

    def cost(self, fit: Fit) -> float:
        """Return the error of a fit, and what its numbers must bring."""
        return fit.error + PARAMETER_COST * len(fit.numbers) * self.before.error


def _slopes(evaluate: Callable[[Fit], Fit], fit: Fit, steps: FloatArray) -> FloatArray:
    """Return the change of the residuals of a fit per number, shape [P, T D, p], by finite differences."""
    columns = []
    for step in steps:
        moved = evaluate(replace(fit, numbers=fit.numbers + step))
        columns.append((moved.residuals - fit.residuals) / step.sum())
    return np.stack(columns, axis=-1)


def _trials(problem: Problem, base: Fit, cause: Cause) -> list[Fit]:
    """Return the best fits with a further cause before least squares, one a group.

    A smooth cause steps to the optimum of the linear model of the residuals, or 0.4 of the way; other causes take the
    best of several starts.
    """
    count = len(cause.parameters)
    is_smooth = not cause.starts and count
    if is_smooth:
        every = base.with_term(cause, Group("", np.arange(count)), np.zeros(count))
        every = replace(every, train=base.train)
        steps = PROBE * np.eye(len(every.numbers))[-count:]
        slopes = _slopes(problem.trained, every, steps)
    trials = []
    for group in cause.groups:
        promised, starts = np.inf, [np.zeros(0)]
        if is_smooth:
            columns = slopes[..., group.index].reshape(-1, len(group.index))
            if group.is_shared:
                columns = columns.sum(axis=1, keepdims=True)
            bounds = cause.lower(group), FAR
            solution = lsq_linear(columns, -base.train.ravel(), bounds=bounds)
            promised = 2.0 * solution.cost / base.train.size
            starts = [solution.x, 0.4 * solution.x]
        elif group.option is None:
            starts = [np.maximum(start, cause.lower(group)) for start in cause.starts]
        fits = [base.with_term(cause, group, start) for start in starts]
        trials.append((replace(fits[0], promised=promised), fits))
    if is_smooth:
        trials = sorted(trials, key=lambda trial: problem.cost(trial[0]))[:MAX_GROUPS]
    best = []
    for promise, fits in trials:
        fit = min(map(problem.trained, fits), key=problem.cost)
        best.append(replace(fit, promised=promise.promised))
    return sorted(best, key=problem.cost)[:MAX_GROUPS]


def _refined(problem: Problem, fit: Fit) -> Fit:
    """Return a fit after least squares of all its numbers together, with all its residuals."""
    if not len(fit.numbers):
        return problem.judged(fit)
    lower = np.concatenate([cause.lower(group) for cause, group in fit.terms])
    start = np.clip(fit.numbers, lower + 1e-9, FAR - 1e-9)
    solution = least_squares(
        lambda numbers: problem.trained(replace(fit, numbers=numbers)).train.ravel(),
        start,
        bounds=(lower, FAR),
        diff_step=1e-2,
        x_scale=np.maximum(np.abs(start), 0.05),
        ftol=1e-3,
        xtol=1e-4,
        max_nfev=MAX_CALLS if len(start) < MAX_FEW else MAX_LARGE_CALLS,
    )
    return problem.judged(replace(fit, numbers=solution.x))


def best_fits(
    problem: Problem,
    base: Fit,
    causes: Sequence[Cause],
    count: int,
    advance: Callable[[str], None] = lambda _: None,
) -> list[Fit]:
    """Return the best fit with each further cause, the best first; `count` fits are refined."""
    trials: list[Fit] = []
    for cause in causes:
        advance(cause.name)
        trials += _trials(problem, base, cause)
    trials.sort(key=problem.cost)
    fits = [_refined(problem, fit) for fit in trials[:count]]
    fits += [problem.judged(fit) for fit in trials[count:]]
    best: dict[str, Fit] = {}
    for fit in sorted(fits, key=problem.cost):
        best.setdefault(fit.names[-1], fit)
    return list(best.values())


def _with_interval(problem: Problem, fit: Fit) -> Fit:
    """Return a fit with the 95 % intervals of its numbers.

    The sandwich A^-1 B A^-1 sums the gradients by pieces, so that correlated residuals and the spread over the pieces
    both widen it.
    """
    if not len(fit.numbers):
        return fit
    after = fit.residuals
    steps = np.diag(1e-2 * np.maximum(np.abs(fit.numbers), 0.05))
    slopes = _slopes(problem.judged, fit, steps)
    inverse = np.linalg.pinv(np.einsum("pri,prj->ij", slopes, slopes))
    gradients = np.einsum("pri,pr->pi", slopes, after)
    freedom = max(len(after) - len(fit.numbers), 1)
    spread = inverse @ gradients.T @ gradients @ inverse * len(after) / freedom
    # The noise alone gives the narrowest interval.
    variance = np.maximum(np.diag(spread), np.abs(np.diag(inverse)))
    return replace(fit, half_width=student.ppf(0.975, freedom) * np.sqrt(variance))


@dataclass(frozen=True)
class Explanation:
    """What explains a log.

    Attributes:
        verdict: What explains the difference.
        fits: Best fit of each cause, the best first; none if the model predicts the log within its noise.
        alike: Names of the causes that the log cannot tell from the first.
        several: Two to four causes that are fitted together; None where one is enough.
    """

    verdict: Verdict = Verdict.NOISE
    fits: tuple[Fit, ...] = ()
    alike: tuple[str, ...] = ()
    several: Fit | None = None

    @property
    def change(self) -> Fit | None:
        """The fit that the verdict is about: one cause, or else several if there are."""
        if self.several and self.verdict is not Verdict.CAUSE:
            return self.several
        return self.fits[0] if self.fits else None


def _are_alike(problem: Problem, best: Fit, other: Fit) -> bool:
    """Say whether the pieces that no fit has seen cannot tell two fits apart (signed ranks, 5 %)."""
    if problem.share(other) < 0.5 * problem.share(best):
        return False
    gap = np.mean(other.held_out**2 - best.held_out**2, axis=1)
    is_equal = np.abs(gap).max() < 1e-3 * (problem.before.error - problem.floor)
    return bool(is_equal or wilcoxon(gap, alternative="greater").pvalue > 0.05)


def _grown(
    problem: Problem, causes: Sequence[Cause], base: Fit, pool: Sequence[Fit]
) -> Fit:
    """Return a fit with the best further cause, after all were fitted together.

    A cause that explains little on top of the others may still explain much with them, so the best ones alone, `pool`,
    are tried too.
    """
    others = [cause for cause in causes if cause.name not in base.names]
    fits = best_fits(problem, base, others, MAX_FURTHER)
    for fit in pool:
        if fit.names[0] not in base.names:
            cause, group = fit.terms[0]
            shorter = fit.numbers if cause.starts else 0.3 * fit.numbers
            fits.append(_refined(problem, base.with_term(cause, group, shorter)))
    return min(fits, key=lambda fit: fit.error)


def _servo(problem: Problem, causes: Sequence[Cause], fits: Sequence[Fit]) -> list[Fit]:
    """Return the constants of a few servos fitted together; nothing for many servos, or without any."""
    by_name = {cause.name: cause for cause in causes}
    if "kp" not in by_name or len(by_name["kp"].parameters) * len(SERVO) > MAX_FEW:
        return []
    delay = next(fit for fit in fits if fit.names == ["delay"])
    for name in SERVO[1:]:
        group = by_name[name].groups[-1]
        delay = delay.with_term(by_name[name], group, np.zeros(group.size))
    return [_refined(problem, delay)]


def _several(
    problem: Problem, causes: Sequence[Cause], fits: Sequence[Fit], bases: Sequence[Fit]
) -> Fit:
    """Return two to four causes that explain more together."""
    pool = fits[:MAX_POOL]
    tried = []
    for base in bases:
        tried.append(_grown(problem, causes, base, pool))
        if problem.left(tried[-1]) < NEAR:
            return tried[-1]
    several = min([*tried, *_servo(problem, causes, fits)], key=lambda fit: fit.error)
    while (
        len(several.terms) < MAX_SEVERAL
        and problem.left(several) > NEAR
        and problem.share(several) > 0.5
    ):
        more = _grown(problem, causes, several, pool)
        if problem.left(more) > BETTER * problem.left(several):
            break
        several = more
    return several


def _verdict(problem: Problem, fits: Sequence[Fit], several: Fit | None) -> Verdict:
    """Return what explains the difference.

    Several causes are named if they explain it far better than one; one cause if it explains it to the noise, or far
    better than any other one.
    """
    left, share = problem.left(fits[0]), problem.share(fits[0])
    if (
        several
        and problem.share(several) > EXPLAINS
        and problem.left(several) < min(MAX_LEFT, BETTER * left)
    ):
        return Verdict.SEVERAL
    leads = all(1.0 - problem.share(fit) > LEADS * (1.0 - share) for fit in fits[1:])
    if share > EXPLAINS and (leads or left < MAX_LEFT):
        return Verdict.CAUSE
    return Verdict.NOTHING


def explain(
    problem: Problem,
    causes: Sequence[Cause],
    advance: Callable[[str], None] = lambda _: None,
) -> Explanation:
    """Return what explains the deviation of a log from the model: each cause alone, then several."""
    if problem.before.error < WITHIN_NOISE * problem.floor:
        return Explanation()
    fits = best_fits(problem, problem.before, causes, MAX_ALONE, advance)
    fits[0] = _with_interval(problem, fits[0])
    alike = [fit.names[0] for fit in fits[1:] if _are_alike(problem, fits[0], fit)]
    several = None
    if problem.left(fits[0]) > NEAR:
        advance("several together")
        bases = [fit for fit in fits if fit.names[0] not in alike]
        several = _several(problem, causes, fits, bases[:MAX_BASES])
        several = _with_interval(problem, several)
    return Explanation(
        _verdict(problem, fits, several), tuple(fits), tuple(alike), several
    )
