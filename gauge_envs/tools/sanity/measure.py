"""Measure phenomena with settings, run each rollout once, and give verdicts."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gauge_envs.backends import Backend
from gauge_envs.errors import GaugeError
from gauge_envs.files import json_ready
from gauge_envs.runs.rollout import DeclinedError, DivergedError, Rollout
from gauge_envs.tools.sanity.engine import Engine, EngineDiedError
from gauge_envs.tools.sanity.model import INSIDE_WITHIN, VISIBLE_WITHIN, Reality, Verdict
from gauge_envs.tools.sanity.phenomena import Phenomenon, PhenomenonValue
from gauge_envs.tools.sanity.scenario import Scenario

FAILURE_DEVIATION = 2.0 * VISIBLE_WITHIN
"""Least deviation of a failure of another kind; half of it is at the limit of `wrong`."""


class TimeLimitError(GaugeError):
    """The time of a check is used up, and another rollout would be needed."""


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Outcome of one phenomenon with some settings.

    Attributes:
        value: Value in the phenomenon's unit; None when nothing was measured.
        deviation: Distance from reality in half-widths of its interval; infinite when nothing was measured.
        verdict: The verdict.
        remark: Why nothing was measured, or a failure that no real trial shows; empty otherwise.
        rollout: The rollout; None when the backend declined or the rollout diverged.
        engine_died: Whether the process of the engine died or exceeded its time limit.
    """

    value: float | None
    deviation: float
    verdict: Verdict
    remark: str = ""
    rollout: Rollout | None = None
    engine_died: bool = False


class Measurements:
    """Measures phenomena on one engine, and caches rollouts by scenario and settings.

    Args:
        engine: The engine, or a backend that runs in this process.
        time_limit_s: Time after which no rollout starts any more [s].
    """

    def __init__(self, engine: Engine | Backend, *, time_limit_s: float = math.inf) -> None:
        self._engine = engine if isinstance(engine, Engine) else Engine(engine)
        self._ends_s = time.monotonic() + time_limit_s
        self._in_force: dict[tuple[str, str], dict[str, Any] | DeclinedError] = {}
        self._rollouts: dict[tuple[str, str], Rollout | DeclinedError | DivergedError] = {}

    def in_force(self, scenario: Scenario, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Return every numerical setting that a scenario runs with."""
        key = _key(scenario, settings)
        if key not in self._in_force:
            try:
                self._in_force[key] = self._engine.settings_in_force(scenario, settings)
            except DeclinedError as declined:
                self._in_force[key] = declined
        known = self._in_force[key]
        if isinstance(known, DeclinedError):
            raise known
        return known

    def measure(self, phenomenon: Phenomenon, settings: Mapping[str, Any]) -> Measured:
        """Measure a phenomenon; an outcome also exists when the backend declines or the rollout diverges."""
        rollout = self._rollout(phenomenon.scenario, settings)
        if isinstance(rollout, DeclinedError):
            return Measured(value=None, deviation=math.inf, verdict=Verdict.DECLINED, remark=str(rollout))
        if isinstance(rollout, EngineDiedError):
            return Measured(
                value=None, deviation=math.inf, verdict=Verdict.WRONG, remark=str(rollout), engine_died=True
            )
        if isinstance(rollout, DivergedError):
            return Measured(value=None, deviation=math.inf, verdict=Verdict.WRONG, remark=f"diverged: {rollout}")
        return judged(phenomenon.read(rollout), phenomenon.reality, rollout)

    def _rollout(self, scenario: Scenario, settings: Mapping[str, Any]) -> Rollout | DeclinedError | DivergedError:
        key = _key(scenario, settings)
        if key not in self._rollouts:
            if time.monotonic() >= self._ends_s:
                raise TimeLimitError("the time limit is reached")
            try:
                # A stated step gives every rollout of the scenario the same sampling rule.
                step = {k: v for k, v in self.in_force(scenario, settings).items() if k == "timestep_s"}
                self._rollouts[key] = self._engine.run(scenario, {**settings, **step})
            except (DeclinedError, DivergedError) as outcome:
                self._rollouts[key] = outcome
        return self._rollouts[key]


def _key(scenario: Scenario, settings: Mapping[str, Any]) -> tuple[str, str]:
    return scenario.name, json.dumps(json_ready(settings), sort_keys=True)


def judged(measured: PhenomenonValue, reality: Reality, rollout: Rollout) -> Measured:
    """Return the outcome of a phenomenon whose value was measured in a rollout."""
    if not math.isfinite(measured.value):
        remark = measured.failure or "it does not happen"
        return Measured(value=None, deviation=math.inf, verdict=Verdict.WRONG, remark=remark, rollout=rollout)
    deviation = abs(measured.value - reality.value) / reality.tolerance
    if measured.failure:
        deviation = max(deviation, FAILURE_DEVIATION)
    return Measured(
        value=measured.value, deviation=deviation, verdict=_verdict(deviation), remark=measured.failure, rollout=rollout
    )


def _verdict(deviation: float) -> Verdict:
    if deviation <= INSIDE_WITHIN:
        return Verdict.INSIDE
    return Verdict.VISIBLE if deviation <= VISIBLE_WITHIN else Verdict.WRONG
