"""Run checks on an engine."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from gauge_envs.backends import Backend, backend as find_backend
from gauge_envs.backends.registry import checked_versions, versions_of
from gauge_envs.errors import GaugeError
from gauge_envs.fixtures.recording import NotFiniteError, UnsupportedError, raised_at
from gauge_envs.runs.workers import CrashError, TimeLimitError, Worker
from gauge_envs.tools.conformance.catalog import checks
from gauge_envs.tools.conformance.lab import (
    ContractError,
    Lab,
    Measurement,
    RejectedSettingsError,
)
from gauge_envs.tools.conformance.model import Check, CheckResult, Status

Settings = Mapping[str, Any] | None


def run_checks(
    backend: Backend | str,
    *,
    settings: Settings = None,
    only: Sequence[str] = (),
    worker: Worker | None = None,
) -> Iterator[CheckResult]:
    """Run checks on an engine and yield each result as its check ends.

    Args:
        backend: An engine, or the name of an installed engine.
        settings: Numerical settings of the engine that replace its defaults, in every scene.
        only: Ids or patterns such as `cloth-*`; all checks when empty.
        worker: Another process, in which the checks of an installed engine run. An engine that crashes, exits or
            exceeds a limit then loses one check. With None, the checks run in this process.

    Raises:
        UnknownNameError: There is no such engine, or a pattern matches no check.
        MissingExtraError: The engine is not installed.
        GaugeError: An engine cannot be imported in the other process, or its `versions` returns no versions.
    """
    chosen = checks(only)
    run: Callable[[Check], CheckResult]
    if worker is not None and isinstance(backend, str):
        versions = _versions_there(worker, backend)
        run = partial(_run_there, worker, backend, settings)
    else:
        engine = find_backend(backend) if isinstance(backend, str) else backend
        versions = dict(checked_versions(engine))
        run = partial(run_check, Lab(engine, settings))
    return (replace(run(check), versions=versions) for check in chosen)


# --- in another process ----------------------------------------------------------------------------------------------


def _versions_there(worker: Worker, backend: str) -> Mapping[str, str]:
    """Import an engine in another process, and return its versions."""
    try:
        return worker.call(versions_of, backend)
    except CrashError as error:
        raise CrashError(f"backend {backend!r} cannot be imported: {error}") from None


def _run_there(
    worker: Worker, backend: str, settings: Settings, check: Check
) -> CheckResult:
    """Run a check in another process."""
    try:
        return worker.call(_run_here, backend, settings, check)
    except GaugeError as error:  # The process died, or the engine raised an error.
        return CheckResult(
            of=check,
            backend=backend,
            status=Status.ERROR,
            diagnosis=str(error),
            is_unfinished=isinstance(error, TimeLimitError),
        )


_labs: dict[str, Lab] = {}
"""Labs of this process by engine and settings. They last, so that checks share recordings."""


def _run_here(backend: str, settings: Settings, check: Check) -> CheckResult:
    """Run a check in the lab of this process."""
    key = f"{backend} {settings}"
    if key not in _labs:
        _labs[key] = Lab(find_backend(backend), settings)
    return run_check(_labs[key], check)


# --- one check -------------------------------------------------------------------------------------------------------


def run_check(lab: Lab, check: Check) -> CheckResult:
    """Run one check in a lab."""
    result = CheckResult(of=check, backend=lab.backend.name, status=Status.ERROR)
    try:
        measurement = check.measure(lab)
        lab.check_scenes()
    except UnsupportedError as reason:
        result = replace(
            result,
            status=Status.UNSUPPORTED,
            missing=reason.missing,
            rejects_settings=isinstance(reason, RejectedSettingsError),
        )
    except KeyboardInterrupt:
        raise
    # Any error of an engine is a result, and the next check may still pass. A panic of Rust is not an `Exception`.
    except BaseException as error:
        result = replace(result, diagnosis=f"{_error_text(error)}{lab.last_scene()}")
    else:
        result = _judged(result, measurement)
    return replace(result, settings=lab.effective_settings)


def _judged(result: CheckResult, measurement: Measurement) -> CheckResult:
    """Return a result with a measurement and its verdict."""
    expected, measured = float(measurement.expected), float(measurement.measured)
    width = measurement.width
    if width is None:
        width = result.of.tolerance.width(expected)
    passed = math.isfinite(measured) and abs(measured - expected) <= width
    judged = replace(
        result,
        status=Status.PASS if passed else Status.FAIL,
        expected=expected,
        measured=measured,
        width=width,
    )
    if passed:
        return replace(judged, diagnosis=measurement.hint if judged.is_narrow else "")
    return replace(judged, diagnosis=_diagnosis(measurement, result.of.cause))


def _diagnosis(measurement: Measurement, usual_cause: str) -> str:
    """Return the meaning of a failure, and its cause: that of the measurement, or the most likely one of the check."""
    separator = ": " if measurement.cause else "; "
    cause = measurement.cause or usual_cause
    return separator.join(filter(None, (measurement.hint, cause)))


def _error_text(error: BaseException) -> str:
    """Return the mistake of an engine as text."""
    if isinstance(error, NotFiniteError):
        return f"not finite: {error}"
    if isinstance(error, ContractError):
        return str(error)
    return f"{type(error).__name__}: {error}{raised_at(error)}"
