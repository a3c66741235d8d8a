"""`gauge compare`."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Format, print_document
from gauge_envs.cli.results import loaded_results
from gauge_envs.errors import ResultFileError, UnknownNameError

if TYPE_CHECKING:
    from gauge_envs.runs.result import Result


def compare(
    sources: arguments.Sources = None,
    metric: arguments.Metrics = None,
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
    """Compare engines, parameters and settings: scores with intervals, and ranks.

    Ranks are within each kind of reference. Without a reference, distances between engines are shown. Results that
    differ in their seed alone are repeats, shown as mean and scatter. Exit code 2 when no result is left, 1 when a
    damaged file was skipped.
    """
    from gauge_envs.tools.compare.comparison import compare as compare_results
    from gauge_envs.tools.compare.report import check_metrics, comparison_document

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
    document = comparison_document(
        compare_results(kept),
        names,
        is_wide=form is Format.WIDE,
        with_rows=form is Format.JSON or ".json" in files,
    )
    print_document(document, form, files=files)
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
