"""`gauge compare`."""

from __future__ import annotations

import fnmatch
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Format, print_document
from gauge_envs.cli.results import loaded_results
from gauge_envs.errors import ResultFileError, UnknownNameError
from gauge_envs.pages.text import short_id

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

    Ranks are within each kind of reference. Experiments without a reference have distances between engines. Results
    that differ only in their seed are repeats, shown as mean and scatter. Exit code 1: a damaged file was skipped;
    2: no result is left.
    """
    from gauge_envs.tools.compare.comparison import compare as compare_results
    from gauge_envs.tools.compare.report import check_metrics, comparison_document
    from gauge_envs.tools.compare.spool import TrajectorySpool

    names, files = check_metrics(metric or ()), arguments.by_suffix(out, ".md", ".json")
    spool = TrajectorySpool()
    results, skipped = loaded_results(sources, corrected=corrected, keep=spool.put)
    patterns = [short_id(pattern) for pattern in only or ["*"]]
    kept = _matching(
        [*results.values()], "experiment", patterns, lambda result: short_id(result.id)
    )
    kept = _matching(
        kept, "backend", backend or ["*"], lambda result: result.backend or ""
    )
    if not kept:
        raise ResultFileError("no result is left to compare; gauge run writes them")
    document = comparison_document(
        compare_results(kept, spool.read),
        names,
        is_wide=form is Format.WIDE,
        with_rows=form is Format.JSON or ".json" in files,
    )
    print_document(document, form, files=files)
    return bool(skipped)


def _matching(
    results: Sequence[Result],
    kind: str,
    patterns: Sequence[str],
    name_of: Callable[[Result], str],
) -> list[Result]:
    """Return the results whose names match a pattern.

    Raises:
        UnknownNameError: A pattern matches no result.
    """
    names = {name_of(result) for result in results}
    for pattern in patterns:
        if names and not fnmatch.filter(names, pattern):
            raise UnknownNameError(f"{kind} of the results", pattern, names)
    return [
        result
        for result in results
        if any(fnmatch.fnmatchcase(name_of(result), pattern) for pattern in patterns)
    ]
