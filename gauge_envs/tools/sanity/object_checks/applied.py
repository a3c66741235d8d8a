"""Apply checks of measured objects to a target: to each set of contact constants for which they mean something."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from gauge_envs.tools.sanity.object_checks import GRASP, object_check
from gauge_envs.tools.sanity.object_checks.check import ObjectCheck
from gauge_envs.tools.sanity.object_checks.measure import Measurements
from gauge_envs.tools.sanity.robot.robot import Settings
from gauge_envs.tools.sanity.training import Need, TrainingConfiguration
from gauge_envs.tools.sanity.verdict import (
    NotApplicableError,
    PartOutcome,
    SanityResult,
    SanityVerdict,
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
class AppliedCheck:
    """A check of measured objects and the settings of each set of contact constants.

    Attributes:
        measurements: Measurements on the backend.
        check: The check.
        sets: Settings by the geoms that touch with them; only sets that the check applies to.
        inapplicable: Why the check does not apply to the target; empty when it does.
        advisory: Why the verdict does not count; empty when it does.
    """

    measurements: Measurements
    check: ObjectCheck
    sets: Sets
    inapplicable: str = ""
    advisory: str = ""

    def outcomes(self) -> dict[str, PartOutcome]:
        """Return the outcome with each set.

        Raises:
            TimeLimitError: The time is used up.
        """
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
        """Return the result of the worst set, with that of the preset where a set does not pass.

        Raises:
            TimeLimitError: The time is used up.
        """
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
        rollout = self.measurements.rollout(self.check.scenario, self.sets[geoms])
        if not isinstance(rollout, PartOutcome):
            # A rollout that diverges fails even where the check is advice.
            result = replace(result, advisory=self.advisory)
        verdicts = {outcome.verdict for outcome in outcomes.values()}
        if verdicts == {SanityVerdict.PASSED}:
            return result
        preset = self.measurements.measure(self.check, {})
        # A scene that the engine cannot simulate at all is not checked.
        is_unknown = {worst.verdict, preset.verdict} == {SanityVerdict.NOT_MEASURED}
        return replace(
            result,
            default=preset.value,
            default_verdict=preset.verdict,
            applies=not is_unknown,
        )


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
    check = own_check = object_check(name)
    foot = configuration.foot_geometry
    if foot is not None and Need.FOOT in check.needs:
        own_check = object_check(name, foot)
    try:
        for need in check.all_needs:
            if need in configuration.inapplicable:
                raise NotApplicableError(configuration.inapplicable[need])
        sets = _sets_of(configuration, check)
    except NotApplicableError as error:
        return AppliedCheck(measurements, check, {}, inapplicable=str(error))
    applied = AppliedCheck(measurements, own_check, sets)
    if not check.is_impact:
        return applied
    if reason := configuration.inapplicable.get(Need.REBOUND):
        return replace(applied, advisory=reason)
    bouncing = {
        geoms: settings
        for geoms, settings in sets.items()
        if _has_rebound(measurements.effective(own_check.scenario, settings))
    }
    if bouncing:
        return replace(applied, sets=bouncing)
    return replace(applied, advisory=NO_IMPACT)


def _sets_of(configuration: TrainingConfiguration, check: ObjectCheck) -> Sets:
    """Return the sets of contact constants that a check applies to.

    Raises:
        NotApplicableError: There is none; the message is the reason.
    """
    contacts: TrainingConfiguration | None = configuration
    if check.id in GRASP:
        contacts = configuration.of_hand(is_flat=check.id == "grasp-torsion")
    if contacts is None:
        raise NotApplicableError(
            "round fingertips: their torsional friction alone holds a torque"
        )
    sets: Sets = contacts.contact_sets
    if Need.FOOT in check.needs:
        foot = configuration.foot_geometry
        if foot is None:
            raise NotApplicableError(NO_ROBOT)
        sets = {geoms: sets[geoms] for geoms in sets if geoms in foot.sets}
        if not sets:
            raise NotApplicableError("the chosen geoms are no foot on the ground")
    if not check.touches:
        sets = dict([*sets.items()][:1])
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
