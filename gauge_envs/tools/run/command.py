"""`gauge run` and `gauge score`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import (
    Format,
    message,
    note,
    print_document,
)
from gauge_envs.cli.results import reported
from gauge_envs.errors import ParameterError, ResultFileError
from gauge_envs.processors import processor_count

if TYPE_CHECKING:
    from gauge_envs.runs.request import RunRequest
    from gauge_envs.runs.result import Result

MAX_LOCAL_EPISODES = 20
"""Maximum number of rigid episodes that run in this process by default."""


def run(
    ids: arguments.Ids = None,
    parameters: arguments.Parameters = None,
    asset: arguments.Asset = None,
    use: arguments.Use = None,
    jitter: arguments.JitterTexts = None,
    marker_proxy: Annotated[
        Literal["material", "node"],
        arguments.option(
            arguments.SCENE,
            "A marker on a deformable body: material, or node for its nearest node (paper).",
        ),
    ] = "material",
    backend: arguments.Backends = arguments.MUJOCO,
    changes: arguments.Settings = None,
    seed: arguments.Seed = 0,
    repeats: arguments.Repeats = 1,
    timeout: arguments.Timeout = None,
    memory: arguments.Memory = None,
    isolate: arguments.Isolate = False,
    jobs: Annotated[
        int | None,
        arguments.option(
            arguments.NUMERICS,
            "Experiments at once, each in a process.",
            "--jobs",
            "-j",
            min=1,
            show_default="all processors for long runs, else 1",
        ),
    ] = None,
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
    from gauge_envs.experiments.variants import is_glob, matching_variants
    from gauge_envs.runs.batch import check_requests, run_many
    from gauge_envs.runs.request import RunRequest
    from gauge_envs.runs.result import Outcome
    from gauge_envs.runs.workers import TIME_LIMIT_S
    from gauge_envs.tools.run.report import summary_document

    if not ids:
        raise ParameterError(
            "nothing to run: give ids or patterns such as '*'; gauge list shows them"
        )
    scatter = arguments.parsed_jitter(jitter)
    if repeats == 1 and scatter is not None and not any(scatter.to_dict().values()):
        scatter = None
    if seed and scatter is None and repeats == 1:
        note(
            f"--seed {seed} changes nothing: the initial state has no noise. Add --jitter real."
        )
    constants = arguments.parsed_parameters(parameters) or "calibrated"
    settings = arguments.parsed_settings(changes)
    variants_of = {pattern: matching_variants(pattern) for pattern in ids}
    requests = [
        RunRequest(
            subject,
            backend=engine,
            parameters=constants,
            settings=settings,
            asset=asset,
            **arguments.parsed_use(use, "drivers", "reference"),
            jitter=scatter,
            marker_proxy=marker_proxy,
            seed=seed,
            repeats=repeats,
        )
        for engine in dict.fromkeys(backend)
        for subject in dict.fromkeys(chain.from_iterable(variants_of.values()))
    ]
    is_apart = True if isolate or timeout or memory else None
    check_requests(requests, isolate=is_apart)
    for text in _unused_restitutions(requests):
        note(text)
    episodes = run_many(
        requests,
        out=out,
        resume=resume,
        isolate=is_apart,
        time_limit_s=timeout or TIME_LIMIT_S,
        memory_limit_gb=memory,
        notify=note,
        jobs=min(jobs or _default_jobs(requests), len(requests)),
    )
    total = sum(request.repeats for request in requests)
    interrupted = f"{out}; --resume continues from there"
    results: list[Result] = []
    try:
        for result in reported(episodes, form, total, interrupted=interrupted):
            results.append(result)
    except ResultFileError:
        message(f"stopped: {_totals(results, out)}; --resume continues from there")
        raise
    if form is not Format.JSON:
        is_detailed = details or form is Format.WIDE
        print_document(summary_document(results, details=is_detailed), form)
    message(_totals(results, out))
    named = {
        variant.id
        for pattern in ids
        if not is_glob(pattern)
        for variant in variants_of[pattern]
    }
    return any(
        result.outcome in (Outcome.FAILED, Outcome.DIVERGED)
        or (result.outcome is Outcome.UNSUPPORTED and result.id in named)
        for result in results
    )


def _unused_restitutions(requests: Sequence[RunRequest]) -> list[str]:
    """Return a sentence for each experiment with a restitution of the user that has no effect."""
    texts = []
    for request in {request.variant: request for request in requests}.values():
        # Some engines do not support the experiment of a pattern.
        with suppress(ParameterError):
            texts.append(request.experiment().unused_restitution)
    return [text for text in dict.fromkeys(texts) if text]


def _default_jobs(requests: Sequence[RunRequest]) -> int:
    """Return the number of processors; 1 for a few rigid episodes, which take less time than the start of a process."""
    episodes = sum(request.repeats for request in requests)
    is_long = episodes > MAX_LOCAL_EPISODES or any(
        request.calibrated_experiment().scene.deformables for request in requests
    )
    return processor_count() if is_long else 1


def _totals(results: Sequence[Result], out: Path) -> str:
    counts = Counter(result.outcome.value for result in results)
    parts = [f"{number} {outcome}" for outcome, number in counts.items()]
    return f"{', '.join(parts) or 'no episode finished'}; results in {out}"


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
        parameters=arguments.parsed_parameters(parameters),
        **arguments.parsed_use(use, "reference"),
    )
    for text in notes:
        note(text)
    document = summary_document([result], details=details or form is Format.WIDE)
    print_document(replace(document, rows=[result.to_dict(trajectory=False)]), form)
