"""Measure phenomena with settings, run each rollout once, and give verdicts."""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from gauge_envs.backends import Backend, backend
from gauge_envs.errors import GaugeError
from gauge_envs.fixtures.recording import (
    DivergedError,
    Recording,
    UnsupportedError,
    raised_at,
)
from gauge_envs.tools.sanity.model import (
    MAX_WARNING,
    Need,
    PhenomenonResult,
    Settings,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.tools.sanity.phenomena import GRASP, phenomenon as phenomenon_of
from gauge_envs.tools.sanity.phenomena.base import Phenomenon
from gauge_envs.tools.sanity.rows import NotApplicableError
from gauge_envs.tools.sanity.scenario import Scenario, effective_settings, run_scenario

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


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Outcome of one phenomenon with some settings.

    Attributes:
        value: Value in the phenomenon's unit; None when nothing was measured.
        deviation: Distance from reality in half-widths of its interval; infinite when nothing was measured.
        verdict: The verdict.
        remark: Why nothing was measured, or a failure that no real trial shows; empty otherwise.
        rollout: The rollout; None when the scene is unsupported or the rollout diverged.
    """

    value: float | None = None
    deviation: float = math.inf
    verdict: Verdict
    remark: str = ""
    rollout: Recording | None = None


class Measurements:
    """Measures phenomena on one engine, and caches rollouts by scenario and settings.

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
        self._known: dict[tuple[str, str, str], Any] = {}
        self._backend = backend(engine) if isinstance(engine, str) else engine
        self.engine, self.versions = self._backend.name, self._backend.versions()

    def measure(self, phenomenon: Phenomenon, settings: Settings) -> Measured:
        """Measure a phenomenon; an outcome also exists when the scene is unsupported or the rollout diverges."""
        outcome = self.outcome(run_scenario, phenomenon.scenario, settings)
        return outcome if isinstance(outcome, Measured) else judged(phenomenon, outcome)

    def outcome(
        self,
        function: Callable[..., Any],
        scenario: Scenario,
        settings: Settings,
    ) -> Any:
        """Return what a function of a backend gives for a scenario and settings, or a `Measured` that says why not.

        Raises:
            TimeLimitError: The time is used up, and a simulation would start.
        """
        touches = scenario.scene.contacts
        effective = [
            (name, value)
            for name, value in sorted(settings.items())
            if touches or not name.startswith(CONTACT_PREFIXES)
        ]
        key = function.__name__, scenario.name, str(effective)
        if key not in self._known:
            if function is run_scenario and time.monotonic() >= self._ends_s:
                raise TimeLimitError("the time limit is reached")
            self._known[key] = self._called(function, scenario, settings)
        return self._known[key]

    def _called(self, function: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return function(self._backend, *arguments)
        except UnsupportedError as error:
            return Measured(verdict=Verdict.NOT_MEASURED, remark=str(error))
        except DivergedError as error:
            remark = f"diverged: {error}"
        # Engines raise exceptions of any kind; other scenes may run.
        except Exception as error:
            raised = f"{type(error).__name__}: {error}{raised_at(error)}"
            remark = f"the engine raised {raised}"
        return Measured(verdict=Verdict.FAILED, remark=remark)


def judged(phenomenon: Phenomenon, rollout: Recording) -> Measured:
    """Return the outcome of a phenomenon in a rollout of its scenario."""
    value, reality = float(phenomenon.value(rollout)), phenomenon.reality
    remark = phenomenon.failure(rollout)
    if not math.isfinite(value):
        remark = remark or "it does not happen"
        return Measured(verdict=Verdict.FAILED, remark=remark, rollout=rollout)
    minimum = FAILURE_DEVIATION if remark else 0.0
    deviation = max(abs(value - reality.value) / reality.tolerance, minimum)
    return Measured(
        value=value,
        deviation=deviation,
        verdict=Verdict.of(deviation),
        remark=remark,
        rollout=rollout,
    )


# --- results --------------------------------------------------------------------------------------------------------


def result_of(
    phenomenon: Phenomenon,
    configured: Measured,
    default: Measured | None,
    **details: Any,
) -> PhenomenonResult:
    """Return the result of a check.

    Args:
        phenomenon: The phenomenon.
        configured: Outcome in the configuration.
        default: Outcome with the backend's default; None when there is none.
        details: Further attributes of the result.
    """
    return PhenomenonResult(
        phenomenon=phenomenon.id,
        title=phenomenon.title,
        experiment=phenomenon.scenario.id,
        unit=phenomenon.unit,
        reality=phenomenon.reality,
        default=None if default is None else default.value,
        configured=configured.value,
        verdict=configured.verdict,
        default_verdict=Verdict.NOT_MEASURED if default is None else default.verdict,
        remark=configured.remark,
        **details,
    )


NO_ROBOT = "the target gives no geoms of a robot, so it has no foot"
"""Reason why checks of a foot do not apply to settings without a model."""

NO_IMPACT = (
    "the target gives no impact constant: its contacts are critically damped or stiffer"
)
"""Reason why a rebound does not count."""

Sets = Mapping[str, Settings]
"""Settings of sets of contact constants, by the geoms that touch with them."""


@dataclass(frozen=True)
class Subject:
    """A phenomenon and the settings of each set of contact constants.

    Attributes:
        measurements: Measurements on the backend.
        phenomenon: The phenomenon.
        sets: Settings by the geoms that touch with them; only sets that the phenomenon applies to.
        inapplicable: Why the phenomenon does not apply to the target; empty when it does.
        advisory: Why the verdict does not count; empty when it does.
    """

    measurements: Measurements
    phenomenon: Phenomenon
    sets: Sets
    inapplicable: str
    advisory: str

    def measured(self) -> dict[str, Measured]:
        """Return the outcome with each set."""
        return {
            geoms: self.measurements.measure(self.phenomenon, settings)
            for geoms, settings in self.sets.items()
        }


def subject_of(
    measurements: Measurements,
    configuration: TrainingConfiguration,
    phenomenon: Phenomenon,
) -> Subject:
    """Return a phenomenon with the sets of contact constants that it applies to."""
    sets: Sets = {}
    inapplicable = advisory = ""
    try:
        for need in phenomenon.needs:
            if need in configuration.inapplicable:
                raise NotApplicableError(configuration.inapplicable[need])
        sets = _sets_of(configuration, phenomenon)
        if phenomenon.needs_foot:
            phenomenon = phenomenon_of(phenomenon.id, configuration.foot_geometry)
        if phenomenon.is_impact:
            sets, advisory = _impact(measurements, configuration, phenomenon, sets)
    except NotApplicableError as error:
        inapplicable = str(error)
    return Subject(measurements, phenomenon, sets, inapplicable, advisory)


def _sets_of(configuration: TrainingConfiguration, phenomenon: Phenomenon) -> Sets:
    """Return the sets of contact constants that a phenomenon applies to.

    Raises:
        NotApplicableError: There is none; the message is the reason.
    """
    contacts: TrainingConfiguration | None = configuration
    if phenomenon.id in GRASP:
        contacts = configuration.of_hand(is_flat=phenomenon.id == "grasp-torsion")
    if contacts is None:
        raise NotApplicableError(
            "round fingertips: their torsional friction alone holds a torque"
        )
    sets: Sets = contacts.contact_sets
    if phenomenon.needs_foot:
        foot = configuration.foot_geometry
        if foot is None:
            raise NotApplicableError(NO_ROBOT)
        sets = {geoms: sets[geoms] for geoms in sets if geoms in foot.sets}
        if not sets:
            raise NotApplicableError("the chosen geoms are no foot on the ground")
    if Need.CONTACT not in phenomenon.needs:
        sets = dict([*sets.items()][:1])
    if Need.FRICTION in phenomenon.needs:
        named = "; ".join(sets) or "the target"
        sets = {geoms: sets[geoms] for geoms in sets if sets[geoms].get("condim") != 1}
        if not sets:
            raise NotApplicableError(
                f"condim 1: contacts of {named} have no friction on purpose"
            )
    return sets


def _impact(
    measurements: Measurements,
    configuration: TrainingConfiguration,
    phenomenon: Phenomenon,
    sets: Sets,
) -> tuple[Sets, str]:
    """Return the sets that give a constant for an impact, or all and why the impact is advisory."""
    if reason := configuration.inapplicable.get(Need.REBOUND):
        return sets, reason
    bouncing = {}
    for geoms, settings in sets.items():
        effective = measurements.outcome(
            effective_settings, phenomenon.scenario, settings
        )
        if isinstance(effective, Measured) or _has_rebound(effective):
            bouncing[geoms] = settings
    return (bouncing, "") if bouncing else (sets, NO_IMPACT)


def _has_rebound(effective: Settings) -> bool:
    """Return whether contacts have a rebound: one solref without it replaces an engine's restitution."""
    if effective.get("newton_material"):
        return False
    if "impact_steps" in effective:
        # Genesis: without a recipe for impacts, all contacts have the damping of lasting ones.
        damping = effective["sustained_dampratio"]
        return effective["impact_steps"] is not None or bool(damping < 1.0)
    first, second = effective.get("contact_solref") or (1.0, 0.0)
    # In the direct format, minus stiffness and damping, the damping ratio is b / (2 sqrt(k)).
    return bool(second < 1.0 if first > 0.0 else -second < 2.0 * (-first) ** 0.5)


def worst_of(outcomes: Mapping[str, Measured]) -> tuple[str, Measured]:
    """Return the geoms and the outcome that is farthest from reality; of those that were not measured if all."""
    return max(
        outcomes.items(),
        key=lambda item: (
            item[1].verdict is not Verdict.NOT_MEASURED,
            item[1].deviation,
        ),
    )
