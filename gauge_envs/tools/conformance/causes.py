"""The cause that the results of all checks together suggest.

`causes.json` has rules in the order of mechanics: gravity, the calls of the contract, contacts that are missing, free
motion, wrenches, hinges, restart, worlds, driven bodies, heights, friction, impacts. What fails first explains what
depends on it. A check that the time limit ended shows nothing. A rule has

- `fails`: checks that fail, with `<` or `>` where they must measure too little or too much, or less or more than a
  number; `?` where this counts only if the check measured something;
- `passes`: checks that do not fail, or not in that way;
- `lacks`: checks that measured nothing;
- `equal`: checks whose errors have one size, or at least two of them;
- `cause`: the cause; without it, the diagnosis of its check is the cause;
- `explains`: patterns of checks that also fail by this cause, or the name of a group of them; by default all checks.
"""

import json
import re
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

import numpy as np

from gauge_envs.tools.conformance.model import CheckResult, Status

ONE_FACTOR = 0.03
"""Largest difference of errors that have one size, over the largest ratio to what is expected."""

FAILURE = re.compile(r"([\w.-]+?)(?:([<>])([\d.]*))?(\??)(?:\s+|$)")
"""Check, sign of its error, a bound of its value, and whether it may have measured nothing."""

Rule = Mapping[str, str]
Results = Mapping[str, CheckResult]


@cache
def rules() -> list[Rule]:
    """Return the rules, from gravity to impacts."""
    document = json.loads(Path(__file__).with_suffix(".json").read_text())
    groups = document["groups"]
    return [
        {**rule, "explains": groups.get(globs, globs)}
        for rule in document["rules"]
        for globs in [rule.get("explains", "*")]
    ]


def likely_causes(results: Sequence[CheckResult]) -> list[str]:
    """Return the causes of failures, each with checks that fail and pass by it; the most basic one first.

    A failure that an earlier rule explains has no other cause. A rule without a cause counts only as the first.
    """
    ran = {each.check: each for each in results if not each.is_unfinished}
    left = {name for name, result in ran.items() if result.is_bad}
    texts: list[str] = []
    for rule in rules():
        failed, *_ = _names(rule["fails"])
        if failed not in left or not _matches(rule, ran):
            continue
        if "cause" in rule or not texts:
            texts.append(_text(rule, ran))
        globs = rule["explains"].split()
        left -= {name for name in left for glob in globs if fnmatchcase(name, glob)}
    return texts


def _names(checks: str) -> list[str]:
    """Return the ids of checks, without signs."""
    return [name for name, *_ in FAILURE.findall(checks)]


def _matches(rule: Rule, ran: Results) -> bool:
    passes = rule.get("passes", "")
    equal = _names(rule.get("equal", ""))
    return (
        all(_fails(ran, *failure) for failure in FAILURE.findall(rule["fails"]))
        and all(name in ran for name in _names(passes))
        and not any(_fails(ran, *failure) for failure in FAILURE.findall(passes))
        and not any(_is_measured(ran, name) for name in _names(rule.get("lacks", "")))
        and (
            not equal or _has_one_size([ran[n] for n in equal if _is_measured(ran, n)])
        )
    )


def _is_measured(ran: Results, name: str) -> bool:
    return name in ran and ran[name].measured is not None


def _fails(ran: Results, name: str, sign: str, bound: str, optional: str) -> bool:
    """Return whether a check fails, with a sign of its error or beyond a bound."""
    if optional and not _is_measured(ran, name):
        return True
    result = ran.get(name)
    if result is None or not result.is_bad or not sign:
        return result is not None and result.is_bad
    limit = float(bound) if bound else result.expected
    if result.measured is None or limit is None:
        return False
    return result.measured < limit if sign == "<" else result.measured > limit


def _has_one_size(results: Sequence[CheckResult]) -> bool:
    """Return whether the relative errors of two or more checks have one size."""
    if len(results) < 2:
        return False
    measured, expected = np.array(
        [(each.measured, each.expected) for each in results], float
    ).T
    scales = np.where(expected, expected, 1.0)
    errors = np.abs(measured - expected) / scales
    return bool(np.ptp(errors) < ONE_FACTOR * np.abs(measured / scales).max())


def _text(rule: Rule, ran: Results) -> str:
    """Return a cause with the checks that fail and pass by it, or the diagnosis of its check."""
    failed = _names(rule["fails"])
    if "cause" not in rule:
        result = ran[failed[0]]
        return f"{result.of.title}: {result.diagnosis} ({result.check} fails)"
    proof = f"fails: {', '.join(name for name in failed if name in ran)}"
    right = [n for n in _names(rule.get("passes", "")) if ran[n].status is Status.PASS]
    proof += f"; passes: {', '.join(right)}" if right else ""
    return f"{rule['cause']} ({proof})"
