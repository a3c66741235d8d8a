"""Run checks of measured objects with settings, each rollout once, and give verdicts."""

import math
import time
from collections.abc import Callable
from typing import Any, TypeVar

from gauge_envs.backends import Backend, backend
from gauge_envs.errors import GaugeError
from gauge_envs.fixtures.recording import (
    DivergedError,
    Recording,
    UnsupportedError,
    raised_at,
)
from gauge_envs.tools.sanity.object_checks.check import ObjectCheck
from gauge_envs.tools.sanity.object_checks.scenario import (
    Scenario,
    effective_settings,
    run_scenario,
)
from gauge_envs.tools.sanity.robot.robot import Settings
from gauge_envs.tools.sanity.verdict import MAX_WARNING, PartOutcome, SanityVerdict

Result = TypeVar("Result")

FAILURE_DEVIATION = 2.0 * MAX_WARNING
"""Smallest deviation of a failure of another kind, twice the largest deviation of a warning."""

CONTACT_PREFIXES = (
    "contact_",
    "condim",
    "cone",
    "impratio",
    "torsional_",
    "rolling_",
    "o_friction",
)
"""Prefixes of settings that have no effect where nothing can touch."""


class TimeLimitError(GaugeError):
    """The time of a check is used up, and another rollout would be needed."""


class Measurements:
    """Runs checks on one engine, and caches rollouts by scenario and settings.

    Args:
        engine: A backend, or the name of an installed one.
        time_limit_s: Time after which no rollout starts any more [s]; None for no limit.

    Attributes:
        engine: Name of the engine.
        versions: Versions of the engine's packages.
    """

    def __init__(
        self, engine: Backend | str, *, time_limit_s: float | None = None
    ) -> None:
        limit_s = math.inf if time_limit_s is None else time_limit_s
        self._ends_s = time.monotonic() + limit_s
        self._known: dict[tuple[object, str, str], Any] = {}
        self._backend = backend(engine) if isinstance(engine, str) else engine
        self.engine, self.versions = self._backend.name, self._backend.versions()

    def measure(self, check: ObjectCheck, settings: Settings) -> PartOutcome:
        """Run a check; an outcome also exists when the scene is unsupported or the rollout diverges."""
        rollout = self.rollout(check.scenario, settings)
        if isinstance(rollout, PartOutcome):
            return rollout
        return judged(check, rollout)

    def rollout(
        self, scenario: Scenario, settings: Settings
    ) -> Recording | PartOutcome:
        """Return the rollout of a scenario with settings, or an outcome that says why there is none.

        Raises:
            TimeLimitError: The time is used up, and a simulation would start.
        """
        return self._once(run_scenario, scenario, settings)

    def effective(
        self, scenario: Scenario, settings: Settings
    ) -> Settings | PartOutcome:
        """Return every setting that a scenario would run with, or an outcome that says why there is none."""
        return self._once(effective_settings, scenario, settings)

    def _once(
        self,
        function: Callable[[Backend, Scenario, Settings], Result],
        scenario: Scenario,
        settings: Settings,
    ) -> Result | PartOutcome:
        touches = scenario.scene.contacts
        relevant = [
            (name, value)
            for name, value in sorted(settings.items())
            if touches or not name.startswith(CONTACT_PREFIXES)
        ]
        key = function, scenario.name, str(relevant)
        if key not in self._known:
            if function is run_scenario and time.monotonic() >= self._ends_s:
                raise TimeLimitError("the time limit is reached")
            self._known[key] = self._called(function, scenario, settings)
        result: Result | PartOutcome = self._known[key]
        return result

    def _called(
        self,
        function: Callable[[Backend, Scenario, Settings], Result],
        scenario: Scenario,
        settings: Settings,
    ) -> Result | PartOutcome:
        try:
            return function(self._backend, scenario, settings)
        except UnsupportedError as error:
            return PartOutcome(verdict=SanityVerdict.NOT_MEASURED, remark=str(error))
        except DivergedError as error:
            remark = f"diverged: {error}"
        # Engines raise exceptions of any kind; other scenes may run.
        except Exception as error:
            raised = f"{type(error).__name__}: {error}{raised_at(error)}"
            remark = f"the engine raised {raised}"
        return PartOutcome(verdict=SanityVerdict.FAILED, remark=remark)


def judged(check: ObjectCheck, rollout: Recording) -> PartOutcome:
    """Return the outcome of a check in a rollout of its scenario."""
    value = float(check.value(rollout))
    remark = check.failure(rollout)
    if not math.isfinite(value):
        remark = remark or "it does not happen"
        return PartOutcome(verdict=SanityVerdict.FAILED, remark=remark)
    deviation = check.reality.deviation(value)
    if remark:
        deviation = max(deviation, FAILURE_DEVIATION)
    return PartOutcome(
        value=value,
        deviation=deviation,
        verdict=SanityVerdict.of(deviation),
        remark=remark,
    )
