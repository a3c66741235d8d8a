"""All checks, from simple to compound."""

from collections.abc import Sequence
from fnmatch import fnmatchcase

from gauge_envs.errors import UnknownNameError
from gauge_envs.tools.conformance import (
    batches,
    cloth,
    contract,
    drive,
    foam,
    forces,
    free_motion,
    grip,
    hinge,
    impact,
    rebound,
    rest,
    restart,
    rope,
    seams,
    slide,
)
from gauge_envs.tools.conformance.model import Check, Level

MODULES = (
    contract,
    free_motion,
    forces,
    hinge,
    restart,
    batches,
    slide,
    grip,
    seams,
    drive,
    rest,
    rebound,
    impact,
    cloth,
    foam,
    rope,
)
"""Modules of checks, from simple to compound."""

FIRST = (
    "determinism",
    "order-of-names",
    "start-position",
    "start-orientation",
    "contact-listed",
)
"""Checks that run first, since their failures make other results worthless."""


def checks(only: Sequence[str] = ()) -> tuple[Check, ...]:
    """Return all checks from simple to compound, or those whose id or level matches one of the patterns.

    Raises:
        UnknownNameError: A pattern matches no check.
    """
    listed = [check for module in MODULES for check in module.check.registered]

    def place(check: Check) -> tuple[int, bool, bool]:
        # A body that does not rest at its height does not slide or roll as it should.
        is_later = check.id != "rest-heights"
        first = FIRST.index(check.id) if check.id in FIRST else len(FIRST)
        return first, check.level is not Level.RIGID, is_later

    known = sorted(listed, key=place)
    chosen = []
    for pattern in only or ["*"]:
        matches = [
            check
            for check in known
            if check.level == pattern or fnmatchcase(check.id, pattern)
        ]
        if not matches:
            ids = [check.id for check in known]
            raise UnknownNameError("check", pattern, [*Level, *ids])
        chosen += matches
    return tuple(check for check in known if check in chosen)
