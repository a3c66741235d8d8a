"""`gauge sweep`."""

from __future__ import annotations

import itertools
import re
import shlex
import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
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
    from gauge_envs.tools.sweep.folder import EarlierEpisode
    from gauge_envs.tools.sweep.plan import SweepPlan, SweepTask
    from gauge_envs.tools.sweep.spec import SweepSpec


def _option(
    option: str, panel: str, text: str, default: str | None = None, **more: Any
) -> Any:
    """Return an option that replaces a key of the sweep file, or that a sweep alone has."""
    names = [option, "-" + option[2]] if option in SHORT else [option]
    shown = True if default is None else default
    return arguments.option(panel, text, *names, show_default=shown, **more)


SHORT = ("--backend", "--parameter", "--seed")
"""Options with a short one, which is their first letter."""

Texts = list[str] | None


def sweep(
    file: Annotated[
        Path | None,
        typer.Argument(
            metavar="FILE", help="Sweep file, TOML; options replace its keys."
        ),
    ] = None,
    parameters: Annotated[
        Texts,
        _option(
            "--parameter",
            arguments.SCENE,
            "Parameter sets, as calibrated,effective; or overrides of one, as cube.friction=0.3.",
            "calibrated",
            metavar=arguments.ASSIGNED,
        ),
    ] = None,
    jitter: arguments.JitterTexts = None,
    backend: Annotated[
        Texts,
        _option(
            "--backend", arguments.NUMERICS, "Engines.", "mujoco", metavar="ENGINE"
        ),
    ] = None,
    preset: Annotated[
        Texts,
        _option(
            "--preset",
            arguments.NUMERICS,
            "Presets of every engine.",
            "chosen by each engine",
            metavar="NAME",
        ),
    ] = None,
    changes: Annotated[
        Texts,
        _option(
            "--set",
            arguments.NUMERICS,
            "Values of a setting, as timestep_s=1/1800,1/3600 or mujoco.iterations=10,50.",
            "those of the engine",
            metavar=arguments.ASSIGNED,
        ),
    ] = None,
    seed: Annotated[
        int | None,
        _option("--seed", arguments.NUMERICS, "Seed of the first repeat.", "0", min=0),
    ] = None,
    repeats: Annotated[
        int | None,
        _option(
            "--repeats",
            arguments.NUMERICS,
            "Episodes of each combination, from starts that scatter.",
            "1",
            min=1,
        ),
    ] = None,
    timeout: arguments.Timeout = None,
    memory: arguments.Memory = None,
    isolate: arguments.Isolate = False,
    jobs: arguments.Jobs = None,
    ray: Annotated[
        str | None,
        _option(
            "--ray",
            arguments.NUMERICS,
            "Run on Ray: auto, local, or the address of a cluster.",
            metavar="ADDRESS",
        ),
    ] = None,
    only: Annotated[
        Texts,
        _option(
            "--only",
            arguments.SELECTION,
            "Ids, patterns or task files.",
            "those of the file",
            metavar="ID",
        ),
    ] = None,
    shard: Annotated[
        str | None,
        _option(
            "--shard",
            arguments.SELECTION,
            "Run one part, as 0/16; parts may run at the same time.",
            metavar="NUMBER/COUNT",
        ),
    ] = None,
    retry_failed: Annotated[
        bool,
        _option("--retry-failed", arguments.SELECTION, "Run again what failed before."),
    ] = False,
    dry_run: Annotated[
        bool,
        _option(
            "--dry-run", arguments.OUTPUT, "Show the plan and its cost; run nothing."
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
    from gauge_envs.tools.sweep.folder import earlier_episodes
    from gauge_envs.tools.sweep.plan import (
        plan_sweep,
        remaining_tasks,
        shard as part_of,
    )
    from gauge_envs.tools.sweep.spec import load_sweep_file, sweep_spec
    from gauge_envs.tools.sweep.words import outcome_table

    scatter = arguments.parsed_jitter(jitter)
    options: dict[str, Any] = {
        "backends": backend,
        "variants": only,
        "presets": preset,
        "parameters": _parameter_sets(parameters),
        "repeats": repeats,
        "seed": seed,
        "jitter": None if scatter is None else scatter.to_dict(),
    }
    given = {key: value for key, value in options.items() if value is not None}
    if file is None and not given and not changes:
        raise ParameterError(
            "nothing to run: give a sweep file, or experiments, as --only 'SlopeSlider-2-*'"
        )
    values = {} if file is None else load_sweep_file(file)
    if changes:
        given["settings"] = _with_changes(values.get("settings", {}), changes)
    spec = sweep_spec(values | given)
    bounds = Limits(TIME_LIMIT_S if timeout is None else timeout, memory, isolate)
    plan = plan_sweep(spec, isolate=bounds.isolate)
    if shard is not None:
        plan = part_of(plan, *_part(shard))
    earlier = earlier_episodes(out, note)
    names = set(plan.file_names)
    done = {
        name: one.outcome
        for name, one in earlier.items()
        if name in names and not (retry_failed and one.outcome is Outcome.FAILED)
    }
    tasks = list(remaining_tasks(plan, done))
    if dry_run:
        _show_plan(plan, tasks, earlier.values(), jobs or processors(), form)
        return False
    counts = Counter(
        (earlier[name].group[0], outcome) for name, outcome in done.items()
    )
    if tasks:
        counts += _run(plan, tasks, _workers(ray, jobs, bounds, len(tasks)), out, form)
    if form is not Format.JSON:
        print_document(outcome_table(plan, counts), form)
    message(f"{counted(counts.total(), 'episode')}; results in {out}")
    if any(outcome is Outcome.FAILED for _, outcome in counts):
        message(
            "causes of failures are in the folder failed; --retry-failed runs them again"
        )
    return _is_bad(plan, spec, counts)


# --- what is asked for -----------------------------------------------------------------------------------------------


def _parameter_sets(texts: Sequence[str] | None) -> list[Any] | None:
    """Return names of parameter sets, or one set of overrides."""
    if texts and any("=" in text for text in texts):
        return [arguments.parsed_parameters(texts)]
    return list(texts) if texts else None


def _with_changes(settings: dict[str, Any], changes: list[str]) -> dict[str, Any]:
    """Return settings with those of `--set`, whose name may begin with an engine and a dot."""
    result = dict(settings)
    for text in changes:
        for name, values in arguments.assigned("--set", [text]).items():
            listed = [arguments.value_of(one) for one in arguments.split_values(values)]
            backend, dot, key = name.partition(".")
            if dot:
                table = result.get(backend)
                table = table if isinstance(table, dict) else {}
                result[backend] = {**table, key: listed}
            else:
                result[name] = listed
    return result


def _part(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text)
    if found is None:
        raise ParameterError(f"--shard {text!r}: expected NUMBER/COUNT, as 0/16")
    return int(found[1]), int(found[2])


# --- runs ------------------------------------------------------------------------------------------------------------


def _show_plan(
    plan: SweepPlan,
    tasks: Sequence[SweepTask],
    earlier: Iterable[EarlierEpisode],
    worker_count: int,
    form: Format,
) -> None:
    """Print what is left of a plan, and what it costs."""
    from gauge_envs.tools.sweep.folder import EarlierCosts
    from gauge_envs.tools.sweep.words import cost_text, plan_document

    costs = EarlierCosts(earlier)
    print_document(plan_document(plan, tasks, costs), form)
    left = sum(len(task.seeds) for task in tasks)
    message(
        f"{plan.episode_count} episodes, {left} left; {counted(plan.duplicates, 'duplicate')} left out"
    )
    message(
        cost_text(
            costs.of(task for task in tasks if task.run.declined is None), worker_count
        )
    )


def _workers(
    ray: str | None, count: int | None, limits: Limits, task_count: int
) -> Sequence[RequestWorker]:
    """Return the workers, at most as many as there are tasks."""
    if ray is not None:
        from gauge_envs.tools.sweep.machines import ray_workers

        return ray_workers(ray, count and min(count, task_count), limits)[:task_count]
    from gauge_envs.runs.pool import ProcessWorker

    return [
        ProcessWorker(limits) for _ in range(min(count or processors(), task_count))
    ]


def _run(
    plan: SweepPlan,
    tasks: Sequence[SweepTask],
    workers: Sequence[RequestWorker],
    out: Path,
    form: Format,
) -> Counter[tuple[str, Outcome]]:
    """Run tasks, and return how many episodes of each engine had which outcome."""
    from gauge_envs.runs.result import Outcome
    from gauge_envs.tools.sweep.folder import result_files
    from gauge_envs.tools.sweep.run import run_sweep

    counts: Counter[tuple[str, Outcome]] = Counter()
    done = plan.episode_count - sum(len(task.seeds) for task in tasks)
    progress = Progress(
        "episodes", plan.episode_count, done=done, line_interval_s=LINE_INTERVAL_S
    )
    lost = LostOutput()
    try:
        with progress, closing(run_sweep(tasks, workers, out)) as finished:
            for result in itertools.chain.from_iterable(finished):
                counts[str(result.backend), result.outcome] += 1
                name = f"{short_id(result.id)} on {result.backend}"
                with lost.tolerated():
                    if result.outcome is Outcome.FAILED:
                        message(f"{name}, seed {result.seed}: {result.error}", "failed")
                    progress.advance(name)
                    if form is Format.JSON:
                        print_json_lines([result.to_dict(trajectory=False)])
    except KeyboardInterrupt:
        left = set(plan.file_names) - {file.name for file in result_files(out)}
        message(
            f"interrupted: {len(left)} of {plan.episode_count} episodes left; continue with:"
        )
        message(shlex.join(["gauge", *sys.argv[1:]]))
        raise typer.Exit(EXIT_INTERRUPTED) from None
    lost.report()
    return counts


def _is_bad(
    plan: SweepPlan, spec: SweepSpec, counts: Mapping[tuple[str, Outcome], int]
) -> bool:
    """Return whether an episode failed or diverged, or an experiment that was given by its id was declined."""
    from gauge_envs.experiments.variants import is_glob
    from gauge_envs.runs.result import Outcome

    if any(outcome in (Outcome.FAILED, Outcome.DIVERGED) for _, outcome in counts):
        return True
    named = {short_id(name) for name in spec.variants if not is_glob(name)}
    return any(run.declined and run.experiment in named for run in plan.runs)
