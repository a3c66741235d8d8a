"""Tables of sweeps: the plan and the outcomes."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import timedelta
from typing import Any

from gauge_envs.pages.document import Document
from gauge_envs.pages.table import Column, Table
from gauge_envs.runs.result import Outcome
from gauge_envs.tools.sweep.folder import Cost, StepTimes
from gauge_envs.tools.sweep.plan import SweepPlan, SweepRun, SweepTask

Group = tuple[str, ...]

COLUMNS = (
    Column("backend", "engine"),
    Column("experiment", "experiment"),
    Column("runs", "runs", is_number=True),
    Column("episodes", "episodes", is_number=True),
    Column("left", "left", is_number=True),
    Column("declined", "declined", is_number=True),
    Column(
        "engine_s", "engine time", lambda value: duration_text(value), is_number=True
    ),
    Column("unknown", "without estimate", is_number=True),
)


def duration_text(seconds: float) -> str:
    """Return a duration, as `1 day, 3:04:05`."""
    return str(timedelta(seconds=round(seconds)))


def cost_text(cost: Cost, workers: int) -> str:
    """Return the estimate of a sweep in words."""
    each_s = cost.engine_s / workers
    return (
        f"about {duration_text(cost.engine_s)} in the engines, {duration_text(each_s)} on {workers} workers, for "
        f"{cost.known} episodes by earlier results; cost unknown for {cost.unknown} episodes"
    )


def plan_document(
    plan: SweepPlan, tasks: Sequence[SweepTask], times: StepTimes
) -> Document:
    """Return the episodes of a plan that are left and their cost: for each engine, or wide for each experiment, too.

    Its rows are those of the engines and experiments.
    """
    engines = _rows(plan, tasks, times, depth=1)
    rows = list(_rows(plan, tasks, times, depth=2))
    return Document(
        parts=(
            Table(columns=(COLUMNS[0], *COLUMNS[2:]), rows=list(engines)),
            Table(columns=COLUMNS, rows=rows, wide_only=True),
        ),
        rows=rows,
    )


def _rows(
    plan: SweepPlan, tasks: Iterable[SweepTask], times: StepTimes, *, depth: int
) -> Iterator[dict[str, Any]]:
    """Yield a row for each engine (depth 1), or for each engine and experiment (depth 2)."""
    runs: dict[Group, list[SweepRun]] = {}
    left: dict[Group, list[SweepTask]] = {}
    for run in plan.runs:
        runs.setdefault(run.group[:depth], []).append(run)
    for task in tasks:
        left.setdefault(task.run.group[:depth], []).append(task)
    for group, members in runs.items():
        pending = left.get(group, [])
        cost = times.cost_of(pending)
        yield {
            "backend": group[0],
            "experiment": group[-1],
            "runs": len(members),
            "episodes": sum(run.request.repeats for run in members),
            "left": sum(len(task.seeds) for task in pending),
            "declined": sum(run.request.repeats for run in members if run.declined),
            "unknown": cost.unknown,
            "reason": members[0].declined,
            "engine_s": cost.engine_s if cost.known else None,
        }


def outcome_table(plan: SweepPlan, counts: Mapping[tuple[str, Outcome], int]) -> Table:
    """Return the number of episodes of each outcome, a row for each engine of a plan."""
    outcomes = [Column(one.value, one.value, is_number=True) for one in Outcome]
    return Table(
        columns=(Column("backend", "engine"), *outcomes),
        rows=[
            {"backend": backend}
            | {one.value: counts.get((backend, one), 0) for one in Outcome}
            for backend in dict.fromkeys(run.request.backend for run in plan.runs)
        ],
    )
