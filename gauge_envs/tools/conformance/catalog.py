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
    rest,
    restart,
    rope,
    seams,
    slide,
)
from gauge_envs.tools.conformance.model import Check

MODULES = [
    contract.check,
    free_motion.check,
    forces.check,
    hinge.check,
    restart.check,
    batches.check,
    slide.check,
    grip.check,
    seams.check,
    drive.check,
    rest.check,
    impact.check,
    cloth.check,
    foam.check,
    rope.check,
]
"""Checks of each module."""

FIRST = ("determinism", "contact-listed")
"""Checks that run first, since their failures make other results worthless."""


def checks(only: Sequence[str] = ()) -> tuple[Check, ...]:
    """Return all checks from simple to compound, or those whose id matches one of the patterns.

    Raises:
        UnknownNameError: A pattern matches no check.
    """
    listed = [check for module in MODULES for check in module.registered]
    known = sorted(listed, key=lambda check: check.id not in FIRST)
    ids = [check.id for check in known]
    for pattern in only:
        if not any(fnmatchcase(name, pattern) for name in ids):
            raise UnknownNameError("check", pattern, ids)
    return tuple(
        check
        for check in known
        if not only or any(fnmatchcase(check.id, pattern) for pattern in only)
    )
