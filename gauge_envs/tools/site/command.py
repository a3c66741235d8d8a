"""`gauge report`."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from typing import Annotated

from gauge_envs.cli import arguments
from gauge_envs.cli.output import LINE_INTERVAL_S, Progress, echo, message, note
from gauge_envs.cli.results import loaded_results
from gauge_envs.optional import needs_extra
from gauge_envs.pages.text import counted
from gauge_envs.runs.configuration import group_by_configuration
from gauge_envs.runs.result import Result


def report(
    sources: arguments.Sources = None,
    corrected: arguments.Corrected = True,
    out: Annotated[
        Path, arguments.folder("Folder for the site; a site in it is replaced.")
    ] = Path("site"),
    motion_view: Annotated[
        bool,
        arguments.option(
            arguments.OUTPUT,
            "3D views of the motions.",
            "--motion-view/--no-motion-view",
        ),
    ] = True,
) -> bool:
    """Write results as a static site: figures and tables of scores, and 3D views of the motions.

    Open index.html from the folder. A 3D view runs the episode again, with the versions of the result. Exit code 1: a
    file was skipped because it is damaged or of another revision of its experiment.
    """
    from gauge_envs.tools.site import save_site
    from gauge_envs.tools.site.build import check_replaceable

    # Check before the runs, which may take minutes.
    check_replaceable(out)
    with needs_extra("gauge report", "plot"):
        import_module("matplotlib")
    results, skipped = loaded_results(sources, with_scene=True, corrected=corrected)
    if motion_view:
        note(_repeated_runs_text(results.values()))
    pages = len({result.id for result in results.values()})
    with Progress("pages", pages, line_interval_s=LINE_INTERVAL_S) as progress:
        notes = save_site(
            results,
            out,
            motion_views=motion_view,
            command=shlex.join(["gauge", *sys.argv[1:]]),
            progress=progress.advance,
        )
    if notes:
        missing = counted(len(notes), "3D view")
        message(f"{missing} missing; the pages give the reasons", "warning")
    message(counted(len(results), "result"))
    echo(out / "index.html")
    return bool(skipped)


def _repeated_runs_text(results: Iterable[Result]) -> str:
    """Return how many episodes the 3D views run again, one of each configuration, and their time."""
    seconds = [
        {result.id: result.wall_s or 0.0 for result in members}
        for _, members in group_by_configuration(results)
    ]
    count = counted(sum(map(len, seconds)), "episode")
    total_s = sum(sum(times.values()) for times in seconds)
    return f"3D views run {count} again, {total_s:.0f} s; --no-motion-view runs nothing"
