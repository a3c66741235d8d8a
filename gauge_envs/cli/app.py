"""The `gauge` command. Heavy imports are inside the commands, so that help and completion stay quick."""

from __future__ import annotations

from typing import Any

import typer
import typer.core

from gauge_envs.cli.checks import backend_app, sanity
from gauge_envs.cli.data import assets_app, data_app
from gauge_envs.cli.describe import list_, materials, show
from gauge_envs.cli.output import EXIT_INTERRUPTED, EXIT_USAGE, plain_text, stderr_console
from gauge_envs.cli.results import compare, diagnose, plot
from gauge_envs.cli.run import run, score
from gauge_envs.errors import GaugeError

__all__ = ["app", "main"]


class _Group(typer.core.TyperGroup):
    """Group that prints errors of gauge-envs without a traceback; no other place catches them."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except GaugeError as error:
            stderr_console().print(f"[red]error:[/] {plain_text(str(error))}", soft_wrap=True)
            raise typer.Exit(EXIT_USAGE) from None
        except KeyboardInterrupt:
            stderr_console().print("interrupted")
            raise typer.Exit(EXIT_INTERRUPTED) from None


app = typer.Typer(
    cls=_Group,
    name="gauge",
    help="Measure how far a physics engine is from real motion-capture trials (GAUGE benchmark).",
    epilog="Exit codes: 0 success; 1 a bad outcome, which the help of a command describes; 2 a wrong request; "
    "130 interrupted.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command("list")(list_)
for command in (show, run, score, plot, compare, diagnose, sanity, materials):
    app.command()(command)
app.add_typer(backend_app, name="backend")
app.add_typer(assets_app, name="assets")
app.add_typer(data_app, name="data")


def main() -> None:
    """Run the `gauge` command."""
    app()
