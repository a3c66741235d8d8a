"""All checks in their order, causes before effects: what is read, then what runs show; their choice by patterns."""

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase

from gauge_envs.errors import UnknownNameError
from gauge_envs.tools.sanity.model_checks import at_rest, ground, joints, runs
from gauge_envs.tools.sanity.model_checks.check import ModelCheck
from gauge_envs.tools.sanity.object_checks import OBJECT_CHECKS
from gauge_envs.tools.sanity.object_checks.measure import Measurements, object_result
from gauge_envs.tools.sanity.static_rules import STATIC_RULES
from gauge_envs.tools.sanity.verdict import SanityResult, TrainingConfiguration

READ: tuple[ModelCheck, ...] = (
    ground.gravity,
    *STATIC_RULES,
    ground.feet,
    joints.joint_brakes,
    joints.servo_response,
)
"""Checks that simulate nothing."""

RUN: tuple[ModelCheck, ...] = (
    runs.holds,
    ground.holding_force,
    ground.stands,
    at_rest.overlap,
    at_rest.constraints,
    at_rest.slip,
    at_rest.hop,
    ground.foot_creep,
    ground.grasp_creep,
    at_rest.creep,
    runs.spin,
    runs.energy,
    runs.solver,
)
"""Checks of runs of the target's own model."""

TARGET_CHECKS: Mapping[str, ModelCheck] = {check.id: check for check in (*READ, *RUN)}
"""Checks of the target's own model, which run none of the suite's experiments, by their id."""


def selection(only: Sequence[str] = ()) -> tuple[str, ...]:
    """Return ids of checks in a fixed order: all, or those that match a pattern.

    Args:
        only: Ids or patterns such as `creep-*`, also several in a text with commas; all when empty.

    Raises:
        UnknownNameError: A pattern matches no check.
    """
    known: tuple[str, ...] = (*TARGET_CHECKS, *OBJECT_CHECKS)
    patterns = [part.strip() for text in only or ["*"] for part in text.split(",")]
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in known):
            raise UnknownNameError("check", pattern, known)
    return tuple(
        name
        for name in known
        if any(fnmatchcase(name, pattern) for pattern in patterns)
    )


def check_result(
    measurements: Measurements, configuration: TrainingConfiguration, name: str
) -> SanityResult:
    """Return the result of a check for a target, by its id."""
    if name in TARGET_CHECKS:
        return TARGET_CHECKS[name].result(configuration)
    return object_result(measurements, configuration, name)
