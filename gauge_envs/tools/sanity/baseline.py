"""Compare a sanity check with an earlier one, so that only regressions fail."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from gauge_envs.errors import TargetError
from gauge_envs.files import MEGABYTE, json_document, read_regular
from gauge_envs.tools.sanity.model import PhenomenonResult, Report, Verdict

MOST_BASELINE_BYTES = 16 * MEGABYTE
"""Largest size of a file with an earlier run."""

RANKS = {Verdict.DECLINED: 0, Verdict.INSIDE: 0, Verdict.VISIBLE: 1, Verdict.WRONG: 2}
"""Verdicts by how bad they are."""


def read_baseline(path: Path) -> dict[str, Verdict]:
    """Return the verdict of each row of an earlier run, by its id.

    Args:
        path: File with the output of `gauge sanity TARGET --json`.
    """
    try:
        content = read_regular(path, MOST_BASELINE_BYTES)
        lines = [json_document(line) for line in content.splitlines() if line.strip()]
    except OSError as error:
        raise TargetError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise TargetError(f"{path}: is not the output of gauge sanity --json: {error}") from None
    try:
        found = {line["phenomenon"]: Verdict(line["verdict"]) for line in lines if "phenomenon" in line}
    except (TypeError, ValueError, KeyError) as error:
        raise TargetError(f"{path}: is not the output of gauge sanity --json: {error}") from None
    if not found:
        raise TargetError(f"{path}: has no row; write it with gauge sanity TARGET --json > {path}")
    return found


def regressions(report: Report, baseline: Mapping[str, Verdict], *, least: Verdict) -> list[PhenomenonResult]:
    """Return the rows that count, are at least as bad as `least`, and are worse than in the baseline.

    A row that the baseline does not have, or that it declined, is compared with `inside`.
    """
    return [
        row
        for row in report.rows
        if row.is_flag
        and RANKS[row.verdict] >= RANKS[least]
        and RANKS[row.verdict] > RANKS[baseline.get(row.phenomenon, Verdict.INSIDE)]
    ]
