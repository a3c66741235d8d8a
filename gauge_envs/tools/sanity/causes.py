"""Find the cause of a finding: what follows from a wrong joint or body is part of that finding."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from gauge_envs.tools.sanity.static_rules import STATIC_RULES
from gauge_envs.tools.sanity.verdict import SanityResult, SanityVerdict

EFFECTS = {
    "robot-holds": "its state diverges",
    "robot-torque": "its motors do not hold it",
    "robot-stands": "it falls or jumps",
    "robot-drive": "its servos do not follow",
    "robot-joint": "its joints are braked",
    "model-overlap": "bodies are crushed",
    "model-constraints": "joints leave their ranges",
    "model-slip": "it creeps where friction holds",
    "model-creep": "it creeps at rest",
    "model-spin": "it turns by itself in flight",
    "robot-energy": "it gains energy",
    "model-solver": "the solver does not converge",
}
"""What follows from a wrong joint or body, by the check that shows it."""

HARMLESS = ("stated-rolling", "stated-friction", "stated-margin", "imu-frame")
"""Static rules that explain no motion at rest."""


def absorb(results: Sequence[SanityResult]) -> list[SanityResult]:
    """Return results in which a finding has its effects, and each effect its cause.

    A static rule explains later static rules on the same elements, and all runs of the model. An effect that is an
    error makes its cause one.
    """
    found: dict[str, SanityResult] = {}
    read = {check.id for check in STATIC_RULES}
    for result in results:
        found[result.id] = result
        if result.id not in read | EFFECTS.keys() or not result.is_flag:
            continue
        cause = next(
            (cause for cause in found.values() if _explains(cause, result, read)), None
        )
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


def _explains(cause: SanityResult, effect: SanityResult, read: set[str]) -> bool:
    """Return whether a finding explains a later one."""
    is_cause = cause.id in read and cause.is_flag and cause.id != effect.id
    if not is_cause or cause.id in HARMLESS:
        return False
    if cause.id == "range-unit" and effect.id.startswith("start-"):
        return True
    if effect.id not in EFFECTS:
        names = {part.name for part in cause.parts}
        return not names.isdisjoint(part.name for part in effect.parts)
    return True
