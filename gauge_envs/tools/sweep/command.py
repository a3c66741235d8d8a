"""`gauge sweep`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import (
    Format,
    message,
    note,
    print_document,
)
from gauge_envs.cli.results import reported
from gauge_envs.errors import ParameterError
from gauge_envs.pages.text import counted, short_id
from gauge_envs.processors import processor_count

if TYPE_CHECKING:
    from gauge_envs.runs.workers import Limits, RequestWorker
    from gauge_envs.tools.sweep.spec import SweepSpec


def sweep(
    file: Annotated[
        Path | None,
        typer.Argument(
            metavar="FILE", help="Sweep file, TOML; options replace its keys."
        ),
    ] = None,
    parameters: arguments.Parameters = None,
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
            "Values of a setting: timestep_s=1/1800,1/3600 or mujoco.iterations=10,50.",
            "--set",
            metavar=arguments.ASSIGNED,
            show_default="defaults of the engine",
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
            "Episodes of each combination, with initial-state noise.",
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
            show_default="ids of the file",
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
        arguments.option(arguments.OUTPUT, "Show the plan; run nothing.", "--dry-run"),
    ] = False,
    out: Annotated[Path, arguments.folder("Folder for the result files.")] = Path(
        "sweep"
    ),
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Run engines, settings and experiments in all combinations; continue an earlier run.

    Episodes with results in the folder do not run again. --timeout and --memory limit the worker processes; with
    --isolate each task runs in a separate process. Exit code 1: an episode failed or diverged, or an experiment given
    by its id is unsupported.
    """
    from gauge_envs.experiments.variants import is_glob
    from gauge_envs.runs.result import Outcome
    from gauge_envs.runs.workers import TIME_LIMIT_S, Limits
    from gauge_envs.tools.sweep.folder import earlier_outcomes, run_sweep
    from gauge_envs.tools.sweep.plan import (
        episode_count,
        part_of,
        plan_sweep,
        remaining_tasks,
    )
    from gauge_envs.tools.sweep.report import outcome_table, plan_document

    scatter = arguments.parsed_jitter(jitter)
    parameter_sets: object = parameters
    if any("=" in text for text in parameters or ()):
        parameter_sets = [arguments.parsed_parameters(parameters)]
    spec = _spec(
        file,
        changes,
        backends=backend,
        variants=only,
        presets=preset,
        parameters=parameter_sets,
        repeats=repeats,
        seed=seed,
        jitter=scatter and scatter.to_dict(),
    )
    runs = part_of(plan_sweep(spec), shard or "0/1")
    earlier = earlier_outcomes(out, note)
    if retry_failed:
        earlier = {
            name: outcome
            for name, outcome in earlier.items()
            if outcome is not Outcome.FAILED
        }
    tasks = list(remaining_tasks(runs, earlier))
    total, left = episode_count(runs), episode_count(tasks)
    if dry_run:
        print_document(plan_document(runs, earlier), form)
        message(f"{counted(total, 'episode')}, {left} left")
        return False
    counts = Counter(
        (run.backend, earlier[name])
        for run in runs
        for name in run.file_names
        if name in earlier
    )
    if tasks:
        limits = Limits(timeout or TIME_LIMIT_S, memory, isolate)
        results = reported(
            run_sweep(tasks, _workers(ray, jobs, limits), out),
            form,
            total,
            done=total - left,
            interrupted=f"{out}; the same command continues",
        )
        counts.update((str(result.backend), result.outcome) for result in results)
    if form is not Format.JSON:
        print_document(outcome_table(counts), form)
    message(
        f"{counted(total, 'episode')}; results in {out}; --retry-failed repeats failures"
    )
    named = {short_id(name) for name in spec.variants if not is_glob(name)}
    is_unsupported = any(run.unsupported and run.experiment in named for run in runs)
    return is_unsupported or any(
        outcome in (Outcome.FAILED, Outcome.DIVERGED) for _, outcome in counts
    )


def _spec(
    file: Path | None, changes: Sequence[str] | None, **options: object
) -> SweepSpec:
    """Return the sweep of a file; options other than None replace its keys."""
    from gauge_envs.tools.sweep.spec import load_sweep_file, sweep_spec

    values = {} if file is None else load_sweep_file(file)
    values |= {key: value for key, value in options.items() if value is not None}
    if "variants" not in values:
        raise ParameterError(
            "nothing to run: give a sweep file or experiments, for example --only 'SlopeSlider-2-*'"
        )
    settings = values.setdefault("settings", {})
    # The name of a setting may have the prefix of an engine: mujoco.iterations.
    for name, listed in arguments.assigned("--set", changes or ()).items():
        engine, dot, key = name.rpartition(".")
        table = settings.setdefault(engine, {}) if dot else settings
        table[key] = list(map(arguments.value_of, arguments.split_values(listed)))
    return sweep_spec(values)


def _workers(
    ray: str | None, count: int | None, limits: Limits
) -> Sequence[RequestWorker]:
    """Return the workers; each process starts with its first task."""
    if ray is not None:
        from gauge_envs.tools.sweep.machines import ray_workers

        return ray_workers(ray, count, limits)
    from gauge_envs.runs.workers import ProcessWorker

    return [ProcessWorker(limits) for _ in range(count or processor_count())]
