"""Register checks and find them by id."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase

from gauge_envs.errors import ParameterError, UnknownNameError
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.model import Check, Measurement, Tolerance

_CHECKS: dict[str, Check] = {}


def check(  # noqa: PLR0913  a check is all of these texts
    id: str,
    *,
    title: str,
    scene: str,
    measures: str,
    law: str,
    source: str,
    unit: str,
    tolerance: Tolerance,
    diagnosis: str,
) -> Callable[[Callable[[Lab], Measurement]], Callable[[Lab], Measurement]]:
    """Return a decorator that registers a function as a check; see `Check` for the arguments.

    Raises:
        ParameterError: A check with this id exists already.
    """

    def register(measure: Callable[[Lab], Measurement]) -> Callable[[Lab], Measurement]:
        if id in _CHECKS:
            raise ParameterError(f"check {id!r} exists already; choose another id")
        _CHECKS[id] = Check(
            id=id,
            title=title,
            scene=scene,
            measures=measures,
            law=law,
            source=source,
            unit=unit,
            tolerance=tolerance,
            diagnosis=diagnosis,
            measure=measure,
        )
        return measure

    return register


def checks(only: Sequence[str] = ()) -> tuple[Check, ...]:
    """Return all checks in a fixed order, or those whose id matches one of the patterns.

    Raises:
        UnknownNameError: A pattern matches no check.
    """
    for pattern in only:
        if not any(fnmatchcase(name, pattern) for name in _CHECKS):
            raise UnknownNameError("check", pattern, _CHECKS)
    chosen = (one for name, one in _CHECKS.items() if not only or any(fnmatchcase(name, p) for p in only))
    return tuple(chosen)
