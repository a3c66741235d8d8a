"""`gauge sanity probe`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from gauge_envs.cli import arguments
from gauge_envs.cli.output import (
    echo,
    message,
)


def sanity_probe(
    out: Annotated[
        Path | None,
        arguments.target(
            "File to write, as gauge_probe.py; - is stdout.",
            metavar=f"PATH|{arguments.STDOUT}",
            show_default="stdout",
        ),
    ] = None,
) -> None:
    """Print a Python file that saves the settings of a training environment.

    Copy it to the training environment, where gauge-envs need not be installed, and run it there: python gauge_probe.py
    TARGET. Then run gauge sanity TARGET.gaugeprobe.json here.
    """
    from gauge_envs.pages.document import save_file

    program = Path(__file__).with_name("gauge_probe.py").read_text(encoding="utf-8")
    if out is None or str(out) == arguments.STDOUT:
        echo(program, nl=False)
    else:
        message(save_file(out, program))
