"""`gauge report`."""

import shlex
import sys
from importlib import import_module
from pathlib import Path
from typing import Annotated

from gauge_envs.cli import arguments
from gauge_envs.cli.output import LINE_INTERVAL_S, Progress, echo, message
from gauge_envs.cli.results import loaded_results
from gauge_envs.optional import needs_extra
from gauge_envs.pages.text import counted


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

    Open index.html from the folder. A 3D view shows the motion that gauge run stored beside the result. Exit code 1: a
    file was skipped because it is damaged or of another revision of its experiment.
    """
    from gauge_envs.tools.site import save_site
    from gauge_envs.tools.site.build import check_replaceable

    check_replaceable(out)
    with needs_extra("gauge report", "plot"):
        import_module("matplotlib")
    results, skipped = loaded_results(sources, with_scene=True, corrected=corrected)
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
