"""Run the tasks of a sweep on lanes, and write each result as soon as it is there."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import replace

from gauge_envs.runs.batch import not_run, planned_results
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.tools.sweep.folder import SweepFolder
from gauge_envs.tools.sweep.lanes import Lane, LaneLostError
from gauge_envs.tools.sweep.plan import SweepTask
from gauge_envs.tools.sweep.schedule import Schedule
from gauge_envs.tools.sweep.store import SweepStore

MOST_LOSSES = 3
"""Lanes that a task may lose before it counts as failed."""

CLOSE_LOOK_S = 0.2
"""Time between two attempts to end the lanes [s]."""


def run_tasks(
    tasks: Iterable[SweepTask], lanes: Sequence[Lane], folder: SweepFolder, store: SweepStore | None
) -> Generator[Result, None, None]:
    """Run tasks on lanes at once, and yield each result after it is written.

    When the iterator is closed, as by Ctrl-C, what is complete is written, and the lanes are closed.

    Args:
        tasks: The tasks.
        lanes: The lanes.
        folder: Folder of the result files.
        store: Store that gets a row for each; None leaves it as it is.
    """
    threads = _LaneThreads(Schedule(tasks), lanes)
    try:
        for task, results in threads.outcomes():
            for result, name in zip(results, task.file_names, strict=True):
                file = folder.write(result, name)
                if store is not None:
                    store.add(result, file)
                yield result
    finally:
        threads.stop()
        try:
            # Complete, and not yet written when the iterator was closed; a file that exists is written once more.
            for task, results in threads.complete:
                for result, name in zip(results, task.file_names, strict=True):
                    folder.write(result, name)
        finally:
            threads.close()


class _LaneThreads:
    """A thread for each lane.

    Args:
        schedule: The tasks.
        lanes: The lanes.

    Attributes:
        complete: Tasks and results that `outcomes` has not handed over, the current one included.
    """

    def __init__(self, schedule: Schedule, lanes: Sequence[Lane]) -> None:
        self.complete: deque[tuple[SweepTask, list[Result]]] = deque()
        self._schedule = schedule
        self._lanes = lanes
        self._losses: Counter[tuple[str, range]] = Counter()
        self._change = threading.Condition()
        self._is_stopped = False
        self._error: BaseException | None = None
        self._left = len(lanes)
        self._threads = [threading.Thread(target=self._serve, args=(lane,), daemon=True) for lane in lanes]
        for thread in self._threads:
            thread.start()

    def outcomes(self) -> Iterator[tuple[SweepTask, list[Result]]]:
        """Yield tasks and their results until none is left."""
        while True:
            with self._change:
                while not self.complete and self._left and self._error is None:
                    self._change.wait()
                if self._error is not None:
                    raise self._error
                if not self.complete:
                    return
                first = self.complete[0]
            yield first
            self.complete.popleft()

    def stop(self) -> None:
        """Take no more tasks and no more results."""
        self._schedule.stop()
        with self._change:
            self._is_stopped = True

    def close(self) -> None:
        """End the lanes and their threads."""
        for thread, lane in zip(self._threads, self._lanes, strict=True):
            # A lane may just have started the process of its next task.
            while thread.is_alive():
                lane.close()
                thread.join(CLOSE_LOOK_S)
            lane.close()

    def _serve(self, lane: Lane) -> None:
        try:
            last = None
            while (task := self._schedule.take(last)) is not None:
                last = task.run.group
                self._run(lane, task)
        # It ends the sweep, in the thread of the sweep.
        except BaseException as error:
            with self._change:
                self._error = None if self._is_stopped else error
        finally:
            with self._change:
                self._left -= 1
                self._change.notify_all()

    def _run(self, lane: Lane, task: SweepTask) -> None:
        try:
            results = [_verified(task, result) for result in lane.run(task.request)]
        except LaneLostError as error:
            if self._loses(task) < MOST_LOSSES:
                self._schedule.put_back(task)
                return
            results = not_run(planned_results(task.request), Outcome.FAILED, f"{error}, {MOST_LOSSES} times")
        with self._change:
            if not self._is_stopped:
                self.complete.append((task, results))
                self._change.notify_all()
        self._schedule.finish(task)

    def _loses(self, task: SweepTask) -> int:
        """Count a lane that a task has lost, and return how many it were."""
        with self._change:
            self._losses[task.run.sha256, task.seeds] += 1
            return self._losses[task.run.sha256, task.seeds]


def _verified(task: SweepTask, result: Result) -> Result:
    """Return a result, or a failure if other versions made it than the plan states."""
    if result.trajectory is None:
        return result
    for package, planned in task.run.versions.items():
        if (found := result.versions.get(package)) != planned:
            reason = f"made with {package} {found}, planned with {planned}: install the same versions on every machine"
            return replace(result, outcome=Outcome.FAILED, error=reason, trajectory=None)
    return result
