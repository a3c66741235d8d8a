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

NEAR = 0.6
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


@cache
def _table() -> tuple[Mapping[str, Sequence[Signs]], Mapping[str, float]]:
    """Return the signs of planted faults by cause, and the share of released engines that fail each check."""
    table = json.loads(Path(__file__).with_suffix(".json").read_text())
    return table["faults"], table["released"]


def likely_causes(results: Sequence[CheckResult]) -> list[str]:
    """Return the causes that explain several results, each with checks that fail and pass by it."""
    ran = {r.check: r for r in results if r.status is not Status.UNSUPPORTED}
    left = {name: sign_of(result) for name, result in ran.items() if result.is_bad}
    texts: list[str] = []
    while True:
        fits = sorted(_fits(left, ran.keys()), reverse=True)
        if not fits or fits[0].agreement < NEAR:
            return texts
        best = [fit for fit in fits if fit.agreement > fits[0].agreement - ALIKE]
        passed = [name for fit in fits for name in sorted(fit.fails & ran.keys())]
        right = [name for name in dict.fromkeys(passed) if not ran[name].is_bad]
        texts.append(_text(best, sorted(best[0].fails & left.keys()), right))
        for name in frozenset().union(*(fit.fails for fit in best)):
            left.pop(name, None)


def sign_of(result: CheckResult) -> str:
    """Return the sign of the error of a check."""
    if result.measured is None or result.expected is None:
        return "!"
    return "<" if result.measured < result.expected else ">"


def _fits(signs: Signs, ran: Iterable[str]) -> Iterable[_Fit]:
    """Yield the agreement with planted faults of which two checks fail.

    It is the weight of equal failures over that of all that the fault has and half of that of the others.
    """
    faults, _ = _table()
    for cause, members in faults.items():
        for member in members:
            expected = {name: member[name] for name in member.keys() & ran}
            equal = {name for name, sign in expected.items() if signs.get(name) == sign}
            if len(equal) > 1 and _weight(equal) > LEAST:
                others = _weight(signs.keys() - expected.keys())
                agreement = _weight(equal) / (_weight(expected) + 0.5 * others)
                yield _Fit(agreement, cause, frozenset(expected))


def _weight(checks: Iterable[str]) -> float:
    """Return the weight of failures."""
    _, released = _table()
    return -sum(log(released.get(name, RARE)) for name in checks)


def _text(best: Sequence[_Fit], failed: Sequence[str], passed: Sequence[str]) -> str:
    """Return causes that fit alike, with checks that fail, and those that pass against the next causes."""
    causes = [*dict.fromkeys(fit.cause for fit in best)][:3]
    text = "; or ".join(causes)
    if len(causes) > 1:
        text = f"several causes fit: {text}"
    proof = f"fails: {', '.join(failed[:6])}"
    proof += f"; passes: {', '.join(passed[:3])}" if passed else ""
    return f"{text} ({proof})"
