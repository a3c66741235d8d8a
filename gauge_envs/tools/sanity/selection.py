"""All checks in their order: their choice by patterns, and the result of one."""

from collections.abc import Sequence
from fnmatch import fnmatchcase

from gauge_envs.errors import UnknownNameError
from gauge_envs.tools.sanity.object_checks import OBJECT_CHECKS
from gauge_envs.tools.sanity.object_checks.measure import Measurements, object_result
from gauge_envs.tools.sanity.target_checks import TARGET_CHECKS
from gauge_envs.tools.sanity.training import TrainingConfiguration
from gauge_envs.tools.sanity.verdict import SanityResult


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
