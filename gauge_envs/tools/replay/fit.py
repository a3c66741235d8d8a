"""Fits of the causes: share of the error that each explains on pieces of the log that the fit has not seen."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares, lsq_linear
from scipy.stats import t as student, wilcoxon

from gauge_envs.tools.replay.causes import Cause, Group
from gauge_envs.tools.replay.log import FloatArray
from gauge_envs.tools.replay.model import Setup
from gauge_envs.tools.replay.predict import Replayer

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
"""Number of groups of each cause that the linear model passes on."""
MAX_CALLS = 25
MAX_LARGE_CALLS = 6
"""Calls of least squares for a few numbers, and for many."""
ROUNDS = ((10, 5), (4, MAX_CALLS))
"""Rounds of least squares: number of the best fits, and of their calls; the first keeps Jacobians of many numbers."""
MAX_BASES, MAX_FURTHER, MAX_POOL = 2, 3, 5
"""Number of causes on top of which a second one is sought, of the second ones, and of those that are best alone."""
MAX_SEVERAL = 4
"""Number of causes that are named together."""
PROBE = 0.05
MAX_WHITE = 1e4


class Problem:
    """Whitened residuals of a log: independent, with standard deviation 1, if the model is right.

    Args:
        replayer: Predicts the log.
        setup: What the user gave; the noise is propagated by it.

    Attributes:
        floor: Error over noise of a perfect model: 1, or that of the first of two logs.
    """

    def __init__(self, replayer: Replayer, setup: Setup) -> None:
        self.replayer, self.setup = replayer, setup
        self.pieces = replayer.pieces(HORIZON_S, PIECES)
        covariance = replayer.covariance(setup, self.pieces)
        self.whitener = np.linalg.inv(np.linalg.cholesky(covariance))
        self.is_train = np.arange(len(self.pieces.start)) % 2 == 0
        self.before = self.residuals(setup)
        self.floor = 1.0

    def residuals(self, setup: Setup) -> FloatArray:
        """Return the whitened residuals of all pieces, shape [P, T D]."""
        deviation = self.replayer.predict(setup, self.pieces)
        white = (self.whitener @ deviation.reshape(len(deviation), -1, 1))[..., 0]
        return np.clip(white, -MAX_WHITE, MAX_WHITE)

    def errors(self, residuals: FloatArray) -> FloatArray:
        """Return the mean squared error of each piece that no fit has seen, over that of the noise."""
        return np.mean(residuals[~self.is_train] ** 2, axis=1)

    def error(self, residuals: FloatArray) -> float:
        """Return the mean of `errors`."""
        return float(np.mean(self.errors(residuals)))

    def left(self, fit: Fit) -> float:
        """Return the error beyond the noise that a fit leaves, over that of the noise."""
        return self.error(fit.residuals) / self.floor - 1.0

    def train_error(self, residuals: FloatArray) -> float:
        """Return the mean squared error of the other pieces."""
        return float(np.mean(residuals[self.is_train] ** 2))

    def share(self, residuals: FloatArray) -> float:
        """Return the share of the error beyond the noise that is gone."""
        beyond = max(self.error(self.before) - self.floor, 1e-9)
        return 1.0 - (self.error(residuals) - self.floor) / beyond


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted cause.

    Attributes:
        cause, group: What was fitted.
        numbers: Result, shape [p]; empty for an alternative.
        setup: The changed setup.
        residuals: Of all pieces.
        share: Share of the error that it explains.
        potential: Share that the linear model promises before least squares.
        slopes: Linear model of the training residuals.
        low, high: 95 % interval of the numbers, where one was computed.
    """

    cause: Cause
    group: Group
    numbers: FloatArray
    setup: Setup
    residuals: FloatArray
    share: float
    potential: float = -np.inf
    slopes: FloatArray | None = None
    low: FloatArray | None = None
    high: FloatArray | None = None

    @property
    def score(self) -> float:
        """Share, or what the linear model promises, less what the numbers cost."""
        return max(self.share, self.potential) - PARAMETER_COST * len(self.numbers)

    def changed(self, base: Setup, numbers: FloatArray | None = None) -> Setup:
        """Return another setup with this change."""
        for label, change in self.cause.alternatives:
            if label == self.group.label:
                return change(base)
        moved = self.numbers if numbers is None else numbers
        return self.cause.changed(
            base, self.cause.numbers(self.group.directions, moved)
        )

    def values(self, numbers: FloatArray) -> FloatArray:
        """Return the values of the cause for numbers of shape [p]."""
        return self.cause.values(self.cause.numbers(self.group.directions, numbers))


