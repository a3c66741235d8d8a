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
from gauge_envs.tools.conformance.model import Check

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
    "rest-heights",
)
"""Checks that run first, since their failures make other results worthless."""


def checks(only: Sequence[str] = ()) -> tuple[Check, ...]:
    """Return all checks from simple to compound, or those whose id matches one of the patterns.

    Raises:
        UnknownNameError: A pattern matches no check.
    """
    listed = [check for module in MODULES for check in module.check.registered]
    order = {name: place for place, name in enumerate(FIRST)}
    known = sorted(listed, key=lambda check: order.get(check.id, len(order)))
    ids = [check.id for check in known]
    chosen: set[str] = set()
    for pattern in only or ["*"]:
        matches = [name for name in ids if fnmatchcase(name, pattern)]
        if not matches:
            raise UnknownNameError("check", pattern, ids)
        chosen.update(matches)
    return tuple(check for check in known if check.id in chosen)
