"""The 95 % intervals of scores hold the true scores, in simulated realities whose truth is known."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from simulated_trials import held_percent

from gauge_envs.scoring import error_sources, uncertainty
from gauge_envs.tools.compare import draws

FAILING = [
    ("drop, skewed release", 5, "raw mm"),
    pytest.param("drop, release correlated 0.4", 22, "raw mm", marks=pytest.mark.slow),
]
"""Worlds, numbers of trials, and the quantity of which intervals of a plain bootstrap fail there."""

OUTLIERS = pytest.param(
    "slide, 5 % outliers", 20, "aligned ratio", marks=pytest.mark.slow
)

# Of 60 realities, a true 95 % gives at least 88 % in 99 of 100 runs.
LEAST_HELD_PERCENT = 88.0


@pytest.mark.parametrize(("name", "count", "worst"), [*FAILING, OUTLIERS])
def test_intervals_hold_the_truth(name: str, count: int, worst: str) -> None:
    found = held_percent(name, count, realities=60, seed=21)
    assert worst in found
    assert min(found.values()) >= LEAST_HELD_PERCENT, found


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
    found = held_percent(name, count, realities=60, seed=21)
    assert found[worst] < LEAST_HELD_PERCENT
