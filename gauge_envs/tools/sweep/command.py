"""`gauge sweep`."""

from __future__ import annotations

import re
import shlex
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from functools import partial
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
    echo,
    message,
    note,
    print_document,
    print_json_lines,
)
from gauge_envs.errors import ParameterError
from gauge_envs.files import processors
from gauge_envs.pages.text import counted

if TYPE_CHECKING:
    from gauge_envs.runs.result import Outcome
    from gauge_envs.tools.sweep.lanes import Lane
    from gauge_envs.tools.sweep.plan import SweepPlan
    from gauge_envs.tools.sweep.spec import SweepSpec

DEFAULT_JOBS = 16
"""Parts of a sweep on Slurm."""


def sweep(
    words: Annotated[
        list[str] | None,
        typer.Argument(metavar="[FILE] [KEY=VALUE]...", help="Sweep file, TOML, and keys that replace those in it."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the result files and the store.")] = Path("sweep"),
    changes: Annotated[
        list[str] | None,
        typer.Option("--set", help="Values of a setting, as timestep_s=0.001,0.0005 or mujoco.iterations=10,50."),
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show the plan and its cost; run nothing.")] = False,
    workers: Annotated[int | None, typer.Option(min=1, help="Worker processes; all processors by default.")] = None,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Run again what failed before.")] = False,
    limits: arguments.Limits = "",
    ray: Annotated[
        str | None, typer.Option(help="Run on Ray: auto, local, or the address of a cluster.", metavar="ADDRESS")
    ] = None,
    slurm: Annotated[Path | None, typer.Option(help="Write a script for Slurm, of --shard parts; run nothing.")] = None,
    shard: Annotated[
        str | None, typer.Option(metavar="NUMBER/COUNT", help="Run one part, as 0/16; parts may run at the same time.")
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Run engines, settings and experiments in all combinations; continue an earlier run.

    Keys: backends=mujoco,rapier; variants='SlopeSlider-2-*', ids, patterns or experiment files; presets=, of every
    engine; parameters=calibrated,effective, or one set of overrides; repeats=, episodes of each combination; seed=, of
    the first repeat; jitter=1mm,0.5deg, scatter of positions and angles. Several values have commas.

    Episodes whose results are in the folder do not run again. Without a sweep, the store of the folder, which may be
    one of gauge run, is brought up to date: sqlite3 DIR/sweep.sqlite 'SELECT id, score FROM results' reads it. Limits
    are those of the worker processes; with isolate each task has a process of its own. Exit code 1 when an episode
    failed or diverged, or when an experiment given by its id was declined.
    """
    from gauge_envs.runs.isolation import TIME_LIMIT_S
    from gauge_envs.tools.sweep.lanes import Limits
    from gauge_envs.tools.sweep.plan import plan_sweep, shard as part_of
    from gauge_envs.tools.sweep.spec import load_sweep_file, sweep_spec
    from gauge_envs.tools.sweep.store import update_store

    file, given = _split(words)
    if file is None and not given and not changes:
        if not out.is_dir():
            raise ParameterError("nothing to run: give a sweep file, or words as variants='SlopeSlider-2-*'")
        echo(update_store(out, note))
        return False
    stated = {} if file is None else load_sweep_file(file)
    if changes:
        known = given.get("backends") or stated.get("backends") or ["mujoco"]
        given["settings"] = _with_changes(stated.get("settings", {}), changes, known)
    spec = sweep_spec(stated | given)
    _, time_s, memory_gb = arguments.parsed_limits(limits)
    bounds = Limits(TIME_LIMIT_S if time_s is None else time_s, memory_gb, "isolate" in limits.split(","))
    plan = plan_sweep(spec, isolate=bounds.isolate)
    if slurm is not None:
        _write_slurm(slurm, file, out, shard, workers or 1, given)
        return False
    if shard is not None:
        plan = part_of(plan, *_part(shard))
    if dry_run:
        _show_plan(plan, out, workers or processors(), retry_failed=retry_failed, form=form)
        return False
    return _run(plan, spec, out, partial(_lanes, ray, workers, bounds), shard is not None, retry_failed, form)


# --- what is asked for -----------------------------------------------------------------------------------------------


def _split(words: Sequence[str] | None) -> tuple[Path | None, dict[str, Any]]:
    """Return the sweep file, and the keys that replace its own."""

    def parameters(text: str) -> list[Any]:
        return [arguments.parsed_parameters(text)] if "=" in text else arguments.split_list(text)

    lists = dict.fromkeys(("backends", "variants", "presets"), arguments.split_list) | {"parameters": parameters}
    numbers = {"repeats": PositiveInt, "seed": NonNegativeInt, "jitter": arguments.parsed_jitter}
    files: list[str] = []
    given: dict[str, Any] = {}
    for word in words or ():
        others, values = arguments.split_details([word], **lists, **numbers)
        files += others
        given |= {key: [*given.get(key, []), *value] if key in lists else value for key, value in values.items()}
    if len(files) > 1:
        raise ParameterError(f"{' and '.join(files)}: expected one sweep file; experiments are variants=ID,ID")
    return (Path(files[0]) if files else None), given


def _with_changes(settings: dict[str, Any], changes: list[str], backends: list[str]) -> dict[str, Any]:
    """Return settings with those of `--set`, whose name may begin with an engine and a dot."""
    result = dict(settings)
    for text in changes:
        key, equals, values = (part.strip() for part in text.partition("="))
        if not (key and equals and values):
            raise ParameterError(f"--set {text!r}: expected NAME=VALUE,VALUE or ENGINE.NAME=VALUE,VALUE")
        listed = [arguments.json_or_text(value.strip()) for value in arguments.split_list(values)]
        backend, dot, name = key.partition(".")
        if not dot:
            result[key] = listed
        elif backend not in backends:
            raise ParameterError(f"--set {text!r}: {backend!r} is no engine of this sweep: {', '.join(backends)}")
        elif isinstance(own := result.get(backend, {}), dict):
            result[backend] = own | {name: listed}
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


def _lanes(ray: str | None, workers: int | None, limits: Any, most: int) -> list[Lane]:
    """Return the lanes, at most so many as there are tasks."""
    from gauge_envs.tools.sweep.lanes import WorkerLane, ray_lanes

    if ray is not None:
        return [*ray_lanes(ray, workers and min(workers, most), limits)[:most]]
    return [WorkerLane(limits) for _ in range(min(workers or processors(), most))]


def _write_slurm(
    script: Path, file: Path | None, out: Path, shard: str | None, workers: int, given: Mapping[str, Any]
) -> None:
    from gauge_envs.tools.sweep.lanes import slurm_script, write_slurm_script

    if file is None or given:
        raise ParameterError(
            "--slurm needs a sweep file that states everything: write what the other words and options state into it"
        )
    if shard is not None and not re.fullmatch(r"[1-9]\d{0,8}", shard):
        raise ParameterError(f"--shard {shard!r}: expected a number of parts with --slurm, as {DEFAULT_JOBS}")
    jobs = DEFAULT_JOBS if shard is None else int(shard)
    words = [str(file.resolve()), "--out", str(out.resolve()), "--workers", str(workers)]
    text = slurm_script(script.name, words, jobs=jobs, workers=workers, log_folder=out.resolve() / "slurm")
    write_slurm_script(script, text)
    message(f"{script} written; it needs submitit: pip install 'gauge-envs[slurm]'")


# --- runs ------------------------------------------------------------------------------------------------------------


def _show_plan(plan: SweepPlan, out: Path, workers: int, *, retry_failed: bool, form: Format) -> None:
    from gauge_envs.runs.result import Outcome
    from gauge_envs.tools.sweep.plan import remaining_tasks
    from gauge_envs.tools.sweep.store import EarlierCosts, SweepFolder
    from gauge_envs.tools.sweep.words import cost_text, plan_document

    folder = SweepFolder(out)
    kept = [one for one in Outcome if not (retry_failed and one is Outcome.FAILED)]
    tasks = list(remaining_tasks(plan, {entry.name for entry in folder.files(*kept)}))
    costs = EarlierCosts(folder)
    print_document(plan_document(plan, tasks, costs), form)
    left = sum(len(task.seeds) for task in tasks)
    message(f"{plan.episode_count} episodes, {left} left; {counted(plan.duplicates, 'duplicate')} left out")
    message(cost_text(costs.of(task for task in tasks if task.run.declined is None), workers))


def _run(
    plan: SweepPlan,
    spec: SweepSpec,
    out: Path,
    lanes: Callable[[int], list[Lane]],
    is_part: bool,
    retry_failed: bool,
    form: Format,
) -> bool:
    """Run what is left of a plan, print the outcomes, and return whether one is bad."""
    from gauge_envs.experiments.variants import is_glob
    from gauge_envs.runs.result import Outcome
    from gauge_envs.tools.sweep.session import SweepSession
    from gauge_envs.tools.sweep.words import outcome_table

    counts: Counter[tuple[str, Outcome]] = Counter()
    with SweepSession(plan, out, is_part=is_part, retry_failed=retry_failed, notify=note) as session:
        counts.update(session.earlier)
        done = session.earlier.total()
        progress = Progress("episodes", plan.episode_count, done=done, line_interval_s=LINE_INTERVAL_S)
        try:
            if session.tasks:
                with progress, closing(session.run(lanes(len(session.tasks)))) as results:
                    for result in results:
                        counts[str(result.backend), result.outcome] += 1
                        name = f"{result.id.removeprefix('GAUGE/')} on {result.backend}"
                        if result.outcome is Outcome.FAILED:
                            message(f"failed: {name}, seed {result.seed}: {result.error}")
                        progress.advance(name)
                        if form is Format.JSON:
                            print_json_lines([result.to_dict(trajectory=False)])
        except KeyboardInterrupt:
            message(f"interrupted: {session.left()} of {plan.episode_count} episodes left; continue with:")
            message(shlex.join(["gauge", *sys.argv[1:]]))
            raise typer.Exit(EXIT_INTERRUPTED) from None
    if form is not Format.JSON:
        print_document(outcome_table(counts), form)
    message(f"{counted(counts.total(), 'episode')}; results in {out}")
    if any(counts[name, Outcome.FAILED] for name in spec.backends):
        message("causes of failures are in the folder failed; --retry-failed runs them again")
    named = {name.removeprefix("GAUGE/") for name in spec.variants if not is_glob(name)}
    return any(outcome in (Outcome.FAILED, Outcome.DIVERGED) for _, outcome in counts) or any(
        run.declined is not None and run.experiment in named for run in plan.runs
    )
