"""Commands that read results."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gauge_envs.cli.arguments import Json, Wide, WithheldOption, check_one_format
from gauge_envs.cli.output import EXIT_FAILED, echo, plain_text, print_json_lines, stderr_console, stdout_console
from gauge_envs.errors import GaugeError, ParameterError, ResultFileError

if TYPE_CHECKING:
    from gauge_envs.analysis.diagnosis import Diagnosis
    from gauge_envs.runs.result import Result


__all__ = ["compare", "diagnose", "loaded_files", "plot"]


def plot(
    sources: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[DIR or FILE]...", help="Result files, or folders of them; results/ by default."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the pictures.")] = Path("plots"),
    pareto: Annotated[
        bool,
        typer.Option(
            "--pareto",
            help="Error over cost instead, of runs with several steps: pareto.png, pareto.md and pareto.json.",
        ),
    ] = False,
) -> None:
    """Plot results over the real band, one PNG per experiment. Exit code 1 when a damaged file was skipped."""
    from gauge_envs.report.figures.experiment import save_figures

    results, skipped = _loaded(sources, with_scene=True)
    for path in _save_pareto(results, out) if pareto else save_figures(results, out):
        echo(path)
    if skipped:
        raise typer.Exit(EXIT_FAILED)


def _save_pareto(results: Sequence[Result], folder: Path) -> Iterator[Path]:
    """Write error over cost as a picture, in Markdown and in JSON; yield each path."""
    from gauge_envs.analysis.pareto import tradeoff
    from gauge_envs.files import write_whole
    from gauge_envs.report.figures.pareto import save_pareto
    from gauge_envs.report.pareto import pareto_json, pareto_markdown

    found = tradeoff(results)
    for note in found.notes:
        stderr_console().print(f"[yellow]note:[/] {plain_text(note)}", soft_wrap=True)
    yield save_pareto(found, folder / "pareto.png")
    texts = {"pareto.md": pareto_markdown(found), "pareto.json": json.dumps(pareto_json(found), indent=1) + "\n"}
    for name, text in texts.items():
        try:
            write_whole(folder / name, text.encode())
        except OSError as error:
            raise ResultFileError(f"{folder / name}: cannot be written: {error.strerror or error}") from error
        yield folder / name


def compare(
    sources: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[DIR or FILE]...", help="Result files, or folders of them; results/ by default."),
    ] = None,
    json_lines: Json = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="Tables as GitHub Markdown.")] = False,
    out: Annotated[Path | None, typer.Option(help="Draw pictures into this folder.")] = None,
    metrics: Annotated[
        list[str] | None,
        typer.Option("--metric", help="Repeatable: rmse, dtw, rmse_aligned, lsd, mte, pd, el; all by default."),
    ] = None,
    wide: Wide = False,
) -> None:
    """Compare engines, parameters and settings: scores with intervals, ranks and pairs within each grade of reference.

    Without a reference, distances between engines are shown. Results that differ in their seed alone are repeats,
    shown as mean and scatter. Exit code 1 when a damaged file was skipped.
    """
    from gauge_envs.analysis.comparison import compare as compare_results
    from gauge_envs.analysis.scores import check_metrics
    from gauge_envs.report import comparison_json, comparison_markdown, comparison_view

    check_one_format(json_lines, markdown)
    chosen = check_metrics(metrics or [])
    results, skipped = _loaded(sources, with_scene=out is not None)
    comparison = compare_results(results)
    if json_lines:
        print_json_lines(comparison_json(comparison, chosen))
    elif markdown:
        echo(comparison_markdown(comparison, chosen), nl=False)
    else:
        stdout_console().print(comparison_view(comparison, chosen, wide=wide))
    if out is not None:
        from gauge_envs.report.figures.overview import save_comparison

        for path in save_comparison(results, out, metric=metrics[0] if metrics else None):
            stderr_console().print(plain_text(str(path)), soft_wrap=True)
    if skipped:
        raise typer.Exit(EXIT_FAILED)


def diagnose(
    sources: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[DIR or FILE]...", help="Result files, or folders of them; results/ by default."),
    ] = None,
    name: Annotated[
        str | None, typer.Option("--id", help="Experiment of trajectory files, as for gauge score.")
    ] = None,
    order: Annotated[
        str, typer.Option(help="Parts in the order in which they are added to the fit.")
    ] = "release,offset,rate",
    measured_only: Annotated[bool, typer.Option("--measured-only", help="Leave out extrapolated frames.")] = False,
    use_withheld: WithheldOption = False,
    out: Annotated[Path | None, typer.Option(help="Draw a picture into this folder.")] = None,
    json_lines: Json = False,
    wide: Wide = False,
) -> None:
    """Split the error of episodes: release time, constant offset, rate or scale of the motion, and the rest.

    Results without a reference, or that did not run to their end, are reported and left out. Exit code 2 when no
    result is left, 1 when a damaged file was skipped.
    """
    from gauge_envs.analysis.error_budget import DiagnosisError, stage_order
    from gauge_envs.analysis.error_budget import diagnose as diagnose_result
    from gauge_envs.report import diagnosis_rows, diagnosis_view
    from gauge_envs.runs.score_file import score_file

    stages = stage_order(part.strip() for part in order.split(","))
    if name is None:
        results, skipped = _loaded(sources, with_scene=True)
    else:
        if not sources:
            raise ParameterError("--id needs trajectory files: give one or more")
        results, skipped = [score_file(file, variant=name, use_withheld=use_withheld)[0] for file in sources], 0
    pairs: list[tuple[Result, Diagnosis]] = []
    reasons: list[str] = []
    for result in results:
        try:
            diagnosis = diagnose_result(result, order=stages, measured_only=measured_only, use_withheld=use_withheld)
            pairs.append((result, diagnosis))
        except DiagnosisError as error:
            reasons.append(str(error))
    if results and not pairs:
        raise DiagnosisError("; ".join(dict.fromkeys(reasons)))
    for reason in dict.fromkeys(reasons):
        stderr_console().print(f"[yellow]left out:[/] {plain_text(reason)}", soft_wrap=True)
    if json_lines:
        print_json_lines(diagnosis_rows(pairs))
    else:
        stdout_console().print(diagnosis_view(pairs, wide=wide))
    if out is not None:
        from gauge_envs.report.figures.budgets import save_diagnoses

        stderr_console().print(plain_text(str(save_diagnoses(pairs, out))), soft_wrap=True)
    if skipped:
        raise typer.Exit(EXIT_FAILED)


def _loaded(sources: Sequence[Path] | None, *, with_scene: bool) -> tuple[list[Result], int]:
    results, skipped = loaded_files(sources, with_scene=with_scene)
    return list(results.values()), skipped


def loaded_files(sources: Sequence[Path] | None, *, with_scene: bool) -> tuple[dict[Path, Result], int]:
    """Return the results of files and folders by file, each file once, and the number of skipped files.

    Args:
        sources: Files and folders; None for `results/`.
        with_scene: Whether to skip also results whose scene cannot be built again.
    """
    from gauge_envs.runs.result_file import load_result
    from gauge_envs.runs.scene_record import recorded_experiment

    files = dict.fromkeys(file.resolve() for source in sources or [Path("results")] for file in _result_files(source))
    results: dict[Path, Result] = {}
    for file in files:
        try:
            result = load_result(file)
            if with_scene:
                recorded_experiment(result)
            results[file] = result
        except GaugeError as error:
            place = "" if isinstance(error, ResultFileError) else f"{file}: "
            stderr_console().print(f"[yellow]skipped:[/] {plain_text(f'{place}{error}')}", soft_wrap=True)
    return results, len(files) - len(results)


def _result_files(source: Path) -> list[Path]:
    files = sorted(source.glob("*.json")) if source.is_dir() else [source]
    if not files or not files[0].exists():
        raise ResultFileError(f"{source}: holds no result files; gauge run writes them")
    return files
