"""Run checks on a backend."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from gauge_envs.backends import Backend
from gauge_envs.backends import backend as find_backend
from gauge_envs.checks.conformance.lab import Lab, RefusedSettingsError
from gauge_envs.checks.conformance.model import Check, CheckResult, Status
from gauge_envs.checks.conformance.registry import checks
from gauge_envs.checks.rollout import DeclinedError, NotFiniteError

__all__ = ["run_checks"]

FINITE = "finite"
"""Id of the check that reports states that are not finite."""


def run_checks(
    backend: Backend | str, *, settings: Mapping[str, Any] | None = None, only: Sequence[str] = ()
) -> Iterator[CheckResult]:
    """Run checks on a backend and yield each result as its check ends.

    Args:
        backend: A backend, or the name of an installed one.
        settings: Numerical settings of the backend that replace its defaults, in every scene.
        only: Ids or patterns such as `cloth-*`; all checks when empty.

    Raises:
        UnknownNameError: There is no such backend, or a pattern matches no check.
        MissingExtraError: The backend's engine is not installed.
        RefusedSettingsError: The backend refuses the settings; the iterator raises it.
    """
    engine = find_backend(backend) if isinstance(backend, str) else backend
    return _results(engine, Lab(engine, settings), checks(only))


def _results(engine: Backend, lab: Lab, chosen: Sequence[Check]) -> Iterator[CheckResult]:
    versions = engine.versions()
    reported_by = ""
    for one in chosen:
        started = time.perf_counter()
        outcome, finite = _outcome(lab, one)
        if not finite:
            if reported_by:
                outcome |= {"diagnosis": f"not finite: see the check {reported_by!r}", "reported_by": reported_by}
            reported_by = reported_by or one.id
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


def _outcome(lab: Lab, one: Check) -> tuple[dict[str, Any], bool]:
    """Return the fields of a result that depend on the run, and whether all states were finite."""
    try:
        measurement = one.measure(lab)
    except DeclinedError as declined:
        return {"status": Status.DECLINED, "missing": declined.missing}, True
    except RefusedSettingsError:
        raise
    # Any exception of a backend is a result, and the next check may still pass.
    except Exception as error:
        finite = not isinstance(error, NotFiniteError)
        return {"status": Status.ERROR, "diagnosis": f"{type(error).__name__}: {error}"}, finite
    expected, measured = float(measurement.expected), float(measurement.measured)
    width = one.tolerance.width(expected)
    passed = math.isfinite(measured) and abs(measured - expected) <= width
    text = "; ".join(part for part in (measurement.hint, one.diagnosis) if part)
    return {
        "status": Status.PASS if passed else Status.FAIL,
        "expected": expected,
        "measured": measured,
        "width": width,
        "diagnosis": "" if passed else text,
    }, not (math.isnan(measured) and not measurement.hint) and not (one.id == FINITE and not passed)
