"""Workers of sweeps in the test process."""

import json
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import pytest

from gauge_envs.errors import GaugeError
from gauge_envs.runs.episodes import run_request
from gauge_envs.runs.result_file import load_result
from gauge_envs.runs.workers import Limits, ProcessWorker
from gauge_envs.tools.run.folder import earlier_outcomes, run_sweep
from gauge_envs.tools.run.plan import plan_runs, remaining_tasks
from gauge_envs.tools.run.spec import run_spec

needs_rapier = pytest.mark.skipif(
    find_spec("rapier3d") is None, reason="extra 'rapier' is absent"
)


class HereWorker:
    """A worker in this process that records its requests."""

    def __init__(self):
        self.requests = []

    def run(self, request):
        self.requests.append(request)
        return run_request(request)

    def close(self):
        pass

    kill = close


class Mortal:
    """A worker process that dies at one of the given seeds."""

    def __init__(self, *seeds):
        self._seeds = set(seeds)

    def call(self, function, request):
        if self._seeds & set(request.seeds):
            raise GaugeError("died")
        return function(request)

    def close(self):
        pass

    kill = close


def mortal_worker(*seeds):
    """Return a worker whose process dies at one of the given seeds."""
    worker = ProcessWorker(Limits())
    worker._process = Mortal(*seeds)  # type: ignore[assignment]
    return worker


def planned(**values):
    return plan_runs(run_spec({"variants": ["SlopeSlider-2-wood"]} | values))


def swept(plan, folder, *workers, retry_failed=False, notify=lambda text: None):
    """Run the rest of a plan as the command does, and return its results."""
    done = earlier_outcomes(folder, notify, without_failed=retry_failed)
    tasks = list(remaining_tasks(plan, done))
    return list(run_sweep(tasks, workers or [HereWorker()], folder))


def plain(result):
    """Return a result as JSON without its run times."""
    return json.dumps(replace(result, wall_s=None, cpu_s=None, created="").to_dict())


def contents(folder):
    """Return the results of a folder by file name."""
    return {file.name: plain(load_result(file)) for file in folder.glob("*.json")}


def outcomes(folder):
    """Return the outcomes of the files of a folder."""
    return sorted(earlier_outcomes(folder, pytest.fail).values())


def children(pid):
    """Return the child processes of all threads of a process."""
    files = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(word) for file in files for word in file.read_text().split()]
