"""`gauge compare` and `gauge plot`."""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Format, echo, note, print_document
from gauge_envs.cli.results import loaded_results
from gauge_envs.errors import ParameterError, ResultFileError, UnknownNameError
from gauge_envs.registry import instruments_by

if TYPE_CHECKING:
    from gauge_envs.runs.result import Result

KINDS = instruments_by("pictures")
"""Instrument of each kind of picture."""

Metrics = Annotated[
    list[str] | None,
    arguments.option(
        arguments.SELECTION,
        "Metrics, as rmse or dtw.",
        "--metric",
        metavar="METRIC",
        show_default="all",
    ),
]


def compare(
    sources: arguments.Sources = None,
    metric: Metrics = None,
    corrected: arguments.Corrected = True,
    only: arguments.Only = None,
    backend: Annotated[
        list[str] | None,
        arguments.backend(
            "Engines whose results count.", arguments.SELECTION, show_default="all"
        ),
    ] = None,
    out: Annotated[
        list[Path] | None, arguments.target("Tables (.md) or rows (.json).")
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Compare engines, parameters and settings: scores with intervals, ranks and pairs.

    Ranks are within each grade of reference. Without a reference, distances between engines are shown. Results that
    differ in their seed alone are repeats, shown as mean and scatter. Exit code 2 when no result is left, 1 when a
    damaged file was skipped.
    """
    from gauge_envs.tools.compare.comparison import compare as compare_results
    from gauge_envs.tools.compare.words import check_metrics, comparison_document

    names, files = check_metrics(metric or ()), arguments.by_suffix(out, ".md", ".json")
    results, skipped = loaded_results(sources, corrected=corrected)
    if results:
        _check_chosen(list(results.values()), only or (), backend or ())
    kept = [
        one
        for one in results.values()
        if _is_chosen(one.id, only) and (not backend or one.backend in backend)
    ]
    if not kept:
        raise ResultFileError("no result is left to compare; gauge run writes them")
    print_document(comparison_document(compare_results(kept), names), form, files=files)
    return bool(skipped)


def _check_chosen(
    results: Sequence[Result], only: Sequence[str], backends: Sequence[str]
) -> None:
    """Raise an error for a pattern or an engine that chooses no result."""
    ids = {one.id for one in results}
    engines = {one.backend for one in results if one.backend is not None}
    for pattern in only:
        if not any(_is_chosen(name, [pattern]) for name in ids):
            raise UnknownNameError("experiment of the results", pattern, ids)
    for engine in backends:
        if engine not in engines:
            raise UnknownNameError("backend of the results", engine, engines)


def _is_chosen(name: str, only: Sequence[str] | None) -> bool:
    """Return whether an id is one of `--only`, or matches one of its patterns."""
    short = name.removeprefix("GAUGE/")
    return not only or any(
        fnmatchcase(short, pattern.removeprefix("GAUGE/")) for pattern in only
    )


def plot(
    sources: arguments.Sources = None,
    name: Annotated[
        str | None,
        arguments.experiment("Experiment of trajectory files, for diagnose."),
    ] = None,
    use: arguments.Use = None,
    metric: Metrics = None,
    corrected: arguments.Corrected = True,
    order: arguments.Order = None,
    measured_only: arguments.MeasuredOnly = False,
    kind: Annotated[
        str,
        arguments.option(
            arguments.OUTPUT, f"What to draw: {', '.join(KINDS)}.", metavar="KIND"
        ),
    ] = "experiments",
    out: Annotated[Path, arguments.folder("Folder for the pictures.")] = Path("plots"),
) -> bool:
    """Draw results: experiments over real bands, a comparison, a diagnosis, or cost.

    --metric and --corrected go with compare; --id, --use, --order and --measured-only with diagnose. Cost needs results
    with several steps. Exit code 1 when a damaged file was skipped.
    """
    if kind not in KINDS:
        raise UnknownNameError("kind of picture", kind, KINDS)
    draw = KINDS[kind].function(f"draw {kind}")
    options: dict[str, Any] = {}
    for key, value, default in (
        ("name", name, None),
        ("use", use, None),
        ("metric", metric, None),
        ("corrected", corrected, True),
        ("order", order, None),
        ("measured_only", measured_only, False),
    ):
        if value != default:
            options[key] = value
    for key in options.keys() - inspect.signature(draw).parameters.keys():
        option = "id" if key == "name" else key.replace("_", "-")
        raise ParameterError(
            f"--kind {kind} does not use --{option}: leave it out, or name another kind"
        )
    files, skipped = draw(sources, out, **options)
    for file in files:
        echo(file)
    return bool(skipped)


def draw_experiments(
    sources: Sequence[str] | None, out: Path
) -> tuple[Iterable[Path], int]:
    """Draw a picture of each experiment, over its real band."""
    from gauge_envs.tools.compare.experiment_figure import save_figures

    results, skipped = loaded_results(sources, with_scene=True)
    return save_figures(list(results.values()), out), skipped


def draw_compare(
    sources: Sequence[str] | None,
    out: Path,
    metric: Sequence[str] | None = None,
    corrected: bool = True,
) -> tuple[Iterable[Path], int]:
    """Draw a picture of each experiment, and one of all."""
    from gauge_envs.tools.compare.overview_figure import save_comparison
    from gauge_envs.tools.compare.words import check_metrics

    names = check_metrics(metric) if metric else ()
    results, skipped = loaded_results(sources, with_scene=True, corrected=corrected)
    if len(names) > 1:
        raise ParameterError(
            f"--metric {','.join(names)}: a picture shows one metric: name one"
        )
    return save_comparison(
        list(results.values()), out, metric=next(iter(names), None)
    ), skipped


def draw_cost(sources: Sequence[str] | None, out: Path) -> tuple[Iterable[Path], int]:
    """Write error over cost as a picture, in Markdown and in JSON."""
    from gauge_envs.pages.document import as_markdown, as_rows, save_file
    from gauge_envs.pages.figures import save_png
    from gauge_envs.tools.compare.cost import cost_curves, cost_document
    from gauge_envs.tools.compare.cost_figure import draw_costs

    results, skipped = loaded_results(sources, with_scene=True)
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
