"""Measure one phenomenon with every set of contact constants of a target that it applies to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from gauge_envs.runs.rollout import DeclinedError
from gauge_envs.tools.sanity.measure import Measured, Measurements
from gauge_envs.tools.sanity.model import Need, TrainingConfiguration, Verdict
from gauge_envs.tools.sanity.phenomena import phenomenon as phenomenon_of
from gauge_envs.tools.sanity.phenomena.base import Phenomenon

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
    sets: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    inapplicable: str = ""
    advisory: str = ""

    def measured(self, changes: Mapping[str, Any] | None = None) -> dict[str, Measured]:
        """Return the outcome with each set, with some settings changed."""
        return {
            geoms: self.measurements.measure(self.phenomenon, {**settings, **(changes or {})})
            for geoms, settings in self.sets.items()
        }

    def worst(self, changes: Mapping[str, Any] | None = None) -> Measured:
        """Return the worst outcome of all sets, with some settings changed."""
        return worst_of(self.measured(changes))[1]


def subject_of(measurements: Measurements, configuration: TrainingConfiguration, phenomenon: Phenomenon) -> Subject:
    """Return a phenomenon with the sets of contact constants that it applies to."""
    subject = Subject(measurements=measurements, phenomenon=phenomenon)
    for need in phenomenon.needs:
        if need in configuration.inapplicable:
            return replace(subject, inapplicable=configuration.inapplicable[need])
    sets: dict[str, Mapping[str, Any]] = dict(configuration.contact_sets)
    if phenomenon.needs_foot:
        geometry = configuration.foot_geometry
        if geometry is None:
            return replace(subject, inapplicable=NO_ROBOT)
        subject = replace(subject, phenomenon=phenomenon_of(phenomenon.id, geometry))
        sets = {geoms: settings for geoms, settings in sets.items() if geoms in geometry.sets}
        if not sets:
            return replace(subject, inapplicable="the chosen geoms are no foot on the ground")
    if Need.CONTACT not in phenomenon.needs:
        sets = dict([next(iter(sets.items()))])
    if phenomenon.needs_friction:
        frictionless = [geoms for geoms, settings in sets.items() if settings.get("condim") == 1]
        sets = {geoms: settings for geoms, settings in sets.items() if geoms not in frictionless}
        if not sets:
            reason = f"condim 1: contacts of {'; '.join(frictionless) or 'the target'} have no friction on purpose"
            return replace(subject, inapplicable=reason)
    subject = replace(subject, sets=sets, advisory=subject.phenomenon.advisory)
    return _impact(subject, configuration) if phenomenon.is_impact else subject


def _impact(subject: Subject, configuration: TrainingConfiguration) -> Subject:
    """Return an impact, which is advisory unless the target states a constant for it."""
    foot = configuration.foot_contact
    if foot is not None and not any(foot.restitution):
        return replace(subject, advisory="the target states a restitution of 0")
    stating = {geoms: settings for geoms, settings in subject.sets.items() if _states_impact(subject, settings)}
    reason = "the target states no impact constant: its contacts are critically damped or stiffer"
    return replace(subject, sets=stating or subject.sets, advisory="" if stating else reason)


def worst_of(outcomes: Mapping[str, Measured]) -> tuple[str, Measured]:
    """Return the geoms and the outcome of the worst verdict; of equal verdicts, the one farthest from reality."""
    return max(outcomes.items(), key=lambda item: (SEVERITY.index(item[1].verdict), item[1].deviation))


def _states_impact(subject: Subject, settings: Mapping[str, Any]) -> bool:
    """Return whether contacts have a rebound: one solref without it replaces an engine's restitution."""
    try:
        force = subject.measurements.in_force(subject.phenomenon.scenario, settings)
    except DeclinedError:
        return True
    if force.get("newton_material"):
        return False
    if "impact_steps" in force:
        # Genesis: without a recipe for impacts, all contacts have the damping of lasting ones.
        return force["impact_steps"] is not None or bool(force["sustained_dampratio"] < 1.0)
    solref = force.get("contact_solref")
    if solref is None:
        return True
    first, second = solref
    # In the direct format, minus stiffness and damping, the damping ratio is b / (2 sqrt(k)).
    ratio = second if first > 0.0 else -second / (2.0 * (-first) ** 0.5) if first < 0.0 else 1.0
    return bool(ratio < 1.0)
