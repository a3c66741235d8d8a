"""Lanes: places that run one task after another, each in a process that keeps its engine.

What runs in a lane is the same function everywhere, so results have the same bits in one process, in many and on other
machines.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

from gauge_envs.errors import GaugeError
from gauge_envs.runs.batch import attempt, not_run, planned_results
from gauge_envs.runs.isolation import TIME_LIMIT_S, Worker
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome, Result


class LaneLostError(GaugeError, RuntimeError):
    """A lane ended through no fault of its task, as the machine that it was on; the task can run again."""


@dataclass(frozen=True)
class Limits:
    """Limits of the processes of lanes.

    Attributes:
        time_limit_s: Time limit of a task [s].
        memory_limit_gb: Limit of the resident memory of a process [GB], on Linux; None: no limit.
        isolate: Whether each task has a process of its own.
    """

    time_limit_s: float = TIME_LIMIT_S
    memory_limit_gb: float | None = None
    isolate: bool = False


class Lane(Protocol):
    """A place that runs one task after another."""

    def run(self, request: RunRequest) -> list[Result]:
        """Return the results of a request, in the order of its seeds; those without a trajectory hold the reason."""

    def close(self) -> None:
        """End the lane, also while another thread waits in `run`."""


class WorkerLane:
    """A lane in another process of this machine. A process serves one engine; the next engine gets a new one.

    Args:
        limits: Limits of the process.
    """

    def __init__(self, limits: Limits) -> None:
        self._worker = Worker(limits.time_limit_s, limits.memory_limit_gb, single_thread=True)
        self._isolate = limits.isolate
        self._backend = ""
        self._is_closed = False

    def run(self, request: RunRequest) -> list[Result]:
        """Return the results of a request; an episode that ends the process is `failed`, with the cause."""
        if self._backend != request.backend:
            self._worker.close()
            self._backend = request.backend
        try:
            return self._worker.call(run_request, request)
        except GaugeError as error:
            if self._is_closed:
                raise LaneLostError("the lane is closed") from error
            if request.repeats == 1:
                return not_run(planned_results(request), Outcome.FAILED, str(error))
        finally:
            if self._isolate:
                self._worker.close()
        # One of the worlds ended the process. Each runs on its own, so that only that one is lost.
        seeds = range(request.seed, request.seed + request.repeats)
        return [result for seed in seeds for result in self.run(replace(request, seed=seed, repeats=1))]

    def close(self) -> None:
        """End the process for good."""
        self._is_closed = True
        self._worker.close()


def run_request(request: RunRequest) -> list[Result]:
    """Return the results of a request; those that were declined or failed hold the reason.

    Args:
        request: The request, with the jitter that applies.
    """
    return attempt(request, planned_results(request))[0]
