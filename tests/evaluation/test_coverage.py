"""The 95 % intervals of scores hold the true scores, in simulated realities whose truth is known.

`studies/coverage` has the worlds, the script and the measured table. The method and its numbers were chosen on the
worlds `CHOSEN_ON` with the seeds 1 and 2; the table has other seeds, and `HELD_OUT` has the worlds that it was not
chosen on. `BEYOND` are worlds in which no method holds without knowing the sessions.
"""

from __future__ import annotations

import math
from collections import Counter
from functools import cache

import numpy as np
import pytest

from gauge_envs.evaluation import error_sources, uncertainty
from gauge_envs.tools.compare import draws
from studies.coverage.interval_coverage import (
    CHOSEN_ON,
    HELD_OUT,
    REALITIES,
    SEEDS,
    WORLDS,
    Row,
    counts,
    coverage,
    read,
)
from studies.coverage.levels import coverage as level_coverage

FAILING = [
    ("drop, skewed release", 5, "raw mm"),
    pytest.param("drop, release correlated 0.4", 22, "raw mm", marks=pytest.mark.slow),
]
"""Worlds, numbers of trials, and the quantity of which intervals of a plain bootstrap fail there."""


# Of 60 realities, a true 95 % gives at least 88 % in 99 of 100 runs.
LEAST_HELD_PERCENT = 88.0


def pooled(rows: list[Row], quantity: str) -> float:
    """Return the percentage of the intervals of a quantity that hold the truth."""
    chosen = [row for row in rows if row.quantity == quantity]
    return (
        100.0
        * sum(row.realities - row.refused - row.missed for row in chosen)
        / sum(row.realities - row.refused for row in chosen)
    )


@pytest.mark.parametrize(("name", "count", "worst"), FAILING)
def test_intervals_hold_the_truth(name: str, count: int, worst: str) -> None:
    rows = coverage(name, count, realities=60, seeds=(21,))
    quantities = sorted({row.quantity for row in rows})
    assert worst in quantities
    for quantity in quantities:
        assert pooled(rows, quantity) >= LEAST_HELD_PERCENT, quantity


@pytest.mark.slow
@pytest.mark.parametrize(("name", "count", "worst"), FAILING)
def test_a_plain_bootstrap_is_found_to_miss_the_truth(
    name: str, count: int, worst: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Resampled trials, with the tails of a normal and as if they were independent, as an earlier version had it."""

    @cache
    def resampled(count: int) -> np.ndarray:
        random = np.random.default_rng(1)
        return (
            random.multinomial(
                count, np.full(count, 1.0 / count), error_sources.DRAW_COUNT
            )
            / count
            - 1.0 / count
        )

    for module in (error_sources, uncertainty):
        monkeypatch.setattr(module, "trial_weights", resampled)
    for module in (uncertainty, draws):
        monkeypatch.setattr(module, "widening", lambda series: 1.0)
    rows = coverage(name, count, realities=60, seeds=(21,))
    assert pooled(rows, worst) < LEAST_HELD_PERCENT


def test_the_table_is_whole_and_holds_as_the_note_says() -> None:
    rows = read()
    cases = Counter((row.world, row.trials) for row in rows)
    assert set(cases) == {(name, count) for name in WORLDS for count in counts(name)}
    assert set(cases.values()) == {16}
    assert {row.realities for row in rows} == {REALITIES * len(SEEDS)}
    coverage_percents = [row.coverage_percent for row in rows]
    assert coverage_percents == sorted(coverage_percents)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "count"), [(next(iter(CHOSEN_ON)), 20), (next(iter(HELD_OUT)), 5)]
)
def test_the_table_is_that_of_the_script(name: str, count: int) -> None:
    measured = {(row.quantity, row.engines): row for row in coverage(name, count)}
    for row in read():
        if (row.world, row.trials) == (name, count):
            again = measured[row.quantity, row.engines]
            # Rounding of a matrix product may move the end of an interval over the truth.
            assert math.isclose(again.missed, row.missed, abs_tol=2) and math.isclose(
                again.refused, row.refused, abs_tol=2
            )


@pytest.mark.slow
def test_ratios_to_20_trials_hold_where_one_trial_in_twenty_is_an_outlier() -> None:
    rows = level_coverage("slide, 5 % outliers", 20, realities=60, seeds=(23,))
    ratios = {row.level: row.holds for row in rows if row.quantity == "aligned ratio"}
    assert min(ratios.values()) >= LEAST_HELD_PERCENT, ratios
