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

NEUTRAL = {"mujoco": {"contact_margin_m": 0.0, "contact_gap_m": 0.0}}
"""Values that are those of an engine where a setting is not stated, by the name of the engine."""

_Run = Callable[[Backend, Scenario, Settings], Any]


class EngineDiedError(DivergedError):
    """The process of an engine died, or exceeded its time limit."""


class TimeLimitError(GaugeError):
    """The time of a check is used up, and another rollout would be needed."""


class Engine:
    """A backend that runs scenarios. An installed backend of another package runs in another process.

    Args:
        engine: The backend, or the name of an installed one.
        time_limit_s: Time limit of a simulation in another process [s].
    """

    def __init__(
        self, engine: Backend | str, time_limit_s: float = SIMULATION_LIMIT_S
    ) -> None:
        self._worker = Worker(time_limit_s)
        self._backend: Backend | None = None
        if isinstance(engine, str):
            if engine in backend_names() and not is_bundled(engine):
                self.name = engine
                try:
                    self.versions = self._worker.call(versions_of, engine)
                except CrashError as error:
                    raise CrashError(
                        f"backend {engine!r} cannot be imported: {error}"
                    ) from None
                return
            engine = backend(engine)
        self._backend = engine
        self.name, self.versions = engine.name, engine.versions()

    def close(self) -> None:
        """End the process of the engine."""
        self._worker.close()

    def call(self, function: _Run, scenario: Scenario, settings: Settings) -> Any:
        """Return the value of a function of the backend, a scenario and settings."""
        if self._backend is not None:
            return function(self._backend, scenario, settings)
        try:
            value, missing, divergence = self._worker.call(
                _outcome_of, function, self.name, scenario, settings
            )
        except GaugeError as error:
            raise EngineDiedError(str(error)) from None
        if missing is not None:
            raise DeclinedError(missing)
        if divergence is not None:
            raise DivergedError(divergence)
        return value


def _outcome_of(
    function: _Run, name: str, scenario: Scenario, settings: Settings
) -> tuple[Any, tuple[str, ...] | None, str | None]:
    """Return the value of a function of a backend and a scenario, or why it declined or diverged."""
    try:
        return function(backend(name), scenario, settings), None, None
    except DeclinedError as error:
        return None, error.missing, None
    except DivergedError as error:
        return None, None, str(error)


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

    value: float | None = None
    deviation: float = math.inf
    verdict: Verdict
    remark: str = ""
    rollout: Recording | None = None
    engine_died: bool = False


class Measurements:
    """Measures phenomena on one engine, and caches rollouts by scenario and settings.

    Args:
        engine: A backend, or the name of an installed one.
        time_limit_s: Time after which no rollout starts any more [s]; None for no limit. It bounds each simulation in
            another process too, to a second at least, in which a process starts.
    """

    def __init__(
        self, engine: Backend | str, *, time_limit_s: float | None = None
    ) -> None:
        limit_s = math.inf if time_limit_s is None else time_limit_s
        self._engine = Engine(engine, min(max(limit_s, 1.0), SIMULATION_LIMIT_S))
        self._ends_s = time.monotonic() + limit_s
        self._known: dict[tuple[str, str, str], Any] = {}

    @property
    def engine(self) -> str:
        """Name of the engine."""
        return self._engine.name

    @property
    def versions(self) -> Mapping[str, str]:
        """Versions of the engine's packages."""
        return self._engine.versions

    def close(self) -> None:
        """End the process of the engine."""
        self._engine.close()

    def in_force(self, scenario: Scenario, settings: Settings) -> dict[str, Any]:
        """Return every numerical setting that a scenario runs with."""
        found = self._outcome(settings_in_force, scenario, settings)
        if isinstance(found, EngineDiedError):
            raise DeclinedError((str(found),))
        if isinstance(found, DeclinedError):
            raise found
        return dict(found)

    def measure(self, phenomenon: Phenomenon, settings: Settings) -> Measured:
        """Measure a phenomenon; an outcome also exists when the backend declines or the rollout diverges."""
        rollout = self._rollout(phenomenon.scenario, settings)
        if isinstance(rollout, DeclinedError):
            return Measured(verdict=Verdict.DECLINED, remark=str(rollout))
        if isinstance(rollout, DivergedError):
            died = isinstance(rollout, EngineDiedError)
            remark = str(rollout) if died else f"diverged: {rollout}"
            return Measured(verdict=Verdict.WRONG, remark=remark, engine_died=died)
        return judged(phenomenon, rollout)

    def _rollout(
        self, scenario: Scenario, settings: Settings
    ) -> Recording | DeclinedError | DivergedError:
        """Return the rollout of a scenario, or why there is none."""
        if _key(self.engine, run_scenario, scenario, settings) in self._known:
            return self._outcome(run_scenario, scenario, settings)
        if time.monotonic() >= self._ends_s:
            raise TimeLimitError("the time limit is reached")
        # A stated step gives every rollout of the scenario the same sampling rule.
        step: dict[str, Any] = {}
        if settings.get("timestep_s") is None:
            try:
                force = self.in_force(scenario, settings)
            except DeclinedError as declined:
                return declined
            step = {k: v for k, v in force.items() if k == "timestep_s"}
        return self._outcome(run_scenario, scenario, settings, step)

    def _outcome(
        self,
        function: _Run,
        scenario: Scenario,
        settings: Settings,
        more: Settings | None = None,
    ) -> Any:
        """Return what a function gives for a scenario and settings, or the error with which it ends."""
        key = _key(self.engine, function, scenario, settings)
        if key not in self._known:
            try:
                self._known[key] = self._engine.call(
                    function, scenario, {**settings, **(more or {})}
                )
            except (DeclinedError, DivergedError) as outcome:
                self._known[key] = outcome
        return self._known[key]


