"""Run checks of measured objects on a target: each rollout once, for each set of contact constants that matters."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from gauge_envs.backends import Backend, backend
from gauge_envs.fixtures.recording import (
    DivergedError,
    Recording,
    UnsupportedError,
    raised_at,
)
from gauge_envs.tools.sanity.object_checks import object_check
from gauge_envs.tools.sanity.object_checks.check import (
    ObjectCheck,
    Scenario,
    effective_settings,
    run_scenario,
)
from gauge_envs.tools.sanity.training import Need, Settings, TrainingConfiguration
from gauge_envs.tools.sanity.verdict import (
    MAX_WARNING,
    NotApplicableError,
    PartOutcome,
    SanityResult,
    SanityVerdict,
)

Result = TypeVar("Result")

FAILURE_DEVIATION = 2.0 * MAX_WARNING
"""Smallest deviation of a failure of another kind, twice the largest deviation of a warning."""


class Measurements:
    """Runs checks on one engine, and caches rollouts by scenario and settings.

    Args:
        engine: A backend, or the name of an installed one.

    Attributes:
        engine: Name of the engine.
        versions: Versions of the engine's packages.
    """

    def __init__(self, engine: Backend | str) -> None:
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
        """Return the rollout of a scenario with settings, or an outcome that says why there is none."""
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
        key = function, scenario.name, str(sorted(settings.items()))
        if key not in self._known:
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


# --- targets ---------------------------------------------------------------------------------------------------------

NO_IMPACT = (
    "the target gives no impact constant: its contacts are critically damped or stiffer"
)
"""Reason why a rebound does not count."""

Sets = Mapping[str, Settings]
"""Settings of sets of contact constants, by the geoms that touch with them."""


@dataclass(frozen=True)
class AppliedCheck:
    """A check of measured objects and the settings of each set of contact constants.

    Attributes:
        measurements: Measurements on the backend.
        check: The check.
        sets: Settings by the geoms that touch with them; only sets that the check applies to.
        inapplicable: Why the check does not apply to the target; empty when it does.
    """

    measurements: Measurements
    check: ObjectCheck
    sets: Sets
    inapplicable: str = ""

    def outcomes(self) -> dict[str, PartOutcome]:
        """Return the outcome with each set."""
        return {
            geoms: self.measurements.measure(self.check, settings)
            for geoms, settings in self.sets.items()
        }

    def unmeasured(self, reason: str) -> SanityResult:
        """Return the result of a check that is not measured."""
        check = self.check
        return SanityResult(
            id=check.id,
            title=check.title,
            experiment=check.scenario.id,
            unit=check.unit,
            reality=check.reality,
            verdict=SanityVerdict.NOT_MEASURED,
            remark=reason,
        )

    def result(self) -> SanityResult:
        """Return the result of the worst set."""
        outcomes = self.outcomes()
        if not outcomes:
            return replace(self.unmeasured(self.inapplicable), applies=False)
        geoms, worst = worst_of(outcomes)
        result = replace(
            self.unmeasured(worst.remark),
            configured=worst.value,
            verdict=worst.verdict,
            geoms=geoms if len(outcomes) > 1 else "",
            parts=tuple(
                replace(outcome, name=name) for name, outcome in outcomes.items()
            ),
        )
        if worst.verdict is not SanityVerdict.NOT_MEASURED:
            return result
        # A scene that the engine cannot simulate at all is not checked.
        preset = self.measurements.measure(self.check, {})
        applies = preset.verdict is not SanityVerdict.NOT_MEASURED
        return replace(result, applies=applies)


def worst_of(outcomes: Mapping[str, PartOutcome]) -> tuple[str, PartOutcome]:
    """Return the geoms and the outcome that is farthest from reality; of those that were not measured if all."""

    def distance(item: tuple[str, PartOutcome]) -> tuple[bool, float]:
        outcome = item[1]
        is_measured = outcome.verdict is not SanityVerdict.NOT_MEASURED
        return is_measured, outcome.deviation

    return max(outcomes.items(), key=distance)


def applied_check(
    measurements: Measurements, configuration: TrainingConfiguration, name: str
) -> AppliedCheck:
    """Return a check of measured objects, by its id, with the sets of contact constants that it applies to."""
    check = object_check(name)
    try:
        for need in (Need.GRAVITY, Need.CONTACT, *check.needs):
            if need in configuration.inapplicable:
                raise NotApplicableError(configuration.inapplicable[need])
        sets = _sets_of(configuration, check)
        if Need.REBOUND in check.needs:
            sets = _bouncing(measurements, check.scenario, sets)
    except NotApplicableError as error:
        return AppliedCheck(measurements, check, {}, inapplicable=str(error))
    return AppliedCheck(measurements, check, sets)


def _bouncing(measurements: Measurements, scenario: Scenario, sets: Sets) -> Sets:
    """Return the sets of contact constants with an impact constant.

    Raises:
        NotApplicableError: There is none; the message is the reason.
    """
    effective = {name: measurements.effective(scenario, sets[name]) for name in sets}
    bouncing = {name: sets[name] for name in sets if _has_rebound(effective[name])}
    if not bouncing:
        raise NotApplicableError(NO_IMPACT)
    return bouncing


def _sets_of(configuration: TrainingConfiguration, check: ObjectCheck) -> Sets:
    """Return the sets of contact constants that a check applies to.

    Raises:
        NotApplicableError: There is none; the message is the reason.
    """
    sets: Sets = configuration.contact_sets
    if Need.FRICTION in check.needs:
        named = "; ".join(sets) or "the target"
        sets = {geoms: sets[geoms] for geoms in sets if sets[geoms].get("condim") != 1}
        if not sets:
            raise NotApplicableError(
                f"condim 1: contacts of {named} have no friction on purpose"
            )
    return sets


def _has_rebound(effective: Settings | PartOutcome) -> bool:
    """Return whether contacts have a rebound: one solref without it replaces an engine's restitution."""
    if isinstance(effective, PartOutcome):
        return True
    if effective.get("newton_material"):
        return False
    if "impact_steps" in effective:
        # Genesis: without a recipe for impacts, all contacts have the damping of lasting ones.
        damping = effective["sustained_dampratio"]
        return effective["impact_steps"] is not None or bool(damping < 1.0)
    first, second = effective.get("contact_solref") or (1.0, 0.0)
    if first > 0.0:
        return bool(second < 1.0)
    # In the direct format, minus stiffness and damping, the damping ratio is b / (2 sqrt(k)).
    return bool(-second < 2.0 * (-first) ** 0.5)
