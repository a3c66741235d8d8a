"""Workers on the machines of a Ray cluster."""

import os
from concurrent.futures import CancelledError
from typing import Any

from gauge_envs.errors import ParameterError
from gauge_envs.optional import needs_extra
from gauge_envs.runs.episodes import results_without_run
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.runs.workers import Limits, ProcessWorker

MAX_RETRIES = 2
"""Number of times that a request runs again after the loss of its actor."""


class RayWorker:
    """A worker in an actor of a Ray cluster; the actor keeps its engine.

    The actor runs requests in a `ProcessWorker`: a crash of the engine loses only its episode. If the actor or its
    machine dies, Ray runs the request again on any free machine.

    Args:
        limits: Limits of the process.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._actor: Any = None
        self._is_killed = False

    def run(self, request: RunRequest) -> list[Result]:
        """Return the results of a request."""
        import ray

        if self._actor is None:
            remote = ray.remote(
                num_cpus=1, max_restarts=-1, max_task_retries=MAX_RETRIES
            )
            self._actor = remote(ProcessWorker).remote(self._limits)
        try:
            return list(ray.get(self._actor.run.remote(request)))
        except ray.exceptions.RayError as error:
            if self._is_killed:
                raise CancelledError from error
            cause = str(error).partition("\n")[0]
        reason = f"the Ray actor of the episode ended: {cause}"
        return results_without_run(request, Outcome.FAILED, reason)

    def kill(self) -> None:
        """End the actor immediately, without a replacement."""
        self._is_killed = True
        self.close()

    def close(self) -> None:
        """End the actor."""
        import ray

        if self._actor is not None:
            ray.kill(self._actor)


def ray_workers(address: str, count: int | None, limits: Limits) -> list[RayWorker]:
    """Connect to a Ray cluster and return its workers.

    Args:
        address: `local` starts Ray on this machine; `auto` uses the cluster of this machine; otherwise the address of
            a cluster.
        count: Number of workers; None for one per processor.
        limits: Limits of the worker processes.
    """
    with needs_extra("a sweep on many machines", "ray"):
        import ray
    options: dict[str, Any] = {
        "address": address,
        "log_to_driver": False,
        "logging_level": "ERROR",
    }
    if address == "local":
        # Local Ray needs no token; without this variable it writes one into the home folder.
        os.environ.setdefault("RAY_AUTH_MODE", "disabled")
        options |= {"include_dashboard": False, "num_cpus": count}
    try:
        ray.init(**options)
    except (ConnectionError, RuntimeError, ValueError, OSError) as error:
        raise ParameterError(
            f"--ray {address}: {str(error).partition(chr(10))[0]}"
        ) from error
    return [
        RayWorker(limits)
        for _ in range(count or int(ray.cluster_resources().get("CPU", 1)))
    ]
