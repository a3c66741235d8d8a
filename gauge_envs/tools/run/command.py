"""`gauge run`, `gauge sweep` and `gauge score`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
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
from gauge_envs.errors import ParameterError, ReferenceFileError
from gauge_envs.processors import processor_count
from gauge_envs.tools.run.options import RunOptions, SweepOptions, parsed_parameters

if TYPE_CHECKING:
    from gauge_envs.runs.request import RunRequest
    from gauge_envs.runs.workers import RequestWorker
    from gauge_envs.tools.run.plan import PlannedRun

MAX_LOCAL_EPISODES = 20
"""Maximum number of rigid episodes that run in this process by default."""


def run(
    ids: arguments.Ids = None,
    *,
    options: RunOptions,
    resume: Annotated[
        bool,
        arguments.option(
            arguments.SELECTION, "Keep results that exist already.", "--resume"
        ),
    ] = False,
    out: Annotated[Path, arguments.folder("Folder for the result files.")] = Path(
        "results"
    ),
    details: arguments.Details = False,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Run experiments, score each against its reference, and write a result file for each.

    The pattern '*' matches all. Engines of other packages run in another process. Exit code 1: an episode failed or
    diverged, or an experiment given by its id is unsupported. Experiments of a pattern may be unsupported.
    """
    from gauge_envs.runs.batch import run_many
    from gauge_envs.tools.run.plan import plan_runs
    from gauge_envs.tools.run.report import has_failed, summary_document, totals_text

    if not ids:
        raise ParameterError(
            "nothing to run: give ids or patterns such as '*'; gauge list shows them"
        )
    requests = [planned.request for planned in plan_runs(options.spec(ids))]
    for text in _without_effect(requests):
        note(text)
    limits = options.limits()
    is_limited = options.isolate or options.timeout or options.memory
    episodes = run_many(
        requests,
        out=out,
        resume=resume,
        isolate=True if is_limited else None,
        time_limit_s=limits.time_limit_s,
        memory_limit_gb=limits.memory_limit_gb,
        notify=note,
        jobs=min(options.jobs or _default_jobs(requests), len(requests)),
    )
    total = sum(request.repeats for request in requests)
    kept = f"{out}; --resume continues from there"
    results = list(reported(episodes, form, total, kept=kept))
    if form is not Format.JSON:
        is_detailed = details or form is Format.WIDE
        print_document(summary_document(results, details=is_detailed), form)
    message(totals_text(results, out))
    return has_failed([(result.id, result.outcome) for result in results], ids)


def _without_effect(requests: Sequence[RunRequest]) -> list[str]:
    """Return a sentence for each seed and restitution of the user that has no effect."""
    texts: dict[str, None] = {}
    for request in {request.variant: request for request in requests}.values():
        if request.seed and request.jitter is None and request.repeats == 1:
            text = "changes nothing: the initial state has no noise. Add --jitter real."
            texts[f"--seed {request.seed} {text}"] = None
        # Some experiments of a pattern do not have the parameters, or have a damaged import.
        with suppress(ParameterError, ReferenceFileError):
            texts[request.experiment().unused_restitution] = None
    return [text for text in texts if text]


def _default_jobs(requests: Sequence[RunRequest]) -> int:
    """Return the number of processors; 1 for a few rigid episodes, which take less time than the start of a process."""
    episodes = sum(request.repeats for request in requests)
    is_long = episodes > MAX_LOCAL_EPISODES or any(
        request.published_experiment().scene.deformables for request in requests
    )
    return processor_count() if is_long else 1


def sweep(
    file: Annotated[
        Path | None,
        typer.Argument(
            metavar="FILE", help="Sweep file, TOML; options replace its keys."
        ),
    ] = None,
    *,
    options: SweepOptions,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Run engines, settings and experiments in all combinations; continue an earlier run.

    Episodes with results in the folder do not run again. --timeout and --memory limit the worker processes; with
    --isolate each task runs in a separate process. Exit code 1: an episode failed or diverged, or an experiment given
    by its id is unsupported.
    """
    from gauge_envs.pages.text import counted
    from gauge_envs.tools.run.folder import earlier_outcomes, run_sweep
    from gauge_envs.tools.run.plan import (
        episode_count,
        part_of,
        plan_runs,
        remaining_tasks,
    )
    from gauge_envs.tools.run.report import has_failed, outcome_table, plan_document

    spec = options.spec_of(file)
    runs = part_of(plan_runs(spec), options.shard)
    out = options.out
    earlier = earlier_outcomes(out, note, without_failed=options.retry_failed)
    tasks = list(remaining_tasks(runs, earlier))
    total, left = episode_count(runs), episode_count(tasks)
    if options.dry_run:
        print_document(plan_document(runs, earlier), form)
        message(f"{counted(total, 'episode')}, {left} left")
        return False
    outcomes = [
        (run.backend, run.experiment, earlier[name])
        for run in runs
        for name in run.file_names
        if name in earlier
    ]
    if tasks:
        results = reported(
            run_sweep(tasks, _workers(options, tasks), out),
            form,
            total,
            done=total - left,
            kept=f"{out}; the same command continues",
        )
        outcomes += [
            (str(result.backend), result.id, result.outcome) for result in results
        ]
    if form is not Format.JSON:
        print_document(outcome_table(outcomes), form)
    message(
        f"{counted(total, 'episode')}; results in {out}; --retry-failed repeats failures"
    )
    return has_failed([outcome[1:] for outcome in outcomes], spec.variants)


def _workers(
    options: SweepOptions, tasks: Sequence[PlannedRun]
) -> Sequence[RequestWorker]:
    """Return the workers; each process starts with its first task."""
    limits = options.limits()
    if options.ray is not None:
        from gauge_envs.tools.run.machines import ray_workers

        return ray_workers(options.ray, options.jobs, limits)
    from gauge_envs.runs.workers import ProcessWorker

    count = options.jobs or _default_jobs([task.request for task in tasks])
    return [ProcessWorker(limits) for _ in range(count)]


def score(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="CSV, NPZ or JSON; also a result file."),
    ],
    name: Annotated[
        str | None,
        arguments.experiment("Experiment, if the file does not name it."),
    ] = None,
    parameters: arguments.Parameters = None,
    use: arguments.Use = None,
    details: arguments.Details = False,
    form: arguments.Form = Format.TEXT,
) -> None:
    """Score a trajectory from your own simulator; no engine is needed.

    The trajectory is g(t) in the observable's unit, mm for positions. Its columns are the coordinates in
    `gauge show ID`. Without a `time_s` column, rows are 30 Hz frames. The id may be a task file.
    """
    from gauge_envs.runs.score_file import score_file
    from gauge_envs.tools.run.report import summary_document

    result, notes = score_file(
        file,
        variant=name,
        parameters=parsed_parameters(parameters),
        **arguments.parsed_use(use, "reference"),
    )
    for text in notes:
        note(text)
    document = summary_document([result], details=details or form is Format.WIDE)
    print_document(replace(document, rows=[result.to_dict(trajectory=False)]), form)
