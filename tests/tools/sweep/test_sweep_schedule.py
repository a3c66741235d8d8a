"""The order of tasks: lanes stay with an experiment and an engine, and share what is left."""

from __future__ import annotations

import threading
from typing import cast

from gauge_envs.tools.sweep.plan import SweepRun, SweepTask
from gauge_envs.tools.sweep.session import Schedule


class Run:
    """As much of a run as a schedule reads."""

    def __init__(self, backend: str, experiment: str) -> None:
        self.group = (backend, experiment)


def tasks(*groups: tuple[str, str], count: int = 3) -> list[SweepTask]:
    return [SweepTask(cast(SweepRun, Run(*group)), range(seed, seed + 1)) for group in groups for seed in range(count)]


def test_a_lane_completes_its_experiment_and_then_its_engine() -> None:
    schedule = Schedule(tasks(("a", "x"), ("b", "x"), ("a", "y")))
    order, last = [], None
    while (task := schedule.take(last)) is not None:
        last = task.run.group
        order.append(last)
        schedule.finish(task)
    assert order == [("a", "x")] * 3 + [("a", "y")] * 3 + [("b", "x")] * 3


def test_two_lanes_take_two_engines_and_then_share_one_experiment() -> None:
    schedule = Schedule(tasks(("a", "x"), ("a", "y"), ("b", "x"), count=1) + tasks(("b", "y"), count=4))
    first, second = schedule.take(None), schedule.take(None)
    assert first is not None and second is not None
    assert {first.run.group[0], second.run.group[0]} == {"a", "b"}
    groups = []
    while (task := schedule.take(first.run.group)) is not None:
        groups.append(task.run.group)
        schedule.finish(task)
        if len(groups) == 5:
            schedule.finish(first)
            schedule.finish(second)
    assert sorted([*groups, first.run.group, second.run.group]) == sorted(
        [("a", "x"), ("a", "y"), ("b", "x"), *[("b", "y")] * 4]
    )


def test_a_lane_waits_for_tasks_that_may_come_back() -> None:
    schedule = Schedule(tasks(("a", "x"), count=1))
    task = schedule.take(None)
    assert task is not None
    taken: list[SweepTask | None] = []
    thread = threading.Thread(target=lambda: taken.append(schedule.take(None)))
    thread.start()
    schedule.put_back(task)
    thread.join(10.0)
    assert taken == [task]
    schedule.finish(task)
    assert schedule.take(None) is None


def test_a_stopped_schedule_gives_nothing() -> None:
    schedule = Schedule(tasks(("a", "x")))
    schedule.stop()
    assert schedule.take(None) is None