def _fit_at(problem: Problem, fit: Fit, base: Setup, numbers: FloatArray) -> Fit:
    """Return a fit at given numbers, on top of a setup."""
    setup = fit.changed(base, numbers)
    residuals = problem.residuals(setup)
    share = problem.share(residuals)
    return replace(
        fit,
        numbers=numbers,
        setup=setup,
        residuals=residuals,
        share=share,
        potential=-np.inf,
    )


def _bounds(fit: Fit) -> tuple[FloatArray, FloatArray]:
    """Return bounds of the numbers of a fit: those of the values that each moves."""
    moved = [column != 0.0 for column in fit.group.directions.T]
    low = [fit.cause.lower[each].max() for each in moved]
    high = [fit.cause.upper[each].min() for each in moved]
    return np.array(low), np.array(high)


def _trials(problem: Problem, cause: Cause, base: Setup) -> list[Fit]:
    """Return fits of a cause before least squares, the most promising ones first."""
    before = problem.residuals(base)
    blanks = [
        Fit(cause, group, np.zeros(0), base, before, 0.0) for group in cause.groups
    ]
    trials = []
    for label, _ in cause.alternatives:
        group = Group(label, np.zeros((0, 0)))
        blank = Fit(cause, group, np.zeros(0), base, before, 0.0)
        trials.append(_fit_at(problem, blank, base, np.zeros(0)))
    if not cause.starts:
        return trials + _linear_trials(problem, cause, blanks, base)
    for blank in blanks:
        starts = [np.clip([start], *_bounds(blank)) for start in cause.starts]
        trials.append(_best_of(problem, blank, base, starts))
    trials.sort(key=lambda fit: -fit.score)
    return trials[:MAX_GROUPS]


def _best_of(
    problem: Problem, blank: Fit, base: Setup, starts: Sequence[FloatArray]
) -> Fit:
    """Return the start with the smallest error of the training pieces."""
    tried = [_fit_at(problem, blank, base, numbers) for numbers in starts]
    return min(tried, key=lambda fit: problem.train_error(fit.residuals))


def _linear_trials(
    problem: Problem, cause: Cause, blanks: Sequence[Fit], base: Setup
) -> list[Fit]:
    """Return the groups that the linear model of the residuals prefers, after a full or a short step."""
    if not blanks:
        return []
    before = blanks[0].residuals
    columns = []
    for numbers in cause.present + PROBE * np.eye(len(cause.parameters)):
        columns.append(
            (problem.residuals(cause.changed(base, numbers)) - before) / PROBE
        )
    slopes = np.stack(columns, axis=-1)
    promised = []
    for blank in blanks:
        jacobian = slopes @ blank.group.directions
        train = jacobian[problem.is_train].reshape(-1, jacobian.shape[-1])
        target = -before[problem.is_train].ravel()
        numbers = lsq_linear(train, target, bounds=_bounds(blank)).x
        potential = problem.share(before + jacobian @ numbers)
        promised.append(
            replace(blank, numbers=numbers, potential=potential, slopes=train)
        )
    promised.sort(key=lambda fit: -fit.score)
    trials = []
    for fit in promised[:MAX_GROUPS]:
        best = _best_of(problem, fit, base, [fit.numbers, 0.4 * fit.numbers])
        trials.append(replace(best, potential=fit.potential))
    return trials


def _applied(setup: Setup, fits: Iterable[Fit]) -> Setup:
    """Return a setup with several changes."""
    for fit in fits:
        setup = fit.changed(setup)
    return setup


