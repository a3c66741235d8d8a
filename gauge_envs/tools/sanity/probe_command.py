"""Command that prints the program which reads settings in a training environment."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gauge_envs.cli.output import echo, plain_text, stderr_console
from gauge_envs.errors import ParameterError


def sanity_probe(
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="File to write, as gauge_probe.py.")] = None,
) -> None:
    """Print a Python file that saves the settings of a training environment for gauge sanity.

    Copy it to the training environment, where gauge-envs need not be installed, and run it there: python gauge_probe.py
    TARGET. Then run gauge sanity TARGET.gaugeprobe.json here.
    """
    from gauge_envs.files import write_whole
    from gauge_envs.tools.sanity.probe import program_text

    text = program_text()
    if out is None:
        echo(text, nl=False)
        return
    try:
        write_whole(out, text.encode())
    except OSError as error:
        raise ParameterError(f"--out {out}: cannot be written: {error.strerror or error}") from None
    stderr_console().print(plain_text(str(out)), soft_wrap=True)
