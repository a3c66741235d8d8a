"""Measures phenomena with settings, each rollout once, and judges what comes out."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gauge_envs.backends import Backend
from gauge_envs.checks.rollout import DeclinedError, DivergedError
from gauge_envs.checks.sanity.model import Reality, Verdict
from gauge_envs.checks.sanity.phenomena import Phenomenon, PhenomenonValue
from gauge_envs.checks.sanity.scenario import Rollout, Scenario, rollout, settings_in_force
from gauge_envs.files import json_ready

__all__ = [
    "INSIDE_WITHIN",
    "VISIBLE_WITHIN",
    "Measured",
    "Measurements",
]

INSIDE_WITHIN = 2.0
"""Standard deviations within which a real trial could have done it."""

VISIBLE_WITHIN = 5.0
"""Standard deviations beyond which it is wrong."""

FAILURE_DEVIATION = 2.0 * VISIBLE_WITHIN
"""Deviation that a failure of another kind counts as at least, so that half of it is not wrong any more."""


@dataclass(frozen=True, kw_only=True)
class Measured:
    """What came out for one phenomenon with some settings.

    Attributes:
        value: In the phenomenon's unit; None where nothing was measured.
        deviation: Distance from reality in standard deviations; infinite where nothing was measured.
        verdict: What that means.
        remark: Why nothing was measured, or what no real trial does; empty otherwise.
        run: The rollout; None where there is none.
    """

    value: float | None
    deviation: float
    verdict: Verdict
    remark: str = ""
    run: Rollout | None = None


class Measurements:
    """Measures phenomena on one backend; rollouts are kept by scene and settings.

    Args:
        backend: The backend.
    """

    def __init__(self, backend: Backend) -> None:
        self._backend = backend
        self._in_force: dict[tuple[str, str], dict[str, Any] | DeclinedError] = {}
        self._runs: dict[tuple[str, str], Rollout | DeclinedError | DivergedError] = {}

    def in_force(self, stage: Scenario, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Every numerical setting that a stage runs with.

        Raises:
            DeclinedError: The backend cannot build the scene, or refuses the settings for it.
        """
        key = _key(stage, settings)
        if key not in self._in_force:
            try:
                self._in_force[key] = settings_in_force(self._backend, stage, settings)
            except DeclinedError as declined:
                self._in_force[key] = declined
        known = self._in_force[key]
        if isinstance(known, DeclinedError):
            raise known
        return known

    def measure(self, phenomenon: Phenomenon, settings: Mapping[str, Any]) -> Measured:
        """Measure a phenomenon; a backend that declines and a rollout that diverges are outcomes, too."""
        run = self._run(phenomenon.stage, settings)
        if isinstance(run, DeclinedError):
            return Measured(value=None, deviation=math.inf, verdict=Verdict.DECLINED, remark=str(run))
        if isinstance(run, DivergedError):
            return Measured(value=None, deviation=math.inf, verdict=Verdict.WRONG, remark=f"diverged: {run}")
        return _judged(phenomenon.read(run), phenomenon.reality, run)

    def _run(self, stage: Scenario, settings: Mapping[str, Any]) -> Rollout | DeclinedError | DivergedError:
        key = _key(stage, settings)
        if key not in self._runs:
            try:
                # With the step stated, every rollout of the stage is sampled alike.
                step = {k: v for k, v in self.in_force(stage, settings).items() if k == "timestep_s"}
                self._runs[key] = rollout(self._backend, stage, {**settings, **step})
            except (DeclinedError, DivergedError) as outcome:
                self._runs[key] = outcome
        return self._runs[key]


def _key(stage: Scenario, settings: Mapping[str, Any]) -> tuple[str, str]:
    return stage.name, json.dumps(json_ready(settings), sort_keys=True)


def _judged(reading: PhenomenonValue, reality: Reality, run: Rollout) -> Measured:
    if not math.isfinite(reading.value):
        remark = reading.failure or "it does not happen"
        return Measured(value=None, deviation=math.inf, verdict=Verdict.WRONG, remark=remark, run=run)
    deviation = abs(reading.value - reality.value) / reality.scatter
    if reading.failure:
        deviation = max(deviation, FAILURE_DEVIATION)
    return Measured(
        value=reading.value, deviation=deviation, verdict=_verdict(deviation), remark=reading.failure, run=run
    )


def _verdict(deviation: float) -> Verdict:
    if deviation <= INSIDE_WITHIN:
        return Verdict.INSIDE
    return Verdict.VISIBLE if deviation <= VISIBLE_WITHIN else Verdict.WRONG
