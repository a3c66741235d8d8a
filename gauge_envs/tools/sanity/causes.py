"""Find the cause of a finding: what follows from a wrong joint or body is part of that finding."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from gauge_envs.tools.sanity.target_checks import READ
from gauge_envs.tools.sanity.verdict import SanityResult, SanityVerdict, Severity

EFFECTS = {
    "robot-holds": "its state diverges",
    "robot-torque": "its motors do not hold it",
    "robot-stands": "it falls or jumps",
    "model-overlap": "bodies are crushed",
    "model-constraints": "joints leave their ranges",
    "model-slip": "it creeps where friction holds",
    "model-hop": "it hops",
    "model-creep": "it creeps at rest",
    "model-spin": "it turns by itself in flight",
    "robot-energy": "it gains energy",
}
"""What follows from a wrong joint or body, by the check that shows it."""

HARMLESS = (
    "gravity",
    "stated-rolling",
    "stated-friction",
    "stated-margin",
    "stated-solref",
    "command-range",
    "imu-frame",
)
"""Static rules whose warnings explain no motion at rest."""

READ_IDS = {check.id for check in READ}

CAUSES = READ_IDS | {"robot-torque"}
"""Checks that explain later ones."""


def absorb(results: Sequence[SanityResult]) -> list[SanityResult]:
    """Return results in which a finding has its effects, and each effect its cause.

    A finding of what is read explains later ones on the same elements, and all runs of the model. An effect that is an
    error makes its cause one. Advice explains nothing: what is unusual need not be the cause of what the run shows.
    """
    found: dict[str, SanityResult] = {}
    for result in results:
        cause = next(
            (cause for cause in found.values() if _explains(cause, result)), None
        )
        found[result.id] = result
        if cause is None:
            continue
        found[result.id] = replace(result, cause=cause.id)
        effects = [*cause.effects, EFFECTS.get(result.id, "")]
        is_error = SanityVerdict.FAILED in (cause.verdict, result.verdict)
        found[cause.id] = replace(
            cause,
            effects=tuple(filter(None, effects)),
            verdict=SanityVerdict.FAILED if is_error else cause.verdict,
        )
    return [*found.values()]


def causes_first(flags: Sequence[SanityResult]) -> list[SanityResult]:
    """Return findings by stage and severity; advice that may be the cause stands in front of what the run shows."""
    order = [*Severity]

    def rank(flag: SanityResult) -> tuple[int, int]:
        stage = 2 * (flag.id not in READ_IDS)
        if flag.severity is Severity.ADVICE:
            stage = 3 if stage or flag.id in HARMLESS else 1
        return stage, -order.index(flag.severity)

    return sorted(flags, key=rank)


def _explains(cause: SanityResult, effect: SanityResult) -> bool:
    """Return whether a finding explains a later one."""
    if not (cause.id in CAUSES and cause.is_flag and effect.is_flag):
        return False
    is_slight = cause.verdict is SanityVerdict.WARNING
    if cause.is_usual or (is_slight and cause.id in HARMLESS):
        return False
    if cause.id == "range-unit" and effect.id.startswith("start-"):
        return True
    if effect.id not in EFFECTS:
        names = {part.name for part in cause.parts if part.verdict.is_off}
        return any(part.name in names for part in effect.parts if part.verdict.is_off)
    return True
