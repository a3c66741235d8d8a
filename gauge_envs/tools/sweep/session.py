"""A sweep in a folder: what is there, what is left, and the run of what is left."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack
from pathlib import Path

from gauge_envs.runs.result import Outcome, Result
from gauge_envs.tools.sweep.execute import run_tasks
from gauge_envs.tools.sweep.folder import SweepFolder
from gauge_envs.tools.sweep.lanes import Lane
from gauge_envs.tools.sweep.plan import SweepPlan, SweepTask, remaining_tasks
from gauge_envs.tools.sweep.store import SweepStore


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