def _key(
    engine: str, function: _Run, scenario: Scenario, settings: Settings
) -> tuple[str, str, str]:
    if not scenario.scene.contacts:
        settings = {
            name: value
            for name, value in settings.items()
            if not name.startswith(OF_CONTACTS)
        }
    neutral = NEUTRAL.get(engine, {})
    stated = {
        name: value
        for name, value in settings.items()
        if name not in neutral or value != neutral[name]
    }
    text = json.dumps(json_ready(stated), sort_keys=True)
    return function.__name__, scenario.name, text


def judged(phenomenon: Phenomenon, rollout: Recording) -> Measured:
    """Return the outcome of a phenomenon in a rollout of its scenario."""
    failure = "" if phenomenon.failure is None else phenomenon.failure(rollout)
    value, reality = float(phenomenon.value(rollout)), phenomenon.reality
    if not math.isfinite(value):
        return Measured(
            verdict=Verdict.WRONG,
            remark=failure or "it does not happen",
            rollout=rollout,
        )
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


SEVERITY = (Verdict.DECLINED, Verdict.INSIDE, Verdict.VISIBLE, Verdict.WRONG)
"""Verdicts, the worst last."""

NO_ROBOT = "the target states no geoms of a robot, so it has no foot"
"""Reason why rows on a foot do not apply to settings without a model."""


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
    sets: Mapping[str, Settings] = field(default_factory=dict)
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
    for need in phenomenon.needs:
        if need in configuration.inapplicable:
            return replace(subject, inapplicable=configuration.inapplicable[need])
    judged_contacts = (
        configuration.of_hand(is_flat=phenomenon.id == "grasp-torsion")
        if phenomenon.id in GRASP
        else configuration
    )
    if judged_contacts is None:
        return replace(
            subject,
            inapplicable="round fingertips: their torsional friction alone holds a torque",
        )
    sets = {
        geoms: _relevant(phenomenon, settings)
        for geoms, settings in judged_contacts.contact_sets.items()
    }
    if phenomenon.needs_foot:
        geometry = configuration.foot_geometry
        if geometry is None:
            return replace(subject, inapplicable=NO_ROBOT)
        subject = replace(subject, phenomenon=phenomenon_of(phenomenon.id, geometry))
        sets = {
            geoms: settings
            for geoms, settings in sets.items()
            if geoms in geometry.sets
        }
        if not sets:
            return replace(
                subject, inapplicable="the chosen geoms are no foot on the ground"
            )
    if Need.CONTACT not in phenomenon.needs:
        sets = dict([next(iter(sets.items()))])
    if phenomenon.needs_friction:
        frictionless = [
            geoms for geoms, settings in sets.items() if settings.get("condim") == 1
        ]
        sets = {
            geoms: settings
            for geoms, settings in sets.items()
            if geoms not in frictionless
        }
        if not sets:
            reason = f"condim 1: contacts of {'; '.join(frictionless) or 'the target'} have no friction on purpose"
            return replace(subject, inapplicable=reason)
    subject = replace(subject, sets=sets, advisory=subject.phenomenon.advisory)
    return _impact(subject, configuration) if phenomenon.is_impact else subject


def _relevant(phenomenon: Phenomenon, settings: Settings) -> Settings:
    """Return settings without torsional and rolling friction for many bodies: bricks that lie flat do not need them."""
    if not phenomenon.has_many_bodies or settings.get("condim", 3) < 3:
        return settings
    several = ("condim", "torsional_friction_m", "rolling_friction_m")
    return {name: value for name, value in settings.items() if name not in several}


def _impact(subject: Subject, configuration: TrainingConfiguration) -> Subject:
    """Return an impact, which is advisory unless the target states a constant for it."""
    foot = configuration.foot_contact
    if foot is not None and not any(foot.restitution):
        return replace(subject, advisory="the target states a restitution of 0")
    stating = {
        geoms: settings
        for geoms, settings in subject.sets.items()
        if _states_impact(subject, settings)
    }
    reason = "the target states no impact constant: its contacts are critically damped or stiffer"
    return replace(
        subject, sets=stating or subject.sets, advisory="" if stating else reason
    )


def worst_of(outcomes: Mapping[str, Measured]) -> tuple[str, Measured]:
    """Return the geoms and the outcome of the worst verdict; of equal verdicts, the one farthest from reality."""
    return max(
        outcomes.items(),
        key=lambda item: (SEVERITY.index(item[1].verdict), item[1].deviation),
    )


def _states_impact(subject: Subject, settings: Settings) -> bool:
    """Return whether contacts have a rebound: one solref without it replaces an engine's restitution."""
    try:
        force = subject.measurements.in_force(subject.phenomenon.scenario, settings)
    except DeclinedError:
        return True
    if force.get("newton_material"):
        return False
    if "impact_steps" in force:
        # Genesis: without a recipe for impacts, all contacts have the damping of lasting ones.
        return force["impact_steps"] is not None or bool(
            force["sustained_dampratio"] < 1.0
        )
    solref = force.get("contact_solref")
    if solref is None:
        return True
    first, second = solref
    if first > 0.0:
        return bool(second < 1.0)
    # In the direct format, minus stiffness and damping, the damping ratio is b / (2 sqrt(k)).
    return bool(-second < 2.0 * (-first) ** 0.5)
