"""Tables of sweeps: the plan and the outcomes."""

from collections.abc import Iterable, Mapping
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


PLAN_COLUMNS = (
    Column("backend", "engine"),
    Column("experiment", "experiment"),
    *(
        Column(key, key, str, is_number=True)
        for key in ("runs", "episodes", "left", "declined")
    ),
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
        row = rows.setdefault(
            run.group,
            {
                "backend": run.group[0],
                "experiment": run.group[1],
                "runs": 0,
                "episodes": 0,
                "declined": 0,
            },
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
    whole = tuple(column for column in PLAN_COLUMNS if column.key != "experiment")
    return Document(
        parts=(
            Table(columns=whole, rows=_sums(rows.values()), narrow_only=True),
            Table(columns=PLAN_COLUMNS, rows=list(rows.values()), wide_only=True),
        ),
        rows=list(rows.values()),
    )


def _sums(rows: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    sums: dict[str, dict[str, Any]] = {}
    for row in rows:
        one = sums.setdefault(
            row["backend"], {"backend": row["backend"], "engine_s": None}
        )
        for key in ("runs", "episodes", "left", "declined", "unknown"):
            one[key] = one.get(key, 0) + row[key]
        if row["engine_s"] is not None:
            one["engine_s"] = (one["engine_s"] or 0.0) + row["engine_s"]
    return list(sums.values())


def outcome_table(plan: SweepPlan, counts: Mapping[tuple[str, Outcome], int]) -> Table:
    """Return the number of episodes of each outcome, a row for each engine of a plan."""
    columns = [Column("backend", "engine")]
    columns += [
        Column(outcome.value, outcome.value, str, is_number=True) for outcome in Outcome
    ]
    rows: list[dict[str, Any]] = []
    for backend in dict.fromkeys(run.request.backend for run in plan.runs):
        rows.append(
            {"backend": backend}
            | {outcome.value: counts.get((backend, outcome), 0) for outcome in Outcome}
        )
    return Table(columns=tuple(columns), rows=rows)
