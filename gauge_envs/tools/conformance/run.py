"""Run checks on an engine."""

import math
import pickle
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

from gauge_envs.backends import Backend, backend as find_backend
from gauge_envs.backends.registry import checked_versions, versions_of
from gauge_envs.errors import GaugeError
from gauge_envs.fixtures.recording import NotFiniteError, UnsupportedError, raised_at
from gauge_envs.runs.workers import CrashError, Worker
from gauge_envs.tools.conformance.lab import ContractError, Lab
from gauge_envs.tools.conformance.model import Check, CheckResult, Status, checks


def run_checks(
    backend: Backend | str,
    *,
    settings: Mapping[str, Any] | None = None,
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
    if worker is not None and isinstance(backend, str):
        task = pickle.dumps((backend, settings))
        try:
            versions = worker.call(versions_of, backend)
        except CrashError as error:
            raise CrashError(
                f"backend {backend!r} cannot be imported: {error}"
            ) from None
        run = lambda check: _run_there(worker, task, check, versions)  # noqa: E731
    else:
        engine = find_backend(backend) if isinstance(backend, str) else backend
        versions = checked_versions(engine)
        lab = Lab(engine, settings)
        run = lambda check: run_check(lab, check)  # noqa: E731
    return _results(run, chosen, dict(versions))


def _results(
    run: Callable[[Check], CheckResult],
    chosen: Sequence[Check],
    versions: Mapping[str, str],
) -> Iterator[CheckResult]:
    for check in chosen:
        started_s = time.perf_counter()
        result = run(check)
        wall_s = time.perf_counter() - started_s
        yield replace(result, versions=versions, wall_s=wall_s)


def _run_there(
    worker: Worker, task: bytes, check: Check, versions: Mapping[str, str]
) -> CheckResult:
    """Run a check in another process."""
    name, _ = pickle.loads(task)
    try:
        values = worker.call(_run_of_task, task, check.id)
    except GaugeError as error:  # The process died, or the engine raised an error.
        return CheckResult(
            of=check, backend=name, status=Status.ERROR, diagnosis=str(error)
        )
    return CheckResult(of=check, **values)


def _run_of_task(task: bytes, name: str) -> dict[str, Any]:
    """Return the fields of a result except its check, which cannot be pickled."""
    (check,) = checks([name])
    result = run_check(_lab_of_task(task), check)
    return {key: value for key, value in vars(result).items() if key != "of"}


@cache
def _lab_of_task(task: bytes) -> Lab:
    """Return a lab that lasts as long as the process, so that checks share recordings."""
    backend, settings = pickle.loads(task)
    return Lab(find_backend(backend), settings)


def run_check(lab: Lab, check: Check) -> CheckResult:
    """Run one check in a lab."""
    started_s = time.process_time()
    result = CheckResult(of=check, backend=lab.backend.name, status=Status.ERROR)
    try:
        measurement = check.measure(lab)
        lab.check_scenes()
    except UnsupportedError as reason:
        result = replace(result, status=Status.UNSUPPORTED, missing=reason.missing)
    except KeyboardInterrupt:
        raise
    # Any error of an engine is a result, and the next check may still pass. A panic of Rust is not an `Exception`.
    except BaseException as error:
        result = replace(result, diagnosis=_error_text(error))
    else:
        expected, measured = float(measurement.expected), float(measurement.measured)
        width = measurement.width
        if width is None:
            width = check.tolerance.width(expected)
        passed = math.isfinite(measured) and abs(measured - expected) <= width
        result = replace(
            result,
            status=Status.PASS if passed else Status.FAIL,
            expected=expected,
            measured=measured,
            width=width,
            diagnosis="" if passed else _message(measurement.hint, check.cause),
        )
    cpu_s = time.process_time() - started_s
    return replace(result, cpu_s=cpu_s, settings=lab.effective_settings)


def _message(hint: str, cause: str) -> str:
    """Return the hint of a failure, and the most likely cause if the hint does not explain it."""
    return hint if ":" in hint else "; ".join(filter(None, (hint, cause)))


def _error_text(error: BaseException) -> str:
    """Return the mistake of an engine as text."""
    if isinstance(error, NotFiniteError):
        return f"not finite: {error}"
    if isinstance(error, ContractError):
        return str(error)
    return f"{type(error).__name__}: {error}{raised_at(error)}"
