"""A script that submits a sweep to Slurm as one job array, with submitit."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from gauge_envs.errors import ResultFileError
from gauge_envs.files import os_errors, write_whole

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
        name=name,
        jobs=jobs,
        command=command,
        cpus=workers,
        memory_gb=4.0 * workers,
        log_folder=repr(str(log_folder)),
    )


def write_slurm_script(file: Path, text: str) -> None:
    """Write the script."""
    with os_errors(lambda cause: ResultFileError(f"{file}: cannot be written: {cause}")):
        write_whole(file, text.encode())
