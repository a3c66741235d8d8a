"""Commands that write results in formats of other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gauge_envs.cli.arguments import WithheldOption
from gauge_envs.cli.output import echo

export_app = typer.Typer(help="Results in formats of other tools.", no_args_is_help=True)


@export_app.callback()
def _group() -> None:
    """Results in formats of other tools."""


@export_app.command("rerun")
def export_rerun(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="Result file.")],
    out: Annotated[Path | None, typer.Option(help="The recording; beside the result by default.")] = None,
    use_withheld: WithheldOption = False,
) -> None:
    """Write an episode as a recording for the Rerun viewer: bodies, cloth, markers, the recorded mean, and g(t).

    The episode is run again, on the engine of the result. Exit code 2 when its g(t) differs from that of the file.
    """
    from gauge_envs.runs.result_file import load_result
    from gauge_envs.tools.film.rerun_file import write_rerun

    echo(write_rerun(load_result(result), out or result.with_suffix(".rrd"), use_withheld=use_withheld))
