"""`gauge compare` and `gauge plot`."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gauge_envs.cli.arguments import Json, Wide, check_one_format
from gauge_envs.cli.output import EXIT_FAILED, echo, plain_text, print_document, stderr_console
from gauge_envs.cli.results import loaded_results

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
    from gauge_envs.pages.document import as_markdown, as_rows, save_file
    from gauge_envs.pages.figures import save_png
    from gauge_envs.tools.cost import draw_pareto, pareto_document, tradeoff

    found = tradeoff(results)
    for note in found.notes:
        stderr_console().print(f"[yellow]note:[/] {plain_text(note)}", soft_wrap=True)
    document = pareto_document(found)
    yield save_png(draw_pareto(found), folder / "pareto.png")
    yield save_file(folder / "pareto.md", as_markdown(document))
    yield save_file(folder / "pareto.json", json.dumps(as_rows(document)[0], indent=1) + "\n")


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
    from gauge_envs.tools.compare.words import check_metrics, comparison_document

    check_one_format(json_lines, markdown)
    chosen = check_metrics(metrics or [])
    results, skipped = loaded_results(sources, with_scene=out is not None)
    comparison = compare_results(results)
    print_document(comparison_document(comparison, chosen), json_lines=json_lines, markdown=markdown, wide=wide)
    if out is not None:
        from gauge_envs.tools.compare.overview_figure import save_comparison

        for path in save_comparison(results, out, metric=metrics[0] if metrics else None):
            stderr_console().print(plain_text(str(path)), soft_wrap=True)
    if skipped:
        raise typer.Exit(EXIT_FAILED)
