"""`gauge compare` and `gauge plot`."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gauge_envs.cli.arguments import Json, Wide, check_one_format
from gauge_envs.cli.output import EXIT_FAILED, echo, plain_text, print_json_lines, stderr_console, stdout_console
from gauge_envs.cli.results import loaded_results
from gauge_envs.errors import ResultFileError

if TYPE_CHECKING:
    from gauge_envs.runs.result import Result


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
    from gauge_envs.tools.compare.experiment_figure import save_figures

    results, skipped = loaded_results(sources, with_scene=True)
    for path in _save_pareto(results, out) if pareto else save_figures(results, out):
        echo(path)
    if skipped:
        raise typer.Exit(EXIT_FAILED)


def _save_pareto(results: Sequence[Result], folder: Path) -> Iterator[Path]:
    """Write error over cost as a picture, in Markdown and in JSON; yield each path."""
    from gauge_envs.files import write_whole
    from gauge_envs.tools.cost.figure import save_pareto
    from gauge_envs.tools.cost.pareto import tradeoff
    from gauge_envs.tools.cost.words import pareto_json, pareto_markdown

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
    from gauge_envs.tools.compare.comparison import compare as compare_results
    from gauge_envs.tools.compare.scores import check_metrics
    from gauge_envs.tools.compare.words import comparison_json, comparison_markdown, comparison_view

    check_one_format(json_lines, markdown)
    chosen = check_metrics(metrics or [])
    results, skipped = loaded_results(sources, with_scene=out is not None)
    comparison = compare_results(results)
    if json_lines:
        print_json_lines(comparison_json(comparison, chosen))
    elif markdown:
        echo(comparison_markdown(comparison, chosen), nl=False)
    else:
        stdout_console().print(comparison_view(comparison, chosen, wide=wide))
    if out is not None:
        from gauge_envs.tools.compare.overview_figure import save_comparison

        for path in save_comparison(results, out, metric=metrics[0] if metrics else None):
            stderr_console().print(plain_text(str(path)), soft_wrap=True)
    if skipped:
        raise typer.Exit(EXIT_FAILED)
