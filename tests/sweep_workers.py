"""Workers of sweeps in the process of the tests."""

import json
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import pytest

from gauge_envs.errors import GaugeError
from gauge_envs.runs.episodes import run_request
from gauge_envs.runs.pool import Limits, ProcessWorker
from gauge_envs.runs.result import Outcome
from gauge_envs.runs.result_file import load_result
from gauge_envs.tools.sweep.folder import earlier_outcomes, run_sweep
from gauge_envs.tools.sweep.plan import plan_sweep, remaining_tasks
from gauge_envs.tools.sweep.spec import sweep_spec

needs_rapier = pytest.mark.skipif(
    find_spec("rapier3d") is None, reason="extra 'rapier' is absent"
)


class HereWorker:
    """A worker in this process, which counts what it runs."""

    def __init__(self):
        self.requests = []

    def run(self, request):
        self.requests.append(request)
        return run_request(request)

    def close(self):
        pass

    kill = close


class Mortal:
    """A worker process that dies where one of some seeds runs."""

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
    """A worker whose process dies where one of some seeds runs."""
    worker = ProcessWorker(Limits())
    worker._process = Mortal(*seeds)  # type: ignore[assignment]
    return worker


def planned(**values):
    return plan_sweep(sweep_spec({"variants": ["SlopeSlider-2-wood"]} | values))


def swept(plan, folder, *workers, retry_failed=False, notify=lambda text: None):
    """The results of what is left of a plan, as the command runs it."""
    done = {
        name
        for name, outcome in earlier_outcomes(folder, notify).items()
        if not (retry_failed and outcome is Outcome.FAILED)
    }
    tasks = list(remaining_tasks(plan, done))
    return list(run_sweep(tasks, workers or [HereWorker()], folder))


def plain(result):
    """A result without the times of its making, to the last bit."""
    return json.dumps(replace(result, wall_s=None, cpu_s=None, created="").to_dict())


def contents(folder):
    """The results of a folder by file name; each must be complete."""
    return {file.name: plain(load_result(file)) for file in folder.glob("*.json")}


def outcomes(folder):
    """The outcomes that the files of a folder state."""
    return sorted(earlier_outcomes(folder, pytest.fail).values())


def children(pid):
    """Processes that any thread of a process has started."""
    files = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(word) for file in files for word in file.read_text().split()]
