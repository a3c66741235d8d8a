"""The cause that the results of all checks together suggest: the planted fault whose results are nearest.

`causes.json` has the checks that fail with each planted fault, with the signs of their errors, and the share of
released engines that fail a check. A failure weighs -log(share): what most engines fail says little of one.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from math import log
from pathlib import Path
from typing import NamedTuple

from gauge_envs.tools.conformance.model import CheckResult, Status

RARE = 0.02
"""Share of engines for a check that all released engines pass."""

NEAR = 0.7
"""Smallest agreement of a cause, of 1."""

LEAST = log(7.0)
"""Smallest weight of the failures that a cause explains: fewer happen to one engine in seven by chance."""

ALIKE = 0.1
"""Difference of agreement up to which causes fit alike."""

Signs = Mapping[str, str]
"""Failures by check: `<` or `>` where it measures too little or too much, `!` for an error."""


class _Fit(NamedTuple):
    """Agreement of failures with a cause, and the checks that fail with its nearest planted fault."""

    agreement: float
    cause: str
    fails: frozenset[str]


Table = tuple[Mapping[str, Sequence[Signs]], Mapping[str, float]]
"""Signs of planted faults by cause, and the share of released engines that fail each check."""


@cache
def _table() -> Table:
    table = json.loads(Path(__file__).with_suffix(".json").read_text())
    return table["faults"], table["released"]


def likely_causes(results: Sequence[CheckResult]) -> list[str]:
    """Return the causes that explain several results, each with checks that fail and pass by it."""
    ran = {r.check: r for r in results if r.status is not Status.UNSUPPORTED}
    left = {name: sign_of(result) for name, result in ran.items() if result.is_bad}
    texts: list[str] = []
    while best := nearest(fits := ranked(left, ran.keys(), _table())):
        passed = [name for fit in fits for name in sorted(fit.fails & ran.keys())]
        right = [name for name in dict.fromkeys(passed) if not ran[name].is_bad]
        texts.append(_text(best, sorted(best[0].fails & left.keys()), right))
        for name in frozenset().union(*(fit.fails for fit in best)):
            left.pop(name, None)
    return texts


def sign_of(result: CheckResult) -> str:
    """Return the sign of the error of a check."""
    if result.measured is None or result.expected is None:
        return "!"
    return "<" if result.measured < result.expected else ">"


def nearest(fits: Sequence[_Fit]) -> list[_Fit]:
    """Return the best of ranked fits and those that fit alike; none if the best is not near."""
    near = [fit for fit in fits if fit.agreement >= NEAR]
    return [fit for fit in near if fit.agreement > near[0].agreement - ALIKE]


def ranked(signs: Signs, ran: Iterable[str], table: Table) -> list[_Fit]:
    """Return the agreement with planted faults of which two checks fail, the best first.

    It is the weight of equal failures over that of all that the fault has and half of that of the others.
    """
    faults, shares = table
    fits = []

    def weight(checks: Iterable[str]) -> float:
        return -sum(log(shares.get(name, RARE)) for name in checks)

    for cause, members in faults.items():
        for member in members:
            expected = {name: member[name] for name in member.keys() & ran}
            equal = {name for name, sign in expected.items() if signs.get(name) == sign}
            if len(equal) > 1 and weight(equal) > LEAST:
                others = weight(signs.keys() - expected.keys())
                agreement = weight(equal) / (weight(expected) + 0.5 * others)
                fits.append(_Fit(agreement, cause, frozenset(expected)))
    return sorted(fits, reverse=True)


def _text(best: Sequence[_Fit], failed: Sequence[str], passed: Sequence[str]) -> str:
    """Return causes that fit alike, with checks that fail, and those that pass against the next causes."""
    causes = [*dict.fromkeys(fit.cause for fit in best)][:3]
    text = "; or ".join(causes)
    if len(causes) > 1:
        text = f"several causes fit: {text}"
    proof = f"fails: {', '.join(failed[:6])}"
    proof += f"; passes: {', '.join(passed[:3])}" if passed else ""
    return f"{text} ({proof})"
