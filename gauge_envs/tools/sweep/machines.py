"""Workers on the machines of a Ray cluster."""

import os
from concurrent.futures import CancelledError
from typing import Any

from gauge_envs.errors import GaugeError, ParameterError, needs_extra
from gauge_envs.runs.episodes import results_without_run
from gauge_envs.runs.pool import Limits, ProcessWorker
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome, Result

MAX_LOSSES = 3
"""Actors that a request may lose before it counts as failed."""


class RayWorker:
    """A worker in an actor of a Ray cluster, which keeps its engine.

    Inside, a `ProcessWorker` runs the requests: an engine that crashes costs its episode there, as on one machine. If
    the actor itself dies, as with its machine, the request runs again in a new one, which Ray places where there is
    room.

    Args:
        limits: Limits of the process.
    """

    def __init__(self, limits: Limits) -> None:
        import ray

        self._ray = ray
        self._limits = limits
        self._class = ray.remote(num_cpus=1, max_restarts=0)(ProcessWorker)
        self._actor: Any = None
        self._is_killed = False

    def run(self, request: RunRequest) -> list[Result]:
        """Return the results of a request."""
        cause = ""
        for _ in range(MAX_LOSSES):
            if self._is_killed:
                raise CancelledError
            if self._actor is None:
                self._actor = self._class.remote(self._limits)
            try:
                return list(self._ray.get(self._actor.run.remote(request)))
            except self._ray.exceptions.RayTaskError as error:
                raise GaugeError(f"a Ray actor raised an error: {error}") from error
            except self._ray.exceptions.RayError as error:
                self._actor = None
                cause = str(error).partition("\n")[0]
        reason = f"the Ray actor of the episode ended: {cause}, {MAX_LOSSES} times"
        return results_without_run(request, Outcome.FAILED, reason)

    def kill(self) -> None:
        """End the actor at once and for good."""
        self._is_killed = True
        self.close()

    def close(self) -> None:
        """End the actor."""
        actor, self._actor = self._actor, None
        if actor is not None:
            self._ray.kill(actor)


def ray_workers(address: str, count: int | None, limits: Limits) -> list[RayWorker]:
    """Connect to a Ray cluster and return its workers, one for each of its processors by default.

    Args:
        address: `local` starts Ray on this machine; `auto` takes the cluster that this machine is part of; else the
            address of a cluster.
        count: Number of workers, or None.
        limits: Limits of their processes.
    """
    with needs_extra("a sweep on many machines", "ray"):
        import ray
    options: dict[str, Any] = {
        "address": address,
        "log_to_driver": False,
        "logging_level": "ERROR",
    }
    if address == "local":
        # Ray on this machine alone needs no token, and would write one into the home folder.
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