def _refined(
    problem: Problem, fits: Sequence[Fit], base: Setup, calls: int
) -> list[Fit]:
    """Return fits after least squares of all their numbers together; each has setup and share of all.

    A single fit of many numbers keeps the Jacobian of its start until the last round.
    """
    ends = np.cumsum([len(fit.numbers) for fit in fits])
    low, high = (np.concatenate(each) for each in zip(*map(_bounds, fits), strict=True))
    start = np.concatenate([fit.numbers for fit in fits])
    inside = np.clip(start, low + 1e-9, high - 1e-9)
    is_large = len(start) > 3

    def moved(numbers: FloatArray) -> list[Fit]:
        parts = np.split(numbers, ends[:-1])
        return [
            replace(fit, numbers=part) for fit, part in zip(fits, parts, strict=True)
        ]

    def train(numbers: FloatArray) -> FloatArray:
        return problem.residuals(_applied(base, moved(numbers)))[
            problem.is_train
        ].ravel()

    tried = [start]
    if len(start):
        solution = least_squares(
            train,
            inside,
            jac=(lambda _: fits[0].slopes)
            if is_large and calls < MAX_CALLS
            else "2-point",
            bounds=(low, high),
            diff_step=1e-2,
            x_scale=np.maximum(np.abs(inside), 0.05),
            ftol=1e-3,
            xtol=1e-4,
            max_nfev=MAX_LARGE_CALLS if is_large else calls,
        )
        tried.append(solution.x)
    best = moved(min(tried, key=lambda numbers: float(np.sum(train(numbers) ** 2))))
    setup = _applied(base, best)
    residuals = problem.residuals(setup)
    share = problem.share(residuals)
    return [
        replace(fit, setup=setup, residuals=residuals, share=share, potential=-np.inf)
        for fit in best
    ]


def best_fits(
    problem: Problem,
    causes: Sequence[Cause],
    base: Setup,
    advance: Callable[[str], None] = lambda _: None,
) -> list[Fit]:
    """Return the best fit of each cause on top of a setup, the best first."""
    fits = []
    for cause in causes:
        fits += _trials(problem, cause, base)
        advance(cause.name)
    for count, calls in ROUNDS:
        fits.sort(key=lambda fit: -fit.score)
        fits = [
            _refined(problem, [fit], base, calls)[0] for fit in fits[:count]
        ] + fits[count:]
    fits = [replace(fit, potential=-np.inf) for fit in fits]
    best: dict[str, Fit] = {}
    for fit in sorted(fits, key=lambda fit: -fit.score):
        best.setdefault(fit.cause.name, fit)
    return list(best.values())


def _with_intervals(problem: Problem, fits: Sequence[Fit]) -> tuple[Fit, ...]:
    """Return fits that hold together, with 95 % intervals of their numbers.

    The sandwich A^-1 B A^-1 sums the gradients by pieces, so that correlated residuals and the spread over the pieces
    both widen it.
    """
    after = problem.residuals(_applied(problem.setup, fits))
    columns = []
    for place, fit in enumerate(fits):
        for step in np.diag(1e-2 * np.maximum(np.abs(fit.numbers), 0.05)):
            moved = replace(fit, numbers=fit.numbers + step)
            setup = _applied(problem.setup, [*fits[:place], moved, *fits[place + 1 :]])
            columns.append((problem.residuals(setup) - after) / step.sum())
    if not columns:
        return tuple(fits)
    slopes = np.stack(columns, axis=-1)
    inverse = np.linalg.pinv(np.einsum("pri,prj->ij", slopes, slopes))
    gradients = np.einsum("pri,pr->pi", slopes, after)
    freedom = max(len(after) - len(columns), 1)
    spread = inverse @ gradients.T @ gradients @ inverse * len(after) / freedom
    # The noise alone gives the narrowest interval.
    variance = np.maximum(np.diag(spread), np.abs(np.diag(inverse)))
    half = student.ppf(0.975, freedom) * np.sqrt(variance)
    ends = np.cumsum([len(fit.numbers) for fit in fits])
    return tuple(
        replace(fit, low=fit.numbers - part, high=fit.numbers + part)
        for fit, part in zip(fits, np.split(half, ends[:-1]), strict=True)
    )


