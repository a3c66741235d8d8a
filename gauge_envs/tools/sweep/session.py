"""A sweep in a folder: what is there, what is left, and the run of what is left on lanes."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from gauge_envs.runs.batch import not_run, planned_results
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.tools.sweep.lanes import Lane, LaneLostError
from gauge_envs.tools.sweep.plan import SweepPlan, SweepTask, remaining_tasks
from gauge_envs.tools.sweep.store import SweepFolder, SweepStore

MOST_LOSSES = 3
"""Lanes that a task may lose before it counts as failed."""

CLOSE_LOOK_S = 0.2
"""Time between two attempts to end the lanes [s]."""

Group = tuple[str, str]
"""Engine and experiment."""


class SweepSession:
    """A sweep in a folder, which it holds against other sweeps. Use it in a `with` statement.

    Args:
        plan: The plan.
        path: The folder; created if it does not exist.
        is_part: Whether the plan is a part of a sweep whose other parts may run at the same time. Parts write result
            files alone; the store gets its rows when the whole sweep or a query opens the folder.
        retry_failed: Whether episodes that failed run again.
        notify: Receives a sentence for a damaged store and for each damaged file, which is moved aside.

    Attributes:
        tasks: What is left.
        earlier: Outcomes of the episodes that are not left, by engine and outcome.

    Example:
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> from gauge_envs.tools.sweep.lanes import Limits, WorkerLane
        >>> from gauge_envs.tools.sweep.plan import plan_sweep
        >>> from gauge_envs.tools.sweep.session import SweepSession
        >>> from gauge_envs.tools.sweep.spec import sweep_spec
        >>> plan = plan_sweep(sweep_spec({"variants": ["SlopeSlider-2-*"], "settings": {"timestep_s": [1 / 1800]}}))
        >>> with TemporaryDirectory() as folder, SweepSession(plan, Path(folder)) as session:
        ...     outcomes = [result.outcome.value for result in session.run([WorkerLane(Limits())])]
        >>> outcomes
        ['finished', 'finished', 'finished']
    """

    def __init__(
        self,
        plan: SweepPlan,
        path: Path,
        *,
        is_part: bool = False,
        retry_failed: bool = False,
        notify: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.tasks: list[SweepTask] = []
        self.earlier: Counter[tuple[str, Outcome]] = Counter()
        self._plan = plan
        self._folder = SweepFolder(path)
        self._is_part = is_part
        self._retry_failed = retry_failed
        self._notify = notify
        self._store: SweepStore | None = None
        self._stack = ExitStack()

    def __enter__(self) -> SweepSession:
        """Hold the folder, bring its store up to date, and find what is left."""
        self._folder.create()
        with ExitStack() as stack:
            stack.enter_context(self._folder.lock(shared=self._is_part))
            if not self._is_part:
                self._store = stack.enter_context(SweepStore(self._folder, self._notify))
                self._store.synchronise()
            self._stack = stack.pop_all()
        done = {
            entry.name: outcome
            for outcome in (Outcome.FINISHED, Outcome.DECLINED, Outcome.FAILED)
            if not (self._retry_failed and outcome is Outcome.FAILED)
            for entry in self._folder.files(outcome)
        }
        if self._store is not None:
            done |= self._store.diverged(done)
        self.tasks = list(remaining_tasks(self._plan, done))
        for run in self._plan.runs:
            for seed in run.seeds:
                if (outcome := done.get(run.file_name(seed))) is not None:
                    self.earlier[run.request.backend, outcome] += 1
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def left(self) -> int:
        """Return the number of episodes that have no file now."""
        there = {entry.name for entry in self._folder.files()}
        return sum(run.file_name(seed) not in there for run in self._plan.runs for seed in run.seeds)

    def run(self, lanes: Sequence[Lane]) -> Generator[Result, None, None]:
        """Run what is left, and yield each result after it is written; close the iterator to stop.

        Args:
            lanes: Where the tasks run; they are closed at the end.
        """
        return run_tasks(self.tasks, lanes, self._folder, self._store)


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
