"""Workers and their tasks: the order of tasks, engines, losses, and the end of a run."""

from __future__ import annotations

import threading
from contextlib import closing
from dataclasses import dataclass
from types import ModuleType, SimpleNamespace

import pytest
from sweep_workers import HereWorker, mortal_worker

from gauge_envs.errors import GaugeError
from gauge_envs.runs.pool import (
    Limits,
    ProcessWorker,
    TaskQueue,
    WorkerClosedError,
    run_tasks,
)
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome
from gauge_envs.tools.sweep.machines import RayWorker

WOOD = "SlopeSlider-2-wood"


@dataclass(frozen=True)
class Step:
    """A task."""

    backend: str
    number: int = 0


def steps(backend, count):
    return [Step(backend, number) for number in range(count)]


# --- the order of tasks ---


def test_a_worker_stays_with_its_engine_and_keeps_the_order():
    queue = TaskQueue([*steps("a", 2), *steps("b", 2), Step("a", 2)])
    order, last = [], None
    while (task := queue.take(last)) is not None:
        last = task.backend
        order.append(task)
    assert order == [*steps("a", 3), *steps("b", 2)]


def test_workers_share_the_engines_and_then_the_rest_of_one():
    queue = TaskQueue([*steps("a", 1), *steps("b", 3)])
    first, second = queue.take(None), queue.take(None)
    assert first == Step("a") and second == Step("b")
    assert queue.take("a") == Step("b", 1)
    assert queue.take("b") == Step("b", 2)
    assert queue.take("b") is None


def test_a_cleared_queue_gives_nothing():
    queue = TaskQueue(steps("a", 3))
    queue.clear()
    assert queue.take(None) is None


# --- runs ---


class Place(HereWorker):
    """A worker that counts how often it was closed."""

    closed = 0

    def close(self):
        self.closed += 1


def test_every_task_is_done_once_on_any_number_of_workers():
    for count in (1, 2, 5):
        workers = [Place() for _ in range(count)]
        done = list(
            run_tasks(steps("a", 20), workers, lambda worker, task: task.number)
        )
        assert sorted(done) == list(range(20))
        assert all(worker.closed for worker in workers)


def test_an_error_ends_the_run_and_closes_the_workers():
    def perform(worker, task):
        if task.number == 3:
            raise ZeroDivisionError("a mistake in the program")
        return task.number

    for count in (1, 2):
        workers = [Place() for _ in range(count)]
        with pytest.raises(ZeroDivisionError, match="a mistake"):
            list(run_tasks(steps("a", 20), workers, perform))
        assert all(worker.closed for worker in workers)


def test_a_closed_run_waits_for_what_its_workers_do_and_starts_nothing_more():
    started = threading.Semaphore(0)
    go_on = threading.Event()
    done = []

    class Slow(Place):
        def close(self):
            super().close()
            go_on.set()

    def perform(worker, task):
        if task.number > 0:
            started.release()
            go_on.wait()
        done.append(task.number)
        return task.number

    workers = [Slow(), Slow()]
    with closing(run_tasks(steps("a", 20), workers, perform)) as finished:
        assert next(finished) == 0
        # Both workers are in a task.
        started.acquire()
        started.acquire()
    assert sorted(done) == [0, 1, 2]


# --- processes ---


def test_repeats_that_die_together_run_one_by_one():
    results = mortal_worker(1).run(
        RunRequest(WOOD, settings={"timestep_s": 1 / 360}, repeats=3)
    )
    assert [result.outcome.value for result in results] == [
        "finished",
        "failed",
        "finished",
    ]
    assert results[1].error == "died"


def test_a_worker_that_is_closed_while_it_runs_calls_nothing_a_failure():
    worker = mortal_worker(0)

    def closes(function, request):
        worker.close()
        raise GaugeError("died")

    worker._process.call = closes
    with pytest.raises(WorkerClosedError, match="closed"):
        worker.run(RunRequest(WOOD, repeats=4))


def test_a_closed_worker_starts_no_process():
    worker = ProcessWorker(Limits())
    worker.close()
    with pytest.raises(WorkerClosedError, match="closed"):
        worker.run(RunRequest(WOOD))
    assert worker._process._process is None


# --- Ray ---


class RayError(Exception):
    """What a Ray call raises when its actor is gone."""


class RayTaskError(RayError):
    """What a Ray call raises when its function did."""


@pytest.fixture
def ray(monkeypatch):
    """Return Ray whose first actors die in their first call."""

    def made(losses):
        left = [losses]

        class Actor:
            def __init__(self, limits):
                self.run = SimpleNamespace(remote=lambda request: request)

        def get(request):
            if left[0]:
                left[0] -= 1
                raise RayError("the machine is gone\nand more")
            return HereWorker().run(request)

        module = ModuleType("ray")
        module.remote = lambda **options: lambda kind: SimpleNamespace(remote=Actor)
        module.get = get
        module.kill = lambda actor: None
        module.exceptions = SimpleNamespace(
            RayError=RayError, RayTaskError=RayTaskError
        )
        monkeypatch.setitem(__import__("sys").modules, "ray", module)
        return module

    return made


@pytest.mark.parametrize("losses", [0, 2])
def test_a_lost_actor_costs_nothing(ray, losses):
    ray(losses)
    (result,) = RayWorker(Limits()).run(
        RunRequest(WOOD, settings={"timestep_s": 1 / 360})
    )
    assert result.outcome is Outcome.FINISHED


def test_a_request_that_always_loses_its_actor_fails(ray):
    ray(3)
    (result,) = RayWorker(Limits()).run(RunRequest(WOOD))
    assert result.outcome is Outcome.FAILED
    assert (
        result.error
        == "the Ray actor of the episode ended: the machine is gone, 3 times"
    )
