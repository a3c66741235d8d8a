"""The cause that the results of all checks together suggest.

`causes.json` has rules in the order of mechanics: the calls of the contract, gravity, contacts that are missing, free
motion, wrenches, hinges, restart, worlds, driven bodies, heights, friction, impacts. What fails first explains what
depends on it. A rule has

- `fails`: checks that fail, with `<` or `>` where they must measure too little or too much, or less or more than a
  number;
- `passes`: checks that do not fail;
- `equal`: checks whose errors are one factor;
- `cause`: the cause; without it, the diagnosis of its check is the cause;
- `explains`: patterns of checks that also fail by this cause; all checks if there are none.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

import numpy as np

from gauge_envs.tools.conformance.model import CheckResult, Status

ONE_FACTOR = 0.03
"""Largest difference of errors that are one factor, over the largest of them."""

FAILURE = re.compile(r"([\w.-]+?)(?:([<>])([\d.]*))?")
"""Check, sign of its error, and a bound of its value."""

Rule = Mapping[str, str]
Results = Mapping[str, CheckResult]


@cache
def rules() -> list[Rule]:
    """Return the rules, from the contract to impacts."""
    rows: list[Rule] = json.loads(Path(__file__).with_suffix(".json").read_text())
    return rows


def likely_causes(results: Sequence[CheckResult]) -> list[str]:
    """Return the causes of failures, each with checks that fail and pass by it; the most basic one first.

    A failure that an earlier rule explains has no other cause. A rule without a cause counts only as the first.
    """
    ran = {result.check: result for result in results}
    left = {name for name, result in ran.items() if result.is_bad}
    texts: list[str] = []
    for rule in rules():
        failed, *_ = _names(rule["fails"])
        if failed not in left or not _matches(rule, ran):
            continue
        if "cause" in rule or not texts:
            texts.append(_text(rule, ran))
        globs = rule.get("explains", "*").split()
        left -= {name for name in left for glob in globs if fnmatchcase(name, glob)}
    return texts


def _names(checks: str) -> list[str]:
    """Return the ids of checks, without signs."""
    return [FAILURE.fullmatch(check)[1] for check in checks.split()]  # type: ignore[index]


def _matches(rule: Rule, ran: Results) -> bool:
    passes = _names(rule.get("passes", ""))
    return (
        all(_fails(ran, check) for check in rule["fails"].split())
        and all(name in ran and not ran[name].is_bad for name in passes)
        and _has_one_factor([ran[name] for name in _names(rule.get("equal", ""))])
    )


def _fails(ran: Results, check: str) -> bool:
    """Return whether a check fails, with a sign of its error or beyond a bound."""
    name, sign, bound = FAILURE.fullmatch(check).groups()  # type: ignore[union-attr]
    result = ran.get(name)
    if result is None or not result.is_bad or not sign:
        return result is not None and result.is_bad
    limit = float(bound) if bound else result.expected
    if result.measured is None or limit is None:
        return False
    return result.measured < limit if sign == "<" else result.measured > limit


def _has_one_factor(results: Sequence[CheckResult]) -> bool:
    """Return whether the errors of failed checks are one factor."""
    shares = [(each.measured or 0.0) / (each.expected or 1.0) for each in results]
    return not shares or bool(np.ptp(shares) < ONE_FACTOR * np.abs(shares).max())


def _text(rule: Rule, ran: Results) -> str:
    """Return a cause with the checks that fail and pass by it, or the diagnosis of its check."""
    failed = _names(rule["fails"])
    if "cause" not in rule:
        result = ran[failed[0]]
        return f"{result.of.title}: {result.diagnosis} ({result.check} fails)"
    proof = f"fails: {', '.join(failed)}"
    right = [n for n in _names(rule.get("passes", "")) if ran[n].status is Status.PASS]
    proof += f"; passes: {', '.join(right)}" if right else ""
    return f"{rule['cause']} ({proof})"
