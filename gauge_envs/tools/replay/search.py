"""Search for the causes that explain a log: each alone, then pairs, judged on pieces that no fit has seen."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.stats import wilcoxon

from gauge_envs.tools.replay.causes import Cause, ParameterGroup, groups_of
from gauge_envs.tools.replay.fit import (
    MAX_EXCESS_OF_SEVERAL,
    MAX_POLISHED,
    MIN_HOPE,
    NEAR_NOISE,
    SLOPE_STEP,
    Fit,
    Problem,
    fit_values,
)
from gauge_envs.tools.replay.log import FloatArray
from gauge_envs.tools.replay.schema import ReplayVerdict

MAX_NOISE_ERROR = 1.3
"""Error below which nothing is left to explain."""
MAX_MISFIT = 0.4
"""Logarithm of the error over that of constant velocity or no motion, below which a model is no worse."""
MIN_SHARE = 0.9
"""Smallest share of the excess that a named cause explains, near the noise."""
MIN_CLAIM = 0.995
"""The same farther from the noise: a cause outside of the list often looks like one of it by 98 %."""
MIN_PART = 0.85
"""Smallest share of a cause that is named in part."""
ABOUT_AS_GOOD = 1.5
"""Excess of losses and armature over the smallest one, up to which they are preferred."""
MAX_EXCESS = 8.0
"""Largest excess of a named cause, unless it leads."""
MIN_LEAD = 5.0
"""Excess of every other cause over that of a cause that leads."""
MAX_RATIO_OF_SEVERAL = 0.4
"""Largest excess of several causes that are named, over that of the best single cause."""
ENOUGH_SHARE = 0.99
"""Share of one cause above which a second one is fitted only above `MAX_EXCESS_OF_SEVERAL`."""
EQUAL_GAP = 1e-3
"""Difference of errors over the excess of the model, up to which causes are equal in each piece."""
MIN_SHARE_OF_EQUAL = 0.5
"""Smallest share of a cause that the log cannot tell from the best one, over that of this one."""
SIGNIFICANCE = 0.05
"""Probability of a signed-rank test below which a cause is worse than the best one."""
MAX_GROUPS = 3
"""Number of groups of each cause that are fitted."""
MAX_REFINED = 10
"""Number of fits of one cause, and of two, that are refined."""
MAX_WORSE = 4.0
"""Largest linear error of a fit that is refined, over that of a fit that reached the noise."""
MAX_BASES = 2
"""Number of fits of one cause to which a second one is added."""
MIN_SECOND = 0.02
"""Relative decrease of the error that a cause must bring alone to be fitted as a second one."""
LOSSES = {"armature", "dry friction", "damping"}
"""What every drive has, and a published model often lacks."""


def try_cause(problem: Problem, cause: Cause, base: Fit) -> list[Fit]:
    """Return fits of a base and each group of a further cause, one for each start, with their residuals.

    A cause without starts begins at the present values. The changes of single values are added, as for linear
    residuals.
    """
    screened = base.training[problem.screening]

    def extended(group: ParameterGroup, number: float) -> Fit:
        numbers = np.append(base.numbers, np.full(group.size, number))
        return Fit(terms=(*base.terms, (cause, group)), numbers=numbers)

    def change(group: ParameterGroup, number: float) -> FloatArray:
        return problem.residuals(extended(group, number), 2) - screened

    grid = np.sort(cause.starts or (0.0, SLOPE_STEP))
    singles = groups_of(len(cause.parameters))
    moved = np.zeros((len(grid), *screened.shape, len(singles)))
    for row in np.flatnonzero(grid).tolist():
        for column, group in enumerate(singles):
            moved[row, ..., column] = change(group, grid[row])
    slopes, reach = np.gradient(moved, grid, axis=0), np.gradient(grid)
    if not cause.starts:
        grid, reach = np.zeros(1), np.full(1, np.inf)
    fits = []
    for row, group in product(range(len(grid)), cause.groups or singles):
        total = moved[row] @ group.selection.sum(axis=1)
        if not cause.parameters:
            total = change(group, 0.0)
        fit = replace(
            extended(group, grid[row]),
            training=screened + total,
            slopes=np.concatenate(
                [base.slopes, slopes[row] @ group.selection], axis=-1
            ),
            reach=np.append(base.reach, np.full(group.size, reach[row])),
        )
        fits.append(fit)
    return fits


def screen(
    problem: Problem,
    base: Fit,
    causes: Sequence[Cause],
    advance: Callable[[str], None] = lambda _: None,
) -> list[Fit]:
    """Return the linear fits of further causes on top of a base."""
    fits: list[Fit] = []
    for cause in causes:
        advance(cause.name)
        if cause.name not in base.names:
            fits += [fit.linearize() for fit in try_cause(problem, cause, base)]
    return fits


def best_fits(problem: Problem, screened: Sequence[Fit]) -> list[Fit]:
    """Return the best fit of each set of causes, the best first.

    A few fits are refined, and after one that reaches the noise only those that come near to it.
    """
    limit = np.inf
    fits: list[Fit] = []
    few = _few_by_cause(problem, screened, MAX_GROUPS)
    for fit in few[:MAX_REFINED]:
        if fit.linear_error < limit and len(fit.numbers):
            fits.append(problem.minimize(fit, measure=False))
        else:
            fits.append(problem.predict(fit))
        if problem.excess(fits[-1]) < NEAR_NOISE:
            limit = min(limit, MAX_WORSE * fit.linear_error)
    leading = _few_by_cause(problem, fits)[:MAX_POLISHED]
    for fit in leading:
        if len(fit.numbers):
            fits.append(problem.minimize(fit, measure=True))
    return sorted(fits, key=problem.cost)


def _few_by_cause(problem: Problem, fits: Sequence[Fit], count: int = 1) -> list[Fit]:
    """Return at most `count` fits of each set of causes, one a group, sorted by cost."""
    few: list[Fit] = []
    labels_by_causes: dict[frozenset[str], set[tuple[str, ...]]] = defaultdict(set)
    for fit in sorted(fits, key=problem.cost):
        chosen = labels_by_causes[frozenset(fit.names)]
        labels = tuple(group.label for _, group in fit.terms)
        if len(chosen) < count and labels not in chosen:
            chosen.add(labels)
            few.append(fit)
    return few


@dataclass(frozen=True)
class Explanation:
    """What explains a log.

    Attributes:
        problem: The log, in pieces as long as the best fit predicts them.
        verdict: What explains the difference.
        change: The fit that the verdict is about; None if the model predicts the log.
        fits: Best fit of each cause, the best first; none if the model predicts the log within its noise.
        indistinguishable: Names of the causes that the log cannot tell from the first.
        several: Causes that are fitted together; None where one is enough.
    """

    problem: Problem
    verdict: ReplayVerdict = ReplayVerdict.NOISE
    change: Fit | None = None
    fits: Sequence[Fit] = ()
    indistinguishable: Sequence[str] = ()
    several: Fit | None = None


def _find_equal(problem: Problem, fits: Sequence[Fit]) -> list[str]:
    """Return the first cause, and those that the held-out pieces cannot tell from it (signed ranks, 5 %)."""
    best, *others = fits
    small = EQUAL_GAP * (problem.before.error - problem.floor)
    names = [best.label]
    for fit in others:
        gap = np.mean(fit.held_out**2 - best.held_out**2, axis=1)
        if problem.share(fit) <= MIN_SHARE_OF_EQUAL * problem.share(best):
            continue
        is_equal = np.abs(gap).max() < small
        is_equal |= wilcoxon(gap, alternative="greater").pvalue > SIGNIFICANCE
        if is_equal:
            names.append(fit.label)
    return names


def _second_causes(problem: Problem, screened: Sequence[Fit]) -> list[Cause]:
    """Return the causes that alone decrease the error, and the losses."""
    present = np.mean(problem.before.training[problem.screening] ** 2)
    limit = (1.0 - MIN_SECOND) * present
    useful = [
        fit.terms[0][0]
        for fit in screened
        if fit.linear_error < limit or _is_drive(fit)
    ]
    return list({id(cause): cause for cause in useful}.values())


def _fit_pairs(
    problem: Problem, bases: Sequence[Fit], causes: Sequence[Cause]
) -> list[Fit]:
    """Return fits of two causes: the best single ones with any other, then the last one of the best pair with any."""
    pairs: list[Fit] = []
    for base in bases[:MAX_BASES]:
        pairs += best_fits(problem, screen(problem, base, causes))
        best = min(pairs, key=problem.cost)
        if problem.excess(best) < NEAR_NOISE:
            return pairs
        if problem.share(best) < MIN_HOPE:
            break
    *_, count = (group.size for _, group in best.terms)
    first = len(best.numbers) - count
    second = replace(
        best,
        terms=best.terms[1:],
        numbers=best.numbers[first:],
        slopes=best.slopes[..., first:],
        reach=best.reach[first:],
    )
    screened = screen(problem, problem.predict(second), causes)
    return pairs + best_fits(problem, screened)


def _prefer_losses(problem: Problem, fits: Sequence[Fit]) -> Fit:
    """Return the best fit, or the best one of losses and armature if none reaches the noise and it is about as good."""
    best = fits[0]
    if problem.excess(best) < MAX_EXCESS_OF_SEVERAL:
        return best
    for fit in fits:
        near = problem.excess(fit) < ABOUT_AS_GOOD * problem.excess(best)
        if near and _is_drive(fit):
            return fit
    return best


def _verdict(
    problem: Problem, fits: Sequence[Fit], several: Fit | None
) -> tuple[ReplayVerdict, Fit]:
    """Return what explains the difference, and its fit.

    Several causes are named if they explain it far better than one; one cause if it explains it to the noise, or far
    better than any other one. Other causes are named in part if they take most of the error.
    """
    best, *others = fits
    excess = problem.excess(best)
    far_less = MAX_RATIO_OF_SEVERAL * excess
    if several and problem.excess(several) < far_less and _is_claim(problem, several):
        is_near = problem.excess(several) < MAX_EXCESS_OF_SEVERAL
        if is_near or _is_drive(several):
            return ReplayVerdict.SEVERAL, several
    leads = all(problem.excess(fit) > MIN_LEAD * excess for fit in others)
    if _is_claim(problem, best) and (leads or excess < MAX_EXCESS):
        return ReplayVerdict.CAUSE, best
    change = best
    if several and (_is_drive(several) or problem.excess(several) < far_less):
        change = several
    if problem.share(change) > MIN_PART:
        return ReplayVerdict.PART, change
    return ReplayVerdict.NOTHING, several or best


def _is_claim(problem: Problem, fit: Fit) -> bool:
    """Return whether a fit leaves so little of the error that its causes may be said to explain it."""
    is_near = problem.excess(fit) < NEAR_NOISE
    least = MIN_SHARE if is_near else MIN_CLAIM
    return problem.share(fit) > least


def _is_drive(fit: Fit) -> bool:
    """Return whether a fit has only what every drive has."""
    return {*fit.names} <= LOSSES


def _predicts(problem: Problem) -> bool:
    """Return whether the model predicts the log within its noise, and better than constant velocity and no motion."""
    if problem.before.error >= MAX_NOISE_ERROR * problem.floor:
        return False
    misfit = problem.replayer.misfit(problem.setup, problem.pieces)
    return bool(misfit.max() < MAX_MISFIT)


def explain(
    problem: Problem, causes: Sequence[Cause], advance: Callable[[str], None]
) -> Explanation:
    """Return what explains the deviation of a log from the model: each cause alone, then several."""
    if _predicts(problem):
        return Explanation(problem)
    screened = screen(problem, problem.before, causes, advance)
    fits = best_fits(problem, screened)
    replayer, odd = problem.replayer, problem.odd_pieces(fits[0])
    if len(odd) and not len(replayer.left_out):
        replayer.leave_out(odd)
        clean = Problem(replayer, problem.setup, floor=problem.floor)
        return explain(clean, causes, advance)
    alone = _few_by_cause(problem, fits)
    names = _find_equal(problem, alone)
    bases = [*alone]
    judge, alone[0] = problem.lengthened(alone[0])
    alone = judge.judged(alone, names)
    names = judge.still_equal(alone, names)
    limit = NEAR_NOISE
    if judge.share(alone[0]) > ENOUGH_SHARE and judge is problem:
        limit = MAX_EXCESS_OF_SEVERAL
    several: Fit | None = None
    if judge.excess(alone[0]) > limit:
        advance("several together")
        together = _fit_pairs(problem, bases, _second_causes(problem, screened))
        together = _few_by_cause(problem, together)
        pairs = _find_equal(problem, together)
        judge, together[0] = problem.lengthened(together[0])
        together = judge.judged(together, pairs)
        alone = judge.judged(alone, [alone[0].label])
        several = _prefer_losses(judge, together)
    verdict, change = _verdict(judge, alone, several)
    if change is several:
        is_claim = verdict is ReplayVerdict.SEVERAL
        names = judge.still_equal(together, pairs) if is_claim else []
        names = [name for name in names if name != change.label]
    fitted = change
    if verdict is ReplayVerdict.NOTHING:
        names = []
    else:
        fitted = fit_values(change, [judge.for_values(change)])
    if change is several:
        several = fitted
    else:
        alone[0] = fitted
    return Explanation(judge, verdict, fitted, alone, names, several)