@dataclass(frozen=True)
class Explanation:
    """What explains a log.

    Attributes:
        problem: The residuals.
        fits: Best fit of each cause, the best first; none if the model predicts the log within its noise.
        alike: Fits that the log cannot tell from the first.
        several: Two to four fits that hold together, the last on top of the others; empty where one is enough.
    """

    problem: Problem
    fits: tuple[Fit, ...] = ()
    alike: tuple[Fit, ...] = ()
    several: tuple[Fit, ...] = ()

    @property
    def has_cause(self) -> bool:
        """Whether one cause explains the difference: to the noise, or far better than any other one."""
        if not self.fits or self.fits[0].share < EXPLAINS or self.has_several:
            return False
        left = 1.0 - self.fits[0].share
        leads = all(1.0 - fit.share > LEADS * left for fit in self.fits[1:])
        return leads or self.problem.left(self.fits[0]) < MAX_LEFT

    @property
    def has_several(self) -> bool:
        """Whether several causes explain the difference, and far better than one."""
        if not self.several or self.several[-1].share < EXPLAINS:
            return False
        left = self.problem.left(self.several[-1])
        return left < min(MAX_LEFT, BETTER * self.problem.left(self.fits[0]))


def _are_alike(problem: Problem, best: Fit, other: Fit) -> bool:
    """Say whether the pieces that no fit has seen cannot tell two fits apart (signed ranks, 5 %)."""
    gap = problem.errors(other.residuals) - problem.errors(best.residuals)
    if other.share < 0.5 * best.share:
        return False
    scale = 1e-3 * (problem.error(problem.before) - problem.floor)
    return bool(
        np.abs(gap).max() < scale or wilcoxon(gap, alternative="greater").pvalue > 0.05
    )


def _grown(
    problem: Problem, causes: Sequence[Cause], fits: Sequence[Fit], pool: Sequence[Fit]
) -> list[Fit]:
    """Return fits with the best further cause, after all were fitted together.

    A cause that explains little on top of the others may still explain much with them, so the best ones alone, `pool`,
    are tried too.
    """
    names = {fit.cause.name for fit in fits}
    others = [cause for cause in causes if cause.name not in names]
    further = best_fits(problem, others, _applied(problem.setup, fits))[:MAX_FURTHER]
    for fit in pool:
        if fit.cause.name not in names:
            shorter = fit.numbers if fit.cause.starts else 0.3 * fit.numbers
            further.append(replace(fit, numbers=shorter))
    tried = [
        _refined(problem, [*fits, each], problem.setup, MAX_CALLS) for each in further
    ]
    return max(tried, key=lambda each: each[-1].share)


def explain(
    problem: Problem,
    causes: Sequence[Cause],
    advance: Callable[[str], None] = lambda _: None,
) -> Explanation:
    """Return what explains the deviation of a log from the model: each cause alone, then several."""
    if problem.error(problem.before) < WITHIN_NOISE * problem.floor:
        return Explanation(problem)
    fits = best_fits(problem, causes, problem.setup, advance)
    fits[:1] = _with_intervals(problem, fits[:1])
    alike = tuple(fit for fit in fits[1:] if _are_alike(problem, fits[0], fit))
    result = Explanation(problem, tuple(fits), alike)
    if problem.left(fits[0]) < NEAR:
        return result
    several: list[Fit] = []
    pool = fits[:MAX_POOL]
    bases = [fits[0], *(fit for fit in fits[1:] if fit not in alike)]
    for base in bases[:MAX_BASES]:
        advance(f"with {base.cause.name}")
        pair = _grown(problem, causes, [base], pool)
        several = max(
            several, pair, key=lambda each: each[-1].share if each else -np.inf
        )
        if problem.left(several[-1]) < NEAR:
            break
    while (
        len(several) < MAX_SEVERAL
        and several[-1].share > 0.5
        and problem.left(several[-1]) > NEAR
    ):
        more = _grown(problem, causes, several, pool)
        if problem.left(more[-1]) > BETTER * problem.left(several[-1]):
            break
        several = more
    return replace(result, several=_with_intervals(problem, several))
