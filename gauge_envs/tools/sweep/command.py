"""Commands of sweeps: `gauge sweep` plans and runs one, `gauge query` reads its store."""

from __future__ import annotations

import math
import os
import shlex
import sys
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gauge_envs.cli.arguments import Json, Wide, json_or_text, parsed_parameters, split_list
from gauge_envs.cli.interrupts import EXIT_INTERRUPTED
from gauge_envs.cli.output import (
    EXIT_FAILED,
    counted,
    echo,
    plain_text,
    print_json_lines,
    print_table,
    stderr_console,
    stdout_console,
)
from gauge_envs.errors import ParameterError
from gauge_envs.experiments.variants import is_glob
from gauge_envs.tools.sweep.progress import SweepProgress

if TYPE_CHECKING:
    from gauge_envs.runs.result import Outcome
    from gauge_envs.tools.sweep.lanes import Lane, Limits
    from gauge_envs.tools.sweep.plan import SweepPlan
    from gauge_envs.tools.sweep.session import SweepSession
    from gauge_envs.tools.sweep.spec import SweepSpec


MOST_DIGITS = 9
"""Most digits of the numbers of `--shard`."""


def sweep(
    file: Annotated[
        Path | None, typer.Argument(metavar="[FILE]", help="Sweep file, TOML; options replace what it states.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the result files and the store.")] = Path("sweep"),
    backends: Annotated[
        list[str] | None, typer.Option("--backend", help="Engine; repeatable; mujoco by default.")
    ] = None,
    variants: Annotated[
        list[str] | None, typer.Option("--variant", help="Id, pattern or experiment file; repeatable.")
    ] = None,
    presets: Annotated[list[str] | None, typer.Option("--preset", help="Preset of every engine; repeatable.")] = None,
    parameters: Annotated[
        list[str] | None, typer.Option("--parameters", help="Parameter set, or overrides; repeatable.")
    ] = None,
    changes: Annotated[
        list[str] | None,
        typer.Option("--set", help="Values of a setting, as timestep_s=0.001,0.0005 or mujoco.iterations=10,50."),
    ] = None,
    repeats: Annotated[int | None, typer.Option(min=1, help="Episodes of each combination.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of the first repeat.")] = None,
    jitter_mm: Annotated[
        float | None, typer.Option(min=0.0, help="Standard deviation of start positions in mm; 1.0 with repeats.")
    ] = None,
    jitter_deg: Annotated[
        float | None, typer.Option(min=0.0, help="Standard deviation of start angles in degrees; 0.5 with repeats.")
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show the plan and its estimated cost; run nothing.")
    ] = False,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Worker processes; one for each processor by default.")
    ] = None,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Run episodes again that failed before.")
    ] = False,
    isolate: Annotated[bool, typer.Option("--isolate", help="Each task in a process of its own.")] = False,
    time_limit_s: Annotated[float, typer.Option(help="Time limit of a task in s.")] = 3600.0,
    memory_limit_gb: Annotated[
        float | None, typer.Option(help="Limit of the resident memory of a worker in GB, on Linux.")
    ] = None,
    ray: Annotated[
        str | None, typer.Option(help="Run on Ray: auto, local, or the address of a cluster.", metavar="ADDRESS")
    ] = None,
    slurm: Annotated[
        Path | None, typer.Option(help="Write a script that submits the sweep file to Slurm; run nothing.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Jobs of the Slurm array.")] = 16,
    part: Annotated[
        str | None, typer.Option("--shard", help="Run one part of the plan, as 0/16; parts may run at the same time.")
    ] = None,
    json_lines: Json = False,
    wide: Wide = False,
) -> None:
    """Run engines, settings, parameters and experiments in all combinations; continue where an earlier run stopped.

    Episodes whose results are in the folder do not run again. Exit code 1 when an episode failed or diverged, or when
    an experiment given by its id was declined.
    """
    from gauge_envs.tools.sweep.lanes import Limits
    from gauge_envs.tools.sweep.plan import plan_sweep
    from gauge_envs.tools.sweep.plan import shard as part_of
    from gauge_envs.tools.sweep.spec import load_sweep_file, sweep_spec

    given = _given(backends, variants, presets, parameters, repeats, seed, _jitter(jitter_mm, jitter_deg))
    stated = {} if file is None else load_sweep_file(file)
    if changes:
        known = given.get("backends") or stated.get("backends") or ["mujoco"]
        given["settings"] = _with_changes(stated.get("settings", {}), changes, known)
    spec = sweep_spec(stated | given)
    plan = plan_sweep(spec, isolate=isolate)
    if slurm is not None:
        _write_slurm(slurm, file, out, jobs, workers, given)
        return
    if part is not None:
        plan = part_of(plan, *_part(part))
    count = workers or _processors()
    if dry_run:
        _show_plan(plan, out, count, retry_failed=retry_failed, json_lines=json_lines, wide=wide)
        return
    limits = Limits(time_limit_s, memory_limit_gb, isolate)
    lanes = partial(_lanes, ray, workers, count, limits)
    _run(plan, spec, out, lanes, part is not None, retry_failed, json_lines)


