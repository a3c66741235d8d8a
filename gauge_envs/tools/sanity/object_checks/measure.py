"""Run checks of measured objects on a target: each rollout once, for each set of contact constants that matters."""

from dataclasses import replace
from operator import attrgetter
from typing import TypeVar

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
    run_scenario,
)
from gauge_envs.tools.sanity.verdict import (
    Need,
    PartOutcome,
    SanityResult,
    SanityVerdict,
    Settings,
    TrainingConfiguration,
)

Result = TypeVar("Result")


class Measurements:
    """Runs checks on one engine, and caches outcomes by check and settings.

    Args:
        engine: A backend, or the name of an installed one.

    Attributes:
        versions: Versions of the engine's packages.
    """

    def __init__(self, engine: Backend | str) -> None:
        self._known: dict[tuple[str, str], Recording | PartOutcome] = {}
        self._backend = backend(engine) if isinstance(engine, str) else engine
        self.versions = self._backend.versions()

    def measure(self, check: ObjectCheck, settings: Settings) -> PartOutcome:
        """Run a check; an outcome also exists when the scene is unsupported or the rollout diverges."""
        key = check.scenario.name, str(sorted(settings.items()))
        if key not in self._known:
            self._known[key] = self._rollout(check.scenario, settings)
        rollout = self._known[key]
        return rollout if isinstance(rollout, PartOutcome) else judged(check, rollout)

    def _rollout(
        self, scenario: Scenario, settings: Settings
    ) -> Recording | PartOutcome:
        """Return the rollout of a scenario with settings, or an outcome that says why there is none."""
        try:
            return run_scenario(self._backend, scenario, settings)
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
    deviation = check.reality.deviation(value)
    return PartOutcome(
        value=value, deviation=deviation, verdict=SanityVerdict.of(deviation)
    )


# --- targets ---------------------------------------------------------------------------------------------------------


def object_result(
    measurements: Measurements, configuration: TrainingConfiguration, name: str
) -> SanityResult:
    """Return the result of a check of measured objects, by its id, with the worst set of contact constants."""
    check, sets = object_check(name), configuration.contact_sets
    unmeasured = SanityResult(
        id=check.id,
        title=check.title,
        experiment=check.scenario.id,
        unit=check.unit,
        reality=check.reality,
        verdict=SanityVerdict.NOT_MEASURED,
    )
    needs = (Need.GRAVITY, Need.CONTACT, *check.needs)
    reasons = [*filter(None, map(configuration.inapplicable.get, needs))]
    slides = {geoms: sets[geoms] for geoms in sets if sets[geoms].get("condim") != 1}
    if not slides:
        named = "; ".join(sets) or "the target"
        reasons.append(f"condim 1: contacts of {named} have no friction on purpose")
    if reasons:
        return replace(unmeasured, remark=reasons[0], applies=False)
    parts = [
        replace(measurements.measure(check, settings), name=geoms)
        for geoms, settings in slides.items()
    ]
    worst = max(parts, key=attrgetter("deviation"))
    return replace(
        unmeasured,
        configured=worst.value,
        verdict=worst.verdict,
        remark=worst.remark,
        geoms=worst.name if len(parts) > 1 else "",
        parts=tuple(parts),
    )
