"""Workers of a run: results keep their order, all workers end, and a lost machine loses one episode."""

import sys
import threading
from concurrent.futures import CancelledError
from contextlib import closing
from types import ModuleType, SimpleNamespace

import pytest
from sweep_workers import HereWorker, mortal_worker

from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome
from gauge_envs.runs.workers import Limits, run_tasks
from gauge_envs.tools.run.machines import RayWorker

WOOD = "SlopeSlider-2-wood"


class Closable(HereWorker):
    """A worker that counts how often it was closed."""

    closed = 0

    def close(self):
        self.closed += 1


@pytest.mark.parametrize("count", [1, 2, 5])
def test_results_have_the_order_of_the_tasks_and_an_error_ends_the_run(count):
    workers = [Closable() for _ in range(count)]
    done = run_tasks(range(20), workers, lambda worker, task: [task])
    assert list(done) == list(range(20))
    assert all(worker.closed for worker in workers)
    workers = [Closable() for _ in range(count)]
    with pytest.raises(ZeroDivisionError):
        list(run_tasks(range(20), workers, lambda worker, task: [1 / (task - 3)]))
    assert all(worker.closed for worker in workers)


def test_a_closed_run_kills_its_workers_and_starts_no_task():
    started = threading.Semaphore(0)
    killed = threading.Event()
    done = []

    class Slow(Closable):
        def kill(self):
            killed.set()

    def perform(worker, task):
        if task > 0:
            started.release()
            killed.wait()
        done.append(task)
        return [task]

    with closing(run_tasks(range(20), [Slow(), Slow()], perform)) as finished:
        assert next(finished) == 0
        # Both workers are in a task.
        started.acquire()
        started.acquire()
    assert sorted(done) == [0, 1, 2]


def test_repeats_that_fail_together_run_again_alone():
    results = mortal_worker(1).run(RunRequest(WOOD, repeats=3))
    outcomes = [result.outcome.value for result in results]
    assert outcomes == ["finished", "failed", "finished"]
    assert results[1].error == "died"


class RayError(Exception):
    """Error of a Ray call after the last loss of its actor."""


def test_a_request_fails_with_its_lost_actor_unless_the_run_ends(monkeypatch):
    def get(request):
        raise RayError("the machine is gone\nand more")

    run = SimpleNamespace(remote=lambda request: request)
    actor = SimpleNamespace(remote=lambda limits: SimpleNamespace(run=run))
    ray = ModuleType("ray")
    ray.remote = lambda **options: lambda kind: actor
    ray.get, ray.kill = get, lambda actor: None
    ray.exceptions = SimpleNamespace(RayError=RayError)
    monkeypatch.setitem(sys.modules, "ray", ray)
    worker = RayWorker(Limits())
    (result,) = worker.run(RunRequest(WOOD))
    assert result.outcome is Outcome.FAILED
    assert result.error.endswith("ended: the machine is gone")
    worker.kill()
    with pytest.raises(CancelledError):
        worker.run(RunRequest(WOOD))
