"""Measure phenomena with settings, run each rollout once, and give verdicts.

A backend runs in this process; one of another package runs in another process, which may crash, exit or hang.
"""

import json
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from gauge_envs.backends import Backend, backend, backend_names, is_bundled, versions_of
from gauge_envs.errors import GaugeError
from gauge_envs.files import json_ready
from gauge_envs.runs.isolation import CrashError, Worker
from gauge_envs.tools.bench.recording import DeclinedError, DivergedError, Recording
from gauge_envs.tools.sanity.model import (
    VISIBLE_WITHIN,
    Need,
    PhenomenonResult,
    Settings,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.tools.sanity.phenomena import GRASP, phenomenon as phenomenon_of
from gauge_envs.tools.sanity.phenomena.base import Phenomenon
from gauge_envs.tools.sanity.scenario import Scenario, run_scenario, settings_in_force

SIMULATION_LIMIT_S = 600.0
"""Default time limit of a simulation in another process [s]."""

FAILURE_DEVIATION = 2.0 * VISIBLE_WITHIN
"""Least deviation of a failure of another kind; half of it is at the limit of `wrong`."""

OF_CONTACTS = (
    "contact_",
    "condim",
    "cone",
    "impratio",
    "torsional_",
    "rolling_",
    "o_friction",
)
"""Starts of names of settings without effect where nothing can touch."""


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
    """

    value: float | None = None
    deviation: float = math.inf
    verdict: Verdict
    remark: str = ""
    rollout: Recording | None = None


_Run = Callable[[Backend, Scenario, Settings], Any]


def _outcome_of(
    engine: Backend | str, function: _Run, scenario: Scenario, settings: Settings
) -> Any:
    """Return the value of a function of a backend, or a `Measured` that says why it declined or diverged."""
    try:
        if isinstance(engine, str):
            engine = backend(engine)
        return function(engine, scenario, settings)
    except DeclinedError as error:
        return Measured(verdict=Verdict.DECLINED, remark=str(error))
    except DivergedError as error:
        return Measured(verdict=Verdict.WRONG, remark=f"diverged: {error}")


class Measurements:
    """Measures phenomena on one engine, and caches rollouts by scenario and settings.

    An installed backend of another package runs in another process.

    Args:
        engine: A backend, or the name of an installed one.
        time_limit_s: Time after which no rollout starts any more [s]; None for no limit. It bounds each simulation in
            another process too, to a second at least, in which a process starts.

    Attributes:
        engine: Name of the engine.
        versions: Versions of the engine's packages.
    """

    def __init__(
        self, engine: Backend | str, *, time_limit_s: float | None = None
    ) -> None:
        limit_s = math.inf if time_limit_s is None else time_limit_s
        self._ends_s = time.monotonic() + limit_s
        self._worker = Worker(min(max(limit_s, 1.0), SIMULATION_LIMIT_S))
        self._known: dict[tuple[str, str, str], Any] = {}
        self._backend: Backend | None = None
        self.versions: Mapping[str, str]
        if (
            isinstance(engine, str)
            and engine in backend_names()
            and not is_bundled(engine)
        ):
            self.engine = engine
            try:
                self.versions = self._worker.call(versions_of, engine)
            except CrashError as error:
                cause = f"backend {engine!r} cannot be imported: {error}"
                raise CrashError(cause) from None
            return
        self._backend = backend(engine) if isinstance(engine, str) else engine
        self.engine, self.versions = self._backend.name, self._backend.versions()

    def close(self) -> None:
        """End the process of the engine."""
        self._worker.close()

    def measure(self, phenomenon: Phenomenon, settings: Settings) -> Measured:
        """Measure a phenomenon; an outcome also exists when the backend declines or the rollout diverges."""
        outcome = self._outcome(run_scenario, phenomenon.scenario, settings)
        return outcome if isinstance(outcome, Measured) else judged(phenomenon, outcome)

    def in_force(
        self, scenario: Scenario, settings: Settings
    ) -> dict[str, Any] | Measured:
        """Return every numerical setting that a scenario runs with, or why there is none."""
        force: dict[str, Any] | Measured
        force = self._outcome(settings_in_force, scenario, settings)
        return force

    def _outcome(self, function: _Run, scenario: Scenario, settings: Settings) -> Any:
        """Return what a function gives for a scenario and settings, or why it gives nothing."""
        key = self._key(function, scenario, settings)
        if key not in self._known:
            if function is run_scenario and time.monotonic() >= self._ends_s:
                raise TimeLimitError("the time limit is reached")
            self._known[key] = self._called(function, scenario, settings)
        return self._known[key]

    def _called(self, *task: Any) -> Any:
        """Return the outcome of a function, a scenario and settings."""
        if self._backend is not None:
            return _outcome_of(self._backend, *task)
        try:
            return self._worker.call(_outcome_of, self.engine, *task)
        except GaugeError as error:
            return Measured(verdict=Verdict.WRONG, remark=str(error))

    def _key(
        self, function: _Run, scenario: Scenario, settings: Settings
    ) -> tuple[str, str, str]:
        """Return a text of the settings that matter to a function of a scenario."""
        touches = scenario.scene.contacts
        stated = {
            name: value
            for name, value in settings.items()
            if touches or not name.startswith(OF_CONTACTS)
        }
        text = json.dumps(json_ready(stated), sort_keys=True)
        return function.__name__, scenario.name, text


def judged(phenomenon: Phenomenon, rollout: Recording) -> Measured:
    """Return the outcome of a phenomenon in a rollout of its scenario."""
    failure = "" if phenomenon.failure is None else phenomenon.failure(rollout)
    value, reality = float(phenomenon.value(rollout)), phenomenon.reality
    if not math.isfinite(value):
        remark = failure or "it does not happen"
        return Measured(verdict=Verdict.WRONG, remark=remark, rollout=rollout)
    deviation = abs(value - reality.value) / reality.tolerance
    if failure:
        deviation = max(deviation, FAILURE_DEVIATION)
    return Measured(
        value=value,
        deviation=deviation,
        verdict=Verdict.of(deviation),
        remark=failure,
        rollout=rollout,
    )


# --- rows of a report ------------------------------------------------------------------------------------------------


def result_of(
    phenomenon: Phenomenon,
    configured: Measured,
    default: Measured | None,
    **details: Any,
) -> PhenomenonResult:
    """Return the row of a phenomenon.

    Args:
        phenomenon: The phenomenon.
        configured: Outcome in the configuration.
        default: Outcome with the backend's default; None when there is none.
        details: Further attributes of the row.
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
        default_verdict=Verdict.DECLINED if default is None else default.verdict,
        remark=configured.remark,
        **details,
    )


