"""Run checks on a backend."""

import math
import pickle
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from statistics import median
from typing import Any, NamedTuple

from gauge_envs.backends import Backend, backend as find_backend
from gauge_envs.backends.registry import versions_of
from gauge_envs.errors import GaugeError
from gauge_envs.runs.isolation import CrashError, Worker
from gauge_envs.tools.bench.recording import (
    DeclinedError,
    NotFiniteError,
    Recording,
    raised_at,
)
from gauge_envs.tools.conformance.facts import facts
from gauge_envs.tools.conformance.lab import DisturbedLab, Lab, RefusedSettingsError
from gauge_envs.tools.conformance.model import (
    Check,
    CheckResult,
    Measurement,
    Outcome,
    Status,
    checks,
    texts_of_checks,
)
from gauge_envs.tools.conformance.torques import UNITS

FINITE = "finite"
"""Id of the check that reports states that are not finite."""

CHECK_LIMIT_S = 600.0
"""Default time limit of a check in another process [s]."""


class _Run(NamedTuple):
    """One run of a check.

    Attributes:
        outcome: What it gave; None if the backend refuses the settings.
        is_finite: Whether all states were finite.
        settings: Settings in force.
        refusal: Why the backend refuses the settings; empty if it does not.
    """

    outcome: Outcome | None
    is_finite: bool = True
    settings: Mapping[str, Any] = {}
    refusal: str = ""


def run_checks(
    backend: Backend | str,
    *,
    settings: Mapping[str, Any] | None = None,
    only: Sequence[str] = (),
    worker: Worker | None = None,
    eliminates: bool | None = None,
) -> Iterator[CheckResult]:
    """Run checks on a backend and yield each result as its check ends.

    Args:
        backend: A backend, or the name of an installed one.
        settings: Numerical settings of the backend that replace its defaults, in every scene.
        only: Ids or patterns such as `cloth-*`; all checks when empty.
        worker: Another process, in which the checks of an installed backend run. An engine that crashes, exits or
            exceeds a limit then costs one check. With None, the checks run in this process.
        eliminates: Whether the elementary checks run after the first failure until one of them fails, and its
            diagnosis says which; None where all checks run.

    Raises:
        UnknownNameError: There is no such backend, or a pattern matches no check.
        MissingExtraError: The backend's engine is not installed.
        GaugeError: A backend cannot be imported in the other process.
        RefusedSettingsError: The backend refuses the settings; the iterator raises it.
    """
    chosen = checks(only)
    if eliminates is None:
        eliminates = not only
    if worker is not None and isinstance(backend, str):
        task = pickle.dumps((backend, settings))
        try:
            versions = worker.call(versions_of, backend)
        except CrashError as error:
            raise CrashError(
                f"backend {backend!r} cannot be imported: {error}"
            ) from None
        return _results(
            backend,
            versions,
            lambda one: _run_there(worker, task, one),
            chosen,
            eliminates,
        )
    engine = find_backend(backend) if isinstance(backend, str) else backend
    lab = Lab(engine, settings)
    return _results(
        engine.name,
        engine.versions(),
        lambda one: _run(lab, one),
        chosen,
        eliminates,
    )


def _results(
    name: str,
    versions: Mapping[str, str],
    run: Callable[[Check], _Run],
    chosen: Sequence[Check],
    eliminates: bool,
) -> Iterator[CheckResult]:
    reported_by, is_told = "", False
    run = cache(run)
    for one in chosen:
        started = time.perf_counter()
        outcome, is_finite, settings, refusal = run(one)
        if outcome is None:
            raise RefusedSettingsError(refusal)
        if not is_finite:
            if reported_by:
                diagnosis = f"not finite: see the check {reported_by!r}"
                outcome = replace(outcome, diagnosis=diagnosis, reported_by=reported_by)
            reported_by = reported_by or one.id
        elif eliminates and outcome.status in (Status.FAIL, Status.ERROR):
            tried, is_found = _eliminated(one.id, run)
            if is_found or not is_told:
                outcome = replace(outcome, diagnosis=f"{outcome.diagnosis}. {tried}")
            eliminates, is_told = not is_found, True
        fields = vars(outcome) | {"wall_s": time.perf_counter() - started}
        yield CheckResult(
            of=one, backend=name, settings=settings, versions=versions, **fields
        )


def _eliminated(failed: str, run: Callable[[Check], _Run]) -> tuple[str, bool]:
    """Run elementary checks until one fails; return what was tried and is left as the cause, and whether one failed.

    Args:
        failed: Id of the check that failed.
        run: Function that runs a check.
    """
    passed: list[str] = []
    texts, simplest, found = texts_of_checks(), failed, "No simpler check fails."

    def outcome_of(name: str) -> Outcome | None:
        return run(*checks([name])).outcome

    for name in texts["elementary"]:
        if name == failed:
            break
        if not _may_show(name, failed):
            continue
        outcome = outcome_of(name)
        if outcome is None or outcome.status is Status.DECLINED:
            continue
        if outcome.status is not Status.PASS:
            simplest = name
            found = f"The simplest that fails is {name}: {outcome.diagnosis}"
            found += _common(outcome_of(failed), outcome)
            break
        passed.append(name)
    for fails, passes, left in texts["left"]:
        first, *others = fails.split()
        wanted = dict.fromkeys(others, Status.FAIL) | dict.fromkeys(
            passes.split(), Status.PASS
        )
        if first in (failed, simplest) and all(
            getattr(outcome_of(name), "status", None) is status
            for name, status in wanted.items()
        ):
            pattern = "; ".join(f"{name}: {one}" for name, one in wanted.items())
            found += f"{'' if found.endswith('.') else '.'} Left ({pattern}): {left}."
            break
    return f"{_tried(passed)}{found}", simplest != failed


