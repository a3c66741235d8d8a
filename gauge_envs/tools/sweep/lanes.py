"""Lanes: places that run one task after another, each in a process that keeps its engine; and jobs of Slurm.

What runs in a lane is the same function everywhere, so results have the same bits in one process, in many and on other
machines.
"""

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from gauge_envs.errors import GaugeError, MissingExtraError, ParameterError, ResultFileError
from gauge_envs.files import os_errors, write_whole
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


# --- the machines of a Ray cluster, for gauge-envs[ray] ---


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


def slurm_script(name: str, arguments: Sequence[str], *, jobs: int, workers: int, log_folder: Path) -> str:
    """Return the text of the script.

    Args:
        name: Its file name.
        arguments: Arguments of `gauge sweep` that state the sweep, without those of the script.
        jobs: Jobs of the array.
        workers: Worker processes of a job.
        log_folder: Folder for what the jobs print.
    """
    command = [sys.executable, "-c", "from gauge_command import main; main()", "sweep", *arguments]
    return SCRIPT.format(
        name=name, jobs=jobs, command=command, cpus=workers, memory_gb=4.0 * workers, log_folder=repr(str(log_folder))
    )


def write_slurm_script(file: Path, text: str) -> None:
    """Write the script."""
    with os_errors(lambda cause: ResultFileError(f"{file}: cannot be written: {cause}")):
        write_whole(file, text.encode())