class Format(StrEnum):
    """Format of the rows of a query."""

    TABLE = "table"
    CSV = "csv"
    JSON = "json"


def query(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of gauge sweep or gauge run.")],
    sql: Annotated[str, typer.Argument(help="One SELECT statement; the table is results.")],
    form: Annotated[Format, typer.Option("--format", help="Format of the rows.")] = Format.TABLE,
) -> None:
    """Query the results of a folder with SQL, which can only read, within 60 s."""
    from gauge_envs.tools.sweep.query import query_sweep
    from gauge_envs.tools.sweep.words import query_csv, query_records, query_table

    columns, rows = query_sweep(folder, sql, notify=_note)
    if form is Format.CSV:
        echo(query_csv(columns, rows), nl=False)
    elif form is Format.JSON:
        print_json_lines(query_records(columns, rows))
    else:
        print_table(query_table(columns, rows), json_lines=False)


# --- what is asked for -----------------------------------------------------------------------------------------------


def _given(
    backends: list[str] | None,
    variants: list[str] | None,
    presets: list[str] | None,
    parameters: list[str] | None,
    repeats: int | None,
    seed: int | None,
    jitter: dict[str, float] | None,
) -> dict[str, Any]:
    """Return the keys of a sweep file that options state."""
    values = {
        "backends": backends,
        "variants": variants,
        "presets": presets,
        "parameters": [parsed_parameters(one) for one in parameters] if parameters else None,
        "repeats": repeats,
        "seed": seed,
        "jitter": jitter,
    }
    return {key: value for key, value in values.items() if value is not None and value != []}


def _jitter(position_mm: float | None, angle_deg: float | None) -> dict[str, float] | None:
    values = {}
    if position_mm is not None:
        values["position_m"] = 1e-3 * position_mm
    if angle_deg is not None:
        values["angle_rad"] = math.radians(angle_deg)
    return values or None


def _with_changes(settings: dict[str, Any], changes: list[str], backends: list[str]) -> dict[str, Any]:
    """Return settings with those of `--set`, whose name may begin with an engine and a dot."""
    result = dict(settings)
    for text in changes:
        key, equals, values = (part.strip() for part in text.partition("="))
        if not (key and equals and values):
            raise ParameterError(f"--set {text!r}: expected NAME=VALUE,VALUE or ENGINE.NAME=VALUE,VALUE")
        listed = [json_or_text(value.strip()) for value in split_list(values)]
        backend, dot, name = key.partition(".")
        if not dot:
            result[key] = listed
        elif backend in backends:
            own = result.get(backend, {})
            if not isinstance(own, dict):
                raise ParameterError(
                    f"--set {text!r}: settings.{backend} of the sweep file is a list, expected a table of settings"
                )
            result[backend] = own | {name: listed}
        else:
            raise ParameterError(f"--set {text!r}: {backend!r} is no engine of this sweep: {', '.join(backends)}")
    return result


def _part(text: str) -> tuple[int, int]:
    number, slash, count = text.partition("/")
    are_numbers = all(part.isdecimal() and len(part) <= MOST_DIGITS for part in (number, count))
    if not (slash and are_numbers):
        raise ParameterError(f"--shard {text!r}: expected NUMBER/COUNT, as 0/16")
    return int(number), int(count)


def _processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def _lanes(ray: str | None, workers: int | None, count: int, limits: Limits, most: int) -> list[Lane]:
    """Return the lanes, at most so many as there are tasks."""
    from gauge_envs.tools.sweep.lanes import WorkerLane
    from gauge_envs.tools.sweep.ray_lanes import ray_lanes

    lanes: list[Lane] = [WorkerLane(limits) for _ in range(1 if ray else min(count, most))]
    return lanes if ray is None else [*ray_lanes(ray, workers and min(workers, most), limits)[:most]]