def _common(*outcomes: Outcome | None) -> str:
    """Return which constants explain all of some failures on hinges; empty where one of them has one cause."""
    texts = [one.diagnosis for one in outcomes if one is not None]
    causes = [{name for name in UNITS if f"the {name} were" in text} for text in texts]
    common = set.intersection(*causes)
    if not common or min(map(len, causes)) == 1:
        return ""
    return f". Both are explained by: {', '.join(sorted(common))}"


def _tried(passed: Sequence[str]) -> str:
    """Return the sentence on the elementary checks that pass."""
    if not passed:
        return ""
    return f"Tried: {passed[0]} to {passed[-1]} ({len(passed)} checks) pass. "


def _may_show(name: str, failed: str) -> bool:
    """Return whether a check has the kind of deformable body of one that failed; those of batches may follow others."""
    kind, kind_of_failed = (
        one if one in ("cloth", "foam", "rope", "rod", "air", "worlds") else ""
        for one in (name.split("-")[0], failed.split("-")[0])
    )
    return kind == kind_of_failed or (kind_of_failed == "worlds" and not kind)


def _run_there(worker: Worker, task: bytes, one: Check) -> _Run:
    """Run a check in another process."""
    try:
        return worker.call(_run_of_task, task, one.id)
    except GaugeError as error:  # The process died, or the engine raised an error that no check expects.
        return _Run(Outcome(status=Status.ERROR, diagnosis=str(error)))


def _run_of_task(task: bytes, name: str) -> _Run:
    (one,) = checks([name])
    return _run(_lab_of_task(task), one)


@cache
def _lab_of_task(task: bytes) -> Lab:
    """Return a lab that lasts as long as the process, so that checks share rollouts."""
    backend, settings = pickle.loads(task)
    return Lab(find_backend(backend), settings)


def _run(lab: Lab, one: Check) -> _Run:
    started_s = time.process_time()
    is_finite = True
    lab.rollouts.clear()
    try:
        found = one.measure(lab)
        width = _width(lab, one, found)
    except DeclinedError as declined:
        outcome = Outcome(status=Status.DECLINED, missing=declined.missing)
    except RefusedSettingsError as error:
        return _Run(None, refusal=str(error))
    except KeyboardInterrupt:
        raise
    # Whatever a backend raises is a result, and the next check may still pass; a panic of Rust is no `Exception`.
    except BaseException as error:
        is_finite = not isinstance(error, NotFiniteError)
        outcome = Outcome(
            status=Status.ERROR,
            diagnosis=f"{type(error).__name__}: {error}{raised_at(error)}",
        )
    else:
        outcome = _judged(one, found, width, lab.rollouts)
        is_finite = not (math.isnan(found.measured) and not found.hint)
        is_finite &= one.id != FINITE or outcome.status is Status.PASS
    outcome = replace(outcome, cpu_s=time.process_time() - started_s)
    return _Run(outcome, is_finite, lab.settings_in_force)


def _width(lab: Lab, one: Check, found: Measurement) -> float:
    """Return how far a measurement may be from what is expected, also where an engine declares that runs part.

    Then a disturbed measurement says how far each part may be off; see `Repeatability`. As it has the engine's scatter
    too, the median part may be half as far off: the disturbance is then shown to be larger than the scatter. The width
    is what the part that comes closest to its limit leaves to the whole.
    """
    width = one.tolerance.width(float(found.expected))
    declared, again = lab.backend.repeatability(lab.settings), one.tolerance.again
    repeats = declared.kind == "bits" or (declared.kind, again) == ("run", "simulation")
    if not again or repeats or not found.measured > width:
        return width
    disturbed = one.measure(DisturbedLab(lab, declared.start_error))
    parts = found.parts or {"": found.measured}
    limits = disturbed.parts or {"": disturbed.measured}
    shares = [
        value / (declared.start_error + 10.0 * limits[name])
        for name, value in parts.items()
    ]
    sizes = [
        value / (0.5 * limits[name])
        for name, value in parts.items()
        if value > 0.0 and limits[name] > 0.0
    ]
    share = max(*shares, median(sizes) if sizes else 0.0)
    # Disturbed runs that diverge allow nothing.
    return max(width, found.measured / share) if share > 0.0 else width


def _judged(
    one: Check, found: Measurement, width: float, rollouts: Sequence[Recording]
) -> Outcome:
    """Return the outcome of a measurement that may be as far as `width` from what is expected.

    What its rollouts show for certain takes the place of the likely causes of the check.
    """
    expected, measured = float(found.expected), float(found.measured)
    passed = math.isfinite(measured) and abs(measured - expected) <= width
    diagnosis = ""
    if not passed:
        certain = found.cause or next(filter(None, map(facts, rollouts)), "")
        diagnosis = "; ".join(filter(None, (found.hint, certain or one.diagnosis)))
    return Outcome(
        status=Status.PASS if passed else Status.FAIL,
        expected=expected,
        measured=measured,
        width=width,
        diagnosis=diagnosis,
    )
