"""`gauge sweep`."""

from __future__ import annotations

import re
import shlex
import sys
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import (
    EXIT_INTERRUPTED,
    LINE_INTERVAL_S,
    Format,
    LostOutput,
    Progress,
    message,
    note,
    print_document,
    print_json_lines,
)
from gauge_envs.errors import ParameterError
from gauge_envs.files import processors
from gauge_envs.pages.text import counted, short_id

if TYPE_CHECKING:
    from gauge_envs.runs.pool import Limits, RequestWorker
    from gauge_envs.runs.result import Outcome
    from gauge_envs.tools.sweep.plan import SweepPlan, SweepTask
    from gauge_envs.tools.sweep.spec import SweepSpec

Counts = Counter[tuple[str, "Outcome"]]
"""Number of episodes by engine and outcome."""


def sweep(
    file: Annotated[
        Path | None,
        typer.Argument(
            metavar="FILE", help="Sweep file, TOML; options replace its keys."
        ),
    ] = None,
    parameters: Annotated[
        list[str] | None,
        arguments.option(
            arguments.SCENE,
            "Parameter sets, as calibrated,effective; or overrides of one, as cube.friction=0.3.",
            "--parameter",
            "-p",
            metavar=arguments.ASSIGNED,
            show_default="calibrated",
        ),
    ] = None,
    jitter: arguments.JitterTexts = None,
    backend: Annotated[
        list[str] | None, arguments.backend("Engines.", show_default="mujoco")
    ] = None,
    preset: Annotated[
        list[str] | None,
        arguments.option(
            arguments.NUMERICS,
            "Presets of every engine.",
            "--preset",
            metavar="NAME",
            show_default="chosen by each engine",
        ),
    ] = None,
    changes: Annotated[
        list[str] | None,
        arguments.option(
            arguments.NUMERICS,
            "Values of a setting, as timestep_s=1/1800,1/3600 or mujoco.iterations=10,50.",
            "--set",
            metavar=arguments.ASSIGNED,
            show_default="those of the engine",
        ),
    ] = None,
    seed: Annotated[
        int | None,
        arguments.option(
            arguments.NUMERICS,
            "Seed of the first repeat.",
            "--seed",
            "-s",
            min=0,
            show_default="0",
        ),
    ] = None,
    repeats: Annotated[
        int | None,
        arguments.option(
            arguments.NUMERICS,
            "Episodes of each combination, from starts that scatter.",
            "--repeats",
            min=1,
            show_default="1",
        ),
    ] = None,
    timeout: arguments.Timeout = None,
    memory: arguments.Memory = None,
    isolate: arguments.Isolate = False,
    jobs: arguments.Jobs = None,
    ray: Annotated[
        str | None,
        arguments.option(
            arguments.NUMERICS,
            "Run on Ray: auto, local, or the address of a cluster.",
            "--ray",
            metavar="ADDRESS",
        ),
    ] = None,
    only: Annotated[
        list[str] | None,
        arguments.option(
            arguments.SELECTION,
            "Ids, patterns or task files.",
            "--only",
            metavar="ID",
            show_default="those of the file",
        ),
    ] = None,
    shard: Annotated[
        str | None,
        arguments.option(
            arguments.SELECTION,
            "Run one part, as 0/16; parts may run at the same time.",
            "--shard",
            metavar="NUMBER/COUNT",
        ),
    ] = None,
    retry_failed: Annotated[
        bool,
        arguments.option(
            arguments.SELECTION, "Run again what failed before.", "--retry-failed"
        ),
    ] = False,
    dry_run: Annotated[
        bool,
        arguments.option(
            arguments.OUTPUT, "Show the plan and its cost; run nothing.", "--dry-run"
        ),
    ] = False,
    out: Annotated[Path, arguments.folder("Folder for the result files.")] = Path(
        "sweep"
    ),
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Run engines, settings and experiments in all combinations; continue an earlier run.

    Episodes whose results are in the folder do not run again. --timeout and --memory are those of the worker processes;
    with --isolate each task has a process of its own. Exit code 1 when an episode failed or diverged, or when an
    experiment given by its id was declined.
    """
    from gauge_envs.runs.isolation import TIME_LIMIT_S
    from gauge_envs.runs.pool import Limits
    from gauge_envs.runs.result import Outcome
    from gauge_envs.tools.sweep.folder import StepTimes, earlier_episodes
    from gauge_envs.tools.sweep.plan import plan_sweep, remaining_tasks
    from gauge_envs.tools.sweep.report import cost_text, outcome_table, plan_document

    scatter = arguments.parsed_jitter(jitter)
    options = {
        "backends": backend,
        "variants": only,
        "presets": preset,
        "parameters": _parameter_sets(parameters),
        "repeats": repeats,
        "seed": seed,
        "jitter": scatter and scatter.to_dict(),
    }
    spec = _spec(file, options, changes)
    limits = Limits(TIME_LIMIT_S if timeout is None else timeout, memory, isolate)
    plan = plan_sweep(spec, isolate=isolate)
    if shard is not None:
        plan = _part(plan, shard)
    earlier = earlier_episodes(out, note)
    done = {
        name: earlier[name].outcome
        for name in plan.file_names
        if name in earlier
        and not (retry_failed and earlier[name].outcome is Outcome.FAILED)
    }
    tasks = list(remaining_tasks(plan, done))
    if dry_run:
        times = StepTimes(earlier.values())
        print_document(plan_document(plan, tasks, times), form)
        left = plan.episode_count - len(done)
        message(
            f"{plan.episode_count} episodes, {left} left; {counted(plan.duplicates, 'duplicate')} left out"
        )
        message(cost_text(times.cost_of(tasks), jobs or processors()))
        return False
    counts = Counter((earlier[name].group[0], one) for name, one in done.items())
    if tasks:
        counts += _run(plan, tasks, _workers(ray, jobs, limits, len(tasks)), out, form)
    if form is not Format.JSON:
        print_document(outcome_table(plan, counts), form)
    message(f"{counted(counts.total(), 'episode')}; results in {out}")
    if any(outcome is Outcome.FAILED for _, outcome in counts):
        message(
            "causes of failures are in the folder failed; --retry-failed runs them again"
        )
    return _is_bad(plan, spec, counts)


# --- what is asked for -----------------------------------------------------------------------------------------------


def _spec(
    file: Path | None, options: dict[str, Any], changes: Sequence[str] | None
) -> SweepSpec:
    """Return the sweep of a file, whose keys the options replace."""
    from gauge_envs.tools.sweep.spec import load_sweep_file, sweep_spec

    given = {key: value for key, value in options.items() if value is not None}
    if file is None and not given and not changes:
        raise ParameterError(
            "nothing to run: give a sweep file, or experiments, as --only 'SlopeSlider-2-*'"
        )
    values = given if file is None else load_sweep_file(file) | given
    settings = dict(values.get("settings", {}))
    # The name of a setting may begin with an engine and a dot.
    for text in changes or ():
        for name, listed in arguments.assigned("--set", [text]).items():
            backend, dot, key = name.rpartition(".")
            texts = arguments.split_values(listed)
            table = {key: [arguments.value_of(one) for one in texts]}
            settings |= {backend: settings.get(backend, {}) | table} if dot else table
    return sweep_spec(values | {"settings": settings})


def _parameter_sets(texts: Sequence[str] | None) -> list[Any] | None:
    """Return names of parameter sets, or one set of overrides."""
    if texts and any("=" in text for text in texts):
        return [arguments.parsed_parameters(texts)]
    return list(texts) if texts else None


def _part(plan: SweepPlan, text: str) -> SweepPlan:
    """Return the part of a plan that --shard names."""
    from gauge_envs.tools.sweep.plan import shard

    numbers = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text)
    if numbers is None:
        raise ParameterError(f"--shard {text!r}: expected NUMBER/COUNT, as 0/16")
    return shard(plan, int(numbers[1]), int(numbers[2]))


# --- runs ------------------------------------------------------------------------------------------------------------


def _workers(
    ray: str | None, count: int | None, limits: Limits, task_count: int
) -> Sequence[RequestWorker]:
    """Return the workers, at most as many as there are tasks."""
    if ray is not None:
        from gauge_envs.tools.sweep.machines import ray_workers

        return ray_workers(ray, count and min(count, task_count), limits)[:task_count]
    from gauge_envs.runs.pool import ProcessWorker

    count = min(count or processors(), task_count)
    return [ProcessWorker(limits) for _ in range(count)]


def _run(
    plan: SweepPlan,
    tasks: Sequence[SweepTask],
    workers: Sequence[RequestWorker],
    out: Path,
    form: Format,
) -> Counts:
    """Run tasks, and return how many episodes of each engine had which outcome."""
    from gauge_envs.runs.result import Outcome
    from gauge_envs.tools.sweep.folder import run_sweep

    counts: Counts = Counter()
    total = plan.episode_count
    done = total - sum(len(task.seeds) for task in tasks)
    progress = Progress("episodes", total, done=done, line_interval_s=LINE_INTERVAL_S)
    lost = LostOutput()
    try:
        with progress, closing(run_sweep(tasks, workers, out)) as finished:
            for result in (one for results in finished for one in results):
                counts[str(result.backend), result.outcome] += 1
                name = f"{short_id(result.id)} on {result.backend}"
                with lost.tolerated():
                    if result.outcome is Outcome.FAILED:
                        message(f"{name}, seed {result.seed}: {result.error}", "failed")
                    progress.advance(name)
                    if form is Format.JSON:
                        print_json_lines([result.to_dict(trajectory=False)])
    except KeyboardInterrupt:
        left = total - done - counts.total()
        message(f"interrupted: {left} of {total} episodes left; continue with:")
        message(shlex.join(["gauge", *sys.argv[1:]]))
        raise typer.Exit(EXIT_INTERRUPTED) from None
    lost.report()
    return counts


def _is_bad(plan: SweepPlan, spec: SweepSpec, counts: Counts) -> bool:
    """Return whether an episode failed or diverged, or an experiment that was given by its id was declined."""
    from gauge_envs.experiments.variants import is_glob
    from gauge_envs.runs.result import Outcome

    if any(outcome in (Outcome.FAILED, Outcome.DIVERGED) for _, outcome in counts):
        return True
    named = {short_id(name) for name in spec.variants if not is_glob(name)}
    return any(run.declined and run.experiment in named for run in plan.runs)
