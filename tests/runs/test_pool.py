"""Workers and their tasks: the order of results, losses, and the end of a run."""

from __future__ import annotations

import threading
from contextlib import closing
from types import ModuleType, SimpleNamespace

import pytest
from sweep_workers import HereWorker, mortal_worker

from gauge_envs.runs.pool import Limits, run_tasks
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome
from gauge_envs.tools.sweep.machines import RayWorker

WOOD = "SlopeSlider-2-wood"


class Place(HereWorker):
    """A worker that counts how often it was closed."""

    closed = 0

    def close(self):
        self.closed += 1


@pytest.mark.parametrize("count", [1, 2, 5])
def test_results_come_in_the_order_of_the_tasks(count):
    workers = [Place() for _ in range(count)]
    done = run_tasks(range(20), workers, lambda worker, task: task)
    assert list(done) == list(range(20))
    assert all(worker.closed for worker in workers)


@pytest.mark.parametrize("count", [1, 2])
def test_an_error_ends_the_run_and_closes_the_workers(count):
    workers = [Place() for _ in range(count)]
    with pytest.raises(ZeroDivisionError):
        list(run_tasks(range(20), workers, lambda worker, task: 1 / (task - 3)))
    assert all(worker.closed for worker in workers)


def test_a_closed_run_kills_its_workers_and_starts_nothing_more():
    started = threading.Semaphore(0)
    killed = threading.Event()
    done = []

    class Slow(Place):
        def kill(self):
            killed.set()

    def perform(worker, task):
        if task > 0:
            started.release()
            killed.wait()
        done.append(task)
        return task

    with closing(run_tasks(range(20), [Slow(), Slow()], perform)) as finished:
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
