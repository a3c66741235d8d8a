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
import operator
import re
from collections.abc import Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from gauge_envs.tools.conformance.model import CheckResult, Status

ONE_FACTOR = 0.03
"""Largest difference of errors that are one factor, over the largest of them."""

FAILURE = re.compile(r"([\w.-]+?)(?:([<>])([\d.]*))?")
"""Check, sign of its error, and a bound of its value."""

COMPARES = {"<": operator.lt, ">": operator.gt}

Rule = Mapping[str, Any]
Results = Mapping[str, CheckResult]


@cache
def rules() -> list[Rule]:
    """Return the rules, from the contract to impacts."""
    rows: list[Rule] = json.loads(Path(__file__).with_suffix(".json").read_text())
    return [
        {
            "cause": row.get("cause", ""),
            "fails": [
                FAILURE.fullmatch(part).groups() for part in row["fails"].split()
            ],  # type: ignore[union-attr]
            "passes": row.get("passes", "").split(),
            "equal": row.get("equal", "").split(),
            "explains": row.get("explains", "*").split(),
        }
        for row in rows
    ]


def likely_causes(results: Sequence[CheckResult]) -> list[str]:
    """Return the causes of failures, each with checks that fail and pass by it; the most basic one first."""
    return [_text(rule, results) for rule in matching_rules(results)]


def matching_rules(results: Sequence[CheckResult]) -> Iterator[Rule]:
    """Yield the rules that explain failures which no earlier rule explains; one without a cause only as the first."""
    ran = {result.check: result for result in results}
    left = {name for name, result in ran.items() if result.is_bad}
    is_first = True
    for rule in rules():
        if rule["fails"][0][0] not in left or not _matches(rule, ran):
            continue
        if rule["cause"] or is_first:
            yield rule
        is_first = False
        left -= {n for n in left for glob in rule["explains"] if fnmatchcase(n, glob)}


def _matches(rule: Rule, ran: Results) -> bool:
    has_failures = all(_fails(ran, *failure) for failure in rule["fails"])
    has_passes = all(n in ran and not ran[n].is_bad for n in rule["passes"])
    return has_failures and has_passes and _has_one_factor(rule, ran)


def _fails(ran: Results, name: str, sign: str | None, bound: str | None) -> bool:
    """Return whether a check fails, with a sign of its error or beyond a bound."""
    result = ran.get(name)
    if result is None or not result.is_bad or sign is None:
        return result is not None and result.is_bad
    limit = float(bound) if bound else result.expected
    if result.measured is None or limit is None:
        return False
    return bool(COMPARES[sign](result.measured, limit))


def _has_one_factor(rule: Rule, ran: Results) -> bool:
    """Return whether errors of checks, which fail, are one factor."""
    shares = [
        (ran[n].measured or 0.0) / (ran[n].expected or 1.0) for n in rule["equal"]
    ]
    return not shares or bool(np.ptp(shares) < ONE_FACTOR * max(np.abs(shares)))


def _text(rule: Rule, results: Sequence[CheckResult]) -> str:
    """Return a cause with the checks that fail and pass by it, or the diagnosis of its check."""
    failed = [name for name, *_ in rule["fails"]]
    ran = {result.check: result for result in results}
    if not rule["cause"]:
        result = ran[failed[0]]
        return f"{result.of.title}: {result.diagnosis} ({result.check} fails)"
    passed = [name for name in rule["passes"] if ran[name].status is Status.PASS]
    proof = f"fails: {', '.join(failed)}"
    proof += f"; passes: {', '.join(passed)}" if passed else ""
    return f"{rule['cause']} ({proof})"
