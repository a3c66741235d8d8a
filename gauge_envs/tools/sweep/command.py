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
from pydantic import NonNegativeInt, PositiveInt

from gauge_envs.cli import arguments
from gauge_envs.cli.interrupts import EXIT_INTERRUPTED
from gauge_envs.cli.output import (
    LINE_INTERVAL_S,
    Format,
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
    from gauge_envs.runs.pool import Limits, TaskWorker
    from gauge_envs.runs.result import Outcome
    from gauge_envs.tools.sweep.folder import EarlierEpisode
    from gauge_envs.tools.sweep.plan import SweepPlan, SweepTask
    from gauge_envs.tools.sweep.spec import SweepSpec

DEFAULT_JOBS = 16
"""Parts of a sweep on Slurm."""


def sweep(
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[FILE] [KEY=VALUE]...",
            help="Sweep file, TOML, and keys that replace those in it.",
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the result files.")] = Path(
        "sweep"
    ),
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="Values of a setting, as timestep_s=0.001,0.0005 or mujoco.iterations=10,50.",
        ),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show the plan and its cost; run nothing.")
    ] = False,
    workers: Annotated[
        int | None,
        typer.Option(min=1, help="Worker processes; all processors by default."),
    ] = None,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Run again what failed before.")
    ] = False,
    limits: arguments.Limits = "",
    ray: Annotated[
        str | None,
        typer.Option(
            help="Run on Ray: auto, local, or the address of a cluster.",
            metavar="ADDRESS",
        ),
    ] = None,
    slurm: Annotated[
        Path | None,
        typer.Option(help="Write a script for Slurm, of --shard parts; run nothing."),
    ] = None,
    shard: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBER/COUNT",
            help="Run one part, as 0/16; parts may run at the same time.",
        ),
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Run engines, settings and experiments in all combinations; continue an earlier run.

    Keys: backends=mujoco,rapier; variants='SlopeSlider-2-*', ids, patterns or experiment files; presets=, of every
    engine; parameters=calibrated,effective, or one set of overrides; repeats=, episodes of each combination; seed=, of
    the first repeat; jitter=1mm,0.5deg, scatter of positions and angles. Several values have commas.

    Episodes whose results are in the folder do not run again. Limits are those of the worker processes; with isolate
    each task has a process of its own. Exit code 1 when an episode failed or diverged, or when an experiment given by
    its id was declined.
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

    file, given = _split(words)
    if file is None and not given and not changes:
        raise ParameterError(
            "nothing to run: give a sweep file, or words as variants='SlopeSlider-2-*'"
        )
    values = {} if file is None else load_sweep_file(file)
    if changes:
        known = given.get("backends") or values.get("backends") or ["mujoco"]
        given["settings"] = _with_changes(values.get("settings", {}), changes, known)
    spec = sweep_spec(values | given)
    _, time_s, memory_gb = arguments.parsed_limits(limits)
    bounds = Limits(
        TIME_LIMIT_S if time_s is None else time_s,
        memory_gb,
        "isolate" in limits.split(","),
    )
    plan = plan_sweep(spec, isolate=bounds.isolate)
    if slurm is not None:
        _write_slurm(slurm, file, out, shard, workers or 1, given)
        return False
    if shard is not None:
        plan = part_of(plan, *_part(shard))
    earlier = earlier_episodes(out, None if dry_run else note)
    names = set(plan.file_names)
    done = {
        name: one.outcome
        for name, one in earlier.items()
        if name in names and not (retry_failed and one.outcome is Outcome.FAILED)
    }
    tasks = list(remaining_tasks(plan, done))
    if dry_run:
        _show_plan(plan, tasks, earlier.values(), workers or processors(), form)
        return False
    counts = Counter(
        (earlier[name].group[0], outcome) for name, outcome in done.items()
    )
    if tasks:
        counts += _run(
            plan, tasks, _workers(ray, workers, bounds, len(tasks)), out, form
        )
    if form is not Format.JSON:
        print_document(outcome_table(plan, counts), form)
    message(f"{counted(counts.total(), 'episode')}; results in {out}")
    if any(outcome is Outcome.FAILED for _, outcome in counts):
        message(
            "causes of failures are in the folder failed; --retry-failed runs them again"
        )
    return _is_bad(plan, spec, counts)


