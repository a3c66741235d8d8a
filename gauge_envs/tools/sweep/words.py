"""Tables of sweeps: the plan and the outcomes."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from gauge_envs.pages.document import Document
from gauge_envs.pages.table import Column, Table
from gauge_envs.runs.result import Outcome
from gauge_envs.tools.sweep.folder import Cost, EarlierCosts
from gauge_envs.tools.sweep.plan import SweepPlan, SweepTask


def duration_text(seconds: float) -> str:
    """Return a duration in the unit that fits it, as `4.2 min`."""
    for size, unit in ((86400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if seconds >= size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.1f} s"


def cost_text(cost: Cost, workers: int) -> str:
    """Return the estimate of a sweep in words."""
    if not cost.known and not cost.unknown:
        return "nothing is left to run"
    if not cost.known:
        return f"cost unknown: no earlier results of these engines and experiments for {cost.unknown} episodes"
    text = (
        f"about {duration_text(cost.engine_s)} in the engines for {cost.known} episodes, by earlier results; "
        f"{duration_text(cost.engine_s / workers)} on {workers} workers, without start and building"
    )
    return f"{text}; unknown for {cost.unknown} episodes" if cost.unknown else text


COUNTS = ("runs", "episodes", "left", "declined", "unknown")
"""Keys of the rows of a plan whose values add up."""

PLAN_COLUMNS = (
    Column("backend", "engine"),
    Column("experiment", "experiment"),
    *(Column(key, key, str, is_number=True) for key in COUNTS[:-1]),
    Column("engine_s", "engine time", duration_text, is_number=True),
    Column("unknown", "without estimate", str, is_number=True),
)


def plan_document(
    plan: SweepPlan, tasks: Iterable[SweepTask], costs: EarlierCosts
) -> Document:
    """Return the episodes of a plan that are left and their cost: for each engine, or wide for each experiment, too.

    Its rows are those of the engines and experiments.
    """
    left: dict[tuple[str, str], list[SweepTask]] = {}
    for task in tasks:
        left.setdefault(task.run.group, []).append(task)
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for run in plan.runs:
        backend, experiment = run.group
        counts = dict.fromkeys(COUNTS, 0)
        row = rows.setdefault(
            run.group, {"backend": backend, "experiment": experiment, **counts}
        )
        row["runs"] += 1
        row["episodes"] += run.request.repeats
        row["declined"] += run.request.repeats if run.declined else 0
        row.setdefault("reason", run.declined)
    for group, row in rows.items():
        waiting = left.get(group, [])
        cost = costs.of(task for task in waiting if task.run.declined is None)
        row["left"] = sum(len(task.seeds) for task in waiting)
        row["engine_s"] = cost.engine_s if cost.known else None
        row["unknown"] = cost.unknown
    engines = [
        _sum(backend, [row for row in rows.values() if row["backend"] == backend])
        for backend in dict.fromkeys(backend for backend, _ in rows)
    ]
    whole = tuple(column for column in PLAN_COLUMNS if column.key != "experiment")
    return Document(
        parts=(
            Table(columns=whole, rows=engines),
            Table(columns=PLAN_COLUMNS, rows=list(rows.values()), wide_only=True),
        ),
        rows=list(rows.values()),
    )


def _sum(backend: str, rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the row of an engine from those of its experiments."""
    known_s = [row["engine_s"] for row in rows if row["engine_s"] is not None]
    counts = {key: sum(row[key] for row in rows) for key in COUNTS}
    return {"backend": backend, "engine_s": sum(known_s) if known_s else None, **counts}


def outcome_table(plan: SweepPlan, counts: Mapping[tuple[str, Outcome], int]) -> Table:
    """Return the number of episodes of each outcome, a row for each engine of a plan."""
    columns = [Column("backend", "engine")]
    columns += [Column(one.value, one.value, str, is_number=True) for one in Outcome]
    return Table(
        columns=tuple(columns),
        rows=[
            {
                "backend": backend,
                **{one.value: counts.get((backend, one), 0) for one in Outcome},
            }
            for backend in dict.fromkeys(run.request.backend for run in plan.runs)
        ],
    )
