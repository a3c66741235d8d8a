"""`gauge compare` and `gauge plot`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from gauge_envs.cli.arguments import FormatOption, SourcesArgument, WithheldOption, split_details, split_list
from gauge_envs.cli.commands import DRAWINGS, load
from gauge_envs.cli.output import Format, echo, print_document
from gauge_envs.cli.results import loaded_results
from gauge_envs.errors import ParameterError, UnknownNameError


def compare(sources: SourcesArgument = None, form: FormatOption = Format.TEXT) -> bool:
    """Compare engines, parameters and settings: scores with intervals, ranks and pairs.

    Ranks are within each grade of reference. Without a reference, distances between engines are shown. Results that
    differ in their seed alone are repeats, shown as mean and scatter. metric=rmse,dtw after the results shows these
    metrics alone. Exit code 1 when a damaged file was skipped.
    """
    from gauge_envs.tools.compare.comparison import compare as compare_results
    from gauge_envs.tools.compare.words import check_metrics, comparison_document

    files, names = _split_metrics(sources)
    results, skipped = loaded_results(files)
    print_document(comparison_document(compare_results(results), check_metrics(names)), form)
    return bool(skipped)


def plot(
    sources: SourcesArgument = None,
    kind: Annotated[
        str,
        typer.Option(
            metavar="KIND",
            help="experiments; compare, all experiments in one picture; diagnose, the parts of the error; or cost, the "
            "error over the cost of runs with several steps.",
        ),
    ] = "experiments",
    out: Annotated[Path, typer.Option(help="Folder for the pictures.")] = Path("plots"),
    name: Annotated[
        str | None, typer.Option("--id", metavar="ID", help="With diagnose: experiment of trajectory files.")
    ] = None,
    use: WithheldOption = "",
) -> bool:
    """Draw results: experiments over real bands, a comparison, a diagnosis, or cost.

    Details after the results: metric=rmse for compare; order=release,offset,rate and measured_only=true for diagnose.
    Exit code 1 when a damaged file was skipped.
    """
    if kind not in DRAWINGS:
        raise UnknownNameError("kind of picture", kind, DRAWINGS)
    options: dict[str, Any] = {key: value for key, value in {"name": name, "use": use}.items() if value}
    if options and kind != "diagnose":
        raise ParameterError("--id and --use go with --kind diagnose: leave them out")
    files, skipped = load(DRAWINGS[kind], f"draw {kind}")(sources or [], out, **options)
    for file in files:
        echo(file)
    return bool(skipped)


def draw_experiments(sources: Sequence[str], out: Path) -> tuple[Iterable[Path], int]:
    """Draw a picture of each experiment, over its real band."""
    from gauge_envs.tools.compare.experiment_figure import save_figures

    files, _ = split_details(sources, {})
    results, skipped = loaded_results(files, with_scene=True)
    return save_figures(results, out), skipped


def draw_compare(sources: Sequence[str], out: Path) -> tuple[Iterable[Path], int]:
    """Draw a picture of each experiment, and one of all."""
    from gauge_envs.tools.compare.overview_figure import save_comparison

    files, names = _split_metrics(sources)
    results, skipped = loaded_results(files, with_scene=True)
    return save_comparison(results, out, metric=names[0] if names else None), skipped


def _split_metrics(words: Sequence[str] | None) -> tuple[list[str], list[str]]:
    """Return files, and the metrics that the detail `metric` names."""
    from gauge_envs.tools.compare.words import check_metrics

    files, details = split_details(words, {"metric": split_list})
    names = details.get("metric", [])
    check_metrics(names)
    return files, names
