"""Workers on the machines of a Ray cluster, and jobs of Slurm."""

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gauge_envs.errors import (
    GaugeError,
    ParameterError,
    ResultFileError,
    needs_extra,
)
from gauge_envs.files import os_errors, write_whole
from gauge_envs.runs.episodes import not_run, planned_results
from gauge_envs.runs.pool import Limits, ProcessWorker, WorkerClosedError
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
        self._is_closed = False

    def run(self, request: RunRequest) -> list[Result]:
        """Return the results of a request."""
        cause = ""
        for _ in range(MAX_LOSSES):
            if self._is_closed:
                raise WorkerClosedError("the worker is closed")
            if self._actor is None:
                self._actor = self._class.remote(self._limits)
            try:
                results: list[Result] = self._ray.get(self._actor.run.remote(request))
            except self._ray.exceptions.RayTaskError as error:
                raise GaugeError(f"a Ray actor raised an error: {error}") from error
            except self._ray.exceptions.RayError as error:
                self._actor = None
                cause = str(error).partition("\n")[0]
            else:
                return results
        reason = f"the Ray actor of the episode ended: {cause}, {MAX_LOSSES} times"
        return not_run(planned_results(request), Outcome.FAILED, reason)

    def close(self) -> None:
        """End the actor for good."""
        self._is_closed = True
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
        raise ParameterError(
            f"--ray {address}: {str(error).partition(chr(10))[0]}"
        ) from error
    return [
        RayWorker(limits)
        for _ in range(count or max(1, int(ray.cluster_resources().get("CPU", 1))))
    ]


SCRIPT = '''"""Submit a sweep to Slurm as one job array: python {name}

Each job runs one part of the plan. Run the script again to continue: jobs skip what is there. To try it on this
machine: python {name} --cluster local
"""

import argparse
import subprocess

import submitit

JOBS = {jobs}
COMMAND = {command}


def run_part(number: int) -> int:
    """Run one part; exit code 1 states that an episode failed or diverged, which the results show."""
    return subprocess.run([*COMMAND, "--shard", f"{{number}}/{{JOBS}}"], check=False).returncode


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--cluster", help="slurm, local for processes of this machine, or debug for this process")
    parser.add_argument("--partition")
    parser.add_argument("--hours", type=float, default=24.0, help="time limit of a job")
    parser.add_argument("--cpus", type=int, default={cpus}, help="processors of a job")
    parser.add_argument("--memory-gb", type=float, default={memory_gb}, help="memory of a job")
    given = parser.parse_args()
    executor = submitit.AutoExecutor(folder={log_folder}, cluster=given.cluster)
    executor.update_parameters(
        name="gauge-sweep",
        timeout_min=round(60 * given.hours),
        cpus_per_task=given.cpus,
        mem_gb=given.memory_gb,
        slurm_array_parallelism=JOBS,
    )
    if given.partition:
        executor.update_parameters(slurm_partition=given.partition)
    jobs = executor.map_array(run_part, range(JOBS))
    print(f"{{JOBS}} jobs; the first is {{jobs[0].job_id}}")
    if executor.cluster in ("local", "debug"):
        # A debug job runs when its result is asked for.
        print("exit codes:", [job.result() for job in jobs])
'''


def slurm_script(
    name: str, arguments: Sequence[str], *, jobs: int, workers: int, log_folder: Path
) -> str:
    """Return the text of the script.

    Args:
        name: Its file name.
        arguments: Arguments of `gauge sweep` that state the sweep, without those of the script.
        jobs: Jobs of the array.
        workers: Worker processes of a job.
        log_folder: Folder for what the jobs print.
    """
    command = [
        sys.executable,
        "-c",
        "from gauge_command import main; main()",
        "sweep",
        *arguments,
    ]
    return SCRIPT.format(
        name=name,
        jobs=jobs,
        command=command,
        cpus=workers,
        memory_gb=4.0 * workers,
        log_folder=repr(str(log_folder)),
    )


def write_slurm_script(file: Path, text: str) -> None:
    """Write the script."""
    with os_errors(
        lambda cause: ResultFileError(f"{file}: cannot be written: {cause}")
    ):
        write_whole(file, text.encode())
