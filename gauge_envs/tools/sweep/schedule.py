"""The order of the tasks of a sweep: a lane stays with its experiment and its engine as long as it can."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Iterable

from gauge_envs.tools.sweep.plan import SweepTask

Group = tuple[str, str]
"""Engine and experiment."""


class Schedule:
    """The tasks that wait, by engine and experiment. Its methods may be called from any thread.

    Args:
        tasks: The tasks.
    """

    def __init__(self, tasks: Iterable[SweepTask]) -> None:
        self._waiting: dict[Group, deque[SweepTask]] = {}
        for task in tasks:
            self._waiting.setdefault(task.run.group, deque()).append(task)
        self._running: Counter[Group] = Counter()
        self._change = threading.Condition()
        self._is_stopped = False

    def take(self, last: Group | None) -> SweepTask | None:
        """Return the next task of a lane, or None when none is left.

        It waits while other lanes run, since their tasks may come back.

        Args:
            last: Engine and experiment of the lane's last task, or None.
        """
        with self._change:
            while not self._is_stopped:
                if self._waiting:
                    group = max(self._waiting, key=lambda one: self._preference(one, last))
                    tasks = self._waiting[group]
                    task = tasks.popleft()
                    if not tasks:
                        del self._waiting[group]
                    self._running[group] += 1
                    return task
                if not self._running.total():
                    return None
                self._change.wait()
        return None

    def _preference(self, group: Group, last: Group | None) -> tuple[bool, bool, bool, int, int]:
        """Rank a group for a lane: its own one, one that no lane serves, its engine, and the engine that few serve."""
        engine_lanes = sum(count for one, count in self._running.items() if one[0] == group[0])
        return (
            group == last,
            not self._running[group],
            last is not None and group[0] == last[0],
            -engine_lanes,
            len(self._waiting[group]),
        )

    def finish(self, task: SweepTask) -> None:
        """State that a task is complete."""
        with self._change:
            self._running[task.run.group] -= 1
            self._change.notify_all()

    def put_back(self, task: SweepTask) -> None:
        """Let a task run again, on any lane."""
        with self._change:
            self._running[task.run.group] -= 1
            self._waiting.setdefault(task.run.group, deque()).append(task)
            self._change.notify_all()

    def stop(self) -> None:
        """Give no more tasks."""
        with self._change:
            self._is_stopped = True
            self._change.notify_all()