# --- what is asked for -----------------------------------------------------------------------------------------------


def _split(words: Sequence[str] | None) -> tuple[Path | None, dict[str, Any]]:
    """Return the sweep file, and the keys that replace its own."""

    def parameters(text: str) -> list[Any]:
        return (
            [arguments.parsed_parameters(text)]
            if "=" in text
            else arguments.split_list(text)
        )

    lists = dict.fromkeys(("backends", "variants", "presets"), arguments.split_list) | {
        "parameters": parameters
    }
    numbers = {
        "repeats": PositiveInt,
        "seed": NonNegativeInt,
        "jitter": arguments.parsed_jitter,
    }
    files: list[str] = []
    given: dict[str, Any] = {}
    for word in words or ():
        others, values = arguments.split_details([word], **lists, **numbers)
        files += others
        given |= {
            key: [*given.get(key, []), *value] if key in lists else value
            for key, value in values.items()
        }
    if len(files) > 1:
        raise ParameterError(
            f"{' and '.join(files)}: expected one sweep file; experiments are variants=ID,ID"
        )
    return (Path(files[0]) if files else None), given


def _with_changes(
    settings: dict[str, Any], changes: list[str], backends: list[str]
) -> dict[str, Any]:
    """Return settings with those of `--set`, whose name may begin with an engine and a dot."""
    result = dict(settings)
    for text in changes:
        key, equals, values = (part.strip() for part in text.partition("="))
        if not (key and equals and values):
            raise ParameterError(
                f"--set {text!r}: expected NAME=VALUE,VALUE or ENGINE.NAME=VALUE,VALUE"
            )
        listed = [
            arguments.json_or_text(value.strip())
            for value in arguments.split_list(values)
        ]
        backend, dot, name = key.partition(".")
        if not dot:
            result[key] = listed
        elif backend not in backends:
            raise ParameterError(
                f"--set {text!r}: {backend!r} is no engine of this sweep: {', '.join(backends)}"
            )
        elif isinstance(of_engine := result.get(backend, {}), dict):
            result[backend] = of_engine | {name: listed}
        else:
            raise ParameterError(
                f"--set {text!r}: settings.{backend} of the sweep file is a list, expected a table of settings"
            )
    return result


def _part(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text)
    if found is None:
        raise ParameterError(f"--shard {text!r}: expected NUMBER/COUNT, as 0/16")
    return int(found[1]), int(found[2])


def _write_slurm(
    script: Path,
    file: Path | None,
    out: Path,
    shard: str | None,
    workers: int,
    given: Mapping[str, Any],
) -> None:
    from gauge_envs.tools.sweep.machines import slurm_script, write_slurm_script

    if file is None or given:
        raise ParameterError(
            "--slurm needs a sweep file that states everything: write what the other words and options state into it"
        )
    if shard is not None and not re.fullmatch(r"[1-9]\d{0,8}", shard):
        raise ParameterError(
            f"--shard {shard!r}: expected a number of parts with --slurm, as {DEFAULT_JOBS}"
        )
    jobs = DEFAULT_JOBS if shard is None else int(shard)
    words = [
        str(file.resolve()),
        "--out",
        str(out.resolve()),
        "--workers",
        str(workers),
    ]
    text = slurm_script(
        script.name,
        words,
        jobs=jobs,
        workers=workers,
        log_folder=out.resolve() / "slurm",
    )
    write_slurm_script(script, text)
    message(f"{script} written; it needs submitit: pip install 'gauge-envs[slurm]'")


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
) -> Sequence[TaskWorker]:
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
    workers: Sequence[TaskWorker],
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
    try:
        with progress, closing(run_sweep(tasks, workers, out)) as finished:
            for result in itertools.chain.from_iterable(finished):
                counts[str(result.backend), result.outcome] += 1
                name = f"{short_id(result.id)} on {result.backend}"
                if result.outcome is Outcome.FAILED:
                    message(f"failed: {name}, seed {result.seed}: {result.error}")
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
    return any(
        run.declined is not None and run.experiment in named for run in plan.runs
    )
