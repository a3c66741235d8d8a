"""A sweep in a folder: what is there, what is left, and the run of what is left on lanes."""

from __future__ import annotations

import itertools
import threading
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue

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

LaneOutcome = list[tuple[Result, str]] | BaseException | None
"""Results of a task with the names of their files, an error that ends the sweep, or None at the end of a lane."""


class SweepSession:
    """A sweep in a folder, which it holds against other sweeps. Use it in a `with` statement.

    Args:
        plan: The plan.
        path: The folder; created if it does not exist.
        is_part: Whether the plan is a part of a sweep whose other parts may run at the same time. Parts write result
            files alone; the store gets its rows when the whole sweep opens the folder.
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
    schedule, outcomes = Schedule(tasks), SimpleQueue[LaneOutcome]()
    losses: Counter[tuple[str, range]] = Counter()
    threads = [threading.Thread(target=_serve, args=(lane, schedule, losses, outcomes), daemon=True) for lane in lanes]
    for thread in threads:
        thread.start()
    left = len(lanes)
    outcome: LaneOutcome = None
    try:
        while left:
            outcome = outcomes.get()
            if outcome is None:
                left -= 1
            elif isinstance(outcome, BaseException):
                raise outcome
            else:
                for result, name in outcome:
                    file = folder.write(result, name)
                    if store is not None:
                        store.add(result, file)
                    yield result
                outcome = None
    finally:
        schedule.stop()
        try:
            # Complete, and not yet written when the iterator was closed; a file that exists is written once more.
            complete = [outcome, *(outcomes.get() for _ in range(outcomes.qsize()))]
            for result, name in itertools.chain(*(one for one in complete if isinstance(one, list))):
                folder.write(result, name)
        finally:
            _close(lanes, threads)


def _close(lanes: Sequence[Lane], threads: Sequence[threading.Thread]) -> None:
    for lane, thread in zip(lanes, threads, strict=True):
        # A lane may just have started the process of its next task.
        while thread.is_alive():
            lane.close()
            thread.join(CLOSE_LOOK_S)
        lane.close()


def _serve(
    lane: Lane, schedule: Schedule, losses: Counter[tuple[str, range]], outcomes: SimpleQueue[LaneOutcome]
) -> None:
    """Run tasks on a lane until none is left; the last outcome is None.

    A task is on one lane at a time, so that lanes do not count the losses of the same one.
    """
    last = None
    try:
        while (task := schedule.take(last)) is not None:
            last, key = task.run.group, (task.run.sha256, task.seeds)
            try:
                results = [_verified(task, result) for result in lane.run(task.request)]
            except LaneLostError as error:
                losses[key] += 1
                if losses[key] < MOST_LOSSES:
                    schedule.put_back(task)
                    continue
                results = not_run(planned_results(task.request), Outcome.FAILED, f"{error}, {MOST_LOSSES} times")
            outcomes.put([*zip(results, task.file_names, strict=True)])
            schedule.finish(task)
    # It ends the sweep, in the thread of the sweep.
    except BaseException as error:
        outcomes.put(error)
    finally:
        outcomes.put(None)


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
    """The tasks that wait, by engine and experiment. Its methods may be called from any thread."""

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
