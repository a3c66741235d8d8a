"""Run checks on a backend."""

from __future__ import annotations

import math
import pickle
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from gauge_envs.backends import Backend
from gauge_envs.backends import backend as find_backend
from gauge_envs.backends.registry import versions_of
from gauge_envs.errors import GaugeError
from gauge_envs.runs.isolation import CrashError, Worker
from gauge_envs.runs.rollout import DeclinedError, NotFiniteError, raised_at
from gauge_envs.tools.conformance.lab import Lab, RefusedSettingsError
from gauge_envs.tools.conformance.model import Check, CheckResult, Status
from gauge_envs.tools.conformance.registry import checks

FINITE = "finite"
"""Id of the check that reports states that are not finite."""

CHECK_LIMIT_S = 600.0
"""Default time limit of a check in another process [s]."""


@dataclass(frozen=True, kw_only=True)
class _Outcome:
    """What one run of a check gave.

    Attributes:
        fields: Fields of the result that depend on the run.
        is_finite: Whether all states were finite.
        settings: Settings in force.
        refusal: Why the backend refuses the settings; empty if it does not.
    """

    fields: Mapping[str, Any]
    is_finite: bool = True
    settings: Mapping[str, Any]
    refusal: str = ""


def run_checks(
    backend: Backend | str,
    *,
    settings: Mapping[str, Any] | None = None,
    only: Sequence[str] = (),
    worker: Worker | None = None,
) -> Iterator[CheckResult]:
    """Run checks on a backend and yield each result as its check ends.

    Args:
        backend: A backend, or the name of an installed one.
        settings: Numerical settings of the backend that replace its defaults, in every scene.
        only: Ids or patterns such as `cloth-*`; all checks when empty.
        worker: Another process, in which the checks of an installed backend run. An engine that crashes, exits or
            exceeds a limit then costs one check. With None, the checks run in this process.

    Raises:
        UnknownNameError: There is no such backend, or a pattern matches no check.
        MissingExtraError: The backend's engine is not installed.
        GaugeError: A backend cannot be imported in the other process.
        RefusedSettingsError: The backend refuses the settings; the iterator raises it.
    """
    chosen = checks(only)
    if worker is not None and isinstance(backend, str):
        task = pickle.dumps((backend, settings))
        try:
            versions = worker.call(versions_of, backend)
        except CrashError as error:
            raise CrashError(f"backend {backend!r} cannot be imported: {error}") from None
        return _results(backend, versions, lambda one: _outcome_there(worker, task, one), chosen)
    engine = find_backend(backend) if isinstance(backend, str) else backend
    lab = Lab(engine, settings)
    return _results(engine.name, engine.versions(), lambda one: _outcome(lab, one), chosen)


def _results(
    name: str, versions: Mapping[str, str], run: Callable[[Check], _Outcome], chosen: Sequence[Check]
) -> Iterator[CheckResult]:
    reported_by = ""
    for one in chosen:
        started = time.perf_counter()
        outcome = run(one)
        if outcome.refusal:
            raise RefusedSettingsError(outcome.refusal)
        fields = dict(outcome.fields)
        if not outcome.is_finite:
            if reported_by:
                fields |= {"diagnosis": f"not finite: see the check {reported_by!r}", "reported_by": reported_by}
            reported_by = reported_by or one.id
        yield CheckResult(
            check=one.id,
            backend=name,
            title=one.title,
            measures=one.measures,
            law=one.law,
            source=one.source,
            unit=one.unit,
            rationale=one.tolerance.rationale,
            wall_s=time.perf_counter() - started,
            settings=outcome.settings,
            versions=versions,
            **fields,
        )


def _outcome_there(worker: Worker, task: bytes, one: Check) -> _Outcome:
    """Return the outcome of a check in another process."""
    try:
        return worker.call(_outcome_of_task, task, one.id)
    except GaugeError as error:  # The process died, or the engine raised an error that no check expects.
        return _Outcome(fields={"status": Status.ERROR, "diagnosis": str(error)}, settings={})


def _outcome_of_task(task: bytes, name: str) -> _Outcome:
    (one,) = checks([name])
    return _outcome(_lab_of_task(task), one)


@cache
def _lab_of_task(task: bytes) -> Lab:
    """Return a lab that lasts as long as the process, so that checks share rollouts."""
    backend, settings = pickle.loads(task)
    return Lab(find_backend(backend), settings)


def _outcome(lab: Lab, one: Check) -> _Outcome:
    """Return the outcome of a check."""
    started_s = time.process_time()
    try:
        fields, is_finite = _measured(lab, one)
    except RefusedSettingsError as error:
        return _Outcome(fields={}, settings={}, refusal=str(error))
    fields["cpu_s"] = time.process_time() - started_s
    return _Outcome(fields=fields, is_finite=is_finite, settings=lab.settings_in_force)


def _measured(lab: Lab, one: Check) -> tuple[dict[str, Any], bool]:
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
        return {"status": Status.ERROR, "diagnosis": f"{type(error).__name__}: {error}{raised_at(error)}"}, finite
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
