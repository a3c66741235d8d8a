"""Lanes on the machines of a Ray cluster, for `gauge-envs[ray]`."""

from __future__ import annotations

import os
from typing import Any

from gauge_envs.errors import GaugeError, MissingExtraError, ParameterError
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Result
from gauge_envs.tools.sweep.lanes import LaneLostError, Limits, WorkerLane


class RayLane:
    """A lane in an actor of a Ray cluster. The actor keeps its engine, and serves an experiment at a time.

    Inside, a `WorkerLane` runs the tasks: an engine that crashes costs its episode there, as on one machine. If the
    actor itself dies, as with its machine, the next task gets a new one, which Ray places where there is room.

    Args:
        limits: Limits of the process.
    """

    def __init__(self, limits: Limits) -> None:
        import ray

        self._ray = ray
        self._limits = limits
        self._class = ray.remote(num_cpus=1, max_restarts=0)(WorkerLane)
        self._actor: Any = None

    def run(self, request: RunRequest) -> list[Result]:
        """Return the results of a request."""
        if self._actor is None:
            self._actor = self._class.remote(self._limits)
        try:
            results: list[Result] = self._ray.get(self._actor.run.remote(request))
        except self._ray.exceptions.RayTaskError as error:
            raise GaugeError(f"a Ray actor raised an error: {error}") from error
        except self._ray.exceptions.RayError as error:
            self._actor = None
            first_line = str(error).partition("\n")[0]
            raise LaneLostError(f"the Ray actor of the episode ended: {first_line}") from error
        return results

    def close(self) -> None:
        """End the actor."""
        actor, self._actor = self._actor, None
        if actor is not None:
            self._ray.kill(actor)


def ray_lanes(address: str, count: int | None, limits: Limits) -> list[RayLane]:
    """Connect to a Ray cluster and return its lanes, one for each of its processors by default.

    Args:
        address: `local` starts Ray on this machine; `auto` takes the cluster that this machine is part of; else the
            address of a cluster.
        count: Number of lanes, or None.
        limits: Limits of their processes.
    """
    try:
        import ray
    except ImportError as error:
        raise MissingExtraError("a sweep on many machines", "ray", error) from error
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    if address == "local":
        # Ray on this machine alone needs no token, and would write one into the home folder.
        os.environ.setdefault("RAY_AUTH_MODE", "disabled")
        options |= {"address": "local", "include_dashboard": False, "num_cpus": count}
    else:
        options["address"] = address
    try:
        ray.init(**options)
    except (ConnectionError, RuntimeError, ValueError, OSError) as error:
        raise ParameterError(f"--ray {address}: {str(error).partition(chr(10))[0]}") from error
    return [RayLane(limits) for _ in range(count or max(1, int(ray.cluster_resources().get("CPU", 1))))]
