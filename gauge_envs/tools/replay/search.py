"""Search for the causes that explain a log: each alone, then pairs, judged on pieces that no fit has seen."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.stats import wilcoxon

from gauge_envs.tools.replay.causes import Cause, ParameterGroup, groups_of
from gauge_envs.tools.replay.fit import THRESHOLDS, Fit, Problem, fit_values
from gauge_envs.tools.replay.log import FloatArray
from gauge_envs.tools.replay.schema import ReplayVerdict

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

    grid = np.sort(cause.starts or (0.0, THRESHOLDS.slope_step))
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
    few = _few_by_cause(problem, screened, THRESHOLDS.max_groups)
    for fit in few[: THRESHOLDS.max_refined]:
        if fit.linear_error < limit and len(fit.numbers):
            fits.append(problem.minimize(fit, measure=False))
        else:
            fits.append(problem.predict(fit))
        if problem.excess(fits[-1]) < THRESHOLDS.near_noise:
            limit = min(limit, THRESHOLDS.max_worse * fit.linear_error)
    leading = _few_by_cause(problem, fits)[: THRESHOLDS.max_polished]
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
    small = THRESHOLDS.equal_gap * (problem.before.error - problem.floor)
    names = [best.label]
    for fit in others:
        gap = np.mean(fit.held_out**2 - best.held_out**2, axis=1)
        if problem.share(fit) <= THRESHOLDS.min_share_of_equal * problem.share(best):
            continue
        is_equal = np.abs(gap).max() < small
        is_equal |= (
            wilcoxon(gap, alternative="greater").pvalue > THRESHOLDS.significance
        )
        if is_equal:
            names.append(fit.label)
    return names


def _second_causes(problem: Problem, screened: Sequence[Fit]) -> list[Cause]:
    """Return the causes that alone decrease the error, and the losses."""
    present = np.mean(problem.before.training[problem.screening] ** 2)
    limit = (1.0 - THRESHOLDS.min_second) * present
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
    for base in bases[: THRESHOLDS.max_bases]:
        pairs += best_fits(problem, screen(problem, base, causes))
        best = min(pairs, key=problem.cost)
        if problem.excess(best) < THRESHOLDS.near_noise:
            return pairs
        if problem.share(best) < THRESHOLDS.min_hope:
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
    if problem.excess(best) < THRESHOLDS.max_excess_of_several:
        return best
    for fit in fits:
        near = problem.excess(fit) < THRESHOLDS.about_as_good * problem.excess(best)
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
    far_less = THRESHOLDS.max_ratio_of_several * excess
    if several and problem.excess(several) < far_less and _is_claim(problem, several):
        is_near = problem.excess(several) < THRESHOLDS.max_excess_of_several
        if is_near or _is_drive(several):
            return ReplayVerdict.SEVERAL, several
    leads = all(problem.excess(fit) > THRESHOLDS.min_lead * excess for fit in others)
    if _is_claim(problem, best) and (leads or excess < THRESHOLDS.max_excess):
        return ReplayVerdict.CAUSE, best
    change = best
    if several and (_is_drive(several) or problem.excess(several) < far_less):
        change = several
    if problem.share(change) > THRESHOLDS.min_part:
        return ReplayVerdict.PART, change
    return ReplayVerdict.NOTHING, several or best


def _is_claim(problem: Problem, fit: Fit) -> bool:
    """Return whether a fit leaves so little of the error that its causes may be said to explain it."""
    is_near = problem.excess(fit) < THRESHOLDS.near_noise
    least = THRESHOLDS.min_share if is_near else THRESHOLDS.min_claim
    return problem.share(fit) > least


def _is_drive(fit: Fit) -> bool:
    """Return whether a fit has only what every drive has."""
    return {*fit.names} <= LOSSES


def _predicts(problem: Problem) -> bool:
    """Return whether the model predicts the log within its noise, and better than constant velocity and no motion."""
    if problem.before.error >= THRESHOLDS.max_noise_error * problem.floor:
        return False
    misfit = problem.replayer.misfit(problem.setup, problem.pieces)
    return bool(misfit.max() < THRESHOLDS.max_misfit)


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
    limit = THRESHOLDS.near_noise
    if judge.share(alone[0]) > THRESHOLDS.enough_share and judge is problem:
        limit = THRESHOLDS.max_excess_of_several
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
