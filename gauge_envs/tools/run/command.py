"""Commands that run and score."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gauge_envs.cli.arguments import (
    AssetOption,
    DriversOption,
    Json,
    ParametersOption,
    ReferenceOption,
    Wide,
    WithheldOption,
    parsed_parameters,
    parsed_settings,
)
from gauge_envs.cli.interrupts import EXIT_INTERRUPTED
from gauge_envs.cli.output import (
    EXIT_FAILED,
    counted,
    plain_text,
    print_json_lines,
    progress_bar,
    stderr_console,
    stdout_console,
)
from gauge_envs.errors import ParameterError, ResultFileError
from gauge_envs.experiments.variants import is_glob, matching_subjects
from gauge_envs.references.imported import DataSource
from gauge_envs.scene.jitter import Jitter

if TYPE_CHECKING:
    from gauge_envs.runs.result import Result


def run(
    ids: Annotated[
        list[str] | None,
        typer.Argument(metavar="[ID or pattern]...", help="Ids or patterns, as 'SlopeSlider-*'; or experiment files."),
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="All experiments that the engine can run.")] = False,
    backends: Annotated[
        list[str] | None, typer.Option("--backend", help="Engine; repeatable; mujoco by default.")
    ] = None,
    parameters: ParametersOption = None,
    asset: AssetOption = None,
    drivers: DriversOption = DataSource.BUNDLED,
    reference: ReferenceOption = DataSource.BUNDLED,
    use_withheld: WithheldOption = False,
    changes: Annotated[
        list[str] | None,
        typer.Option("--set", help="Numerical setting of the engine, as timestep_s=0.0005; repeatable."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    marker_proxy: Annotated[
        str,
        typer.Option(
            help="What represents a marker on a deformable body: its material point, or the nearest node (paper)."
        ),
    ] = "material",
    repeats: Annotated[
        int, typer.Option(min=1, help="Runs of each experiment, from starts that scatter as real ones do.")
    ] = 1,
    jitter_mm: Annotated[
        float | None, typer.Option(min=0.0, help="Standard deviation of start positions in mm; 1.0 with --repeats.")
    ] = None,
    jitter_deg: Annotated[
        float | None, typer.Option(min=0.0, help="Standard deviation of start angles in degrees; 0.5 with --repeats.")
    ] = None,
    uncertainty: Annotated[
        bool,
        typer.Option("--uncertainty", help="Measure the sensitivities of this run, by about 20 further runs."),
    ] = False,
    out: Annotated[Path, typer.Option(help="Folder for the result files.")] = Path("results"),
    resume: Annotated[bool, typer.Option(help="Keep results that exist already.")] = False,
    isolate: Annotated[
        bool,
        typer.Option(
            "--isolate",
            help="Each experiment in a process of its own; engines of other packages always run in another process.",
        ),
    ] = False,
    time_limit_s: Annotated[
        float, typer.Option(help="Time limit of an experiment, with its repeats, in another process in s.")
    ] = 3600.0,
    memory_limit_gb: Annotated[
        float | None,
        typer.Option(help="Limit of the resident memory of that process in GB, on Linux; implies --isolate."),
    ] = None,
    json_lines: Json = False,
    wide: Wide = False,
) -> None:
    """Run experiments, score them against reality, and write a result file for each.

    Exit code 1 when an episode failed or diverged, or when an experiment given by its id was declined. Experiments of
    a pattern or of --all may be declined.
    """
    from gauge_envs.pages.results import summary_view
    from gauge_envs.runs.batch import check_requests, run_many
    from gauge_envs.runs.request import RunRequest
    from gauge_envs.runs.result import Outcome

    if not ids and not every:
        raise ParameterError("nothing to run: give ids, patterns or --all; gauge list shows them")
    patterns = ["*"] if every else ids or []
    chosen = list(dict.fromkeys(subject for pattern in patterns for subject in matching_subjects(pattern)))
    named = dict.fromkeys(
        subject for pattern in ids or [] if not is_glob(pattern) for subject in matching_subjects(pattern)
    )
    engines = list(dict.fromkeys(backends or ["mujoco"]))
    values, settings = parsed_parameters(parameters) or "calibrated", parsed_settings(changes or [])
    requests = [
        RunRequest(
            subject,
            backend=engine,
            parameters=values,
            settings=settings,
            marker_proxy=marker_proxy,
            drivers=drivers,
            reference=reference,
            use_withheld=use_withheld,
            asset=asset,
            seed=seed,
            repeats=repeats,
            jitter=_jitter(jitter_mm, jitter_deg),
            uncertainty=uncertainty,
        )
        for engine in engines
        for subject in chosen
    ]
    isolation = isolate or memory_limit_gb is not None or None
    check_requests(requests, isolate=isolation)
    by_name = {request.calibrated_experiment().id for request in requests if request.variant in named}

    stderr = stderr_console()
    results: list[Result] = []
    episodes = run_many(
        requests,
        out=out,
        resume=resume,
        isolate=isolation,
        time_limit_s=time_limit_s,
        memory_limit_gb=memory_limit_gb,
        notify=lambda text: stderr.print(f"[yellow]note:[/] {plain_text(text)}", soft_wrap=True),
    )
    total = len(requests) * repeats
    try:
        with progress_bar(stderr) as progress:
            bar = progress.add_task("episodes", total=total)
            for result in episodes:
                results.append(result)
                progress.update(bar, advance=1, description=result.id.removeprefix("GAUGE/"))
                if not stderr.is_terminal:
                    stderr.print(plain_text(_progress_line(result, len(results), total)), soft_wrap=True)
                if json_lines:
                    print_json_lines([result.to_dict(trajectory=False)])
    except KeyboardInterrupt:
        kept = sum(result.error is None for result in results)
        stderr.print(f"interrupted: {counted(kept, 'result')} kept in {out}; --resume continues from there")
        raise typer.Exit(EXIT_INTERRUPTED) from None
    except ResultFileError:
        stderr.print(summary_view(results, wide=wide, budget=uncertainty))
        stderr.print(f"stopped: {_totals(results, out)}; --resume continues from there when the cause is gone")
        raise
    (stderr if json_lines else stdout_console()).print(summary_view(results, wide=wide, budget=uncertainty))
    stderr.print(_totals(results, out))
    bad = (Outcome.FAILED, Outcome.DIVERGED)
    if any(r.outcome in bad or (r.outcome is Outcome.DECLINED and r.id in by_name) for r in results):
        raise typer.Exit(EXIT_FAILED)


def score(
    file: Annotated[Path, typer.Argument(help="CSV, NPZ or JSON; also a result file.")],
    name: Annotated[
        str | None, typer.Option("--id", help="Experiment, or experiment file; not needed if a JSON file states it.")
    ] = None,
    parameters: ParametersOption = None,
    reference: ReferenceOption = DataSource.BUNDLED,
    use_withheld: WithheldOption = False,
    json_lines: Json = False,
    wide: Wide = False,
) -> None:
    """Score a trajectory from your own simulator: g(t) in the observable's unit (mm for positions), no engine needed.

    Columns are the coordinates that `gauge show ID` lists. Without a `time_s` column, rows are 30 Hz frames.
    """
    from gauge_envs.pages.results import summary_view
    from gauge_envs.runs.score_file import score_file

    result, interpolated = score_file(
        file,
        variant=name,
        parameters=parsed_parameters(parameters),
        reference=reference,
        use_withheld=use_withheld,
    )
    if interpolated:
        stderr_console().print(
            f"[yellow]note:[/] {counted(interpolated, 'frame')} between samples: interpolated linearly"
        )
    if json_lines:
        print_json_lines([result.to_dict(trajectory=False)])
    else:
        stdout_console().print(summary_view([result], wide=wide))


def _totals(results: Sequence[Result], out: Path) -> str:
    counts: dict[str, int] = {}
    for result in results:
        counts[result.outcome.value] = counts.get(result.outcome.value, 0) + 1
    return f"{', '.join(f'{number} {outcome}' for outcome, number in counts.items())}; results in {out}"


def _progress_line(result: Result, number: int, total: int) -> str:
    return f"{number}/{total} {result.id.removeprefix('GAUGE/')} on {result.backend}: {result.outcome.value}"


def _jitter(position_mm: float | None, angle_deg: float | None) -> Jitter | None:
    if position_mm is None and angle_deg is None:
        return None
    given: dict[str, float] = {}
    if position_mm is not None:
        given["position_m"] = 1e-3 * position_mm
    if angle_deg is not None:
        given["angle_rad"] = math.radians(angle_deg)
    return Jitter(**given)