def _write_slurm(
    script: Path, file: Path | None, out: Path, jobs: int, workers: int | None, given: dict[str, Any]
) -> None:
    from gauge_envs.tools.sweep.slurm import slurm_script, write_slurm_script

    if file is None or given:
        raise ParameterError(
            "--slurm needs a sweep file that states everything: write what the other options state into it"
        )
    count = workers or 1
    arguments = [str(file.resolve()), "--out", str(out.resolve()), "--workers", str(count)]
    text = slurm_script(script.name, arguments, jobs=jobs, workers=count, log_folder=out.resolve() / "slurm")
    write_slurm_script(script, text)
    stderr_console().print(plain_text(f"{script} written; it needs submitit: pip install 'gauge-envs[slurm]'"))


# --- runs ------------------------------------------------------------------------------------------------------------


def _show_plan(plan: SweepPlan, out: Path, workers: int, *, retry_failed: bool, json_lines: bool, wide: bool) -> None:
    from gauge_envs.runs.result import Outcome
    from gauge_envs.tools.sweep.estimate import EarlierCosts
    from gauge_envs.tools.sweep.folder import SweepFolder
    from gauge_envs.tools.sweep.plan import remaining_tasks
    from gauge_envs.tools.sweep.words import cost_text, plan_rows, plan_table

    folder = SweepFolder(out)
    kept = [one for one in Outcome if not (retry_failed and one is Outcome.FAILED)]
    tasks = list(remaining_tasks(plan, {entry.name for entry in folder.files(*kept)}))
    costs = EarlierCosts(folder)
    rows = plan_rows(plan, tasks, costs)
    print_table(plan_table(rows, wide=wide or json_lines), json_lines=json_lines, wide=True)
    left = sum(row["left"] for row in rows)
    stderr = stderr_console()
    stderr.print(
        f"{plan.episode_count} episodes, {left} left; {counted(plan.duplicates, 'duplicate')} left out", soft_wrap=True
    )
    cost = costs.of(task for task in tasks if task.run.declined is None)
    stderr.print(plain_text(cost_text(cost, workers)), soft_wrap=True)


def _run(
    plan: SweepPlan,
    spec: SweepSpec,
    out: Path,
    lanes: Callable[[int], list[Lane]],
    is_part: bool,
    retry_failed: bool,
    json_lines: bool,
) -> None:
    from gauge_envs.pages.table import as_rich
    from gauge_envs.runs.result import Outcome
    from gauge_envs.tools.sweep.session import SweepSession
    from gauge_envs.tools.sweep.words import outcome_table

    stderr = stderr_console()
    counts: Counter[tuple[str, Outcome]] = Counter()
    with SweepSession(plan, out, is_part=is_part, retry_failed=retry_failed, notify=_note) as session:
        counts.update(session.earlier)
        progress = SweepProgress(stderr, total=plan.episode_count, done=session.earlier.total())
        try:
            _run_left(session, lanes, progress, counts, json_lines=json_lines)
        except KeyboardInterrupt:
            command = shlex.join(["gauge", *sys.argv[1:]])
            stderr.print(
                plain_text(f"interrupted: {session.left()} of {plan.episode_count} episodes left; continue with:")
            )
            stderr.print(plain_text(command), soft_wrap=True)
            raise typer.Exit(EXIT_INTERRUPTED) from None
    if json_lines:
        stderr.print(plain_text(f"{counted(counts.total(), 'episode')}; results in {out}"), soft_wrap=True)
    else:
        stdout_console().print(as_rich(outcome_table(counts)))
        stderr.print(plain_text(f"results in {out}"), soft_wrap=True)
    if any(counts[name, Outcome.FAILED] for name in spec.backends):
        stderr.print("causes of failures are in the folder failed; --retry-failed runs them again")
    if any(outcome in (Outcome.FAILED, Outcome.DIVERGED) for _, outcome in counts) or _has_named_declined(plan, spec):
        raise typer.Exit(EXIT_FAILED)


def _run_left(
    session: SweepSession,
    lanes: Callable[[int], list[Lane]],
    progress: SweepProgress,
    counts: Counter[tuple[str, Outcome]],
    *,
    json_lines: bool,
) -> None:
    """Run what is left, and count it."""
    if not session.tasks:
        return
    with progress, closing(session.run(lanes(len(session.tasks)))) as results:
        for result in results:
            counts[str(result.backend), result.outcome] += 1
            progress.advance(result)
            if json_lines:
                print_json_lines([result.to_dict(trajectory=False)])


def _has_named_declined(plan: SweepPlan, spec: SweepSpec) -> bool:
    """Return whether an experiment that was given by its id cannot run."""
    named = {name.removeprefix("GAUGE/") for name in spec.variants if not is_glob(name)}
    return any(run.declined is not None and run.experiment in named for run in plan.runs)


def _note(text: str) -> None:
    stderr_console().print(f"[yellow]note:[/] {plain_text(text)}", soft_wrap=True)
