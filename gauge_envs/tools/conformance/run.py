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
from gauge_envs.runs.isolation import CrashError, Worker
from gauge_envs.tools.bench.recording import DeclinedError, NotFiniteError, raised_at
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
        backend: An engine, or the name of an installed one.
        settings: Numerical settings of the engine that replace its defaults, in every scene.
        only: Ids or patterns such as `cloth-*`; all checks when empty.
        worker: Another process, in which the checks of an installed engine run. An engine that crashes, exits or
            exceeds a limit then costs one check. With None, the checks run in this process.

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
        run = lambda one: _run_there(worker, task, one, versions)  # noqa: E731
    else:
        engine = find_backend(backend) if isinstance(backend, str) else backend
        versions = checked_versions(engine)
        lab = Lab(engine, settings)
        run = lambda one: run_check(lab, one)  # noqa: E731
    return _results(run, chosen, dict(versions))


def _results(
    run: Callable[[Check], CheckResult],
    chosen: Sequence[Check],
    versions: Mapping[str, str],
) -> Iterator[CheckResult]:
    for one in chosen:
        started_s = time.perf_counter()
        result = run(one)
        wall_s = time.perf_counter() - started_s
        yield replace(result, versions=versions, wall_s=wall_s)


def _run_there(
    worker: Worker, task: bytes, one: Check, versions: Mapping[str, str]
) -> CheckResult:
    """Run a check in another process."""
    name, _ = pickle.loads(task)
    try:
        values = worker.call(_run_of_task, task, one.id)
    except GaugeError as error:  # The process died, or the engine raised an error that no check expects.
        return CheckResult(
            of=one, backend=name, status=Status.ERROR, diagnosis=str(error)
        )
    return CheckResult(of=one, **values)


def _run_of_task(task: bytes, name: str) -> dict[str, Any]:
    """Return the fields of a result but its check, which cannot be pickled."""
    (one,) = checks([name])
    result = run_check(_lab_of_task(task), one)
    return {key: value for key, value in vars(result).items() if key != "of"}


@cache
def _lab_of_task(task: bytes) -> Lab:
    """Return a lab that lasts as long as the process, so that checks share recordings."""
    backend, settings = pickle.loads(task)
    return Lab(find_backend(backend), settings)


def run_check(lab: Lab, one: Check) -> CheckResult:
    """Run one check in a lab."""
    started_s = time.process_time()
    result = CheckResult(of=one, backend=lab.backend.name, status=Status.ERROR)
    try:
        found = one.measure(lab)
        lab.check_scenes()
    except DeclinedError as declined:
        result = replace(result, status=Status.DECLINED, missing=declined.missing)
    except KeyboardInterrupt:
        raise
    # Whatever an engine raises is a result, and the next check may still pass; a panic of Rust is no `Exception`.
    except BaseException as error:
        result = replace(result, diagnosis=_error_text(error))
    else:
        expected, measured = float(found.expected), float(found.measured)
        width = one.tolerance.width(expected) if found.width is None else found.width
        passed = math.isfinite(measured) and abs(measured - expected) <= width
        result = replace(
            result,
            status=Status.PASS if passed else Status.FAIL,
            expected=expected,
            measured=measured,
            width=width,
            diagnosis="" if passed else _message(found.hint, one.cause),
        )
    cpu_s = time.process_time() - started_s
    return replace(result, cpu_s=cpu_s, settings=lab.settings_in_force)


def _message(hint: str, cause: str) -> str:
    """Return what a failure shows, and its most likely cause where the hint does not explain it."""
    return hint if ":" in hint else "; ".join(filter(None, (hint, cause)))


def _error_text(error: BaseException) -> str:
    """Return what an engine did wrong; states that are not finite are named first."""
    if isinstance(error, NotFiniteError):
        return f"not finite: {error}"
    if isinstance(error, ContractError):
        return str(error)
    return f"{type(error).__name__}: {error}{raised_at(error)}"
