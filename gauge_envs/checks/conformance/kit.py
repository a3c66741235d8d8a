"""What a check is, how it becomes known, and how it is run on a backend."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from fnmatch import fnmatchcase
from typing import Any

from gauge_envs.backends import Backend
from gauge_envs.backends import backend as find_backend
from gauge_envs.checks.conformance.lab import Lab, RefusedSettingsError
from gauge_envs.checks.rollout import DeclinedError
from gauge_envs.errors import ParameterError, UnknownNameError
from gauge_envs.files import json_ready

__all__ = [
    "Check",
    "CheckResult",
    "Tolerance",
    "Measurement",
    "Status",
    "check",
    "checks",
    "run_checks",
]


class Status(StrEnum):
    """What became of a check."""

    PASS = "pass"
    """Measured within the pass mark."""
    FAIL = "fail"
    """Measured outside of it, or not a finite number."""
    DECLINED = "declined"
    """The backend says that it cannot build the scene; not a failure."""
    ERROR = "error"
    """The backend raised an exception."""


@dataclass(frozen=True, kw_only=True)
class Tolerance:
    """How far from the law a measured value may be: `absolute + relative * |expected|`, the same for every engine.

    Attributes:
        rationale: Why it is this wide; a reason of physics or of the benchmark, never of an engine.
        absolute: Part in the unit of the measured value.
        relative: Part as a share of the expected value.
    """

    rationale: str
    absolute: float = 0.0
    relative: float = 0.0

    def width(self, expected: float) -> float:
        """Largest admissible distance from an expected value, in its unit."""
        return self.absolute + self.relative * abs(expected)


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """What a check measured.

    Attributes:
        measured: The measured value.
        expected: What the law says, in the same unit.
        hint: What this value in particular points to, for the diagnosis; empty where nothing does.
    """

    measured: float
    expected: float
    hint: str = ""


@dataclass(frozen=True, kw_only=True)
class Check:
    """One law that a backend must obey, measured by one number.

    Attributes:
        id: Stable name.
        title: What it is about, in a few words.
        measures: What is measured, and how.
        law: The formula that gives the expected value.
        source: Where the law is from.
        unit: Unit of the measured value; "1" for a pure number.
        tolerance: How far from the law a backend may be.
        diagnosis: Where to look when it fails.
        measure: Measures it; builds its scene through the `Lab` that it gets.
    """

    id: str
    title: str
    measures: str
    law: str
    source: str
    unit: str
    tolerance: Tolerance
    diagnosis: str
    measure: Callable[[Lab], Measurement]


@dataclass(frozen=True, kw_only=True)
class CheckResult:
    """What became of one check on one backend.

    Attributes:
        check: Id of the check.
        backend: Name of the backend.
        status: Pass, fail, declined or error.
        title: As in the check.
        measures: As in the check.
        law: As in the check.
        source: As in the check.
        unit: As in the check.
        expected: What the law says; None where nothing was measured.
        measured: What was measured; None where nothing was. May be infinite or NaN, which fails.
        width: Largest admissible difference of the two; None where nothing was measured.
        rationale: Why the tolerance is that wide.
        diagnosis: Where to look, when it failed; the exception's text for an error; empty otherwise.
        missing: What the backend says it lacks, when it declined.
        wall_s: Time that the check took [s]; checks that share a run count it once.
        settings: Numerical settings in force in the check's scenes; those of the last where there are several.
        versions: Versions of the engine's packages.
    """

    check: str
    backend: str
    status: Status
    title: str
    measures: str
    law: str
    source: str
    unit: str
    rationale: str
    expected: float | None = None
    measured: float | None = None
    width: float | None = None
    diagnosis: str = ""
    missing: tuple[str, ...] = ()
    wall_s: float = 0.0
    settings: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)

    @property
    def is_bad(self) -> bool:
        """Whether it counts as a failure of the backend."""
        return self.status in (Status.FAIL, Status.ERROR)

    def to_dict(self) -> dict[str, Any]:
        """All attributes, JSON-ready; null stands for a number that is not finite."""
        values: dict[str, Any] = json_ready(asdict(self))
        return values | {"status": self.status.value}


_CHECKS: dict[str, Check] = {}


def check(
    id: str,
    *,
    title: str,
    measures: str,
    law: str,
    source: str,
    unit: str,
    tolerance: Tolerance,
    diagnosis: str,
) -> Callable[[Callable[[Lab], Measurement]], Callable[[Lab], Measurement]]:
    """Decorator that makes a function a check; see `Check` for the arguments.

    Raises:
        ParameterError: A check of that id exists already.
    """

    def register(measure: Callable[[Lab], Measurement]) -> Callable[[Lab], Measurement]:
        if id in _CHECKS:
            raise ParameterError(f"check {id!r} exists already")
        _CHECKS[id] = Check(
            id=id,
            title=title,
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
    """All checks in a fixed order, or those whose id matches one of the patterns.

    Raises:
        UnknownNameError: A pattern matches no check.
    """
    for pattern in only:
        if not any(fnmatchcase(name, pattern) for name in _CHECKS):
            raise UnknownNameError("check", pattern, _CHECKS)
    chosen = (one for name, one in _CHECKS.items() if not only or any(fnmatchcase(name, p) for p in only))
    return tuple(chosen)


def run_checks(
    backend: Backend | str, *, settings: Mapping[str, Any] | None = None, only: Sequence[str] = ()
) -> Iterator[CheckResult]:
    """Run checks on a backend, each finding as its check ends.

    Args:
        backend: A backend, or the name of an installed one.
        settings: Numerical settings of the backend that replace its defaults, in every scene.
        only: Ids or patterns as `cloth-*`; all checks when empty.

    Raises:
        UnknownNameError: No such backend, or a pattern matches no check.
        MissingExtraError: The backend's engine is not installed.
        RefusedSettingsError: The backend refuses the settings; raised by the iterator.
    """
    engine = find_backend(backend) if isinstance(backend, str) else backend
    return _results(engine, Lab(engine, settings), checks(only))


def _results(engine: Backend, lab: Lab, chosen: Sequence[Check]) -> Iterator[CheckResult]:
    versions = engine.versions()
    for one in chosen:
        started = time.perf_counter()
        outcome = _outcome(lab, one)
        yield CheckResult(
            check=one.id,
            backend=engine.name,
            title=one.title,
            measures=one.measures,
            law=one.law,
            source=one.source,
            unit=one.unit,
            rationale=one.tolerance.rationale,
            wall_s=time.perf_counter() - started,
            settings=lab.settings_in_force,
            versions=versions,
            **outcome,
        )


def _outcome(lab: Lab, one: Check) -> dict[str, Any]:
    """The fields of a finding that depend on the run."""
    try:
        reading = one.measure(lab)
    except DeclinedError as declined:
        return {"status": Status.DECLINED, "missing": declined.missing}
    except RefusedSettingsError:
        raise
    # Whatever a backend raises is a finding about that backend, and the next check may still be fine.
    except Exception as error:
        return {"status": Status.ERROR, "diagnosis": f"{type(error).__name__}: {error}"}
    expected, measured = float(reading.expected), float(reading.measured)
    width = one.tolerance.width(expected)
    passed = math.isfinite(measured) and abs(measured - expected) <= width
    text = "; ".join(part for part in (reading.hint, one.diagnosis) if part)
    return {
        "status": Status.PASS if passed else Status.FAIL,
        "expected": expected,
        "measured": measured,
        "width": width,
        "diagnosis": "" if passed else text,
    }
