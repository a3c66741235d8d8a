"""`gauge compare` and `gauge plot`."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Format, echo, note, print_document
from gauge_envs.cli.results import loaded_results
from gauge_envs.errors import ParameterError, UnknownNameError
from gauge_envs.registry import instruments_by

KINDS = instruments_by("pictures")
"""Instrument of each kind of picture."""


def compare(
    sources: arguments.Sources = None, form: arguments.Form = Format.TEXT
) -> bool:
    """Compare engines, parameters and settings: scores with intervals, ranks and pairs.

    Ranks are within each grade of reference. Without a reference, distances between engines are shown. Results that
    differ in their seed alone are repeats, shown as mean and scatter. metric=rmse,dtw after the results shows these
    metrics alone; corrected=false leaves out engines whose physics this package corrects. Exit code 1 when a damaged
    file was skipped.
    """
    from gauge_envs.tools.compare.comparison import compare as compare_results
    from gauge_envs.tools.compare.words import check_metrics, comparison_document

    files, names, corrected = _split_details(sources)
    results, skipped = loaded_results(files, corrected=corrected)
    print_document(
        comparison_document(
            compare_results(list(results.values())), check_metrics(names)
        ),
        form,
    )
    return bool(skipped)


def plot(
    sources: arguments.Sources = None,
    kind: Annotated[
        str, typer.Option(help=f"{', '.join(KINDS)}, which is the error over cost.")
    ] = "experiments",
    out: Annotated[Path, typer.Option(help="Folder for the pictures.")] = Path("plots"),
    name: Annotated[
        str | None,
        typer.Option("--id", metavar="ID", help="With diagnose: of trajectory files."),
    ] = None,
    use: arguments.Use = "",
) -> bool:
    """Draw results: experiments over real bands, a comparison, a diagnosis, or cost.

    Details after the results: metric=rmse and corrected=false for compare; order=release,offset,rate and
    measured_only=true for diagnose. Cost needs results with several steps. Exit code 1 when a damaged file was skipped.
    """
    if kind not in KINDS:
        raise UnknownNameError("kind of picture", kind, KINDS)
    options: dict[str, Any] = {
        key: value for key, value in {"name": name, "use": use}.items() if value
    }
    if options and kind != "diagnose":
        raise ParameterError("--id and --use go with --kind diagnose: leave them out")
    files, skipped = KINDS[kind].function(f"draw {kind}")(sources, out, **options)
    for file in files:
        echo(file)
    return bool(skipped)


def draw_experiments(
    sources: Sequence[str] | None, out: Path
) -> tuple[Iterable[Path], int]:
    """Draw a picture of each experiment, over its real band."""
    from gauge_envs.tools.compare.experiment_figure import save_figures

    results, skipped = loaded_results(
        arguments.split_details(sources)[0], with_scene=True
    )
    return save_figures(list(results.values()), out), skipped


def draw_compare(
    sources: Sequence[str] | None, out: Path
) -> tuple[Iterable[Path], int]:
    """Draw a picture of each experiment, and one of all."""
    from gauge_envs.tools.compare.overview_figure import save_comparison

    files, names, corrected = _split_details(sources)
    results, skipped = loaded_results(files, with_scene=True, corrected=corrected)
    return save_comparison(
        list(results.values()), out, metric=next(iter(names), None)
    ), skipped


def draw_cost(sources: Sequence[str] | None, out: Path) -> tuple[Iterable[Path], int]:
    """Write error over cost as a picture, in Markdown and in JSON."""
    from gauge_envs.pages.document import as_markdown, as_rows, save_file
    from gauge_envs.pages.figures import save_png
    from gauge_envs.tools.compare.cost import cost_curves, cost_document, draw_costs

    results, skipped = loaded_results(
        arguments.split_details(sources)[0], with_scene=True
    )
    notes: list[str] = []
    curves = cost_curves(results.values(), notes)
    for text in dict.fromkeys(notes):
        note(text)
    document = cost_document(curves)
    files = (
        save_png(draw_costs(curves), out / "pareto.png"),
        save_file(out / "pareto.md", as_markdown(document)),
        save_file(out / "pareto.json", json.dumps(as_rows(document), indent=1) + "\n"),
    )
    return files, skipped


def _split_details(words: Sequence[str] | None) -> tuple[list[str], list[str], bool]:
    """Return files, the metrics that the detail `metric` names, and whether corrected engines count."""
    from gauge_envs.tools.compare.words import check_metrics

    files, details = arguments.split_details(
        words, metric=arguments.split_list, corrected=bool
    )
    names = details.get("metric", [])
    check_metrics(names)
    return files, names, details.get("corrected", True)