NO_ROBOT = "the target states no geoms of a robot, so it has no foot"
"""Reason why rows on a foot do not apply to settings without a model."""

NO_IMPACT = "the target states no impact constant: its contacts are critically damped or stiffer"
"""Reason why a rebound does not count."""

Sets = Mapping[str, Settings]
"""Settings of sets of contact constants, by the geoms that touch with them."""


@dataclass(frozen=True, kw_only=True)
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
    sets: Sets = field(default_factory=dict)
    inapplicable: str = ""
    advisory: str = ""

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
    subject = Subject(measurements=measurements, phenomenon=phenomenon)
    reasons = configuration.inapplicable
    for need in phenomenon.needs:
        if need in reasons:
            return replace(subject, inapplicable=reasons[need])
    sets = _sets_of(configuration, phenomenon)
    if isinstance(sets, str):
        return replace(subject, inapplicable=sets)
    if phenomenon.needs_foot:
        phenomenon = phenomenon_of(phenomenon.id, configuration.foot_geometry)
    subject = replace(subject, phenomenon=phenomenon, sets=sets)
    return _impact(subject, configuration) if phenomenon.is_impact else subject


def _sets_of(
    configuration: TrainingConfiguration, phenomenon: Phenomenon
) -> Sets | str:
    """Return the sets of contact constants that a phenomenon applies to, or why there is none."""
    contacts: TrainingConfiguration | None = configuration
    if phenomenon.id in GRASP:
        contacts = configuration.of_hand(is_flat=phenomenon.id == "grasp-torsion")
    if contacts is None:
        return "round fingertips: their torsional friction alone holds a torque"
    sets: Sets = contacts.contact_sets
    if phenomenon.has_many_bodies:
        sets = {geoms: _flat(settings) for geoms, settings in sets.items()}
    if phenomenon.needs_foot:
        foot = configuration.foot_geometry
        if foot is None:
            return NO_ROBOT
        sets = {geoms: sets[geoms] for geoms in sets if geoms in foot.sets}
        if not sets:
            return "the chosen geoms are no foot on the ground"
    if Need.CONTACT not in phenomenon.needs:
        sets = dict([*sets.items()][:1])
    if phenomenon.needs_friction:
        named = "; ".join(sets) or "the target"
        sets = {geoms: sets[geoms] for geoms in sets if sets[geoms].get("condim") != 1}
        if not sets:
            return f"condim 1: contacts of {named} have no friction on purpose"
    return sets


def _flat(settings: Settings) -> Settings:
    """Return settings without torsional and rolling friction: many bricks that lie flat do not need them."""
    turning = {"condim", "torsional_friction_m", "rolling_friction_m"}
    kept = {name: settings[name] for name in settings if name not in turning}
    return kept if settings.get("condim", 3) >= 3 else settings


def _impact(subject: Subject, configuration: TrainingConfiguration) -> Subject:
    """Return an impact, which is advisory unless the target states a constant for it."""
    if reason := configuration.inapplicable.get(Need.REBOUND):
        return replace(subject, advisory=reason)
    scenario, sets = subject.phenomenon.scenario, subject.sets
    stating = {
        geoms: settings
        for geoms, settings in sets.items()
        if _states_impact(subject.measurements.in_force(scenario, settings))
    }
    advisory = "" if stating else NO_IMPACT
    return replace(subject, sets=stating or sets, advisory=advisory)


def _states_impact(force: dict[str, Any] | Measured) -> bool:
    """Return whether contacts have a rebound: one solref without it replaces an engine's restitution."""
    if isinstance(force, Measured):
        return True
    if force.get("newton_material"):
        return False
    if "impact_steps" in force:
        # Genesis: without a recipe for impacts, all contacts have the damping of lasting ones.
        damping = force["sustained_dampratio"]
        return force["impact_steps"] is not None or bool(damping < 1.0)
    first, second = force.get("contact_solref") or (1.0, 0.0)
    # In the direct format, minus stiffness and damping, the damping ratio is b / (2 sqrt(k)).
    return bool(second < 1.0 if first > 0.0 else -second < 2.0 * (-first) ** 0.5)


def worst_of(outcomes: Mapping[str, Measured]) -> tuple[str, Measured]:
    """Return the geoms and the outcome that is farthest from reality; of those that were not measured if all."""

    def distance(item: tuple[str, Measured]) -> float:
        _, outcome = item
        return -1.0 if outcome.verdict is Verdict.DECLINED else outcome.deviation

    return max(outcomes.items(), key=distance)
